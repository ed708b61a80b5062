"""Separation of discs from static distractors: spots that do not move while the ball turns.

Bolts, their shadows and a player's buttons pass every test of shape. The tracker follows each candidate from its first
place, and compares it with the place to which the ball's rotation would have carried a disc. A spot that moved with the
ball can become a disc. A spot that stayed becomes a mask in the image until the camera moves.
This needs the right attitude, so use one that the frame itself confirms, never a prediction. If a hand had stopped the
ball meanwhile, a prediction would mask the discs themselves.
"""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.matching import are_among, distances, mutual_nearest
from spheremouse.geometry.rotation import Array

MOVED_PX = 2.0  # displacement by the ball's rotation that shows a static candidate: many times a centre's noise
TURNED_PART = 0.3  # of its path, by which a disc may miss the place to which the ball turned it
STILL_PX = 0.6  # a static candidate stays within this: noise and passing shadows; at most half of MOVED_PX
MASK_RADIUS_PX = 1.5  # a mask hides the detections within this of its centre
_MATCH_PX = 4.0  # a candidate is found again within this of its last place or of its rotated place
_FORGET_AFTER_S = 1.0  # a candidate not seen for so long is dropped; in ten seconds noise makes thousands
_MASK_LIFE_S = 600.0  # a mask that hid nothing for so long is dropped; hands hide bolts for minutes


class Candidates(NamedTuple):
    """Spots that are not yet known to be discs or static."""

    place: Array  # (t, 2) px, where last seen
    anchor: Array  # (t, 2) px, where first seen
    anchor_ball: Array  # (t, 3) direction in ball, were it a disc
    seen: Array  # (t,) s
    proven: NDArray[np.bool_]  # (t,) moved with the ball
    number: NDArray[np.intp]  # (t,) different for each

    def take(self, keep: NDArray[np.bool_]) -> "Candidates":
        """Return the candidates in a mask, (t,)."""
        if keep.all():
            return self
        part: Any = [column[keep] for column in self]
        return Candidates(*part)

    def joined(self, other: "Candidates") -> "Candidates":
        """Return both."""
        if len(other.place) == 0:
            return self
        both: Any = [np.concatenate(pair) for pair in zip(self, other, strict=True)]
        return Candidates(*both)


_NO_CANDIDATES = Candidates(
    np.zeros((0, 2)),
    np.zeros((0, 2)),
    np.zeros((0, 3)),
    np.zeros(0),
    np.zeros(0, dtype=np.bool_),
    np.zeros(0, dtype=np.intp),
)


@dataclass(frozen=True, slots=True)
class StaticDistractors:
    """Masks, and candidates that are not yet classified."""

    masks: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (k, 2) px
    mask_seen: Array = field(default_factory=lambda: np.zeros(0))  # (k,) s
    candidates: Candidates = _NO_CANDIDATES
    next_number: int = 0  # of the next candidate; each camera counts from a number of its own


def unmasked(state: StaticDistractors, centre: Array, stamp: float) -> tuple[NDArray[np.bool_], StaticDistractors]:
    """Return which detections, (n, 2) px, are outside all masks, (n,), and the state.

    A mask that hides a detection gets `stamp`, s. The state loses masks that hid nothing for 600 s.
    """
    free, seen = np.ones(len(centre), dtype=bool), state.mask_seen.copy()
    if len(seen) == 0 or len(centre) == 0:
        return free, state
    hidden, hiding = (distances(centre, state.masks) < MASK_RADIUS_PX).nonzero()
    free[hidden], seen[hiding] = False, stamp
    alive = stamp - seen < _MASK_LIFE_S
    if len(hidden) or not all(alive.tolist()):
        state = replace(state, masks=state.masks[alive], mask_seen=seen[alive])
    return free, state


def mask(state: StaticDistractors, centre: Array, stamp: float) -> StaticDistractors:
    """Add masks at (k, 2) px."""
    if len(centre) == 0:
        return state
    return replace(
        state,
        masks=np.concatenate([state.masks, centre]),
        mask_seen=np.concatenate([state.mask_seen, np.full(len(centre), stamp)]),
    )


def without_landmarks(state: StaticDistractors, discs: Array, disc_angle: float) -> StaticDistractors:
    """Remove the candidates on discs, (m, 3) unit vectors in ball, of angular radius `disc_angle` rad."""
    near = np.any(state.candidates.anchor_ball @ discs.T > np.cos(disc_angle), axis=1)
    return replace(state, candidates=state.candidates.take(~near))


def without_candidates(state: StaticDistractors, numbers: NDArray[np.intp]) -> StaticDistractors:
    """Forget the candidates with these `numbers`, (k,)."""
    return replace(state, candidates=state.candidates.take(~are_among(state.candidates.number, numbers)))


