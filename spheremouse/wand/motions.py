"""Motion model of a hand-held ball between two frames, and the part of the picture that the ball can reach."""

import numpy as np

from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array
from spheremouse.wand.colour import Region, reduction_factor
from spheremouse.wand.particles import MotionMixture, normalise
from spheremouse.wand.pose_velocity import pose_difference, predicted_velocity_covariance
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.state import PRIOR_MOTION_PROBABILITY, Track, WandTracker

_THESIS_DT = 1.25  # s between the frames of the thesis' standard deviations (0.8 Hz)
_BIRTH_PROBABILITY = 1e-3  # per frame, of a ball at an arbitrary pose
_PERSISTENCE = 0.8  # part of a motion's probability that the next frame inherits
_REGION_MARGIN = 0.5  # radii about the ball, in addition to its motion
_MAX_SPREAD, _MARGIN_PX, _MIN_REGION_PX = 0.4, 8, 8  # of a region: m of motion, px around it, px of its sides
_MAX_PREDICTED_ANGLE = 2.5  # rad between two frames: a larger rotation is no prediction
_MAX_SIGMA = np.array([0.5] * 3 + [1.2] * 3)  # m, rad between two frames


def possible_motions(track: Track, dt: float, tracker: WandTracker) -> MotionMixture:
    """Return the motions over dt s: rest, constant velocity, sudden start; or a random walk alone (`adaptive`)."""
    s = tracker.settings
    if not s.adaptive:
        return random_walk(dt, tracker)
    assert track.pose_velocity is not None
    stamp = track.stamp + dt
    motion_covariance = dt**2 * predicted_velocity_covariance(track.pose_velocity, stamp, max_acceleration(s))
    start = np.array([min(0.01 + s.fastest * dt, 0.5)] * 3 + [min(0.05 + s.fastest_turn * dt, 1.2)] * 3)
    shift = np.zeros((3, 6))
    shift[1] = track.velocity * dt
    angle = np.linalg.norm(shift[1, 3:])
    if angle > _MAX_PREDICTED_ANGLE:
        shift[1, 3:] *= _MAX_PREDICTED_ANGLE / angle
    # errors of successive frames are correlated, so no prediction is better than one frame
    error = track.measurement_covariance
    covariance = np.stack(
        [random_walk_covariance(dt, s) + error, limit_covariance(motion_covariance + error), np.diag(start**2)]
    )
    return MotionMixture(shift, covariance, track.motion_probability * (1.0 - _BIRTH_PROBABILITY), _birth(tracker))


def random_walk(dt: float, tracker: WandTracker) -> MotionMixture:
    """Return the random walk over dt s (Grzonka 2005, chapter 4), with births."""
    covariance = random_walk_covariance(dt, tracker.settings)[None]
    return MotionMixture(np.zeros((1, 6)), covariance, np.array([1.0 - _BIRTH_PROBABILITY]), _birth(tracker))


def _birth(tracker: WandTracker) -> float:
    """Return the probability of birth times its density in view, per m³ and rad³."""
    camera, s = tracker.camera, tracker.settings
    volume = camera.width * camera.height / (camera.fx * camera.fy) * (s.farthest**3 - s.nearest**3) / 3.0
    return _BIRTH_PROBABILITY / (volume * 8.0 * np.pi**2)


def random_walk_covariance(dt: float, s: WandSettings) -> Array:
    """Return the covariance of the random walk over dt s, (6, 6) m², rad²."""
    walk = np.array([s.sigma_x, s.sigma_y, s.sigma_z, s.sigma_pitch, s.sigma_yaw, s.sigma_roll])
    return np.diag(walk**2 * (dt / _THESIS_DT))


def max_acceleration(s: WandSettings) -> Array:
    """Return the greatest acceleration of a hand, (6,) m/s², rad/s²."""
    return np.array([s.acceleration] * 3 + [s.turn_acceleration] * 3)


def limit_covariance(covariance: Array) -> Array:
    """Scale a covariance, (6, 6), so that no standard deviation exceeds 0.5 m or 1.2 rad."""
    scale = np.minimum(1.0, _MAX_SIGMA / np.sqrt(np.diag(covariance)))
    return covariance * np.outer(scale, scale)


def search_region(track: Track, motions: MotionMixture, tracker: WandTracker, radius: float) -> tuple[Region, int]:
    """Return the region (left, top, right, bottom px, the last two exclusive) in which the ball can be.

    It covers 3 sigma of rest and steady motion, at most 0.4 m. A ball that starts suddenly is left to the search of the
    whole picture. The second result is the factor by which to reduce the region.
    """
    assert track.pose is not None
    camera, (p, _, covariance) = tracker.camera, track.pose
    middle = p + motions.shift[:, :3]
    middle = middle[middle[:, 2] > radius]
    uv = project(middle if len(middle) else p[None], camera)[0]
    depth = max(float(p[2]), 2.0 * radius)
    without_start = motions.covariance[:2]
    spread = 3.0 * np.sqrt(np.max(np.diagonal(without_start, axis1=1, axis2=2)[:, :2]) + covariance[0, 0])
    reach = camera.fx * (radius * (1.0 + _REGION_MARGIN) + min(spread, _MAX_SPREAD)) / depth + _MARGIN_PX
    left, top = np.floor(np.min(uv, axis=0) - reach).astype(int)
    right, bottom = np.ceil(np.max(uv, axis=0) + reach).astype(int) + 1
    h, w = camera.height, camera.width
    left, top = min(max(left, 0), w - _MIN_REGION_PX), min(max(top, 0), h - _MIN_REGION_PX)
    region = (left, top, max(min(right, w), left + _MIN_REGION_PX), max(min(bottom, h), top + _MIN_REGION_PX))
    return region, reduction_factor(2.0 * camera.fx * radius / depth)


def motion_probabilities(track: Track, pose: tuple[Array, Array, Array], motions: MotionMixture) -> Array:
    """Return the probabilities of the motions after a measured pose, (3,), by Bayes' rule."""
    assert track.pose is not None
    if len(motions.probability) < len(PRIOR_MOTION_PROBABILITY):
        return track.motion_probability
    p, R, covariance = track.pose
    displacement = pose_difference(p, R, *pose[:2])
    log_fit = np.empty(3)
    for m in range(3):
        S = motions.covariance[m] + pose[2] + covariance
        d = displacement - motions.shift[m]
        log_fit[m] = np.log(motions.probability[m]) - 0.5 * (d @ np.linalg.solve(S, d) + np.linalg.slogdet(S)[1])
    posterior, _ = normalise(log_fit)
    return _PERSISTENCE * posterior + (1.0 - _PERSISTENCE) * PRIOR_MOTION_PROBABILITY
