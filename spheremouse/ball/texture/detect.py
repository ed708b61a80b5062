"""The anchors of a ball's picture in a frame, and what the frame teaches of the picture.

The picture of the ball is learnt while the ball turns. Until it has turned, what stands in front of it looks like a
part of it. So the ball is not tracked before something turns as the ball does. After a longer turn the picture loses
what it took from pixels that stand still.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Detections, Image, no_detections
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.outline import SeenCentre
from spheremouse.ball.phases.bearing import interval
from spheremouse.ball.rig import view_of
from spheremouse.ball.state import CentreCheck, Learning, Recognising, Tracker, TrackState
from spheremouse.ball.texture.centre import has_moved, image_shift, is_lifted, is_measured, measure_centre, update_check
from spheremouse.ball.texture.picture import (
    DETAIL,
    SHADING,
    SHOWS,
    STATIC_ODDS,
    Alignment,
    ChartLight,
    Picture,
    Tiles,
    align,
    contrast_noise,
    contrast_of_samples,
    contrast_on_chart,
    empty_picture,
    first_seen,
    forget,
    grain_of,
    is_symmetric,
    learn,
    seen_again,
    seen_with_skew,
    shows_all_axes,
    tiles_in_view,
    tiles_to_learn,
    tilt_sigma,
    weigh,
    with_skew,
    without_past,
)
from spheremouse.ball.texture.picture_map import PictureMap, resize, state_from_map
from spheremouse.ball.texture.search import (
    CLEAR,
    Lesson,
    Level,
    Shutter,
    TextureDetector,
    TextureState,
    compared_with_itself,
    fits,
    is_ambiguous,
    near,
    search,
    significance,
)
from spheremouse.ball.texture.view import TextureView
from spheremouse.geometry.rotation import Array, rotation_between
from spheremouse.native import kernels
from spheremouse.tracker import Frame, Status

TURNING = 0.7  # of the parts of the ball that are known to turn: a hand or a strut may cover the others
_MIN_SAMPLES = 100  # samples of a part of the ball that show it
_TURNED_PX = 17.0  # path, in pixels, after which most pixels of a pattern have shown whether they turn
_MOVED_PX = 0.5  # path that shows the cells other pixels
_LESSON_ANGLE = 0.2  # rad, of a turn that brings so much into view that the next lesson does not wait for its frame
_DETAIL_ANGLE = 0.03  # rad, of path that shows a sample another part of the pattern
_MAX_TILES = 1300  # that a frame learns: half of those in view, in less than a millisecond
_TASK_CYCLE = 4  # frames, of which one is learnt, one weighed, one compared: neighbours in time show the same
# such paths, of which one in `_TASK_CYCLE` is weighed, after which the contrast of light is known
_PATHS_TO_KNOW_LIGHT = 10.0
_FRAME_WEIGHT = 0.1  # of one frame in the running means, which cover a third of a second at 30 Hz
# standard deviation of an anchor's place per axis: errors of the picture that its pixels share
_ANCHOR_FLOOR_PX = 0.05
_ANCHOR_PRIOR_SIGMA = 0.01  # rad, of an anchor's place relative to the whole alignment
MAX_ANCHOR_SIGMA = 0.005  # rad, standard deviation above which the pixels around an anchor do not determine its place
_MIN_DETAILS = 0.25  # of the usual details, below which the ball is covered: another pattern may have half of them


def detect_texture(
    state: TrackState[So3State], frame: Frame, tracker: Tracker[So3Filter], predicted: So3State
) -> tuple[Detections, TextureState]:
    """Return the anchors in view as detections, and the state of the detector."""
    detector: TextureDetector = tracker.detector_data
    before, lost = state.search, _is_lost(state)
    if isinstance(before, PictureMap):
        before = state_from_map(detector, frame, before)
    if not isinstance(before, TextureState) or _begins(state, detector, before):
        now = _begin(detector, frame, predicted.attitude)
        found, anchors = _detections(detector.fine, now.alignment, tracker, predicted, np.zeros(3))
        return found, now._replace(shown=anchors)
    readout = 0.0 if lost else tracker.rig.readout_s + predicted.readout
    sample = partial(_sample, detector, before, frame.image, readout * predicted.rate)
    fit = sample(image_shift(tracker, predicted.centre))
    expected = state.reported_attitude if lost else predicted.attitude  # a ball that was hidden mostly rested
    alignment, turns = near(detector, fit.state, expected)
    if lost and not (before.turned or turns):
        alignment = None  # a static scene would fit
    if alignment is None and before.turned:
        near_to = None if isinstance(state.phase, Recognising) else expected
        shutter = _shutter(state, frame.stamp, readout)
        alignment, now = search(detector, fit.state, near_to, lost, shutter)
        fit = fit._replace(state=now._replace(searched=True))
    elif before.turned and before.alignment is None and alignment is not None:
        alignment = None if is_ambiguous(detector, fit.state, alignment) else alignment
    fit = fit._replace(alignment=alignment)
    if alignment is not None and before.turned and not tracker.detector.sees_discs:
        fit = _at_seen_centre(state, frame.stamp, tracker, predicted, fit, sample)
    return _learnt(fit, tracker, predicted, turns=turns, stamp=frame.stamp)


def _is_lost(state: TrackState[So3State]) -> bool:
    return state.status is Status.LOST or isinstance(state.phase, Recognising)


class _Fit(NamedTuple):
    """A frame, sampled for one place of the ball's centre, and how it fits the picture."""

    off: Array  # (2,) px, of the ball's image from its place
    light: tuple[ChartLight, ChartLight]
    noise: float  # of a contrast; larger in the dark, where noise is no change
    state: TextureState
    alignment: Alignment | None = None
    shift: SeenCentre | None = None  # of the centre from its place, if it was measured
    check: CentreCheck = CentreCheck()  # of the bearings, after that measurement


