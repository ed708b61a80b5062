"""Motion of frames in, reports of the pointer out: a thread that keeps an output open and sends what `pointer` says.

It wakes when a frame is given and while there is a course to carry on; else it sleeps. No error of an output gets out:
the output is closed, opened again with growing patience, and what comes meanwhile is counted, not sent. An output that
says itself that nothing gets through (`Acknowledged`) stays open and is given empty reports until it does again. One
that does not come back from being opened, written to or closed is seen from outside, by whoever gives frames or asks.
On every axis, what was given is what was sent plus what was left unsent, less what the pointer is ahead of the ball;
what the other end of an output has not acknowledged was not sent.
"""

import contextlib
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import floor

import numpy as np

from spheremouse.output import Acknowledged, DeliveryStatus, Output, OutputClosed, Report, no_report, pointer
from spheremouse.output.null import Null
from spheremouse.output.pointer import Counts, PointerSettings, Resampler, minus, plus
from spheremouse.output.text import Text
from spheremouse.tracker import no_motion

BACK_OFF = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0)  # s
LATE = 0.25  # s in the queue after which a frame's counts are not wanted any more: an output hung
# s that others see an output at the same report before it counts as hanging. A report takes microseconds, and what the
# machine's load adds are milliseconds; time in which those who look were held up themselves is hardly counted.
HANGS = 0.4
QUEUED = 256  # frames: seconds, at any camera's rate
REMEMBERED = 4096  # latencies: a minute at 60 Hz
_JOIN = 5.0  # s
_OPENS, _SENDS, _CLOSES = "it cannot be opened", "it takes no report", "it cannot be closed"
_NONE: Counts = (0, 0, 0)
_PASSED = DeliveryStatus()


@dataclass(frozen=True, slots=True)
class Latency:
    """From a frame's stamp to the end of `send`, over the last frames."""

    p50: float  # s
    p99: float  # s
    max: float  # s


@dataclass(frozen=True, slots=True)
class ReporterStatus:
    """Condition of the output, sums of counts and latency."""

    failed: str | None  # why nothing can be sent; None: it can
    ended: bool  # whoever read the output has gone, for good
    reports: int  # with counts
    sent: Counts  # as far as the output's other end acknowledges them, where it does
    unsent: Counts  # given while the output was gone or paused, or too late; or sent and lost
    ahead: Counts  # sent and not given yet, or the reverse: what is predicted, and what was, is withheld or under way
    latency: Latency | None  # None: no frame was sent


@dataclass(frozen=True, slots=True)
class _Given:
    report: Report
    taken: float  # s, the frame's stamp on the clock
    wanted: bool  # not paused
    came: float  # s
    frame: bool = True  # False: nothing but the end of what is predicted


