"""What the tracker sees, drawn on the frame: a picture or a video to judge by eye.

Detected contours white, targets green, discs of the map where they are predicted red with the last epochs fading
(Wittich 2017, fig. 27), masked look-alikes blue, the ball's outline thin; a strip with numbers below.
"""

import os
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import appearance, ball_outline
from spheremouse.ball.pose import Resection, predict_targets
from spheremouse.ball.rig import Rig, directions_at
from spheremouse.ball.state import Phase, Tracker, TrackState, current
from spheremouse.errors import OutputError
from spheremouse.files.atomic import replace
from spheremouse.files.folders import NewFolder
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.conics import ellipse_to_pixel, project_circle
from spheremouse.geometry.rotation import Array
from spheremouse.session.offline import Epoch

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]  # blue, green, red

WHITE, GREEN, RED, BLUE, OUTLINE = (255, 255, 255), (90, 220, 60), (40, 40, 255), (230, 150, 60), (200, 200, 120)  # BGR
SHADOW = (40, 40, 40)
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates: a sixteenth of a pixel
_EPOCHS = 15  # epochs that fade: half a second
_PICTURES = (".png", ".jpg", ".jpeg")
# MPEG-4 plays in every player though not in every browser, and costs 2 ms a frame; VP8, which browsers play, costs 80.
_CODECS = {".mkv": "mp4v", ".mp4": "mp4v", ".avi": "MJPG"}


@dataclass(frozen=True, slots=True)
class Mark:
    """A target as it is drawn."""

    code: str
    centre: Array  # (2,) px
    shape: Array  # (2, 2) px², of the outer ring


def target_marks(rig: Rig, pose: Pose, seen: Resection | None) -> tuple[Mark, ...]:
    """Marks of the targets that the pose rests on, where they were seen; of all, where they should be, without it."""
    if len(rig.targets.codes) == 0:
        return ()
    codes, centres = (rig.targets.codes, predict_targets(pose, rig)) if seen is None else (seen.codes, seen.centre)
    points = pose.to_cam(rig.targets.position[[rig.targets.codes.index(c) for c in codes]])
    normal = np.broadcast_to(pose.rotation[2], points.shape)  # obj's Z axis in cam
    _, shape = ellipse_to_pixel(*project_circle(points, normal, float(rig.targets.radii[-1])), rig.camera)
    return tuple(Mark(c, p, s) for c, p, s in zip(codes, centres, shape, strict=True) if np.all(np.isfinite(p)))


class Overlay:
    """Draws epochs, and remembers the last few for their traces."""

    def __init__(self, tracker: Tracker, targets: tuple[Mark, ...] = (), scale: int = 1) -> None:
        """`scale` enlarges the frame before anything is drawn on it."""
        self._tracker, self._targets, self._scale = tracker, targets, scale
        self._outline = ball_outline(tracker.rig, tracker.pose)
        self._trace: deque[Array] = deque(maxlen=_EPOCHS)  # (m, 2) px each, the newest last

    def remember(self, state: TrackState) -> None:
        """The predicted discs of an epoch, for the traces; `draw` does not."""
        tracker = current(state, self._tracker)
        if tracker is not self._tracker:  # the camera was moved: what is drawn from its pose moves along
            self._tracker, self._outline = tracker, ball_outline(tracker.rig, tracker.pose)
            self._targets = target_marks(tracker.rig, tracker.pose, None)
            self._trace.clear()
        seen = _predicted(state, self._tracker)
        self._trace.append(seen if state.phase is not Phase.LOST else seen[:0])

    def draw(self, epoch: Epoch, counts: tuple[int, int, int]) -> Image:
        """The epoch that was remembered last, with the sum of counts so far."""
        state = epoch.state
        canvas = canvas_of(epoch.frame.image, self._scale)
        pen = Pen(canvas, self._scale)
        pen.outline(self._outline)
        pen.trace(list(self._trace))
        used = np.zeros(len(state.points), dtype=bool)
        used[epoch.state.filter.used] = True
        _draw_detections(pen, state, self._tracker, used)
        for mark in self._targets:
            pen.target(mark)
        for centre in _masked(state, self._tracker):
            pen.cross(centre)
        pen.caption(_cells(epoch, counts))
        return canvas


