"""Draw the two figures of the placement guide as SVG, in mm of paper.

Both halves of the ball are azimuthal equidistant maps, so distances from the pole are to scale. A sketch shows
the tape.
"""

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from spheremouse.files.report import svg
from spheremouse.geometry.rotation import Array

_RIM = 56.0  # radius of a hemisphere on paper
_WIDTH = 180.0


def drawn_radius(radius: float, disc_radius: float) -> float:
    """Return the drawn radius of discs in m: their own, or that of a pencil's point if it is larger."""
    return max(disc_radius, 0.9 / _RIM * 0.5 * np.pi * radius)


def drawing(directions: Array, radius: float, disc_radius: float) -> Markup:
    """Return both halves of a ball with its discs as SVG; radii in m."""
    return svg.drawing(_WIDTH, 4 * _RIM + 18, "both halves", _halves(directions, radius, disc_radius))


def _halves(directions: Array, radius: float, disc_radius: float) -> Iterator[Markup]:
    mm = 1e3 * radius
    quarter = 0.5 * np.pi * mm
    scale = _RIM / quarter
    top, bottom, cx = 9.0 + _RIM, 9.0 + 3.0 * _RIM, 0.5 * _WIDTH
    step = 250 if radius >= 0.3 else 10 * max(1, round(quarter / 40))  # of rings and spokes
    circumference = 2.0 * np.pi * mm

    def at(upper: bool, r: float, reading: float) -> tuple[float, float]:
        a = reading / mm
        return (cx + r * np.sin(a), (top + r * np.cos(a)) if upper else (bottom - r * np.cos(a)))

    for upper, cy in ((True, top), (False, bottom)):
        for reading in np.arange(0.0, circumference - 0.4 * step, step):
            yield _line(at(upper, 0.06 * _RIM, reading), at(upper, _RIM, reading), "grid")
            if 0.5 < reading / mm < 2.0 * np.pi - 0.5:  # the halves touch there
                x, y = at(upper, _RIM + 4.6, reading)
                yield _text(x, y + 1.0, f"{reading:.0f}", "scale")
        label = _free_spoke(directions, upper, np.arange(0.5 * step, circumference, step) / mm)
        first = step if upper else np.ceil((quarter + 1e-6) / step) * step
        for length in np.arange(first, quarter if upper else 2.0 * quarter, step):
            r = (length if upper else 2.0 * quarter - length) * scale
            if r < 3.0 or r > _RIM - 1.5:
                continue
            yield svg.element("circle", class_="grid", cx=cx, cy=cy, r=r)
            x, y = at(upper, r, label * mm)
            yield _haloed(x, y + 0.9, f"{length:.0f}", "scale")
        yield svg.element("circle", class_="rim", cx=cx, cy=cy, r=_RIM)
    yield _text(cx + 6.0, 0.5 * (top + bottom) + 1.2, "0", "zero")
    yield _text(cx - 6.0, 0.5 * (top + bottom) + 1.2, "0", "zero")
    yield _text(6.0, top - _RIM + 6.0, "around P", "half")
    yield _text(6.0, bottom + _RIM - 2.0, "lower half", "half")
    yield _haloed(cx, bottom + 0.9, f"{2 * quarter:.0f}", "scale")
    size = drawn_radius(radius, disc_radius) * 1e3 * scale
    for k, (x, y, z) in enumerate(directions):
        upper = bool(z >= 0.0)
        polar = np.arccos(np.clip(z, -1.0, 1.0)) * mm
        px, py = at(upper, (polar if upper else 2.0 * quarter - polar) * scale, float(np.arctan2(y, x)) * mm)
        yield svg.element("circle", class_="disc", cx=px, cy=py, r=size)
        text = f"{k + 1} = P" if k == 0 and z > 1.0 - 1e-12 else str(k + 1)
        left = px > cx and np.hypot(px + 6.0 - cx, py - (top if upper else bottom)) > _RIM  # keep the rim visible
        yield _haloed(px - size - 0.8 - 2.9 * len(text) if left else px + size + 0.8, py + 1.5, text, "number")


