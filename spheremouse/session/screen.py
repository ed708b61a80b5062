"""Status line of a run on standard error: renewed in place on a terminal, else once a second."""

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from spheremouse.ball.state import Epoch
from spheremouse.output import Counts
from spheremouse.output.pointer import minus, plus
from spheremouse.session.timing import FrameTimes
from spheremouse.wand.axes import axes_of
from spheremouse.wand.state import WandPose

_REFRESH = 0.1  # s between two lines in the same place
_LINE_EVERY = 1.0  # s between two lines without a terminal


class Tally:
    """Totals of a run: frames, sum of counts, times."""

    def __init__(self) -> None:
        self.frames = 0
        self._counts: Counts = (0, 0, 0)  # of all frames
        self.unsent: Callable[[], Counts] = lambda: (0, 0, 0)  # the part of these that was not sent
        self.left_out: dict[str, int] = {}  # frames that were not tracked, by reason
        self.times = FrameTimes()
        self.words = ""  # further words

    def add(self, counts: Counts, seconds: float) -> None:
        """Add a frame: its counts, and its time in s."""
        self.frames += 1
        self._counts = plus(self._counts, counts)
        self.times.add(seconds, time.perf_counter())

    @property
    def counts(self) -> Counts:
        """Sum of the counts that were sent."""
        return minus(self._counts, self.unsent())

    def __str__(self) -> str:
        left_out = ", ".join(f"{n} {why}" for why, n in self.left_out.items() if n)
        left_out = f"frames left out: {left_out}" if left_out else ""
        if not self.frames:
            return "; ".join(filter(None, ("no frame tracked", left_out)))
        x, y, z = self.counts
        median, slow = (1e3 * self.times.quantile(q) for q in (0.5, 0.99))
        frames = f"{self.frames} frame{'s' if self.frames != 1 else ''}"
        text = f"{frames}; counts x {x:+d}, y {y:+d}, third {z:+d}; {median:.1f} ms per frame (99 %: {slow:.1f} ms)"
        if any(unsent := self.unsent()):
            text += "; not sent: x {:+d}, y {:+d}, third {:+d}".format(*unsent)
        return "; ".join(filter(None, (text, self.words, left_out)))


class StatusLine:
    """One line for each ball, and messages above it; a context manager."""

    def __init__(self, wanted: bool, console: Console | None = None) -> None:
        """With `wanted` False, show only messages."""
        self.console = Console(file=sys.stderr, highlight=False) if console is None else console
        self._wanted = wanted
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

    def log(self, text: str) -> None:
        """Print one or more lines, which stay."""
        self.console.print(Text(text), soft_wrap=True)

    def show(self, line: Callable[..., str], *given: object) -> None:
        """Show the line that a function returns, if the last one is old enough."""
        now = time.perf_counter()
        if not self._wanted or now < self._due:
            return
        if self._live is not None:
            self._due = now + _REFRESH
            self._live.update(Text(line(*given)), refresh=True)
        else:
            self._due = now + _LINE_EVERY
            self.log(line(*given))


def ball_line(epoch: Epoch, tally: Tally) -> str:
    """Return the state in one line."""
    rate = " ".join(f"{w:+.1f}" for w in np.degrees(epoch.estimate.rate[:3]))
    counts = " ".join(f"{n:+d}" for n in tally.counts)
    return (
        f"{epoch.frame.stamp:9.3f} s  {_status(epoch)}  rate {rate} deg/s  counts {counts}  discs {_discs(epoch)}  "
        f"{1e3 * tally.times.recent_quantile(0.5):.1f} ms"
    )


def _status(epoch: Epoch) -> str:
    withheld = epoch.state.withheld
    return f"{epoch.state.status}{'' if withheld is None or not withheld.announced else ', motion withheld'}"


def _discs(epoch: Epoch) -> str:
    n = epoch.estimate.statistics
    masked = len(epoch.state.lookalikes.masks)
    text = f"{n['discs_used']} used, {n['discs_seen']} seen, {n['discs_known']} known"
    return f"{text}; {masked} masked" if masked else text


def pose_lines(stamp: float, poses: tuple[WandPose, ...], tally: Tally) -> str:
    """Return the pose of each ball at `stamp` (s), one in a line."""
    return "\n".join(_pose_line(stamp, pose, tally) for pose in poses)


def _pose_line(stamp: float, pose: WandPose, tally: Tally) -> str:
    where = "                                                   "
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = axes_of(pose.position, pose.rotation, pose.covariance)
        x, y, z = axes.position
        yaw, pitch, roll = np.degrees(axes.angles)
        where = f"x {x:+.3f} y {y:+.3f} z {z:.3f} m  yaw {yaw:+6.1f} pitch {pitch:+6.1f} roll {roll:+6.1f} deg"
    counts = " ".join(f"{n:+d}" for n in tally.counts)
    median = 1e3 * tally.times.recent_quantile(0.5)
    return f"{stamp:9.3f} s  {pose.name} {pose.phase}  {where}  counts {counts}  {median:.1f} ms"
