"""The ball's centre in its bearings: how discs and outline show that it moves.

In a good bearing the centre stays in its place, or where the first seconds showed it, and costs nothing. The centre of
an eccentric ball moves as it turns, and the filter estimates its place on the ball. If a shift of
the centre explains places of discs that a rotation does not explain, or if the ball's outline leaves its place, the
filter lets the centre move, as far as it has moved lately. From then on it uses the outline of each frame
(`seen_centre`), since discs alone confuse a shift across the line of sight with a turn. If discs do not fit while the
outline stays, a length in the rig is wrong. A ball that is far from its usual place is lifted.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from spheremouse.ball import centre_offset
from spheremouse.ball.centre_offset import CentreOffset, KnownDiscs
from spheremouse.ball.events import BallLost, OutOfRound, Why
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_eccentric import as_eccentric
from spheremouse.ball.filters.so3_motion import CLONE_DIM
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS
from spheremouse.ball.filters.so3_state import CENTRE, So3State, delays
from spheremouse.ball.phases.filter_again import filtered_again, relative_shift
from spheremouse.ball.phases.follow import follow
from spheremouse.ball.phases.seen_centre import LARGE_NIS, RESTS, correct_by_outline, with_doubtful_turn
from spheremouse.ball.state import (
    BufferedFrame,
    CentreCheck,
    Events,
    Learning,
    Lost,
    Tracker,
    Tracking,
    TrackState,
    lost,
)
from spheremouse.geometry.rotation import rotation_between

# Filters a frame: the state before it, its stamp, the tracker, and the prediction
Follow = Callable[[TrackState[So3State], float, Tracker[So3Filter], So3State], TrackState[So3State]]

MAX_DRIFT = 5e-3  # rad, of the place of a disc that was found while the centre moved unseen
_MIN_CENTRE_NOISE = 1e-3  # radii/sqrt(s), least noise of a centre that has moved
_NOISE_TIME_S = 0.4  # time constant of the estimate of that noise
# mean squared Mahalanobis distance above which the centre is off its place; in it, at most 3 are expected
_MAX_MEAN_NIS = 4.0
_EVIDENCE_TIME_S = 0.3  # time constant of that mean; hands and struts spoil a disc for less
_NEGLIGIBLE_NIS = 0.1  # of that mean
_MAX_FRAME_NIS = 40.0  # largest squared Mahalanobis distance that one frame adds to that mean
_MIN_LOG_ODDS = 9.0  # nats, odds of 8000 to 1 for a wrong length in the rig
_MAX_FRAME_LOG_ODDS = 3.0  # nats, largest contribution of one frame: a false pair is no proof
# rad, turn after which a wrong place of the centre would have shown: a quarter of the visible side is new
PROOF_ROTATION = 0.5
_MIN_PAIRS = 5  # of discs, for an estimate of the centre: with three any shift fits, with four nearly
_PROOF_SIGMA = 0.002  # radii, standard deviation of the shift with which a frame counts in full for that proof
_ECCENTRIC_CHECK_S = 0.2  # between tests for an eccentric ball
_HOME_TIME_S = 3.0  # time constant of the usual place
_MAX_INTERVAL_S = 0.1  # the longest time that one frame counts for
# times the shift in radii: a shift across the line of sight looks like a turn by as much, before noise
_MAX_TURN_BY_SHIFT = 3.0


def check_learning(
    before: TrackState[So3State], state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[TrackState[So3State], Events]:
    """Check the centre in a frame before the ball has turned; `before` is the state before that frame.

    If it is off, filter the kept frames again. While the outline stays, a length in the rig may be wrong. If the centre
    is then farther off than lengths by tape explain, the ball moves along the line of sight. If the attitude turns by
    more than a shift explains, the frames show something else, such as spots on a hand, and the centre stays.
    """
    views = state.phase.views if isinstance(state.phase, Learning) else ()
    if not views or views[-1].camera != state.camera:
        return state, ()
    (check, _), outline = _update_evidence(state, interval(before, stamp), tracker), state.outline
    moves = outline.has_moved or _is_refuted(state, tracker)
    if check.evidence <= _MAX_MEAN_NIS and not moves:
        return state._replace(centre=check), ()
    again = _learnt_again(state, views, tracker, wrong_rig=not moves)
    if _is_refuted(again, tracker):
        again = _learnt_again(state, views, tracker, wrong_rig=False)
    turn = rotation_between(state.filter.attitude, again.filter.attitude)
    shift = relative_shift(again.filter.rig_error - views[0].points.rig_error, tracker)
    if np.linalg.norm(turn) > _MAX_TURN_BY_SHIFT * shift:
        return state._replace(centre=check._replace(evidence=0.0), outline=outline.again(outline.first)), ()
    return again, () if check.moved else (OutOfRound(),)


def _is_refuted(state: TrackState[So3State], tracker: Tracker[So3Filter]) -> bool:
    """Return whether wrong lengths, by which the centre was thought to be off, do not explain how far it is off."""
    return state.centre.wrong_rig and tracker.filter.is_beyond_a_tape(state.filter, state.outline.size_sigma)


def _learnt_again(
    state: TrackState[So3State], views: tuple[BufferedFrame, ...], tracker: Tracker[So3Filter], *, wrong_rig: bool
) -> TrackState[So3State]:
    """Return the state after filtering the kept frames again, with a wrong rig or a centre that moves, or both.

    A centre that moves along the line of sight begins at home: the estimate of a wrong rig is not its place.
    """
    outline, home = state.outline, tracker.filter.initial(views[0].stamp, views[0].attitude).rig_error
    if not (wrong_rig and outline.is_in_place):
        filtered = state.filter if outline.has_moved else state.filter._replace(rig_error=home)
        state = state._replace(filter=tracker.filter.let_centre_move(filtered))
    state = state._replace(
        centre=CentreCheck(moved=True, wrong_rig=wrong_rig),
        outline=outline.again(outline.first if outline.is_in_place else None),
    )
    return filtered_again(state, np.zeros((0, 2)), views, tracker)


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
    no_doubt = state.centre.evidence < _NEGLIGIBLE_NIS and not _is_doubtful(state)
    if no_doubt and predicted.centre_noise == 0.0 and not state.outline.has_moved:
        return state, ()
    events = ()
    dt = interval(before, stamp)
    check, shift = _update_evidence(state, dt, tracker)
    check = _update_odds(check, state, dt, tracker, predicted)
    wrong = _has_wrong_rig(check) or _is_refuted(state, tracker)
    if check.evidence > _MAX_MEAN_NIS or wrong or state.outline.has_moved:
        events = () if check.moved else (OutOfRound(),)
        state, predicted = _filtered_with_shift(before, state._replace(centre=check), stamp, tracker, predicted)
        check = state.centre
    elif predicted.centre_noise > 0.0 and state.confirmed:
        state = with_learnt_noise(before, state, dt, tracker)
    if check.turned < PROOF_ROTATION:
        check = check._replace(home=state.filter.pivot, turned=check.turned + _proof(state, shift, dt, tracker))
        return state._replace(centre=check), events
    state, more = with_usual_place(state._replace(centre=check), stamp, dt, tracker, predicted)
    return state, (*events, *more)


def with_eccentricity(
    before: TrackState[So3State], state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> TrackState[So3State]:
    """Return the state of an eccentric ball if the frames show that it is one; `before` is that before the frame."""
    f = state.filter
    is_due = stamp // _ECCENTRIC_CHECK_S != before.filter.stamp // _ECCENTRIC_CHECK_S
    if not (is_due and state.confirmed and isinstance(state.phase, Tracking)) or f.speed < RESTS:
        return state
    eccentric = as_eccentric(f, tracker.rig.ball.radius)
    return state if eccentric is None else state._replace(filter=eccentric)


def with_usual_place(
    state: TrackState[So3State], stamp: float, dt: float, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[TrackState[So3State], Events]:
    """Return the state with the usual place of the centre after a frame. A ball far from that is lost: it was lifted.

    `predicted` is the filter's state predicted for the frame.
    """
    check, radius = state.centre, tracker.rig.ball.radius
    path = state.filter.pivot - check.home
    if float(path @ path) > (tracker.settings.loss.lifted * radius) ** 2:
        blind = tracker.filter.update(predicted, state.points, np.zeros(len(state.points), dtype=bool))
        blind = blind._replace(rig_error=np.append(blind.rig_error[:1], check.home), centre_noise=0.0)
        state = lost(state._replace(filter=blind), lifted_at=stamp)
        return state, (BallLost(Why.OFF_CENTRE, float(np.linalg.norm(path)), radii=radius == 1.0),)
    home = check.home + (1.0 - math.exp(-dt / _HOME_TIME_S)) * path
    return state._replace(centre=check._replace(home=home)), ()


def _filtered_with_shift(
    before: TrackState[So3State],
    state: TrackState[So3State],
    stamp: float,
    tracker: Tracker[So3Filter],
    predicted: So3State,
) -> tuple[TrackState[So3State], So3State]:
    """Return the state and the prediction for a frame with a wrong rig, a centre that moves, or both.

    `before` is the state before the frame, `state` that after it with a good bearing, and `predicted` the prediction
    with that.
    """
    check, outline = state.centre, state.outline
    in_doubt = check.turned < PROOF_ROTATION and not check.moved
    unproven = check.turned < PROOF_ROTATION
    static = in_doubt and not outline.has_moved and check.odds_static > 0.0
    wrong_rig = not outline.has_moved and (
        _has_wrong_rig(check)
        or (in_doubt and outline.is_in_place)
        or (static and len(state.filter.used) >= _MIN_PAIRS)  # a few discs do not decide, so both doubts remain
    )
    was_in_place = outline.away > 0  # until now, as the outline shows
    first = outline.first if wrong_rig or not unproven else None
    if wrong_rig or static:
        predicted = tracker.filter.with_rig_uncertainty(predicted, outline.size_sigma)
    if not wrong_rig:
        if unproven:
            drift = min(outline.drift / tracker.rig.ball.radius, MAX_DRIFT) if was_in_place else MAX_DRIFT
            predicted = with_doubtful_map(predicted, drift)
        outline_shift = before.outline.shift
        if outline_shift is not None:
            predicted = with_doubtful_turn(predicted, outline_shift, tracker)
        predicted = tracker.filter.let_centre_move(predicted)
        predicted = correct_by_outline(predicted, outline._replace(first=first))
    state = follow(before, stamp, tracker, predicted)
    turned = 0.0 if unproven else check.turned
    check = CentreCheck(moved=True, wrong_rig=wrong_rig, turned=turned, home=check.home)
    return state._replace(centre=check, outline=outline.again(first)), predicted


def back_on_bearings(
    state: TrackState[So3State], phase: Lost, filter_state: So3State, tracker: Tracker[So3Filter]
) -> bool:
    """Return whether a lifted ball turns about its centre again, at the attitude of its map."""
    if phase.lifted_at is None:
        return True
    shift = _shift(state, filter_state, tracker)
    if shift is None:
        return False
    shift = replace(shift, shift=shift.shift - (filter_state.centre - state.points.rig_error[1:]))
    return centre_offset.fits(shift, tracker.rig.ball.radius, tracker.settings.loss.lifted)


def interval(before: TrackState[So3State], stamp: float) -> float:
    """Return the time, s, that a frame counts for after the state before it."""
    return min(max(stamp - before.filter.stamp, 1e-3), _MAX_INTERVAL_S)


def _update_evidence(
    state: TrackState[So3State], dt: float, tracker: Tracker[So3Filter]
) -> tuple[CentreCheck, CentreOffset | None]:
    """Return the check after a frame, and the offset of the centre if the frame leaves a doubt."""
    check, f, squared, shift = state.centre, state.filter, 0.0, None
    if _is_doubtful(state):
        shift = _shift(state, f, tracker)
        if shift is None or shift.chi2_with_offset > centre_offset.MISFIT:  # these are no discs of this ball
            return check, None
        C = shift.covariance + f.centre_covariance
        squared = float(shift.shift @ np.linalg.solve(C, shift.shift)) / max(shift.chi2_with_offset, 1.0)
    return with_evidence(check, squared, dt), shift


def with_evidence(check: CentreCheck, squared: float, dt: float) -> CentreCheck:
    """Return the check after a frame in which the squared Mahalanobis distance of the centre is `squared`."""
    keep = math.exp(-dt / _EVIDENCE_TIME_S)
    return check._replace(evidence=keep * check.evidence + (1.0 - keep) * min(squared, _MAX_FRAME_NIS))


def _update_odds(
    check: CentreCheck, state: TrackState[So3State], dt: float, tracker: Tracker[So3Filter], predicted: So3State
) -> CentreCheck:
    """Return the check after a frame with the odds of a rig with a wrong length.

    The odds are fading sums, in nats, of log likelihood ratios of the pairs (Kass, Raftery 1995): a wrong radius or
    focal length against a right rig, and against a moving centre. A ball at rest shows no wrong length, since its discs
    keep their places.
    """
    f, used, keep = state.filter, len(state.filter.used), math.exp(-dt / _EVIDENCE_TIME_S)
    check = check._replace(odds=keep * check.odds, odds_static=keep * check.odds_static)
    rests, fits = f.speed <= RESTS, f.nis <= LARGE_NIS * used
    if check.turned >= PROOF_ROTATION or check.moved or rests or used < 2 or fits:
        return check
    stage, pairing = tracker.filter, tracker.filter.nearest_pairs(predicted, state.points)
    hypotheses = (
        stage.with_rig_uncertainty(predicted, state.outline.size_sigma),
        predicted,
        stage.let_centre_move(predicted),
    )
    wrong, right, moves = (stage.correct(each, state.points, pairing)[1] for each in hypotheses)
    return check._replace(
        odds=max(check.odds + min(wrong - right, _MAX_FRAME_LOG_ODDS), 0.0),
        odds_static=check.odds_static + min(max(wrong - moves, -_MAX_FRAME_LOG_ODDS), _MAX_FRAME_LOG_ODDS),
    )


def _has_wrong_rig(check: CentreCheck) -> bool:
    """Return whether a wrong length in the rig explains the frames better than a right rig or a moving centre."""
    return check.odds > _MIN_LOG_ODDS and check.odds_static > 0.0


def _is_doubtful(state: TrackState[So3State]) -> bool:
    """Return whether the last frame may show that the centre is off, or has to prove that it is not."""
    f, used = state.filter, len(state.filter.used)
    unproven = state.centre.turned < PROOF_ROTATION and f.speed > RESTS
    return unproven or f.nis > LARGE_NIS * used or used < len(state.points)


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
    if not state.confirmed or shift is None or shift.pairs < _MIN_PAIRS:
        return 0.0
    if not centre_offset.fits(shift, radius, lifted):
        return 0.0
    variance = shift.sigma**2 + float(np.trace(state.filter.centre_covariance))
    return state.filter.speed * dt * min(1.0, (_PROOF_SIGMA * radius) ** 2 / max(variance, 1e-18))


def with_doubtful_map(state: So3State, doubt: float) -> So3State:
    """Return the state with discs as far off, rad, as the centre has moved unseen while they were found."""
    joint, discs = state.joint.copy(), np.arange(state.map_row, len(state.joint) - CLONE_DIM)
    joint[discs, discs] += doubt**2
    return state._replace(joint=joint)


def with_learnt_noise(
    before: TrackState[So3State], state: TrackState[So3State], dt: float, tracker: Tracker[So3Filter]
) -> TrackState[So3State]:
    """Return the state after a frame with the noise of the centre that frames show; `before` is that before it."""
    least = (_MIN_CENTRE_NOISE * tracker.rig.ball.radius) ** 2
    noise = max(_learnt_noise(before.filter, state.filter, dt), least)
    return state._replace(filter=state.filter._replace(centre_noise=noise))


def _learnt_noise(before: So3State, filtered: So3State, dt: float) -> float:
    """Return the noise of the centre, m²/s, after a frame: the mean square of its steps given the frame.

    This is expectation and maximisation (Shumway and Stoffer 1982) with a memory of `_NOISE_TIME_S`.
    """
    q = before.centre_noise * dt
    P = before.joint[CENTRE, CENTRE] + q * np.eye(3)
    G = q * np.linalg.inv(P)
    step = G @ (filtered.pivot - before.pivot)
    C = q * np.eye(3) - G @ (P - filtered.joint[CENTRE, CENTRE]) @ G.T
    keep = math.exp(-dt / _NOISE_TIME_S)
    return keep * before.centre_noise + (1.0 - keep) * float(step @ step + np.trace(C)) / (3.0 * dt)
