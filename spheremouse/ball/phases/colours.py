"""Choice of the colour projection in which discs are darker than the ball.

Until the ball turns, the tracker repeatedly tries all candidates (detect.choose_projection). Once three discs are
known, Fisher's discriminant of their pixels replaces the candidate if it gives more information. After that the
projection stays the same, unless the ball is lost for 10 s. The lens's blur is measured at the start, and again after
twice the time.
"""

from typing import Any

import numpy as np

from spheremouse.ball.detect.choose_projection import best_projection, projections_to_try
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.projection import colour_contrast
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.events import DiscColours
from spheremouse.ball.state import Colours, Learning, Lost, Phase, Recognising, Tracker, Tracking, TrackState
from spheremouse.tracker import Frame, Status, Step

_MIN_INFORMATION = 0.2  # noise-free discs: with more information, the wait until the next trial doubles
_FIRST_WAIT_S, _MAX_WAIT_S = 0.5, 64.0  # between trials; it doubles while the choice stays the same
_OTHER_BALL_S = 10.0  # time without a disc after which the user may have placed another ball


def is_trial_due(state: TrackState, stamp: float) -> bool:
    """Return True if the tracker must try all projections on the frame of `stamp` (s)."""
    colours, phase = state.colours, state.phase
    wait = _FIRST_WAIT_S if isinstance(phase, Lost) else colours.wait  # a cover may have had colours of its own
    if colours.fixed or isinstance(phase, Tracking) or colours.tried <= stamp < colours.tried + wait:
        return False
    if isinstance(phase, Lost) and isinstance(phase.last, Tracking):
        return phase.in_view_since is None and stamp - state.confirmed_at > _OTHER_BALL_S
    return True


def wants_colour(state: TrackState, stamp: float) -> bool:
    """Return True if the projection, or a trial that is due, needs the frame of `stamp` (s) in colour."""
    return state.colours.projection.needs_colour or is_trial_due(state, stamp)


def with_trial(state: TrackState, frame: Frame, tracker: Tracker) -> TrackState:
    """Return the state after a trial of all projections, if one is due: one on each frame while the ball is tracked.

    If another projection shows the discs better, the search and an unfinished phase start again with it. A lost ball
    keeps its map, since a cover may have these colours. The discs in them get a new map once they turn like a ball.
    """
    before, image = state.colours, frame.image
    if not is_trial_due(state, frame.stamp):
        return state._replace(colours=before._replace(tried_now=())) if before.tried_now else state
    detector = blurred_detector(state, tracker)  # the projection is fixed for one that uses no colours
    known = dict(before.tried_now)
    rest = (p for p in projections_to_try(image, before.projection) if p not in known)
    if state.status is Status.TRACKING and (other := next(rest, None)) is not None:  # all would take many intervals
        known[other] = detector.with_projection(other).information(image)
        return state._replace(colours=before._replace(tried_now=tuple(known.items())))
    projection, information = best_projection(image, detector, before.projection, known)
    if known and projection != before.projection:  # the frames of the trial may show different things
        projection, information = best_projection(image, detector, before.projection)
    if projection == before.projection:
        wait = min(2.0 * before.wait, _MAX_WAIT_S) if information > _MIN_INFORMATION else _FIRST_WAIT_S
        return state._replace(colours=before._replace(tried=frame.stamp, wait=wait, tried_now=()))
    colours = before._replace(projection=projection, tried=frame.stamp, wait=_FIRST_WAIT_S, tried_now=(), refined=False)
    state = state._replace(colours=colours, phase=_in_other_colours(state.phase), search=SearchState())
    if not isinstance(state.phase, Learning):
        return state._replace(supported_at=-np.inf)
    start = tracker.filter.initial(frame.stamp, state.filter.attitude).with_reference_of(state.filter)
    return state._replace(filter=start, alternatives=())


def with_blur(state: TrackState, frame: Frame, tracker: Tracker) -> TrackState:
    """Return the state after a measurement of the lens's blur, if one is due. A picture without edges shows none."""
    colours, stamp = state.colours, frame.stamp
    measures = tracker.detector.uses_colours and tracker.method.keeps_map  # the published filters measure no blur
    if not measures or colours.blur_tried <= stamp < colours.blur_tried + colours.blur_wait:
        return state
    colours, blur = colours._replace(blur_tried=stamp), tracker.detector_data.lens_blur(frame.image)
    if blur is not None:
        colours = colours._replace(lens_blur=blur, blur_wait=2.0 * colours.blur_wait)
    return state._replace(colours=colours)


def blurred_detector(state: TrackState, tracker: Tracker) -> DiscDetector:
    """Return the detector of discs for the blur of the camera's lens."""
    return tracker.detector_data.with_lens_blur(state.colours.lens_blur)


def _in_other_colours(phase: Phase) -> Phase:
    """Return the phase without the views and times from the previous projection."""
    match phase:
        case Learning(found):
            return Learning(found)
        case Lost(Learning(found)):
            return phase._replace(last=Learning(found), in_view_since=-np.inf, trial=None)  # the next begins at once
        case Recognising():
            return Recognising()
        case _:
            return phase


def refine_projection(done: Step[TrackState], frame: Frame, tracker: Tracker) -> Step[TrackState]:
    """Return the step with Fisher's projection, if that gives more information than the present projection.

    The comparison takes place once, when a confirmed frame in colour shows enough discs and the ball has turned.
    """
    state, colours = done.state, done.state.colours
    if colours.fixed or colours.refined or not colours.projection.needs_colour or frame.image.ndim != 3:
        return done
    if not isinstance(state.phase, Tracking) or not state.confirmed:
        return done
    used: Any = state.points.index[state.filter.used]
    detector = blurred_detector(state, tracker)
    found, diameter = state.detections.take(used), detector.model.diameter
    contrast = colour_contrast(frame.image, detector.model.mask, found, diameter)
    if contrast is None:
        return done
    fisher = contrast.fisher
    before, after = (detector.with_projection(p).information(frame.image) for p in (colours.projection, fisher))
    if after <= before:
        return done._replace(state=state._replace(colours=colours._replace(refined=True)))
    state = state._replace(colours=colours._replace(projection=fisher, refined=True), search=SearchState())
    return done._replace(state=state)


def with_colour_event(done: Step[TrackState], before: Colours) -> Step[TrackState]:
    """Return the step, with a `DiscColours` event if its projection differs from that of `before`."""
    projection = done.state.colours.projection
    if projection == before.projection:
        return done
    return done._replace(events=(DiscColours(projection.weights), *done.events))
