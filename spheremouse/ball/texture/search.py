"""Attitudes at which a frame shows what the picture of the ball shows.

The search begins near the predicted attitude. If the frame does not fit there, the coarse picture shows which attitudes
may fit: near ones, those farther away, and for a lost ball all attitudes, a part of them in each frame.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import clear_mask
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import unmasked
from spheremouse.ball.outline import SeenCentre
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import CentreCheck
from spheremouse.ball.texture.chart import IN_PLACE, Chart, Resampling, chart_of, resampling
from spheremouse.ball.texture.picture import (
    DETAIL,
    Alignment,
    ChartLight,
    Picture,
    Seen,
    Tiles,
    align,
    correlate,
    light_on_charts,
    with_doubtful,
    with_skew,
)
from spheremouse.ball.texture.view import (
    Floats,
    TextureView,
    rows_showing,
    texture_pixel,
    texture_spacing,
    texture_view,
)
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, exp, log, rotation_between

_COARSE_FACTOR = 4  # times as large are the details of the coarse picture: it shows the way from four times as far
MIN_CORRELATION = 0.35  # of frame and picture: with noise as strong as the pattern in both, it is a half
# standard deviations of the correlation of independent pictures: near a prediction, by a search of many attitudes, and
# of a pattern that a search can find while half of it is covered
_MIN_NEAR_SIGNIFICANCE, _MIN_SEARCH_SIGNIFICANCE, CLEAR = 6.0, 9.0, 12.0
# A wrong attitude fits some details by chance. So a search must find so much of the usual correlation and of its
# significance, and residuals up to so many times the usual ones. A hand or blur may make them larger near a prediction.
_MIN_USUAL_CORRELATION, _MIN_USUAL_SIGNIFICANCE, _MAX_SEARCH_SCALE, _MAX_NEAR_SCALE = 0.7, 0.5, 1.6, 2.5
_MIN_CHANGED_PART = 0.05  # part of the informative samples that changes by more than noise once the ball turns
# rad, of a search: no attitude is farther than 2.3° from the grid, where the coarse picture fits
_GRID_STEP = float(np.radians(2.7))
_FLICK_ANGLE, _JUMP_ANGLE = float(np.radians(12.0)), float(np.radians(48.0))  # a flick between two frames, and a jump
# rad, apart are two attitudes of a pattern that repeats itself; part of the significance that both have
_MIN_RIVAL_ANGLE, _MIN_RIVAL_SIGNIFICANCE = float(np.radians(6.0)), 0.7
_SEARCH_SAMPLES, _PRESELECTION_SAMPLES = 200, 50  # samples
_MAX_FULL_ATTITUDES = 1000  # attitudes that are looked at with all samples
_STARTS = 4  # attitudes of a search from which an alignment starts
_SKEW_SIGMA = 0.05  # rad, of a rotation while rows are exposed: a rate in doubt by 200 °/s, and 15 ms
FRAMES_PER_SEARCH = 64  # of all attitudes: each frame tries another part of them
PARTS_OF_COMPARISON = 4096  # of the ball with itself


@dataclass(frozen=True, slots=True)
class TextureDetector:
    """The views of a ball at two scales."""

    resampling: Resampling  # from an image to the fine chart
    fine: TextureView
    coarse: TextureView

    @property
    def views(self) -> tuple[TextureView, TextureView]:
        """The views, the fine one first."""
        return self.fine, self.coarse

    def light(self, image: Image, shift: Array = IN_PLACE) -> tuple[tuple[ChartLight, ChartLight], float]:
        """Return what an image shows on the fine and on the coarse chart, and the mean grey value.

        The ball's image is off its place by `shift`, (2,) px.
        """
        return light_on_charts(self.fine, self.coarse, self.resampling(image, shift))


def texture_detector(rig: Rig, pose: Pose, masks: Iterable[tuple[float, ...]] = ()) -> TextureDetector:
    """Return the detector for a rig's ball as the camera sees it from `pose`. `masks` are those of `DiscSettings`.

    Raises ConfigurationError if the masks hide the whole ball, or all but a margin.
    """
    mask = unmasked(clear_mask(rig, pose), masks)
    chart, resample = texture_chart(rig, pose)
    inside = chart.inside & (resample(mask) == 255)
    parts = inside.reshape(chart.size // _COARSE_FACTOR, _COARSE_FACTOR, chart.size // _COARSE_FACTOR, _COARSE_FACTOR)
    fine = texture_view(rig, pose, chart, inside)
    coarse = texture_view(rig, pose, chart.reduced(_COARSE_FACTOR), parts.all(axis=(1, 3)))
    if len(coarse.at) == 0 or len(fine.at) == 0:
        raise ConfigurationError("discs.masks: they leave nothing of the ball: give smaller ones")
    return TextureDetector(resample._replace(inside=fine.inside), fine, coarse)


def texture_chart(rig: Rig, pose: Pose) -> tuple[Chart, Resampling]:
    """Return the fine chart of a rig's ball as the camera sees it from `pose`, and the way to it from an image."""
    spacing = texture_spacing(rig, pose)
    chart = chart_of(rig, pose, spacing, _COARSE_FACTOR)
    return chart, resampling(chart, rig, pose, 2 * max(round(0.5 * spacing / texture_pixel(rig, pose)), 1) + 1)