def canvas_of(image: Image, scale: int) -> Image:
    """A copy of a frame, grey or BGR, in colour and enlarged."""
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    if scale != 1:
        canvas = cv2.resize(canvas, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(canvas, dtype=np.uint8)


class OverlayFile:
    """A picture of the last drawing, or a video of all, under its name only when it is complete. A context manager."""

    def __init__(self, path: Path, fps: float | None) -> None:
        """`fps` is what a video plays at. Raises OutputError where nothing can be written there."""
        self.path = path
        self._picture = path.suffix.lower() in _PICTURES
        self._fps = fps or 30.0
        self._video: cv2.VideoWriter | None = None
        self._overlay: Overlay | None = None
        self._last: Callable[[], Image] | None = None
        self.written = False  # at the end, where there was anything to draw
        if path.is_dir():
            raise OutputError(f"{path}: is a folder; name a file in it")
        if not self._picture and path.suffix.lower() not in _CODECS:
            known = ", ".join((*_CODECS, *_PICTURES))
            raise OutputError(f"{path}: unknown kind of overlay; end the name in one of {known}")
        if not path.parent.is_dir():
            raise OutputError(f"{path}: cannot be written: there is no folder {path.parent}")
        self._new = NewFolder(path.with_name(f"{path.name}.part"), OutputError)  # that it can be made is known at once
        self._part = self._new.path / path.name

    def begin(self, tracker: Tracker, targets: tuple[Mark, ...]) -> None:
        """What will be drawn: known only once the camera's pose is."""
        self._overlay = Overlay(tracker, targets, self.scale(tracker.rig.camera.width))

    def add(self, epoch: Epoch, counts: tuple[int, int, int]) -> None:
        """One more epoch."""
        overlay = self._overlay
        assert overlay is not None
        overlay.remember(epoch.state)
        self.show(lambda: overlay.draw(epoch, counts))

    def scale(self, width: int) -> int:
        """By how much frames of a width, px, are to be enlarged: pictures more, they are looked at on their own."""
        return max(1, round((1280 if self._picture else 640) / width))

    def show(self, draw: Callable[[], Image]) -> None:
        """One more drawing: made now for a video, and only if it is the last for a picture."""
        self._last = draw
        if self._picture:
            return
        image = draw()
        if self._video is None:
            self._video = _open_video(self._part, self._fps, (image.shape[1], image.shape[0]))
        self._video.write(image)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._video is not None:
                self._video.release()
            if self._last is not None:
                if self._picture:
                    write_picture(self.path, self._last())
                else:
                    self._publish()
                self.written = True
        finally:
            self._new.discard()

    def _publish(self) -> None:
        """OpenCV's writer reports no errors: look whether the file can be read before it gets its name."""
        written = cv2.VideoCapture(str(self._part), cv2.CAP_FFMPEG)
        good = written.isOpened() and written.grab()
        written.release()
        if not good:
            raise OutputError(f"{self.path}: the video could not be written; is the disk full?")
        try:
            os.replace(self._part, self.path)
        except OSError as e:
            raise OutputError(f"{self.path}: cannot be written: {e.strerror or e}") from None


def write_picture(path: Path, image: Image, mode: int | None = None) -> None:
    """Write an image under its name only when it is complete; OutputError where that fails.

    `mode` is the file's, whatever the umask; without it, it is like any other file.
    """
    good, data = cv2.imencode(path.suffix, image)
    if not good:
        raise OutputError(f"{path}: OpenCV cannot write such a picture; use .png")
    try:
        replace(path, data.tobytes(), mode)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written: {e.strerror or e}") from None


def _open_video(path: Path, fps: float, size: tuple[int, int]) -> cv2.VideoWriter:
    codec = cv2.VideoWriter.fourcc(*_CODECS[path.suffix.lower()])
    video = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, fps, size)
    if not video.isOpened():
        raise OutputError(f"{path}: this OpenCV cannot write such a video; use another of {', '.join(_CODECS)} or .png")
    return video


