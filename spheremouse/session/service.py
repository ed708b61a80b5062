"""The daemon: the loop of the worker's thread over the parts of a run.

It takes the newest frame, tracks it, and handles requests between two frames. It waits only for the next frame.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from spheremouse.capture.newest import Arrival
from spheremouse.capture.signals import SignalHandler, on_hang_up
from spheremouse.output import Report, report_of
from spheremouse.output.pointer import minus
from spheremouse.session import command_handler
from spheremouse.session.control.protocol import Request
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.control.status import State, StatusReport
from spheremouse.session.live_run import LiveRun
from spheremouse.session.process.realtime import GcPause
from spheremouse.session.run_status import status_of
from spheremouse.session.timing import NEXT_FRAME_S, SleepMonitor
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter

_MAX_FRAME_WAIT_S = 0.25  # s; the longest wait for a frame
_REQUEST_TIME_S = 0.005  # s; `set` takes 1 to 2 ms
_CHECK_INTERVAL_S = 1.0  # s between two checks of the files, and of the memory and processor in use
_MAX_UNUSABLE_S = 5.0  # s of frames that cannot be used, after which the daemon opens the camera again

Show = Callable[[FrameResult, Report, TrackerAdapter], None]


class Daemon:
    """One run. `run` releases everything at its end."""

    def __init__(self, parts: LiveRun, *, show: Show = lambda _, __, ___: None, frames: int | None = None) -> None:
        """`show` sees each tracked frame; `frames` ends the run after so many of them."""
        self.parts, self._show, self._limit = parts, show, frames
        self.finished = False  # the end of a recording has ended the run
        self._checked_at = self._reopened_at = time.monotonic()
        self._sleep = SleepMonitor()

    def run(self, stopping: SignalHandler) -> None:
        """Run until a signal, a `stop` request or the end of a recording."""
        parts = self.parts
        try:
            with on_hang_up(self._reload):  # as other services do
                parts.begin(partial(command_handler.receive, parts), self.status)
                self._loop(stopping, parts.start())
        finally:
            parts.notifier.send("STOPPING=1")
            parts.close()

    def status(self) -> StatusReport:
        """Return the status, from any thread."""
        return status_of(self.parts)

    # ---- the loop ----

    def _loop(self, stopping: SignalHandler, gc_pause: GcPause) -> None:
        """Track frames, and run requests when they delay none.

        That is after a frame, well before the next one, if it is late, or after the last.
        """
        parts, handle = self.parts, partial(command_handler.handle, self.parts)
        captures, arrivals, now = parts.captures, parts.arrivals, time.monotonic()
        while not (stopping.stop_requested or parts.ending):
            arrival = parts.ring.take(NEXT_FRAME_S if arrivals.on_time(now) else _MAX_FRAME_WAIT_S)
            now, finished = time.monotonic(), captures.finished
            if arrival is not None:
                self._work(arrival, now)
            parts.update_state(now)
            frame_overdue = not arrivals.on_time(now)
            if arrival is not None or finished or frame_overdue or arrivals.time_left(now) > _REQUEST_TIME_S:
                parts.requests.run(handle)
            if arrival is None and finished:
                if captures.failure is not None:
                    raise captures.failure
                self.finished = True
                break
            gc_pause.collect_if_due(now)
            self._do_periodic_work(now)
            parts.ending |= parts.outputs.ended

    def _work(self, arrival: Arrival, now: float) -> None:
        """Track a frame that arrived at `now` (s, monotonic), and show it."""
        parts, worker, replay = self.parts, self.parts.worker, self.parts.setup.replay
        parts.arrivals.add(now)
        if slept := self._sleep.slept(now):
            parts.log(f"the computer slept for {slept:.0f} s: motion meanwhile is not counted")
            parts.outputs.end_prediction(now)
        if slept or self._sleep.is_older(arrival.taken):
            parts.adapter.slept()
        waiting = parts.adapter.waiting
        if replay is not None and replay.is_first(arrival.raw) and not waiting:
            parts.adapter.restart("the recording begins")
        shown = arrival.camera == parts.captures.main
        try:
            made = worker.work(arrival, colour=parts.archive.wants_colour)
            if made is not None:
                if parts.monitor.state is not State.TRACKING:
                    parts.update_state(now)  # log the state before anything moves
                self._publish(made, arrival.taken, shown=shown)
            elif worker.untracked is not None and shown:
                parts.archive.look(worker.untracked, parts.adapter)
            parts.pictures.show(now, arrival, parts.adapter, made, len(parts.captures.each))
        finally:
            if replay is not None and waiting and not parts.adapter.waiting:
                replay.control(replay.controls, rewind=True)  # to the frames before the pose was known
            worker.untracked = None
            arrival.raw.release()

    def _publish(self, result: FrameResult, taken: float, *, shown: bool) -> None:
        """Pass the result of a frame on, to the outputs first. Those that may block have threads of their own.

        `taken` is the frame's mid-exposure, s of time.monotonic. The latency of the samples ends here; that of the
        status ends when the output has sent. `shown`: it is of the camera whose pictures are kept.
        """
        parts = self.parts
        latency = time.monotonic() - taken
        wall = time.time() - latency
        samples = tuple(replace(sample, wall=wall, latency=latency) for sample in result.samples)
        report = report_of(samples, parts.adapter.mapping, result.pointing)
        # `_work` has just updated a state that is not TRACKING. An output that fails later counts its frames as unsent.
        parts.outputs.submit(report, taken, wanted=parts.monitor.state is not State.FAILED_OUTPUT)
        # Archive and view get the image, too, whose buffer is released after this.
        if shown:
            parts.archive.keep(result, parts.adapter, lambda: minus(parts.outputs.counts, parts.outputs.unsent))
        self._show(result, report, parts.adapter)
        if parts.server is not None:
            parts.server.submit(report)
        if self._limit is not None and parts.worker.frames >= self._limit:
            parts.ending = True

    def _do_periodic_work(self, now: float) -> None:
        """Feed the watchdog and flush the log.

        Each second also measure, reopen a camera whose frames are unusable, reload changed files, and drop requests
        whose clients have left.
        """
        parts, captures, worker = self.parts, self.parts.captures, self.parts.worker
        silent = parts.arrivals.silent(now)
        parts.notifier.progress(("attempts", captures.attempts) if silent else ("frames", worker.seen))
        parts.log.flush()
        if len(captures.each) > 1:
            captures.log_changes(now, map(parts.trouble_of, range(len(captures.each))))
        if now - self._checked_at < _CHECK_INTERVAL_S:
            return
        self._checked_at = now
        parts.pictures.refuse_late(now, parts.monitor.reason)
        parts.cpu.look(now)
        worker.update_stages()
        unusable_s = now - max(worker.last_good_at, self._reopened_at)
        if worker.trouble and not captures.trouble and unusable_s > _MAX_UNUSABLE_S:
            self._reopened_at = now
            captures.reopen()
        if parts.reloader.outdated:
            parts.requests.put(PendingRequest(Request(command="reload"), quiet=True))
        parts.archive.cancel_abandoned()

    def _reload(self) -> None:
        requests = self.parts.requests
        requests.call(lambda: requests.put(PendingRequest(Request(command="reload"))))
