"""Texture of the ball: its contrast in a frame, aligned with a picture of the ball that earlier frames have taught.

Contrast is the grey value less the mean of a small neighbourhood, over the mean of a larger one. Light that changes
slowly over the ball, and its level, cancel. The picture has the contrast of each place of the ball, on the faces of a
cube. The alignment gives the attitude that explains most pixels (`align.cpp`). Each part of the picture has an anchor,
a direction on the ball. The detector returns the anchors in view as points of the image, with the covariance that the
pixels around each give it. To the filter an anchor is a disc.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.projection import GREY, sample_weights_of
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import Rig, view_of
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels

Floats = NDArray[np.float32]

STATIC_ODDS = -3.0  # log odds below which a sample does not turn with the ball, as `align.cpp` has it
_NOISE = 0.01  # of a contrast, without image noise: shading
_TILE = 8  # cells along the edge of a tile
_HALF = 1.1  # half the width of a face, as `picture.h` has it
_CELL_PX = 1.5  # width of a cell where the ball is nearest, px
_FINEST, _COARSEST = 256, 32  # cells along a face: a ball of 350 px, one of 44 px
_SMALL, _LARGE = 0.03, 0.3  # half widths of the neighbourhoods, in radii of the ball's image
_SMOOTH = 3  # px, width of the mean that stands for a pixel: samples are farther apart, and noise is less
_DARK = 10.0  # grey values, added to the larger mean: in the dark, contrast is noise
_MOST_SAMPLES = 16000
_CONTOUR_PX = 0.15  # standard deviation of a contour of the picture: interpolation and blur
_FACING = 0.3  # cosine between ray and normal from which a pixel shows the ball well


@dataclass(frozen=True, slots=True)
class TextureView:
    """Constant data of one camera pose."""

    rig: Rig
    pose: Pose
    window: tuple[slice, slice]  # rows and columns of the ball in the image
    reduction: int  # px of the image to one of the window
    inside: Floats  # (h, w) 1 on the ball, 0 elsewhere, of the window
    share: tuple[Floats, ...]  # (h, w) one over the part of each neighbourhood that is on the ball
    widths: tuple[int, int]  # px, of the small and of the large neighbourhood
    direction: Floats  # (rows, columns, 3) obj, of samples every `step` px of the window; nan: not on the ball
    step: int  # px
    pixel: float  # rad, of the ball, that a pixel shows where the ball is nearest; times `coarse`
    cells: int  # along a face of the picture
    anchors: Array  # (k, 3) unit vectors, ball
    anchor_of: NDArray[np.int64]  # (6, t, t) the nearest anchor of each tile


class Picture(NamedTuple):
    """The contrast of the ball's surface on six faces of a cube, and how often each cell was seen."""

    value: Floats  # (6, n, n)
    weight: Floats  # (6, n, n) views, each by the squared cosine of its obliqueness
    known: Floats  # (6, t, t) mean weight of each tile


class Seen(NamedTuple):
    """Samples of a frame, each with the odds that it turns with the ball."""

    contrast: Floats  # (h, w) of the window
    mean: Floats  # (rows, columns) contrast of late
    odds: Floats  # (rows, columns) log odds that the sample turns with the ball
    before: Floats  # (rows, columns) contrast of the first frame, until the ball has turned; then nan


class Alignment(NamedTuple):
    """The attitude that explains a frame, and the information of the pixels around each anchor."""

    attitude: Array  # (3, 3) R_obj_ball
    scale: float  # of the residuals, in standard deviations of their model
    correlation: float  # of frame and picture
    used: int  # pixels
    converged: bool
    information: Array  # (k, 3, 3) of a rotation, rad^-2
    gradient: Array  # (k, 3)
    pixels: Array  # (k,) number of them, each by its weight


