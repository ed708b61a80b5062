"""Write the placement guide: one HTML page for a person who puts the discs on the ball with a tape measure.

Lengths on the page are mm along the surface. The tape runs from a pole P over a band of masking tape round the equator
with a scale in mm, so every disc has one place.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spheremouse.calibrate.layout.choose import TRIAL_HIDDEN, TRIAL_SIGMA, Assessment, misplaced, recognition
from spheremouse.calibrate.layout.drawing import drawing, drawn_radius, sketch
from spheremouse.errors import ConfigurationError
from spheremouse.files.report.page import page, rendered
from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.rotation import Array

_SHOWN_ERROR = np.radians(5.0)  # of discs placed by eye


@dataclass(frozen=True, slots=True)
class Place:
    """Place of one disc, in mm along the surface."""

    number: int  # from 1, in the order of work
    band: int | None  # reading of the band under the tape; None at the pole
    from_pole: int
    below_band: int  # negative towards the pole
    checks: tuple[tuple[int, int], ...]  # number of a disc on the ball, and distance to it


def tape_step(radius: float) -> int:
    """Return the step of the tape's readings in mm: 5 on a large ball, 1 on one that a hand can hold."""
    return 5 if radius >= 0.3 else 1


def on_the_tape(directions: Array, radius: float) -> Array:
    """Round directions (n, 3) to whole steps of the tape, from the pole and along the band."""
    step = 1e-3 * tape_step(radius) / radius
    polar = np.rint(np.arccos(np.clip(directions[:, 2], -1.0, 1.0)) / step) * step
    azimuth = np.rint(np.arctan2(directions[:, 1], directions[:, 0]) / step) * step
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)


def places(directions: Array, radius: float) -> list[Place]:
    """Return the lengths to measure for each disc, with checks by the two nearest of the discs before it."""
    step, mm = tape_step(radius), 1e3 * radius
    angle = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))

    def taped(length: float) -> int:
        return int(round(length / step) * step)

    found = []
    for k, (x, y, z) in enumerate(directions):
        polar = float(np.arccos(np.clip(z, -1.0, 1.0)))
        on_axis = np.hypot(x, y) * mm < 0.5 * step
        reading = (
            None if on_axis else taped(float(np.arctan2(y, x)) % (2.0 * np.pi) * mm) % max(taped(2 * np.pi * mm), 1)
        )
        nearest = np.argsort(angle[k, :k], kind="stable")[:2]
        checks = tuple((int(j) + 1, taped(float(angle[k, j]) * mm)) for j in nearest)
        found.append(Place(k + 1, reading, taped(polar * mm), taped((polar - 0.5 * np.pi) * mm), checks))
    return found


def write_guide(
    path: Path, directions: Array, found: Assessment, radius: float, disc_radius: float, view_angle: float, seed: int
) -> None:
    """Write the page, whole or not at all. Radii in m, `view_angle` in rad."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigurationError(f"{path.parent}: cannot be made: {e.strerror or e}") from None
    n, mm = len(directions), 1e3 * radius
    circumference = round(2.0 * np.pi * mm)
    step = tape_step(radius)
    inexact = misplaced(directions, _SHOWN_ERROR, np.random.default_rng(seed))
    guide = rendered(
        "spheremouse.calibrate.layout",
        "guide.html",
        found=found,
        discs=n,
        inexact_mm=f"{_SHOWN_ERROR * mm:.0f}",
        inexact_recognised=100.0 * recognition(inexact, view_angle)[0],
        sketch=sketch(),
        circumference=circumference,
        quarter=round(0.25 * circumference / step) * step,
        mark=500 if radius >= 0.3 else 50,
        step=step,
        to_scale=drawn_radius(radius, disc_radius) == disc_radius,
        drawing=drawing(directions, radius, disc_radius),
        places=places(directions, radius),
        view=f"{np.degrees(view_angle):.0f}",
        distance=f"{found.distance * mm:.0f}",
        sigma=f"{np.degrees(TRIAL_SIGMA):.2g}",
        hidden=f"{100 * TRIAL_HIDDEN:.0f}",
    )
    ball = f"Ball {2 * mm:.0f} mm in diameter ({circumference} mm around) · discs {2e3 * disc_radius:.0f} mm"
    text = page(f"Where to put the {n} discs", f"{ball} · layout of seed {seed}", [guide], paper="A4")
    write_atomically(path, text)
