"""Estimates of a run, frame by frame, as arrays for metrics and plots."""

from dataclasses import dataclass, field, replace

import numpy as np

from spheremouse.ball.state import Epoch
from spheremouse.evaluate.metrics import Run
from spheremouse.geometry.rotation import Array

_TURNING = (0, 1, 2, 6, 7, 8)  # of an estimate's covariance: rotation and its rate


@dataclass(slots=True)
class History:
    """Results of a run, frame by frame, without the pictures: what `evaluate` looks at."""

    epochs: list[Epoch] = field(default_factory=list)

    def add(self, epoch: Epoch) -> None:
        """One more."""
        self.epochs.append(replace(epoch, frame=replace(epoch.frame, image=np.zeros((0, 0), np.uint8))))

    def run(self) -> Run:
        """As the metrics take it."""
        epochs, n = self.epochs, len(self.epochs)
        states = [e.state for e in epochs]
        return Run(
            frame=np.array([e.frame.sequence for e in epochs], dtype=np.intp),
            stamp=np.array([e.frame.stamp for e in epochs], dtype=float),
            status=tuple(s.status for s in states),
            attitude=np.array([e.estimate.rotation for e in epochs]).reshape(n, 3, 3),
            rate=np.array([e.estimate.rate[:3] for e in epochs]).reshape(n, 3),
            rotation=np.array([e.estimate.increment[:3] for e in epochs]).reshape(n, 3),
            covariance=np.array([e.estimate.covariance[np.ix_(_TURNING, _TURNING)] for e in epochs]).reshape(n, 6, 6),
            absolute=np.array([s.absolute for s in states], dtype=bool),
            detected=tuple(s.detections.centre for s in states),
            used=tuple(e.used for e in epochs),
            seconds={stage: np.array([e.seconds[stage] for e in epochs]) for stage in (epochs[0].seconds if n else ())},
            nis=_innovations(epochs),
        )


def _innovations(epochs: list[Epoch]) -> Array | None:
    """Return the normalised innovation squared of each update, (n,); None if the filter does not give it."""
    values = [e.estimate.statistics.get("nis") for e in epochs]
    return None if None in values else np.array(values, dtype=float)