class OutputThread:
    """Sends motion from a thread of its own. All methods may be called from any thread; none waits but `close`."""

    def __init__(
        self,
        open_output: Callable[[], Output],
        settings: PointerSettings,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        begin: Callable[[threading.Thread], None] = threading.Thread.start,
    ) -> None:
        """`open_output` and `say` are called in the thread; `clock` (s) runs as time does.

        What `begin` raises where no thread is to be had comes out here.
        """
        self._open, self._settings, self._say, self._clock = open_output, settings, say, clock
        # A lock as a bell: it is rung by releasing it. Unlike a condition it never makes the one who rings wait.
        self._wakeup = threading.Lock()
        self._wakeup.acquire()
        self._given: deque[_Given] = deque()
        self._sum, self._overflow = _NONE, _NONE  # counts given, and of these pushed out of the queue
        self._over = self._paused = self._ended = False
        self._output: Output | None = None
        self._failed: str | None = None
        self._failures = 0
        self._again = clock()  # s, when the output is opened
        self._resampler, self._sent = Resampler(), _NONE  # since the output was opened
        self._past, self._unsent = _NONE, _NONE
        # What the thread does with the output, and since when others have seen it at it: at most one of them each.
        self._doing: _Doing | None = None
        self._seen: tuple[_Doing, float] | None = None
        self._reports = self._frames = 0
        self._latency = np.zeros(REMEMBERED)
        self._last: _Given | None = None
        self._grid, self._period = 0.0, 1.0 / settings.rate  # s; reports follow a frame at whole periods
        self._next = np.inf  # s, when the next one is due
        self._thread = threading.Thread(target=self._run, name="reporter", daemon=True)
        begin(self._thread)

    def submit(self, report: Report, taken: float, wanted: bool = True) -> None:
        """A frame's report and the time (s, of the clock) it was taken. Never waits.

        What is not `wanted` is counted as unsent, as it is during a pause.
        """
        self._sum = plus(self._sum, report.counts)
        self._given.append(_Given(report, taken, wanted and not self._paused, self._clock()))
        if len(self._given) > QUEUED:
            with contextlib.suppress(IndexError):  # the thread was quicker
                self._overflow = plus(self._overflow, self._given.popleft().report.counts)
        self._wake_thread()
        self.failed  # noqa: B018  a look at whether the output hangs

    def rest(self, now: float) -> None:
        """Carry nothing on: no frame will say whether it is true."""
        self._given.append(_Given(no_report(now), now, True, self._clock(), frame=False))
        self._wake_thread()

    def pause(self, paused: bool) -> None:
        """While paused nothing is sent; what comes meanwhile is counted as unsent."""
        self._paused = paused
        self._wake_thread()

    def change(self, settings: PointerSettings) -> None:
        """Other settings, from the next frame on."""
        self._settings = settings

    def status(self) -> ReporterStatus:
        """Condition of the output, sums of counts and latency."""
        failed, arrived, unsent, ahead = self._sums()
        n, latency = min(self._frames, REMEMBERED), None
        if n:
            p50, p99 = np.percentile(self._latency[:n], (50.0, 99.0)).tolist()
            latency = Latency(p50, p99, float(self._latency[:n].max()))
        return ReporterStatus(failed, self._ended, self._reports, arrived, unsent, ahead, latency)

    @property
    def unsent(self) -> Counts:
        """Counts that were given and will not be sent, as `status` has them."""
        return self._sums()[2]

    def _sums(self) -> tuple[str | None, Counts, Counts, Counts]:
        """Why nothing can be sent; counts sent, unsent and ahead."""
        failed, past, sent, passage = self.failed, self._past, self._sent, _passage(self._output)
        arrived = minus(plus(past, sent), plus(passage.waiting, passage.lost))
        if failed is not None:  # nothing is under way: what was given and has not arrived will not
            return failed, arrived, minus(self._sum, arrived), _NONE
        unsent = plus(plus(self._unsent, self._overflow), passage.lost)
        return None, arrived, unsent, minus(minus(sent, self._resampler.truth), passage.waiting)

    @property
    def failed(self) -> str | None:
        """The reason why nothing can be sent; None: it can."""
        doing, now = self._doing, self._clock()
        if doing is None:
            return self._failed
        if self._seen is None or self._seen[0] is not doing:
            self._seen = doing, now
        took = now - self._seen[1]
        if took < HANGS:
            return self._failed
        reason = f"the output hangs: {doing.what}{doing.hint} for {took:.1f} s"
        if not doing.hangs:
            doing.hangs = True
            self._say(f"output: {reason}")
        return reason

    @property
    def ended(self) -> bool:
        """Whoever read the output has gone, for good."""
        return self._ended

    @property
    def native_id(self) -> int | None:
        """The thread's number in the system."""
        return self._thread.native_id

    def close(self) -> None:
        """Close the output; waits for it, if it does not take too long. One that hangs is left behind."""
        self._over = True
        self._wake_thread()
        if self._thread.ident is None:  # it was never begun
            return
        self._thread.join(HANGS if self._doing is not None and self._doing.hangs else _JOIN)

    def _wake_thread(self) -> None:
        with contextlib.suppress(RuntimeError):  # it rings already
            self._wakeup.release()

    # ---- the thread ----

    def _run(self) -> None:
        try:
            while not self._over:
                try:
                    self._turn()
                except Exception as e:
                    self._say("internal error, please report it:\n" + traceback.format_exc().rstrip())
                    self._fail(f"internal error: {_reason(e)}", e)
                left = self._wake() - self._clock()
                if left > 0.0:
                    self._wakeup.acquire(timeout=min(left, threading.TIMEOUT_MAX))
        finally:
            self._close(None)
            self._drop_queue()

    def _wake(self) -> float:
        """s, when there is something to do if nothing is given."""
        if self._given:
            return -np.inf
        if self._output is None:
            return np.inf if self._ended else self._again
        return self._next

    def _turn(self) -> None:
        if self._output is None and not self._ended and self._clock() >= self._again:
            self._open_again()
        self._look_at_passage()
        if self._paused:
            self._forget()
        while self._given:
            given = self._given.popleft()
            if not given.frame and self._per_frame:
                continue
            now = self._clock()
            late = now - given.came > LATE and not self._per_frame
            if self._failed is not None or self._output is None or self._paused or late or not given.wanted:
                self._unsent = plus(self._unsent, given.report.counts)
                if self._output is not None and self._failed is not None and not self._paused:
                    self._send(_without(given.report), self._sent)
            else:
                self._take(given, now)
        if self._output is not None and (now := self._clock()) >= self._next:
            self._carry_on(now)

    def _take(self, given: _Given, now: float) -> None:
        """A frame's report, at once. It is sent even if it is empty: some outputs want to know that we live."""
        settings, report = self._settings, given.report
        tracking = report.motion.confirmed and not self._per_frame
        self._resampler = pointer.take(
            self._resampler, self._sent, report.counts, report.rate, given.taken, now, tracking, settings
        )
        self._last, self._grid, self._period = given, now, 1.0 / settings.rate
        self._plan(now)
        due = pointer.due(self._resampler, now)
        counts = minus(due, self._sent)
        if self._send(report._replace(counts=counts), due):
            self._latency[self._frames % REMEMBERED] = self._clock() - given.taken
            self._frames += 1

    def _carry_on(self, now: float) -> None:
        """A report between frames, if there are counts for it."""
        self._plan(now)
        due = pointer.due(self._resampler, now)
        if due != self._sent:
            assert self._last is not None
            last = _without(self._last.report, now - self._last.taken)
            self._send(last._replace(counts=minus(due, self._sent)), due)

    def _plan(self, now: float) -> None:
        """Set the time of the next report: on a grid that does not drift, and once after the course has ended."""
        period = self._period
        after = self._grid + (floor((now - self._grid) / period) + 1) * period
        self._next = after if now < self._resampler.until else np.inf

    @property
    def _per_frame(self) -> bool:
        """Does the output get what the frames say, as they say it?"""
        return isinstance(self._output, Text | Null) and not self._settings.text

    def _send(self, report: Report, due: Counts) -> bool:
        assert self._output is not None
        try:
            with self._at(_SENDS) as doing:
                self._output.send(report)
        except OutputClosed as e:
            self._ended = True
            self._fail("whoever read the output has gone", e)
            return False
        except Exception as e:
            self._fail(_reason(e), e)
            return False
        self._sent = due
        if report.counts != _NONE:
            self._reports += 1
            self._failures = 0  # not on opening: what opens and never sends must not flap
        if doing.hangs:
            self._say("output: works again")
            self._forget()  # what was due meanwhile would be a jump
        return True

    def _open_again(self) -> None:
        try:
            with self._at(_OPENS) as doing:
                self._output = self._open().__enter__()
        except Exception as e:
            self._fail(_reason(e), e)
            return
        if self._failed is not None or doing.hangs:
            self._works_again()
        self._next = np.inf

    def _look_at_passage(self) -> None:
        """Tell, and note as failure, that the output that is open gets no counts through, or does again."""
        if not isinstance(self._output, Acknowledged):
            return
        trouble = self._output.passage().trouble
        if trouble and self._failed is None:
            self._forget()
            self._output.give_up()
            self._say(f"output: {trouble}")
        if trouble:
            self._failed = trouble
        elif self._failed is not None:
            self._works_again()

    def _works_again(self) -> None:
        self._say("output: works again")
        self._drop_queue()
        self._failed = None

    @contextlib.contextmanager
    def _at(self, what: str) -> Iterator["_Doing"]:
        """While something is done with the output that may not come to an end."""
        self._doing = doing = _Doing(what, " (its reader does not read)" if isinstance(self._output, Text) else "")
        try:
            yield doing
        finally:
            self._doing = None

    def _fail(self, reason: str, error: Exception) -> None:
        """Close the output; it is opened again after a while."""
        self._close(error)
        if reason != self._failed:
            self._say(f"output: {reason}" + ("" if self._ended else "; trying again until it works"))
        self._failed = reason
        self._again = self._clock() + BACK_OFF[min(self._failures, len(BACK_OFF) - 1)]
        self._failures += 1

    def _close(self, error: Exception | None) -> None:
        self._forget()
        output = self._output
        if output is not None:
            with contextlib.suppress(Exception), self._at(_CLOSES):
                output.__exit__(None if error is None else type(error), error, None)
            missing = plus(_passage(output).waiting, _passage(output).lost)
            self._past, self._unsent = minus(self._past, missing), plus(self._unsent, missing)
            self._output = None

    def _forget(self) -> None:
        """Begin anew; what has not been sent will not be."""
        if self._resampler.stamp is not None:
            self._unsent = plus(self._unsent, minus(self._resampler.truth, self._sent))
            self._past = plus(self._past, self._sent)
            self._resampler, self._sent = Resampler(), _NONE
        self._next = np.inf

    def _drop_queue(self) -> None:
        """Count as unsent what came while the output was gone: all at once it would be a jump."""
        for _ in range(len(self._given)):
            self._unsent = plus(self._unsent, self._given.popleft().report.counts)


@dataclass(slots=True, eq=False)
class _Doing:
    """One thing that is done with the output."""

    what: str  # in words for who waits
    hint: str
    hangs: bool = False


def _without(report: Report, later: float = 0.0) -> Report:
    """A report of no turn, so many s after another one."""
    motion = no_motion(report.motion.stamp + later)
    return Report(_NONE, report.rate, motion._replace(rate=report.motion.rate))


def _passage(output: Output | None) -> DeliveryStatus:
    """Counts of an output that have not arrived; none where it cannot tell."""
    return output.passage() if isinstance(output, Acknowledged) else _PASSED


def _reason(error: Exception) -> str:
    """An error in one line."""
    text = " ".join(str(error).split())
    return text or type(error).__name__
