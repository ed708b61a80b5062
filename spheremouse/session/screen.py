"""Display of a run on standard error: a table on a terminal, at most ten times a second, else a line a second."""

import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from spheremouse.ball.state import Epoch
from spheremouse.geometry.rotation import Array, to_euler
from spheremouse.output import Counts
from spheremouse.output.pointer import minus, plus
from spheremouse.session.timing import FrameTimes
from spheremouse.tracker import Status
from spheremouse.wand.axes import axes_of
from spheremouse.wand.state import WandPose

_REFRESH = 0.1  # s between two pictures of the table
_LINE_EVERY = 1.0  # s between two lines without a terminal
_HISTORY = 5.0  # s of rates in the small curves
_CURVE = 26  # characters
_BLOCKS = "▁▂▃▄▅▆▇█"
_AXES = (("X", "bright_red", "ω"), ("Y", "bright_green", "φ"), ("Z", "bright_cyan", "κ"))
_COLOURS = {Status.SEARCHING: "yellow", Status.TRACKING: "green", Status.LOST: "red"}


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


class Screen:
    """Status on a terminal, or else one line per second; a context manager."""

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

    def refresh(self, picture: Callable[[], RenderableType], line: Callable[[], str]) -> None:
        """Draw one of the two, if the last one is old enough."""
        now = time.perf_counter()
        if not self._wanted or now < self._due:
            return
        if self._live is not None:
            self._due = now + _REFRESH
            self._live.update(picture(), refresh=True)
        else:
            self._due = now + _LINE_EVERY
            self.log(line())


class StatusTable(Screen):
    """Shows epochs."""

    def __init__(self, title: str, table: bool, tally: Tally, console: Console | None = None) -> None:
        """With `table` False, show only messages. `tally` is not changed."""
        super().__init__(table, console)
        self._title, self._tally = title, tally
        self._last: Epoch | None = None
        self._rates: deque[tuple[float, Array]] = deque(maxlen=5000)  # stamp s, rad/s

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None and self._last is not None:
            self._live.update(self._picture(self._last), refresh=True)
        super().__exit__(kind, error, trace)

    def show(self, epoch: Epoch) -> None:
        """Set the newest epoch, and draw it if the last one is old enough."""
        self._last = epoch
        stamp = epoch.frame.stamp
        self._rates.append((stamp, epoch.estimate.rate[:3]))
        while self._rates[0][0] < stamp - _HISTORY:
            self._rates.popleft()
        self.refresh(lambda: self._picture(epoch), lambda: as_line(epoch, self._tally))

    def _picture(self, epoch: Epoch) -> RenderableType:
        return as_table(epoch, self._tally, list(self._rates), self._title)


def as_line(epoch: Epoch, tally: Tally) -> str:
    """Return the state in one line."""
    rate = " ".join(f"{w:+.1f}" for w in np.degrees(epoch.estimate.rate[:3]))
    counts = " ".join(f"{n:+d}" for n in tally.counts)
    return (
        f"{epoch.frame.stamp:9.3f} s  {_status(epoch)}  rate {rate} deg/s  counts {counts}  discs {_discs(epoch)}  "
        f"{1e3 * tally.times.recent_quantile(0.5):.1f} ms"
    )


