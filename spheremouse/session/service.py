"""The daemon: capture, worker, outputs and control socket of one run.

The loop in `Daemon.run` is the worker's thread. It takes the newest frame, tracks it, and handles requests between two
frames. It waits only for the next frame.
"""

import contextlib
import math
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from spheremouse import __version__
from spheremouse.capture import OpenCamera
from spheremouse.capture.fetch import MAX_FRAME_GAP_S
from spheremouse.capture.newest import Arrival, LatestFrame
from spheremouse.capture.replay import Controls
from spheremouse.capture.replay import Replay as PlayedRecording
from spheremouse.capture.signals import SignalHandler, on_hang_up
from spheremouse.errors import ControlError
from spheremouse.output import Counts, Report, report_of
from spheremouse.output.pointer import minus
from spheremouse.output.rate_limited_logger import RateLimitedLogger
from spheremouse.output.reporter import ReporterStatus
from spheremouse.output.third_axis import left_out
from spheremouse.session.captures import Captures
from spheremouse.session.config_reloader import READING, ConfigReloader, given, settings_in_use
from spheremouse.session.control.protocol import (
    Pictures,
    Profile,
    Record,
    Replay,
    Request,
    Save,
    Set,
    Snapshot,
    refused,
)
from spheremouse.session.control.request_queue import PendingRequest, RequestQueue
from spheremouse.session.control.server import ControlServer, open_endpoints
from spheremouse.session.control.status import (
    CameraStatus,
    OutputStatus,
    Quantiles,
    ReplayStatus,
    SourceStatus,
    State,
    StatusReport,
)
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
from spheremouse.session.timing import NEXT_FRAME_S, Arrivals, CpuShare, SleepMonitor, memory_mb
from spheremouse.session.tracker_adapter import MAP, POSE, TARGETS, FrameResult, TrackerAdapter
from spheremouse.session.worker import Worker

_MAX_FRAME_WAIT_S = 0.25  # s; the longest wait for a frame
_REQUEST_TIME_S = 0.005  # s; `set` takes 1 to 2 ms
_CHECK_INTERVAL_S = 1.0  # s between two checks of the files, and of the memory and processor in use
_PAUSED = "by `spheremouse ctl pause`; `resume` ends it"
_MAX_UNUSABLE_S = 5.0  # s of frames that cannot be used, after which the daemon opens the camera again

Show = Callable[[FrameResult, Report, TrackerAdapter], None]


