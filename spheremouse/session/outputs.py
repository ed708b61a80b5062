"""The outputs of a run, each with a queue and a thread of its own. They can be exchanged between frames.

The first output is the main one: the state of the run, the sums of counts and the latency are its own. The worker calls
all methods. Any thread may call `status` and `troubles`. Only `close` waits.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial

from spheremouse.errors import ControlError, OutputError
from spheremouse.output import Counts, DescribeRun, Output, Report, open_output, response_of
from spheremouse.output.counts import OutputCounter
from spheremouse.output.null import Null
from spheremouse.output.pointer import PointerSettings, minus, plus
from spheremouse.output.reporter import OutputThread, ReporterStatus
from spheremouse.output.response import COUNTS_RESPONSE
from spheremouse.session.process.threads import WorkerPool, begin

OUTPUT = "output"  # kind of the pool's work

_NONE: Counts = (0, 0, 0)


@dataclass(frozen=True, slots=True)
class RunOutput:
    """An output `KIND:ARGUMENT` of a run, its thread and its counts."""

    spec: str
    thread: OutputThread
    counter: OutputCounter

    def submit(self, report: Report, taken: float, *, wanted: bool) -> Counts:
        """Submit a frame's report, and return this output's counts."""
        report = self.counter.apply(report)
        self.thread.submit(report, taken, wanted=wanted)
        return report.counts


class Outputs:
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
        self._past: tuple[int, Counts] = (0, _NONE)  # reports and unsent counts of the run, less the main output's own
        self._all = [self._output(spec, settings, len(specs) > 1) for spec in specs]

    def begin(self) -> None:
        """Start the threads, which open the outputs. Raises ControlError if the system refuses a thread."""
        delayed, self._late = self._late, None
        for thread in delayed or ():
            begin(thread)

    def submit(self, report: Report, taken: float, *, wanted: bool) -> None:
        """Submit a frame's report, taken at a time (s, monotonic), to each output. Only the main one heeds `wanted`."""
        first, *others = self._all
        counts = first.submit(report, taken, wanted=wanted)
        for output in others:
            output.submit(report, taken, wanted=True)
        self.counts = plus(self.counts, counts)

    def end_prediction(self, now: float) -> None:
        """End the extrapolation of the pointer at `now` (s, monotonic), because no frame will correct it."""
        for output in self._all:
            output.thread.end_prediction(now)

    def set_paused(self, paused: bool) -> None:
        """Begin or end a pause, in which nothing is sent."""
        self._paused = paused
        for output in self._all:
            output.thread.set_paused(paused)

    def change(self, settings: PointerSettings) -> None:
        for output in self._all:
            output.thread.change(settings)

    def exchange(self, specs: Sequence[str], settings: PointerSettings) -> None:
        """Use other outputs; those that stay go on. ControlError if the system refuses a thread: then all stay."""
        kept = {output.spec: output for output in self._all if output.spec in specs}
        removed = [output.thread for output in self._all if output.spec not in specs]
        before, closed = self.main, Future[bool]()
        made: dict[str, RunOutput] = {}
        try:
            for spec in (s for s in specs if s not in kept):
                made[spec] = self._output(spec, settings, len(specs) > 1, closed)
                made[spec].thread.set_paused(self._paused)
        except ControlError:
            closed.set_result(False)
            for output in made.values():
                output.thread.close()
            raise
        self._all = [(kept | made)[spec] for spec in specs]
        self.change(settings)
        if self.main is not before:
            self._exclude(self.main.thread)
            if before.thread not in removed:
                self._include(before.thread)

        def retire() -> None:
            for thread in removed:
                thread.close()
            closed.set_result(True)
            if before.thread in removed:
                self._call(lambda: self._include(before.thread))

        self._workers.submit(OUTPUT, retire)

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

    def _output(
        self, spec: str, settings: PointerSettings, several: bool, closed: Future[bool] | None = None
    ) -> RunOutput:
        """Return an output with its thread. Raises ControlError if the system refuses the thread."""
        name, open_it = f"output {spec}" if several else "output", partial(self._open, spec, closed)
        thread = OutputThread(open_it, settings, self._log, start=self._begin, name=name)
        with contextlib.suppress(OutputError):  # the thread logs it
            return RunOutput(spec, thread, OutputCounter(response_of(spec)))
        return RunOutput(spec, thread, OutputCounter(COUNTS_RESPONSE))

    def _open(self, spec: str, closed: Future[bool] | None = None) -> Output:
        """Open an output, once those before are `closed`: they may be the same devices. False: open none."""
        if closed is not None and not closed.result():
            return Null()
        output = open_output(spec)
        if output.paced:
            self._claim()
        output.begin(self._describe_run)
        return output

    def _begin(self, thread: threading.Thread) -> None:
        begin(thread) if self._late is None else self._late.append(thread)

    def _include(self, thread: OutputThread) -> None:
        """Add the sums of an output that is not the main one any more to those of the run."""
        status, (reports, unsent) = thread.status(), self._past
        self._past = reports + status.reports, plus(unsent, status.unsent)

    def _exclude(self, thread: OutputThread) -> None:
        """Subtract the sums of an output that becomes the main one: until now it was another one."""
        status, (reports, unsent) = thread.status(), self._past
        self._past = reports - status.reports, minus(unsent, status.unsent)
