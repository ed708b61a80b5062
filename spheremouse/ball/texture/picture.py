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
from spheremouse.ball.rig import Rig
from spheremouse.ball.texture.chart import Chart, Resampling
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels

Floats = NDArray[np.float32]
Samples = tuple[Floats, Floats, Floats, Floats, int]  # contrast, direction, log odds, offset and step, for `kernels`

STATIC_ODDS = kernels.STATIC_ODDS  # log odds below which a sample does not turn with the ball
_NOISE = 0.01  # of a contrast, without image noise: shading
TILE = kernels.TILE  # cells along the edge of a tile
LEAST_WEIGHT = kernels.LEAST_WEIGHT  # of a known cell: one oblique view
HALF = 1.1  # half the width of a face, as `picture.h` has it
_CELL_PX = 1.5  # width of a cell, and of a pixel of the chart, where the ball is nearest, px
FINEST, COARSEST = 320, 32  # cells along a face: a ball of 350 px, one of 44 px
_SMALL, _LARGE = 0.032, 0.6  # rad, widths of the neighbourhoods; the small one is a mean of means
_ROUNDING = 0.4  # grey values, of mean and interpolation
_DARK = 10.0  # grey values, added to the larger mean: in the dark, contrast is noise
_MOST_SAMPLES = 16000
_SAME, SHOWS = 3.0, 2.0  # standard deviations of a contrast, of one that may not have changed, and of a detail
_APART = 3.0  # standard deviations of a contrast, by which what turns and what stands still differ
DETAIL = 8.0  # samples of one detail of the contrast, which are not independent
_OF_LATE = 0.2  # of a frame in the mean contrast
_CONTOUR_PX = 0.1  # standard deviation of a contour of the picture: interpolation and blur


@dataclass(frozen=True, slots=True)
class TextureView:
    """Constant data of one camera pose."""

    rig: Rig
    pose: Pose
    chart: Chart
    inside: Image  # (h, w) 255 on the ball, 0 elsewhere, of the chart
    share: tuple[Floats, ...]  # (h, w) one over the small and the large neighbourhood of a ball of grey value 1
    widths: tuple[int, int]  # px of the chart, of the small and of the large neighbourhood
    direction: Floats  # (rows, columns, 3) obj, of samples every `step` px of the chart; nan: not on the ball
    nothing: Floats  # (rows, columns) 0, or -inf where a sample is not on the ball
    step: int  # px
    cells: int  # along a face of the picture
    anchors: Array  # (k, 3) unit vectors, ball
    anchor_of: NDArray[np.int64]  # (6, t, t) the nearest anchor of each tile

    @property
    def pixel(self) -> float:
        """Angle of the ball between two pixels of the chart, rad."""
        return self.chart.spacing


class Picture(NamedTuple):
    """The contrast of the ball's surface on six faces of a cube, and how often each cell was seen."""

    value: Floats  # (6, n, n)
    weight: Floats  # (6, n, n) views, each by the squared cosine of its obliqueness
    known: Floats  # (6, t, t) mean weight of each tile


class Seen(NamedTuple):
    """Samples of a frame, each with the odds that it turns with the ball."""

    contrast: Floats  # (h, w) of the chart
    mean: Floats  # (rows, columns) contrast of late
    odds: Floats  # (rows, columns) log odds that the sample turns with the ball
    least: Floats  # (rows, columns) log odds of the sample of its neighbourhood that stands still most likely
    offset: Floats  # (rows, columns) contrast that stands still: of light, its shadows and reflections
    first: Floats  # (rows, columns) contrast of the first frame
    counts: Floats  # (rows, columns) `least`, or -inf for a detail that may stand still since the first frame
    turning: Floats  # (rows, columns) `counts`, or -inf for any sample that may


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


class AlignmentScale(NamedTuple):
    """Scale of the samples that are aligned, and the anchors to which their information belongs."""

    contour: float  # rad, standard deviation of a contour of the picture
    pixel: float  # rad, between two samples
    anchor_of: NDArray[np.int64]  # (6, t, t) the anchor of each tile
    anchors: int


