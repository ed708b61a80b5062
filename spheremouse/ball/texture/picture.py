"""Texture of the ball: its contrast in a frame, aligned with a picture of the ball that earlier frames have taught.

Contrast is the grey value less the mean of a small neighbourhood, over the mean of a larger one. Light that changes
slowly over the ball, and its level, cancel. The picture has the contrast of each place of the ball, on the faces of a
cube. The alignment gives the attitude that explains most pixels (`align.cpp`). Each part of the picture has an anchor,
a direction on the ball. The detector returns the anchors in view as points of the image, with the covariance that the
pixels around each give it. To the filter an anchor is a disc.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.projection import GREY, sample_weights_of
from spheremouse.ball.outline import SeenCentre
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import Rig
from spheremouse.ball.texture.chart import Resampling
from spheremouse.ball.texture.view import SMALL_WIDTH, TILE, Floats, TextureView, neighbourhood_mean, rows_showing
from spheremouse.geometry.camera import Pose, row_of
from spheremouse.geometry.rotation import Array, exp, hat
from spheremouse.native import kernels

Tiles = NDArray[np.int64]
Samples = tuple[Floats, Floats, Floats, Floats]  # contrast, direction, log odds and offset, for `kernels`

STATIC_ODDS = kernels.STATIC_ODDS  # log odds below which a sample does not turn with the ball
SHADING = 0.005  # standard deviation of a contrast without image noise
LEAST_WEIGHT = kernels.LEAST_WEIGHT  # of a known cell: one oblique view
_ROUNDING_SIGMA = 0.4  # grey values, of mean and interpolation
_DARK_OFFSET = 10.0  # grey values, added to the larger mean: in the dark, contrast is noise
_MAX_MEAN_VIEWS = 20.0  # in the mean of a cell: new dirt on the ball shows after a turn
_VIEWS_PER_HALVING = 2.0  # views of a tile, after which it is learnt half as often
_MAX_HALVINGS = 3  # times that this halves
# standard deviations of a contrast, of one that may not have changed, and of a detail
_UNCHANGED_SIGMAS, SHOWS = 3.0, 2.0
_DISTINCT_SIGMAS = 3.0  # standard deviations of a contrast, by which what turns and what stands still differ
DETAIL = 8.0  # samples of one detail of the contrast, which are not independent
_FRAME_WEIGHT = 0.2  # of a frame in the mean contrast
_MIN_SKEW_PX = 0.1  # px of the chart, by which a rolling shutter shifts a sample: less does not count
_GROUP_PX = 0.3  # px of the chart, by which the ball turns while a group of tiles is exposed
SHADING_PX = 0.1  # by which light that stands still shifts a contour
_CONTOUR_PX = 0.1  # standard deviation of a contour of the picture: interpolation and blur


class ChartLight(NamedTuple):
    """Light of a frame on a chart."""

    light: Image  # (h, w) grey values, 0 beside the ball
    far: Floats  # (h, w) of this chart or of a coarser one: mean grey value of a large neighbourhood


class Picture(NamedTuple):
    """The contrast of the ball's surface on six faces of a cube, and how often each cell was seen."""

    value: Floats  # (6, n, n)
    weight: Floats  # (6, n, n) views, each by the squared cosine of its obliqueness
    known: Floats  # (6, t, t) mean weight of each tile


class Seen(NamedTuple):
    """Samples of a frame, each with the odds that it turns with the ball."""

    contrast: Floats  # (n,)
    mean: Floats  # (n,) contrast of late
    odds: Floats  # (n,) log odds that the sample turns with the ball
    least: Floats  # (n,) log odds of the sample of its neighbourhood that stands still most likely
    offset: Floats  # (n,) contrast that stands still: of light, its shadows and reflections
    first: Floats  # (n,) contrast of the first frame
    counts: Floats  # (n,) `least`, or -inf for a detail that may stand still since the first frame
    turning: Floats  # (n,) `counts`, or -inf for any sample that may
    direction: Floats  # (3, n) obj, at the frame's stamp
    skew: Array  # (3,) rad, rotation of the ball, in obj, while a rolling shutter exposes all rows


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
    known: Array  # (3, 3) projection to the axes, obj, about which the pixels show a rotation
    tilt: float  # of the other axes, if all pixels shared an error: rotation seen by rotation about them


