"""A tracker's run over a recording, and the truth of that recording: the input of all metrics."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.smooth import observe, smooth
from spheremouse.ball.state import Epoch, Tracker, current
from spheremouse.ball.truth import DiscTruth, Truth
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Status

_ROTATION_AND_RATE = (0, 1, 2, 6, 7, 8)  # of an estimate's covariance: rotation and its rate


@dataclass(frozen=True, slots=True)
class Run:
    """Results of a tracker, one entry for each of the n frames that it was given."""

    frame: NDArray[np.intp]  # (n,) index into the recording
    stamp: Array  # (n,) s
    status: tuple[Status, ...]  # (n,)
    attitude: Array  # (n, 3, 3) R_obj_ball
    rate: Array  # (n, 3) rad/s, w_obj
    rotation: Array  # (n, 3) rad, rotation vector in obj that was sent as motion with this frame
    covariance: Array  # (n, 6, 6) of rotation error (rad, obj) and rate (rad/s)
    absolute: NDArray[np.bool_]  # (n,) the attitude is in the frame of a saved map
    detected: tuple[Array, ...]  # (n,) of (k, 2) px: all candidates of the detector
    used: tuple[Array, ...]  # (n,) of (k, 2) px: those that took part in the filter's update
    seconds: dict[str, Array]  # stage -> (n,) s, measured by the caller
    nis: Array | None = None  # (n,) normalised innovation squared of the filter's update; None: it has none

    @property
    def tracked(self) -> NDArray[np.intp]:
        """Indices, (k,), of the frames in Status.TRACKING."""
        return np.flatnonzero([p is Status.TRACKING for p in self.status])

    @property
    def steps(self) -> NDArray[np.intp]:
        """Indices, (k,), of the tracked frames after a tracked frame."""
        return self.tracked[np.isin(self.tracked - 1, self.tracked)]


@dataclass(frozen=True, slots=True)
class Reference:
    """The truth of a recording; None for parts that it does not contain."""

    motion: Truth | None = None
    discs: DiscTruth | None = None
    pose: Pose | None = None  # of the camera
    directions: Array | None = None  # (m, 3) unit vectors to the discs, ball


@dataclass(slots=True)
class History:
    """Results of a run, frame by frame, without the pictures, as `evaluate` collects them."""

    epochs: list[Epoch] = field(default_factory=list)

    def add(self, epoch: Epoch) -> None:
        """Add a frame's results, without its image."""
        self.epochs.append(replace(epoch, frame=replace(epoch.frame, image=np.zeros((0, 0), np.uint8))))

    def smoothed(self, tracker: Tracker[So3Filter]) -> "History":
        """Return the history with the estimates of the fixed-interval smoother in place of the filter's."""
        filters = [current(e.state, tracker).filter for e in self.epochs]
        seen = [
            observe(e.estimate, e.state.filter, e.state.points, f, ambiguous=bool(e.state.alternatives))
            for e, f in zip(self.epochs, filters, strict=True)
        ]
        estimates = smooth(seen, tracker.settings.so3)
        return History([replace(e, estimate=s) for e, s in zip(self.epochs, estimates, strict=True)])

    def run(self) -> Run:
        """Return the results as arrays for the metrics."""
        epochs, n = self.epochs, len(self.epochs)
        states = [e.state for e in epochs]
        return Run(
            frame=np.array([e.frame.sequence for e in epochs], dtype=np.intp),
            stamp=np.array([e.frame.stamp for e in epochs], dtype=float),
            status=tuple(s.status for s in states),
            attitude=np.array([e.estimate.rotation for e in epochs]).reshape(n, 3, 3),
            rate=np.array([e.estimate.rate[:3] for e in epochs]).reshape(n, 3),
            rotation=np.array([e.estimate.increment[:3] for e in epochs]).reshape(n, 3),
            covariance=np.array(
                [e.estimate.covariance[np.ix_(_ROTATION_AND_RATE, _ROTATION_AND_RATE)] for e in epochs]
            ).reshape(n, 6, 6),
            absolute=np.array([s.absolute for s in states], dtype=bool),
            detected=tuple(s.detections.centre for s in states),
            used=tuple(e.used for e in epochs),
            seconds={stage: np.array([e.seconds[stage] for e in epochs]) for stage in (epochs[0].seconds if n else ())},
            nis=_innovations(epochs),
        )


def _innovations(epochs: list[Epoch]) -> Array | None:
    """Return the normalised innovation squared of each update, (n,); None if the filter does not report it."""
    values = [e.estimate.statistics.get("nis") for e in epochs]
    return None if None in values else np.array(values, dtype=float)


def number(x: Any) -> float | None:
    """Return a float; None if x is not finite."""
    return float(x) if np.isfinite(x) else None
