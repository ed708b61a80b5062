"""The two drawings of the placement guide: directions in, SVG out, in mm of paper.

Both halves of the ball as azimuthal equidistant maps, so that distances from the pole are to scale; and a sketch of
how the tape is held.
"""

import html

import numpy as np

from spheremouse.geometry.rotation import Array

_RIM = 56.0  # radius of a hemisphere on paper


def drawn_radius(radius: float, disc_radius: float) -> float:
    """m, the radius at which discs of a ball are drawn: their own, unless a pencil's point is larger."""
    return max(disc_radius, 0.9 / _RIM * 0.5 * np.pi * radius)


def drawing(directions: Array, radius: float, disc_radius: float) -> str:
    """Both halves of a ball with its discs, distances from the pole to scale, as SVG; radii in m."""
    mm = 1e3 * radius
    quarter = 0.5 * np.pi * mm
    scale = _RIM / quarter
    width, top, bottom = 180.0, 9.0 + _RIM, 9.0 + 3.0 * _RIM
    cx = 0.5 * width
    parts = [
        f"<svg class='drawing' viewBox='0 0 {width:.0f} {4 * _RIM + 18:.0f}' role='img' aria-label='both halves'>",
        f"<style>{_SVG_STYLE}</style>",
    ]
    ring = 250 if radius >= 0.3 else 10 * max(1, round(quarter / 40))
    spoke = 250 if radius >= 0.3 else 10 * max(1, round(quarter / 40))
    circumference = 2.0 * np.pi * mm

    def at(upper: bool, r: float, reading: float) -> tuple[float, float]:
        a = reading / mm
        return (cx + r * np.sin(a), (top + r * np.cos(a)) if upper else (bottom - r * np.cos(a)))

    for upper, cy in ((True, top), (False, bottom)):
        for reading in np.arange(0.0, circumference - 0.4 * spoke, spoke):
            x0, y0 = at(upper, 0.06 * _RIM, reading)
            x1, y1 = at(upper, _RIM, reading)
            parts.append(f"<line class='grid' x1='{x0:.2f}' y1='{y0:.2f}' x2='{x1:.2f}' y2='{y1:.2f}'/>")
            if 0.5 < reading / mm < 2.0 * np.pi - 0.5:  # where the halves touch there is no room
                x, y = at(upper, _RIM + 4.6, reading)
                parts.append(f"<text class='scale' x='{x:.2f}' y='{y + 1.0:.2f}'>{reading:.0f}</text>")
        label = _free_spoke(directions, upper, np.arange(0.5 * spoke, circumference, spoke) / mm)
        first = ring if upper else np.ceil((quarter + 1e-6) / ring) * ring
        for length in np.arange(first, quarter if upper else 2.0 * quarter, ring):
            r = (length if upper else 2.0 * quarter - length) * scale
            if r < 3.0 or r > _RIM - 1.5:
                continue
            parts.append(f"<circle class='grid' cx='{cx}' cy='{cy:.2f}' r='{r:.2f}'/>")
            x, y = at(upper, r, label * mm)
            parts.append(_haloed(x, y + 0.9, f"{length:.0f}", "scale"))
        parts.append(f"<circle class='rim' cx='{cx}' cy='{cy:.2f}' r='{_RIM}'/>")
    parts.append(f"<text class='zero' x='{cx + 6.0}' y='{0.5 * (top + bottom) + 1.2:.2f}'>0</text>")
    parts.append(f"<text class='zero' x='{cx - 6.0}' y='{0.5 * (top + bottom) + 1.2:.2f}'>0</text>")
    parts.append(f"<text class='half' x='6' y='{top - _RIM + 6:.1f}'>around P</text>")
    parts.append(f"<text class='half' x='6' y='{bottom + _RIM - 2:.1f}'>lower half</text>")
    parts.append(_haloed(cx, bottom + 0.9, f"{2 * quarter:.0f}", "scale"))
    size = drawn_radius(radius, disc_radius) * 1e3 * scale
    for k, (x, y, z) in enumerate(directions):
        upper = bool(z >= 0.0)
        polar = np.arccos(np.clip(z, -1.0, 1.0)) * mm
        px, py = at(upper, (polar if upper else 2.0 * quarter - polar) * scale, float(np.arctan2(y, x)) * mm)
        parts.append(f"<circle class='disc' cx='{px:.2f}' cy='{py:.2f}' r='{size:.2f}'/>")
        text = f"{k + 1} = P" if k == 0 and z > 1.0 - 1e-12 else str(k + 1)
        left = px > cx and np.hypot(px + 6.0 - cx, py - (top if upper else bottom)) > _RIM  # else it hides the rim
        parts.append(_haloed(px - size - 0.8 - 2.9 * len(text) if left else px + size + 0.8, py + 1.5, text, "number"))
    parts.append("</svg>")
    return "".join(parts)


def _free_spoke(directions: Array, upper: bool, azimuths: Array) -> float:
    """The azimuth, of some, along which a half has the most room between its discs."""
    side = directions[(directions[:, 2] >= 0.0) == upper]
    polar = np.linspace(0.15, 0.5, 8) * np.pi
    heights = np.cos(polar) if upper else -np.cos(polar)
    along = np.sin(polar)[:, None] * np.stack([np.cos(azimuths), np.sin(azimuths)])[:, None]
    nearest = [along[0] * x + along[1] * y + (heights * z)[:, None] for x, y, z in side]
    return float(azimuths[np.argmin(np.max(nearest, axis=(0, 1)))]) if nearest else float(azimuths[0])