def _sample(detector: TextureDetector, before: TextureState, image: Image, skew: Array, off: Array) -> _Fit:
    light, mean_grey = detector.light(image, off)
    noise = contrast_noise(before.grain, mean_grey)
    return _Fit(off, light, noise, _with_contrast(detector, before, light, noise, skew))


def _at_seen_centre(
    state: TrackState[So3State],
    stamp: float,
    tracker: Tracker[So3Filter],
    predicted: So3State,
    fit: _Fit,
    sample: Callable[[Array], _Fit],
) -> _Fit:
    """Return a frame's fit with the ball's centre as the frame shows it.

    A lost ball that is lifted fits nowhere. If the centre has left its place, `sample` samples the frame for the
    measured one.
    """
    assert fit.alignment is not None
    detector: TextureDetector = tracker.detector_data
    moves, lost = predicted.centre_noise > 0.0, _is_lost(state)
    if not (moves or lost or is_measured(fit.state, fit.alignment)):
        return fit
    shift = measure_centre(detector.fine, fit.state, fit.alignment, predicted)
    if shift is None:
        return fit
    if lost and is_lifted(shift, state, tracker):
        return fit._replace(alignment=None)
    check = state.centre
    if not (moves or fit.state.searched):
        check = update_check(check, shift, fit.state, predicted, interval(state, stamp))
    if fit.state.searched or not (moves or has_moved(check)):
        return fit._replace(shift=shift, check=check)
    there = sample(image_shift(tracker, shift.axes @ shift.place))
    alignment, _ = near(detector, there.state, fit.alignment.attitude)
    if alignment is None:  # the shift explains nothing
        return fit
    return there._replace(alignment=alignment, shift=shift, check=check)


