"""Places in an image that resemble a ring target, each with the bound that it exceeds.

The search widens one bound after the other and repeats the detection. If a shape appears only with a wider bound, that
bound has rejected it. The search is slow, so use it for single images that a person examines, not for every frame.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import permutations

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.rings import (
    MAX_COPIES,
    RingSettings,
    Spots,
    TargetDetections,
    candidates_of,
    concentric_pairs,
    detect_targets,
    spots_of,
)
from spheremouse.ball.rig import COLOURS
from spheremouse.geometry.rotation import Array

_MIN_INNER_RADIUS_PX = 0.5  # px, least radius of an inner disc: smaller ones are less than a pixel wide
_MIN_PURE_RADIUS_PX = 2.0  # px, radius of an inner disc below which few of its pixels have its colour alone
_MAX_PROPORTION_ERROR = 3.0  # by which proportions may be wrong: a ring would be as wide as all of the target
_MAX_HUE_DIFFERENCE = 12  # of OpenCV's 180: neighbours are 60 apart
_MAX_PALE_VALUE = 25  # saturation and value below which a colour is the noise of grey


class Bound(StrEnum):
    """The bound of a target that a shape violates; the first one if it violates several."""

    EDGES = "edges"  # the rings lie in one another, and their edges cannot be measured
    SIZE = "size"  # RingSettings.min_radius
    CENTRE = "centre"  # RingSettings.concentric
    RATIO = "ratio"  # RingSettings.ratio
    LIGHT = "light"  # rings.saturation, rings.value
    HUE = "hue"  # rings.cyan, rings.magenta, rings.yellow
    COLOURS = "colours"  # two of the three lie in one another


@dataclass(frozen=True, slots=True)
class Refused:
    """A shape that resembles a target."""

    code: str  # its colours inside to outside: two or three
    centre: Array  # (2,) px
    radius: float  # px
    bound: Bound


def refused_targets(image: Image, radii: Array, settings: RingSettings, seen: TargetDetections) -> tuple[Refused, ...]:
    """Return the near misses in a BGR image, (h, w, 3), in which `seen` are the targets; each one once.

    `radii` (3,) are the rig's circles, in any unit. Takes ten times as long as `detect_targets`.
    """
    proportion = np.asarray(radii, dtype=float) / radii[-1]
    spots = spots_of(image, settings)
    found = _Places(seen)
    for bound, wider in (
        (Bound.EDGES, settings),
        (Bound.CENTRE, replace(settings, concentric=1.0)),
        (Bound.RATIO, replace(settings, ratio=max(settings.ratio, _MAX_PROPORTION_ERROR))),
    ):
        nests = candidates_of(spots, proportion, wider, image.shape)[0]
        for nest in sorted(nests, key=lambda nest: -nest.area):  # rings within one are not another
            found.add(nest.code, nest.middle, float(np.sqrt(nest.half.prod())), bound)
    for bound, wider in _relaxed_rules(settings):
        more = detect_targets(image, radii, wider)
        for code, centre, radius in zip(more.codes, more.centre, more.radius, strict=True):
            found.add(
                code, centre, float(radius), Bound.SIZE if radius * proportion[0] < _MIN_PURE_RADIUS_PX else bound
            )
    for code, centre, radius in _pairs(spots, proportion, settings):
        found.add(code, centre, radius, Bound.COLOURS)
    return tuple(found.refused)


class _Places:
    """Near misses that do not overlap each other or a target."""

    def __init__(self, seen: TargetDetections) -> None:
        self.refused: list[Refused] = []
        self._taken = list(zip(seen.centre, seen.radius, strict=True))

    def add(self, code: str, centre: Array, radius: float, bound: Bound) -> None:
        """Add a near miss, unless it overlaps a target or an earlier one."""
        if all(np.linalg.norm(centre - other) > max(radius, r) for other, r in self._taken):
            self._taken.append((centre, radius))
            self.refused.append(Refused(code, centre, radius, bound))


def _relaxed_rules(s: RingSettings) -> tuple[tuple[Bound, RingSettings], ...]:
    """Return the rules to relax, one at a time: each bound with the settings in which it alone is wider."""
    hues = {"cyan": s.cyan, "magenta": s.magenta, "yellow": s.yellow}
    hues = {
        name: (max(low - _MAX_HUE_DIFFERENCE, 0), min(high + _MAX_HUE_DIFFERENCE, 180))
        for name, (low, high) in hues.items()
    }
    pale = replace(
        s, saturation=(min(s.saturation[0], _MAX_PALE_VALUE), 255), value=(min(s.value[0], _MAX_PALE_VALUE), 255)
    )
    return (
        (Bound.SIZE, replace(s, min_radius=min(s.min_radius, _MIN_INNER_RADIUS_PX))),
        (Bound.LIGHT, pale),
        (Bound.HUE, replace(s, **hues)),
    )


def _pairs(spots: dict[str, Spots], proportion: Array, settings: RingSettings) -> list[tuple[str, Array, float]]:
    """Return nested pairs of colours with the proportions of a target: colours, centre, radius, px; largest first."""
    found: list[tuple[str, Array, float]] = []
    least = settings.min_radius / proportion[0]
    for inner, outer in permutations(COLOURS, 2):
        large = np.flatnonzero(spots[outer].radius >= least)
        for share in (proportion[1], proportion[0] / proportion[1], proportion[0]):
            _, around = concentric_pairs(spots[inner], spots[outer], large, float(share), settings)
            found += [(inner + outer, spots[outer].centre[k], float(spots[outer].radius[k])) for k in np.unique(around)]
    return sorted(found, key=lambda pair: -pair[2])[: 3 * MAX_COPIES]
