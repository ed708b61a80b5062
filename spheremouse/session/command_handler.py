"""The requests of the control socket: answered at once, or by the worker between two frames."""

import time

from spheremouse.capture.replay import Controls
from spheremouse.errors import ControlError
from spheremouse.session.config_reloader import settings_in_use
from spheremouse.session.control.protocol import Profile, Record, Replay, Save, Set, Snapshot, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.control.status import State
from spheremouse.session.live_run import PAUSED, LiveRun
from spheremouse.session.run_status import status_of
from spheremouse.session.tracker_adapter import POSE


def receive(run: LiveRun, pending: PendingRequest) -> None:
    """Answer a request in the thread of the control socket, or leave it to the worker."""
    request, monitor = pending.request, run.monitor
    if request.command == "status":
        pending.answer(status_of(run).as_json())
    elif request.command == "settings":
        overrides, plan = run.reloader.overrides, run.reloader.plan
        pending.answer({"settings": settings_in_use(overrides, plan), "changes": list(overrides.changes)})
    elif request.command == "scene":
        pending.answer(run.adapter.scene())
    elif request.command == "picture":
        run.pictures.request(time.monotonic(), pending)
    elif request.command == "stop":
        run.ending = True
        run.ring.wake()
        pending.answer({})
    elif monitor.starting and request.command not in ("pause", "resume"):
        pending.answer(refused(f"{monitor.state}: {monitor.starting}"))
    else:
        run.requests.put(pending)


def handle(run: LiveRun, pending: PendingRequest) -> None:
    """Answer a request in the worker's thread, at once or when a thread of the pool has done its part."""
    request = pending.request
    if isinstance(request, Set):
        run.reloader.set(request.assignments, pending)
    elif isinstance(request, Profile):
        run.reloader.profile(request.name, pending)
    elif isinstance(request, Save):
        run.reloader.save(request, pending)
    elif isinstance(request, Record):
        _record(run, request, pending)
    elif isinstance(request, Snapshot):
        frames_arrive = run.worker.unfit and run.monitor.reason == run.worker.trouble
        if not frames_arrive:
            _refuse_without_camera(run)
        run.archive.want_snapshot(request, run.reloader.plan.configuration, pending)
    elif isinstance(request, Replay):
        _control_replay(run, request)
        pending.answer({})
    elif request.command == "reload":
        run.reloader.reload(pending)
    elif request.command == "reinit":
        _estimate_pose(run, pending)
    else:
        _pause(run, request.command == "pause")
        pending.answer({"state": str(run.monitor.state)})


def _record(run: LiveRun, request: Record, pending: PendingRequest) -> None:
    """Begin or end a recording. Raises ControlError before the pose is known."""
    subject = run.adapter.subject
    if request.stop:
        run.archive.stop(pending)
    elif subject is None:
        raise ControlError(f"nothing to record before the camera's pose is known: {run.monitor.reason}")
    else:
        settings, camera = run.reloader.plan.configuration, run.captures.first.description
        run.archive.record(request, settings, subject, camera, pending)


def _estimate_pose(run: LiveRun, pending: PendingRequest) -> None:
    """Estimate the camera's pose again, in a thread of the pool, until the client disconnects."""
    _refuse_without_camera(run)
    if run.workers.busy(POSE):
        problem = "the camera's pose is being estimated already, for a client that has disconnected"
        raise ControlError(problem, "ask again")

    def answer(error: str | None, text: str) -> None:
        run.log(text if error is None else f"camera pose: {error}")
        pending.answer({"message": text} if error is None else refused(error))

    run.adapter.reinitialise(answer, lambda: not pending.cancelled)


def _refuse_without_camera(run: LiveRun) -> None:
    if run.monitor.state is State.NO_CAMERA:
        raise ControlError(f"there is no picture now: {run.monitor.state}: {run.monitor.reason}")


def _control_replay(run: LiveRun, request: Replay) -> None:
    replay = run.setup.replay
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


def _pause(run: LiveRun, paused: bool) -> None:
    """Pause or resume the replay, or else the outputs, and log the change of state before anything moves."""
    if run.setup.replay is not None:
        run.setup.replay.set_paused(paused)
    else:
        run.monitor.paused = PAUSED if paused else ""
        if paused:
            run.outputs.set_paused(True)
    run.update_state(time.monotonic())
    if not paused:
        run.outputs.set_paused(False)
