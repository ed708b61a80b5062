"""The daemon: capture, worker, reporter and control socket of one run.

The loop in `Daemon.run` is the worker's thread. It takes the newest frame, tracks it, and handles requests between two
frames. It waits only for the next frame.
"""

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spheremouse import __version__
from spheremouse.capture import OpenCamera
from spheremouse.capture.fetch import Capture
from spheremouse.capture.newest import LatestFrame
from spheremouse.capture.signals import SignalHandler, on_hang_up
from spheremouse.output.pointer import Counts, minus, plus
from spheremouse.output.rate_limited_logger import RateLimitedLogger
from spheremouse.output.third_axis import left_out
from spheremouse.session.arrivals import Arrivals
from spheremouse.session.cameras import held
from spheremouse.session.changes import given
from spheremouse.session.command_handler import CommandHandler
from spheremouse.session.config_reloader import READING, ConfigReloader
from spheremouse.session.control.endpoints import Endpoints
from spheremouse.session.control.protocol import Request, refused
from spheremouse.session.control.request_queue import PendingRequest, RequestQueue
from spheremouse.session.follower import MAP, POSE, TARGETS, FrameResult, Setup, TrackerAdapter
from spheremouse.session.outputs import OUTPUT, Outputs
from spheremouse.session.plan import Plan
from spheremouse.session.plan import Request as PlanRequest
from spheremouse.session.process import realtime
from spheremouse.session.process.notify import Notifier
from spheremouse.session.process.threads import WorkerPool, begin
from spheremouse.session.process.usage import CpuShare, memory_mb
from spheremouse.session.record.archive import RECORDING, SNAPSHOT, Archive
from spheremouse.session.record.places import recordings_folder, tidy
from spheremouse.session.state_monitor import StateMonitor
from spheremouse.session.states import State
from spheremouse.session.worker import Worker

_TICK = 0.25  # s; the longest wait for a shot
_EVERY = 1.0  # s between two looks at files, and at what the process takes
_COMPILING = 900.0  # s that a small computer may take for it
_USELESS = 5.0  # s of frames that cannot be used, after which the daemon opens the camera again

Show = Callable[[FrameResult, TrackerAdapter], None]


