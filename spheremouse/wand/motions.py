"""How a hand moves a ball: what particles are drawn with."""

import numpy as np

from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array
from spheremouse.wand.colour import Region, reduction
from spheremouse.wand.course import between, speed_covariance
from spheremouse.wand.particles import (
    Motions,
    normalised,
)
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.state import MIXTURE, Track, WandTracker

_THESIS_DT = 1.25  # s between the frames to which the thesis' standard deviations belong (0.8 per second)
_BIRTH = 1e-3  # probability per frame that the ball is somewhere else altogether
_STAYS = 0.8  # part of a motion's probability that lives on to the next frame
_REACH = 0.5  # radii around the ball that the region of interest keeps free, besides the motion


def possible_motions(track: Track, dt: float, tracker: WandTracker) -> Motions:
    """Rest, go on, free, over dt."""
    s = tracker.settings
    rest = rest_covariance(dt, s)
    camera = tracker.camera
    volume = camera.width * camera.height / (camera.fx * camera.fy) * (s.farthest**3 - s.nearest**3) / 3.0
    birth = _BIRTH / (volume * 8.0 * np.pi**2)
    if not s.adaptive or s.proposal == "motion":
        return Motions(np.zeros((1, 6)), rest[None], np.array([1.0 - _BIRTH]), birth)
    assert track.course is not None
    on = dt**2 * speed_covariance(track.course, track.stamp + dt, accelerations(s))
    leap = np.array([min(0.01 + s.fastest * dt, 0.5)] * 3 + [min(0.05 + s.fastest_turn * dt, 1.2)] * 3)
    shift = np.zeros((3, 6))
    shift[1] = track.velocity * dt
    angle = np.linalg.norm(shift[1, 3:])
    if angle > 2.5:  # more between two frames is no prediction
        shift[1, 3:] *= 2.5 / angle
    # the next picture has wrong much of what the last one had: no prediction is better than a picture
    covariance = np.stack([rest + track.repeats, limited(on + track.repeats), np.diag(leap**2)])
    return Motions(shift, covariance, track.motion * (1.0 - _BIRTH), birth)


def rest_covariance(dt: float, s: WandSettings) -> Array:
    """Covariance of the random walk of a ball at rest, (6, 6)."""
    walk = np.array([s.sigma_x, s.sigma_y, s.sigma_z, s.sigma_pitch, s.sigma_yaw, s.sigma_roll])
    return np.diag(walk**2 * (dt / _THESIS_DT))


def accelerations(s: WandSettings) -> Array:
    return np.array([s.acceleration] * 3 + [s.turn_acceleration] * 3)


def limited(covariance: Array) -> Array:
    """A covariance whose standard deviations stay below what a motion may be: 0.5 m, 1.2 rad."""
    most = np.array([0.5] * 3 + [1.2] * 3)
    scale = np.minimum(1.0, most / np.sqrt(np.diag(covariance)))
    return covariance * np.outer(scale, scale)


def search_region(track: Track, motions: Motions, tracker: WandTracker, radius: float) -> tuple[Region, int]:
    """Where to look, and how much to reduce the picture there."""
    assert track.pose is not None
    camera, (p, _, covariance) = tracker.camera, track.pose
    middle = p + motions.shift[:, :3]
    middle = middle[middle[:, 2] > radius]
    uv = project(middle if len(middle) else p[None], camera)[0]
    depth = max(float(p[2]), 2.0 * radius)
    spread = 3.0 * np.sqrt(np.max(np.diagonal(motions.covariance[:2], axis1=1, axis2=2)[:, :2]) + covariance[0, 0])
    reach = camera.fx * (radius * (1.0 + _REACH) + min(spread, 0.4)) / depth + 8.0
    left, top = np.floor(np.min(uv, axis=0) - reach).astype(int)
    right, bottom = np.ceil(np.max(uv, axis=0) + reach).astype(int) + 1
    h, w = camera.height, camera.width
    left, top = min(max(left, 0), w - 8), min(max(top, 0), h - 8)
    region = (left, top, max(min(right, w), left + 8), max(min(bottom, h), top + 8))
    return region, reduction(2.0 * camera.fx * radius / depth)


def motion_probabilities(track: Track, pose: tuple[Array, Array, Array], motions: Motions) -> Array:
    """Probabilities of the motions after a frame, (3,), by Bayes' rule."""
    assert track.pose is not None
    if len(motions.probability) < 3:
        return track.motion
    p, R, covariance = track.pose
    way = between(p, R, *pose[:2])
    fit = np.empty(3)
    for m in range(3):
        S = motions.covariance[m] + pose[2] + covariance
        d = way - motions.shift[m]
        fit[m] = np.log(motions.probability[m]) - 0.5 * (d @ np.linalg.solve(S, d) + np.linalg.slogdet(S)[1])
    share, _ = normalised(fit)
    return _STAYS * share + (1.0 - _STAYS) * MIXTURE