class Lesson(NamedTuple):
    """A frame whose tiles the picture learns in parts, one for each of the next frames."""

    attitude: Array  # (3, 3) R_obj_ball
    seen: Seen
    contrast: Floats  # (h, w) of the chart
    parts: tuple[Tiles, ...]


class Level(NamedTuple):
    """Samples and picture at one scale."""

    seen: Seen
    picture: Picture
    lesson: Lesson | None = None


class TextureState(NamedTuple):
    """State of the detector between frames."""

    view: TextureView  # of the samples of `fine`
    fine: Level
    coarse: Level
    grain: float  # grey values, noise of a pixel of the fine chart
    noise: float  # of a contrast, in the light of the first frame
    began: Array  # (3, 3) attitude of the first frame
    learnt_at: Array  # (3, 3) attitude of the last frame that was learnt
    proven: bool = False  # what changes turns like the ball
    turned: bool = False  # it has turned so far that the pictures show it alone
    frame_index: int = 0  # since the first frame
    alignment: Alignment | None = None  # of the last frame; None: it fits nowhere
    searched: bool = False  # it was not near the prediction
    usual: float = 0.0  # running mean of the correlation of frames that fitted near their predictions
    usual_scale: float = np.inf  # of the residuals of these frames, in standard deviations; inf: none since the start
    usual_significance: float = 0.0  # of their correlation, in standard deviations
    details: float = 0.0  # coarse samples of these frames that showed a detail
    compared: int = 0  # parts of all attitudes at which the ball was compared with itself
    repeats: bool = False  # it looks the same at another attitude
    unseen: float = 0.0  # share of recent frames that showed no rotation about some axis
    # (3, 3) ball, projections to the axes about which frames showed a rotation, summed over the path of the ball, rad
    shown_axes: Array = np.zeros((3, 3))
    symmetric: bool = False  # the picture was taught at unknown rotations about an axis, as if they changed nothing
    reported: tuple[bool, bool] = (False, False)  # by events: frames show no rotation about some axis; `repeats`
    shift: SeenCentre | None = None  # of the ball's centre in the last frame, from its place, if it was measured
    check: CentreCheck = CentreCheck()  # of the bearings, after that measurement
    last_plain_stamp: float = -np.inf  # s, stamp of the last frame without a fit that showed few details
    shown: NDArray[np.intp] = np.zeros(0, dtype=np.intp)  # (n,) the anchors of the last frame's detections


class Shutter(NamedTuple):
    """A rolling shutter, and the motion from which the ball comes to a frame."""

    readout: float  # s, time it takes over all rows
    attitude: Array  # (3, 3) R_obj_ball
    rate: Array  # (3,) rad/s, obj
    since: float  # s

    def skew(self, attitude: Array) -> Array:
        """Return the rotation, (3,) rad in obj, of a ball that comes to `attitude`, (3, 3), while rows are exposed.

        The rate changes evenly between the frames.
        """
        return (2.0 * rotation_between(self.attitude, attitude) / self.since - self.rate) * self.readout


def exposed(detector: TextureDetector, now: TextureState, skew: Array) -> TextureState:
    """Return the state with samples of a ball that turns by `skew`, (3,) rad in obj, while all rows are exposed."""
    fine, coarse = (
        level._replace(seen=with_skew(view, level.seen, skew))
        for view, level in zip(detector.views, (now.fine, now.coarse), strict=True)
    )
    return now._replace(fine=fine, coarse=coarse)


