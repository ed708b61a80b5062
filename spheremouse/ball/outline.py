"""The ball's outline in a picture, and the radius and centre that it shows.

The strongest edge on each normal of the predicted outline is a candidate. Struts, the base and hands hide much of the
outline, and shading gives other edges. The result is the radius and the shift of the centre on which most edges agree.
Near the limb the edges of a bold pattern run along the outline. If they are most of the edges, there is no result.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose, sphere_outline, unproject
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.native import kernels

_POINTS = 240  # of the outline
_MAX_ERROR = 0.05  # relative, largest error of the radius: five standard deviations of a tape
_STEP_PX = 0.25  # between samples
_SLOPE = kernels.SLOPE  # samples on each side of an edge
# px, side of the square that widens a mask by 6 px: samples lie 3 px beyond the largest outline
_MASK_MARGIN_PX = 13
# times the median slope, from which one is an edge: five standard deviations of grey noise above it
_MIN_SLOPE_RATIO = 8.4
_NEAR_PX = 2.0  # from the outline, of an edge that confirms it
_EDGE_SIGMA_PX = 0.3  # standard deviation of an outline from blur and shading
_WEIGHT_SCALES = 0.01, 0.006, 0.004, 0.003, 0.002, 0.002  # of the radius, of the weights of edges off the outline
_MIN_INFORMATION = 1e-9  # edges: along a direction that no edge shows, the shift is 0
_SHARING_NEIGHBOURS = 4.0  # neighbours that share the error of an edge
_SIDE_SIGMA_PX = 0.1  # standard deviation of one side of an outline against the other, from shading
_NONE = np.zeros(0, dtype=np.intp)
_MIN_SUPPORT = 0.2  # of the outline: the ball's edge is free on so much, and a twentieth agrees by chance


class SeenCentre(NamedTuple):
    """The ball's centre by its outline or its pattern.

    The first two axes are across the line of sight. An outline has a third, along it, which shows how much nearer the
    ball looks than in another frame.
    """

    place: Array  # (k,) m, along the axes, from its place in the rig
    axes: Array  # (3, k) unit vectors, obj
    scatter: Array  # (k, k) m², covariance from the edges or the pixels
    common: float  # m², variance that frames share, from shading

    @property
    def covariance(self) -> Array:
        """Covariance of the place, (k, k) m²."""
        return self.scatter + self.common * np.eye(len(self.scatter))

    @property
    def across(self) -> "SeenCentre":
        """The part across the line of sight. The other one includes the error of the rig's radius."""
        return SeenCentre(self.place[:2], self.axes[:, :2], self.scatter[:2, :2], self.common)


class SeenBall(NamedTuple):
    """The ball's size and centre by its outline."""

    size_error: float  # relative, of the rig's radius; 0 if the outline does not show it
    sigma: float  # standard deviation of that; infinite if the outline does not show it
    centre: SeenCentre
    trust: Array  # (240,) of each normal, 0..1: its edge is that of the ball


class _Edges(NamedTuple):
    """Edges across the predicted outline: the strongest on each normal, if it is clear."""

    which: NDArray[np.intp]  # (n,) indices of their normals
    error: Array  # (n,) relative error of the radius that puts the outline on the edge
    normal: Array  # (n, 3) of the ball there, obj
    normals: int  # number of normals in the picture, with an edge or without
    px: float  # for a relative error of 1


class _Fit(NamedTuple):
    """A shift of the centre by the edges of an outline."""

    shift: Array  # (3,) m, obj
    weight: Array  # (n,) of the edges
    N: Array  # (3, 3) information, in units of that of one edge
    off: Array  # (n,) m, residuals


def support_mask(rig: Rig, pose: Pose) -> Image:
    """Return a mask, (h, w), 255 for the pixels beside the outline that this module reads, and for the ball."""
    mask = np.zeros((rig.camera.height, rig.camera.width), np.uint8)
    try:
        uv = sphere_outline(pose.to_cam(rig.ball.centre), (1.0 + _MAX_ERROR) * rig.ball.radius, rig.camera, _POINTS)
    except np.linalg.LinAlgError:  # not wholly in front of the camera
        return mask
    cv2.fillPoly(mask, [np.rint(np.clip(uv, -1e4, 1e4)).astype(np.int32)], 255)
    return np.asarray(cv2.dilate(mask, np.ones((_MASK_MARGIN_PX, _MASK_MARGIN_PX), np.uint8)), np.uint8)


