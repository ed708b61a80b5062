"""The compiled functions made ready before the first frame: a small ball turned before a small camera, once a process.

Numba compiles a function for the types of its first call and keeps the result on disk; even reading it back takes tens
of milliseconds, which no frame should wait for. So all that tracking calls is called here, by tracking.
"""

from functools import cache
from typing import Literal

import cv2
import numpy as np

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.appearance import appearance, ball_mask
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, disc_map
from spheremouse.ball.track import step
from spheremouse.compiling import report_compilation
from spheremouse.geometry.camera import InteriorOrientation, Pose, unproject
from spheremouse.geometry.rotation import Array, exp, left_jacobian, log
from spheremouse.tracker import Frame

_LENS = np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
_CAMERA = InteriorOrientation(160, 120, 160.0, 160.0, 79.5, 59.5, _LENS)
_POSE = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.2]))
_RIG = Rig(_CAMERA, Ball(0.6), NO_TARGETS, 0.05, 0.01, 0.005, 0.005, _POSE)
_TURN = np.array([0.06, 0.05, 0.03])  # rad a frame
_DT = 1.0 / 30.0


def warm_up(settings: Settings) -> None:
    """Compile the functions of this tracker and detector, once a process."""
    _warm_up(settings.tracker, settings.detector)


@cache
def _warm_up(tracker: Literal["so3", "ekf1", "ekf2"], detector: Literal["default", "blobs"]) -> None:
    discs = _spread(40)
    made = build(_RIG, _POSE, Settings(tracker=tracker, detector=detector))
    known = _watch(made, discs, None)
    if known is not None:
        _watch(made, discs, known)
    unproject(np.zeros((1, 2)), _CAMERA)  # for a pose
    log(np.eye(3)[None])
    left_jacobian(np.zeros(3))


def _watch(tracker: Tracker, discs: Array, known: DiscMap | None) -> DiscMap | None:
    state = begin(tracker, 0.0, known=known)
    for k in range(60):
        turned = discs @ exp(_TURN * k).T
        if 24 <= k < 30:  # hands: more that is no disc than discs
            turned = np.concatenate([turned[::3], discs @ exp(-3.0 * _TURN * k).T])
        hidden = 30 <= k < 45  # lost, and found again
        image = _picture(turned[:0] if hidden else turned[: len(turned) - k % 3])
        state = step(state, Frame(image, k * _DT, k), tracker).state
    return disc_map(state)


def _picture(directions: Array) -> Image:
    image = np.where(ball_mask(_RIG, _POSE) > 0, 190, 90).astype(np.uint8)
    seen = appearance(directions, _RIG, _POSE)
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    for i in np.flatnonzero(seen.whole):
        rim = seen.centroid[i] + (np.linalg.cholesky(seen.shape[i]) @ circle).T
        cv2.fillPoly(image, [np.rint(rim * 16).astype(np.int32)], 30, cv2.LINE_AA, shift=4)
    return cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 0.5), cv2.COLOR_GRAY2BGR)


def _spread(n: int) -> Array:
    """Directions on an uneven spiral, (n, 3)."""
    z = 1.0 - (np.arange(n) + 0.5) * 2.0 / n
    azimuth = np.arange(n) * 2.4 + 0.3 * np.sin(7.0 * np.arange(n))
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)


if __name__ == "__main__":
    with report_compilation():
        warm_up(Settings())