def as_table(epoch: Epoch, tally: Tally, rates: Sequence[tuple[float, Array]], title: str) -> RenderableType:
    """Return the state as a table of 78 columns; `rates` are stamps in s and w_obj (3,) rad/s of the last seconds."""
    estimate = epoch.estimate
    rate = np.rad2deg(estimate.rate[:3])
    sigma = np.rad2deg(np.sqrt(np.maximum(np.diag(estimate.covariance)[6:9], 0.0)))
    angles = np.rad2deg(to_euler(estimate.rotation))
    history = np.rad2deg(np.array([w for _, w in rates]).reshape(-1, 3))
    stamps = np.array([t for t, _ in rates])

    grid = Table(box=None, padding=(0, 1), expand=True, header_style="dim")
    grid.add_column("about")
    grid.add_column("rate", justify="right", min_width=11)
    grid.add_column("sigma", justify="right")
    grid.add_column(f"last {_HISTORY:.0f} s", width=_CURVE)
    grid.add_column("attitude", justify="right", min_width=11)
    for i, (name, colour, letter) in enumerate(_AXES):
        grid.add_row(
            Text(name, style=f"bold {colour}"),
            Text(f"{rate[i]:+.1f} °/s", style="dim" if estimate.status is Status.LOST else "bold"),
            Text(f"±{sigma[i]:.2f}", style="dim"),
            Text(curve(stamps, history[:, i], epoch.frame.stamp), style=colour),
            Text(f"{letter} {angles[i]:+7.1f}°"),
        )

    x, y, third = tally.counts
    times = tally.times
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="dim", min_width=7)
    facts.add_column()
    facts.add_row("counts", Text.assemble(*_named((("x", x), ("y", y), ("third", third)))))
    facts.add_row("discs", Text(_discs(epoch)))
    pace = f"median {1e3 * times.recent_quantile(0.5):.1f} ms, 99 % {1e3 * times.recent_quantile(0.99):.1f} ms"
    facts.add_row("time", Text(f"{pace}; {times.rate:.0f} frames/s" if np.isfinite(times.rate) else pace))

    head = Text.assemble(
        (f" {title} ", "bold"),
        "│ ",
        (f"● {_status(epoch)}", _COLOURS[estimate.status]),
        f" │ {epoch.frame.stamp:.2f} s ",
    )
    return Panel(Group(grid, Text(), facts), title=head, title_align="left", border_style="dim", width=78)


def curve(stamps: Array, values: Array, now: float) -> str:
    """Return values, (n,) at stamps (n,) s, of the last seconds up to `now` as blocks, zero at half height."""
    if len(values) == 0:
        return ""
    most = max(float(np.abs(values).max()), 5.0)  # deg/s; noise at rest stays flat
    place = ((stamps - (now - _HISTORY)) / _HISTORY * _CURVE).astype(int)
    cells = []
    for k in range(_CURVE):
        here = values[np.minimum(place, _CURVE - 1) == k]
        level = None if len(here) == 0 else (float(here.mean()) / most + 1.0) / 2.0 * (len(_BLOCKS) - 1)
        cells.append(" " if level is None else _BLOCKS[round(level)])
    return "".join(cells)


def _status(epoch: Epoch) -> str:
    withheld = epoch.state.withheld
    return f"{epoch.state.status}{'' if withheld is None or not withheld.announced else ', motion withheld'}"


def _discs(epoch: Epoch) -> str:
    n = epoch.estimate.statistics
    masked = len(epoch.state.lookalikes.masks)
    text = f"{n['discs_used']} used, {n['discs_seen']} seen, {n['discs_known']} known"
    return f"{text}; {masked} masked" if masked else text


def _named(pairs: Sequence[tuple[str, int]]) -> list[tuple[str, str]]:
    parts: list[tuple[str, str]] = []
    for name, value in pairs:
        parts += [(f"{name} ", "dim"), (f"{value:+d}".ljust(9), "bold")]
    return parts


class WandStatusTable(Screen):
    """Shows poses."""

    def __init__(self, wanted: bool, tally: Tally, console: Console | None = None) -> None:
        """With `wanted` False, show only messages. `tally` is not changed."""
        super().__init__(wanted, console)
        self._tally = tally

    def show(self, stamp: float, poses: tuple[WandPose, ...]) -> None:
        """Set the newest poses, of `stamp` (s), and draw them if the last ones are old enough."""

        def text() -> str:
            return "\n".join(pose_line(stamp, pose, self._tally) for pose in poses)

        self.refresh(lambda: Text(text()), text)


def pose_line(stamp: float, pose: WandPose, tally: Tally) -> str:
    """Return the pose of a ball at `stamp` (s) in one line."""
    where = "                                                   "
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = axes_of(pose.position, pose.rotation, pose.covariance)
        x, y, z = axes.position
        yaw, pitch, roll = np.degrees(axes.angles)
        where = f"x {x:+.3f} y {y:+.3f} z {z:.3f} m  yaw {yaw:+6.1f} pitch {pitch:+6.1f} roll {roll:+6.1f} deg"
    counts = " ".join(f"{n:+d}" for n in tally.counts)
    median = 1e3 * tally.times.recent_quantile(0.5)
    return f"{stamp:9.3f} s  {pose.name} {pose.phase}  {where}  counts {counts}  {median:.1f} ms"
