"""A run's estimates, frame by frame, as arrays for metrics and plots."""

from dataclasses import dataclass, field, replace

import numpy as np

from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import Epoch, TrackState
from spheremouse.evaluate.metrics import Run
from spheremouse.geometry.rotation import Array


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
            attitude=np.array([s.filter.attitude for s in states]).reshape(n, 3, 3),
            rate=np.array([s.filter.rate for s in states]).reshape(n, 3),
            rotation=np.array([e.motion.rotation for e in epochs]).reshape(n, 3),
            covariance=np.array([s.filter.covariance for s in states]).reshape(n, 6, 6),
            absolute=np.array([s.absolute for s in states], dtype=bool),
            detected=tuple(s.detections.centre for s in states),
            used=tuple(e.used for e in epochs),
            seconds={stage: np.array([e.seconds[stage] for e in epochs]) for stage in (epochs[0].seconds if n else ())},
            nis=_innovations(states),
        )


def _innovations(states: list[TrackState]) -> Array | None:
    """Normalised innovation squared of every frame's update, (n,); None for a filter that does not give it."""
    values = [s.filter.nis for s in states if isinstance(s.filter, So3State)]
    return np.array(values, dtype=float) if len(values) == len(states) else None