def texture_view(rig: Rig, pose: Pose, chart: Chart, inside: NDArray[np.bool_]) -> TextureView:
    """Return the constant data of a rig's ball as the camera sees it from `pose`.

    `inside`, (size, size), is True where the chart shows the ball.
    """
    small = 2 * max(round(0.5 * _SMALL / chart.spacing), 1) + 1
    large = 2 * round(0.5 * _LARGE / chart.spacing) + 1
    shown = inside.astype(np.uint8)
    share = _inverse(_summed_twice(shown, small)), _inverse(_box(shown.astype(np.float32), large))
    step = max(round(float(np.sqrt(np.count_nonzero(inside) / _MOST_SAMPLES))), 1)
    direction = chart.directions()
    whole = cv2.erode(shown, np.ones((2 * small - 1, 2 * small - 1), np.uint8))
    direction[~(chart.facing(direction) > kernels.FACING) | (whole == 0)] = np.nan
    direction = np.ascontiguousarray(direction[::step, ::step], dtype=np.float32)
    nothing = np.where(np.isfinite(direction[..., 0]), 0.0, -np.inf).astype(np.float32)
    cells = int(np.clip(TILE * round(2.0 * HALF / (chart.spacing * TILE)), COARSEST, FINEST))
    anchors = anchor_directions()
    anchor_of = np.argmax(cell_directions(cells // TILE) @ anchors.T, axis=-1)
    return TextureView(
        rig, pose, chart, 255 * shown, share, (small, large), direction, nothing, step, cells, anchors, anchor_of
    )


def texture_spacing(rig: Rig, pose: Pose) -> float:
    """Return the angle of the ball, rad, between two pixels of a chart that has the details of the picture."""
    return max(_CELL_PX * texture_pixel(rig, pose), 2.0 * HALF / FINEST)


def texture_pixel(rig: Rig, pose: Pose) -> float:
    """Return the angle of the ball, rad, that a pixel shows where the ball is nearest."""
    distance = float(np.linalg.norm(pose.position - rig.ball.centre)) - rig.ball.radius
    return distance / (rig.ball.radius * max(rig.camera.intrinsic[:2]))


def contrast_of(fine: TextureView, coarse: TextureView, grey: Image) -> tuple[tuple[Floats, Floats], float]:
    """Return the contrast of a chart's grey values, (h, w) on it and on the coarse chart, and the mean grey value."""
    size = coarse.chart.size
    rough = np.asarray(cv2.resize(grey, (size, size), interpolation=cv2.INTER_AREA))
    light = cv2.bitwise_and(rough, coarse.inside).astype(np.float32)
    far = np.asarray(cv2.multiply(_box(light, coarse.widths[1]), coarse.share[1]) + np.float32(_DARK), np.float32)
    mean = float(light.sum() / max(np.count_nonzero(coarse.inside), 1))
    return (_contrast(fine, grey, far), _contrast(coarse, rough, far)), mean


def _contrast(view: TextureView, grey: Image, far: Floats) -> Floats:
    light = np.asarray(cv2.bitwise_and(grey, view.inside), np.uint8)
    return kernels.contrast_on_chart(light, _summed_twice(light, view.widths[0]), view.share[0], far)


def _summed_twice(picture: Image, width: int) -> Floats:
    """Return the sums over a neighbourhood that is nearly round: sums of sums. The `width` is up to 16 px."""
    sums = cv2.boxFilter(picture, cv2.CV_16U, (width, width), normalize=False)
    return np.asarray(cv2.boxFilter(sums, cv2.CV_32F, (width, width), normalize=False), np.float32)


def _box(picture: Image | Floats, width: int) -> Floats:
    return np.asarray(cv2.blur(picture, (width, width)), np.float32)


def _inverse(part: Floats) -> Floats:
    return np.asarray(1.0 / np.maximum(part, 1e-3), np.float32)


def empty_picture(view: TextureView) -> Picture:
    """Return a picture of which nothing is known."""
    shape = (6, view.cells, view.cells)
    tiles = view.cells // TILE
    return Picture(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros((6, tiles, tiles), np.float32))


def first_seen(view: TextureView, contrast: Floats) -> Seen:
    """Return the samples of a first frame: all may turn with the ball."""
    mean = np.ascontiguousarray(contrast[:: view.step, :: view.step])
    zero = np.zeros(mean.shape, np.float32)
    return Seen(contrast, mean, zero, view.nothing, zero, mean, view.nothing, view.nothing)


def without_past(seen: Seen) -> Seen:
    """Return the samples of a view that is new, though the ball is known: none is in doubt for what it showed first."""
    return seen._replace(first=np.full_like(seen.first, np.nan))


def seen_again(view: TextureView, seen: Seen, contrast: Floats, noise: float) -> Seen:
    """Return the samples with the contrast of a frame.

    A sample that shows a detail, and shows the same as in the first frame, is in doubt until it is known to turn.
    """
    samples = contrast, view.direction, seen.least, seen.offset, view.step
    counts, turning = kernels.leave_out_doubtful(samples, seen.first, seen.odds, _SAME * noise, SHOWS * noise)
    return seen._replace(contrast=contrast, counts=counts, turning=turning)


def align(view: TextureView, seen: Seen, picture: Picture, attitude: Array, noise: float) -> Alignment:
    """Return the attitude near `attitude`, (3, 3), that explains a frame. `noise` is that of a contrast."""
    scale = AlignmentScale(_CONTOUR_PX * view.pixel, view.pixel, view.anchor_of, len(view.anchors))
    return align_samples(_samples(view, seen, seen.turning), picture, attitude, noise, scale)


def align_samples(
    samples: Samples, picture: Picture, attitude: Array, noise: float, scale: AlignmentScale
) -> Alignment:
    """Return the attitude near `attitude`, (3, 3), that explains samples. `noise` is that of a contrast."""
    attitude = np.ascontiguousarray(attitude)
    return Alignment(*kernels.align_texture(samples, picture[:2], attitude, noise, *scale))


def learn(
    view: TextureView, seen: Seen, picture: Picture, attitude: Array, most: float, turn: int = -1, forget: bool = False
) -> Picture:
    """Return the picture with what a frame at `attitude`, (3, 3), shows. A cell is the mean of up to `most` views.

    With a `turn`, the number of calls so far, each call learns some of the well known parts. With `forget`, the picture
    loses instead what a frame at that attitude took from pixels that stand still.
    """
    learnt = Picture(*(part.copy() for part in picture))
    kernels.learn_texture(
        _samples(view, seen, seen.counts),
        learnt[:2],
        learnt.known,
        view.chart,
        attitude,
        most,
        turn,
        forget,
    )
    return learnt


def with_doubtful(seen: Seen) -> Seen:
    """Return the samples so that those in doubt count as well."""
    return seen._replace(counts=seen.least, turning=seen.least)


def grain_of(resampling: Resampling, image: Image) -> float:
    """Return the standard deviation of the grey values of a chart by the noise of an image."""
    colours = np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None])
    rows, columns = resampling.window
    weights = sample_weights_of(GREY, colours.shape[2])
    noise = kernels.noise_of(colours, weights, rows.start, rows.stop, columns.start, columns.stop)
    return float(np.hypot(noise / resampling.width, _ROUNDING))