class Daemon:
    """One run. `run` releases everything at its end."""

    def __init__(
        self,
        overrides: CommandLineOverrides,
        plan: RunConfig,
        setup: Setup,
        camera: Callable[[RunConfig], OpenCamera],
        *,
        log: Callable[[str], None],
        show: Show = lambda _, __, ___: None,
        frames: int | None = None,
    ) -> None:
        """`camera` returns the function that opens the camera of a plan with one camera.

        `log` takes lines for the log, from any thread; `show` sees each tracked frame; `frames` ends the run after so
        many of them.
        """
        self._setup, self._camera, self._print, self._show, self._limit = setup, camera, log, show, frames
        self._log = RateLimitedLogger(self._log_now)  # from any thread; of each kind one line a second
        self._began = self._checked_at = self._reopened_at = time.monotonic()
        self._ending = self._finished = False
        self._cpu = CpuShare()
        self._realtime = plan.configuration.realtime == "auto"
        self._scheduling = "usual scheduling"
        self._notifier = Notifier()
        self._server: ControlServer | None = None
        self._stack = contextlib.ExitStack()
        self._ring = LatestFrame()
        self._requests = RequestQueue(self._ring.wake, self._log)
        call = self._requests.call
        self._workers = WorkerPool((READING, TARGETS, POSE, MAP, OUTPUT, RECORDING, SNAPSHOT), self._log)
        self._reloader = ConfigReloader(
            overrides, plan, setup, self._prepare, workers=self._workers, call=call, log=self._log
        )
        self._archive = Archive(self._workers, self._log)
        self._pictures = PictureFeed(self._log)
        patience = MAX_FRAME_GAP_S if setup.replay is None else math.inf  # its user may pause it
        self._captures = Captures(map(camera, plan.cameras), self._ring, self._log, patience)
        self._arrivals = Arrivals(patience)
        adapter = setup.adapter(plan, self._log, self._workers.submit)
        self._worker, self._sleep = Worker(adapter, self._log, len(plan.cameras)), SleepMonitor()
        self._outputs = Outputs(
            plan.outputs,
            plan.configuration.pointer,
            log=self._log,
            workers=self._workers,
            call=call,
            describe_run=lambda: describe_run(self._reloader.plan, self._captures.first.description),
            claim=lambda: self._claim(0),
        )
        self._monitor = StateMonitor(
            self._worker, self._captures, self._arrivals, self._outputs, log=self._log, notify=self._notifier.status
        )

    def run(self, stopping: SignalHandler) -> None:
        """Run until a signal, a `stop` request or the end of a recording."""
        try:
            with on_hang_up(self._reload):  # as other services do
                self._workers.begin()
                self._open_endpoints()  # a daemon that is refused there has opened no output
                self._outputs.begin()
                self._log_left_out(self._reloader.plan)
                if self._reloader.plan.notice:
                    self._log(self._reloader.plan.notice)
                self._update_state(time.monotonic())
                self._start()
                self._loop(stopping)
        finally:
            self._notifier.stopping()
            self._close()

    @property
    def finished(self) -> bool:
        """True if the end of a recording ended the run."""
        return self._finished

    @property
    def adapter(self) -> TrackerAdapter:
        """The tracker's adapter. A change of rig or balls replaces it."""
        return self._worker.adapter

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
            "dropped": self._captures.dropped,
            "damaged": self._worker.damaged,
            "before anything could be tracked": self.adapter.untracked,
        }

    @property
    def latency(self) -> tuple[float, float] | None:
        """s from a frame's stamp until its motion was sent: median, 99 %; None without frames."""
        latency = self._outputs.main.thread.status().latency
        return None if latency is None else (latency.p50, latency.p99)

    # ---- the loop ----

    def _loop(self, stopping: SignalHandler) -> None:
        """Track frames, and run requests when they delay none.

        That is after a frame, well before the next one, if it is late, or after the last.
        """
        now = time.monotonic()
        while not (stopping.asked or self._ending):
            arrival = self._ring.take(NEXT_FRAME_S if self._arrivals.on_time(now) else _MAX_FRAME_WAIT_S)
            now, finished = time.monotonic(), self._captures.finished
            if arrival is not None:
                self._work(arrival, now)
            self._update_state(now)
            frame_overdue = not self._arrivals.on_time(now)
            if arrival is not None or finished or frame_overdue or self._arrivals.time_left(now) > _REQUEST_TIME_S:
                self._requests.run(self._handle)
            if arrival is None and finished:
                if self._captures.failure is not None:
                    raise self._captures.failure
                self._finished = True
                break
            self._do_periodic_work(now)
            self._ending |= self._outputs.ended

    def _work(self, arrival: Arrival, now: float) -> None:
        """Track a frame that arrived at `now` (s, monotonic), and show it."""
        self._arrivals.add(now)
        if slept := self._sleep.slept(now):
            self._log(f"the computer slept for {slept:.0f} s: motion meanwhile is not counted")
            self._outputs.end_prediction(now)
        if slept or self._sleep.is_older(arrival.taken):
            self.adapter.slept()
        replay, waiting = self._setup.replay, self.adapter.waiting
        if replay is not None and replay.is_first(arrival.raw) and not waiting:
            self.adapter.restart("the recording begins")
        shown = arrival.camera == self._captures.main
        try:
            made = self._worker.work(arrival, colour=self._archive.wants_colour)
            if made is not None:
                if self._monitor.state is not State.TRACKING:
                    self._update_state(now)  # log the state before anything moves
                self._publish(made, arrival.taken, shown=shown)
            elif self._worker.untracked is not None and shown:
                self._archive.look(self._worker.untracked, self.adapter)
            if shown:
                self._pictures.show(now, arrival.raw, self.adapter, made)
        finally:
            if replay is not None and waiting and not self.adapter.waiting:
                replay.control(replay.controls, rewind=True)  # to the frames before the pose was known
            self._worker.forget()
            arrival.raw.release()

    def _publish(self, result: FrameResult, taken: float, *, shown: bool) -> None:
        """Pass the result of a frame on, to the outputs first. Those that may block have threads of their own.

        `taken` is the frame's mid-exposure, s of time.monotonic. The latency of the samples ends here; that of the
        status ends when the output has sent. `shown`: it is of the camera whose pictures are kept.
        """
        latency = time.monotonic() - taken
        wall = time.time() - latency
        samples = tuple(replace(sample, wall=wall, latency=latency) for sample in result.samples)
        report = report_of(samples, self.adapter.mapping, result.pointing)
        # `_work` has just updated a state that is not TRACKING. An output that fails later counts its frames as unsent.
        wanted = self._monitor.state is not State.FAILED_OUTPUT
        self._outputs.submit(report, taken, wanted=wanted)
        # Archive and view get the image, too, whose buffer is released after this.
        if shown:
            self._archive.keep(result, self.adapter, lambda: minus(self._outputs.counts, self.unsent))
        self._show(result, report, self.adapter)
        if self._server is not None:
            self._server.submit(report)
        if self._limit is not None and self._worker.frames >= self._limit:
            self._ending = True

    def _update_state(self, now: float) -> None:
        """Update the state. Without frames, stop the pointer and the requests that need one."""
        if self._setup.replay is not None:  # it also pauses itself, at its end and for a step
            self._monitor.paused = _PAUSED if self._setup.replay.paused else ""
        if self._monitor.update(now):
            self._outputs.end_prediction(now)
            self.adapter.interrupted(self._monitor.reason)
            self._archive.interrupted(self._monitor.reason)

    def _do_periodic_work(self, now: float) -> None:
        """Feed the watchdog, flush the log and collect garbage.

        Each second also measure, reopen a camera whose frames are unusable, reload changed files, and drop requests
        whose clients have left.
        """
        captures, worker = self._captures, self._worker
        silent = self._arrivals.silent(now)
        self._notifier.progress(("attempts", captures.attempts) if silent else ("frames", worker.seen))
        self._log.flush()
        self._gc_pause.collect_if_due(now)
        if len(captures.each) > 1:
            captures.log_changes(now, map(self._trouble_of, range(len(captures.each))))
        if now - self._checked_at < _CHECK_INTERVAL_S:
            return
        self._checked_at = now
        self._pictures.expire(now)
        self._cpu.look(now)
        worker.update_stages()
        if (
            worker.trouble
            and not captures.trouble
            and now - max(worker.last_good_at, self._reopened_at) > _MAX_UNUSABLE_S
        ):
            self._reopened_at = now
            captures.reopen()
        if self._reloader.outdated:
            self._requests.run_now(PendingRequest(Request(command="reload"), quiet=True), self._reloader.reload)
        self._archive.cancel_abandoned()

    # ---- beginning and end ----

    def _open_endpoints(self) -> None:
        """Open control socket and metrics, and notify systemd."""
        c = self._reloader.plan.configuration
        self._server = open_endpoints(
            self._stack, c, self.handle, self.status, log=self._log, claim=lambda: self._claim(0)
        )
        removed = tidy(recordings_folder(c.record))
        if removed:
            self._log(f"record: {removed} half-written by a run that was cut off, removed")
        self._notifier.ready()

    def _start(self) -> None:
        """Request real-time scheduling, and start the camera."""
        self._monitor.starting = ""
        self._scheduling = realtime.prepare(self._realtime)
        self._gc_pause = self._stack.enter_context(contextlib.closing(realtime.GcPause()))
        self._captures.start(self._claim)
        self._arrivals.begin()

    def _log_left_out(self, plan: RunConfig) -> None:
        for notice in filter(None, map(left_out, plan.outputs)):
            self._log(str(notice))

    def _claim(self, thread: int | None) -> None:
        """Request real-time scheduling for a thread, if it is configured."""
        if self._realtime:
            realtime.claim(thread)

    def _close(self) -> None:
        """Close the camera, outputs and all other parts, in the reverse order of the callbacks.

        An error of one does not stop the others, and is raised at the end. Workers finish writing files and opening
        outputs; the results of other work are not used any more.
        """
        with contextlib.ExitStack() as closing:
            closing.callback(self._log.flush, end=True)
            closing.callback(self._stack.close)
            closing.callback(self.adapter.close)
            closing.callback(self._workers.end, RECORDING, SNAPSHOT, MAP, OUTPUT)
            closing.callback(self._archive.close)
            closing.callback(self._pictures.close)
            closing.callback(self._outputs.close)
            closing.callback(self._captures.close)

    def _log_now(self, text: str) -> None:
        self._print(text)
        if self._server is not None:
            self._server.publish({"event": "log", "text": text})

    # ---- requests ----

    def _reload(self) -> None:
        self._requests.call(lambda: self._requests.put(PendingRequest(Request(command="reload"))))

    def handle(self, pending: PendingRequest) -> None:
        """Answer a request of the control socket, in its thread, or leave it to the worker."""
        monitor, command = self._monitor, pending.request.command
        if command == "status":
            pending.answer(self.status().as_json())
        elif command == "settings":
            reloader = self._reloader
            settings = settings_in_use(reloader.overrides, reloader.plan)
            pending.answer({"settings": settings, "changes": list(reloader.overrides.changes)})
        elif command == "scene":
            pending.answer(self.adapter.scene())
        elif command == "stop":
            self._ending = True
            self._ring.wake()
            pending.answer({})
        elif isinstance(pending.request, Pictures):
            camera = self.adapter.camera
            ring = self._pictures.lease(time.monotonic(), pending.request.interval, (camera.width, camera.height))
            pending.answer({"slots": ring.slots, "slot_bytes": ring.slot_bytes, "ring": ring})
        elif monitor.starting and command not in ("pause", "resume"):
            pending.answer(refused(f"{monitor.state}: {monitor.starting}"))
        else:
            self._requests.put(pending)

    def _handle(self, pending: PendingRequest) -> None:
        """Answer a request in the worker's thread, at once or when a thread of the pool has done its part."""
        request = pending.request
        if isinstance(request, Set):
            self._reloader.set(request.assignments, pending)
        elif isinstance(request, Profile):
            self._reloader.profile(request.name, pending)
        elif isinstance(request, Save):
            self._reloader.save(request, pending)
        elif isinstance(request, Record):
            self._record(request, pending)
        elif isinstance(request, Snapshot):
            frames_arrive = self._worker.unfit and self._monitor.reason == self._worker.trouble
            if not frames_arrive:
                self._refuse_without_camera()
            self._archive.want_snapshot(request, self._reloader.plan.configuration, pending)
        elif isinstance(request, Replay):
            self._control_replay(request)
            pending.answer({})
        elif request.command == "reload":
            self._reloader.reload(pending)
        elif request.command == "reinit":
            self._estimate_pose(pending)
        else:
            self._pause(request.command == "pause")
            pending.answer({"state": str(self._monitor.state)})

    def _record(self, request: Record, pending: PendingRequest) -> None:
        """Begin or end a recording. Raises ControlError before the pose is known."""
        subject = self.adapter.subject
        if request.stop:
            self._archive.stop(pending)
        elif subject is None:
            raise ControlError(f"nothing to record before the camera's pose is known: {self._monitor.reason}")
        else:
            settings = self._reloader.plan.configuration
            self._archive.record(request, settings, subject, self._captures.first.description, pending)

    def _estimate_pose(self, pending: PendingRequest) -> None:
        """Estimate the camera's pose again, in a thread of the pool, until the client disconnects."""
        self._refuse_without_camera()
        if self._workers.busy(POSE):
            raise ControlError(
                "the camera's pose is being estimated already, for a client that has disconnected; ask again"
            )
        self.adapter.reinitialise(partial(self._answer_pose, pending), lambda: not pending.cancelled)

    def _answer_pose(self, pending: PendingRequest, error: str | None, text: str) -> None:
        self._log(text if error is None else f"camera pose: {error}")
        pending.answer({"message": text} if error is None else refused(error))

    def _refuse_without_camera(self) -> None:
        if self._monitor.state is State.NO_CAMERA:
            raise ControlError(f"there is no picture now: {self._monitor.state}: {self._monitor.reason}")

    def _control_replay(self, request: Replay) -> None:
        replay = self._setup.replay
        if replay is None:
            raise ControlError("this run shows no recording; start one with `spheremouse run --replay`")
        given = {key: value for key in Controls._fields if (value := getattr(request, key)) is not None}
        controls = replay.controls._replace(**given)
        controls = controls._replace(end=controls.end or None)
        if controls.end is not None and controls.end <= controls.begin:
            raise ControlError(f"replay: end: must be above begin, {controls.begin:g} s; 0 is the end of the recording")
        if request.step:
            replay.set_paused(True)
        replay.control(controls, steps=int(request.step), rewind=request.rewind)

    def _pause(self, paused: bool) -> None:
        """Pause or resume the replay, or else the outputs, and log the change of state before anything moves."""
        if self._setup.replay is not None:
            self._setup.replay.set_paused(paused)
        else:
            self._monitor.paused = _PAUSED if paused else ""
            if paused:
                self._outputs.set_paused(True)
        self._update_state(time.monotonic())
        if not paused:  # log the state before anything moves
            self._outputs.set_paused(False)

    def _prepare(self, plan: RunConfig, changed: list[str]) -> Callable[[], bool]:
        """Prepare another plan for `ConfigReloader`."""
        change = self.adapter.prepare(plan, changed)
        if "output" in changed:
            self._outputs.exchange(plan.outputs, plan.configuration.pointer)
            self._log_left_out(plan)

        def apply() -> bool:
            another = not {"tracker", "rig", "balls"}.isdisjoint(changed)
            ended = another and self._archive.configuration_changes()
            self._worker.adapter = change()
            if "source" in changed:
                for capture, each in zip(self._captures.each, plan.cameras, strict=True):
                    capture.reopen_with(self._camera(each))
            if "pointer" in changed and "output" not in changed:
                self._outputs.change(plan.configuration.pointer)
            return ended

        return apply

    # ---- the status ----

    def status(self) -> StatusReport:
        """Return the status, from any thread."""
        now = time.monotonic()
        worker, plan, monitor, overrides = self._worker, self._reloader.plan, self._monitor, self._reloader.overrides
        outputs = [_output_status(spec, status) for spec, status in self._outputs.status()]
        return StatusReport(
            **dict(self.adapter.tracker_status(monitor.state not in (State.STARTING, State.NO_CAMERA))),
            state=str(monitor.state),
            reason=monitor.reason,
            since_s=now - monitor.since,
            fps=self._arrivals.rate(now),
            latency_ms=outputs[0].latency_ms,
            stages_ms={name: _ms(*quantiles) for name, quantiles in worker.stages.items()},
            tracker=plan.configuration.tracker,
            frames=worker.frames,
            skipped=self._ring.skipped,
            dropped=self._captures.dropped,
            damaged=worker.damaged,
            counts=list(self._outputs.counts),
            outputs=outputs,
            source=_source_status(plan, self._captures.first.description, self._setup.replay),
            cameras=self._cameras_status(),
            unseen_s=monitor.unseen,
            lost_count=worker.lost,
            camera_restarts=self._captures.restarts,
            uptime_s=now - self._began,
            version=__version__,
            pid=os.getpid(),
            config=_absolute(overrides.file),
            changes=list(overrides.changes),
            given=list(given(overrides)),
            saved=None if overrides.saved is None else list(plan.saved),
            rig=_absolute(plan.rig_path),
            map=_absolute(plan.map_path),
            recording=self._archive.status(),
            recordings=str(recordings_folder(plan.configuration.record)),
            memory_mb=memory_mb(),
            cpu_share=self._cpu.share,
            scheduling=self._scheduling,
            paused=bool(monitor.paused),
        )

    def _cameras_status(self) -> list[CameraStatus]:
        """Return the status of each camera if there are two; else it is that of the run."""
        captures, plans = self._captures, self._reloader.plan.cameras
        if len(plans) == 1:
            return []
        return [
            CameraStatus(
                spec=plan.source,
                description=captures.each[k].description,
                trouble=self._trouble_of(k),
                rig=_absolute(plan.rig_path),
                frames=self._worker.frames_of[k],
                restarts=captures.each[k].restarts,
                pose=self.adapter.pose_of(k),
            )
            for k, plan in enumerate(plans)
        ]

    def _trouble_of(self, camera: int) -> str:
        """Return the reason why a camera takes no part in tracking; empty if it does."""
        return (
            self._captures.trouble_of(camera) or self._worker.refused.get(camera, "") or self.adapter.trouble_of(camera)
        )


def _output_status(spec: str, status: ReporterStatus) -> OutputStatus:
    latency, notice = status.latency, left_out(spec)
    return OutputStatus(
        spec=spec,
        left_out=None if notice is None else str(notice),
        failed=status.failed,
        reports=status.reports,
        unsent=list(status.unsent),
        ahead=list(status.ahead),
        dropped=status.dropped,
        latency_ms=None if latency is None else _ms(latency.p50, latency.p99, max=1e3 * latency.max),
    )


def _source_status(plan: RunConfig, description: str, replay: PlayedRecording | None) -> SourceStatus:
    if replay is None:
        return SourceStatus(spec=plan.source, description=description)
    shown = ReplayStatus(frame=replay.frame, frames=replay.frames, seconds=replay.seconds, **replay.controls._asdict())
    return SourceStatus(spec=plan.source, description=description, replay=shown)


def _absolute(path: Path | None) -> str | None:
    """Return the absolute path: clients run in other folders."""
    return None if path is None else str(path.absolute())


def _ms(median: float, slow: float, **longest: float) -> Quantiles:
    return Quantiles(p50=1e3 * median, p99=1e3 * slow, **longest)
