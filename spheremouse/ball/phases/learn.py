"""The first turn of the ball, from which discs are told from look-alikes."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import common_rotation
from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.detect.lookalikes import StaticSettings
from spheremouse.ball.filters import FilterState
from spheremouse.ball.phases.follow import attitude_holds
from spheremouse.ball.points import SpherePoints
from spheremouse.ball.state import (
    Sight,
    Tracker,
    TrackState,
)
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array

_REPLAY = 30  # frames kept while nothing has moved yet, to be filtered again without the look-alikes


def first_motion(state: TrackState, stamp: float, tracker: Tracker, predicted: FilterState) -> TrackState:
    """Nothing has moved yet: every candidate may be a disc or a look-alike. Take all, until three turn alike.

    Then those that stayed are masked, and the frames since are filtered again without them, as if they had been known.
    """
    naive = replace(state, filter=tracker.filter.update(predicted, state.points))
    naive = replace(naive, holds=attitude_holds(naive.filter, len(state.points), predicted, tracker))
    if len(state.points) == 0 and not state.recent:
        return naive
    recent = (*state.recent, Sight(stamp, state.detections, state.points, naive.filter.attitude))
    if len(recent) > _REPLAY:
        recent = (recent[0], *recent[2:])  # the first frame is the anchor: slow motion shows against it
    naive = replace(naive, recent=recent)
    still = _still_since(recent[0], recent[-1], tracker)
    if still is None:
        if len(recent) == _REPLAY and _changed(recent[0], recent[-1], tracker.settings.static):
            naive = replace(naive, recent=recent[-1:])
        return naive
    lookalikes = static.mask(state.lookalikes, still, stamp)
    filtered = tracker.filter.initial(recent[0].stamp, recent[0].attitude)
    points = state.points
    for sight in recent:
        free, _ = static.unmasked(lookalikes, sight.centre, sight.stamp, tracker.settings.static)
        points = sight.points.take(free)
        filtered = tracker.filter.update(tracker.filter.predict(filtered, sight.stamp), points)
    masked = f"{len(still)} look-alike{'s' if len(still) > 1 else ''} masked"
    event = f"the ball turns; {masked}" if len(still) else "the ball turns"
    return replace(
        state,
        filter=filtered,
        lookalikes=lookalikes,
        points=points,
        moved=True,
        holds=len(filtered.used) > 1,
        recent=(),
        event=event,
    )


def _still_since(anchor: Sight, now: Sight, tracker: Tracker) -> Array | None:
    """Places, (k, 2) px, that stayed while at least three others turned alike; None while nothing is certain."""
    s = tracker.settings.static
    if len(anchor.points) < 3 or len(now.points) < 3:
        return None
    distance = np.linalg.norm(now.centre[:, None] - anchor.centre[None], axis=2)
    stayed = distance.min(axis=1) < s.still
    left = distance.min(axis=0) >= s.still
    spread = np.sqrt(np.trace(now.points.image_covariance, axis1=1, axis2=2) / 2.0) / tracker.rig.ball.radius
    sigma = max(float(np.median(spread)), 1e-3)
    shared = common_rotation(anchor.points.direction[left], now.points.direction[~stayed], sigma)
    if shared is None:
        return None
    rotation, pairs = shared
    path = np.linalg.norm(anchor.centre[left][pairs[:, 0]] - now.centre[~stayed][pairs[:, 1]], axis=1)
    if np.median(path) < s.moved:
        return None
    return now.centre[stayed & _would_move(now.points, rotation, tracker, s.moved)]


def _would_move(points: SpherePoints, rotation: Array, tracker: Tracker, least: float) -> NDArray[np.bool_]:
    """Which points would have come from at least `least` px away, were they discs under `rotation`."""
    radius, centre = tracker.rig.ball.radius, tracker.rig.ball.centre
    uv = [
        project(tracker.pose.to_cam(centre + radius * d), tracker.rig.camera)[0]
        for d in (points.direction, points.direction @ rotation)
    ]
    return np.linalg.norm(uv[0] - uv[1], axis=1) > least


def _changed(anchor: Sight, now: Sight, settings: StaticSettings) -> bool:
    """The anchor's picture is gone without a common rotation: hands, light, or too few discs in common."""
    if len(anchor.points) == 0 or len(now.points) == 0:
        return len(now.points) > 0
    stayed = np.linalg.norm(anchor.centre[:, None] - now.centre[None], axis=2).min(axis=1) < settings.still
    return bool(np.count_nonzero(~stayed) > 0.5 * len(anchor.points))
