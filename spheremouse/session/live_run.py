"""The parts of a live run: their construction, their common state, a change of the configuration, and the end."""

import contextlib
import math
import time
from collections.abc import Callable

from spheremouse.capture import OpenCamera
from spheremouse.capture.fetch import MAX_FRAME_GAP_S
from spheremouse.capture.newest import LatestFrame
from spheremouse.output.rate_limited_logger import RateLimitedLogger
from spheremouse.output.third_axis import left_out
from spheremouse.session.captures import Captures
from spheremouse.session.config_reloader import READING, ConfigReloader
from spheremouse.session.control.request_queue import RequestQueue
from spheremouse.session.control.server import ControlServer, Handle, open_endpoints
from spheremouse.session.control.status import StatusReport
from spheremouse.session.outputs import OUTPUT, Outputs
from spheremouse.session.picture_feed import PictureFeed
from spheremouse.session.process import realtime
from spheremouse.session.process.notify import Notifier
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.record.archive import RECORDING, SNAPSHOT, Archive
from spheremouse.session.record.places import recordings_folder, tidy
from spheremouse.session.run_config import CommandLineOverrides, RunConfig
from spheremouse.session.run_description import describe_run
from spheremouse.session.setup import Setup
from spheremouse.session.state_monitor import StateMonitor
from spheremouse.session.timing import Arrivals, CpuShare
from spheremouse.session.tracker_adapter import MAP, POSE, TARGETS, TrackerAdapter
from spheremouse.session.worker import Worker

PAUSED = "by `spheremouse ctl pause`; `resume` ends it"


