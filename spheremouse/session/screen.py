"""Status line of a run on standard error: renewed in place on a terminal, else once a second."""

import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from spheremouse.errors import format_count
from spheremouse.output import Counts
from spheremouse.output.pointer import minus, plus
from spheremouse.output.sample import Sample
from spheremouse.session.timing import FrameTimes
from spheremouse.session.tracker_adapter import FrameResult
from spheremouse.tracker import Status
from spheremouse.wand.axes import estimated_axes

if TYPE_CHECKING:
    from rich.live import Live

_REFRESH_INTERVAL_S = 0.1  # s between two lines in the same place
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
        axes, texts = "x {:+d}, y {:+d}, third {:+d}", ["no frame tracked"]
        if self.frames:
            median, slow = (1e3 * self.times.quantile(q) for q in (0.5, 0.99))
            texts = [format_count(self.frames, "frame"), f"counts {axes.format(*self.counts)}"]
            texts.append(f"{median:.1f} ms per frame (99 %: {slow:.1f} ms)")
            if any(unsent := self.unsent()):
                texts.append(f"not sent: {axes.format(*unsent)}")
            texts += filter(None, [self.words])
        if left_out := ", ".join(f"{n} {why}" for why, n in self.left_out.items() if n):
            texts.append(f"frames left out: {left_out}")
        return "; ".join(texts)


class StatusLine:
    """One line for each ball, and messages above it; a context manager."""

    def __init__(self, wanted: bool) -> None:
        """With `wanted` False, show only messages."""
        self._wanted = wanted
        self._live = _renewed_line() if wanted and sys.stderr.isatty() else None
        self._due = 0.0

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._live is not None:
            self._live.__exit__(*error)

    def log(self, text: str) -> None:
        """Print one or more lines, which stay."""
        if self._live is None:
            # `print` writes the line's end separately, so the lines of two threads could mix.
            sys.stderr.write(f"{text}\n")
        else:
            self._live.console.print(text, soft_wrap=True)

    def show(self, result: FrameResult, tally: Tally) -> None:
        """Show the state of the balls after a frame, if the last line is old enough."""
        now = time.perf_counter()
        if not self._wanted or now < self._due:
            return
        if self._live is not None:
            self._due = now + _REFRESH_INTERVAL_S
            self._live.update(status_lines(result, tally), refresh=True)
        else:
            self._due = now + _LINE_EVERY
            self.log(status_lines(result, tally))


def _renewed_line() -> "Live":
    from rich.console import Console
    from rich.live import Live

    console = Console(file=sys.stderr, highlight=False, markup=False, emoji=False)
    return Live(console=console, auto_refresh=False)


def status_lines(result: FrameResult, tally: Tally) -> str:
    """Return the state of each ball in one line."""
    counts, median = "counts {:+d} {:+d} {:+d}".format(*tally.counts), 1e3 * tally.times.recent_quantile(0.5)
    return "\n".join(f"{s.stamp:9.3f} s  {_state_words(s, counts)}  {median:.1f} ms" for s in result.samples)


def _state_words(sample: Sample, counts: str) -> str:
    if sample.coordinates == "obj":
        rate, n = "rate {:+.1f} {:+.1f} {:+.1f} deg/s".format(*np.degrees(sample.rate)), sample.statistics
        points = f"points {n['discs_used']:.0f} used, {n['discs_seen']:.0f} seen, {n['discs_known']:.0f} known"
        return f"{sample.status}  {rate}  {counts}  {points}"
    if sample.status is not Status.TRACKING:
        return f"{sample.name} {sample.status}  {counts}"
    axes = estimated_axes(sample.estimate)
    pose = "x {:+.3f} y {:+.3f} z {:.3f} m  yaw {:+6.1f} pitch {:+6.1f} roll {:+6.1f} deg"
    return f"{sample.name} {sample.status}  {pose.format(*axes.position, *np.degrees(axes.angles))}  {counts}"
