"""The true motion of a ball, as simulations and data sets have it."""

from dataclasses import dataclass

from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class WandTruth:
    """The motion of a ball, one row per frame."""

    stamp: Array  # (n,) s
    position: Array  # (n, 3) m, centre in cam
    rotation: Array  # (n, 3, 3) R_cam_ball

    def __len__(self) -> int:
        return len(self.stamp)
