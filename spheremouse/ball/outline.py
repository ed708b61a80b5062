"""The ball's outline in a picture, and the radius that it shows.

Struts, the base and hands hide much of it, and shading gives other edges. So the radius on which most edges agree
counts.
"""

from typing import NamedTuple

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose, sphere_outline
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma

_POINTS = 240  # of the outline
_REACH = 0.05  # relative, largest error of the radius: five standard deviations of a tape
_STEP_PX = 0.25  # between samples
_SLOPE = 8  # samples on each side of an edge
_CLEAR = 5.0  # standard deviations of the slopes, from which one is an edge
_NEAR_PX = 2.0  # from the outline, of an edge that confirms it
_EDGE_PX = 0.3  # standard deviation of an outline from blur and shading
_LEAST_SUPPORT = 0.2  # of the outline: the ball's edge is free on so much, and a twentieth agrees by chance


class _Edges(NamedTuple):
    """Edges across the predicted outline: the strongest on each normal, if it is clear."""

    error: Array  # (n,) relative error of the radius with which the outline lies on it
    normals: int  # number of those in the picture
    px: float  # of an error of 1


def support(image: Image, rig: Rig, pose: Pose) -> float:
    """Return the share of the predicted outline, 0..1, that has an edge, less the share that has one by chance."""
    found = _edges(image, rig, pose)
    if found.normals == 0:
        return 0.0
    near = float(np.count_nonzero(np.abs(found.error) * found.px < _NEAR_PX)) / found.normals
    chance = min(_NEAR_PX / (_REACH * found.px), 0.5)
    return max(0.0, (near - chance) / (1.0 - chance))


def size_error(image: Image, rig: Rig, pose: Pose) -> tuple[float, float]:
    """Return the relative error of the rig's radius that the ball's outline shows, and its standard deviation.

    A fifth of the outline must have an edge at one radius, and half as much at most at the rig's if that is another.
    Otherwise the result is no error, of infinite standard deviation. `image` is (h, w) or (h, w, 3), and `pose` that of
    its camera.
    """
    found = _edges(image, rig, pose)
    error, sigma = np.sort(found.error), _EDGE_PX / found.px
    agree = np.searchsorted(error, error + 4.0 * sigma, "right") - np.arange(len(error))
    if len(error) == 0 or agree.max() < _LEAST_SUPPORT * found.normals or found.normals < _LEAST_SUPPORT * _POINTS:
        return 0.0, np.inf
    first = int(agree.argmax())
    radius = float(error[first : first + agree[first]].mean())
    rivals = np.count_nonzero(np.abs(error) < 2.0 * sigma) if abs(radius) > 4.0 * sigma else 0
    return (0.0, np.inf) if 2 * rivals > agree[first] else (radius, sigma)


def _edges(image: Image, rig: Rig, pose: Pose) -> _Edges:
    centre = pose.to_cam(rig.ball.centre)
    try:
        uv, larger = (sphere_outline(centre, k * rig.ball.radius, rig.camera, _POINTS) for k in (1.0, 1.0 + _REACH))
    except np.linalg.LinAlgError:  # not wholly in front of the camera
        return _Edges(np.zeros(0), 0, 1.0)
    px = float(np.median(np.linalg.norm(larger - uv, axis=1))) / _REACH
    h, w = image.shape[:2]
    inside = np.all((uv > 1) & (uv < [w - 2, h - 2]), axis=1)
    if not (inside.any() and px < max(w, h)):
        return _Edges(np.zeros(0), 0, px)
    step = _STEP_PX / px
    error = np.arange(-_REACH - _SLOPE * step, _REACH + _SLOPE * step, step)
    at = uv[inside, None] + error[:, None] / _REACH * (larger - uv)[inside, None]
    x, y = (np.ascontiguousarray(at[:, :, i], dtype=np.float32) for i in (0, 1))
    samples = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(*x.shape, -1)
    sums = np.pad(np.cumsum(samples, axis=1, dtype=float), ((0, 0), (1, 0), (0, 0)))
    means = (sums[:, _SLOPE:] - sums[:, :-_SLOPE]) / _SLOPE
    slope = np.abs(means[:, _SLOPE:] - means[:, :-_SLOPE]).max(axis=2)  # of the colour that has the largest
    clear = slope.max(axis=1) > np.median(slope) + _CLEAR * float(mad_sigma(slope.ravel()))
    return _Edges(error[_SLOPE : _SLOPE + slope.shape[1]][slope.argmax(axis=1)][clear], len(at), px)
