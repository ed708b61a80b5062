"""The state of the default filter: attitude, rate, acceleration and the map of discs, with one covariance for all.

How errors move it, and how discs enter and leave it. The filter itself is in `so3`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.intersect import SpherePoints
from spheremouse.rotation import Array, exp, hat, tangent_basis

CORE = 9  # rotation error, rate, acceleration: before the discs in the state


@dataclass(frozen=True, slots=True)
class So3State:
    """Attitude, rate and map with their joint covariance."""

    stamp: float  # s
    attitude: Array  # (3, 3) R_obj_ball
    rate: Array  # (3,) rad/s, w_obj
    acceleration: Array  # (3,) rad/s², angular, obj
    discs: Array  # (m, 3) unit vectors, ball
    basis: Array  # (m, 3, 2) tangent vectors of the discs: axes of their errors, ball
    joint: Array  # (9 + 2m, 9 + 2m): rotation error rad (obj), rate rad/s, acceleration rad/s², discs rad
    hits: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # (m,) sightings
    missed: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # (m,) in a row
    used: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # into the last points
    weights: Array = field(default_factory=lambda: np.zeros(0))  # (l,) probability of each level; empty: as usual
    process: Array = field(default_factory=lambda: np.zeros((CORE, CORE)))  # noise of the last prediction, at level 1
    level: float = 1.0  # factor on the density that the last update took, root mean square over the levels
    nis: float = 0.0  # normalised innovation squared of the last update, chi-square with 2 len(used) degrees

    @property
    def covariance(self) -> Array:
        """(6, 6) of rotation error and rate."""
        return self.joint[:6, :6]


def inject(state: So3State, dx: Array) -> So3State:
    """Move the state by an error vector, (9 + 2m,)."""
    attitude = exp(dx[:3]) @ state.attitude
    discs = state.discs + np.einsum("mij,mj->mi", state.basis, dx[CORE:].reshape(-1, 2))
    discs = discs / np.linalg.norm(discs, axis=1, keepdims=True)
    # carry the axes along: their part along the new direction goes, then they are made orthonormal again
    basis = state.basis - discs[:, :, None] * np.einsum("mi,mij->mj", discs, state.basis)[:, None, :]
    first = basis[:, :, 0] / np.linalg.norm(basis[:, :, 0], axis=1, keepdims=True)
    second = np.cross(discs, first)
    second *= np.sign(np.sum(second * basis[:, :, 1], axis=1))[:, None]
    return replace(
        state,
        attitude=attitude,
        rate=state.rate + dx[3:6],
        acceleration=state.acceleration + dx[6:9],
        discs=discs,
        basis=np.stack([first, second], axis=2),
    )


def drop(state: So3State, keep: NDArray[np.bool_]) -> So3State:
    if np.all(keep):
        return state
    rows = np.concatenate([np.ones(CORE, dtype=bool), np.repeat(keep, 2)])
    return replace(
        state,
        discs=state.discs[keep],
        basis=state.basis[keep],
        joint=state.joint[np.ix_(rows, rows)],
        hits=state.hits[keep],
        missed=state.missed[keep],
    )


def augment(state: So3State, points: SpherePoints, index: NDArray[np.intp]) -> So3State:
    """Take up new discs with their covariance and their correlation with the attitude.

    d = R^T b; a rotation error e turns it by R^T (b x e): the inverse observation of EKF-SLAM, which Wittich 2017,
    eq. 171 leaves out.
    """
    b = points.direction[index]
    R = state.attitude
    discs = b @ R
    basis = tangent_basis(discs)
    G = (basis.transpose(0, 2, 1) @ (R.T @ hat(b))).reshape(-1, 3)
    radius2 = np.sum(points.position[index] ** 2, axis=1)[:, None, None]
    E = R @ basis
    noise = E.transpose(0, 2, 1) @ (points.image_covariance[index] / radius2) @ E
    P, k, n = state.joint, len(index), len(state.joint)
    joint = np.zeros((n + 2 * k, n + 2 * k))
    joint[:n, :n] = P
    joint[n:, :n] = G @ P[:3]
    joint[:n, n:] = joint[n:, :n].T
    joint[n:, n:] = G @ P[:3, :3] @ G.T
    for i in range(k):
        at = n + 2 * i
        joint[at : at + 2, at : at + 2] += noise[i]
    none = np.zeros(k, dtype=np.intp)
    return replace(
        state,
        discs=np.concatenate([state.discs, discs]),
        basis=np.concatenate([state.basis, basis]),
        joint=joint,
        hits=np.concatenate([state.hits, none + 1]),
        missed=np.concatenate([state.missed, none]),
    )