def _free_spoke(directions: Array, upper: bool, azimuths: Array) -> float:
    """Return the azimuth, of some, with the most room between the discs of a half."""
    side = directions[(directions[:, 2] >= 0.0) == upper]
    polar = np.linspace(0.15, 0.5, 8) * np.pi
    heights = np.cos(polar) if upper else -np.cos(polar)
    along = np.sin(polar)[:, None] * np.stack([np.cos(azimuths), np.sin(azimuths)])[:, None]
    nearest = [along[0] * x + along[1] * y + (heights * z)[:, None] for x, y, z in side]
    return float(azimuths[np.argmin(np.max(nearest, axis=(0, 1)))]) if nearest else float(azimuths[0])


def _line(a: Array | tuple[float, float], b: Array | tuple[float, float], style: str) -> Markup:
    return svg.element("line", class_=style, x1=a[0], y1=a[1], x2=b[0], y2=b[1])


def _text(x: float, y: float, text: str, style: str) -> Markup:
    return svg.element("text", text, class_=style, x=x, y=y)


def _haloed(x: float, y: float, text: str, style: str) -> Markup:
    """Draw text with a white edge, legible across lines. It is drawn twice, since printers may ignore `paint-order`."""
    return _text(x, y, text, f"{style} halo") + _text(x, y, text, style)


def sketch() -> Markup:
    """Return a ball with P, the band and one disc of the lower half, seen from a little above."""
    return svg.drawing(84, 84, "tape from P over the band to a disc", _held_tape())


def _held_tape() -> Iterator[Markup]:
    tilt = np.radians(24.0)
    radius, cx, cy = 34.0, 42.0, 40.0

    def seen(polar: Array | float, azimuth: Array | float) -> tuple[Array, NDArray[np.bool_]]:
        """Return places in the drawing (..., 2), and whether they are on the near side. P is up."""
        x, y, z = np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)
        across, up, towards = x, np.cos(tilt) * y - np.sin(tilt) * z, np.sin(tilt) * y + np.cos(tilt) * z
        return np.stack(np.broadcast_arrays(cx + radius * across, cy - radius * up), axis=-1), towards >= 0.0

    def curve(polar: Array | float, azimuth: Array | float, style: str) -> Iterator[Markup]:
        xy, near = seen(polar, azimuth)
        for part, name in ((xy[near], style), (xy[~near], f"{style} behind")):
            if len(part) > 1:
                yield svg.element("polyline", class_=name, points=part)

    turn = np.linspace(0.01, 2.0 * np.pi - 0.01, 120) + np.pi / 2  # begins where it goes behind
    zero, reading, place = np.radians(-38.0), np.radians(22.0), np.radians(122.0)
    down = np.linspace(0.0, 1.0, 60)
    yield svg.element("circle", class_="rim", cx=cx, cy=cy, r=radius)
    yield from curve(np.pi / 2, turn, "band")
    yield from curve(down * np.pi / 2, zero, "grid dark")
    yield from curve(down * place, reading, "tape")
    for where in np.arange(zero, np.radians(80.0), np.radians(20.0)):
        yield _line(seen(np.pi / 2 - 0.03, where)[0], seen(np.pi / 2 + 0.045, where)[0], "tick")
    for polar, azimuth in ((0.0, 0.0), (place, reading)):
        (x, y), _ = seen(polar, azimuth)
        yield svg.element("ellipse", class_="disc", cx=x, cy=y, rx=2.1, ry=2.1 if polar else 1.0)
    for polar, azimuth, text, dx, dy in (
        (0.0, 0.0, "P, disc 1", 3.0, -1.4),
        (np.pi / 2, zero, "0", -1.0, 6.4),
        (np.pi / 2, reading, "reading", -17.5, -2.4),
        (place, reading, "disc", 3.4, 1.4),
        (0.85, reading, "from P", 2.0, 0.0),
        (np.pi / 2, np.radians(66.0), "band", -6.0, -3.6),
    ):
        (x, y), _ = seen(polar, azimuth)
        yield _haloed(x + dx, y + dy, text, "plain")