def near(detector: TextureDetector, now: TextureState, attitude: Array) -> tuple[Alignment | None, bool]:
    """Return the alignment near an attitude, None if the frame does not fit, and whether samples out of doubt do."""
    found = align(detector.fine, now.fine.seen, now.fine.picture, attitude, now.noise)
    fitting = fits(found)
    if fitting or now.turned:
        usual = fitting and found.scale < _MAX_NEAR_SCALE * now.usual_scale
        return (found if usual else None), usual
    # Only what has changed since the first frame counted. If that is little, the ball rests.
    whole = align(detector.fine, with_doubtful(now.fine.seen), now.fine.picture, attitude, now.noise)
    return (whole if found.used < _MIN_CHANGED_PART * whole.used and fits(whole) else None), False


def search(
    detector: TextureDetector, now: TextureState, attitude: Array | None, lost: bool, shutter: Shutter | None = None
) -> tuple[Alignment | None, TextureState]:
    """Return the alignment of a frame by the coarse picture, from farther away; None if the frame fits nowhere.

    For a ball that is `lost`, this includes a part of all attitudes. A lost ball that repeats itself is not searched.
    `attitude` is None if nothing is known of it. The state has the samples as a rolling `shutter` shows them at the
    attitude found.
    """
    if lost and now.repeats:
        return None, now
    for start in _start_attitudes(detector, now, attitude, lost):
        found, at_frame = _fit_from(detector, now, start, shutter)
        if found is not None:
            return (None if is_ambiguous(detector, at_frame, found) else found), at_frame
    return None, now


def _fit_from(
    detector: TextureDetector, now: TextureState, start: Array, shutter: Shutter | None = None
) -> tuple[Alignment | None, TextureState]:
    """Return the alignment with the coarse picture from `start`, then the fine one; None if the frame does not fit.

    Each attitude expects another rate, and so other rows of a rolling shutter. A fine alignment that fits shows how the
    rows differ from that, and is made again.
    """

    def exposed_at(attitude: Array) -> TextureState:
        return now if shutter is None else exposed(detector, now, shutter.skew(attitude))

    def fine_from(attitude: Array) -> Alignment:
        return align(detector.fine, now.fine.seen, now.fine.picture, attitude, now.noise)

    now = exposed_at(start)
    rough = align(detector.coarse, now.coarse.seen, now.coarse.picture, start, now.noise)
    if not rough.correlation > MIN_CORRELATION:
        return None, now
    now = exposed_at(rough.attitude)
    found = fine_from(rough.attitude)
    if shutter is not None and fits(found):
        skew = now.fine.seen.skew + _unexplained_skew(detector.fine, found)
        now = exposed(detector, now, skew)
        found = fine_from(found.attitude)
    usual = found.correlation > _MIN_USUAL_CORRELATION * now.usual and found.scale < _MAX_SEARCH_SCALE * now.usual_scale
    least = max(_MIN_SEARCH_SIGNIFICANCE, _MIN_USUAL_SIGNIFICANCE * now.usual_significance)
    return (found if fits(found) and usual and significance(found) > least else None), now


def _unexplained_skew(view: TextureView, found: Alignment) -> Array:
    """Return the rotation, (3,) rad in obj, while rows are exposed, that explains how parts differ from the whole.

    A part of row r differs from the alignment of the whole by r times that rotation (least squares).
    """
    row = rows_showing(view.anchors @ found.attitude.T, view.rig, view.pose)
    row = np.clip(np.nan_to_num(row), -0.5, 0.5)
    H = np.einsum("k,kij->ij", row**2, found.information) + np.eye(3) / _SKEW_SIGMA**2
    return np.linalg.solve(H, row @ found.gradient)


def is_ambiguous(detector: TextureDetector, now: TextureState, found: Alignment) -> bool:
    """Return whether a frame that fits at an attitude fits about as well up to 48° away: the pattern repeats itself.

    Attitudes that differ only about an axis that no pixel shows count as one.
    """
    correlation = partial(correlate, now.coarse.seen, now.coarse.picture)
    for grid in _GRIDS:
        turns = grid[np.linalg.norm(log(grid) @ found.known, axis=1) > _MIN_RIVAL_ANGLE]
        if any(_is_rival(detector, now, found, start) for start in best_attitudes(correlation, turns @ found.attitude)):
            return True
    return False


def compared_with_itself(detector: TextureDetector, now: TextureState, found: Alignment) -> TextureState:
    """Return the state after a frame was compared with the picture at a part of all other attitudes.

    If the ball looks the same there, it repeats itself as a football does. Then no frame identifies a lost ball.
    """
    if now.repeats or now.compared == PARTS_OF_COMPARISON:
        return now
    turns = attitudes_of_part(now.compared, PARTS_OF_COMPARISON)
    attitudes = found.attitude @ turns[np.linalg.norm(log(turns), axis=1) > _MIN_RIVAL_ANGLE]
    correlation = partial(correlate, now.coarse.seen, now.coarse.picture)
    glanced = np.argsort(-correlation(attitudes, _PRESELECTION_SAMPLES))[:_STARTS]
    likely = attitudes[glanced][correlation(attitudes[glanced], _SEARCH_SAMPLES) > MIN_CORRELATION]
    repeats = any(_is_rival(detector, now, found, start) for start in likely)
    return now._replace(compared=now.compared + 1, repeats=repeats)