def recent(state: StaticDistractors, stamp: float) -> NDArray[np.intp]:
    """Return the numbers, (k,), of the candidates that would not be forgotten at `stamp`, s."""
    return state.candidates.number[stamp - state.candidates.seen < _FORGET_AFTER_S]


def with_places(state: StaticDistractors, numbers: NDArray[np.intp], places: Array) -> StaticDistractors:
    """Set the places on the ball, (k, 3) unit vectors in ball, of the candidates with `numbers`, (k,)."""
    candidates = state.candidates
    at, which = np.nonzero(candidates.number[:, None] == numbers)
    if len(at) == 0:
        return state
    anchors = candidates.anchor_ball.copy()
    anchors[at] = places[which]
    return replace(state, candidates=candidates._replace(anchor_ball=anchors))


def classify_candidates(
    state: StaticDistractors,
    centre: Array,
    direction: Array,
    attitude: Array,
    stamp: float,
    rig: Rig,
    pose: Pose,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.intp], StaticDistractors]:
    """Follow the candidates of one frame: `centre` (n, 2) px, `direction` (n, 3) unit in obj, none of them masked.

    `attitude` is R_obj_ball, (3, 3), as this frame's discs have confirmed it. Returns two masks, the number of each
    candidate, (n,), and the new state. The first mask, (n,), contains the candidates proven to turn with the ball. The
    second, (n,), contains those newly proven to be static. The new state masks the static ones.
    """
    candidates = state.candidates
    if len(centre) == 0:  # a frequent case: only the time passes
        none, alive = np.zeros(0, dtype=bool), stamp - candidates.seen < _FORGET_AFTER_S
        state = state if alive.all() else replace(state, candidates=candidates.take(alive))
        return none, none, np.zeros(0, dtype=np.intp), state
    expected = _expected_places(candidates, attitude, rig, pose)
    track = _match(candidates, expected, centre)
    known = track >= 0
    which = track[known]
    turns, stands = _classify_by_motion(centre[known], candidates.anchor[which], expected[which])
    proven, still = np.zeros(len(centre), dtype=bool), np.zeros(len(centre), dtype=bool)
    proven[known] = (candidates.proven[which] | turns) & ~stands
    still[known] = stands

    place, seen, known_proven = candidates.place.copy(), candidates.seen.copy(), candidates.proven.copy()
    place[which], seen[which], known_proven[which] = centre[known], stamp, proven[known]
    keep = stamp - seen < _FORGET_AFTER_S
    keep[which[stands]] = False
    followed = candidates._replace(place=place, seen=seen, proven=known_proven).take(keep)
    at, count = centre[~known], len(centre) - len(which)
    number = np.zeros(len(centre), dtype=np.intp)
    number[known], number[~known] = candidates.number[which], state.next_number + np.arange(count)
    anchors, unproven = direction[~known] @ attitude, np.zeros(count, dtype=bool)
    new = Candidates(at, at, anchors, np.full(count, stamp), unproven, number[~known])
    state = replace(state, candidates=followed.joined(new), next_number=state.next_number + count)
    return proven, still, number, mask(state, centre[still], stamp)


def _classify_by_motion(centre: Array, first: Array, turned: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks, (n,), of the candidates that turn with the ball and of the static ones.

    `centre`, (n, 2) px, are their current places, `first` their first ones, and `turned` those of discs in this frame.
    """
    path, off, stayed = (np.hypot(*(a - b).T) for a, b in ((turned, first), (centre, turned), (centre, first)))
    tell = path > MOVED_PX
    return tell & (off < TURNED_PART * path), tell & (stayed < STILL_PX) & (off > 0.5 * path)


def known_before_to_turn(
    state: StaticDistractors, centre: Array, attitude: Array, rig: Rig, pose: Pose
) -> NDArray[np.bool_]:
    """Return a mask, (n,), of `centre`, (n, 2) px: candidates proven by earlier frames, at a predicted attitude."""
    proven = np.zeros(len(centre), dtype=bool)
    candidates = state.candidates
    if np.count_nonzero(candidates.proven) == 0:
        return proven
    track = _match(candidates, _expected_places(candidates, attitude, rig, pose), centre)
    proven[track >= 0] = candidates.proven[track[track >= 0]]
    return proven


def _expected_places(candidates: Candidates, attitude: Array, rig: Rig, pose: Pose) -> Array:
    """Return the places, (t, 2) px, of the candidates if they were discs."""
    turned = seen_at(candidates.anchor_ball @ attitude.T, rig, pose)
    return np.where(np.isfinite(turned), turned, candidates.place)


def _match(candidates: Candidates, expected: Array, centre: Array) -> NDArray[np.intp]:
    """Return for each of `centre`, (n, 2) px, the index of a candidate that stayed or turned there, (n,); -1: none."""
    nearer = np.minimum(distances(centre, expected), distances(centre, candidates.place))
    return mutual_nearest(np.where(nearer < _MATCH_PX, nearer, np.inf))