def _learnt(
    fit: _Fit, tracker: Tracker[So3Filter], predicted: So3State, *, turns: bool, stamp: float
) -> tuple[Detections, TextureState]:
    """Return the detections of a frame, and the state with what the frame shows of the ball.

    `turns` is true if samples that are known to turn fit.
    """
    detector: TextureDetector = tracker.detector_data
    now, alignment = fit.state, fit.alignment
    if alignment is not None:
        now = _update_pictures(detector, now, fit.light, alignment)
        now = now._replace(unseen=now.unseen + _FRAME_WEIGHT * (float(not shows_all_axes(alignment)) - now.unseen))
        if not now.searched:
            now = _with_running_means(now, alignment)
            if now.turned and now.frame_index % _TASK_CYCLE == _TASK_CYCLE - 1:
                now = compared_with_itself(detector, now, alignment)
    elif _details(now) < _MIN_DETAILS * now.details:
        now = now._replace(last_plain_stamp=stamp)
    found, anchors = _detections(detector.fine, alignment, tracker, predicted, now.fine.seen.skew)
    found = replace(found, centre=found.centre + fit.off)
    proven = now.turned or now.proven
    if alignment is not None and turns and not proven and _path(detector, now, alignment) > _apart(detector.fine):
        clear = significance(alignment) > CLEAR  # else no search would find a lost ball
        proven = clear and _turns_all_over(detector.fine, now.fine, alignment.attitude, fit.noise)
    return found, now._replace(alignment=alignment, shown=anchors, proven=proven, shift=fit.shift, check=fit.check)


def _with_running_means(now: TextureState, alignment: Alignment) -> TextureState:
    """Return the state with its running means of fit after a frame that fits near its prediction."""
    scale = alignment.scale if now.usual_scale == np.inf else now.usual_scale
    return now._replace(
        usual=now.usual + _FRAME_WEIGHT * (alignment.correlation - now.usual),
        usual_scale=scale + _FRAME_WEIGHT * (alignment.scale - scale),
        usual_significance=now.usual_significance + _FRAME_WEIGHT * (significance(alignment) - now.usual_significance),
        details=now.details + _FRAME_WEIGHT * (_details(now) - now.details),
    )


def _begins(state: TrackState[So3State], detector: TextureDetector, before: TextureState) -> bool:
    """Return whether a picture begins with this frame. A known one also serves at another pose of the camera."""
    if isinstance(state.phase, Learning) and not state.phase.found and before.alignment is None:
        return True
    return not (before.view is detector.fine or before.turned)


def _shutter(state: TrackState[So3State], stamp: float, readout: float) -> Shutter | None:
    """Return the shutter, which takes `readout` s, and the last confirmed motion; None if all rows are one exposure."""
    since = stamp - state.confirmed_at
    if readout == 0.0 or since <= 0.0:
        return None
    return Shutter(readout, state.reported_attitude, state.filter.rate, since)


def _with_contrast(
    detector: TextureDetector, before: TextureState, shown: tuple[ChartLight, ChartLight], noise: float, skew: Array
) -> TextureState:
    """Return the state with the samples of a frame. At another pose of the camera, none has a past."""
    levels = []
    for view, level, light in zip(detector.views, (before.fine, before.coarse), shown, strict=True):
        contrast = contrast_of_samples(view, light)
        if before.view is detector.fine:
            seen = with_skew(view, level.seen, skew)
            levels.append(level._replace(seen=seen_again(view, seen, contrast, noise)))
        else:
            seen = with_skew(view, without_past(first_seen(view, contrast)), skew)
            levels.append(Level(seen, resize(level.picture, view.cells)))
    fine, coarse = levels
    return before._replace(
        view=detector.fine, fine=fine, coarse=coarse, frame_index=before.frame_index + 1, searched=False
    )


def _details(now: TextureState) -> int:
    """Return the number of coarse samples that show a detail, and may turn."""
    seen = now.coarse.seen
    return int(np.count_nonzero((np.abs(seen.contrast) > SHOWS * now.noise) & (seen.counts > STATIC_ODDS)))


