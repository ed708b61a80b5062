"""The part of a picture that a recording shows: the ball and the targets, and no people.

Kept is what the tracker looks at while it knows where the camera is, and no pixel more, so that a recording blacked out
everywhere else is tracked bit for bit as the whole picture was. The margins are therefore the reach of its filters:

- around the ball's outline the widest one, the closing that tells how bright the ball is beside a disc: one and a half
  discs, within the ball's bounding box;
- in that box sixteen lines, one pixel high, by which the noise of the picture is measured;
- around each target the patch by which the camera is watched, a few pixels by which it may be pushed, and the room
  that measuring its rings takes.

When all targets are looked for by their colours, after a large bump, the whole picture is searched: that alone does not
work on a masked recording.
"""

from dataclasses import replace

import cv2
import numpy as np

from spheremouse.ball import camera_watch as watch
from spheremouse.ball.build import build
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.geometry.camera import Pose

_NOISE_LINES = 16  # by which detect.fit measures the noise
_FIT = 4  # px of the reduced picture around a pixel of the ball: kernel of the fit, and a block cut by the outline
_PUSHED = 3  # px of a target's reduced patch: where it is looked for in an ordinary look (watch)
_RINGS = 6  # px, and a quarter of the patch: around a target whose rings are measured (watch)


def kept(rig: Rig, pose: Pose, settings: Settings) -> Image:
    """255 where a recording keeps a pixel, 0 where it is black, (h, w) uint8.

    Of a device seen from a pose, by a tracker with these settings. Raises PoseError where the ball is not in view.
    """
    default = replace(settings, detector="default", discs=replace(settings.discs, masks=()))
    detector = build(rig, pose, default).detector
    assert isinstance(detector, DiscDetector)
    mask = _around_ball(detector, clipped=settings.detector == "default")
    for left, top, right, bottom in _target_boxes(rig, pose):
        mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = 255
    return mask


def masked(image: Image, keep: Image | None) -> Image:
    """A copy of an image, (h, w, 3) or (h, w), black where `keep`, (h, w), is 0; all of it without `keep`."""
    return image.copy() if keep is None else cv2.copyTo(image, keep)


def _around_ball(detector: DiscDetector, clipped: bool) -> Image:
    """The ball with the reach of what finds and measures discs; `clipped`: nothing beyond its box is looked at."""
    f = detector.lattice.reduction
    rows, columns = detector.window
    closing = 2 * int(np.ceil(0.75 * detector.model.diameter / f))
    smoothing = int(np.ceil(3.0 * detector.settings.smoothing)) + 1
    wide = _grown(detector.model.mask, f * (closing + smoothing + 1))
    mask = _grown(detector.model.mask, f * _FIT)
    if clipped:
        mask[detector.window] |= wide[detector.window]
    else:
        mask |= wide
    step = max((rows.stop - rows.start) // _NOISE_LINES, 1)
    mask[rows.start + step // 2 : rows.stop : step, columns] = 255
    return mask


def _grown(mask: Image, by: int) -> Image:
    side = 2 * by + 1
    return np.asarray(cv2.dilate(mask, np.ones((side, side), np.uint8)), dtype=np.uint8)


def _target_boxes(rig: Rig, pose: Pose) -> list[tuple[int, int, int, int]]:
    """Return for each monitored target the first column and row, and those after the last."""
    watched = watch.begin(rig, pose)
    if watched is None:
        return []
    boxes = []
    for (x, y), size, reduction in zip(watched.corner, watched.size, watched.reduction, strict=True):
        if size:
            margin = int(_PUSHED * reduction + size // 4 + _RINGS)
            boxes.append((int(x) - margin, int(y) - margin, int(x + size) + margin, int(y + size) + margin))
    return boxes