def texture_view(rig: Rig, pose: Pose, mask: Image, coarse: int = 1) -> TextureView:
    """Return the constant data of a rig's ball as the camera sees it from `pose`, by details `coarse` times as large.

    A `mask`, (h, w), is 255 where the picture shows the ball.
    """
    window = _span(np.flatnonzero(mask.any(axis=1)), coarse), _span(np.flatnonzero(mask.any(axis=0)), coarse)
    inside = (_reduced(mask[window], coarse) == 255).astype(np.float32)
    pixel = texture_pixel(rig, pose)
    radius = 1.0 / (coarse * pixel)  # px, of the ball in the window
    small, large = (2 * max(round(part * radius), 2) + 1 for part in (_SMALL, _LARGE))
    share = tuple(_inverse(part) for part in (_twice(inside, small), _box(inside, large), _box(inside, _SMOOTH)))
    step = max(round(float(np.sqrt(np.count_nonzero(inside) / _MOST_SAMPLES))), 1)
    direction = _directions(rig, pose, window, inside, coarse, step)
    cells = int(np.clip(_TILE * round(2.0 * _HALF * radius / (_CELL_PX * _TILE)), _COARSEST, _FINEST))
    anchors = anchor_directions()
    anchor_of = np.argmax(tile_directions(cells) @ anchors.T, axis=-1)
    return TextureView(
        rig,
        pose,
        window,
        coarse,
        inside,
        share,
        (small, large),
        direction,
        step,
        coarse * pixel,
        cells,
        anchors,
        anchor_of,
    )


def texture_pixel(rig: Rig, pose: Pose) -> float:
    """Return the angle of the ball, rad, that a pixel shows where the ball is nearest."""
    distance = float(np.linalg.norm(pose.position - rig.ball.centre)) - rig.ball.radius
    return distance / (rig.ball.radius * max(rig.camera.intrinsic[:2]))


def _directions(rig: Rig, pose: Pose, window: tuple[slice, slice], inside: Floats, reduction: int, step: int) -> Floats:
    grid = np.mgrid[0 : inside.shape[0] : step, 0 : inside.shape[1] : step]
    shape = grid.shape[1:]
    middle = reduction * (grid + 0.5) - 0.5
    uv = np.stack([middle[1] + window[1].start, middle[0] + window[0].start], axis=-1).reshape(-1, 2)
    found, index = directions_at(uv, rig, pose)
    direction = np.full((len(uv), 3), np.nan, np.float32)
    ray = rig.ball.centre + rig.ball.radius * found - pose.position
    facing = -np.sum(found * ray, axis=1) / np.linalg.norm(ray, axis=1)
    shows = (facing > _FACING) & (inside[::step, ::step].ravel()[index] > 0)
    direction[index[shows]] = found[shows]
    return direction.reshape(*shape, 3)


def contrast_of(view: TextureView, image: Image) -> Floats:
    """Return the contrast of the ball's pixels in an image, (h, w) of the window."""
    part = image[view.window]
    grey = _reduced(part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), view.reduction)
    light = cv2.multiply(grey, view.inside, dtype=cv2.CV_32F)
    small, large = view.widths
    near = cv2.multiply(_twice(light, small), view.share[0])
    far = cv2.multiply(_box(light, large), view.share[1])
    smooth = cv2.multiply(_box(light, _SMOOTH), view.share[2])
    return np.ascontiguousarray(cv2.divide(smooth - near, far + _DARK) * view.inside, dtype=np.float32)