class Daemon:
    """One run. `run` releases everything at its end."""

    def __init__(
        self,
        request: PlanRequest,
        plan: Plan,
        setup: Setup,
        open_camera: OpenCamera,
        reopen: Callable[[Plan], OpenCamera],
        *,
        say: Callable[[str], None],
        show: Show = lambda _, __: None,
        frames: int | None = None,
    ) -> None:
        """`setup` makes what follows the ball; `reopen` gives the way to open the camera of another plan.

        `say` takes lines for the log, from any thread; `show` sees each tracked frame; `frames` ends the run after so
        many of them.
        """
        self._setup, self._reopen, self._print, self._show, self._limit = setup, reopen, say, show, frames
        self._say = RateLimitedLogger(self._say_now)  # from any thread; of each kind one line a second
        self._began = self._looked = self._cured = time.monotonic()
        self._over = self._finished = False
        self._cpu = CpuShare()
        self._scheduling = "usual scheduling"
        self._notifier = Notifier()
        self._endpoints = Endpoints(self.handle, self._say)
        self._stack = contextlib.ExitStack()
        self._stack.callback(self._endpoints.close)
        self._ring = LatestFrame()
        self._requests = RequestQueue(self._ring.wake, self._say)
        ask = self._requests.call
        self._crew = WorkerPool((READING, TARGETS, POSE, MAP, OUTPUT, RECORDING, SNAPSHOT), self._say)
        self._loader = ConfigReloader(request, plan, setup, self._prepare, crew=self._crew, ask=ask, say=self._say)
        self._archive = Archive(self._crew, ask, self._say)
        self._capture = Capture(open_camera, self._ring, self._say)
        self._arrivals = Arrivals()
        follower = setup.follower(plan, self._say, self._crew.do)
        self._worker = Worker(follower, self._say)
        self._outputs = Outputs(follower.outputs, plan.configuration.pointer, say=self._say, crew=self._crew, ask=ask)
        self._counts: Counts = (0, 0, 0)  # of all frames
        self._monitor = StateMonitor(
            self._worker, self._capture, self._arrivals, self._outputs, say=self._say, tell=self._notifier.status
        )
        self._commands = CommandHandler(
            self._worker,
            self._monitor,
            self._loader,
            self._archive,
            self._crew,
            pause=self._pause,
            camera=lambda: self._capture.description,
            log=self._say,
        )

    def run(self, stopping: SignalHandler) -> None:
        """Run until a signal, a `stop` request or the end of a recording."""
        try:
            with on_hang_up(self._reload):  # as other services do
                self._crew.begin()
                self._open_endpoints()  # a daemon that is refused there has opened no output
                self._outputs.begin()
                self._tell_left_out(self._loader.plan)
                if self._get_ready(stopping):
                    self._loop(stopping)
        finally:
            self._notifier.stopping()
            self._close()

    @property
    def finished(self) -> bool:
        """True if the end of a recording ended the run."""
        return self._finished

    @property
    def follower(self) -> TrackerAdapter:
        """The tracker's adapter; another one after a change of the device."""
        return self._worker.follower

    @property
    def trouble(self) -> str:
        """Reason why the last frames could not be used; empty if they could."""
        return self._worker.trouble

    @property
    def unsent(self) -> Counts:
        """Counts of all frames that will not be sent."""
        return self._outputs.unsent

    @property
    def left_out(self) -> dict[str, int]:
        """Frames that were not tracked, by reason."""
        return {
            "skipped": self._ring.skipped,
            "dropped": self._capture.dropped,
            "damaged": self._worker.damaged,
            "before anything could be tracked": self.follower.untracked,
        }

    @property
    def latency(self) -> tuple[float, float] | None:
        """s from a frame's stamp until its motion was sent: median, 99 %; None without frames."""
        _, latency = self._outputs.status()
        return None if latency is None else (latency.p50, latency.p99)

    # ---- the loop ----

    def _loop(self, stopping: SignalHandler) -> None:
        while not (stopping.asked or self._over):
            arrival = self._ring.take(_TICK)
            self._requests.run(self._commands.handle)
            now = time.monotonic()
            if arrival is not None:
                self._arrivals.add(now)
                try:
                    made = self._worker.work(arrival, colour=self._archive.wants_colour)
                    if made is not None:
                        if self._monitor.state is not State.TRACKING:
                            self._judge(now)  # log the state before anything moves
                        self._pass_on(made, arrival.taken)
                    elif self._worker.untracked is not None:
                        self._archive.look(self._worker.untracked, self.follower)
                finally:
                    self._worker.forget()
                    arrival.raw.release()
            elif self._capture.finished:
                if self._capture.failure is not None:
                    raise self._capture.failure
                self._finished = True
                break
            self._judge(now)
            self._tend(now)
            self._over |= self._outputs.ended

    def _pass_on(self, made: FrameResult, taken: float) -> None:
        """Pass the result of a frame to all subscribers, the pointer first."""
        # where the output has come back since this was judged, the next frame is the first one for it
        self._outputs.give(made.report, taken, self._monitor.state is not State.FAILED_OUTPUT)
        self._counts = plus(self._counts, made.report.counts)
        self._archive.keep(made, self.follower, lambda: minus(self._counts, self.unsent))
        self._show(made, self.follower)
        if self._limit is not None and self._worker.frames >= self._limit:
            self._over = True

    def _judge(self, now: float) -> None:
        """Update the state. Without frames, stop the pointer and the requests that need one."""
        if self._monitor.update(now):
            self._outputs.rest(now)
            self.follower.interrupted(self._monitor.reason)
            self._archive.interrupted(self._monitor.reason)

    def _tend(self, now: float) -> None:
        """Do periodic work: watchdog, files, garbage collection."""
        capture, worker = self._capture, self._worker
        silent = self._arrivals.silent(now)
        self._notifier.progress(("attempts", capture.attempts) if silent else ("frames", worker.seen))
        self._say.flush()
        self._quiet.rest(now)
        if now - self._looked < _EVERY:
            return
        self._looked = now
        self._cpu.look(now)
        worker.look()
        self._endpoints.retry(self._loader.plan.configuration.control, now)
        if worker.trouble and not capture.trouble and now - max(worker.good, self._cured) > _USELESS:
            self._cured = now
            capture.again()
        if self._loader.outdated:
            self._requests.run_now(PendingRequest(Request(command="reload"), quiet=True), self._loader.reload)
        self._archive.tend()

    # ---- beginning and end ----

    def _open_endpoints(self) -> None:
        """Open control socket and metrics, and notify systemd."""
        c = self._loader.plan.configuration
        self._endpoints.open(c.control, c.metrics, self.status)
        removed = tidy(recordings_folder(c.record))
        if removed:
            self._say(f"record: {removed} half-written by a run that was cut off, removed")
        self._notifier.ready()

    def _get_ready(self, stopping: SignalHandler) -> bool:
        """Compile and start the camera. Return False if a stop came before."""
        plan = self._loader.plan
        self._monitor.starting = "the program is made ready"
        self._notifier.patience(_COMPILING)
        self._judge(time.monotonic())
        with held(plan):  # a second daemon fails here
            ready = self._crew.make(READING, lambda: self._setup.make_ready(plan, self._compiled))
            while not ready.wait(_TICK):
                self._requests.run(self._commands.handle)
                self._judge(time.monotonic())
                if stopping.asked or self._over:
                    return False
        self._notifier.usual()
        self._monitor.starting = ""
        self._realtime = plan.configuration.realtime == "auto"
        self._scheduling = realtime.prepare(self._realtime)
        self._quiet = self._stack.enter_context(contextlib.closing(realtime.GcPause()))
        self._claim(self._outputs.pointer.native_id)
        begin(self._capture)
        self._claim(self._capture.native_id)
        self._arrivals.begin()
        return True

    def _tell_left_out(self, plan: Plan) -> None:
        if words := left_out(plan.output):
            self._say(words)

    def _compiled(self, how_far: str) -> None:
        self._monitor.starting = f"the program is made ready: {how_far}"

    def _claim(self, thread: int | None) -> None:
        if self._realtime:
            realtime.claim(thread)

    def _close(self) -> None:
        """Close all parts, the last one first. An error of one does not stop the others."""
        with contextlib.ExitStack() as last:
            last.callback(self._say.flush, end=True)
            last.callback(self._stack.close)
            last.callback(self.follower.close)
            last.callback(self._archive.discard)
            last.callback(self._crew.end, RECORDING, SNAPSHOT, MAP, OUTPUT)  # its results are not used any more
            last.callback(self._archive.close)
            last.callback(self._outputs.close)
            last.callback(self._capture.close)

    def _say_now(self, text: str) -> None:
        self._print(text)
        self._endpoints.publish(text)

    # ---- requests ----

    def _reload(self) -> None:
        self._requests.call(lambda: self._requests.put(PendingRequest(Request(command="reload"))))

    def handle(self, pending: PendingRequest) -> None:
        """Answer a request of the control socket, in its thread, or leave it to the worker."""
        monitor, command = self._monitor, pending.request.command
        if command == "status":
            pending.answer(self.status())
        elif command == "stop":
            self._over = True
            self._ring.wake()
            pending.answer({})
        elif monitor.starting and command not in ("pause", "resume"):
            pending.answer(refused(f"{monitor.state}: {monitor.starting}"))
        else:
            self._requests.put(pending)

    def _pause(self, paused: bool) -> None:
        self._monitor.paused = "by `spheremouse ctl pause`; `resume` ends it" if paused else ""
        if paused:
            self._outputs.pause(True)
        self._judge(time.monotonic())
        if not paused:  # log the state before anything moves
            self._outputs.pause(False)

    def _prepare(self, plan: Plan, changed: list[str]) -> Callable[[], bool]:
        """Prepare another plan for `ConfigReloader`."""
        change = self.follower.prepare(plan, changed)
        if "output" in changed:
            self._outputs.exchange(change.outputs, plan.configuration.pointer)
            self._tell_left_out(plan)
            self._claim(self._outputs.pointer.native_id)
        elif "axes" in changed:
            self._outputs.exchange_others(change.outputs[1:], plan.configuration.pointer)

        def apply() -> bool:
            another = not {"tracker", "motion", "rig", "balls"}.isdisjoint(changed)
            ended = another and self._archive.configuration_changes()
            self._worker.follower = change.apply()
            if "source" in changed:
                self._capture.reopen(self._reopen(plan))
            if "pointer" in changed and "output" not in changed:
                self._outputs.change(plan.configuration.pointer)
            return ended

        return apply

    # ---- the status ----

    def status(self) -> dict[str, Any]:
        """Return the status of docs/control.md, from any thread."""
        now = time.monotonic()
        worker, plan, how = self._worker, self._loader.plan, self._monitor
        output, latency = self._outputs.status()
        return {
            "state": str(how.state),
            "reason": how.reason,
            "since_s": now - how.since,
            "fps": self._arrivals.rate(now),
            "latency_ms": None if latency is None else _ms(latency.p50, latency.p99, latency.max),
            "stages_ms": {name: _ms(*quantiles) for name, quantiles in worker.stages.items()},
            "tracker": plan.configuration.tracker,
            **self.follower.figures(how.state not in (State.STARTING, State.NO_CAMERA)),
            "frames": worker.frames,
            "skipped": self._ring.skipped,
            "dropped": self._capture.dropped,
            "damaged": worker.damaged,
            "counts": list(self._counts),
            "output": {"spec": plan.output, "left_out": left_out(plan.output) or None, **output},
            "source": {"spec": plan.source, "description": self._capture.description},
            "unseen_s": how.unseen,
            "lost_count": worker.lost,
            "camera_restarts": self._capture.restarts,
            "uptime_s": now - self._began,
            "version": __version__,
            "pid": os.getpid(),
            "config": _whole(self._loader.request.file),
            "changes": list(self._loader.request.changes),
            "given": list(given(self._loader.request)),
            "rig": _whole(plan.rig_path),
            "map": _whole(plan.map_path),
            "recording": self._archive.status(),
            "memory_mb": memory_mb(),
            "cpu_share": self._cpu.share,
            "scheduling": self._scheduling,
            "paused": bool(how.paused),
        }


def _whole(path: Path | None) -> str | None:
    """Return the absolute path: clients run in other folders."""
    return None if path is None else str(path.absolute())


def _ms(median: float, slow: float, most: float | None = None) -> dict[str, float]:
    made = {"p50": 1e3 * median, "p99": 1e3 * slow}
    return made if most is None else {**made, "max": 1e3 * most}
