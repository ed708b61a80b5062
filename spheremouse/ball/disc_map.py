"""The map of a ball: directions of its discs in `ball` with their joint covariance, as a tracker has built it.

The map lasts longer than a run. It is kept beside the rig, and makes the next run's attitude absolute from its first
frame. Two maps are compared: whether they show the same ball, and which discs stayed, moved, are gone or new.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import identify
from spheremouse.ball.detect.projection import GREY, Projection
from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import Array, align, tangent_basis

_LEAST, _MOST = 0.005, 0.05  # rad: a disc nearer to its old place has stayed (3 mm on the ball); farther, it has not
_REACH = 0.2  # rad: a disc gone here and one new there, nearer than 12 cm on the ball, is one that was moved
_RISK = 1e-3  # of taking another ball for the same one
_ANY_AXIS = np.array([0.36, 0.48, 0.8])
_ALL_AROUND = -0.9999  # cosine of the horizon: a map shows all sides of a ball


@dataclass(frozen=True, slots=True)
class DiscMap:
    """Discs known on a ball."""

    directions: Array  # (m, 3) unit vectors, ball
    covariance: Array  # (2m, 2m) rad², of errors along rotation.tangent_basis(directions)
    sightings: NDArray[np.intp]  # (m,) frames in which each was seen
    projection: Projection = GREY  # of colours, in which the discs are darker than the ball

    def __len__(self) -> int:
        return len(self.directions)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of the discs of map `a` with map `b`."""

    rotation: Array  # (3, 3), directions of b ~ those of a @ rotation.T
    stayed: NDArray[np.intp]  # (k, 2) indices (a, b)
    moved: NDArray[np.intp]  # (l, 2) indices (a, b)
    gone: NDArray[np.intp]  # (p,) indices of a
    new: NDArray[np.intp]  # (q,) indices of b

    @property
    def same_ball(self) -> bool:
        """True if three discs and half of those of the smaller map stayed, since a few always fit by chance."""
        k = len(self.stayed)
        return k >= 3 and 2 * k >= min(k + len(self.moved) + len(self.gone), k + len(self.moved) + len(self.new))


def compare(a: DiscMap, b: DiscMap) -> Comparison | None:
    """Compare two maps in any frames. Return None if they show no sign of the same ball."""
    sigma = float(np.clip(np.sqrt(np.median(variances(a)) + np.median(variances(b))), 0.001, 0.02))
    found = identify(b.directions, a.directions, sigma=sigma, view_axis=_ANY_AXIS, horizon=_ALL_AROUND, risk=_RISK)
    if found is None:
        return None
    comparison = compare_at(a, b, found.rotation)
    if len(comparison.stayed) >= 3:
        i, j = comparison.stayed.T
        weights = 1.0 / (variances(a)[i] + variances(b)[j] + 1e-12)
        comparison = compare_at(a, b, align(a.directions[i], b.directions[j], weights))
    return comparison if comparison.same_ball else None


def compare_at(a: DiscMap, b: DiscMap, rotation: Array) -> Comparison:
    """Compare two maps. `rotation`, (3, 3), turns `a`: directions of `b` are about those of `a` @ rotation.T."""
    cosine = b.directions @ rotation @ a.directions.T
    apart = np.arccos(np.clip(cosine, -1.0, 1.0)).T
    near = np.clip(5.0 * np.sqrt(variances(a)[:, None] + variances(b)[None]), _LEAST, _MOST)
    stayed = np.stack(assign(apart / near, 1.0), axis=1)
    left_a = np.setdiff1d(np.arange(len(a)), stayed[:, 0])
    left_b = np.setdiff1d(np.arange(len(b)), stayed[:, 1])
    i, j = assign(apart[np.ix_(left_a, left_b)], _REACH)
    return Comparison(
        rotation,
        stayed,
        np.stack([left_a[i], left_b[j]], axis=1),
        np.delete(left_a, i),
        np.delete(left_b, j),
    )


def variances(disc_map: DiscMap) -> Array:
    """Variance of each disc's direction, (m,) rad², the mean over its two axes."""
    return np.diag(disc_map.covariance).reshape(-1, 2).mean(axis=1)


def turned(disc_map: DiscMap, rotation: Array) -> DiscMap:
    """Return the map in a frame rotated by (3, 3): the new directions are the old ones @ rotation.T."""
    before = disc_map.directions
    after = before @ rotation.T
    axes = tangent_basis(after).transpose(0, 2, 1) @ rotation @ tangent_basis(before)  # (m, 2, 2)
    m = len(disc_map)
    blocks = disc_map.covariance.reshape(m, 2, m, 2)
    covariance = np.einsum("iab,ibjc,jdc->iajd", axes, blocks, axes).reshape(2 * m, 2 * m)
    return replace(disc_map, directions=after, covariance=covariance)


def in_words(comparison: Comparison) -> str:
    """`24 discs stayed, 1 moved, 1 gone, 2 new`, without empty parts."""
    parts = [f"{len(comparison.stayed)} discs stayed"]
    for name in ("moved", "gone", "new"):
        if count := len(getattr(comparison, name)):
            parts.append(f"{count} {name}")
    return ", ".join(parts)
