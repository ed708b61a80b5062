"""Write the placement guide: one HTML page for a person who puts the discs on the ball with a tape measure.

Lengths on the page are mm along the surface. Its drawing has both halves of the ball as azimuthal equidistant maps, so
distances from the pole are to scale.
"""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from spheremouse.calibrate.layout.choose import min_in_view, nearest, places, tape_step
from spheremouse.files.report.page import page, render
from spheremouse.files.report.style import styled
from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEMISPHERE_RADIUS_MM = 56.0  # mm of paper, radius of a hemisphere
_DRAWING_WIDTH_MM = 180.0  # mm
_POINTS_PER_MM = 72.0 / 25.4


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
    with styled({"axes.edgecolor": "black", "grid.color": "#999999", "grid.linewidth": 0.4}):
        drawing = _halves(layout)
    guide = render(
        "spheremouse.calibrate.layout",
        "guide.html",
        discs=n,
        circumference=circumference,
        quarter=round(0.25 * circumference / step) * step,
        mark=500 if layout.radius >= 0.3 else 50,
        step=step,
        to_scale=_drawn_radius(layout) == layout.disc_radius,
        drawing=drawing,
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
    return max(layout.disc_radius, 0.9 / _HEMISPHERE_RADIUS_MM * 0.5 * np.pi * layout.radius)


def _halves(layout: Layout) -> "Figure":
    """The half around P above, the lower half below; they touch at the band's 0."""
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

    mm = 1e3 * layout.radius
    quarter = 0.5 * np.pi * mm
    step = 250 if layout.radius >= 0.3 else 10 * max(1, round(quarter / 40))  # of rings and spokes
    spokes = np.arange(0.0, 2.0 * np.pi * mm - 0.4 * step, step)
    names = [f"{r:.0f}" for r in spokes]
    lower_names = [name if np.cos(r / mm) < 0.85 else "" for r, name in zip(spokes, names, strict=True)]
    rings = np.arange(step, 2.0 * quarter, step)
    diameter = 2e3 * _drawn_radius(layout) * _HEMISPHERE_RADIUS_MM / quarter * _POINTS_PER_MM
    x, y, z = layout.directions.T
    azimuth, polar = np.arctan2(y, x), np.arccos(np.clip(z, -1.0, 1.0)) * mm
    width, height = _DRAWING_WIDTH_MM, 4.0 * _HEMISPHERE_RADIUS_MM + 26.0
    figure = Figure(figsize=(width / 25.4, height / 25.4))
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.2}  # legible across lines
    for upper in (True, False):
        low = 13.0 + 2.0 * _HEMISPHERE_RADIUS_MM if upper else 13.0
        place = (
            0.5 - _HEMISPHERE_RADIUS_MM / width,
            low / height,
            2.0 * _HEMISPHERE_RADIUS_MM / width,
            2.0 * _HEMISPHERE_RADIUS_MM / height,
        )
        axes = PolarAxes(figure, place, theta_offset=-0.5 * np.pi if upper else 0.5 * np.pi)
        figure.add_axes(axes)
        axes.set_theta_direction(1 if upper else -1)
        axes.set_thetagrids(np.degrees(spokes / mm), names if upper else lower_names, fontsize=7.0)
        in_half = (z >= 0.0) == upper
        shown = rings[(rings < quarter) == upper]
        free = _free_azimuth(azimuth[in_half], np.arange(0.5 * step, 2.0 * np.pi * mm, step) / mm)
        radii = shown if upper else 2.0 * quarter - shown
        axes.set_rgrids(radii, [f"{r:.0f}" for r in shown], angle=np.degrees(free), fontsize=7.0, bbox=box)
        distance = polar[in_half] if upper else 2.0 * quarter - polar[in_half]
        axes.plot(azimuth[in_half], distance, "o", color="black", ms=diameter, mew=0.0)
        axes.set_rmax(quarter)
        for k, a, r in zip(np.flatnonzero(in_half), azimuth[in_half], distance, strict=True):
            look = {"fontsize": 11, "fontweight": "bold", "bbox": box, "textcoords": "offset points"}
            name = f"{k + 1} = P" if polar[k] == 0.0 else str(k + 1)
            axes.annotate(name, (float(a), float(r)), (0.5 * diameter + 2.0, -4.0), **look)
    for text, at in (("around P", height - 12.0), ("lower half", 12.0)):
        figure.text(0.03, at / height, text, fontsize=11)
    return figure


def _free_azimuth(discs: Array, azimuths: Array) -> float:
    """The azimuth, of some, farthest from those of all discs, rad."""
    gap = np.abs((azimuths[:, None] - discs + np.pi) % (2.0 * np.pi) - np.pi)
    return float(azimuths[np.argmax(gap.min(axis=1, initial=np.pi))])
