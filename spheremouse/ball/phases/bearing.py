"""The ball's centre in its bearings: how discs and outline show that it moves.

In a good bearing the centre stays in its place, or where the first seconds showed it, and costs nothing. If a shift of
the centre explains places of discs that a rotation does not explain, or if the ball's outline leaves its place, the
filter lets the centre move, as far as it has moved lately. From then on it uses the outline of each frame, since discs
alone confuse a shift across the line of sight with a turn. If discs do not fit while the outline stays, a length in the
rig is wrong. A ball that is far from its usual place is lifted.
"""

import math
from dataclasses import replace

import numpy as np

from spheremouse.ball import centre_offset
from spheremouse.ball.centre_offset import CentreOffset, KnownDiscs
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.events import BallLost, OutOfRound, Why, WrongSize
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_motion import CLONE_DIM
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS
from spheremouse.ball.filters.so3_state import CENTRE, So3State, delays, with_seen_centre, with_uncertain_turn
from spheremouse.ball.outline import SeenCentre, seen_centre, size_error
from spheremouse.ball.phases.follow import follow
from spheremouse.ball.phases.learn import filtered_again
from spheremouse.ball.state import CentreCheck, Events, Learning, Lost, Tracker, TrackState, lost
from spheremouse.tracker import Status

_DOUBT = 5e-3  # rad, of a disc that was found while the centre moved unseen
_STEADY = 1e-3  # radii/sqrt(s), least noise of a centre that has moved
_NOISE_TIME_S = 0.4  # time constant of the estimate of that noise
_OFF = 4.0  # mean squared deviations of a centre that is off; at most 3 are expected of one in its place
_OFF_TIME_S = 0.3  # time constant of that mean; hands and struts spoil a disc for less
_NO_EVIDENCE = 0.1  # of that mean
_LARGE_NIS = 3.0  # for each disc, of two expected: more may be a shift
_MOST = 40.0  # squared deviations that a frame counts for in that mean
_CERTAIN = 9.0  # nats: odds of 8000 to 1
_MOST_NATS = 3.0  # that a frame counts for: a false pair is no proof
_PROVEN = 0.5  # rad: a quarter of the visible side has changed, so a wrong place would have shown
_PAIRS = 5  # discs that show a centre: with three any shift fits, with four nearly
_FITS = 0.002  # radii, standard deviation of the shift that a frame of that proof has
_HOME_TIME_S = 3.0  # time constant of the usual place
_RESTS = 0.05  # rad/s, below which a ball rests and shows nothing new
_CERTAIN_SIGMAS = 3.0  # of the outline's radius
_WATCHED = 1.0  # rad of play in which bearings show whether they are worn
_DOUBTFUL = 1.0  # mean squared deviations by the discs, from which the outline is measured
_MOVED_SIGMAS, _MOVED_FRAMES = 5.0, 2  # of the way of an outline, and frames in a row
_FRAME = 0.1  # s, the longest that one frame counts for


