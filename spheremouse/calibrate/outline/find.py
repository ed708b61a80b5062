"""Find the outline of a ball that turns, in pictures of a still camera: inside, pixels change; outside, they do not.

The pixels that change are in a region whose border is an outline where nothing hides the ball. RANSAC finds the cone
that most of the border lies on. Then the edge is measured across the outline: where a contour of unknown strength that
comes and goes ends at a still background, its gradient over its value depends on the blur and the place alone. Last,
where the mean picture has a step there, its place counts: gloss and a fine pattern do not move it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from spheremouse.ball.detect.blur import blur_of
from spheremouse.ball.detect.detections import Image
from spheremouse.calibrate.outline.fit import Outline, fit_outline, rays_of, residuals
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma

POINTS = "or give points on its edge: --points X,Y X,Y X,Y"
_TURN_HINT = "turn the ball by a quarter and more while you film all of it with a still camera"

_MIN_BRIGHTNESS, _MAX_BRIGHTNESS = 25.0, 250.0  # grey values between which a pixel is neither dark nor white
_SMOOTHING_SIGMA_PX = 0.8  # px, standard deviation of the Gaussian before all else
_MAX_LIGHT_CHANGE = 0.2  # in the logarithm of a frame's light: frames with another light are left out
_MIN_CHANGE = 2.0  # grey values, standard deviation of a pixel that changes
_MIN_CHANGE_SIGMAS = 4.0  # of the noise, of a pixel that changes
_MIN_AREA = 0.002  # of the picture
_MIN_SIDE = 16  # px, side of a picture
_MAX_BORDER_POINTS = 1000  # points of the border in RANSAC
_RANSAC_TRIALS = 2000
_GRID_SIDE = 40  # pixels along a side of the picture that test an outline
_MIN_POINTS = 30  # of a border or an outline
_MIN_REGION = 0.003  # of the largest region that moves: others are noise
_MIN_SECANT_SQUARED = 1.0 + 1e-6  # of the angular radius
_MIN_DEPTH = 1.1  # radii, least depth of a ball's centre
_MAX_OFF, _MAX_OFF_PX = 0.01, 3.0  # of the radius, and px: a point of the border that fits
_MIN_SUPPORT = 0.3  # of the outline, on which an edge is
_MIN_IN_PICTURE = 0.7  # of the outline
_MIN_OVERLAP, _MIN_OTHER_SIZE = 0.6, 0.3  # of moving pixels and outline, of the first outline: of another ball
_SEARCH_RANGES = (0.08, 0.04, 0.02, 0.02)  # of the radius: in which an edge is looked for, one pass after another
_MIN_SEARCH_PX = 4.0  # px, least search range across an outline
_EDGE_RATIO = float(np.sqrt(2.0 / np.pi))  # gradient over change at an edge, times the blur: phi(0) / Phi(0)
_MIN_BLUR = 1.0  # px, standard deviation of the blur of a sharp picture after `_SMOOTHING_SIGMA_PX` and differences
_SAMPLING_PX = 0.25  # px
_OUTSIDE_SAMPLES = 6  # samples
_MIN_EDGE_VARIANCE = 0.02  # of the variance within: less is noise
_MAX_BACKGROUND_VARIANCE = 0.25  # of the variance within: the background
_STEP_REACH_PX, _MIN_STEP_SLOPE = 2.5, 5.0  # px to each side, and grey values a pixel, of a step of the mean picture
_MIN_STEP_SHARE = 0.5  # steps, of the edges
_STEP_FLOOR_PX, _STEP_SHARED = (0.08, 0.12), (0.3, 0.3)  # as those below, by steps
_FLOOR_PX = (0.1, 0.25)  # standard deviations of centre and radius by blur and shading
_SHARED_SCATTER = (0.7, 1.0)  # of the scatter of the edges, which many of them share: the pattern is finer at the limb


class Change(NamedTuple):
    """Changes of pixels over time."""

    mean: Array  # (h, w) grey values
    variance: Array  # (h, w) grey values²
    gradient: Array  # (h, w, 3) grey values² per px², covariance of the gradient: xx, xy, yy
    noise: float  # grey values, standard deviation of a pixel that does not change


def find_outline(
    images: Sequence[Image], camera: InteriorOrientation, start: Outline | None = None
) -> tuple[Outline, Array]:
    """Return the outline of the ball that turns in images (h, w) or (h, w, 3), near `start` if that is given.

    Also return the edges that it fits, (n, 2) px. Raises CalibrationError, with a remedy, if there is no outline, if
    there are several, or if it cannot be measured.
    """
    grey = [i if i.ndim == 2 else np.asarray(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), np.uint8) for i in images]
    _check_light(grey)
    change = change_of(grey, light_of(grey))
    moving = _moving(change)
    first = start or _ransac(moving, camera)
    blur = float(np.hypot(_MIN_BLUR, np.nan_to_num(np.median([blur_of(grey[k]) for k in (0, len(grey) // 2, -1)]))))
    outline, edges = _refine(change, first, camera, _EDGE_RATIO / blur)
    if _has_other(moving, change, outline, camera, _EDGE_RATIO / blur):
        raise CalibrationError("several balls turn in the pictures", f"cover all but one, {POINTS}")
    return outline, edges


def change_of(images: Sequence[Image], light: Array) -> Change:
    """Return how the pixels of images, (h, w) grey values, change over time, over the light of each, (n,).

    Images with a light that is far from the usual one do not count.
    """
    sums, count = np.zeros((7, *images[0].shape), np.float32), 0
    along, base = np.array([[-0.5, 0.0, 0.5]], np.float32), np.float32(0.0)
    for image, k in zip(images, light, strict=True):
        if abs(np.log(max(k, 1e-3))) > _MAX_LIGHT_CHANGE:
            continue
        smooth = cv2.GaussianBlur(image.astype(np.float32) / np.float32(k), (0, 0), _SMOOTHING_SIGMA_PX)
        base = base if count else smooth  # sums of small values lose no digits
        d = smooth - base
        x, y = cv2.filter2D(d, -1, along), cv2.filter2D(d, -1, along.T)
        for i, value in enumerate((d, x, y, d * d, x * x, x * y, y * y)):
            sums[i] += value
        count += 1
    d, x, y, dd, xx, xy, yy = sums / max(count, 1)
    variance = np.maximum(dd - d * d, 0.0)
    gradient = np.stack([xx - x * x, xy - x * y, yy - y * y], axis=-1)
    return Change(base + d, variance, gradient, float(np.percentile(variance[::4, ::4], 25.0)) ** 0.5)


def _check_light(images: Sequence[Image]) -> None:
    thin = np.stack([image[::8, ::8] for image in images])
    if np.percentile(thin, 95.0) < _MIN_BRIGHTNESS:
        raise CalibrationError("the pictures are black", "light the ball, or lengthen the exposure")
    if np.percentile(thin, 50.0) > _MAX_BRIGHTNESS:
        raise CalibrationError("the pictures are overexposed", "shorten the exposure, or dim the light")


def light_of(images: Sequence[Image]) -> Array:
    """Return the light of each image over the usual light, (n,), by the pixels that are neither dark nor white."""
    thin = np.stack([image[::8, ::8] for image in images]).reshape(len(images), -1).astype(float)
    usual = np.median(thin, axis=0)
    clear = (usual > _MIN_BRIGHTNESS) & (usual < _MAX_BRIGHTNESS)
    return np.median(thin[:, clear] / usual[clear], axis=1) if clear.any() else np.ones(len(images))


def _moving(change: Change) -> Image:
    """Return 255 where pixels change, without specks, (h, w)."""
    least = max(_MIN_CHANGE, _MIN_CHANGE_SIGMAS * change.noise)
    mask = (change.variance > least**2).astype(np.uint8) * 255
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8)), np.uint8)
    if np.count_nonzero(mask) < _MIN_AREA * mask.size or min(mask.shape) < _MIN_SIDE:
        raise CalibrationError("nothing moves in the pictures", f"{_TURN_HINT}, {POINTS}")
    return mask


def _border(moving: Image) -> Array:
    """Return points of the border of what moves, (n, 2) px, without those on the picture's edge."""
    contours = cv2.findContours(moving, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    areas = np.array([cv2.contourArea(c) for c in contours])
    if len(contours) == 0:
        return np.zeros((0, 2))
    large = [c[:, 0] for c, area in zip(contours, areas, strict=True) if area >= _MIN_REGION * areas.max()]
    points = np.concatenate(large).astype(float)
    h, w = moving.shape
    points = points[np.all((points > 2) & (points < (w - 3, h - 3)), axis=1)]
    return points[np.linspace(0, len(points) - 1, min(len(points), _MAX_BORDER_POINTS)).astype(int)]


def _ransac(moving: Image, camera: InteriorOrientation) -> Outline:
    """Return the outline that fits the border of what moves best: a circular cone of rays, fitted to its border points.

    A ray x is on a cone with axis n/|n| and angle arccos(1/|n|) if n x = 1, so three points of the border determine n.
    The score is the number of border points on the cone, times the share of moving pixels that it contains, times the
    share of its pixels that move. Raises CalibrationError if there is no such cone in front of the camera.
    """
    border, (h, w) = _border(moving), moving.shape
    pixels = np.stack(np.meshgrid(*(np.linspace(1, side - 2, _GRID_SIDE) for side in (w, h))), axis=-1).reshape(-1, 2)
    moves = moving[tuple(pixels[:, ::-1].astype(int).T)] > 0
    rays, grid = rays_of(border, camera), rays_of(pixels, camera)
    if len(rays) < _MIN_POINTS:
        raise _no_ball()
    A = rays[np.random.default_rng(0).integers(0, len(rays), (_RANSAC_TRIALS, 3))]
    A = A[np.abs(np.linalg.det(A)) > 1e-9]
    n = np.linalg.solve(A, np.ones((len(A), 3, 1)))[:, :, 0]  # (t, 3), one of each trial
    square = np.sum(n**2, axis=1)
    n = n[(square > _MIN_SECANT_SQUARED) & (n[:, 2] > _MIN_DEPTH * np.sqrt(np.maximum(square - 1.0, 0.0)))]
    cos = 1.0 / np.linalg.norm(n, axis=1)
    angle = np.arccos(cos)[:, None]
    tolerance = np.minimum(_MAX_OFF * angle, _MAX_OFF_PX / np.sqrt(camera.fx * camera.fy))
    fits = np.abs(np.arccos(np.clip(cos[:, None] * (n @ rays.T), -1.0, 1.0)) - angle) < tolerance
    inside = n @ grid.T > 1.0
    common = np.count_nonzero(inside & moves, axis=1)
    contained = common / max(1, np.count_nonzero(moves))
    filled = np.minimum(1.0, 2.0 * common / np.maximum(1, np.count_nonzero(inside, axis=1)))  # half may be hidden
    score = np.count_nonzero(fits, axis=1) * contained * filled
    if not score.any():
        raise _no_ball()
    return _robust(rays[fits[np.argmax(score)]], start=None)


def _robust(rays: Array, start: Outline | None) -> Outline:
    try:
        return fit_outline(rays, 1.0, start, robust=True)
    except CalibrationError:
        raise _no_ball() from None


def _no_ball() -> CalibrationError:
    return CalibrationError("no ball turns in the pictures", f"{_TURN_HINT}, {POINTS}")


def _refine(change: Change, outline: Outline, camera: InteriorOrientation, level: float) -> tuple[Outline, Array]:
    """Return the outline fitted to edges near `outline`, and the edges that it fits, (n, 2) px.

    At an edge, the gradient of the change, divided by the change, is `level`, 1/px. Clear steps of the mean picture
    replace the edges. Raises CalibrationError if too little of the outline is in the picture or has an edge.
    """
    f = np.sqrt(camera.fx * camera.fy)
    pixels, edges = outline.pixels(camera), np.zeros((0, 2))
    for part in _SEARCH_RANGES:
        edges = _edges(change, pixels, max(_MIN_SEARCH_PX, part * f * outline.angle), level)
        if len(edges) < _MIN_POINTS:
            raise _no_ball()
        outline = _robust(rays_of(edges, camera), outline)
        pixels = outline.pixels(camera)
    residual = residuals(outline, rays_of(edges, camera)) * f
    scatter = float(mad_sigma(residual))
    fits = np.abs(residual) < max(1.5, 3.0 * scatter)
    inside = float(np.mean(np.all((pixels >= 0.0) & (pixels < (camera.width, camera.height)), axis=1)))
    support = float(np.count_nonzero(fits)) / len(pixels)
    if inside < _MIN_IN_PICTURE:
        raise CalibrationError(
            f"only {inside:.0%} of the ball's outline is in the picture", f"turn the camera, {POINTS}"
        )
    if support < _MIN_SUPPORT:
        raise CalibrationError(
            f"no round outline: only {support:.0%} of the best one is on an edge", f"{_TURN_HINT}, {POINTS}"
        )
    edges, floor_px, shared = edges[fits], _FLOOR_PX, _SHARED_SCATTER
    steps = _steps(change.mean, outline, edges, camera)
    if len(steps) > _MIN_STEP_SHARE * len(edges):
        outline = _robust(rays_of(steps, camera), outline)
        residual = residuals(outline, rays_of(steps, camera)) * f
        scatter, edges, floor_px, shared = float(mad_sigma(residual)), steps, _STEP_FLOOR_PX, _STEP_SHARED
    floor = np.hypot(floor_px, np.multiply(shared, scatter)) / f
    covariance = outline.covariance + np.diag(np.square(floor[[0, 0, 1]]))
    return Outline(outline.direction, outline.angle, covariance), edges


def _edges(change: Change, pixels: Array, reach: float, level: float) -> Array:
    """Return the edges, (n, 2) px, across an outline, (m, 2) px, within `reach` px.

    The outermost edge of the change counts. There the gradient over the change is `level`, 1/px.
    """
    normal, offset = _normals(pixels), np.arange(reach, -reach, -_SAMPLING_PX)  # from outside
    at = pixels[:, None] + offset[:, None] * normal[:, None]
    variance, xx, xy, yy = (_sample(part, at) for part in (change.variance, *np.moveaxis(change.gradient, -1, 0)))
    x, y = normal[:, None, 0], normal[:, None, 1]
    gradient = x * x * xx + 2.0 * x * y * xy + y * y * yy
    outside, within = (
        np.median(variance[:, k], axis=1) for k in (slice(_OUTSIDE_SAMPLES), slice(-_OUTSIDE_SAMPLES, None))
    )
    variance = np.maximum(variance - outside[:, None], 1e-6)
    gradient = np.maximum(gradient - np.median(gradient[:, :_OUTSIDE_SAMPLES], axis=1)[:, None], 0.0)
    ratio = np.where(variance > _MIN_EDGE_VARIANCE * within[:, None], np.sqrt(gradient / variance), np.inf)
    h, w = change.variance.shape
    seen = np.all((at >= 1.0) & (at <= (w - 2, h - 2)), axis=(1, 2))
    clear = within > max(_MIN_CHANGE, _MIN_CHANGE_SIGMAS * change.noise) ** 2
    ok = np.flatnonzero(seen & clear & (outside < _MAX_BACKGROUND_VARIANCE * within))
    ratio = ratio[ok]
    k = np.argmax(ratio < level, axis=1)
    i = np.arange(len(ratio))
    before, after = ratio[i, k - 1], ratio[i, k]
    with np.errstate(invalid="ignore", divide="ignore"):
        edge = np.where(np.isfinite(before), k - (level - after) / (before - after), k - 0.5)
    place, i = (reach - _SAMPLING_PX * edge)[k > _OUTSIDE_SAMPLES], ok[k > _OUTSIDE_SAMPLES]
    return pixels[i] + place[:, None] * normal[i]


def _steps(mean: Array, outline: Outline, edges: Array, camera: InteriorOrientation) -> Array:
    """Return the places, (n, 2) px, at which the mean picture has a clear step of brightness across the outline.

    They are near the `edges` of the change, (m, 2) px. Gloss moves those edges inwards, but not the steps.
    """
    pixels = outline.pixels(camera)
    normal, offset = _normals(pixels), np.arange(-_STEP_REACH_PX, _STEP_REACH_PX + _SAMPLING_PX, _SAMPLING_PX)
    profile = _sample(mean, pixels[:, None] + offset[:, None] * normal[:, None])
    slope = np.abs(profile[:, 2:] - profile[:, :-2]) / (2.0 * _SAMPLING_PX)
    k, i = np.argmax(slope, axis=1), np.arange(len(slope))
    inner = np.clip(k, 1, slope.shape[1] - 2)
    a, b, c = (slope[i, inner + d] for d in (-1, 0, 1))
    place = offset[1 + inner] + _SAMPLING_PX * 0.5 * (a - c) / np.minimum(a - 2.0 * b + c, -1e-9)
    near = np.min(np.linalg.norm(pixels[:, None] - edges[None], axis=2), axis=1) < 2.0 * _STEP_REACH_PX
    ok = near & (k == inner) & (b > _MIN_STEP_SLOPE)
    return pixels[ok] + place[ok, None] * normal[ok]


def _normals(pixels: Array) -> Array:
    """Return the unit normals of a closed outline, (m, 2) px, outwards."""
    ahead = np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0)
    normal = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    normal *= np.sign(np.sum(normal * (pixels - pixels.mean(axis=0)), axis=1))[:, None]
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True), float)