def _predicted(state: TrackState, tracker: Tracker) -> Array:
    """Where the discs of the map are seen, (m, 2) px, those on the near side."""
    discs = np.asarray(state.filter.discs, dtype=float).reshape(-1, 3)
    seen = appearance(discs @ state.filter.attitude.T, tracker.rig, tracker.pose)
    return seen.centre[seen.whole]


def _masked(state: TrackState, tracker: Tracker) -> Array:
    """Detections set aside as look-alikes, (k, 2) px."""
    offset = state.detections.centre[:, None] - state.lookalikes.masks[None]
    near = np.linalg.norm(offset, axis=2) < tracker.settings.static.mask_radius
    near[state.points.index] = False
    return state.detections.centre[near.any(axis=1)]


def _draw_detections(pen: "Pen", state: TrackState, tracker: Tracker, used: NDArray[np.bool_]) -> None:
    """Contours as detected; where the detector fits ellipses and has none, the ellipse of the disc seen there."""
    weights = np.where(used, 1.0, 0.45)
    if state.detections.contours:
        for index, weight in zip(state.points.index, weights, strict=True):
            pen.contour(state.detections.contours[index], float(weight))
        return
    centre = state.detections.centre[state.points.index]
    directions, which = directions_at(centre, tracker.rig, tracker.pose)
    seen = appearance(directions, tracker.rig, tracker.pose)
    for k in np.flatnonzero(seen.whole):
        pen.ellipse(centre[which[k]], seen.shape[k], WHITE, float(weights[which[k]]))


