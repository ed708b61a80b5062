"""The wand's use phase: one frame in, the pose of each ball out. The only place that knows the order of the stages.

Select colours, look for the likelihood's peaks (near the prediction, else by spots, else in the whole picture), draw
particles, weigh, resample, average (Grzonka 2005, section 3.4 and its outlook 5.2). Nothing here reads a clock.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array, exp
from spheremouse.tracker import Frame, Status
from spheremouse.wand import limb
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import DEFAULT_COLOURS, Fields, tone
from spheremouse.wand.complaints import complaint_of, doubtful, second_ball, turned_away, unseen
from spheremouse.wand.course import begun, between, measured, predicted, told
from spheremouse.wand.events import BallHidden, SecondBall
from spheremouse.wand.likelihood import counts, log_likelihood
from spheremouse.wand.model import Model, model
from spheremouse.wand.motions import (
    accelerations,
    limited,
    motion_probabilities,
    possible_motions,
    rest_covariance,
    search_region,
)
from spheremouse.wand.particles import (
    Motions,
    Particles,
    Peaks,
    effective,
    estimate,
    low_variance,
    moved,
    normalised,
    proposed,
    scatter,
    steadied,
)
from spheremouse.wand.peaks import (
    ELSEWHERE,
    HIDDEN_LEVEL,
    SURE,
    Found,
    Scene,
    SearchContext,
    accepted,
    as_peaks,
    from_spots,
    joined,
    passes_without_prior,
    refine_modes,
    search,
    some_peaks,
)
from spheremouse.wand.refine import Peak
from spheremouse.wand.rims import ColourSettings
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.state import Track, WandPose, WandState, WandTracker
from spheremouse.wand.thesis import REDRAW, by_motion, some

_LOOK_EVERY = 15  # frames at least between searches of the whole picture: a slow camera has no time for more
_DOUBT = 0.85  # of that level: below, the picture is searched for a better pose before this one is believed
_REACHED = 36.0  # d² of six standard deviations of a motion: farther, a ball is elsewhere
_REMEMBERED = 3.0  # s, the level of a ball that is lost: it may come back farther off, or half hidden
_NEAR_PEAK = 0.5  # of that level: a predicted pose that has as much lies on the flank of the right peak
_LEVEL_GAIN = 0.2  # the level follows the ball's turning within five frames
_BLIND = 0.1  # part of the particles that know nothing of the peaks
_ABOUT = 0.3  # rad about a peak: the same discs show, with as much of each to a tenth
_PREDICTED = 48  # predicted particles that are tried for a peak
_WORTH = 1.0 - 1e-6  # of a complaint: frames' parts of a second do not add up to one exactly


def build(
    camera: InteriorOrientation,
    balls: tuple[WandBall, ...],
    settings: WandSettings | None = None,
    colours: dict[str, ColourSettings] | None = None,
) -> WandTracker:
    """A tracker of balls before a camera."""
    discs = tuple(np.array([[*d.direction, d.angle] for d in ball.discs]) for ball in balls)
    names = tuple(sorted({c for ball in balls for c in ball.colours}))
    models = tuple(model(ball, camera, names) for ball in balls)
    return WandTracker(
        settings or WandSettings(), camera, balls, models, discs, DEFAULT_COLOURS | (colours or {}), names
    )


def begin(
    tracker: WandTracker, seed: int = 0, stamp: float = 0.0, poses: dict[int, tuple[Array, Array]] | None = None
) -> WandState:
    """The state before the first frame. `poses`: position and rotation of balls where they are known (by index)."""
    rng = np.random.default_rng(seed)
    tracks = []
    for i in range(len(tracker.balls)):
        track = Track()
        if poses and i in poses:
            p, R = poses[i]
            covariance = np.diag([0.02**2] * 2 + [0.05**2] + [0.1**2] * 3)
            cloud = scatter(p, R, covariance, tracker.settings.particles, rng)
            course = begun(stamp, p, R, covariance)
            track = Track(Status.TRACKING, cloud, (p, R, covariance), course, stamp=stamp, seen=stamp)
        tracks.append(track)
    return WandState(tuple(tracks), seed=seed)


def step(
    state: WandState, frame: Frame, tracker: WandTracker, command: Array | None = None
) -> tuple[WandState, tuple[WandPose, ...]]:
    """One frame. Gives the state after it and the pose of each ball.

    `command`, (6,) m/s and rad/s in cam axes, is a known velocity until this frame (a robot's), in place of the last
    one.
    """
    image = frame.image if frame.image.ndim == 3 else np.repeat(frame.image[:, :, None], 3, axis=2)
    rng = np.random.default_rng((state.seed, frame.sequence))
    scene = Scene(image, tracker, tone(image, tracker.colours, tracker.names))
    tracks, poses = list(state.tracks), []
    looked = frame.stamp - state.looked >= tracker.settings.look_around and state.waited >= _LOOK_EVERY
    complaint, worth, heard = state.complaint, state.worth, state.heard
    for i in range(len(tracks)):
        track = tracks[i]
        others = [
            t.pose[0] for j, t in enumerate(tracks) if j != i and t.pose is not None and t.phase == Status.TRACKING
        ]
        if command is not None and track.course is not None:
            track = replace(track, course=told(track.course, command, np.diag([1e-4] * 3 + [1e-3] * 3)))
        tracks[i], pose = _follow(track, frame.stamp, SearchContext(scene, i, others), looked, rng)
        if isinstance(pose.event, SecondBall) and len(others) < len(tracks) - 1:
            pose = replace(pose, event=None)  # it may be a declared one that is not found yet
        poses.append(pose)
    if scene.whole is not None:
        complaint, patience = complaint_of(scene.whole, turned_away(tracker, tracks))
        before, ago = (worth, frame.stamp - heard) if complaint == state.complaint else (0.0, 0.0)
        worth = before + ago / (patience * tracker.settings.look_around) if patience else 1.0
        heard = frame.stamp
    missing = [t for t in (*state.tracks, *tracks) if t.phase != Status.TRACKING]  # found at last: still worth a word
    if complaint and (missing or worth > _WORTH):
        poses = [replace(p, event=complaint) if not p.event or p.phase != Status.TRACKING else p for p in poses]
    around = scene.searched
    after = WandState(
        tuple(tracks),
        frame.stamp if around else state.looked,
        0 if around else state.waited + 1,
        complaint,
        worth,
        heard,
        state.seed,
    )
    return after, tuple(poses)


def _follow(
    track: Track, stamp: float, sought: SearchContext, look: bool, rng: np.random.Generator
) -> tuple[Track, WandPose]:
    """One ball, one frame; `look`: it is time to look around in the whole picture."""
    if track.phase != Status.TRACKING or track.particles is None:
        return _acquire(track, stamp, sought, rng)
    s, scene, radius = sought.tracker.settings, sought.scene, sought.ball.radius
    dt = max(stamp - track.stamp, 1e-4)
    motions = possible_motions(track, dt, sought.tracker)
    region, factor = search_region(track, motions, sought.tracker, radius)
    seen = scene.part(region if s.region else None, factor)
    if s.region is False and factor == 1:
        scene.whole = seen
    if s.proposal == "motion":
        return by_motion(track, stamp, motions, seen, sought, rng)
    found = _near_prediction(track, motions, seen, sought, rng)
    event = None
    if not accepted(found, s, track.level) or look or doubtful(track):
        far = search(sought, track.turn)
        track = replace(track, turn=far.turn)
        found = joined(found, _gate_by_motion(far, track, motions, sought), radius)
        first = found.peaks[0].position if accepted(found, s, track.level) else None
        track, event = second_ball(track, far, first, dt, sought)
    if not accepted(found, s, track.level):
        return _unseen(track, stamp, dt, sought, rng, found)
    assert track.particles is not None
    assert track.course is not None
    peaks = as_peaks(found)
    drawn, ratio, nearest = proposed(track.particles, motions, peaks, _BLIND, s.particles, rng)
    value = _values(drawn.position, drawn.rotation, nearest, _about(drawn, peaks, nearest), found, sought.model)
    weight, _ = normalised(ratio + value)
    particles = Particles(drawn.position, drawn.rotation, weight)
    pose, count, followed = _averaged(particles, nearest, found)
    if count < REDRAW * len(weight):
        particles = some(particles, len(weight), rng)
    wrong = limited(followed.covariance)  # what this picture has, as far as it says so
    after = replace(
        track,
        phase=Status.TRACKING,
        particles=particles,
        pose=pose,
        course=measured(track.course, stamp, followed.position, followed.rotation, wrong, accelerations(s)),
        motion=motion_probabilities(track, pose, motions),
        stamp=stamp,
        seen=stamp,
        unseen_frames=0,
        level=_level(track, found),
        repeats=wrong,
    )
    return after, WandPose(sought.ball.name, *pose, Status.TRACKING, event, float(found.match[0]), count, True)


def _near_prediction(
    track: Track, motions: Motions, seen: Fields, sought: SearchContext, rng: np.random.Generator
) -> Found:
    """Peaks that the ball can have moved to: from where it is predicted, and from spots where those leave a doubt."""
    assert track.particles is not None
    assert track.pose is not None
    ahead = moved(some(track.particles, _PREDICTED, rng), motions, rng)
    p, R, _ = track.pose
    position = np.concatenate([p + motions.shift[:, :3], ahead.position])
    rotation = np.concatenate([exp(motions.shift[:, 3:]) @ R, ahead.rotation])
    found = refine_modes(position, rotation, 2, sought, seen, sure=_NEAR_PEAK * track.level)
    found = _gate_by_motion(found, track, motions, sought)
    if (
        not accepted(found, sought.tracker.settings, track.level)
        or found.match[0] < SURE
        or found.log_likelihood[0] < _DOUBT * track.level
    ):
        near = _gate_by_motion(from_spots(sought, seen, 6), track, motions, sought)
        found = joined(found, near, sought.ball.radius)
    return found


def _values(
    position: Array, rotation: Array, nearest: NDArray[np.int64], about: NDArray[np.int64], found: Found, m: Model
) -> Array:
    """Log-likelihood ratios of n poses, (n,), each with the outline as measured at its `nearest` peak.

    `about` says by which peak's counts the discs count, -1 for the pose's own.
    """
    assert found.fields is not None
    f = found.fields.factor
    counted_as = counts(found.position, found.rotation, m, f), about
    value, _ = log_likelihood(position, rotation, m, found.fields, matches=False, counted_as=counted_as)
    limb.weigh(position, nearest, np.array([k.edges for k in found.peaks]), m.radius, m.lens, f, value)
    return value


def _averaged(
    particles: Particles, nearest: NDArray[np.int64], found: Found
) -> tuple[tuple[Array, Array, Array], float, Peak]:
    """Pose and covariance of weighted particles, their effective number, and the peak that most of them lie about."""
    count = effective(particles.weight)
    p, R, sample = estimate(particles)
    followed = found.peaks[int(np.bincount(nearest, particles.weight).argmax())]
    return (p, R, steadied(sample, count, followed.covariance)), count, followed


def _gate_by_motion(found: Found, track: Track, motions: Motions, sought: SearchContext) -> Found:
    """Of peaks, those that the ball can have moved to, or that are a ball and show as much of it as it did of late.

    One that starts all of a sudden is not half hidden as well: where a ball is hidden, other things of its colours are
    all that is left to see.
    """
    assert track.pose is not None
    p, R, covariance = track.pose
    reached, elsewhere = [], []
    for i, k in enumerate(found.peaks):
        way = between(p, R, k.position, k.rotation)
        gaps = [
            (way - d) @ np.linalg.solve(S + covariance, way - d)
            for d, S in zip(motions.shift, motions.covariance, strict=True)
        ]
        sudden = min(gaps[:2]) >= _REACHED
        if min(gaps) < _REACHED and not (sudden and found.log_likelihood[i] < HIDDEN_LEVEL * track.level):
            reached.append(i)
        elif found.log_likelihood[i] >= ELSEWHERE * track.level:
            elsewhere.append(i)
    balls = passes_without_prior(some_peaks(found, elsewhere), sought).peaks
    return some_peaks(found, [i for i, k in enumerate(found.peaks) if i in reached or any(k is b for b in balls)])


def _level(track: Track, found: Found) -> float:
    best = float(found.log_likelihood[0])
    return best if track.level == 0.0 else track.level + _LEVEL_GAIN * (best - track.level)


def _about(particles: Particles, peaks: Peaks, nearest: NDArray[np.int64]) -> NDArray[np.int64]:
    """The nearest peak of each particle, (n,); -1 where not even about that one the same side of the ball shows."""
    trace = np.einsum("nij,nij->n", particles.rotation, peaks.rotation[nearest])
    return np.where(trace > 1.0 + 2.0 * np.cos(_ABOUT), nearest, -1)


def _unseen(
    track: Track, stamp: float, dt: float, sought: SearchContext, rng: np.random.Generator, found: Found
) -> tuple[Track, WandPose]:
    """The ball does not show: the particles go on unweighted, for a while."""
    assert track.particles is not None
    assert track.course is not None
    s, ball = sought.tracker.settings, sought.ball
    frames = track.unseen_frames + 1
    match = float(found.match[0]) if found.peaks else 0.0
    if stamp - track.seen > s.lost_after and frames > 1:
        lost = Track(Status.LOST, stamp=stamp, seen=track.seen, level=track.level)
        return lost, WandPose(ball.name, None, None, None, Status.LOST, unseen(ball, track.seen), match)
    particles = moved(track.particles, Motions(np.zeros((1, 6)), rest_covariance(dt, s)[None], np.ones(1), 0.0), rng)
    pose = estimate(particles)
    after = replace(
        track,
        particles=particles,
        pose=pose,
        course=predicted(track.course, stamp, accelerations(s)),
        repeats=np.zeros((6, 6)),  # no picture, nothing that the next one repeats
        stamp=stamp,
        unseen_frames=frames,
    )
    return after, WandPose(ball.name, *pose, Status.TRACKING, BallHidden(ball.name), match)


def _acquire(track: Track, stamp: float, sought: SearchContext, rng: np.random.Generator) -> tuple[Track, WandPose]:
    """Find the ball in the whole picture: particles are injected at the peaks."""
    s, ball = sought.tracker.settings, sought.ball
    found = search(sought, track.turn)
    track = replace(track, turn=found.turn)
    found = passes_without_prior(found, sought)
    least = ELSEWHERE * track.level * np.exp(-(stamp - track.seen) / _REMEMBERED) if track.level else 0.0
    if not accepted(found, s) or found.log_likelihood[0] < least:
        match = float(found.match[0]) if found.peaks else 0.0
        missing = WandPose(ball.name, None, None, None, track.phase, unseen(ball, track.seen), match)
        return replace(track, stamp=stamp), missing
    peaks = as_peaks(found)
    share, _ = normalised(peaks.log_mass)
    which = low_variance(share, s.particles, rng.random())
    root = np.linalg.cholesky(peaks.covariance)
    d = np.einsum("nij,nj->ni", root[which], rng.standard_normal((s.particles, 6)))
    position, rotation = peaks.position[which] + d[:, :3], exp(d[:, 3:]) @ peaks.rotation[which]
    value = _values(position, rotation, which, which, found, sought.model)
    gaussian = -0.5 * np.einsum("ni,nij,nj->n", d, np.linalg.inv(peaks.covariance)[which], d)
    weight, _ = normalised(value - gaussian - found.log_likelihood[which])
    particles = Particles(position, rotation, weight)
    pose, count, followed = _averaged(particles, which, found)
    after = Track(
        Status.TRACKING,
        some(particles, s.particles, rng),
        pose,
        begun(stamp, followed.position, followed.rotation, followed.covariance),
        repeats=limited(followed.covariance),
        stamp=stamp,
        seen=stamp,
        level=float(found.log_likelihood[0]),
    )
    after, event = second_ball(after, found, found.peaks[0].position, 0.0, sought)
    return after, WandPose(ball.name, *pose, Status.TRACKING, event, float(found.match[0]), count, True)
