"""The landmarks of the default filter's state: how discs and candidates enter and leave it."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.filters.so3_motion import CLONE_DIM
from spheremouse.ball.filters.so3_settings import FALSE_SHARE, HIDDEN_SHARE
from spheremouse.ball.filters.so3_state import ECCENTRICITY, So3State
from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.matching import are_among
from spheremouse.geometry.rotation import tangent_basis
from spheremouse.native import kernels

_MAX_SAVED_HITS = 60  # largest count of sightings that a saved disc starts with: it stays for 300 misses in a row
_NONE = np.zeros(0, dtype=np.intp)


def augment(state: So3State, points: SpherePoints, index: NDArray[np.intp], radius: float) -> So3State:
    """Take up the points `index`, (k,), on a ball of `radius` m as discs, with covariance and correlations."""
    if len(index) == 0:
        return state
    state = with_candidates(state, points, index, np.full(len(index), -1), radius)
    return promote(state, np.flatnonzero(state.candidates < 0))


def with_candidates(
    state: So3State, points: SpherePoints, index: NDArray[np.intp], numbers: NDArray[np.intp], radius: float
) -> So3State:
    """Take up the points `index`, (k,), on a ball of `radius` m as candidates; `numbers` (k,) are of look-alikes."""
    if len(index) == 0:
        return state
    centre_moves = bool(state.centre_noise > 0.0)
    places, basis, joint = kernels.take_up(state.body, points.measurement(radius), index, centre_moves)
    return state._replace(
        landmarks=np.concatenate([state.landmarks, places]),
        basis=np.concatenate([state.basis, basis]),
        joint=joint,
        candidates=np.concatenate([state.candidates, numbers]),
    )


def with_map(state: So3State, known: DiscMap, most: int = _MAX_SAVED_HITS) -> So3State:
    """Return the state with a saved map's discs and eccentricity. `most` limits the counts of sightings."""
    m, first = len(known), state.map_row
    joint = np.zeros((first + 2 * m + CLONE_DIM, first + 2 * m + CLONE_DIM))
    joint[:first, :first] = state.joint[:first, :first]
    joint[first:-CLONE_DIM, first:-CLONE_DIM] = known.covariance
    if known.eccentricity_sigma > 0.0:
        joint[ECCENTRICITY] = joint[:, ECCENTRICITY] = 0.0
        joint[ECCENTRICITY, ECCENTRICITY] = known.eccentricity_sigma**2 * np.eye(3)
    return state._replace(
        landmarks=known.directions.copy(),
        basis=tangent_basis(known.directions),
        joint=joint,
        eccentricity=known.eccentricity,
        hits=np.minimum(known.sightings, most),
        missed=np.zeros(m, dtype=np.intp),
        hidden=np.full(m, HIDDEN_SHARE),
        candidates=_NONE,
        others=tuple(other._replace(hidden=np.full(m, HIDDEN_SHARE)) for other in state.others),
    )


def to_map(state: So3State, least: int) -> DiscMap | None:
    """Return the discs with `least` sightings or more, and a significant eccentricity; None with fewer than four discs.

    The axes are by `tangent_basis`.
    """
    keep = state.hits >= least
    if np.count_nonzero(keep) < 4:
        return None
    kept = drop(without_candidates(state), keep)
    basis = tangent_basis(kept.discs)
    T = basis.transpose(0, 2, 1) @ kept.basis
    m = len(kept.discs)
    P = kept.joint[kept.map_row : -CLONE_DIM, kept.map_row : -CLONE_DIM].reshape(m, 2, m, 2)
    P = np.einsum("iab,ibjc,jdc->iajd", T, P, T).reshape(2 * m, 2 * m)
    found = DiscMap(kept.discs, 0.5 * (P + P.T), kept.hits)
    if not state.is_off_centre:
        return found
    return found.with_centre(state.eccentricity, state.joint[ECCENTRICITY, ECCENTRICITY])


def drop(state: So3State, keep: NDArray[np.bool_]) -> So3State:
    """Forget the discs that are not in a mask, (m,)."""
    if all(keep.tolist()):
        return state
    state = _with_landmarks(state, np.flatnonzero(np.concatenate([keep, np.ones(len(state.candidates), dtype=bool)])))
    others = tuple(other._replace(hidden=other.hidden[keep]) for other in state.others)
    return state._replace(hits=state.hits[keep], missed=state.missed[keep], hidden=state.hidden[keep], others=others)


def keep_candidates(state: So3State, numbers: NDArray[np.intp]) -> So3State:
    """Forget the candidates without one of the `numbers`, (k,)."""
    keep = are_among(state.candidates, numbers)
    if keep.all():
        return state
    m = len(state.discs)
    return _with_landmarks(state, np.r_[:m, m + np.flatnonzero(keep)])._replace(candidates=state.candidates[keep])


def without_candidates(state: So3State) -> So3State:
    """Forget all candidates."""
    return keep_candidates(state, _NONE)


def promote(state: So3State, which: NDArray[np.intp]) -> So3State:
    """Make discs of the candidates `which`, (k,) indices; they become the last discs, in that order."""
    m, rest = len(state.discs), np.delete(np.arange(len(state.candidates)), which)
    state = _with_landmarks(state, np.r_[:m, m + which, m + rest])._replace(candidates=state.candidates[rest])
    return _counted_once(state, len(which))


def _with_landmarks(state: So3State, which: NDArray[np.intp]) -> So3State:
    """Return the state with the landmarks `which`, (k,) indices, in that order."""
    first = state.map_row
    errors = first + (2 * which[:, None] + np.arange(2)).ravel()
    rows = np.concatenate([np.arange(first), errors, len(state.joint) - CLONE_DIM + np.arange(CLONE_DIM)])
    return state._replace(
        landmarks=state.landmarks[which], basis=state.basis[which], joint=state.joint[np.ix_(rows, rows)]
    )


def _counted_once(state: So3State, k: int) -> So3State:
    """Return the state with k discs after the counted ones, each seen once."""
    none, hidden = np.zeros(k, dtype=np.intp), np.full(k, HIDDEN_SHARE)
    return state._replace(
        others=tuple(o._replace(hidden=np.concatenate([o.hidden, hidden])) for o in state.others),
        hits=np.concatenate([state.hits, none + 1]),
        missed=np.concatenate([state.missed, none]),
        hidden=np.concatenate([state.hidden, np.full(k, FALSE_SHARE)]),
    )