def support(image: Image, rig: Rig, pose: Pose) -> float:
    """Return the share of the predicted outline, 0..1, that has an edge, less the share that has one by chance."""
    found = _edges(image, rig, pose, rig.ball.centre)
    if found.normals == 0:
        return 0.0
    near = float(np.count_nonzero(np.abs(found.error) * found.px < _NEAR_PX)) / found.normals
    chance = min(_NEAR_PX / (_MAX_ERROR * found.px), 0.5)
    return max(0.0, (near - chance) / (1.0 - chance))


def seen_ball(image: Image, rig: Rig, pose: Pose) -> SeenBall | None:
    """Return the ball that the outline shows; None if too little of it is seen.

    The size is unknown unless a fifth of the outline has an edge at one radius, and half as much at most at the rig's
    if that is another. `image` is (h, w) or (h, w, 3), and `pose` that of its camera. The outline of a ball with a bold
    pattern counts as not seen.
    """
    home, radius = rig.ball.centre, rig.ball.radius
    found = _edges(image, rig, pose, home)
    if not _suffices(found, _POINTS):
        return None
    error, sigma = np.sort(found.error), _EDGE_SIGMA_PX / found.px
    agree = np.searchsorted(error, error + 4.0 * sigma, "right") - np.arange(len(error))
    first = int(agree.argmax())
    towards = pose.position - home  # a larger ball looks like one that is nearer by the same share
    at_mode = float(error[first : first + agree[first]].mean()) * towards
    as_rig, at_mode = (_fit(found, radius, start, np.ones(len(error))) for start in (np.zeros(3), at_mode))
    fit = max(at_mode, as_rig, key=lambda fit: fit.weight.sum())
    size = float(towards @ fit.shift) / float(towards @ towards)
    agree, rivals = (int(np.count_nonzero(np.abs(off) < 2.0 * sigma * radius)) for off in (fit.off, radius * error))
    if agree < _MIN_SUPPORT * found.normals or (abs(size) > 4.0 * sigma and 2 * rivals > agree):
        size, sigma, fit = 0.0, np.inf, as_rig
    if _breaks_down(fit, found, radius):
        return None
    trust = np.zeros(_POINTS)
    trust[found.which] = fit.weight
    return SeenBall(size, sigma, _centre(fit, found, rig, pose, home), trust)


