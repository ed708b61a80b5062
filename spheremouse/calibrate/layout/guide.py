"""Write the placement guide: one HTML page for a person who puts the discs on the ball with a tape measure.

Lengths on the page are mm along the surface. Its drawing has both halves of the ball as azimuthal equidistant maps, so
distances from the pole are to scale.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from spheremouse.calibrate.layout.choose import min_in_view, nearest, places, tape_step
from spheremouse.files.report import svg
from spheremouse.files.report.page import page, rendered
from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.rotation import Array

_RIM = 56.0  # mm of paper, radius of a hemisphere
_WIDTH = 180.0  # mm


class Layout(NamedTuple):
    """Places of discs on a ball, and the ball."""

    directions: Array  # (n, 3)
    radius: float  # m, of the ball
    disc_radius: float  # m
    view_angle: float  # rad, within which the camera sees discs
    seed: int


def write_guide(path: Path, layout: Layout) -> None:
    """Write the page, whole or not at all."""
    n, mm, step = len(layout.directions), 1e3 * layout.radius, tape_step(layout.radius)
    circumference = round(2.0 * np.pi * mm)
    distance, (first, second) = nearest(layout.directions)
    guide = rendered(
        "spheremouse.calibrate.layout",
        "guide.html",
        discs=n,
        circumference=circumference,
        quarter=round(0.25 * circumference / step) * step,
        mark=500 if layout.radius >= 0.3 else 50,
        step=step,
        to_scale=_drawn_radius(layout) == layout.disc_radius,
        drawing=svg.drawing(_WIDTH, 4 * _RIM + 18, "both halves", _halves(layout)),
        places=places(layout.directions, layout.radius),
        in_view=min_in_view(layout.directions, layout.view_angle),
        view=f"{np.degrees(layout.view_angle):.0f}",
        nearest=(first + 1, second + 1),
        distance=f"{distance * mm:.0f}",
    )
    ball = f"Ball {2 * mm:.0f} mm in diameter ({circumference} mm around) · discs {2e3 * layout.disc_radius:.0f} mm"
    text = page(f"Where to put the {n} discs", f"{ball} · layout of seed {layout.seed}", guide, paper="A4")
    write_atomically(path, text)


# ---- the drawing ----


def _drawn_radius(layout: Layout) -> float:
    """Drawn radius of discs in m: their own, or that of a pencil's point if it is larger."""
    return max(layout.disc_radius, 0.9 / _RIM * 0.5 * np.pi * layout.radius)


def _halves(layout: Layout) -> Iterator[Markup]:
    directions, mm = layout.directions, 1e3 * layout.radius
    quarter = 0.5 * np.pi * mm
    scale = _RIM / quarter
    top, bottom, cx = 9.0 + _RIM, 9.0 + 3.0 * _RIM, 0.5 * _WIDTH
    step = 250 if layout.radius >= 0.3 else 10 * max(1, round(quarter / 40))  # of rings and spokes
    circumference = 2.0 * np.pi * mm

    def at(upper: bool, r: float, reading: float) -> tuple[float, float]:
        a = reading / mm
        return (cx + r * np.sin(a), (top + r * np.cos(a)) if upper else (bottom - r * np.cos(a)))

    for upper, cy in ((True, top), (False, bottom)):
        for reading in np.arange(0.0, circumference - 0.4 * step, step):
            (x1, y1), (x2, y2) = at(upper, 0.06 * _RIM, reading), at(upper, _RIM, reading)
            yield svg.element("line", class_="grid", x1=x1, y1=y1, x2=x2, y2=y2)
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
    for x in (cx + 6.0, cx - 6.0):
        yield _text(x, 0.5 * (top + bottom) + 1.2, "0", "zero")
    yield _text(6.0, top - _RIM + 6.0, "around P", "half")
    yield _text(6.0, bottom + _RIM - 2.0, "lower half", "half")
    yield _haloed(cx, bottom + 0.9, f"{2 * quarter:.0f}", "scale")
    size = _drawn_radius(layout) * 1e3 * scale
    for k, (x, y, z) in enumerate(directions):
        upper = bool(z >= 0.0)
        polar = np.arccos(np.clip(z, -1.0, 1.0)) * mm
        px, py = at(upper, (polar if upper else 2.0 * quarter - polar) * scale, float(np.arctan2(y, x)) * mm)
        yield svg.element("circle", class_="disc", cx=px, cy=py, r=size)
        text = f"{k + 1} = P" if k == 0 and z > 1.0 - 1e-12 else str(k + 1)
        left = px > cx and np.hypot(px + 6.0 - cx, py - (top if upper else bottom)) > _RIM  # keep the rim visible
        yield _haloed(px - size - 0.8 - 2.9 * len(text) if left else px + size + 0.8, py + 1.5, text, "number")


def _free_spoke(directions: Array, upper: bool, azimuths: Array) -> float:
    """The azimuth, of some, with the most room between the discs of a half."""
    side = directions[(directions[:, 2] >= 0.0) == upper]
    polar = np.linspace(0.15, 0.5, 8) * np.pi
    heights = np.cos(polar) if upper else -np.cos(polar)
    along = np.sin(polar)[:, None] * np.stack([np.cos(azimuths), np.sin(azimuths)])[:, None]
    cosine = [along[0] * x + along[1] * y + (heights * z)[:, None] for x, y, z in side]
    return float(azimuths[np.argmin(np.max(cosine, axis=(0, 1)))]) if cosine else float(azimuths[0])


def _text(x: float, y: float, text: str, style: str) -> Markup:
    return svg.element("text", text, class_=style, x=x, y=y)


def _haloed(x: float, y: float, text: str, style: str) -> Markup:
    """Text with a white edge, legible across lines. It is drawn twice, since printers may ignore `paint-order`."""
    return _text(x, y, text, f"{style} halo") + _text(x, y, text, style)
