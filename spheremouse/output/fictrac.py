"""FicTrac's 25 columns, for programs that read FicTrac's socket.

The columns and their frames are those of FicTrac's `doc/data_header.txt` and `doc/coordinate_frames.md` (Moore et al.
2014, https://doi.org/10.1016/j.jneumeth.2014.01.010). docs/coming-from-fictrac.md lists each column. A frame that
does not confirm the estimate gets no line, as in FicTrac.

The laboratory frame is right-handed: X in the animal's forward direction, Y to its right, Z down. With `forward=0` the
animal looks away from the camera: X is -Z of `obj`, Y is X, Z is -Y. For a hand-held ball X, Y, Z are z, x, y of `cam`.
"""

import time
from functools import lru_cache
from math import atan2, cos, hypot, pi, radians, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np
import orjson

from spheremouse.geometry import Array
from spheremouse.output import Report
from spheremouse.output.sample import Sample, to_quaternion
from spheremouse.tracker import Status

if TYPE_CHECKING:
    from spheremouse.geometry.camera import Pose

FRAMES = ("camera", "window")
_QUARTER_HOUR_S = 900.0  # s; clocks change at its ends alone
R_LAB_OBJ = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_UNKNOWN_ROTATION = [[np.nan] * 3] * 3
_R_LAB_CAM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


class FicTrac:
    """Integrates the path of an animal that walks on the ball which makes the counts."""

    def __init__(self, frame: str = "camera", forward: float = 0.0) -> None:
        """`frame` is that of columns 2-4 and 9-11.

        `forward` is the animal's forward direction, degrees to the right of the direction away from the camera.
        """
        self._window = frame == "window"
        self._camera: Pose | None = None  # of the line before
        self._R_cam = _UNKNOWN_ROTATION  # its rotation from obj
        c, s = cos(radians(forward)), sin(radians(forward))
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        self._R_lab = {"obj": (turn @ R_LAB_OBJ).tolist(), "cam": (turn @ _R_LAB_CAM).tolist()}
        self._x = self._y = self._heading = self._forward = self._side = 0.0  # rad
        self._first: int | None = None  # sequence number of the first line since the ball was found
        self._last = 0.0  # s, stamp of the line before

    def lines(self, report: Report) -> list[bytes]:
        """Return the line of a frame; none if the ball is not tracked or the frame does not confirm the estimate."""
        sample = report.pointing_sample
        if sample is None:
            return []
        if sample.status is not Status.TRACKING:
            self._first = None
        elif sample.confirmed:
            return [self._line(sample)]
        return []

    def _line(self, sample: Sample) -> bytes:
        """Return FicTrac's columns for a sample, and continue the path."""
        if self._first is None:  # the way while the ball was lost is unknown
            self._first, self._last = sample.sequence, sample.stamp
            self._x = self._y = self._heading = 0.0
        estimate = sample.estimate
        increment, attitude = estimate.increment.tolist()[:3], _rotation_vector(estimate.rotation)
        variance = sum(estimate.increment_covariance.diagonal().tolist()[:3])
        R_cam, R_lab = self._rotation_to_camera(sample), self._R_lab[sample.coordinates]
        lab = _rotate(R_lab, increment)
        forward, side = lab[1], -lab[0]
        self._integrate(forward, side, -lab[2])
        capture = sample.stamp if sample.wall is None else sample.wall
        values = [sample.sequence + 1, *_rotate(R_cam, increment), sqrt(max(0.0, variance)), *lab]
        values += [*_rotate(R_cam, attitude), *_rotate(R_lab, attitude)]
        values += [self._x, self._y, self._heading, atan2(side, forward) % (2 * pi), hypot(forward, side)]
        values += [self._forward, self._side, 1e3 * capture, sample.sequence - self._first + 1]
        values += [1e3 * (sample.stamp - self._last)]
        values += [1e3 * (capture if sample.wall is None else _since_midnight(capture))]
        self._last = sample.stamp
        numbers = orjson.dumps(values, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1]
        return b"FT, %b\n" % numbers.replace(b"null", b"nan").replace(b",", b", ")

    def _integrate(self, forward: float, side: float, turn: float) -> None:
        """Add a step (rad) along a circular arc: heading and motion change evenly between two frames."""
        middle, chord = self._heading + turn / 2, sin(turn / 2) / (turn / 2) if turn else 1.0
        self._x += chord * (forward * cos(middle) - side * sin(middle))
        self._y += chord * (forward * sin(middle) + side * cos(middle))
        self._heading = (self._heading + turn) % (2 * pi)
        self._forward += forward
        self._side += side

    def _rotation_to_camera(self, sample: Sample) -> list[list[float]]:
        """Return the rotation from the still axes to the camera or the window, (3, 3); nan if it is unknown."""
        if sample.coordinates == "cam":
            return (_window_axes(sample.position) if self._window else np.eye(3)).tolist()
        if sample.camera is not self._camera:
            self._camera = sample.camera
            self._R_cam = _UNKNOWN_ROTATION if sample.camera is None else self._rotation_from_obj(sample.camera)
        return self._R_cam

    def _rotation_from_obj(self, camera: "Pose") -> list[list[float]]:
        window = _window_axes(camera.to_cam(np.zeros(3))) if self._window else np.eye(3)
        return (window @ camera.rotation.T).tolist()


def _rotation_vector(R: Array) -> list[float]:
    w, x, y, z = to_quaternion(R)
    size = hypot(x, y, z)
    scale = 2.0 * atan2(size, w) / size if size > 0.0 else 2.0
    return [scale * x, scale * y, scale * z]


def _rotate(R: list[list[float]], vector: list[float]) -> list[float]:
    """Return R v; a product of arrays takes ten times as long if it is not in the processor's cache."""
    x, y, z = vector
    return [a * x + b * y + c * z for a, b, c in R]


def _window_axes(centre: Array) -> Array:
    """Return the smallest rotation that turns the direction of the ball's centre, (3,) m in cam, to z."""
    x, y, z = (centre / np.linalg.norm(centre)).tolist()  # z > 0: the camera sees the ball
    V = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.eye(3) + V + V @ V / (1.0 + z)


def _since_midnight(wall: float) -> float:
    quarter, rest = divmod(wall, _QUARTER_HOUR_S)
    return _seconds_of_day(quarter) + rest


@lru_cache(maxsize=1)
def _seconds_of_day(quarter: float) -> int:
    local = time.localtime(quarter * _QUARTER_HOUR_S)  # looks for a new time zone on the disk
    return 3600 * local.tm_hour + 60 * local.tm_min + local.tm_sec