def _turns_all_over(view: TextureView, level: Level, attitude: Array, noise: float) -> bool:
    """Return whether most parts of the ball in view have turned since the first frame. A hand is in fewer.

    One sample of a faint pattern is no evidence, but all samples of a part are. The first frame has more noise than the
    picture, a mean of frames. So its contrast counts by the share that is no noise: else noise would turn.
    """
    first, part = np.nan_to_num(level.seen.first), np.argmax(view.anchors.astype(np.float32) @ view.direction, axis=0)
    power = np.bincount(part, first * first) / np.maximum(np.bincount(part), 1)
    pattern = np.maximum(1.0 - (noise**2 - SHADING**2) / np.maximum(power, 1e-12), 0.0)  # Wiener's filter
    seen = level.seen._replace(mean=(pattern[part] * first).astype(np.float32), odds=np.zeros_like(level.seen.odds))
    nats = weigh(view, seen, level.picture, attitude, noise, apart=0.0).odds
    counts = seen.counts > STATIC_ODDS
    known = counts & (nats != 0.0)  # the first frame did not show the others, so they prove nothing
    if 2 * np.count_nonzero(known) < np.count_nonzero(counts):
        return False
    number = np.bincount(part[known], minlength=len(power))
    total = np.bincount(part[known], nats[known], minlength=len(power)) / DETAIL
    return bool(np.count_nonzero(total > -STATIC_ODDS) > TURNING * np.count_nonzero(number >= _MIN_SAMPLES))


def _apart(view: TextureView) -> int:
    """Return the path, px, from which a sample and its place in the first frame share no grey value.

    Their contrasts are those of a mean of means each. On a shorter path the noise of the first frame, and what stands
    still, pull the alignment back to that frame.
    """
    return 2 * (view.widths[0] - 1)


def _path(detector: TextureDetector, now: TextureState, alignment: Alignment | None) -> float:
    """Return the path of the ball's surface since the first frame, px."""
    return 0.0 if alignment is None else _angle(alignment.attitude, now.began) / detector.fine.pixel


def _begin(detector: TextureDetector, frame: Frame, attitude: Array) -> TextureState:
    """Return the state after the first frame: its picture, aligned with itself."""
    shown, light = detector.light(frame.image)
    grain = grain_of(detector.resampling, frame.image)
    noise = contrast_noise(grain, light)
    levels = []
    for view, one in zip(detector.views, shown, strict=True):
        seen = first_seen(view, contrast_of_samples(view, one))
        tiles = tiles_in_view(view, attitude)
        picture = learn(view, seen, contrast_on_chart(view, one), empty_picture(view), attitude, tiles)
        levels.append(Level(seen, picture))
    alignment = align(detector.fine, levels[0].seen, levels[0].picture, attitude, noise)
    return TextureState(
        detector.fine,
        levels[0],
        levels[1],
        grain,
        noise,
        attitude,
        attitude,
        alignment=alignment if fits(alignment) else None,
    )


def _angle(a: Array, b: Array) -> float:
    return float(np.linalg.norm(rotation_between(a, b)))


def _update_pictures(
    detector: TextureDetector, now: TextureState, shown: tuple[ChartLight, ChartLight], alignment: Alignment
) -> TextureState:
    """Return the state with what a frame shows of the ball at its alignment, and of what stands still.

    A frame that shows no rotation about some axis teaches nothing, since its attitude about that axis is unknown. But
    stripes, which all hide the same axis of the ball, look the same at any rotation about it. A search may find a wrong
    attitude, so its frame teaches nothing before the next one fits near its prediction.
    """
    pixel, attitude = detector.fine.pixel, alignment.attitude
    path = _angle(attitude, now.alignment.attitude) if now.turned and now.alignment is not None else 0.0
    now = now._replace(shown_axes=now.shown_axes + path * (attitude.T @ alignment.known @ attitude))
    complete = shows_all_axes(alignment)
    placed = not now.searched and (complete or (now.reported[0] and is_symmetric(now.shown_axes)))
    starts = now.proven and not now.turned and _angle(attitude, now.began) > _TURNED_PX * pixel
    turn, task = divmod(now.frame_index, _TASK_CYCLE)
    since = _angle(attitude, now.learnt_at)
    moved = placed and now.turned and since > (_MOVED_PX * pixel if task == 0 else _LESSON_ANGLE)
    weighs = task == _TASK_CYCLE // 2 or not now.turned
    work = _Work(weighs, starts, moved, turn, min(path / _DETAIL_ANGLE, 1.0) / _PATHS_TO_KNOW_LIGHT)
    fine, coarse = (
        _level_after(view, level, light, attitude, now, work)
        for view, level, light in zip(detector.views, (now.fine, now.coarse), shown, strict=True)
    )
    learnt = attitude if starts or moved else now.learnt_at
    symmetric = now.symmetric or (moved and not complete)
    return now._replace(fine=fine, coarse=coarse, learnt_at=learnt, turned=now.turned or starts, symmetric=symmetric)


