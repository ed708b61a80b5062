"""Send the motion of frames to one output, from a thread that keeps the output open.

The thread wakes for each frame and, while the pointer's prediction runs, at a steady rate. If the output never blocks,
the caller of `submit` sends, since waking a thread costs more than most outputs do. No exception of an output leaves
this module. If an output fails, the thread closes it and opens it again after a growing delay. It counts the motion of
that time as unsent. An output that reports trouble of its receiver stays open and gets empty reports until it recovers.
The thread cannot notice that it hangs itself in a call of the output. The callers of `submit` and of `failed` notice
it.

On every axis: submitted counts = sent + unsent - ahead. Counts that the output's other end has not acknowledged were
not sent.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from math import floor, inf
from time import monotonic

import numpy as np

from spheremouse.errors import internal_error_text, reason_of
from spheremouse.output import Counts, DeliveryStatus, Output, OutputClosed, Report, pointer
from spheremouse.output.call_watch import HANG_TIMEOUT, CallWatch
from spheremouse.output.pointer import PointerSettings, Resampler, minus, plus

RETRY_DELAYS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0)  # s
MAX_QUEUE_TIME = 0.25  # s; counts that waited longer in the queue become unsent
MAX_QUEUED_FRAMES = 256  # seconds, at any camera's rate
_MAX_JOIN_TIME = 5.0  # s
_LATENCY_COUNT = 4096  # a minute at 60 Hz
_OPENS, _SENDS, _CLOSES = "it cannot be opened", "it takes no report", "it cannot be closed"
_NONE: Counts = (0, 0, 0)
_ALL_ARRIVED = DeliveryStatus()


# A report in the queue, the frame's stamp (s, monotonic), False during a pause, and the time of `submit` (s). A plain
# tuple costs each frame and output least.
_QueuedReport = tuple[Report, float, bool, float]


def log_line(name: str, reason: object) -> str:
    """Return the log line of an output with a name as "output udp:HOST:PORT", which the reason may begin with, too."""
    return f"{name}: {str(reason).removeprefix(name.removeprefix('output ') + ': ')}"


@dataclass(frozen=True, slots=True)
class Latency:
    """Time from a frame's stamp to the end of `send`, over the last frames."""

    p50: float  # s
    p99: float  # s
    max: float  # s


@dataclass(frozen=True, slots=True)
class ReporterStatus:
    """Condition of the output, sums of counts and latency."""

    failed: str | None  # reason of a failure; None: the output works
    ended: bool  # the reader of the output closed it; it is not opened again
    reports: int  # reports with counts
    dropped: int  # frames that were not sent: during a failure or pause, too late, or more than the queue holds
    sent: Counts  # acknowledged ones alone, if the output acknowledges
    unsent: Counts  # submitted during a failure or pause, or too late; or lost on the way
    ahead: Counts  # sent before the ball made them; negative: made by the ball and not sent yet
    latency: Latency | None  # None: no frame was sent yet


