"""A page to print for whoever puts the discs on the ball with a tape measure: directions in, one HTML file out.

Lengths on the page are mm along the surface. A pole mark P, a band of masking tape round the equator with its own mm
scale, and a tape pulled from P over the band: every disc has one place, and no two arcs to be crossed.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spheremouse.calibrate.layout.drawing import drawing, drawn_radius, sketch
from spheremouse.calibrate.layout.search import CLEAR, ENOUGH, Judgement, Trials, alike
from spheremouse.errors import ConfigurationError
from spheremouse.files.atomic import write_atomically
from spheremouse.files.report.page import page, rendered
from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Place:
    """Place of one disc; all but numbers in mm along the surface."""

    number: int  # from 1, in the order of work
    band: int | None  # reading of the band that the tape runs over; None at the pole
    from_pole: int
    below_band: int  # negative above it, towards the pole
    checks: tuple[tuple[int, int], ...]  # number of a disc already there, and distance to it


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Effect of inaccurate placement on a layout: the worst of some random misplacements."""

    sd_mm: float  # mm to either side
    separability: float  # contradictions
    in_view: int  # discs


@dataclass(frozen=True, slots=True)
class Design:
    """A layout as it is on the tape, and what it is worth."""

    directions: Array  # (n, 3) unit vectors, ball: z to the pole mark, x to the band's zero
    radius: float  # m, of the ball
    disc_radius: float  # m, along the surface
    view_angle: float  # rad
    seed: int
    judgement: Judgement
    trials: Trials
    trial_sigma: float  # rad
    trial_missing: float
    accuracy: tuple[Accuracy, ...]
    tries: int  # misplaced layouts for each line of `accuracy`

    @property
    def bears_mm(self) -> float:
        """The largest standard deviation tried up to which every misplaced layout was clear; 0 for none."""
        bears = 0.0
        for a in self.accuracy:
            if a.separability < CLEAR or a.in_view < min(ENOUGH, self.judgement.in_view):
                break
            bears = a.sd_mm
        return bears


def tape_step(radius: float) -> int:
    """mm to which a tape is read: 5 on a large ball, 1 on one that a hand can hold."""
    return 5 if radius >= 0.3 else 1


def on_the_tape(directions: Array, radius: float) -> Array:
    """Directions, (n, 3), at the whole steps of the tape nearest to those given: from the pole, and along the band."""
    step = 1e-3 * tape_step(radius) / radius
    polar = np.rint(np.arccos(np.clip(directions[:, 2], -1.0, 1.0)) / step) * step
    azimuth = np.rint(np.arctan2(directions[:, 1], directions[:, 0]) / step) * step
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)


def places(directions: Array, radius: float) -> list[Place]:
    """Lengths to measure for each disc, in the order of `directions`; each is checked by the two nearest before it."""
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


def write_guide(path: Path, design: Design) -> None:
    """Write the page; whole or not at all."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigurationError(f"{path.parent}: cannot be made: {e.strerror or e}") from None
    write_atomically(path, guide_text(design))


def guide_text(design: Design) -> str:
    """The page as HTML: steps, drawing, table. It needs no other file."""
    n, mm = len(design.directions), 1e3 * design.radius
    circumference = round(2.0 * np.pi * mm)
    step = tape_step(design.radius)
    guide = rendered(
        "spheremouse.calibrate.layout",
        "guide.html",
        design=design,
        discs=n,
        careless=_careless(design),
        sketch=sketch(),
        circumference=circumference,
        quarter=round(0.25 * circumference / step) * step,
        mark=500 if design.radius >= 0.3 else 50,
        step=step,
        to_scale=drawn_radius(design.radius, design.disc_radius) == design.disc_radius,
        drawing=drawing(design.directions, design.radius, design.disc_radius),
        places=places(design.directions, design.radius),
        short=_short,
        view=f"{np.degrees(design.view_angle):.0f}",
        apart=f"{design.judgement.apart * mm:.0f}",
        usual=np.median(design.judgement.contradictions),
        alike=f"{alike(n) * mm:.0f}",
        sigma=f"{np.degrees(design.trial_sigma):.2g}",
    )
    ball = f"Ball {2 * mm:.0f} mm in diameter ({circumference} mm around) · discs {2e3 * design.disc_radius:.0f} mm"
    return page(f"Where to put the {n} discs", f"{ball} · layout of seed {design.seed}", [guide], paper="A4")


def _careless(design: Design) -> str:
    """What inaccurate placement does to this layout, in a sentence."""
    bears = design.bears_mm
    if bears == 0.0:
        tried = f"{len(design.accuracy)} degrees of carelessness"
        return f"Of {tried} that were tried, none kept all views apart: more discs would."
    least = min(a.separability for a in design.accuracy if a.sd_mm <= bears)
    most = ", the most that was tried" if bears == design.accuracy[-1].sd_mm else ""
    return (
        f"Even where every disc was off by {_short(bears)} mm at random (standard deviation to either side{most}), "
        f"at least {least:.1f} discs told any view from all others."
    )


def _short(mm: float) -> str:
    """A length in whole mm, or in tenths where it is short."""
    return f"{mm:.0f}" if mm >= 10.0 else f"{mm:.1f}"
