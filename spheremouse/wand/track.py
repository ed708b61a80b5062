"""Tracking of hand-held balls: one frame in, the pose of each ball out (Grzonka 2005, section 3.4 and outlook 5.2).

The stages of a frame: select colours; find the likelihood's peaks near the prediction, else from spots, else in the
whole picture; draw particles, weigh them, average, resample.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array, exp
from spheremouse.tracker import MAX_REPEATS, Event, Frame, Status, Step, sampled_rows
from spheremouse.wand.colour import Fields, picture_colours
from spheremouse.wand.estimate import estimate, measured_pose
from spheremouse.wand.events import (
    BallHidden,
    SecondBall,
    missing_ball,
    second_ball_unconfirmed,
    update_colour_problem,
    update_second_ball,
)
from spheremouse.wand.likelihood import Peak, disc_weights, log_likelihood, outline_log_likelihood
from spheremouse.wand.model import Model
from spheremouse.wand.motions import (
    limit_covariance,
    max_acceleration,
    motion_probabilities,
    possible_motions,
    random_walk_covariance,
)
from spheremouse.wand.particles import (
    MotionMixture,
    Particles,
    PeakMixture,
    effective_number,
    low_variance_indices,
    mean_pose,
    move,
    normalise,
    propose,
    regularised_covariance,
    resample,
    resample_degenerate,
    scatter,
)
from spheremouse.wand.peaks import (
    CERTAIN_MATCH,
    Modes,
    Scene,
    SearchContext,
    determines_pose,
    fields_near,
    is_ball,
    merge_modes,
    modes_from_spots,
    modes_without_prior,
    proposals,
    refine_modes,
    search_picture,
)
from spheremouse.wand.pose_velocity import GATE, PoseVelocityState, initialise, pose_difference, predict, update
from spheremouse.wand.state import EXPOSURE_PRIOR, EXPOSURES, LENS_BLURS, Track, WandPose, WandState, WandTracker

_MIN_FRAMES_BETWEEN_SEARCHES = 15  # of the whole picture: a slow camera leaves no time for more
_DOUBTFUL_SUPPORT = 0.8  # below, spots are tried besides the prediction
# since the frame before, the same: clear views differ by less, and a ball that turns fast shows most of a wrong pose
_MAX_SUPPORT_LOSS = 0.05
_FRACTION_WITHOUT_PEAKS = 0.1  # fraction of the particles drawn without the peaks
_SAME_SIDE = 0.3  # rad from a peak: the same discs show, each by the same area to a tenth
_PREDICTED_POSES = 48  # predicted particles that are tried
_REFINED_PREDICTIONS = 2  # best predicted poses that are refined to peaks
_REFINED_HYPOTHESES = 6  # best poses by spots that are refined to peaks
_EXPOSURE_PERSISTENCE = 0.9  # part of an exposure's log-likelihood that the next frame inherits: some ten frames count
_REPORT_AGE = 1.0 - 1e-6  # of a colour problem: the parts of a second that frames add up to are inexact
_KNOWN_POSE_COVARIANCE = np.diag([0.02**2] * 2 + [0.05**2] + [0.1**2] * 3)  # m², rad²


def begin(
    tracker: WandTracker, seed: int = 0, stamp: float = 0.0, poses: dict[int, tuple[Array, Array]] | None = None
) -> WandState:
    """Return the state before the first frame, at `stamp` (s).

    `poses` has known positions (3,) m in cam and R_cam_ball (3, 3) by ball index.
    """
    rng = np.random.default_rng(seed)
    tracks = []
    for i in range(len(tracker.balls)):
        track = Track()
        if poses and i in poses:
            pose = *poses[i], _KNOWN_POSE_COVARIANCE
            particles = scatter(*pose, tracker.settings.particles, rng)
            track = Track(Status.TRACKING, particles, pose, initialise(stamp, *pose), stamp=stamp, seen=stamp)
        tracks.append(track)
    return WandState(tuple(tracks), seed=seed)


def step(state: WandState, frame: Frame, tracker: WandTracker) -> Step[WandState]:
    """Track all balls through one frame.

    The estimate is that of the ball `tracker.points`, and the state has those of all balls. Equal frames and seeds give
    equal poses.

    A camera that has no new picture in time may give its last one again, with a new stamp. That would show that a ball
    stands. At most two such frames in a row are predictions.
    """
    rows = sampled_rows(frame.image)
    if rows == state.rows and state.repeats < MAX_REPEATS and any(t.phase == Status.TRACKING for t in state.tracks):
        return _repeated(state, frame.stamp, tracker)
    state = replace(state, rows=rows, repeats=0)
    image = np.ascontiguousarray(
        frame.image if frame.image.ndim == 3 else np.repeat(frame.image[:, :, None], 3, axis=2)
    )
    rng = np.random.default_rng((state.seed, frame.sequence))
    scene = Scene(image, tracker, picture_colours(image, tracker.colours, tracker.names))
    tracks, poses = list(state.tracks), []
    since_search = frame.stamp - state.last_search
    due = since_search >= tracker.settings.look_around and state.frames_since_search >= _MIN_FRAMES_BETWEEN_SEARCHES
    for i, track in enumerate(state.tracks):
        others = [
            t.pose[0] + t.velocity[:3] * (frame.stamp - t.stamp)  # predicted, until this frame is measured
            for j, t in enumerate(tracks)
            if j != i and t.pose is not None and t.phase == Status.TRACKING
        ]
        context = SearchContext(scene, i, others, _lens_blur(track, frame.sequence))
        tracks[i], pose = tracker.follow(track, frame.stamp, context, due, rng)
        if isinstance(pose.event, SecondBall) and len(others) < len(tracks) - 1:
            pose = replace(pose, event=None)  # it can be a declared ball that is not tracked yet
        poses.append(pose)
        tracks[i] = replace(tracks[i], measured=measured_pose(track.measured, pose, frame.stamp))
    after = replace(
        update_colour_problem(state, frame.stamp, scene, tracks),
        tracks=tuple(tracks),
        last_search=frame.stamp if scene.searched else state.last_search,
        frames_since_search=0 if scene.searched else state.frames_since_search + 1,
    )
    problem = after.colour_problem
    some_missing = any(t.phase != Status.TRACKING for t in (*state.tracks, *tracks))  # now or before this frame
    if problem and (some_missing or after.colour_problem_age > _REPORT_AGE):
        poses = [replace(p, event=problem) if not p.event or p.phase != Status.TRACKING else p for p in poses]
    both = zip(state.tracks, tracks, poses, strict=True)
    estimates = tuple(estimate(old.measured, new, pose, frame.stamp, state.frames) for old, new, pose in both)
    known = {pose.event for pose in state.poses}
    events = dict.fromkeys(pose.event for pose in poses if pose.event is not None and pose.event not in known)
    after = replace(after, poses=tuple(poses), estimates=estimates, frames=state.frames + 1)
    return Step(after, estimates[tracker.points], tuple(events))


def _repeated(state: WandState, stamp: float, tracker: WandTracker) -> Step[WandState]:
    """Process a frame that shows the last picture again. The tracks go on from the frame before."""
    poses, estimates = [], []
    for track, pose in zip(state.tracks, state.poses, strict=True):
        if track.phase == Status.TRACKING and track.pose_velocity is not None:
            ahead = predict(track.pose_velocity, stamp, max_acceleration(tracker.settings))
            place = {"position": ahead.position, "rotation": ahead.rotation, "covariance": ahead.covariance[:6, :6]}
            poses.append(replace(pose, seen=False, **place))
        else:
            poses.append(pose)
        estimates.append(estimate(track.measured, track, poses[-1], stamp, state.frames))
    after = replace(state, poses=tuple(poses), estimates=tuple(estimates), frames=state.frames + 1)
    return Step(replace(after, repeats=state.repeats + 1), estimates[tracker.points], ())


def _lens_blur(track: Track, sequence: int) -> Array:
    """Return the blur of the lens for the ball, (c,) or () px. A search tries another one in every other frame."""
    if track.phase == Status.TRACKING or sequence % 2 == 0:
        return track.lens_blur
    return LENS_BLURS[sequence // 2 % len(LENS_BLURS)]


def follow(
    track: Track, stamp: float, context: SearchContext, search_due: bool, rng: np.random.Generator
) -> tuple[Track, WandPose]:
    """Track one ball through one frame. `search_due` asks for a search of the whole picture."""
    particles, pose_velocity = track.particles, track.pose_velocity
    if track.phase != Status.TRACKING or particles is None or pose_velocity is None:
        return acquire(track, stamp, context, rng)
    s, radius = context.tracker.settings, context.ball.radius
    dt = max(stamp - track.stamp, 1e-4)
    motions = possible_motions(track, dt, context.tracker)
    modes = _modes_near_prediction(track, motions, fields_near(track, motions, context), context, rng)
    event = None
    if not is_ball(modes, s) or search_due or second_ball_unconfirmed(track):
        far = search_picture(context, track.next_spot)
        track = replace(track, next_spot=far.next_spot)
        modes = merge_modes(modes, _gate(far, track, motions, context), radius)
        first = modes.peaks[0].position if is_ball(modes, s) else None
        track, event = update_second_ball(track, far, first, dt, context)
    if not is_ball(modes, s):
        return _predict_hidden(track, stamp, dt, context, rng, modes)
    assert modes.fields is not None
    average = _filter(particles, motions, modes, context.model, s.particles, rng)
    peak = average.peak
    covariance = limit_covariance(peak.covariance)
    pose_velocity = update(pose_velocity, stamp, peak.position, peak.rotation, covariance, max_acceleration(s))
    after = replace(
        track,
        phase=Status.TRACKING,
        particles=resample_degenerate(average.particles, rng),
        pose=average.pose,
        pose_velocity=pose_velocity,
        motion_probability=motion_probabilities(track, average.pose, motions),
        stamp=stamp,
        seen=stamp,
        unseen_frames=0,
        measurement_covariance=covariance,
        support=float(modes.support[0]),
        exposure_log_likelihood=_exposure_log_likelihood(track, pose_velocity.velocity, peak, modes, context.model),
        lens_blur=modes.fields.learnt_lens_blur(peak.rims, _speed(pose_velocity, context)),
    )
    return after, _measured_pose(average, modes, context, event)


def _speed(of: PoseVelocityState, context: SearchContext) -> float:
    """Return px/s by which the fastest points of a ball move in the picture, at most."""
    surface = np.linalg.norm(of.velocity[:3]) + context.ball.radius * np.linalg.norm(of.velocity[3:])
    return float(surface * context.tracker.camera.fx / of.position[2])


def acquire(track: Track, stamp: float, context: SearchContext, rng: np.random.Generator) -> tuple[Track, WandPose]:
    """Search the whole picture at `stamp` (s) for a ball without a pose and draw particles from the peaks."""
    s, ball = context.tracker.settings, context.ball
    modes = search_picture(context, track.next_spot)
    track = replace(track, next_spot=modes.next_spot)
    modes = modes_without_prior(modes, context)
    if not is_ball(modes, s):
        match = float(modes.match[0]) if modes.peaks else 0.0
        missing = WandPose.unknown(ball.name, track.phase, missing_ball(ball, track.seen), match)
        return replace(track, stamp=stamp), missing
    assert modes.fields is not None
    peaks = proposals(modes)
    weight, _ = normalise(peaks.log_mass)
    which = low_variance_indices(weight, s.particles, rng.random())
    root = np.linalg.cholesky(peaks.covariance)
    d = np.einsum("nij,nj->ni", root[which], rng.standard_normal((s.particles, 6)))
    position, rotation = peaks.position[which] + d[:, :3], exp(d[:, 3:]) @ peaks.rotation[which]
    value = _log_likelihoods(position, rotation, which, which, modes, context.model)
    log_proposal = -0.5 * np.einsum("ni,nij,nj->n", d, np.linalg.inv(peaks.covariance)[which], d)
    weight, _ = normalise(value - log_proposal - modes.log_likelihood[which])
    average = _average(Particles(position, rotation, weight), which, modes)
    peak = average.peak
    after = Track(
        Status.TRACKING,
        resample(average.particles, s.particles, rng),
        average.pose,
        initialise(stamp, peak.position, peak.rotation, peak.covariance),
        measurement_covariance=limit_covariance(peak.covariance),
        stamp=stamp,
        seen=stamp,
        exposure_log_likelihood=track.exposure_log_likelihood,
        lens_blur=modes.fields.learnt_lens_blur(peak.rims, None),
    )
    after, event = update_second_ball(after, modes, modes.peaks[0].position, 0.0, context)
    return after, _measured_pose(average, modes, context, event)


@dataclass(frozen=True, slots=True)
class _Average:
    """Weighted particles and their mean."""

    particles: Particles
    pose: tuple[Array, Array, Array]  # position, rotation, covariance
    effective: float  # number of particles
    peak: Peak  # that most of the weight is nearest to


def _measured_pose(average: _Average, modes: Modes, context: SearchContext, event: Event | None) -> WandPose:
    match = float(modes.match[0])
    return WandPose(context.ball.name, *average.pose, Status.TRACKING, event, match, average.effective, seen=True)


def _filter(
    particles: Particles, motions: MotionMixture, modes: Modes, m: Model, count: int, rng: np.random.Generator
) -> _Average:
    """Draw `count` particles from motions and peaks, weigh and average them."""
    peaks = proposals(modes)
    drawn, log_ratio, nearest = propose(particles, motions, peaks, _FRACTION_WITHOUT_PEAKS, count, rng)
    weighted_as = _weighted_as(drawn, peaks, nearest)
    value = _log_likelihoods(drawn.position, drawn.rotation, nearest, weighted_as, modes, m)
    weight, _ = normalise(log_ratio + value)
    return _average(Particles(drawn.position, drawn.rotation, weight), nearest, modes)


def _average(particles: Particles, nearest: NDArray[np.int64], modes: Modes) -> _Average:
    """Return the mean pose of particles with its covariance, and the peak with most weight."""
    count = effective_number(particles.weight)
    p, R, sample = mean_pose(particles)
    peak = modes.peaks[int(np.bincount(nearest, particles.weight).argmax())]
    return _Average(particles, (p, R, regularised_covariance(sample, count, peak.covariance)), count, peak)


def _log_likelihoods(
    position: Array, rotation: Array, nearest: NDArray[np.int64], weighted_as: NDArray[np.int64], modes: Modes, m: Model
) -> Array:
    """Return log-likelihood ratios of n poses, (n,), with the outline as measured at the `nearest` peak of each.

    The discs have the weights that they have at the peak `weighted_as`, (n,), or at the pose itself for -1.
    """
    assert modes.fields is not None
    f = modes.fields.factor
    fixed = disc_weights(modes.position, modes.rotation, m, f), weighted_as
    value, _ = log_likelihood(position, rotation, m, modes.fields, fixed_weights=fixed)
    return value + outline_log_likelihood(position, nearest, np.array([k.edges for k in modes.peaks]), m, f)


def _weighted_as(particles: Particles, peaks: PeakMixture, nearest: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the nearest peak of each particle, (n,), or -1 if another side of the ball shows there."""
    trace = np.einsum("nij,nij->n", particles.rotation, peaks.rotation[nearest])
    return np.where(trace > 1.0 + 2.0 * np.cos(_SAME_SIDE), nearest, -1)


