"""The requests of the control socket: answered at once, or by the worker between two frames."""

import time
from functools import partial

from spheremouse.capture.replay import Controls
from spheremouse.errors import ControlError
from spheremouse.session.config_reloader import settings_in_use
from spheremouse.session.control.protocol import Pictures, Profile, Record, Replay, Save, Set, Snapshot, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.control.status import State
from spheremouse.session.live_run import PAUSED, LiveRun
from spheremouse.session.run_status import status_of
from spheremouse.session.tracker_adapter import POSE


class CommandHandler:
    """Answers the requests for a run."""

    def __init__(self, run: LiveRun) -> None:
        self._run = run

    def receive(self, pending: PendingRequest) -> None:
        """Answer a request in the thread of the control socket, or leave it to the worker."""
        run, command = self._run, pending.request.command
        if command == "status":
            pending.answer(status_of(run).as_json())
        elif command == "settings":
            overrides, plan = run.reloader.overrides, run.reloader.plan
            pending.answer({"settings": settings_in_use(overrides, plan), "changes": list(overrides.changes)})
        elif command == "scene":
            pending.answer(run.adapter.scene())
        elif command == "stop":
            run.ending = True
            run.ring.wake()
            pending.answer({})
        elif isinstance(pending.request, Pictures):
            camera = run.adapter.camera
            ring = run.pictures.lease(time.monotonic(), pending.request.interval, (camera.width, camera.height))
            pending.answer({"slots": ring.slots, "slot_bytes": ring.slot_bytes, "ring": ring})
        elif run.monitor.starting and command not in ("pause", "resume"):
            pending.answer(refused(f"{run.monitor.state}: {run.monitor.starting}"))
        else:
            run.requests.put(pending)

    def handle(self, pending: PendingRequest) -> None:
        """Answer a request in the worker's thread, at once or when a thread of the pool has done its part."""
        run, request = self._run, pending.request
        if isinstance(request, Set):
            run.reloader.set(request.assignments, pending)
        elif isinstance(request, Profile):
            run.reloader.profile(request.name, pending)
        elif isinstance(request, Save):
            run.reloader.save(request, pending)
        elif isinstance(request, Record):
            self._record(request, pending)
        elif isinstance(request, Snapshot):
            frames_arrive = run.worker.unfit and run.monitor.reason == run.worker.trouble
            if not frames_arrive:
                self._refuse_without_camera()
            run.archive.want_snapshot(request, run.reloader.plan.configuration, pending)
        elif isinstance(request, Replay):
            self._control_replay(request)
            pending.answer({})
        elif request.command == "reload":
            run.reloader.reload(pending)
        elif request.command == "reinit":
            self._estimate_pose(pending)
        else:
            self._pause(request.command == "pause")
            pending.answer({"state": str(run.monitor.state)})

    def _record(self, request: Record, pending: PendingRequest) -> None:
        """Begin or end a recording. Raises ControlError before the pose is known."""
        run, subject = self._run, self._run.adapter.subject
        if request.stop:
            run.archive.stop(pending)
        elif subject is None:
            raise ControlError(f"nothing to record before the camera's pose is known: {run.monitor.reason}")
        else:
            camera = run.captures.first.description
            run.archive.record(request, run.reloader.plan.configuration, subject, camera, pending)

    def _estimate_pose(self, pending: PendingRequest) -> None:
        """Estimate the camera's pose again, in a thread of the pool, until the client disconnects."""
        self._refuse_without_camera()
        if self._run.workers.busy(POSE):
            raise ControlError(
                "the camera's pose is being estimated already, for a client that has disconnected; ask again"
            )
        self._run.adapter.reinitialise(partial(self._answer_pose, pending), lambda: not pending.cancelled)

    def _answer_pose(self, pending: PendingRequest, error: str | None, text: str) -> None:
        self._run.log(text if error is None else f"camera pose: {error}")
        pending.answer({"message": text} if error is None else refused(error))

    def _refuse_without_camera(self) -> None:
        monitor = self._run.monitor
        if monitor.state is State.NO_CAMERA:
            raise ControlError(f"there is no picture now: {monitor.state}: {monitor.reason}")

    def _control_replay(self, request: Replay) -> None:
        replay = self._run.setup.replay
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
        run = self._run
        if run.setup.replay is not None:
            run.setup.replay.set_paused(paused)
        else:
            run.monitor.paused = PAUSED if paused else ""
            if paused:
                run.outputs.set_paused(True)
        run.update_state(time.monotonic())
        if not paused:
            run.outputs.set_paused(False)