def _sample(image: Array, at: Array) -> Array:
    """Return the values of an image at places, (..., 2) px."""
    x, y = np.moveaxis(at.astype(np.float32), -1, 0)
    return cv2.remap(np.ascontiguousarray(image, np.float32), x, y, cv2.INTER_CUBIC).astype(float)


def _has_other(moving: Image, change: Change, outline: Outline, camera: InteriorOrientation, level: float) -> bool:
    """Return whether another ball turns: a second region that moves, round, large, and with an edge all around."""
    pixels = outline.pixels(camera)
    rest = _fill_polygon(moving, pixels.mean(axis=0) + 1.1 * (pixels - pixels.mean(axis=0)), 0)
    try:
        other, _ = _refine(change, _ransac(rest, camera), camera, level)
    except CalibrationError:
        return False
    disc = _fill_polygon(np.zeros_like(rest), other.pixels(camera), 255)
    common = np.count_nonzero(rest & disc)
    least = _MIN_OVERLAP * max(np.count_nonzero(rest), np.count_nonzero(disc))
    return bool(common > least) and other.angle > _MIN_OTHER_SIZE * outline.angle


def _fill_polygon(image: Image, pixels: Array, value: int) -> Image:
    """Return an image with a polygon of (n, 2) px that has a grey value."""
    return np.asarray(cv2.fillPoly(image.copy(), [np.rint(np.clip(pixels, -1e4, 1e4)).astype(np.int32)], value))