class Pen:
    """Draws in the frame's pixels on a canvas `scale` times as large. Lines that leave the picture are cut."""

    def __init__(self, canvas: Image, scale: int) -> None:
        self._canvas, self._scale = canvas, scale
        self.width = max(1, round(min(canvas.shape[:2]) / 480))  # of a thin line, px

    def outline(self, points: Array) -> None:
        """A ball's outline, (n, 2) px: thin, as it is not detected but known."""
        layer = self._canvas.copy()
        cv2.polylines(layer, [self._fixed(points)], True, OUTLINE, self.width, cv2.LINE_AA, _SHIFT)
        cv2.addWeighted(layer, 0.55, self._canvas, 0.45, 0.0, dst=self._canvas)

    def contour(self, points: NDArray[np.int32], weight: float) -> None:
        """A contour as OpenCV gives it; a `weight` below 1 makes it greyer."""
        self._closed(points.reshape(-1, 2).astype(float), WHITE, weight)

    def line(self, points: Array, colour: Colour, weight: float = 1.0, width: int = 1) -> None:
        """A line through (n, 2) px, so many times as wide as a thin one."""
        if len(points) > 1:
            self._stroke(points, _dull(colour, weight), width * self.width)

    def ellipse(self, centre: Array, shape: Array, colour: Colour, weight: float = 1.0) -> None:
        """An ellipse of a shape, (2, 2) px²."""
        angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        rim = centre + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ np.linalg.cholesky(shape).T
        self._closed(rim, colour, weight)

    def trace(self, epochs: list[Array], colour: Colour = RED) -> None:
        """Dots at (m, 2) px of each epoch, the newest last: older ones smaller and fainter."""
        alpha = np.zeros(self._canvas.shape[:2], np.uint8)
        for age, points in reversed(list(enumerate(reversed(epochs)))):
            freshness = 1.0 - age / _EPOCHS
            radius = (0.9 + 1.9 * freshness) * self.width
            level = round(255 * (1.0 if age == 0 else 0.15 + 0.6 * freshness))
            for p in self._fixed(points):
                x, y = int(p[0]), int(p[1])
                cv2.circle(alpha, (x, y), round(radius * 2**_SHIFT), level, -1, cv2.LINE_AA, _SHIFT)
        rows, columns = np.nonzero(alpha)
        share = alpha[rows, columns, None].astype(np.float32) / 255.0
        mixed = self._canvas[rows, columns] * (1.0 - share) + np.array(colour, np.float32) * share
        self._canvas[rows, columns] = np.rint(mixed).astype(np.uint8)

    def cross(self, centre: Array) -> None:
        """A diagonal cross on a look-alike."""
        r = 5.0 * self.width / self._scale
        for arm in (np.array([r, r]), np.array([r, -r])):
            self._stroke(np.array([centre - arm, centre + arm]), BLUE, 2 * self.width)

    def target(self, mark: Mark) -> None:
        """A ring around the target, a crosshair through it, its code beside it."""
        self.ellipse(mark.centre, 1.6 * mark.shape, GREEN)
        across = np.sqrt(np.diag(mark.shape))
        for arm in 1.75 * np.diag(across):
            self._stroke(np.array([mark.centre - arm, mark.centre + arm]), GREEN, self.width)
        self.label(mark.code, mark.centre + (1.5, -1.1) * across, GREEN)

    def label(self, text: str, at: Array, colour: Colour) -> None:
        """Words that begin at a place, (2,) px, or as near to it as they are in the picture; with a shadow."""
        h, w = self._canvas.shape[:2]
        (long, high), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 11 * self.width / _LETTERS, 1)
        x, y = np.rint(np.nan_to_num(at) * self._scale).tolist()
        x, y = int(min(max(x, 0), w - long - 1)), int(min(max(y, high), h - 3 * high))
        _text(self._canvas, text, (x + self.width, y + self.width), 11 * self.width, SHADOW)
        _text(self._canvas, text, (x, y), 11 * self.width, colour)

    def caption(self, cells: Sequence[tuple[str, float]], height: int = 11) -> None:
        """A strip along the lower edge: words, each from a share of the width on, so that numbers do not dance."""
        h, w = self._canvas.shape[:2]
        size = height * self.width
        top = h - 2 * size
        self._canvas[top:] = self._canvas[top:] // 4
        for text, place in cells:
            _text(self._canvas, text, (round(place * w), h - round(0.65 * size)), size, (235, 235, 235))

    def _closed(self, points: Array, colour: Colour, weight: float) -> None:
        """A closed line."""
        fixed = [self._fixed(points)]
        cv2.polylines(self._canvas, fixed, True, _dull(colour, weight), self.width, cv2.LINE_AA, _SHIFT)

    def _stroke(self, points: Array, colour: Colour, width: int) -> None:
        cv2.polylines(self._canvas, [self._fixed(points)], False, colour, width, cv2.LINE_AA, _SHIFT)

    def _fixed(self, points: Array) -> NDArray[np.int32]:
        """Frame pixels to OpenCV's fixed point on the canvas; pixel centres stay pixel centres."""
        at = (np.asarray(points, dtype=float) + 0.5) * self._scale - 0.5
        return np.rint(np.clip(at, -1e5, 1e5) * 2**_SHIFT).astype(np.int32)


_LETTERS = 22.0  # px high at font scale 1


def _dull(colour: Colour, weight: float) -> Colour:
    b, g, r = (round(weight * c + (1.0 - weight) * 110) for c in colour)
    return b, g, r


def _text(image: Image, text: str, at: tuple[int, int], height: float, colour: Colour) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, height / _LETTERS, colour, 1, cv2.LINE_AA)


def _cells(epoch: Epoch, counts: tuple[int, int, int]) -> tuple[tuple[str, float], ...]:
    """Time, phase, rate, counts, discs."""
    state = epoch.state
    rate = "  ".join(f"{n} {np.rad2deg(v):+.1f}" for n, v in zip("XYZ", state.filter.rate, strict=True))
    return (
        (f"{epoch.frame.stamp:.2f} s  {state.phase}", 0.012),
        (f"{rate} deg/s", 0.2),
        (f"counts {counts[0]:+d} {counts[1]:+d} {counts[2]:+d}", 0.55),
        (f"discs {len(epoch.state.filter.used)} of {len(state.filter.discs)}", 0.86),
    )