class _Work(NamedTuple):
    """Work of a frame on the pictures."""

    weighs: bool  # whether each sample turns
    starts: bool  # pictures of the ball alone
    moved: bool  # so far that another lesson begins
    turn: int  # number of the lesson
    settle: float  # share of the frame in the contrast that stands still


def _level_after(
    view: TextureView, level: Level, light: ChartLight, attitude: Array, now: TextureState, work: _Work
) -> Level:
    """Return samples and picture at one scale after a frame at an attitude."""
    seen, picture, lesson = level
    if work.weighs:
        seen = weigh(view, seen, picture, attitude, now.noise, work.settle)
    if work.starts:
        seen = seen_again(view, seen, seen.contrast, now.noise)
        picture = forget(view, seen, picture, now.began)
        lesson = Lesson(attitude, seen, contrast_on_chart(view, light), (tiles_in_view(view, attitude),))
    elif work.moved:
        parts = _parts(tiles_to_learn(view, picture, attitude, work.turn))
        lesson = Lesson(attitude, seen, contrast_on_chart(view, light), parts)
    if lesson is not None:
        picture, lesson = _with_lesson(view, picture, lesson)
    return Level(seen, picture, lesson)


def _parts(tiles: Tiles) -> tuple[Tiles, ...]:
    """Return tiles in parts, one for each frame until the next lesson at most."""
    return tuple(np.array_split(tiles, np.clip(-(-len(tiles) // _MAX_TILES), 1, _TASK_CYCLE)))


def _with_lesson(view: TextureView, picture: Picture, lesson: Lesson) -> tuple[Picture, Lesson | None]:
    """Return the picture after the next part of a lesson, and the rest of it."""
    part, *rest = lesson.parts
    learnt = learn(view, lesson.seen, lesson.contrast, picture, lesson.attitude, part)
    return learnt, lesson._replace(parts=tuple(rest)) if rest else None


def _detections(
    view: TextureView, alignment: Alignment | None, tracker: Tracker[So3Filter], predicted: So3State, skew: Array
) -> tuple[Detections, NDArray[np.intp]]:
    """Return the anchors whose surroundings a frame shows, as points of the image, and their numbers, (n,).

    The pixels around an anchor give a rotation of their own about the two axes across it, relative to the alignment of
    the whole. A rolling shutter shows an anchor where the ball, which turns by `skew`, (3,) rad in obj, has it then.
    """
    if alignment is None:
        return no_detections(), np.zeros(0, dtype=np.intp)
    facing = tracker.filter.station.towards, tracker.filter.station.horizon
    unseen = float(np.sum(predicted.joint[:3, :3] * (np.eye(3) - alignment.known)))  # rad², about unknown axes
    errors = MAX_ANCHOR_SIGMA, _ANCHOR_PRIOR_SIGMA, _ANCHOR_FLOOR_PX * view.pixel, tilt_sigma(alignment, unseen)
    place, covariance, which = kernels.anchor_points(
        view.anchors,
        alignment.attitude,
        alignment.information,
        alignment.gradient,
        errors,
        alignment.known,
        facing,
        view_of(view.rig, view.pose),
    )
    if skew.any():
        place = seen_with_skew(place, view.rig, view.pose, skew)
    return Detections(place, covariance, alignment.pixels[which]), which
