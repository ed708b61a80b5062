"""The use phase: one frame in, attitude and motion out. Only this module defines the order of the stages.

The stages are: detect, intersect, remove look-alikes, associate and filter, report the motion (Wittich 2017, section
3.5). All functions are pure functions of the state before and the frame. Nothing here waits, logs or reads a clock.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from spheremouse.ball import camera_moved
from spheremouse.ball import camera_watch as watching
from spheremouse.ball.build import begin, build, colours_of
from spheremouse.ball.camera_moved import Seek, seek_by_colour
from spheremouse.ball.camera_state import facing
from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.detect.detections import Detections, no_detections
from spheremouse.ball.detect.lookalikes import StaticDistractors
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.events import (
    BallLost,
    CameraMoved,
    Doubt,
    MotionReleased,
    MotionWithheld,
    OutOfRound,
    ReadoutKnown,
    TargetsHidden,
    Why,
)
from spheremouse.ball.filters import FilterState
from spheremouse.ball.filters.so3_camera import with_uncertain_turn
from spheremouse.ball.filters.so3_mixture import mixture_covariance
from spheremouse.ball.filters.so3_state import PLACED
from spheremouse.ball.phases import colours
from spheremouse.ball.phases.recover import lost_in_a_gap, lost_in_time
from spheremouse.ball.phases.seen_centre import with_first_outline, with_outline
from spheremouse.ball.points import intersect
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import (
    CentreCheck,
    Events,
    LastPicture,
    Learning,
    Lost,
    OutlineCheck,
    Phase,
    Recognising,
    Tracker,
    Tracking,
    TrackState,
    Withheld,
    current,
    lost,
    no_points,
    statistics,
)
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, rotation_between
from spheremouse.geometry.statistics import is_nonzero
from spheremouse.tracker import MAX_REPEATS, Estimate, Frame, Status, Step, check_size

_READOUT_SURE = 8e-5  # s, standard deviation from which a readout is known
_READOUT_LEAST = 2e-3  # s: less moves nothing by more than a tenth of a degree
_MATTERS = 0.1  # s without a confirmation from which a player notices: the pointer's prediction ends there by default


def step(
    state: TrackState,
    frame: Frame,
    tracker: Tracker,
    detected: Callable[[], None] = lambda: None,
    seek: Seek = seek_by_colour,
) -> Step[TrackState]:
    """Process one frame. Raises SourceError if the frame has another size than the calibration of the camera.

    If the targets show that the camera was moved, the frame is processed with a new pose. The function calls `detected`
    after detection, to measure times. `seek` searches for the targets by colour, which takes long. In real time, search
    in another thread, and use `with_pose`. `tracker` is that of the frame's camera (`cameras.with_camera`).

    A camera that has no new picture in time may give its last one again, with a new stamp. That would show that the
    ball stands. If the ball turns steadily, at most two such frames in a row are predictions.
    """
    check_size(frame, tracker.rig.camera)
    state = facing(state, frame.camera)
    tracker = current(state, tracker)
    picture = LastPicture.of(frame.image, state.filter.rate)
    if picture.rows == state.picture.rows and state.picture.repeats < MAX_REPEATS and _turns_steadily(state):
        return _predicted(state, frame.stamp, tracker)
    state = state._replace(picture=picture)
    if state.watch is None:
        return _stages(state, frame, tracker, detected)
    if state.watch.moving_since is not None:
        return _with_check(state, None, frame, tracker, seek)
    done = _stages(state, frame, tracker, detected)
    watch = camera_moved.with_references(state.watch, frame, tracker)
    watch, odd = watching.check_next_target(watch, frame.image, frame.stamp, camera_moved.bump_suspected(done.state))
    if watch is not done.state.watch:
        done = done._replace(state=done.state._replace(watch=watch))
    # A pushed camera looks like a ball out of round
    odd |= any(isinstance(event, OutOfRound) for event in done.events)
    if odd or watch.colour_frame_requested or camera_moved.out_of_sight(done.state, frame.stamp):
        done = _with_check(state._replace(watch=watch), done, frame, tracker, seek)
    if state.status is Status.TRACKING and done.state.status is Status.LOST and camera_moved.hidden(done.state.watch):
        return done._replace(events=(*done.events, TargetsHidden()))
    return done


def _turns_steadily(state: TrackState) -> bool:
    """Return whether the ball is tracked, and turns at a rate that has not changed by half since before the picture."""
    rate, covariance = state.filter.rate, state.filter.covariance[3:, 3:]
    if state.status is not Status.TRACKING or not is_nonzero(rate, covariance):
        return False
    return bool(np.linalg.norm(rate - state.picture.rate) < 0.5 * np.linalg.norm(rate))


def _predicted(state: TrackState, stamp: float, tracker: Tracker) -> Step[TrackState]:
    """Process a frame that shows the last picture again. The filter goes on from the frame before."""
    carried = state._replace(filter=tracker.filter.predict(state.filter, stamp))
    estimate = _estimate(carried, stamp, np.zeros(6), np.zeros((6, 6)), confirmed=False)
    picture = state.picture._replace(repeats=state.picture.repeats + 1)
    state = state._replace(picture=picture, frames=state.frames + 1)
    return Step(state, estimate._replace(statistics=statistics(state)))  # of the picture


def wants_colour(state: TrackState, stamp: float) -> bool:
    """Return whether discs or targets need the frame of `stamp` in colour; otherwise grey suffices."""
    if colours.wants_colour(state, stamp):
        return True
    watch = state.watch
    if watch is None:
        return False
    unknown = stamp >= watch.due and any(patch is None for patch in watch.patches)
    moving = watch.moving_since is not None
    return watch.colour_frame_requested or moving or unknown or camera_moved.out_of_sight(state, stamp)


def with_pose(state: TrackState, frame: Frame, tracker: Tracker, pose: Pose) -> Step[TrackState]:
    """Process one frame with the camera at a new `pose`. The ball keeps its attitude and rate.

    Raises PoseError if the camera cannot see the ball from there.
    """
    tracker = current(state, tracker)
    state = state._replace(picture=LastPicture.of(frame.image, state.filter.rate))
    return _with_new_pose(state, build(tracker.rig, pose, tracker.settings), None, frame, tracker)


def with_settings(state: TrackState, tracker: Tracker, settings: Settings) -> tuple[TrackState, Tracker]:
    """Return state and tracker with other settings.

    Another kind of filter starts at the last attitude, and so does the picture of a ball's pattern if the detector is
    another.
    """
    before = current(state, tracker)
    anew = build(tracker.rig, before.pose, settings, before)
    keeps = anew.detector.keeps_state or before.detector.keeps_state
    other_picture = keeps and anew.detector_data is not before.detector_data
    if settings.tracker != tracker.settings.tracker or other_picture:
        return begin(anew, state.filter.stamp, state.filter.attitude), anew
    others = tuple(h._replace(state=anew.filter.adopt(h.state, tracker.filter)) for h in state.alternatives)
    state = state._replace(filter=anew.filter.adopt(state.filter, tracker.filter), alternatives=others)
    seen = colours_of(anew.rig, settings, state.colours)
    return state._replace(rebuilt=None, search=_kept_search(state, anew), colours=seen), anew


def _kept_search(state: TrackState, anew: Tracker) -> Any:
    """Return the state of the detector for another tracker."""
    return state.search if anew.detector.keeps_state else SearchState()


def _stages(
    state: TrackState, frame: Frame, tracker: Tracker, detected: Callable[[], None] = lambda: None
) -> Step[TrackState]:
    """Process one frame of an unmoved camera."""
    before, events = state.colours, ()
    state = colours.with_trial(colours.with_blur(state, frame, tracker), frame, tracker)
    uses_outline, begun = tracker.detector.is_exact and tracker.method.keeps_map, state.outline.begun
    if uses_outline and not begun:
        state, events = with_first_outline(state, frame.image, tracker)
        tracker = current(state, tracker)
    predicted = tracker.filter.predict(state.filter, frame.stamp)
    if uses_outline and begun:
        state, predicted = with_outline(state, predicted, frame.image, tracker)
    detections, search = tracker.detector.detect(state, frame, tracker, predicted)
    detected()
    done = advance(state, frame.stamp, detections, tracker, predicted, search)
    if events:
        done = done._replace(events=(*events, *done.events))
    done = colours.refine_projection(done, frame, tracker)
    return done if done.state.colours is before else colours.with_colour_event(done, before)


def _with_check(
    state: TrackState, done: Step[TrackState] | None, frame: Frame, tracker: Tracker, seek: Seek
) -> Step[TrackState]:
    """Process a frame with a check of all targets; `done` is its result with an unmoved camera, if known."""
    assert state.watch is not None
    check = camera_moved.check_targets(state.watch, done.state if done else None, frame, tracker, seek)
    if check.moved is not None:
        return _with_new_pose(state, *check.moved, frame, tracker)
    if check.moving:
        return _camera_moving(state._replace(watch=check.watch), frame.stamp, tracker)
    done = done or _stages(state, frame, tracker)
    return done._replace(state=done.state._replace(watch=check.watch))


def _with_new_pose(
    state: TrackState, anew: Tracker, added: Array | None, frame: Frame, tracker: Tracker
) -> Step[TrackState]:
    """Process a frame after the camera has moved. The ball's attitude and rate stay, so the pointer does not jump.

    The tracker forgets look-alikes and candidates, because they have other places in the picture. It also forgets the
    checks of the ball's centre, because a new pose changes the ball's apparent centre. The covariance of the pose
    stays, with the map's share of it, and grows by `added`, (6, 6). With None the new pose is independent of the old
    one.
    """
    filtered = anew.method.at_new_pose(state, anew, added)
    watch = watching.begin(anew.rig, anew.pose) if anew.method.keeps_map else None
    if watch is not None:
        watch = replace(camera_moved.with_references(watch, frame, anew), due=frame.stamp, shaken=frame.stamp)
    phase = _from_elsewhere(state.phase)
    state = state._replace(
        phase=phase,
        filter=filtered,
        lookalikes=StaticDistractors(next_number=state.lookalikes.next_number),
        search=_kept_search(state, anew),
        watch=watch,
        centre=CentreCheck(),
        outline=OutlineCheck(),
        rebuilt=anew,
    )
    done = _stages(state, frame, anew)
    path, turn = watching.difference(tracker.pose, anew.pose)
    return done._replace(events=(CameraMoved(path, turn), *done.events))


def _from_elsewhere(phase: Phase) -> Phase:
    """Return the phase without the views from the earlier pose."""
    match phase:
        case Learning():
            return Learning(phase.found)
        case Tracking():
            return Tracking()
        case Lost():
            return phase._replace(last=Learning(phase.last.found) if isinstance(phase.last, Learning) else Tracking())
        case Recognising():
            return phase


def _camera_moving(state: TrackState, stamp: float, tracker: Tracker) -> Step[TrackState]:
    """Process a frame of a moving camera: wait, and lose the ball after a while.

    Nothing was detected in such a frame, so it does not show that discs are hidden. The frames before may have shown
    the camera's motion as one of the ball.
    """
    assert state.watch is not None
    before = state.watch.moving_since
    moving_since = stamp if before is None else min(before, stamp)
    filtered = state.filter
    if before is None:
        filtered = with_uncertain_turn(filtered, camera_moved.apparent_turn(state.watch.shift, tracker))
    predicted = tracker.filter.predict(filtered, stamp)
    state = state._replace(
        filter=tracker.filter.update(predicted, no_points(tracker))._replace(hidden=predicted.hidden),
        detections=no_detections(),
        points=no_points(tracker),
        confirmed=False,
        watch=replace(state.watch, moving_since=moving_since, shaken=stamp),
    )
    known_at = max(moving_since, min(state.confirmed_at, stamp))  # another camera may show the ball
    if state.status is Status.TRACKING and stamp - known_at > tracker.settings.loss.lost_after:
        return _step(lost(state), stamp, (BallLost(Why.CAMERA),))
    return _step(state, stamp, ())


def advance(
    state: TrackState,
    stamp: float,
    detections: Detections,
    tracker: Tracker,
    predicted: FilterState | None = None,
    search: SearchState | None = None,
) -> Step[TrackState]:
    """Process one frame after detection; `predicted` is the filter at `stamp`, if known."""
    carried: Any = tracker.filter.predict(state.filter, stamp) if predicted is None else predicted
    free, lookalikes = static.unmasked(state.lookalikes, detections.centre, stamp)
    which = None if all(free.tolist()) else np.flatnonzero(free)
    points = intersect(
        detections,
        tracker.rig,
        tracker.pose,
        carried.seen_rig if state.status is Status.TRACKING else carried.rig_error,
        which,
    )
    state = state._replace(
        lookalikes=lookalikes,
        detections=detections,
        points=points,
        confirmed_at=min(state.confirmed_at, stamp),  # a clock that starts again: nothing is confirmed in time to come
        confirmed=False,
        search=search or state.search,
    )
    state, gap = lost_in_a_gap(state, stamp, tracker)
    state, events = tracker.method.next_phase(state, stamp, tracker, carried)
    events = events or gap  # found again with the frame that ends it
    state, more = lost_in_time(state, stamp, tracker)
    events = (*more, *events)  # causes of the state come first
    if tracker.rig.readout_sigma_s > 0.0 and not state.readout_known:
        state, more = _learn_readout(state, tracker)
        events = (*events, *more)
    if state.filter.stamp != stamp:  # a frame that the filter does not use
        done = _step(state._replace(filter=carried), stamp, events)
        return done._replace(state=done.state._replace(filter=state.filter))
    return _step(state, stamp, events)


def _learn_readout(state: TrackState, tracker: Tracker) -> tuple[TrackState, Events]:
    """Return an event when the filter has determined the readout time of a rolling shutter."""
    if state.filter.readout_sigma > _READOUT_SURE:
        return state, ()
    readout = tracker.rig.readout_s + state.filter.readout
    state = state._replace(readout_known=True)
    return state, () if abs(readout) < _READOUT_LEAST else (ReadoutKnown(readout),)


def _step(state: TrackState, stamp: float, events: Events) -> Step[TrackState]:
    """Return the estimate of a frame, with the increment since the last confirmed one if discs confirm the attitude."""
    frames, f = state.frames + 1, state.filter
    increment, increment_covariance = np.zeros(6), np.zeros((6, 6))
    if state.status is not Status.TRACKING:
        estimate = _estimate(state, stamp, increment, increment_covariance, confirmed=False)
        return Step(state._replace(withheld=None, frames=frames, shown_at=stamp), estimate, events)
    if not state.confirmed:
        withheld, more = _withheld(state, stamp)
        estimate = _estimate(state, stamp, increment, increment_covariance, confirmed=False)
        return Step(state._replace(withheld=withheld, frames=frames, shown_at=stamp), estimate, (*events, *more))
    rotation = rotation_between(state.reported_attitude, f.attitude)
    since = f.increment_covariance(rotation)
    if since[0, 0] + since[1, 1] + since[2, 2] <= PLACED**2:  # a motion unseen is a guess, and none is sent
        increment[:3], increment_covariance[:3, :3] = rotation, since[:3, :3]
    estimate = _estimate(state, stamp, increment, increment_covariance, confirmed=True)
    before = state.withheld
    if before is not None and before.announced:
        events = (*events, MotionReleased(stamp - before.since, float(np.linalg.norm(increment))))
    state = state._replace(
        filter=f.clone_attitude(),
        reported_attitude=f.attitude,
        confirmed_at=stamp,
        withheld=None,
        frames=frames,
        shown_at=stamp,
    )
    return Step(state, estimate, events)


def _estimate(
    state: TrackState, stamp: float, increment: Array, increment_covariance: Array, *, confirmed: bool
) -> Estimate:
    """Return the estimate of a frame with an increment of 6 components."""
    f, rate, covariance = state.filter, np.zeros(6), np.zeros((12, 12))
    rate[:3] = f.rate
    known = mixture_covariance(f, state.alternatives) if state.alternatives else f.covariance
    covariance[:3, :3], covariance[6:9, 6:9] = known[:3, :3], known[3:, 3:]
    covariance[:3, 6:9], covariance[6:9, :3] = known[:3, 3:], known[3:, :3]
    return Estimate(
        stamp,
        state.frames,
        state.status,
        f.attitude,
        np.zeros(3),
        rate,
        covariance,
        increment,
        increment_covariance,
        confirmed,
        statistics(state),
    )


def _withheld(state: TrackState, stamp: float) -> tuple[Withheld, Events]:
    """Return the withheld motion after an unconfirmed frame, and one event for each spell that a player notices."""
    before = state.withheld or Withheld(state.confirmed_at, Doubt.NO_DISC)
    since, doubt = min(before.since, stamp), _doubt(state)  # a clock that starts again
    if before.announced or stamp - since <= _MATTERS:
        return Withheld(since, doubt, before.announced), ()
    return Withheld(since, doubt, announced=True), (MotionWithheld(doubt),)


def _doubt(state: TrackState) -> Doubt:
    """Return the reason why the last frame, which must be unconfirmed, does not confirm the ball's attitude."""
    used = len(state.filter.used)
    if state.watch is not None and state.watch.moving_since is not None:
        return Doubt.CAMERA
    if len(state.points) == 0:
        return Doubt.NO_DISC
    if state.alternatives:
        return Doubt.SEVERAL
    if used == 0:
        return Doubt.UNKNOWN
    return Doubt.ONE_DISC if used == 1 else Doubt.UNCERTAIN