def seen_centre(image: Image, rig: Rig, pose: Pose, expected: Array, trust: Array | None = None) -> SeenCentre | None:
    """Return the ball's centre that the outline shows, near the `expected` one, (3,) m in obj.

    An edge counts by the `trust` (240,) in its normal, from the first frame (None: all alike), since a ball that moves
    passes the edges of struts. Returns None if too little of the outline is seen.
    """
    found = _edges(image, rig, pose, expected, _POINTS // 2, 0.5 * _MAX_ERROR)
    if not _suffices(found, _POINTS // 2):
        return None
    prior = np.ones(len(found.which)) if trust is None else trust[2 * found.which]
    fit = _fit(found, rig.ball.radius, np.zeros(3), prior)
    if _breaks_down(fit, found, rig.ball.radius, None if trust is None else prior / trust[::2].sum()):
        return None
    return _centre(fit, found, rig, pose, expected)


def _breaks_down(fit: _Fit, found: _Edges, radius: float, trust: Array | None = None) -> bool:
    """Return whether most edges are not of the fitted outline, so that a robust fit can follow them (Hampel 1971).

    With a `trust`, (n,) of the found normals' share in the sum 1, they are the trusted normals. Otherwise they are the
    edges on the outline and inside of it, since a ball's pattern has no edge outside.
    """
    off = fit.off * found.px / radius
    on = np.abs(off) < 2.0 * _EDGE_SIGMA_PX
    if trust is not None:
        return float(trust @ on) < 0.5
    return bool(np.count_nonzero(on) < np.count_nonzero(off <= -2.0 * _EDGE_SIGMA_PX))


def _centre(fit: _Fit, found: _Edges, rig: Rig, pose: Pose, expected: Array) -> SeenCentre:
    """Return the centre by a fit to the edges about the `expected` one.

    A free arc of the outline confuses a shift across its middle with one along the line of sight, which looks like
    shade and blur. The joint covariance of all three keeps the combination that the arc shows well.
    """
    towards = pose.position - expected
    distance = float(np.linalg.norm(towards))
    axes = np.column_stack([tangent_basis(towards / distance), towards / distance])
    variance = float(fit.weight @ fit.off**2) / max(float(fit.weight.sum()) - 3.0, 1.0)
    scatter = _SHARING_NEIGHBOURS * variance * axes.T @ np.linalg.inv(fit.N) @ axes
    scatter[2, 2] += (_EDGE_SIGMA_PX / found.px * distance) ** 2
    common = (_SIDE_SIGMA_PX / found.px * rig.ball.radius) ** 2
    return SeenCentre(axes.T @ (expected + fit.shift - rig.ball.centre), axes, scatter, common)


def _suffices(found: _Edges, points: int) -> bool:
    """Return whether enough of an outline of so many points is in the picture, with an edge."""
    return len(found.error) >= _MIN_SUPPORT * found.normals and found.normals >= _MIN_SUPPORT * points


def _fit(found: _Edges, radius: float, start: Array, prior: Array) -> _Fit:
    """Return the shift of the centre by the edges, from a `start`, (3,) m in obj, by robust least squares.

    A shift d moves the edge on a normal n as a radius that is larger by n·d does. The edges' weights are the `prior`
    ones, (n,), times those of Geman and McClure (1987).
    """
    n, error, shift, weight, N = found.normal, radius * found.error, start, prior, np.eye(3)
    for scale in _WEIGHT_SCALES:
        weight = prior / (1.0 + ((error - n @ shift) / (scale * radius)) ** 2) ** 2
        N = n.T @ (weight[:, None] * n) + _MIN_INFORMATION * np.eye(3)
        shift = np.asarray(np.linalg.solve(N, n.T @ (weight * error)), float)
    return _Fit(shift, weight, N, error - n @ shift)


def _edges(image: Image, rig: Rig, pose: Pose, at: Array, points: int = _POINTS, reach: float = _MAX_ERROR) -> _Edges:
    """Return the edges near the outline of a ball with its centre `at`, (3,) m in obj."""
    centre, radius = pose.to_cam(at), rig.ball.radius
    try:
        uv, larger = (sphere_outline(centre, k * radius, rig.camera, points) for k in (1.0, 1.0 + reach))
    except np.linalg.LinAlgError:  # not wholly in front of the camera
        return _Edges(_NONE, np.zeros(0), np.zeros((0, 3)), 0, 1.0)
    px = float(np.median(np.linalg.norm(larger - uv, axis=1))) / reach
    h, w = image.shape[:2]
    inside = np.all((uv > 1) & (uv < [w - 2, h - 2]), axis=1)
    if not (inside.any() and px < max(w, h)):
        return _Edges(_NONE, np.zeros(0), np.zeros((0, 3)), 0, px)
    step = _STEP_PX / px
    first, samples = -reach - _SLOPE * step, int(2.0 * reach / step) + 2 * _SLOPE
    way = (larger - uv)[inside] / reach  # px, by an error of 1
    colours = np.ascontiguousarray(image if image.ndim == 3 else image[..., None])
    slope, where, usual = kernels.outline_slopes(colours, uv[inside] + first * way, step * way, samples)
    clear = slope > _MIN_SLOPE_RATIO * max(usual, 1e-6)
    ray = np.column_stack([unproject(uv[inside][clear], rig.camera)[0], np.ones(np.count_nonzero(clear))])
    ray *= np.sqrt(centre @ centre - radius**2) / np.linalg.norm(ray, axis=1, keepdims=True)  # to the tangent points
    error = np.asarray(first + step * (where[clear] - 0.5), float)  # half-way from the sample before
    return _Edges(np.flatnonzero(inside)[clear], error, (ray - centre) / radius @ pose.rotation.T, len(slope), px)