def _exposure_log_likelihood(track: Track, velocity: Array, peak: Peak, modes: Modes, m: Model) -> Array:
    """Return the log-likelihood of each of `EXPOSURES` after a frame, less the greatest one: (n,).

    A moving rim is selected elsewhere than a resting one, by a distance that grows with the exposure. `velocity`, (6,)
    m/s, rad/s, is that of the frame. Automatic exposure changes, so earlier frames fade. To save time, each frame
    compares the likeliest exposure with a shorter one and two longer ones.
    """
    assert modes.fields is not None
    pose = peak.position[None], peak.rotation[None]
    value = EXPOSURE_PRIOR + _EXPOSURE_PERSISTENCE * (track.exposure_log_likelihood - EXPOSURE_PRIOR)
    best = int(np.argmax(value))
    near = np.arange(max(best - 1, 0), min(best + 3, len(EXPOSURES)))
    blurred = (replace(modes.fields, exposure_motion=EXPOSURES[k] * velocity) for k in near)
    gain = np.array([log_likelihood(*pose, m, fields)[0][0] for fields in blurred])
    value[near] += gain - gain[near == best]
    return value - np.max(value)


def _modes_near_prediction(
    track: Track, motions: MotionMixture, fields: Fields, context: SearchContext, rng: np.random.Generator
) -> Modes:
    """Return the peaks of the likelihood near predicted poses that `_gate` accepts, the best one first; perhaps none.

    The predictions are one pose for each motion, and particles of the track. If the best peak is doubtful, the peaks
    that start from the spots of the region are added, which takes longer.
    """
    assert track.particles is not None
    assert track.pose is not None
    ahead = move(resample(track.particles, _PREDICTED_POSES, rng), motions, rng)
    p, R, _ = track.pose
    position = np.concatenate([p + motions.shift[:, :3], ahead.position])
    rotation = np.concatenate([exp(motions.shift[:, 3:]) @ R, ahead.rotation])
    modes = refine_modes(position, rotation, _REFINED_PREDICTIONS, context, fields, near=True)
    modes = _gate(modes, track, motions, context)
    if (
        not is_ball(modes, context.tracker.settings)
        or modes.match[0] < CERTAIN_MATCH
        or modes.support[0] < max(_DOUBTFUL_SUPPORT, track.support - _MAX_SUPPORT_LOSS)
    ):
        near = _gate(modes_from_spots(context, fields, _REFINED_HYPOTHESES), track, motions, context)
        modes = merge_modes(modes, near, context.ball.radius)
    return modes


