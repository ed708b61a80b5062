"""The map of a ball: directions of its discs in `ball` with their joint covariance, as a tracker has built it.

The map lasts longer than a run. It is kept beside the rig, and makes the next run's attitude absolute from its first
frame. Two maps are compared: whether they show the same ball, and which discs stayed, moved, are gone or new.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import identify
from spheremouse.ball.detect.projection import GREY, Projection
from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import Array, align, tangent_basis

# rad: a disc nearer to its old place has stayed (3 mm on the ball); farther, it has not
_MIN_STAY_RADIUS_RAD, _MAX_STAY_RADIUS_RAD = (0.005, 0.05)
# rad: a disc gone here and one new there, nearer than 12 cm on the ball, is one that was moved
_MAX_DISC_MOVE_RAD = 0.2
_MAX_RISK = 1e-3  # of taking another ball for the same one
_ANY_AXIS = np.array([0.36, 0.48, 0.8])
_ALL_AROUND = -0.9999  # cosine of the horizon: a map shows all sides of a ball


@dataclass(frozen=True, slots=True)
class DiscMap:
    """Discs known on a ball."""

    directions: Array  # (m, 3) unit vectors, ball
    covariance: Array  # (2m, 2m) rad², of errors along rotation.tangent_basis(directions)
    sightings: NDArray[np.intp]  # (m,) frames in which each was seen
    projection: Projection = GREY  # of colours, in which the discs are darker than the ball
    eccentricity: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, ball, from the pivot to the centre
    eccentricity_sigma: float = 0.0  # m, its largest standard deviation; 0: the frames show no eccentricity

    kind: ClassVar[str] = "discs"
    alteration: ClassVar[str] = "its discs were moved"

    def __len__(self) -> int:
        return len(self.directions)

    @property
    def amount(self) -> float:
        """Number of discs, for a comparison with other maps."""
        return len(self)

    @property
    def text(self) -> str:
        """The contents in words."""
        return f"{len(self)} discs"

    @property
    def is_finite(self) -> bool:
        """Return whether the discs' covariance is known."""
        return bool(np.all(np.isfinite(self.covariance)))

    def compare(self, other: "DiscMap") -> "Comparison | None":
        """Compare with another map in any frame. Return None if they show no sign of the same ball."""
        sigma = float(np.clip(np.sqrt(np.median(variances(self)) + np.median(variances(other))), 0.001, 0.02))
        found = identify(
            other.directions, self.directions, sigma=sigma, view_axis=_ANY_AXIS, horizon=_ALL_AROUND, risk=_MAX_RISK
        )
        if found is None:
            return None
        comparison = self.compare_at(other, found.rotation)
        if len(comparison.stayed) >= 3:
            i, j = comparison.stayed.T
            weights = 1.0 / (variances(self)[i] + variances(other)[j] + 1e-12)
            comparison = self.compare_at(other, align(self.directions[i], other.directions[j], weights))
        return comparison if comparison.same_ball else None

    def compare_at(self, other: "DiscMap", rotation: Array) -> "Comparison":
        """Compare with another map, whose directions are about those of this one @ rotation.T, (3, 3)."""
        cosine = other.directions @ rotation @ self.directions.T
        angle = np.arccos(np.clip(cosine, -1.0, 1.0)).T
        near = np.clip(
            5.0 * np.sqrt(variances(self)[:, None] + variances(other)[None]), _MIN_STAY_RADIUS_RAD, _MAX_STAY_RADIUS_RAD
        )
        stayed = np.stack(assign(angle / near, 1.0), axis=1)
        left_a = np.setdiff1d(np.arange(len(self)), stayed[:, 0])
        left_b = np.setdiff1d(np.arange(len(other)), stayed[:, 1])
        i, j = assign(angle[np.ix_(left_a, left_b)], _MAX_DISC_MOVE_RAD)
        return Comparison(
            rotation,
            stayed,
            np.stack([left_a[i], left_b[j]], axis=1),
            np.delete(left_a, i),
            np.delete(left_b, j),
        )

    def improves(self, saved: "DiscMap") -> bool:
        """Return whether this map has other discs than a saved one, one with less than half its deviation, or a centre.

        The centre's place must be new, or known with less than half its deviation.
        """
        now, then = self.eccentricity_sigma, saved.eccentricity_sigma
        if now > 0.0 and not 2.0 * now >= then > 0.0:
            return True
        comparison = saved.compare_at(self, np.eye(3))
        i, j = comparison.stayed.T
        better = variances(self)[j] < 0.25 * variances(saved)[i]
        return len(i) < len(saved) or len(j) < len(self) or bool(np.any(better))

    def with_centre(self, place: Array, covariance: Array) -> "DiscMap":
        """Return the map with the centre at `place`, (3,) m in ball from the pivot, and its covariance, (3, 3) m²."""
        return replace(self, eccentricity=place, eccentricity_sigma=float(np.linalg.eigvalsh(covariance)[-1]) ** 0.5)

    def turned(self, rotation: Array) -> "DiscMap":
        """Return the map with its vectors d replaced by rotation @ d, and the covariance in the tangent bases there.

        `rotation` is (3, 3).
        """
        directions, m = self.directions @ rotation.T, len(self)
        basis_change = np.swapaxes(tangent_basis(directions), 1, 2) @ rotation @ tangent_basis(self.directions)
        blocks = self.covariance.reshape(m, 2, m, 2)
        covariance = np.einsum("iab,ibjc,jdc->iajd", basis_change, blocks, basis_change).reshape(2 * m, 2 * m)
        return replace(self, directions=directions, covariance=covariance, eccentricity=rotation @ self.eccentricity)


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

    @property
    def text(self) -> str:
        """`24 discs stayed, 1 moved, 1 gone, 2 new`, without empty parts."""
        parts = [f"{len(self.stayed)} discs stayed"]
        for name in ("moved", "gone", "new"):
            if count := len(getattr(self, name)):
                parts.append(f"{count} {name}")
        return ", ".join(parts)


def variances(disc_map: DiscMap) -> Array:
    """Return the variance of each disc's direction, (m,) rad², the mean over its two axes."""
    return np.diag(disc_map.covariance).reshape(-1, 2).mean(axis=1)