class LiveRun:
    """The parts of a run. The worker's thread calls the methods; other threads may read the attributes."""

    def __init__(
        self,
        overrides: CommandLineOverrides,
        plan: RunConfig,
        setup: Setup,
        camera: Callable[[RunConfig], OpenCamera],
        log: Callable[[str], None],
    ) -> None:
        """Create the parts. They start in `begin` and `start`.

        `camera` returns the function that opens the camera of a plan with one camera. `log` takes lines for the log,
        from any thread.
        """
        self.setup, self._camera, self._print = setup, camera, log
        self.log = RateLimitedLogger(self._log_now)  # from any thread; of each kind one line a second
        self.began = time.monotonic()
        self.ending = False  # the run is to end
        self.cpu = CpuShare()
        self._realtime = plan.configuration.realtime == "auto"
        self.scheduling = "usual scheduling"
        self.notifier = Notifier()
        self.server: ControlServer | None = None
        self._stack = contextlib.ExitStack()
        self.ring = LatestFrame()
        self.requests = RequestQueue(self.ring.wake, self.log)
        call = self.requests.call
        self.workers = WorkerPool((READING, TARGETS, POSE, MAP, OUTPUT, RECORDING, SNAPSHOT), self.log)
        self.reloader = ConfigReloader(
            overrides, plan, setup, self._prepare, workers=self.workers, call=call, log=self.log
        )
        self.archive = Archive(self.workers, self.log)
        self.pictures = PictureFeed(self.log)
        patience = MAX_FRAME_GAP_S if setup.replay is None else math.inf  # its user may pause it
        self.captures = Captures(map(camera, plan.cameras), self.ring, self.log, patience)
        self.arrivals = Arrivals(patience)
        self.worker = Worker(setup.adapter(plan, self.log, self.workers.submit), self.log, len(plan.cameras))
        self.outputs = Outputs(
            plan.outputs,
            plan.configuration.pointer,
            log=self.log,
            workers=self.workers,
            call=call,
            describe_run=lambda: describe_run(self.reloader.plan, self.captures.first.description),
            claim=lambda: self._claim(0),
        )
        self.monitor = StateMonitor(
            self.worker, self.captures, self.arrivals, self.outputs, log=self.log, notify=self.notifier.status
        )

    @property
    def adapter(self) -> TrackerAdapter:
        """The tracker's adapter. A change of rig or balls replaces it."""
        return self.worker.adapter

    @property
    def left_out(self) -> dict[str, int]:
        """Frames that were not tracked, by reason."""
        return {
            "skipped": self.ring.skipped,
            "dropped": self.captures.dropped,
            "damaged": self.worker.damaged,
            "before anything could be tracked": self.adapter.untracked,
        }

    @property
    def latency(self) -> tuple[float, float] | None:
        """s from a frame's stamp until its motion was sent: median, 99 %; None without frames."""
        latency = self.outputs.main.thread.status().latency
        return None if latency is None else (latency.p50, latency.p99)

    def begin(self, handle: Handle, status: Callable[[], StatusReport]) -> None:
        """Start the threads, open control socket, metrics and outputs, and notify systemd.

        `handle` answers requests, and `status` returns the status, from any thread.
        """
        self.workers.begin()
        plan = self.reloader.plan
        # first, since a daemon that is refused there has opened no output
        self.server = open_endpoints(
            self._stack, plan.configuration, handle, status, log=self.log, claim=lambda: self._claim(0)
        )
        if removed := tidy(recordings_folder(plan.configuration.record)):
            self.log(f"record: {removed} half-written by a run that was cut off, removed")
        self.notifier.send("READY=1")
        self.outputs.begin()
        self._log_left_out(plan)
        if plan.notice:
            self.log(plan.notice)
        self.update_state(time.monotonic())

    def start(self) -> realtime.GcPause:
        """Request real-time scheduling, and start the camera. Return the pause of Python's garbage collection."""
        self.monitor.starting = ""
        self.scheduling = realtime.prepare(self._realtime)
        pause = self._stack.enter_context(contextlib.closing(realtime.GcPause()))
        self.captures.start(self._claim)
        self.arrivals.begin()
        return pause

    def update_state(self, now: float) -> None:
        """Update the state. Without frames, stop the pointer and the requests that need one."""
        if self.setup.replay is not None:  # it also pauses itself, at its end and for a step
            self.monitor.paused = PAUSED if self.setup.replay.paused else ""
        if self.monitor.update(now):
            self.outputs.end_prediction(now)
            self.adapter.interrupted(self.monitor.reason)
            self.archive.interrupted(self.monitor.reason)

    def trouble_of(self, camera: int) -> str:
        """Return the reason why a camera takes no part in tracking; empty if it does."""
        refused = self.worker.refused.get(camera, "")
        return self.captures.trouble_of(camera) or refused or self.adapter.trouble_of(camera)

    def close(self) -> None:
        """Close the camera, outputs and all other parts, in the reverse order of the callbacks.

        An error of one does not stop the others, and is raised at the end. Workers finish writing files and opening
        outputs; the results of other work are not used any more.
        """
        with contextlib.ExitStack() as closing:
            closing.callback(self.log.flush, end=True)
            closing.callback(self._stack.close)
            closing.callback(self.adapter.close)
            closing.callback(self.workers.end, RECORDING, SNAPSHOT, MAP, OUTPUT)
            closing.callback(self.archive.close)
            closing.callback(self.pictures.refuse_late, math.inf, "the run ends")
            closing.callback(self.outputs.close)
            closing.callback(self.captures.close)

    # ---- within ----

    def _prepare(self, plan: RunConfig, changed: list[str]) -> Callable[[], bool]:
        """Prepare another plan for `ConfigReloader`."""
        change = self.adapter.prepare(plan, changed)
        if "output" in changed:
            self.outputs.exchange(plan.outputs, plan.configuration.pointer)
            self._log_left_out(plan)

        def apply() -> bool:
            another = not {"tracker", "rig", "balls"}.isdisjoint(changed)
            ended = another and self.archive.configuration_changes()
            self.worker.adapter = change()
            if "source" in changed:
                for capture, each in zip(self.captures.each, plan.cameras, strict=True):
                    capture.reopen_with(self._camera(each))
            if "pointer" in changed and "output" not in changed:
                self.outputs.change(plan.configuration.pointer)
            return ended

        return apply

    def _log_left_out(self, plan: RunConfig) -> None:
        for notice in filter(None, map(left_out, plan.outputs)):
            self.log(str(notice))

    def _log_now(self, text: str) -> None:
        self._print(text)
        if self.server is not None:
            self.server.publish({"event": "log", "text": text})

    def _claim(self, thread: int | None) -> None:
        """Request real-time scheduling for a thread, if it is configured."""
        if self._realtime:
            realtime.claim(thread)