def _gate(modes: Modes, track: Track, motions: MotionMixture, context: SearchContext) -> Modes:
    """Keep peaks that the ball can have moved to and that determine the pose, and others that pass without a prior.

    A sudden start explains nearly any pose. If the ball is hidden, only other things in its colours are left in view.
    """
    assert track.pose is not None
    p, R, covariance = track.pose
    kept, elsewhere = [], []
    for i, k in enumerate(modes.peaks):
        displacement = pose_difference(p, R, k.position, k.rotation)
        d2 = [
            (displacement - d) @ np.linalg.solve(S + covariance, displacement - d)
            for d, S in zip(motions.shift[:2], motions.covariance[:2], strict=True)
        ]
        (kept if min(d2) < GATE and determines_pose(k, modes, context) else elsewhere).append(i)
    passed = modes_without_prior(modes.select(elsewhere), context).peaks
    return modes.select([i for i, k in enumerate(modes.peaks) if i in kept or any(k is other for other in passed)])


def _predict_hidden(
    track: Track, stamp: float, dt: float, context: SearchContext, rng: np.random.Generator, modes: Modes
) -> tuple[Track, WandPose]:
    """Return the track and the pose to report after a frame that does not show a tracked ball.

    For `lost_after` s after the last measurement, the particles spread by a random walk about the last pose, and the
    ball stays TRACKING with the event BallHidden. Then it is LOST, but not before its second frame without measurement.
    `stamp` s is that of the frame, and `dt` s the time since the frame before. `modes` are the rejected peaks; the pose
    reports the match of the best one.
    """
    assert track.particles is not None
    assert track.pose_velocity is not None
    s, ball = context.tracker.settings, context.ball
    frames = track.unseen_frames + 1
    match = float(modes.match[0]) if modes.peaks else 0.0
    if stamp - track.seen > s.lost_after and frames > 1:
        exposure = track.exposure_log_likelihood  # that of the camera, whatever it sees
        lost = Track(Status.LOST, stamp=stamp, seen=track.seen, exposure_log_likelihood=exposure)
        return lost, WandPose.unknown(ball.name, Status.LOST, missing_ball(ball, track.seen), match)
    walk = MotionMixture(
        shift=np.zeros((1, 6)), covariance=random_walk_covariance(dt, s)[None], probability=np.ones(1), birth=0.0
    )
    particles = move(track.particles, walk, rng)
    pose = mean_pose(particles)
    after = replace(
        track,
        particles=particles,
        pose=pose,
        pose_velocity=predict(track.pose_velocity, stamp, max_acceleration(s)),
        measurement_covariance=np.zeros((6, 6)),  # no measurement
        stamp=stamp,
        unseen_frames=frames,
    )
    return after, WandPose(ball.name, *pose, Status.TRACKING, BallHidden(ball.name), match)