def _is_rival(detector: TextureDetector, now: TextureState, found: Alignment, start: Array) -> bool:
    """Return whether a frame that fits at an attitude fits as well at another one, near `start`."""
    other, _ = _fit_from(detector, now, start)
    if other is None or significance(other) < _MIN_RIVAL_SIGNIFICANCE * significance(found):
        return False
    return bool(np.linalg.norm(found.known @ rotation_between(found.attitude, other.attitude)) > 0.5 * _MIN_RIVAL_ANGLE)


def fits(alignment: Alignment) -> bool:
    """Return whether frame and picture show the same."""
    enough = alignment.correlation > MIN_CORRELATION and significance(alignment) > _MIN_NEAR_SIGNIFICANCE
    return alignment.converged and enough


def significance(alignment: Alignment) -> float:
    """Return the correlation of frame and picture in standard deviations of that of independent pictures."""
    return float(np.arctanh(min(alignment.correlation, 0.999)) * np.sqrt(alignment.used / DETAIL))


def _start_attitudes(
    detector: TextureDetector, now: TextureState, attitude: Array | None, lost: bool
) -> Iterator[Array]:
    """Yield attitudes, R_obj_ball (3, 3), from which an alignment may succeed, the likely ones first.

    They are the predicted `attitude`, the best ones near it, and the best ones farther away. For a `lost` ball follow
    the best of a part of all attitudes. If `attitude` is None, and the ball is not lost, there are none.
    """
    correlation = partial(correlate, now.coarse.seen, now.coarse.picture)
    if attitude is not None:
        yield attitude
        for turns in _GRIDS:
            yield from best_attitudes(correlation, turns @ attitude)
    if lost:
        yield from best_attitudes(correlation, attitudes_of_part(now.frame_index, FRAMES_PER_SEARCH))


def best_attitudes(correlation: Callable[[Array, int], Array], attitudes: Array) -> Array:
    """Return the attitudes, (k, 3, 3), with the largest correlation, by attitudes and a number of samples."""
    if len(attitudes) > _MAX_FULL_ATTITUDES:  # a part of the samples leaves few to look at
        rough = correlation(attitudes, _PRESELECTION_SAMPLES)
        attitudes = attitudes[np.argpartition(-rough, len(rough) // 20)[: len(rough) // 20]]
    return attitudes[np.argsort(-correlation(attitudes, _SEARCH_SAMPLES))[:_STARTS]]


def _grid(least: float, most: float) -> Array:
    """Return the rotations, (n, 3, 3), of a cubic grid of vectors with lengths from `least` to `most` rad."""
    k = np.arange(-int(most / _GRID_STEP), int(most / _GRID_STEP) + 1) * _GRID_STEP
    v = np.stack(np.meshgrid(k, k, k), axis=-1).reshape(-1, 3)
    length = np.linalg.norm(v, axis=1)
    return exp(v[(length > least) & (length <= most)].astype(np.float64))


def attitudes_of_part(part: int, parts: int) -> Array:
    """Return one of `parts` parts of all rotations, (n, 3, 3). `part` counts on beyond the last.

    The pole of the ball goes to directions on a spiral (Saff, Kuijlaars 1997, "Distributing many points on a sphere").
    About each the ball turns by equal steps.
    """
    n, m = round(4.0 * np.pi / _GRID_STEP**2), round(2.0 * np.pi / _GRID_STEP)
    k = np.arange(part % parts, n, parts)
    height, longitude = 1.0 - (2.0 * k + 1.0) / n, k * np.pi * (3.0 - 5.0**0.5)
    tilt = np.arccos(height)[:, None] * np.stack([-np.sin(longitude), np.cos(longitude), np.zeros(len(k))], axis=1)
    about = exp(np.arange(m)[:, None] * 2.0 * np.pi / m * np.array([0.0, 0.0, 1.0]))
    return (exp(tilt)[:, None] @ about[None]).reshape(-1, 3, 3)


_GRIDS = _grid(0.0, _FLICK_ANGLE), _grid(_FLICK_ANGLE, _JUMP_ANGLE)
