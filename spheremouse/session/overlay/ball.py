"""What the tracker sees, drawn on the frame: a picture or a video to judge by eye.

Detected contours white, targets green, discs of the map where they are predicted red with the last epochs fading
(Wittich 2017, fig. 27), masked look-alikes blue, the ball's outline thin; a strip with numbers below.
"""

import os
from collections import deque
from collections.abc import Callable
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
from spheremouse.session.overlay.pen import _EPOCHS, WHITE, Image, Mark, Pen, canvas_of

_PICTURES = (".png", ".jpg", ".jpeg")
# MPEG-4 plays in every player though not in every browser, and costs 2 ms a frame; VP8, which browsers play, costs 80.
_CODECS = {".mkv": "mp4v", ".mp4": "mp4v", ".avi": "MJPG"}


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
