"""Discs in windows of their own: directions on the ball and a picture in, measured centres out, in one compiled call.

Where each disc is by the time its row is read, how it looks from there and how far it travels while the shutter is open
comes from the geometry (detect.appearance); the measuring itself is detect.fit.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from spheremouse.ball.detect.appearance import appearance_into, seen_into
from spheremouse.ball.detect.detections import Detections, Image, no_detections
from spheremouse.ball.detect.fit import FitSettings, measure_into
from spheremouse.ball.detect.fit_model import PATH
from spheremouse.ball.detect.projection import weights_of
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose, row_of
from spheremouse.geometry.rotation import Array, exp_into


@dataclass(frozen=True, slots=True)
class DiscModel:
    """Parameters of search, appearance and acceptance of discs, as arrays for compiled code."""

    mask: Image  # (h, w) 255 on the ball, a little within its outline
    centre: Array  # (3,) m, of the ball, obj
    radius: float  # m
    alpha: float  # rad, angular radius of a disc
    rotation: Array  # (3, 3) R_obj_cam
    position: Array  # (3,) m, obj
    intrinsic: tuple[float, float, float, float]
    distortion: Array  # (5,)
    exposure: float  # s
    fit: FitSettings
    least: float  # px², smaller discs are left out
    apart: float  # px, of two that are nearer that which fits less well is left out


def view_of(rig: Rig, pose: Pose, mask: Image, fit: FitSettings, least: float, apart: float) -> DiscModel:
    """Return the model for a device and a camera that stands still."""
    return DiscModel(
        mask,
        np.ascontiguousarray(rig.ball.centre, dtype=np.float64),
        float(rig.ball.radius),
        float(rig.disc_radius / rig.ball.radius),
        np.ascontiguousarray(pose.rotation, dtype=np.float64),
        np.ascontiguousarray(pose.position, dtype=np.float64),
        rig.camera.intrinsic,
        np.ascontiguousarray(rig.camera.distortion, dtype=np.float64),
        float(rig.exposure_s),
        fit,
        least,
        apart,
    )


_EXPECTED = 0.3  # of the contrast is enough where the map says that a disc must be: glare, deep shade
_ANYWHERE = np.zeros((0, 2))
_STILL = np.zeros(3)


def measure_discs(
    image: Image,
    directions: Array,
    view: DiscModel,
    noise: float,
    places: Array = _ANYWHERE,
    rate: Array = _STILL,
    readout: float = 0.0,
    size: float = 0.0,
) -> tuple[Detections, float]:
    """Measure the discs at `directions`, (n, 3) unit vectors in obj, in an image (h, w, c) of uint8.

    Each begins at its place of `places`, (n, 2) px, where something dark was seen; without them where it is expected,
    and there a part of the contrast is enough. `noise` is that of a pixel. Discs that are not wholly in the picture are
    left out. With `rate` (3,) rad/s, w_obj, they are carried to when their row is read (`readout` s for all rows),
    smeared by the exposure. `size` (fitted over expected) is held where it is known, not 0; the second result is the
    one that the discs have in common, 0 where too few tell.
    """
    if len(directions) == 0:
        return no_detections(), size
    fit, share = view.fit, 1.0 if len(places) else _EXPECTED
    centre, covariance, area, told = _measure_discs(
        image, view.mask, np.ascontiguousarray(directions), np.ascontiguousarray(places), rate, readout, view.exposure,
        view.centre, view.radius, view.alpha, view.rotation, view.position, view.intrinsic, view.distortion, noise,
        view.least, view.apart, weights_of(fit.projection, image.shape[2]), fit.kernel, fit.blur, share * fit.contrast,
        fit.size_tolerance, fit.rim, fit.sigma, size,
    )  # fmt: skip
    return Detections(centre, covariance, area), told


@njit(cache=True, error_model="numpy")
def _measure_discs(
    image, mask, directions, places, rate, readout, exposure, K, radius, alpha, rotation, P, intrinsic, distortion,
    noise, least, apart, weights, kernel, blur, contrast, size_tolerance, rim_least, sigma, size,
):  # fmt: skip
    n = len(directions)
    height, width = mask.shape
    to_centre = K - P
    uv, turn, R = np.empty((n, 2)), np.empty(3), np.empty((3, 3))
    if readout != 0.0:
        seen_into(directions, to_centre, radius, rotation, intrinsic, distortion, uv)
        moved = directions.copy()
        for i in range(n):
            if np.isfinite(uv[i, 1]):
                late = readout * row_of(uv[i, 1], height)
                for j in range(3):
                    turn[j] = rate[j] * late
                exp_into(turn, R)
                moved[i] = R @ directions[i]
        directions = moved
    centre, centroid, shape = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2, 2))
    area, whole = np.empty(n), np.empty(n, dtype=np.bool_)
    appearance_into(
        directions, K, radius, alpha, rotation, P, intrinsic, distortion, centre, centroid, shape, area, whole
    )
    path = np.zeros((n, PATH))
    if exposure > 0.0:
        _paths(directions, exposure, rate, K, radius, alpha, rotation, P, intrinsic, distortion, centre, path)
    index = np.empty(n, dtype=np.int64)
    k = 0
    for i in range(n):
        if not area[i] >= least:
            continue
        dx, dy = np.sqrt(shape[i, 0, 0]), np.sqrt(shape[i, 1, 1])
        x, y = centroid[i, 0], centroid[i, 1]
        if x - dx > -0.5 and x + dx < width - 0.5 and y - dy > -0.5 and y + dy < height - 0.5:
            index[k] = i
            k += 1
    index = index[:k]
    start = (places if len(places) else centroid)[index]
    ok, found, covariance = np.zeros(k, dtype=np.bool_), np.empty((k, 2)), np.empty((k, 2, 2))
    rim, cut = np.zeros(k), np.zeros(k)
    told = measure_into(
        image, mask, start, shape[index], path[index], np.float32(noise), weights, kernel, blur, contrast,
        size_tolerance, rim_least, sigma, size, ok, found, covariance, rim, cut,
    )  # fmt: skip
    kept = np.empty(k, dtype=np.int64)
    m = 0
    for i in range(k):
        found[i] -= centroid[index[i]] - centre[index[i]]  # the eccentricity
    for _ in range(k):  # the best first, each if it has no better one beside it
        best = -1
        for i in range(k):
            if ok[i] and (best < 0 or rim[i] > rim[best]):
                best = i
        if best < 0:
            break
        ok[best] = False
        alone = True
        for j in range(m):
            alone = alone and np.hypot(found[best, 0] - found[kept[j], 0], found[best, 1] - found[kept[j], 1]) >= apart
        if alone:
            kept[m] = best
            m += 1
    kept = kept[:m]
    return found[kept], covariance[kept], area[index[kept]], told


@njit(cache=True, error_model="numpy")
def _paths(directions, exposure, rate, K, radius, alpha, rotation, P, intrinsic, distortion, centre, path):
    """Write the motion of n discs at `directions` during the exposure, at a constant `rate`, into `path`, (n, 7).

    `centre` (n, 2) px is where they are at mid-exposure. The ends of the way give what `moving_ellipse_of` needs; of a
    disc that is not whole at both ends the shape counts as constant.
    """
    n = len(directions)
    turn, R = 0.5 * exposure * rate, np.empty((3, 3))
    exp_into(turn, R)
    ends = np.empty((2, n, 3))
    for i in range(n):
        ends[0, i] = R.T @ directions[i]
        ends[1, i] = R @ directions[i]
    uv, inverse = np.empty((2, n, 2)), np.empty((2, n, 3))
    at, centroid, shape = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2, 2))
    area, whole = np.empty(n), np.empty(n, dtype=np.bool_)
    for end in range(2):
        seen_into(ends[end], K - P, radius, rotation, intrinsic, distortion, uv[end])
        appearance_into(
            ends[end], K, radius, alpha, rotation, P, intrinsic, distortion, at, centroid, shape, area, whole
        )
        for i in range(n):
            det = shape[i, 0, 0] * shape[i, 1, 1] - shape[i, 0, 1] ** 2
            inverse[end, i, 0], inverse[end, i, 2] = shape[i, 1, 1] / det, shape[i, 0, 0] / det
            inverse[end, i, 1] = -shape[i, 0, 1] / det
    for i in range(n):
        if not np.isfinite(uv[0, i, 0] + uv[1, i, 0]):
            continue
        path[i, :2] = uv[1, i] - uv[0, i]
        path[i, 2:4] = 2.0 * (uv[1, i] + uv[0, i] - 2.0 * centre[i])
        if np.isfinite(inverse[0, i, 0] + inverse[1, i, 0]):
            path[i, 4:] = inverse[1, i] - inverse[0, i]