def contrast_noise(grain: float, light: float) -> float:
    """Return the standard deviation of a contrast, by that of grey values over their mean."""
    return float(np.hypot(_NOISE, grain / max(light, 1.0)))


def weigh(
    view: TextureView,
    seen: Seen,
    picture: Picture,
    attitude: Array,
    noise: float,
    settle: float = 0.0,
    apart: float = _APART,
) -> Seen:
    """Return the samples with the odds after a frame at `attitude`, (3, 3), that they turn with the ball.

    What stands still affects the contrast of its neighbourhood too. The offset takes the share `settle` of a frame.
    A sample tells only if the two explanations are `apart` standard deviations.
    """
    mean, odds, offset = seen.mean.copy(), seen.odds.copy(), seen.offset.copy()
    after = mean, odds, offset
    kernels.weigh_static(
        _samples(view, seen, seen.counts), picture[:2], attitude, after, noise, _OF_LATE, settle, apart
    )
    reach = 2 * (-(-(view.widths[0] - 1) // view.step)) + 1
    least = cv2.erode(cv2.medianBlur(odds, 3), np.ones((reach, reach), np.uint8))  # a single sample may be chance
    return seen._replace(mean=mean, odds=odds, offset=offset, least=least + view.nothing)


def _samples(view: TextureView, seen: Seen, odds: Floats) -> Samples:
    """Return the samples as the native functions have them, with their log odds."""
    return seen.contrast, view.direction, odds, seen.offset, view.step


def correlate(view: TextureView, seen: Seen, picture: Picture, attitudes: Array, most: int) -> Array:
    """Return the correlation, (n,), of a frame and the picture at attitudes, (n, 3, 3), by the `most` best samples."""
    samples = _samples(view, seen, seen.counts)
    return kernels.correlate_texture(samples, picture[:2], np.ascontiguousarray(attitudes), most)


def anchor_directions() -> Array:
    """Return the 20 corners of a dodecahedron as unit vectors, (20, 3): anchors 42° apart."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    signs = (-1.0, 1.0)
    cube = [(a, b, c) for a in signs for b in signs for c in signs]
    others = [np.roll([0.0, a / golden, b * golden], k) for k in range(3) for a in signs for b in signs]
    return np.array([*cube, *others]) / 3.0**0.5


def cell_directions(cells: int) -> Array:
    """Return the unit vectors in `ball` of the middles of a picture's cells, or of its tiles, (6, n, n, 3)."""
    at = (2.0 * (np.arange(cells) + 0.5) / cells - 1.0) * HALF
    a, b = np.meshgrid(at, at, indexing="ij")
    found = np.empty((6, cells, cells, 3))
    for face in range(6):
        axis = face // 2
        found[face, ..., axis] = -1.0 if face % 2 else 1.0
        found[face, ..., (axis + 1) % 3], found[face, ..., (axis + 2) % 3] = a, b
    return found / np.linalg.norm(found, axis=-1, keepdims=True)
