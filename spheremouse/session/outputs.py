"""The outputs of a run, each with a queue and a thread of its own. They can be exchanged between frames.

The first output is the main one: the state of the run, the sums of counts and the latency are its own. The worker calls
all methods. Any thread may call `status` and `troubles`. Only `close` waits.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from spheremouse.errors import ControlError
from spheremouse.output import Counts, DescribeRun, Output, Report, open_output, response_of
from spheremouse.output.counts import OutputCounter
from spheremouse.output.null import Null
from spheremouse.output.pointer import PointerSettings, minus, plus
from spheremouse.output.reporter import OutputThread, ReporterStatus
from spheremouse.session.process.threads import WorkerPool, begin

OUTPUT = "output"  # kind of the pool's work

Open = Callable[[], Output]
_NONE: Counts = (0, 0, 0)


@dataclass(frozen=True, slots=True)
class RunOutput:
    """An output `KIND:ARGUMENT` of a run, its thread and its counts."""

    spec: str
    thread: OutputThread
    counter: OutputCounter

    def submit(self, report: Report, taken: float, wanted: bool) -> Counts:
        """Submit a frame's report, and return this output's counts."""
        report = self.counter.apply(report)
        self.thread.submit(report, taken, wanted)
        return report.counts


class Outputs:
    """The outputs of one run."""

    def __init__(
        self,
        specs: Sequence[str],
        settings: PointerSettings,
        *,
        log: Callable[[str], None],
        workers: WorkerPool,
        call: Callable[[Callable[[], None]], None],
        describe_run: DescribeRun = dict,
        claim: Callable[[], object] = lambda: None,
    ) -> None:
        """`workers` closes exchanged outputs; `call` has the worker run a call, from any thread.

        Outputs call `describe_run` in their threads. The thread of a paced output also calls `claim`, to request
        real-time scheduling. The other outputs must not compete with the tracker.
        """
        self._describe_run, self._claim = describe_run, claim
        self._log, self._workers, self._call = log, workers, call
        self._late: list[threading.Thread] | None = []  # started by `begin`
        self._paused = False
        self.counts = _NONE  # of all frames, as the main output gets them
        self._submitted = _NONE  # those of them that the main output of now was given
        self._past: tuple[int, Counts] = (0, _NONE)  # reports and unsent counts of the main outputs before this one
        openers = [(spec, partial(self._open, spec)) for spec in specs]
        self._all = self._threads(openers, settings, len(specs) > 1)

    def begin(self) -> None:
        """Start the threads, which open the outputs. Raises ControlError if the system refuses a thread."""
        late, self._late = self._late, None
        for thread in late or ():
            begin(thread)

    def submit(self, report: Report, taken: float, wanted: bool) -> None:
        """Submit a frame's report, taken at a time (s, monotonic), to each output. Only the main one heeds `wanted`."""
        first, *others = self._all
        counts = first.submit(report, taken, wanted)
        for output in others:
            output.submit(report, taken, True)
        self._submitted, self.counts = plus(self._submitted, counts), plus(self.counts, counts)

    def end_prediction(self, now: float) -> None:
        """End the extrapolation of the pointer at `now` (s, monotonic), because no frame will correct it."""
        for output in self._all:
            output.thread.end_prediction(now)

    def pause(self, paused: bool) -> None:
        """Begin or end a pause, in which nothing is sent."""
        self._paused = paused
        for output in self._all:
            output.thread.pause(paused)

    def change(self, settings: PointerSettings) -> None:
        """Change the pointer's settings."""
        for output in self._all:
            output.thread.change(settings)

    def exchange(self, specs: Sequence[str], settings: PointerSettings) -> None:
        """Use other outputs; those that stay go on. ControlError if the system refuses a thread: then all stay."""
        kept = {output.spec: output for output in self._all if output.spec in specs}
        gone = [output for output in self._all if output.spec not in specs]
        before, submitted = self.main, self._submitted
        exchange = _Exchange([output.thread for output in gone])
        openers = [(spec, exchange.after(partial(self._open, spec))) for spec in specs if spec not in kept]
        try:
            made = {o.spec: o for o in self._threads(openers, settings, len(specs) > 1, exchange.give_up)}
        finally:
            exchange.decided.set()
        for output in made.values():
            output.thread.pause(self._paused)
        self._all = [(kept | made)[spec] for spec in specs]
        self.change(settings)
        another_main = self.main is not before
        if another_main:
            self._submitted = _NONE

        def retire() -> None:
            exchange.close()
            if another_main:
                self._call(lambda: self._count_past(before.thread, submitted))

        self._workers.do(OUTPUT, retire)

    def close(self) -> None:
        """Close each, the main one first. Wait at most 5 s for each, and 0.4 s for one that hangs."""
        for output in self._all:
            output.thread.close()

    @property
    def main(self) -> RunOutput:
        """The first output."""
        return self._all[0]

    @property
    def ended(self) -> bool:
        """True if the readers of all outputs have gone."""
        return all(output.thread.ended for output in self._all)

    @property
    def failed(self) -> str:
        """Reason why the main output fails; empty if it works, or if its reader is gone and others go on."""
        thread = self.main.thread
        return "" if thread.ended and not self.ended else thread.failed or ""

    @property
    def unsent(self) -> Counts:
        """Counts of the run that the main output will not send."""
        return plus(self._past[1], self.main.thread.unsent)

    def status(self) -> list[tuple[str, ReporterStatus]]:
        """Return each output's `KIND:ARGUMENT` and status, the main one first.

        Its `reports` and `unsent` include those of earlier main outputs. Its other sums are its own.
        """
        (reports, unsent), (first, *others) = self._past, [(o.spec, o.thread.status()) for o in self._all]
        spec, main = first
        whole = replace(main, reports=reports + main.reports, unsent=plus(unsent, main.unsent))
        return [(spec, whole), *others]

    def _threads(
        self,
        openers: Sequence[tuple[str, Open]],
        settings: PointerSettings,
        several: bool,
        give_up: Callable[[], None] = lambda: None,
    ) -> list[RunOutput]:
        """Return a thread for each output. Raises ControlError, after `give_up`, if the system refuses one."""
        begun: list[RunOutput] = []
        try:
            for spec, open_it in openers:
                name = f"output {spec}" if several else "output"
                thread = OutputThread(open_it, settings, self._log, start=self._begin, name=name)
                begun.append(RunOutput(spec, thread, OutputCounter(response_of(spec))))
        except ControlError:
            give_up()
            for output in begun:
                output.thread.close()
            raise
        return begun

    def _open(self, spec: str) -> Output:
        output = open_output(spec)
        if output.paced:
            self._claim()
        output.begin(self._describe_run)
        return output

    def _begin(self, thread: threading.Thread) -> None:
        begin(thread) if self._late is None else self._late.append(thread)

    def _count_past(self, old: OutputThread, submitted: Counts) -> None:
        """Add the counts that a closed output did not send, those in its queue included."""
        status, (reports, unsent) = old.status(), self._past
        self._past = (reports + status.reports, plus(unsent, minus(submitted, status.sent)))


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