class AlignmentScale(NamedTuple):
    """Scale of the samples that are aligned, and the anchors to which their information belongs."""

    contour: float  # rad, standard deviation of a contour of the picture
    pixel: float  # rad, between two samples
    anchor_of: NDArray[np.int64]  # (6, t, t) the anchor of each tile
    across: Array  # (k, 3, 3) of the tiles of each anchor, mean projection across their directions


def light_on_charts(fine: TextureView, coarse: TextureView, grey: Image) -> tuple[tuple[ChartLight, ChartLight], float]:
    """Return what grey values on a chart, 0 beside the ball, show there and on the coarse chart, and their mean."""
    size = coarse.chart.size
    rough = np.asarray(cv2.resize(grey, (size, size), interpolation=cv2.INTER_AREA))
    rough = np.asarray(cv2.bitwise_and(rough, coarse.inside), np.uint8)
    far = neighbourhood_mean(rough.astype(np.float32), coarse.widths[1]) * coarse.share + np.float32(_DARK_OFFSET)
    mean = float(rough.sum() / max(np.count_nonzero(coarse.inside), 1))
    return (ChartLight(grey, far), ChartLight(rough, far)), mean


def contrast_of_samples(view: TextureView, shown: ChartLight) -> Floats:
    """Return the contrast of the samples, (n,)."""
    return kernels.contrast_of_samples(shown.light, view.at, shown.far, view.widths[0] // 2)


def empty_picture(view: TextureView) -> Picture:
    """Return a picture of which nothing is known."""
    shape = (6, view.cells, view.cells)
    tiles = view.cells // TILE
    return Picture(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros((6, tiles, tiles), np.float32))


def first_seen(view: TextureView, contrast: Floats) -> Seen:
    """Return the samples of a first frame by their contrast, (n,). All may turn with the ball."""
    zero = np.zeros(len(view.at), np.float32)
    return Seen(contrast, contrast, zero, zero, zero, contrast, zero, zero, view.direction, np.zeros(3))


def without_past(seen: Seen) -> Seen:
    """Return the samples of a view that is new, though the ball is known: none is in doubt for what it showed first."""
    return seen._replace(first=np.full_like(seen.first, np.nan))


def with_skew(view: TextureView, seen: Seen, skew: Array) -> Seen:
    """Return the samples of a frame in which the ball turns by `skew`, (3,) rad in obj, while all rows are exposed.

    Their directions are those at the frame's stamp, the middle of the exposure. If that differs by less than a tenth of
    a pixel from what the camera sees, they are as the camera sees them.
    """
    if np.linalg.norm(skew) < 2.0 * _MIN_SKEW_PX * view.pixel:
        return seen._replace(direction=view.direction, skew=np.zeros(3))
    x, turn = view.direction, hat(skew).astype(np.float32)
    return seen._replace(direction=x - view.row * (turn @ (x - 0.5 * view.row * (turn @ x))), skew=skew)


def seen_with_skew(place: Array, rig: Rig, pose: Pose, skew: Array) -> Array:
    """Return where a rolling shutter shows points of the ball, (n, 2) px, that are at `place` at the frame's stamp.

    The ball turns by `skew`, (3,) rad in obj, while all rows are exposed.
    """
    direction, index = directions_at(place, rig, pose)
    row = row_of(place[index, 1], rig.camera.height)
    seen = place.copy()
    seen[index] = seen_at(np.einsum("nij,nj->ni", exp(row[:, None] * skew), direction), rig, pose)
    return seen


def seen_again(view: TextureView, seen: Seen, contrast: Floats, noise: float) -> Seen:
    """Return the samples with the contrast of a frame, (n,).

    A sample that shows a detail, and shows the same as in the first frame, is in doubt until it is known to turn.
    """
    samples = contrast, seen.direction, seen.least, seen.offset
    counts, turning = kernels.leave_out_doubtful(
        samples, seen.first, seen.odds, _UNCHANGED_SIGMAS * noise, SHOWS * noise
    )
    return seen._replace(contrast=contrast, counts=counts, turning=turning)


def align(view: TextureView, seen: Seen, picture: Picture, attitude: Array, noise: float) -> Alignment:
    """Return the attitude near `attitude`, (3, 3), that explains a frame. `noise` is that of a contrast."""
    scale = AlignmentScale(_CONTOUR_PX * view.pixel, view.pixel, view.anchor_of, view.across)
    return align_samples(_samples(seen, seen.turning), picture, attitude, noise, scale)


def align_samples(
    samples: Samples, picture: Picture, attitude: Array, noise: float, scale: AlignmentScale
) -> Alignment:
    """Return the attitude near `attitude`, (3, 3), that explains samples. `noise` is that of a contrast."""
    attitude = np.ascontiguousarray(attitude)
    return Alignment(*kernels.align_texture(samples, picture[:2], attitude, noise, *scale))


def measure_shift(view: TextureView, seen: Seen, picture: Picture, attitude: Array, noise: float) -> SeenCentre:
    """Return the ball's centre by a frame, relative to the place for which the frame was resampled.

    `attitude`, (3, 3), is that of the alignment. Across the line of sight, a shift looks like a rotation in the middle
    of the ball, but not towards its outline.
    """
    ball = view.rig.ball
    axes = view.chart.axes[:2]
    shift, covariance = kernels.shift_of_texture(
        _samples(seen, seen.turning),
        picture[:2],
        np.ascontiguousarray(attitude),
        noise,
        _CONTOUR_PX * view.pixel,
        view.pixel,
        (view.pose.position - ball.centre) / ball.radius,
        np.ascontiguousarray(axes),
    )
    scatter = DETAIL * ball.radius**2 * covariance
    return SeenCentre(ball.radius * shift, axes.T, scatter, (SHADING_PX * view.pixel * ball.radius) ** 2)


def shows_all_axes(alignment: Alignment) -> bool:
    """Return whether the pixels show a rotation about any axis."""
    return bool(np.trace(alignment.known) > 2.5)


def is_symmetric(shown_axes: Array) -> bool:
    """Return whether a pattern looks the same at any rotation about an axis of the ball, as stripes do.

    `shown_axes`, (3, 3), is the sum of projections to the axes that frames showed, in ball. All frames of stripes hide
    one axis. Wood hides one axis in one view, and another axis in the next. If the hidden axis scatters by less than a
    small neighbourhood, no rotation about it moves a detail.
    """
    least, _, most = np.linalg.eigvalsh(shown_axes)
    return bool(least < SMALL_WIDTH**2 * most)


def tilt_sigma(alignment: Alignment, unseen: float) -> float:
    """Return the standard deviation, rad, of the alignment about its known axes, due to errors of their directions.

    `unseen` is the variance, rad², of the rotation about the other axes.
    """
    return float(alignment.tilt * (max(unseen, 0.0) * DETAIL / alignment.used) ** 0.5)


def tiles_in_view(view: TextureView, attitude: Array) -> Tiles:
    """Return the tiles, (k,), of which a frame at `attitude`, (3, 3), shows a part."""
    return np.flatnonzero(view.tiles @ (view.chart.axes[2] @ attitude) > view.least_height)


def tiles_to_learn(view: TextureView, picture: Picture, attitude: Array, turn: int) -> Tiles:
    """Return the tiles, (k,), in view that a turn learns. The more often one was seen, the less it gains."""
    which = tiles_in_view(view, attitude)
    every = 1 << np.minimum(picture.known.ravel()[which] / _VIEWS_PER_HALVING, _MAX_HALVINGS).astype(int)
    return which[(which - turn) % every == 0]


def learn(view: TextureView, seen: Seen, contrast: Floats, picture: Picture, attitude: Array, tiles: Tiles) -> Picture:
    """Return the picture with what some tiles show in a frame at `attitude`, (3, 3), with the chart's contrast, (h, w).

    A cell is the mean of up to 20 views.
    """
    return _learn_tiles(view, seen, contrast, picture, attitude, tiles, forget=False)


def forget(view: TextureView, seen: Seen, picture: Picture, attitude: Array) -> Picture:
    """Return the picture without what a frame at `attitude`, (3, 3), took from pixels that stand still."""
    nothing = np.zeros(view.inside.shape, np.float32)
    return _learn_tiles(view, seen, nothing, picture, attitude, tiles_in_view(view, attitude), forget=True)


def _learn_tiles(
    view: TextureView, seen: Seen, contrast: Floats, picture: Picture, attitude: Array, tiles: Tiles, forget: bool
) -> Picture:
    learnt = Picture(*(part.copy() for part in picture))
    shown = contrast, view.number, seen.counts, seen.offset, view.step
    for turned, part in _exposed_together(view, seen.skew, attitude, tiles):
        kernels.learn_texture(shown, learnt, part, view.chart, turned, _MAX_MEAN_VIEWS, forget)
    return learnt


def _exposed_together(view: TextureView, skew: Array, attitude: Array, tiles: Tiles) -> list[tuple[Array, Tiles]]:
    """Return tiles in groups of about one exposure, (k,), each with the ball's attitude then, (3, 3).

    `attitude` is that at the stamp. Within a group the ball turns by less than a third of a pixel.
    """
    groups = int(np.linalg.norm(skew) / (_GROUP_PX * view.pixel)) + 1
    if groups == 1:
        return [(attitude, tiles)]
    group = np.rint(groups * rows_showing(view.tiles[tiles] @ attitude.T, view.rig, view.pose)).astype(int)
    return [(exp(skew * (k / groups)) @ attitude, tiles[group == k]) for k in np.unique(group)]


def contrast_on_chart(view: TextureView, shown: ChartLight) -> Floats:
    """Return the contrast on the chart, (h, w)."""
    return kernels.contrast_on_chart(shown.light, view.inside, shown.far, view.widths[0] // 2)


def with_doubtful(seen: Seen) -> Seen:
    """Return the samples so that those in doubt count as well."""
    return seen._replace(counts=seen.least, turning=seen.least)


def grain_of(resampling: Resampling, image: Image) -> float:
    """Return the standard deviation of the grey values of a chart by the noise of green in an image.

    Grey has less. With that, a hand on a ball with a faint pattern would pass for a ball that turns.
    """
    colours = np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None])
    rows, columns = resampling.window
    weights = sample_weights_of(GREY, colours.shape[2])
    noise = kernels.noise_of(colours, weights, rows.start, rows.stop, columns.start, columns.stop)
    return float(np.hypot(noise / resampling.width, _ROUNDING_SIGMA))


