"""Assignment of detections to true discs, and centre errors by size."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import HIDDEN, VISIBLE, DiscTruth
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import Array

# px. A detection this near to a disc's centre is that disc: centres are good to a tenth of a pixel, or to one where a
# strut cuts the disc, while the next thing dark is at least a disc's radius away (7 px, thesis' cameras).
MATCH = 3.0
_FINEST = 1e-4  # px: no picture shows a centre better, and a noise of 0 has no information matrix
_LEAST = 20  # centres of a size class: their RMS is good to a tenth where errors are independent


@dataclass(frozen=True, slots=True)
class Sight:
    """Discs measured in a frame."""

    disc: NDArray[np.intp]  # (k,) index of the disc
    sigma: Array  # (k,) px, standard deviation of its centre per axis


def semi_minor_axes(centre: Array, rig: Rig, pose: Pose) -> Array:
    """Semi-minor axes, (n,) px, of the images of discs whose centres project to pixels (n, 2).

    nan for a disc that the limb cuts, and for a pixel beside the ball.
    """
    axes = np.full(len(centre), np.nan)
    directions, index = directions_at(centre, rig, pose)
    seen = appearance(directions, rig, pose)
    axes[index[seen.whole]] = np.sqrt(np.linalg.eigvalsh(seen.shape[seen.whole])[:, 0])
    return axes


def distances(a: Array, b: Array) -> Array:
    """px, (n, m), between points (n, 2) and (m, 2)."""
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def measured(frames: Iterable[int], detected: Iterable[Array], truth: DiscTruth) -> list[Sight]:
    """Detections of the true discs in each frame, with the noise that such centres have in these frames.

    `detected` (k, 2) px by frame. The noise of a class is the RMS of its errors, systematic ones included: classes are
    whole discs by octaves of their area, and those that something cuts.
    """
    rows: list[DiscTruth] = []
    errors = [np.zeros((0, 2))]
    for frame, points in zip(frames, detected, strict=True):
        discs = truth.of_frame(frame)
        shown = np.flatnonzero((discs.state != HIDDEN) & np.isfinite(discs.centre).all(axis=1))
        i, j = assign(distances(discs.centre[shown], points), MATCH)
        found = shown[i]
        rows.append(DiscTruth(*(getattr(discs, name)[found] for name in DiscTruth.__slots__)))
        errors.append(points[j] - discs.centre[found])
    area = np.concatenate([np.where(r.state == VISIBLE, r.area, np.nan) for r in rows]) if rows else np.zeros(0)
    sigma = _by_class(area, np.mean(np.concatenate(errors) ** 2, axis=1))
    ends = np.cumsum([0, *(len(r) for r in rows)])
    return [Sight(r.disc, sigma[a:b]) for r, a, b in zip(rows, ends[:-1], ends[1:], strict=True)]


def _by_class(area: Array, square: Array) -> Array:
    """Root of the mean of `square` over centres of the same class; areas (n,) px², nan: something cuts them.

    An octave with too few goes with the next larger one, the largest with the next smaller. What is cut is a class of
    its own; where too few are, they are no better than the worst of the others.
    """
    whole = np.isfinite(area)
    octave = np.floor(np.log2(np.maximum(np.where(whole, area, 1.0), 1.0)))
    groups: list[NDArray[np.bool_]] = []
    few = np.zeros(len(area), dtype=bool)
    for value in np.unique(octave[whole]):
        few |= whole & (octave == value)
        if np.count_nonzero(few) >= _LEAST:
            groups.append(few)
            few = np.zeros(len(area), dtype=bool)
    if few.any():
        groups = [*groups[:-1], groups[-1] | few] if groups else [few]
    sigma = np.zeros(len(area))
    for group in groups:
        sigma[group] = _rms(square[group])
    cut = ~whole
    if cut.any():
        worst = float(sigma.max(initial=0.0))
        sigma[cut] = _rms(square[cut]) if np.count_nonzero(cut) >= _LEAST else max(worst, _rms(square[cut]))
    return sigma


def _rms(square: Array) -> float:
    return max(float(np.sqrt(np.mean(square))), _FINEST)
