"""The use phase: one frame in, attitude and motion out. The only place that knows the order of the stages.

Detect, intersect, set aside look-alikes, associate and filter, turn rotation into counts (Wittich 2017, section 3.5).
Everything is a pure function of the state before and the frame; nothing here waits, logs or reads a clock.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from spheremouse.ball import camera_watch as watching
from spheremouse.ball.build import begin, build, check_size
from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.detect.detections import Detections, no_detections
from spheremouse.ball.detect.lookalikes import Lookalikes
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.detect.search import Hunt
from spheremouse.ball.filters import FilterState
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import CORE, So3State, consider
from spheremouse.ball.phases.camera_moved import Moved, hidden, out_of_sight, relative, surprised, with_references
from spheremouse.ball.phases.follow import follow_discs, look
from spheremouse.ball.phases.learn import first_motion
from spheremouse.ball.phases.lifted import on_its_bearings
from spheremouse.ball.phases.readout import tell_readout
from spheremouse.ball.phases.recover import lost_in_a_gap, recognise_saved, recovered
from spheremouse.ball.points import intersect
from spheremouse.ball.pose import find_pose, predict_targets
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import (
    Phase,
    Tracker,
    TrackState,
    current,
    no_motion,
    no_points,
    unused,
)
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, rotation_between
from spheremouse.output.counts import to_counts
from spheremouse.tracker import Frame, Motion

Seek = Callable[[Frame, Tracker], Moved | None]


def seek_by_colour(frame: Frame, tracker: Tracker) -> Moved | None:
    """The tracker for the pose that the whole picture tells; None where it tells none, or the one that is known."""
    rig, settings = tracker.rig, tracker.settings
    if frame.image.ndim != 3:
        return None
    try:
        seen = detect_targets(frame.image, rig.targets.radii, settings.rings)
        pose = find_pose([seen], rig, frame.image, settings.pose).pose
        shift = predict_targets(pose, rig) - predict_targets(tracker.pose, rig)
        return (
            (build(rig, pose, settings), None) if watching.displaced(shift, 3.0 * settings.watch.match_sigma) else None
        )
    except PoseError:
        return None


def step(
    state: TrackState,
    frame: Frame,
    tracker: Tracker,
    detected: Callable[[], None] = lambda: None,
    seek: Seek = seek_by_colour,
) -> tuple[TrackState, Motion]:
    """One frame. Raises SourceError when the frame has another size than the camera was calibrated for.

    Where the targets say that the camera was moved, the pose is estimated anew and the frame is done with that.
    `detected` is called between detection and what follows: whoever measures times needs to know. `seek` looks for the
    camera by the targets' colours, which takes long: whoever has no time does that elsewhere, and uses `posed_anew`.
    """
    check_size(frame, tracker.rig)
    tracker = current(state, tracker)
    if state.watch is None:
        return _stages(state, frame, tracker, detected)
    if state.watch.away is not None:
        return _attend(state, None, frame, tracker, seek)
    new, motion = _stages(state, frame, tracker, detected)
    watch = with_references(state.watch, frame, tracker)
    watch, odd = watching.glance(watch, frame.image, frame.stamp, tracker.settings.watch, surprised(new))
    if watch is not new.watch:
        new = replace(new, watch=watch)
    if odd or watch.asked or out_of_sight(new, frame.stamp):
        new, motion = _attend(replace(state, watch=watch), (new, motion), frame, tracker, seek)
    if state.phase is Phase.TRACKING and new.phase is Phase.LOST and hidden(new.watch):
        return replace(
            new, event=f"{new.event}; the targets are out of sight: if the camera was moved, initialise again"
        ), motion
    return new, motion


def wants_colour(state: TrackState, stamp: float) -> bool:
    """Will the targets be looked for in the frame of `stamp`? Then it should come in colour; grey does otherwise."""
    watch = state.watch
    if watch is None:
        return False
    unknown = stamp >= watch.due and any(patch is None for patch in watch.patches)
    return watch.asked or watch.away is not None or unknown or out_of_sight(state, stamp)


def posed_anew(state: TrackState, frame: Frame, tracker: Tracker, pose: Pose) -> tuple[TrackState, Motion]:
    """One frame with the camera at a `pose` that was estimated anew: the ball goes on as it was, nothing jumps.

    Raises PoseError where the ball cannot be seen from there.
    """
    tracker = current(state, tracker)
    return _from_there(state, build(tracker.rig, pose, tracker.settings), None, frame, tracker)


def shows_targets(frame: Frame, tracker: Tracker, pose: Pose) -> bool:
    """Does a frame still look as from a pose that was found for one before: three targets in their places there?"""
    watch = watching.begin(tracker.rig, pose)
    if watch is None:
        return True  # too near the edge of the picture to be watched
    every = np.arange(len(watch), dtype=np.intp)
    return bool(
        np.count_nonzero(watching.take(watch, frame.image, every, tracker.rig, tracker.settings.rings).seen) >= 3
    )


def retuned(state: TrackState, tracker: Tracker, settings: Settings) -> tuple[TrackState, Tracker]:
    """State and tracker with other settings, between two frames; another kind of filter begins at the last attitude."""
    anew = build(tracker.rig, current(state, tracker).pose, settings)
    if settings.tracker != tracker.settings.tracker:
        return begin(anew, state.filter.stamp, state.filter.attitude), anew
    if settings.so3.levels != tracker.settings.so3.levels and isinstance(state.filter, So3State):
        state = replace(state, filter=replace(state.filter, weights=np.zeros(0)))  # they were those of other levels
    return replace(state, rebuilt=None, hunt=Hunt()), anew


def _stages(
    state: TrackState, frame: Frame, tracker: Tracker, detected: Callable[[], None] = lambda: None
) -> tuple[TrackState, Motion]:
    """One frame of a camera that stands."""
    predicted = tracker.filter.predict(state.filter, frame.stamp)
    detections, hunt = look(state, frame, tracker, predicted)
    detected()
    return advance(state, frame.stamp, detections, tracker, predicted, hunt)


def _attend(
    state: TrackState, done: tuple[TrackState, Motion] | None, frame: Frame, tracker: Tracker, seek: Seek
) -> tuple[TrackState, Motion]:
    """All targets are looked at: is the camera where it was, does it swing, or stand elsewhere?

    `done` is what the frame says if the camera has not moved, where that is known already. While it swings, nothing is
    filtered and nothing sent: the prediction of the ball waits for the pose.
    """
    assert state.watch is not None
    s, before = tracker.settings.watch, state.watch.shift
    watch, shift = watching.look_at_all(state.watch, frame.image, s)
    on_rings = watching.on_rings(watch, frame.image, shift, tracker.rig, tracker.settings.rings)
    moved = watching.displaced(on_rings, s.displaced)
    if moved is None:
        moved = watching.displaced(shift, 3.0 * s.match_sigma)
    if moved and watching.stands(before, shift, s):
        anew = relative(on_rings, shift, tracker) or seek(frame, tracker)
        if anew is not None:
            return _from_there(state, *anew, frame, tracker)
    if moved:
        return _swings(replace(state, watch=replace(watch, shift=shift)), frame.stamp, tracker)
    watch = replace(watch, shift=np.zeros((0, 2)), away=None)
    if frame.image.ndim != 3 and not watch.asked:  # what is too little for correlation, colours may tell
        new, motion = _stages(state, frame, tracker) if done is None else done
        return replace(new, watch=replace(watch, asked=True)), motion
    watch = replace(watch, asked=False)
    if moved is None and done is not None and out_of_sight(replace(done[0], watch=watch), frame.stamp):
        watch = replace(watch, tried=frame.stamp)
        anew = seek(frame, tracker)
        if anew is not None:
            return _from_there(state, *anew, frame, tracker)
    if moved is False:  # then a target out of its place was moved by itself, or is in another light
        alone = np.flatnonzero(np.hypot(*np.nan_to_num(shift).T) > s.displaced)
        watch = watching.take(watch, frame.image, alone, tracker.rig, tracker.settings.rings)
    new, motion = _stages(state, frame, tracker) if done is None else done
    return replace(new, watch=watch), motion


def _from_there(
    state: TrackState, anew: Tracker, added: Array | None, frame: Frame, tracker: Tracker
) -> tuple[TrackState, Motion]:
    """The frame with the camera where it is now: the ball knows nothing of the bump, so nothing jumps.

    What lies in the picture, look-alikes and candidates, is forgotten, and how well the ball turned about its centre:
    a new pose is a new claim of where that is. The pose's error stays what it was, and so does
    what the map has taken up of it; `added`, (6, 6), comes on top. None: the pose owes nothing to the one before.
    """
    filtered: Any = state.filter
    if not state.moved:  # nothing is known yet but where candidates were in the picture
        filtered = anew.filter.initial(state.filter.stamp, state.filter.attitude)
    elif isinstance(filtered, So3State) and isinstance(anew.filter, So3Filter):
        joint = filtered.joint.copy()
        if added is None:
            consider(joint, anew.filter.considered)
        else:
            joint[CORE : CORE + 6, CORE : CORE + 6] += added
        filtered = replace(filtered, joint=joint)
    watch = watching.begin(anew.rig, anew.pose)
    if watch is not None:
        watch = replace(with_references(watch, frame, anew), due=frame.stamp)
    state = replace(state, filter=filtered, lookalikes=Lookalikes(), recent=(), hunt=Hunt(), watch=watch, rebuilt=anew)
    state = replace(state, off=0, misfit=0.0, out_of_round=False, fitted=0.0)
    new, motion = _stages(state, frame, anew)
    path, turn = watching.difference(tracker.pose, anew.pose)
    event = f"the camera was moved: pose estimated anew ({1e3 * path:.1f} mm, {np.degrees(turn):.2f}°)"
    return replace(new, event=f"{event}; {new.event}" if new.event else event), motion


def _swings(state: TrackState, stamp: float, tracker: Tracker) -> tuple[TrackState, Motion]:
    """The camera is not where it was and does not stand: wait; lost when that lasts."""
    assert state.watch is not None
    away = stamp if state.watch.away is None else min(state.watch.away, stamp)
    state = replace(
        state,
        event="",
        filter=tracker.filter.update(tracker.filter.predict(state.filter, stamp), no_points(tracker)),
        detections=no_detections(),
        points=no_points(tracker),
        holds=False,
        watch=replace(state.watch, away=away),
    )
    if state.phase is Phase.TRACKING and stamp - away > tracker.settings.loss.lost_after:
        text = "lost: the camera was moved, and its pose is not found: uncover the targets, or initialise again"
        state = replace(state, phase=Phase.LOST, found=None, event=text)
    return state, no_motion(stamp)


def advance(
    state: TrackState,
    stamp: float,
    detections: Detections,
    tracker: Tracker,
    predicted: FilterState | None = None,
    hunt: Hunt | None = None,
) -> tuple[TrackState, Motion]:
    """The stages after detection; `predicted` is the filter carried on to `stamp`, where that was done before."""
    carried: FilterState = tracker.filter.predict(state.filter, stamp) if predicted is None else predicted
    free, lookalikes = static.unmasked(state.lookalikes, detections.centre, stamp, tracker.settings.static)
    if free.all():
        points = intersect(detections, tracker.rig, tracker.pose)
    else:
        points = intersect(detections.take(free), tracker.rig, tracker.pose)
        points = replace(points, index=np.flatnonzero(free)[points.index])
    state = replace(
        state,
        event="",
        lookalikes=lookalikes,
        detections=detections,
        points=points,
        held=min(state.held, stamp),  # a clock that starts again: nothing is held by a time to come
        holds=False,
        hunt=hunt or state.hunt,
    )
    state = lost_in_a_gap(state, stamp, tracker)
    if state.phase is Phase.LOST:
        state = recovered(state, stamp, tracker)
    elif state.saved:
        state = recognise_saved(state, stamp, tracker)
    elif not state.moved:
        state = first_motion(state, stamp, tracker, carried)
    else:
        state = on_its_bearings(follow_discs(state, stamp, tracker, carried), stamp, tracker, carried)
    state = _judge_phase(state, stamp, tracker)
    if tracker.rig.readout_sigma_s > 0.0 and not state.readout_told:
        state = tell_readout(state, tracker)
    return _motion(state, stamp, tracker)


def _judge_phase(state: TrackState, stamp: float, tracker: Tracker) -> TrackState:
    """Is the ball tracked, lost, or still looked for?"""
    if state.holds and state.phase is Phase.TRACKING:
        return state  # `_motion` notes when
    if state.holds:
        state = replace(state, held=stamp)
    if state.phase is Phase.SEARCHING:
        if not state.saved and len(state.filter.discs) >= 2:
            event = f"{state.event}; " if state.event else ""
            event += f"tracking: {len(state.points)} discs in view"
            return replace(state, phase=Phase.TRACKING, held=stamp, event=event)
        return replace(state, held=stamp)
    if state.phase is Phase.TRACKING and stamp - state.held > tracker.settings.loss.lost_after:
        seen = len(state.points)
        why = f"{seen} discs in view, none where it should be" if seen else "no disc in view"
        return replace(
            state,
            phase=Phase.LOST,
            found=None,
            filter=unused(state.filter),
            event=f"lost: {why} for {tracker.settings.loss.lost_after:.1f} s",
        )
    return state


def _motion(state: TrackState, stamp: float, tracker: Tracker) -> tuple[TrackState, Motion]:
    """Motion since the last one, where discs hold the attitude; nothing otherwise: it is made up for when they do."""
    if state.phase is not Phase.TRACKING or not state.holds:
        return state, no_motion(stamp)
    attitude = state.filter.attitude
    rotation = rotation_between(state.sent, attitude)
    counts, remainder = to_counts(rotation, tracker.counts, state.remainder)
    state = replace(state, sent=attitude, remainder=remainder, held=stamp)
    return state, Motion(stamp, counts, rotation, state.filter.rate)
