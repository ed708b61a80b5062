"""Display of a wand's run: a line per ball on a terminal, else a line a second."""

import numpy as np
from rich.console import Console
from rich.text import Text

from spheremouse.session.screen import Screen, Tally
from spheremouse.wand.axes import axes_of
from spheremouse.wand.state import WandPose


class WandStatusTable(Screen):
    """Shows poses."""

    def __init__(self, wanted: bool, tally: Tally, console: Console | None = None) -> None:
        """With `wanted` False, show only messages. `tally` is not changed."""
        super().__init__(wanted, console)
        self._tally = tally

    def show(self, stamp: float, poses: tuple[WandPose, ...]) -> None:
        """The newest poses; drawn when it is time."""

        def text() -> str:
            return "\n".join(as_line(stamp, pose, self._tally) for pose in poses)

        self.refresh(lambda: Text(text()), text)


def as_line(stamp: float, pose: WandPose, tally: Tally) -> str:
    """A ball in one line."""
    where = "                                                   "
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = axes_of(pose.position, pose.rotation, pose.covariance)
        x, y, z = axes.position
        yaw, pitch, roll = np.degrees(axes.angles)
        where = f"x {x:+.3f} y {y:+.3f} z {z:.3f} m  yaw {yaw:+6.1f} pitch {pitch:+6.1f} roll {roll:+6.1f} deg"
    counts = " ".join(f"{n:+d}" for n in tally.counts)
    median = 1e3 * tally.times.recent_quantile(0.5)
    return f"{stamp:9.3f} s  {pose.name} {pose.phase}  {where}  counts {counts}  {median:.1f} ms"