class OutputThread:
    """Sends motion from its own thread. You may call all methods from any thread; only `close` blocks."""

    def __init__(
        self,
        open_output: Callable[[], Output],
        settings: PointerSettings,
        log: Callable[[str], None],
        start: Callable[[threading.Thread], None] = threading.Thread.start,
        name: str = "output",
    ) -> None:
        """Start the thread, which calls `open_output` and `log`; log lines begin with `name`.

        Exceptions of `start`, which starts the thread, propagate, because the system may refuse a new thread.
        """
        self._open, self._settings, self._log, self._name = open_output, settings, log, name
        # Releasing this lock wakes the thread. A condition would make the caller wait for the lock inside it.
        self._wakeup = threading.Lock()
        self._wakeup.acquire()
        self._queue: deque[_QueuedReport] = deque()
        self._overflow, self._overflowed = _NONE, 0  # counts and frames that the queue did not hold
        self._closing = self._paused = False
        self.ended = False  # True: the reader of the output closed it; it is not opened again
        self._turn = threading.Lock()  # of the thread, or the caller of `submit`, that works on the output
        self._output: Output | None = None
        self._failed: str | None = None
        self._unproven: str | None = None  # reason of a failure, once the output is open again and took no report yet
        self._failures = 0
        self._retry_time = monotonic()  # s, when the thread opens the output
        self._resampler = Resampler()
        self._frame_sum, self._sent = _NONE, _NONE  # counts of frames, and those sent, since `_reset`
        self._past, self._unsent = _NONE, _NONE  # counts sent before that, and those that will never be sent
        self._calls = CallWatch(lambda reason: log(f"{name}: {reason}"))
        self._reports = self._dropped = 0
        self._latencies = deque[float](maxlen=_LATENCY_COUNT)  # s, of the last frames
        self._acknowledges = False  # True: the output may report trouble of its receiver
        self._paced = False  # True: counts at a steady rate, with prediction; False: a report a frame
        self._last: tuple[Report, float] | None = None  # of the last frame, and its stamp on the monotonic clock, s
        self._grid, self._period = 0.0, 1.0 / settings.rate  # s; reports follow a frame at whole periods
        self._next_time = inf  # s, when the next one is due
        self._thread = threading.Thread(target=self._run, name="reporter", daemon=True)
        start(self._thread)

    def submit(self, report: Report, taken: float, *, wanted: bool = True) -> None:
        """Send or queue a frame's report, taken at a time (s, monotonic), without blocking.

        If it is not `wanted`, or during a pause, its counts become unsent.
        """
        output, wanted = self._output, wanted and not self._paused
        at_once = output is not None and not (output.blocks or self._paced or self._queue)
        if at_once and self._turn.acquire(blocking=False):
            try:
                return self._take(report, taken, wanted, taken)
            finally:
                self._turn.release()
        self._queue.append((report, taken, wanted, monotonic()))
        if len(self._queue) > MAX_QUEUED_FRAMES:
            with contextlib.suppress(IndexError):  # the thread has emptied the queue
                self._overflow = plus(self._overflow, self._queue.popleft()[0].counts)
                self._overflowed += 1
        self._wake_thread()
        if self._calls.pending is not None:
            self._calls.look()

    def end_prediction(self, now: float) -> None:
        """End the prediction at `now` (s, monotonic), because no frame will correct it."""
        if self._paced:
            submitted = monotonic()
            self._queue.append((_empty(now), submitted, True, submitted))
            self._wake_thread()

    def set_paused(self, paused: bool) -> None:
        """Start or end a pause, in which all submitted counts become unsent."""
        self._paused = paused
        self._wake_thread()

    def change(self, settings: PointerSettings) -> None:
        """Use other settings from the next frame on."""
        self._settings = settings

    def status(self) -> ReporterStatus:
        """Return the condition of the output, the sums of counts and the latency."""
        failed, arrived, unsent, ahead = self._sums()
        dropped, latency = self._dropped + self._overflowed, _latency_of(tuple(self._latencies))
        return ReporterStatus(failed, self.ended, self._reports, dropped, arrived, unsent, ahead, latency)

    @property
    def queued(self) -> Counts:
        """Counts that were submitted and that the thread has not processed."""
        return reduce(plus, (queued[0].counts for queued in tuple(self._queue)), _NONE)

    @property
    def unsent(self) -> Counts:
        """Counts that were submitted and will not be sent, as in `status`."""
        return self._sums()[2]

    def _sums(self) -> tuple[str | None, Counts, Counts, Counts]:
        """Return the reason of a failure, and the counts that arrived, are unsent, and are ahead of the frames.

        Counts are ahead if the prediction sent them before a frame confirmed them. Of a failed output, all counts of
        frames that have not arrived are unsent, also those in the queue.
        """
        failed, past, sent, delivery = self.failed, self._past, self._sent, _delivery(self._output)
        arrived = minus(plus(past, sent), plus(delivery.waiting, delivery.lost))
        unsent = plus(plus(self._unsent, self._overflow), delivery.lost)
        ahead = minus(minus(sent, self._frame_sum), delivery.waiting)
        if failed is not None:
            return failed, arrived, plus(minus(unsent, ahead), self.queued), _NONE
        return None, arrived, unsent, ahead

    @property
    def failed(self) -> str | None:
        """Reason of a failure; None: the output works. Read it often: it logs a call that hangs for 0.4 s."""
        return self._calls.look() or self._failed

    def close(self) -> None:
        """Close the output and wait for the thread, at most 5 s. A thread that hangs is left running."""
        self._closing = True
        self._wake_thread()
        if self._thread.ident is None:  # the thread was never started
            return
        self._thread.join(HANG_TIMEOUT if self._calls.hung(self._calls.pending) else _MAX_JOIN_TIME)

    def _wake_thread(self) -> None:
        try:  # noqa: SIM105  suppress takes three times as long, for each frame and output
            self._wakeup.release()
        except RuntimeError:  # the thread is awake already
            pass

    # ---- the thread ----

    def _run(self) -> None:
        """Send what is due until `close`, and what is queued then. Then it opens no failed output again.

        After an unexpected exception, `_work` opens the output again with delay.
        """
        try:
            closing = False
            while not closing:
                closing = self._closing
                with self._turn:
                    try:
                        wait = self._work()
                    except Exception as e:
                        self._log(internal_error_text())
                        self._fail(f"internal error: {reason_of(e)}", e)
                        wait = 0.0
                if wait > 0.0 and not closing:
                    self._wakeup.acquire(timeout=min(wait, threading.TIMEOUT_MAX))
        finally:
            with self._turn:
                self._close()
                self._drop_queue()

    def _work(self) -> float:
        """Do all work that is due, and return the time (s) until the next, if no report is submitted before."""
        given_up = self.ended or (self._closing and self._failed is not None)
        if self._output is None and not given_up and monotonic() >= self._retry_time:
            self._open_again()
        if self._acknowledges:
            self._check_delivery()
        if self._paused:
            self._reset()
        while self._queue:
            self._take(*self._queue.popleft())
        if self._output is None:
            return inf if self.ended else self._retry_time - monotonic()
        if self._next_time == inf:
            return inf
        if monotonic() >= self._next_time:
            self._send_between_frames(monotonic())
        return self._next_time - monotonic()

    def _take(self, report: Report, taken: float, wanted: bool, submitted: float) -> None:
        """Send a frame's report at once, even an empty one: some outputs use it as a sign of life."""
        now = monotonic() if self._paced else submitted  # a late report of a frame is still worth sending
        works = self._output is not None and self._failed is None and not self._paused
        if not (works and wanted) or now - submitted > MAX_QUEUE_TIME:
            self._unsent, self._dropped = plus(self._unsent, report.counts), self._dropped + 1
            if self._output is not None and self._failed is not None and not self._paused:
                self._send(_empty(report.stamp), self._sent)
            return
        self._frame_sum = due = plus(self._frame_sum, report.counts)
        if self._paced:
            due = self._predict(report, taken, now)
            report = report._replace(counts=minus(due, self._sent))
        if self._send(report, due):
            self._latencies.append(monotonic() - taken)

    def _predict(self, report: Report, taken: float, now: float) -> Counts:
        """Start the prediction from a frame, and return the sum of counts that is due."""
        settings = self._settings
        self._resampler = pointer.take(self._resampler, self._sent, report.counts, report.rate, taken, now, settings)
        self._last, self._grid, self._period = (report, taken), now, 1.0 / settings.rate
        self._plan(now)
        return pointer.due(self._resampler, now)

    def _send_between_frames(self, now: float) -> None:
        """Send a report between frames if counts are due, or an empty one to an output that has a period."""
        if not self._paced:
            assert self._output is not None
            self._next_time = now + self._output.period
            self._send(_empty(now), self._sent)
            return
        self._plan(now)
        due = pointer.due(self._resampler, now)
        if due != self._sent:
            assert self._last is not None
            last, taken = self._last
            self._send(Report(minus(due, self._sent), last.rate, last.stamp + now - taken), due)

    def _plan(self, now: float) -> None:
        """Set the time of the next report: on a grid without drift, and once after the end of the prediction."""
        period = self._period
        after = self._grid + (floor((now - self._grid) / period) + 1) * period
        self._next_time = after if now < self._resampler.until else inf

    def _send(self, report: Report, due: Counts) -> bool:
        """Send a report, after which `due` is sent. Return whether the output took it, and log each change."""
        assert self._output is not None
        self._calls.pending = call = (_SENDS, self._output.hang_hint)  # as `run`, which would cost each report more
        try:
            self._output.send(report)
        except OutputClosed as e:
            self.ended = True
            self._fail("the reader of the output is gone", e)
            return False
        except Exception as e:
            self._fail(reason_of(e), e)
            return False
        finally:
            self._calls.pending = None
        self._sent = due
        if report.counts != _NONE:
            self._reports += 1
            self._failures = 0  # reset by a report, not by opening: an output may open and never send
        if self._unproven is not None:
            self._unproven = None
            self._log(f"{self._name}: works again")
        if self._calls.hung(call):
            self._log(f"{self._name}: works again")
            self._reset()  # the counts of that time would make the pointer jump
        return True

    def _open_again(self) -> None:
        try:
            hung = self._calls.run((_OPENS, ""), self._enter)
        except Exception as e:
            self._fail(reason_of(e), e)
            return
        if self._failed is not None:
            self._drop_queue()
            self._failed, self._unproven = None, self._failed
        elif hung:
            self._works_again()

    def _enter(self) -> None:
        """Open the output, and read whether it is paced and confirms deliveries."""
        self._output = output = self._open().__enter__()
        self._next_time = monotonic() + output.period
        self._paced, self._acknowledges = output.paced, type(output).delivery is not Output.delivery

    def _check_delivery(self) -> None:
        if self._output is None:
            return
        trouble = self._output.delivery().trouble
        if trouble and self._failed is None:
            self._reset()
            self._output.drop_waiting()
            self._log(log_line(self._name, trouble))
        if trouble:
            self._failed = trouble
        elif self._failed is not None:
            self._works_again()

    def _works_again(self) -> None:
        self._log(f"{self._name}: works again")
        if self._paced:  # others get each frame, for example a table whose library took long to load
            self._drop_queue()
        self._failed = None

    def _fail(self, reason: str, error: Exception) -> None:
        """Close the output, log the reason and set the time of the next attempt."""
        self._close(error)
        if reason not in (self._failed, self._unproven):
            self._log(log_line(self._name, reason) + ("" if self.ended else "; trying again until it works"))
        self._failed, self._unproven = reason, None
        self._retry_time = monotonic() + RETRY_DELAYS[min(self._failures, len(RETRY_DELAYS) - 1)]
        self._failures += 1
        self._wake_thread()  # to open it again

    def _close(self, error: Exception | None = None) -> None:
        """Close the output, after the `error` that made it fail if there is one."""
        self._reset()
        output = self._output
        if output is not None:
            try:
                call = (_CLOSES, output.hang_hint)
                self._calls.run(call, output.__exit__, None if error is None else type(error), error, None)
            except Exception as e:
                if error is None:  # otherwise the output failed before
                    self._log(log_line(self._name, reason_of(e)))
            missing = plus(_delivery(output).waiting, _delivery(output).lost)
            self._past, self._unsent = minus(self._past, missing), plus(self._unsent, missing)
            self._output = None

    def _reset(self) -> None:
        """Start with a new resampler. Counts that are due become unsent."""
        self._unsent = plus(self._unsent, minus(self._frame_sum, self._sent))
        self._past = plus(self._past, self._sent)
        self._resampler, self._frame_sum, self._sent = Resampler(), _NONE, _NONE
        if self._paced:
            self._next_time = inf

    def _drop_queue(self) -> None:
        """Count the queued reports as unsent: sent all at once they would make the pointer jump."""
        for _ in range(len(self._queue)):
            self._unsent, self._dropped = plus(self._unsent, self._queue.popleft()[0].counts), self._dropped + 1


def _latency_of(seconds: tuple[float, ...]) -> Latency | None:
    if not seconds:
        return None
    p50, p99 = np.percentile(seconds, (50.0, 99.0)).tolist()
    return Latency(p50, p99, max(seconds))


def _empty(stamp: float) -> Report:
    return Report(_NONE, rate=None, stamp=stamp)


def _delivery(output: Output | None) -> DeliveryStatus:
    return _ALL_ARRIVED if output is None else output.delivery()
