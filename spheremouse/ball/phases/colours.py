"""The projection of colours found in which discs are darker than the ball, while nothing is known to turn with it.

All candidates are tried on one picture (detect.choice), again and again until the ball turns. Once three of its discs
are known, Fisher's discriminant of their pixels takes the place of the candidate. From then on it is fixed.
"""

from dataclasses import replace
from typing import Any

from spheremouse.ball.detect.choice import chosen, information_of
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.projection import fisher_projection
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.events import DiscColours
from spheremouse.ball.state import Colours, Detector, Learning, Lost, Phase, Recognising, Tracker, Tracking, TrackState
from spheremouse.tracker import Frame, Step

_ENOUGH = 0.2  # discs without noise, from which the wait until the next trial grows
_WAIT = (0.5, 64.0)  # s between trials, at first and at most: doubled while the choice stays
_LOST = 10.0  # s without a disc, after which another ball may be there


def seen_in(detector: Detector, colours: Colours) -> Detector:
    """The detector that sees the discs in these colours."""
    return detector.seeing(colours.projection) if isinstance(detector, DiscDetector) else detector


def is_trial_due(state: TrackState, stamp: float) -> bool:
    """Should all projections be tried on the frame of `stamp`?"""
    colours, phase = state.colours, state.phase
    if colours.fixed or isinstance(phase, Tracking) or colours.tried <= stamp < colours.tried + colours.wait:
        return False
    if isinstance(phase, Lost) and isinstance(phase.last, Tracking):
        return phase.in_view_since is None and stamp - state.confirmed_at > _LOST
    return True


def wants_colour(state: TrackState, stamp: float) -> bool:
    """Do the discs, or the choice of how to see them, need the frame of `stamp` in colour?"""
    return state.colours.projection.needs_colour or is_trial_due(state, stamp)


def with_trial(state: TrackState, frame: Frame, tracker: Tracker) -> TrackState:
    """The state with the projection that shows the discs best, where a trial is due; begun anew where it is another."""
    detector = tracker.detector
    if not (isinstance(detector, DiscDetector) and is_trial_due(state, frame.stamp)):
        return state
    before = state.colours
    projection, information = chosen(frame.image, detector, before.projection)
    if projection == before.projection:
        wait = min(2.0 * before.wait, _WAIT[1]) if information > _ENOUGH else _WAIT[0]
        return replace(state, colours=before._replace(tried=frame.stamp, wait=wait))
    colours = Colours(projection, tried=frame.stamp, wait=_WAIT[0])
    state = replace(state, colours=colours, phase=_in_other_colours(state.phase), search=SearchState())
    if not isinstance(state.phase, Learning):
        return state
    start = tracker.filter.initial(frame.stamp, state.filter.attitude).with_reference_of(state.filter)
    return replace(state, filter=start, alternatives=())


def _in_other_colours(phase: Phase) -> Phase:
    """The phase without what was seen in the colours before."""
    match phase:
        case Learning(found):
            return Learning(found)
        case Lost(Learning()):
            return Learning()
        case Recognising():
            return Recognising()
        case _:
            return phase


def refined(done: Step[TrackState], frame: Frame, tracker: Tracker) -> Step[TrackState]:
    """The step with the projection that parts the pixels of the discs from those of the ball best, once, if it does."""
    state, detector = done.state, tracker.detector
    colours = state.colours
    if colours.fixed or colours.refined or not colours.projection.needs_colour or frame.image.ndim != 3:
        return done
    if not (isinstance(detector, DiscDetector) and isinstance(state.phase, Tracking) and state.confirmed):
        return done
    used: Any = state.points.index[state.filter.used]
    fisher = fisher_projection(frame.image, detector.view.mask, state.detections.take(used), detector.diameter)
    if fisher is None:
        return done
    before, after = (
        information_of(detector.seeing(p).detect(frame.image), detector.settings.sigma)
        for p in (colours.projection, fisher)
    )
    if after <= before:
        return done._replace(state=replace(state, colours=colours._replace(refined=True)))
    state = replace(state, colours=colours._replace(projection=fisher, refined=True), search=SearchState())
    return done._replace(state=state)


def told(done: Step[TrackState], before: Colours) -> Step[TrackState]:
    """The step with an event where the discs are seen in other colours than `before`."""
    projection = done.state.colours.projection
    if projection == before.projection:
        return done
    return done._replace(events=(DiscColours(projection.weights), *done.events))
