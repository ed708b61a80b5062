"""Start threads, with a clear error if the system has none left; and a fixed pool of threads."""

import queue
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import TypeVar

from spheremouse.errors import ControlError, internal_error_text

_MAX_FINISH_S = 30.0  # that a recording may take at the end

T = TypeVar("T")
Work = Callable[[], Callable[[], None] | None]  # returns a call that follows, which may ask for more work of the kind


def begin(thread: threading.Thread) -> None:
    """Start a thread. Raise ControlError if the system refuses it."""
    try:
        thread.start()
    except RuntimeError:  # CPython raises it for any reason
        hint = "end other programs of this user, or raise TasksMax of the unit (`ulimit -u` by hand)"
        raise ControlError("the system refuses a new thread, as its limit of tasks is reached", hint) from None


def as_future(work: Callable[[], T], submit: Callable[[Work], object]) -> Future[T]:
    """Have `submit` run the work, and return the future of its result or error."""
    future = Future[T]()

    def run() -> None:
        try:
            future.set_result(work())
        except Exception as e:
            future.set_exception(e)

    submit(run)
    return future


class WorkerPool:
    """One thread for each kind of work. All start together, since the system may refuse threads later.

    A thread does its work in order. To avoid a queue, check `busy` first.
    """

    def __init__(self, kinds: Iterable[str], log: Callable[[str], None]) -> None:
        """`log` logs internal errors, from any thread."""
        self._log = log
        self._queues: dict[str, queue.SimpleQueue[Work | None]] = {kind: queue.SimpleQueue() for kind in kinds}
        self._unfinished = dict.fromkeys(self._queues, 0)  # number of works, queued or running
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []

    def begin(self) -> None:
        """Start all threads. Raise ControlError if the system refuses one."""
        for kind in self._queues:
            thread = threading.Thread(target=self._run, args=(kind,), name=kind, daemon=True)
            begin(thread)
            self._threads.append(thread)

    def submit(self, kind: str, work: Work) -> None:
        """Have the thread of a kind do work, from any thread, without waiting.

        If the work returns a function, the thread calls it when `busy` no longer counts this work. A client that gets
        its answer there may request again at once.
        """
        with self._lock:
            self._unfinished[kind] += 1
        self._queues[kind].put(work)

    def busy(self, kind: str) -> bool:
        """Return True while work of that kind is not done."""
        return self._unfinished[kind] > 0

    def end(self, *kinds: str) -> None:
        """End the threads after their work. Wait for work of these kinds, at most 30 s in all."""
        for works in self._queues.values():
            works.put(None)
        end = time.monotonic() + _MAX_FINISH_S
        for thread in self._threads:
            if thread.name in kinds:
                thread.join(max(0.0, end - time.monotonic()))

    def _run(self, kind: str) -> None:
        while (work := self._queues[kind].get()) is not None:
            follow_up = self._run_and_log_error(work)
            del work  # else its pictures stay in memory until the next one comes
            with self._lock:
                self._unfinished[kind] -= 1
            if follow_up is not None:
                self._run_and_log_error(follow_up)
                del follow_up

    def _run_and_log_error(self, work: Work) -> Callable[[], None] | None:
        try:
            return work()
        except Exception:
            self._log(internal_error_text())
            return None
