"""What a run of the wand looks like while it goes: a line per ball on a terminal, a line a second elsewhere."""

import sys
import time
from types import TracebackType
from typing import Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from spheremouse.live import Tally
from spheremouse.wand.axes import axes_of
from spheremouse.wand.track import WandPose

_REFRESH, _LINE_EVERY = 0.1, 1.0  # s


class WandBoard:
    """Shows poses; a context manager. `say` writes a line that stays."""

    def __init__(self, wanted: bool, tally: Tally, console: Console | None = None) -> None:
        """`wanted` False: nothing but what is said. `tally` is read, not changed."""
        self.console = Console(file=sys.stderr, highlight=False) if console is None else console
        self._wanted, self._tally = wanted, tally
        self._live = Live(console=self.console, auto_refresh=False) if wanted and self.console.is_terminal else None
        self._due = 0.0

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, trace)

    def say(self, text: str) -> None:
        """One or more lines, as they are."""
        self.console.print(Text(text), soft_wrap=True)

    def show(self, stamp: float, poses: tuple[WandPose, ...]) -> None:
        """The newest poses; drawn when it is time."""
        now = time.perf_counter()
        if not self._wanted or now < self._due:
            return
        text = "\n".join(as_line(stamp, pose, self._tally) for pose in poses)
        self._due = now + (_LINE_EVERY if self._live is None else _REFRESH)
        if self._live is None:
            self.say(text)
        else:
            self._live.update(Text(text), refresh=True)


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