def contrast_noise(grain: float, light: float) -> float:
    """Return the standard deviation of a contrast, by that of grey values over their mean."""
    return float(np.hypot(SHADING, grain / max(light, 1.0)))


def plain_share(view: TextureView, contrast: Floats, noise: float) -> float:
    """Return the part of the ball in view, 0 to 1, on which the contrast, (n,), is no more than `noise`.

    It is that of the samples nearest to each anchor.
    """
    part = np.argmax(view.anchors.astype(np.float32) @ view.direction, axis=0)
    number, squares = np.bincount(part), np.bincount(part, contrast * contrast)
    return float(number[squares < number * noise**2].sum() / number.sum())


def weigh(
    view: TextureView,
    seen: Seen,
    picture: Picture,
    attitude: Array,
    noise: float,
    settle: float = 0.0,
    apart: float = _DISTINCT_SIGMAS,
) -> Seen:
    """Return the samples with the odds after a frame at `attitude`, (3, 3), that they turn with the ball.

    What stands still affects the contrast of its neighbourhood too. The offset takes the share `settle` of a frame.
    A sample tells only if the two explanations are `apart` standard deviations.
    """
    mean, odds, offset = seen.mean.copy(), seen.odds.copy(), seen.offset.copy()
    after = mean, odds, offset
    kernels.weigh_static(_samples(seen, seen.counts), picture[:2], attitude, after, noise, _FRAME_WEIGHT, settle, apart)
    reach = 2 * (-(-(view.widths[0] - 1) // view.step)) + 1
    grid = np.zeros(view.number.shape, np.float32)
    grid.ravel()[view.place] = odds
    least = cv2.erode(cv2.medianBlur(grid, 3), np.ones((reach, reach), np.uint8))  # a single sample may be chance
    return seen._replace(mean=mean, odds=odds, offset=offset, least=least.ravel()[view.place])


def _samples(seen: Seen, odds: Floats) -> Samples:
    """Return the samples as the native functions have them, with their log odds."""
    return seen.contrast, seen.direction, odds, seen.offset


def correlate(seen: Seen, picture: Picture, attitudes: Array, most: int) -> Array:
    """Return the correlation, (n,), of a frame and the picture at attitudes, (n, 3, 3), by the `most` best samples."""
    samples = _samples(seen, seen.counts)
    return kernels.correlate_texture(samples, picture[:2], np.ascontiguousarray(attitudes), most)