def _haloed(x: float, y: float, text: str, style: str) -> str:
    """Text with a white edge, legible across lines. Drawn twice: not every printer knows `paint-order`."""
    at = f"x='{x:.2f}' y='{y:.2f}'>{html.escape(text)}</text>"
    return f"<text class='{style} halo' {at}<text class='{style}' {at}"


def sketch() -> str:
    """A ball with P, the band and one disc of the lower half, seen from a little above."""
    tilt = np.radians(24.0)
    radius, cx, cy = 34.0, 42.0, 40.0

    def seen(v: Array) -> tuple[Array, Array, Array]:
        x, y, z = v[..., 1], v[..., 2], v[..., 0]  # the reader looks along -x, P (z) is up
        return cx + radius * x, cy - radius * (np.cos(tilt) * y - np.sin(tilt) * z), np.sin(tilt) * y + np.cos(tilt) * z

    def on_ball(polar: Array, azimuth: Array) -> Array:
        return np.stack(
            [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth], axis=-1
        )

    def line(polar: Array, azimuth: Array, style: str) -> str:
        u, v, front = seen(on_ball(polar, azimuth))
        text = ""
        for near in (True, False):
            part = [f"{a:.2f},{b:.2f}" for a, b, f in zip(u, v, front, strict=True) if (f >= 0.0) == near]
            if len(part) > 1:
                text += f"<polyline class='{style}{'' if near else ' behind'}' points='{' '.join(part)}'/>"
        return text

    turn = np.linspace(0.01, 2.0 * np.pi - 0.01, 120) + np.pi / 2  # begins where it goes behind
    zero, reading, place = np.radians(-38.0), np.radians(22.0), np.radians(122.0)
    down = np.linspace(0.0, 1.0, 60)
    parts = [
        "<svg class='sketch' viewBox='0 0 84 84' role='img' aria-label='tape from P over the band to a disc'>",
        f"<style>{_SVG_STYLE}</style>",
        f"<circle class='rim' cx='{cx}' cy='{cy}' r='{radius}'/>",
        line(np.full(120, np.pi / 2), turn, "band"),
        line(down * np.pi / 2, np.full(60, zero), "grid dark"),
        line(down * place, np.full(60, reading), "tape"),
    ]

    def label(polar: float, azimuth: float, text: str, dx: float, dy: float) -> str:
        u, v, _ = seen(on_ball(np.array(polar), np.array(azimuth)))
        return _haloed(float(u) + dx, float(v) + dy, text, "plain")

    for where in np.arange(zero, np.radians(80.0), np.radians(20.0)):
        (u0, v0, _), (u1, v1, _) = (seen(on_ball(np.array(np.pi / 2 + o), np.array(where))) for o in (-0.03, 0.045))
        parts.append(
            f"<line class='tick' x1='{float(u0):.2f}' y1='{float(v0):.2f}' x2='{float(u1):.2f}' y2='{float(v1):.2f}'/>"
        )
    for polar, azimuth in ((0.0, 0.0), (place, reading)):
        u, v, _ = seen(on_ball(np.array(polar), np.array(azimuth)))
        parts.append(
            f"<ellipse class='disc' cx='{float(u):.2f}' cy='{float(v):.2f}' rx='2.1' ry='{2.1 if polar else 1.0}'/>"
        )
    parts += [
        label(0.0, 0.0, "P, disc 1", 3.0, -1.4),
        label(np.pi / 2, zero, "0", -1.0, 6.4),
        label(np.pi / 2, reading, "reading", -17.5, -2.4),
        label(place, reading, "disc", 3.4, 1.4),
        label(0.85, reading, "from P", 2.0, 0.0),
        label(np.pi / 2, np.radians(66.0), "band", -6.0, -3.6),
        "</svg>",
    ]
    return "".join(parts)


_SVG_STYLE = """
text { font-family: "Helvetica Neue", Arial, "Liberation Sans", "DejaVu Sans", sans-serif; }
circle, polyline { fill: none; }
.rim { stroke: #000; stroke-width: 0.45; }
.grid { stroke: #999; stroke-width: 0.12; }
.dark { stroke: #000; stroke-width: 0.18; }
.band { stroke: #777; stroke-width: 1.8; }
.tape { stroke: #000; stroke-width: 0.7; stroke-dasharray: 2 0.7; }
.behind { stroke-dasharray: 0.5 1; stroke-width: 0.3; }
.tick { stroke: #000; stroke-width: 0.35; }
circle.disc, ellipse.disc { fill: #000; stroke: #fff; stroke-width: 0.25; }
.halo { fill: #fff; stroke: #fff; stroke-width: 0.9; stroke-linejoin: round; }
.number { font-size: 4.2px; font-weight: bold; }
.plain { font-size: 4px; }
.scale { font-size: 2.6px; fill: #444; text-anchor: middle; }
.zero { font-size: 4px; font-weight: bold; text-anchor: middle; }
.half { font-size: 4px; }
"""