def _span(at: NDArray[np.intp], reduction: int) -> slice:
    """Return the rows or columns from the first to the last of `at`, in a multiple of `reduction`."""
    return slice(int(at[0]), int(at[0]) + (int(at[-1]) + 1 - int(at[0])) // reduction * reduction)


def _reduced(picture: Image, reduction: int) -> Image:
    if reduction == 1:
        return picture
    height, width = picture.shape
    return np.asarray(cv2.resize(picture, (width // reduction, height // reduction), interpolation=cv2.INTER_AREA))


def _box(picture: Image, width: int) -> Floats:
    return np.asarray(cv2.blur(picture, (width, width)), np.float32)


def _twice(picture: Image, width: int) -> Floats:
    """Return the mean over a neighbourhood that is nearly round."""
    return _box(_box(picture, width // 2 | 1), width // 2 | 1)


def _inverse(part: Image) -> Floats:
    return np.asarray(1.0 / np.maximum(part, 1e-3), np.float32)


def empty_picture(view: TextureView) -> Picture:
    """Return a picture of which nothing is known."""
    shape = (6, view.cells, view.cells)
    tiles = view.cells // _TILE
    return Picture(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros((6, tiles, tiles), np.float32))


def first_seen(view: TextureView, contrast: Floats) -> Seen:
    """Return the samples of a first frame: all may turn with the ball."""
    mean = np.ascontiguousarray(contrast[:: view.step, :: view.step])
    return Seen(contrast, mean, np.zeros(mean.shape, np.float32), mean)


def align(view: TextureView, seen: Seen, picture: Picture, attitude: Array, noise: float) -> Alignment:
    """Return the attitude near `attitude`, (3, 3), that explains a frame. `noise` is that of a contrast."""
    samples = seen.contrast, view.direction, seen.odds, seen.before, view.step
    return Alignment(
        *kernels.align_texture(
            samples,
            (picture.value, picture.weight),
            attitude,
            noise,
            _CONTOUR_PX * view.pixel,
            view.pixel,
            view.anchor_of,
            len(view.anchors),
        )
    )


def learn(
    view: TextureView, seen: Seen, picture: Picture, attitude: Array, most: float, turn: int = -1, forget: bool = False
) -> Picture:
    """Return the picture with what a frame at `attitude`, (3, 3), shows. A cell is the mean of up to `most` views.

    With a `turn`, the number of the frame, each frame learns a part. With `forget`, the picture loses instead what a
    frame at that attitude took from pixels that stand still.
    """
    learnt = Picture(*(part.copy() for part in picture))
    window = float(view.window[1].start), float(view.window[0].start), float(view.reduction)
    kernels.learn_texture(
        (seen.contrast, view.direction, seen.odds, seen.before, view.step),
        learnt[:2],
        learnt.known,
        view_of(view.rig, view.pose),
        attitude,
        window,
        most,
        turn,
        forget,
    )
    return learnt


def without_before(seen: Seen) -> Seen:
    """Return the samples without the contrast of the first frame, so that all count."""
    return seen._replace(before=np.full_like(seen.before, np.nan))


def contrast_noise(view: TextureView, image: Image) -> float:
    """Return the standard deviation of a contrast, by the noise of a pixel over the light."""
    colours = np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None])
    rows, columns = view.window
    weights = sample_weights_of(GREY, colours.shape[2])
    noise = kernels.noise_of(colours, weights, rows.start, rows.stop, columns.start, columns.stop)
    light = float(image[view.window][view.inside > 0].mean())  # a recording blackens the rest
    return float(np.hypot(_NOISE, noise / (_SMOOTH * max(light, 1.0))))


def weigh(view: TextureView, seen: Seen, picture: Picture, attitude: Array, noise: float, turn: int) -> Seen:
    """Return the samples with the odds after a frame at `attitude`, (3, 3), that they turn with the ball."""
    mean, odds = seen.mean.copy(), seen.odds.copy()
    kernels.weigh_static(
        (seen.contrast, view.direction, seen.odds, seen.before, view.step),
        picture[:2],
        attitude,
        mean,
        odds,
        noise,
        0.2,
        turn,
    )
    return seen._replace(mean=mean, odds=odds)


def correlate(view: TextureView, seen: Seen, picture: Picture, attitudes: Array, most: int) -> Array:
    """Return the correlation, (n,), of a frame and the picture at attitudes, (n, 3, 3), by the `most` best samples."""
    samples = seen.contrast, view.direction, seen.odds, seen.before, view.step
    return kernels.correlate_texture(samples, picture[:2], np.ascontiguousarray(attitudes), most)


def anchor_directions() -> Array:
    """Return the 42 corners and mid-edges of an icosahedron as unit vectors, (42, 3): anchors about 36° apart."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    corners = np.array([np.roll([0.0, a, b * golden], k) for k in range(3) for a in (-1, 1) for b in (-1, 1)])
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    first, second = np.nonzero(np.triu(corners @ corners.T > 0.4, 1))
    middle = corners[first] + corners[second]
    return np.concatenate([corners, middle / np.linalg.norm(middle, axis=1, keepdims=True)])


def tile_directions(cells: int) -> Array:
    """Return the unit vectors in `ball` of the middles of the picture's tiles, (6, t, t, 3)."""
    tiles = cells // _TILE
    at = (2.0 * (np.arange(tiles) + 0.5) / tiles - 1.0) * _HALF
    a, b = np.meshgrid(at, at, indexing="ij")
    found = np.empty((6, tiles, tiles, 3))
    for face in range(6):
        axis = face // 2
        found[face, ..., axis] = -1.0 if face % 2 else 1.0
        found[face, ..., (axis + 1) % 3], found[face, ..., (axis + 2) % 3] = a, b
    return found / np.linalg.norm(found, axis=-1, keepdims=True)