def with_size_of_outline(
    state: TrackState[So3State], image: Image, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Return the state before the first frame, `image`, with the radius that the ball's outline shows.

    If it differs from the rig's by more than the outline's error, one of them is wrong: the outline may be that of an
    opening before the ball. So the standard deviation of the radius is as large as the difference.
    """
    error, sigma = size_error(image, tracker.rig, tracker.pose)
    if abs(error) < _CERTAIN_SIGMAS * sigma:
        return state, ()
    stage = replace(tracker.filter, station=replace(tracker.filter.station, size_error=error))
    state = state._replace(filter=stage.with_station(state.filter), rebuilt=replace(tracker, filter=stage))
    return state, (WrongSize(error),)


def with_outline(
    state: TrackState[So3State], predicted: So3State, image: Image, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], So3State]:
    """Return state and prediction with the ball's centre by its outline in a frame.

    The outline is measured in the first frame, while the ball first turns, if discs cause a doubt, and while the
    centre moves.
    """
    check, moves = state.centre, predicted.centre_noise > 0.0
    speed = math.sqrt(float(state.filter.rate @ state.filter.rate))
    doubt = check.evidence > _DOUBTFUL or state.filter.nis > _LARGE_NIS * len(state.filter.used)
    watched = (speed > _RESTS and check.watched < _WATCHED) or doubt or state.frames == 0
    if predicted.others or not (moves or (watched and state.status is not Status.LOST)):
        return (state if check.seen is None else state._replace(centre=check._replace(seen=None))), predicted
    check = check._replace(watched=check.watched + speed * (predicted.stamp - state.filter.stamp))
    home = tracker.rig.ball.centre
    seen = seen_centre(image, tracker.rig, tracker.pose, home + predicted.centre)
    if seen is None:
        return state._replace(centre=check._replace(seen=None)), predicted
    seen = seen._replace(place=seen.place - seen.axes.T @ home)
    check = check._replace(seen=seen, first=seen if state.frames == 0 else check.first)
    if not moves and check.first is not None:
        check = _compared_with_first(check, seen, check.first)
    return state._replace(centre=check), _with_seen_centre(predicted, check) if moves else predicted


def _compared_with_first(check: CentreCheck, seen: SeenCentre, first: SeenCentre) -> CentreCheck:
    """Return the check with the way of the outline from its place in the first frame."""
    step, covariance = seen.place - first.place, seen.covariance + first.scatter
    if float(step @ np.linalg.solve(covariance, step)) > _MOVED_SIGMAS**2:
        return check._replace(away=check.away + 1)
    return check._replace(away=0, drift=max(check.drift, float(np.linalg.norm(step))))


def _is_in_place(check: CentreCheck) -> bool:
    """Return whether the outline of the last frame is where it was in the first."""
    return check.seen is not None and check.first is not None and check.away == 0


def _with_seen_centre(predicted: So3State, check: CentreCheck) -> So3State:
    """Return the state corrected by the centre of the outline. The first frame shows how shading shifts it."""
    seen, first = check.seen, check.first
    if seen is None:
        return predicted
    if first is None:
        return with_seen_centre(predicted, seen.place, seen.axes, seen.covariance)
    return with_seen_centre(predicted, seen.place - first.place, seen.axes, seen.scatter + first.scatter)


def check_learning(
    before: TrackState[So3State], state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Check the centre in a frame before the ball has turned; `before` is the state before that frame.

    If it moves, filter the kept frames again.
    """
    views = state.phase.views if isinstance(state.phase, Learning) else ()
    if not views or views[-1].camera != state.camera:
        return state, ()
    check, _ = _checked(state, _interval(before, stamp), tracker)
    moves = check.away >= _MOVED_FRAMES
    if check.evidence <= _OFF and not moves:
        return state._replace(centre=check), ()
    if not _is_in_place(check):
        state = state._replace(filter=tracker.filter.let_centre_move(state.filter))
    first = check.first if _is_in_place(check) else None
    state = state._replace(centre=CentreCheck(moved=True, wrong_rig=not moves, first=first))
    state = filtered_again(state, np.zeros((0, 2)), views, tracker)
    return state, () if check.moved else (OutOfRound(),)


def check_bearings(
    before: TrackState[So3State],
    state: TrackState[So3State],
    stamp: float,
    tracker: Tracker[So3Filter],
    predicted: So3State,
) -> tuple[TrackState[So3State], Events]:
    """Check the centre in a followed frame. `before` is the state before it, `predicted` the filter predicted for it.

    If the frame shows a shift, filter it again with an uncertain rig, a centre that moves, or both. If the centre is
    then too far from its usual place, report the ball lost.
    """
    moves = state.centre.away >= _MOVED_FRAMES
    no_doubt = state.centre.evidence < _NO_EVIDENCE and not _is_doubtful(state)
    if no_doubt and predicted.centre_noise == 0.0 and not moves:
        return state, ()
    radius, events = tracker.rig.ball.radius, ()
    dt = _interval(before, stamp)
    check, shift = _checked(state, dt, tracker)
    check = _compared(check, state, dt, tracker, predicted)
    refuted = check.wrong_rig and tracker.filter.is_beyond_a_tape(state.filter)
    if check.evidence > _OFF or _has_wrong_rig(check) or refuted or moves:
        events = () if check.moved else (OutOfRound(),)
        unproven = check.turned < _PROVEN
        static = unproven and not (check.moved or moves) and check.odds_static > 0.0
        stays = unproven and not check.moved and _is_in_place(check)
        wrong_rig = _has_wrong_rig(check) or stays or (static and len(state.filter.used) >= _PAIRS)
        wrong_rig = wrong_rig and not moves
        if wrong_rig or static:  # a few discs do not decide, so both doubts remain
            predicted = tracker.filter.with_rig_uncertainty(predicted)
        in_place = check.away > 0  # until now, as the outline shows
        first = check.first if wrong_rig or in_place or not unproven else None
        if not wrong_rig:
            doubt = min(check.drift / radius, _DOUBT) if in_place else _DOUBT
            predicted = _with_doubtful_map(predicted, doubt) if unproven else predicted
            predicted = _with_doubtful_turn(predicted, before.centre, tracker)
            predicted = tracker.filter.let_centre_move(predicted)
            predicted = _with_seen_centre(predicted, check._replace(first=first))
        state = follow(before, stamp, tracker, predicted)
        turned = 0.0 if unproven else check.turned
        check = CentreCheck(moved=True, wrong_rig=wrong_rig, turned=turned, home=check.home, first=first)
    elif predicted.centre_noise > 0.0 and state.confirmed:
        noise = max(_learnt_noise(before.filter, state.filter, dt), (_STEADY * radius) ** 2)
        state = state._replace(filter=replace(state.filter, centre_noise=noise))
    path = state.filter.centre - check.home
    if check.turned >= _PROVEN and float(path @ path) > (tracker.settings.loss.lifted * radius) ** 2:
        blind = tracker.filter.update(predicted, state.points, np.zeros(len(state.points), dtype=bool))
        blind = replace(blind, rig_error=np.append(blind.rig_error[:1], check.home), centre_noise=0.0)
        state = lost(state._replace(filter=blind, centre=check), lifted_at=stamp)
        return state, (*events, BallLost(Why.OFF_CENTRE, float(np.linalg.norm(path)), radii=radius == 1.0))
    if check.turned < _PROVEN:
        check = check._replace(home=state.filter.centre, turned=check.turned + _proof(state, shift, dt, tracker))
    else:
        check = check._replace(home=check.home + (1.0 - math.exp(-dt / _HOME_TIME_S)) * path)
    return state._replace(centre=check), events


def back_on_bearings(
    state: TrackState[So3State], phase: Lost, filter_state: So3State, tracker: Tracker[So3Filter]
) -> bool:
    """Return whether a lifted ball turns about its centre again, at the attitude of its map."""
    if phase.lifted_at is None:
        return True
    shift = _shift(state, filter_state, tracker)
    return shift is not None and centre_offset.fits(shift, tracker.rig.ball.radius, tracker.settings.loss.lifted)


def _interval(before: TrackState[So3State], stamp: float) -> float:
    """Return the time, s, that a frame counts for after the state before it."""
    return min(max(stamp - before.filter.stamp, 1e-3), _FRAME)


def _checked(
    state: TrackState[So3State], dt: float, tracker: Tracker[So3Filter]
) -> tuple[CentreCheck, CentreOffset | None]:
    """Return the check after a frame, and the offset of the centre if the frame leaves a doubt."""
    check, f, squared, shift = state.centre, state.filter, 0.0, None
    if _is_doubtful(state):
        shift = _shift(state, f, tracker)
        if shift is None or shift.chi2_with_offset > centre_offset.MISFIT:  # these are no discs of this ball
            return check, None
        C = shift.covariance + f.joint[CENTRE, CENTRE]
        squared = float(shift.shift @ np.linalg.solve(C, shift.shift)) / max(shift.chi2_with_offset, 1.0)
        squared = min(squared, _MOST)
    keep = math.exp(-dt / _OFF_TIME_S)
    return check._replace(evidence=keep * check.evidence + (1.0 - keep) * squared), shift


def _compared(
    check: CentreCheck, state: TrackState[So3State], dt: float, tracker: Tracker[So3Filter], predicted: So3State
) -> CentreCheck:
    """Return the check after a frame with the odds of a rig with a wrong length.

    The odds are fading sums, in nats, of log likelihood ratios of the pairs (Kass, Raftery 1995): a wrong radius or
    focal length against a right rig, and against a moving centre. A ball at rest shows no wrong length, since its discs
    keep their places.
    """
    f, used, keep = state.filter, len(state.filter.used), math.exp(-dt / _OFF_TIME_S)
    check = check._replace(odds=keep * check.odds, odds_static=keep * check.odds_static)
    rests, fits = float(f.rate @ f.rate) <= _RESTS**2, f.nis <= _LARGE_NIS * used
    if check.turned >= _PROVEN or check.moved or rests or used < 2 or fits:
        return check
    stage, pairing = tracker.filter, tracker.filter.nearest_pairs(predicted, state.points)
    hypotheses = stage.with_rig_uncertainty(predicted), predicted, stage.let_centre_move(predicted)
    wrong, right, moves = (stage.correct(each, state.points, pairing)[1] for each in hypotheses)
    return check._replace(
        odds=max(check.odds + min(wrong - right, _MOST_NATS), 0.0),
        odds_static=check.odds_static + min(max(wrong - moves, -_MOST_NATS), _MOST_NATS),
    )


def _has_wrong_rig(check: CentreCheck) -> bool:
    """Return whether a wrong length in the rig explains the frames better than a right rig or a moving centre."""
    return check.odds > _CERTAIN and check.odds_static > 0.0


def _is_doubtful(state: TrackState[So3State]) -> bool:
    """Return whether the last frame may show that the centre is off, or has to prove that it is not."""
    f, used = state.filter, len(state.filter.used)
    unproven = state.centre.turned < _PROVEN and float(f.rate @ f.rate) > _RESTS**2
    return unproven or f.nis > _LARGE_NIS * used or used < len(state.points)


def _shift(state: TrackState[So3State], filter_state: So3State, tracker: Tracker[So3Filter]) -> CentreOffset | None:
    """Return the offset of the ball's centre by the last frame's discs, with a filter's attitude and map."""
    sure = np.flatnonzero(filter_state.hits >= ESTABLISHED_HITS)
    variance = filter_state.joint.diagonal()[filter_state.map_row : -CLONE_DIM].reshape(-1, 2).mean(axis=1)[sure]
    discs = KnownDiscs(filter_state.discs[sure], variance, filter_state.attitude, filter_state.rate)
    delay = delays(state.points, filter_state)
    return centre_offset.shift_of(state.points, delay, discs, tracker.rig.ball.radius, 2.0 * tracker.filter.disc_angle)


def _proof(state: TrackState[So3State], shift: CentreOffset | None, dt: float, tracker: Tracker[So3Filter]) -> float:
    """Return by how much, rad, a frame proves that the ball turns about the centre."""
    radius, lifted = tracker.rig.ball.radius, tracker.settings.loss.lifted
    if not state.confirmed or shift is None or shift.pairs < _PAIRS or not centre_offset.fits(shift, radius, lifted):
        return 0.0
    speed = float(np.linalg.norm(state.filter.rate))
    variance = shift.sigma**2 + float(np.trace(state.filter.joint[CENTRE, CENTRE]))
    return speed * dt * min(1.0, (_FITS * radius) ** 2 / max(variance, 1e-18))


def _with_doubtful_map(state: So3State, doubt: float) -> So3State:
    """Return the state with discs as far off, rad, as the centre has moved unseen while they were found."""
    joint, discs = state.joint.copy(), np.arange(state.map_row, len(state.joint) - CLONE_DIM)
    joint[discs, discs] += doubt**2
    return replace(state, joint=joint)


def _with_doubtful_turn(state: So3State, before: CentreCheck, tracker: Tracker[So3Filter]) -> So3State:
    """Return the state with the turn that a shift looked like, by the outline of the frame before, as uncertain."""
    if before.seen is None or before.first is None:
        return state
    step = before.seen.axes @ (before.seen.place - before.first.place) / tracker.rig.ball.radius
    return with_uncertain_turn(state, np.cross(tracker.filter.station.towards, step))


def _learnt_noise(before: So3State, filtered: So3State, dt: float) -> float:
    """Return the noise of the centre, m²/s, after a frame: the mean square of its steps given the frame.

    This is expectation and maximisation (Shumway and Stoffer 1982) with a memory of `_NOISE_TIME_S`.
    """
    q = before.centre_noise * dt
    P = before.joint[CENTRE, CENTRE] + q * np.eye(3)
    G = q * np.linalg.inv(P)
    step = G @ (filtered.centre - before.centre)
    C = q * np.eye(3) - G @ (P - filtered.joint[CENTRE, CENTRE]) @ G.T
    keep = math.exp(-dt / _NOISE_TIME_S)
    return keep * before.centre_noise + (1.0 - keep) * float(step @ step + np.trace(C)) / (3.0 * dt)
