"""The outputs of a run: the pointer's and further ones, each with a thread. They can be exchanged between frames.

The worker calls all methods. Any thread may call `status` and `troubles`. Only `close` waits.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Any

from spheremouse.errors import ControlError
from spheremouse.output import Output, Report
from spheremouse.output.null import Null
from spheremouse.output.pointer import Counts, PointerSettings, minus, plus
from spheremouse.output.reporter import Latency, OutputThread
from spheremouse.session.process.threads import WorkerPool, begin

OUTPUT = "output"  # kind of the pool's work

Open = Callable[[], Output]
_NONE: Counts = (0, 0, 0)


class Outputs:
    """The outputs of one run. The first of them is the pointer's."""

    def __init__(
        self,
        openers: Sequence[Open],
        settings: PointerSettings,
        *,
        log: Callable[[str], None],
        workers: WorkerPool,
        call: Callable[[Callable[[], None]], None],
    ) -> None:
        """`workers` closes exchanged outputs; `call` has the worker run a call, from any thread."""
        self._log, self._workers, self._call = log, workers, call
        self._late: list[threading.Thread] | None = []  # started by `begin`
        self._paused = False
        self._given = _NONE  # sum of the counts that the pointer's output was given
        self.past: tuple[int, Counts] = (0, _NONE)  # reports and unsent counts of the pointer's outputs before this one
        self.pointer, *self.others = self._threads(openers, settings)

    def begin(self) -> None:
        """Start the threads, which open the outputs. Raises ControlError if the system refuses a thread."""
        late, self._late = self._late, None
        for thread in late or ():
            begin(thread)

    def give(self, report: Report, taken: float, wanted: bool) -> None:
        """Submit a frame's report, taken at a time (s), to the pointer first."""
        self.pointer.submit(report, taken, wanted)
        for other in self.others:
            other.submit(report, taken)
        self._given = plus(self._given, report.counts)

    def rest(self, now: float) -> None:
        """Stop the pointer's extrapolation."""
        self.pointer.end_prediction(now)

    def pause(self, paused: bool) -> None:
        """Begin or end a pause, in which nothing is sent."""
        self._paused = paused
        for thread in self._all:
            thread.pause(paused)

    def change(self, settings: PointerSettings) -> None:
        """Change the pointer's settings."""
        for thread in self._all:
            thread.change(settings)

    def exchange(self, openers: Sequence[Open], settings: PointerSettings) -> None:
        """Exchange all outputs. ControlError if there is no thread; the old ones then stay."""
        old, given = self.pointer, self._given

        def closed() -> None:
            self._call(lambda: self._count_past(old, given))

        self.pointer, *self.others = self._next(self._all, openers, settings, closed)
        self._given = _NONE

    def exchange_others(self, openers: Sequence[Open], settings: PointerSettings) -> None:
        """Exchange all outputs but the pointer's. ControlError as in `exchange`."""
        self.others = self._next(self.others, openers, settings, lambda: None)

    def close(self) -> None:
        """Close each; waits for it, if it does not take too long. The pointer's is closed first."""
        for thread in self._all:
            thread.close()

    @property
    def ended(self) -> bool:
        """True if the reader of an output has gone."""
        return any(thread.ended for thread in self._all)

    @property
    def unsent(self) -> Counts:
        """Counts of the run that the pointer's output will not send."""
        return plus(self.past[1], self.pointer.unsent)

    @property
    def troubles(self) -> str | None:
        """Return the reasons of the outputs that fail; None if all work."""
        return "; ".join(filter(None, (thread.failed for thread in self._all))) or None

    def status(self) -> tuple[dict[str, Any], Latency | None]:
        """Return the sums of the run, as defined in docs/control.md, and the latency."""
        report, (reports, unsent) = self.pointer.status(), self.past
        sums = {
            "failed": self.troubles,
            "reports": reports + report.reports,
            "unsent": list(plus(unsent, report.unsent)),
            "ahead": list(report.ahead),
        }
        return sums, report.latency

    @property
    def _all(self) -> list[OutputThread]:
        return [self.pointer, *self.others]

    def _next(
        self, old: list[OutputThread], openers: Sequence[Open], settings: PointerSettings, closed: Callable[[], None]
    ) -> list[OutputThread]:
        """Threads for the next ones; `closed` is called once those before are."""
        exchange = _Exchange(old)
        try:
            made = self._threads([exchange.after(open_next) for open_next in openers], settings, exchange.give_up)
        finally:
            exchange.decided.set()
        for thread in made:
            thread.pause(self._paused)

        def retire() -> None:
            exchange.close()
            closed()

        self._workers.do(OUTPUT, retire)
        return made

    def _threads(
        self, openers: Sequence[Open], settings: PointerSettings, give_up: Callable[[], None] = lambda: None
    ) -> list[OutputThread]:
        """Return a thread for each output. Raises ControlError, after `give_up`, if the system refuses one."""
        begun: list[OutputThread] = []
        try:
            for open_it in openers:
                begun.append(OutputThread(open_it, settings, self._log, start=self._begin))
        except ControlError:
            give_up()
            for thread in begun:
                thread.close()
            raise
        return begun

    def _begin(self, thread: threading.Thread) -> None:
        begin(thread) if self._late is None else self._late.append(thread)

    def _count_past(self, old: OutputThread, given: Counts) -> None:
        """Add the counts that a closed output did not send, those in its queue included."""
        status, (reports, unsent) = old.status(), self.past
        self.past = (reports + status.reports, plus(unsent, minus(given, status.sent)))


class _Exchange:
    """The next outputs are opened when those before are closed, since they may be the same devices; or never."""

    def __init__(self, old: Sequence[OutputThread]) -> None:
        self._old, self._closing = list(reversed(old)), threading.Lock()
        self._wanted, self.decided = True, threading.Event()

    def after(self, open_next: Open) -> Open:
        """Return a function that opens an output after the old ones are closed, in its thread."""

        def open_it() -> Output:
            self.decided.wait()
            if not self._wanted:
                return Null()
            self.close()
            return open_next()

        return open_it

    def close(self) -> None:
        """Close the old outputs, in the first thread that calls this."""
        with self._closing:
            while self._old:
                self._old.pop().close()

    def give_up(self) -> None:
        """Keep the old outputs, and open no other."""
        self._wanted = False
        self.decided.set()
