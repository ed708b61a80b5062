"""Requests of the control socket, handled by the worker's thread."""

from collections.abc import Callable
from functools import partial

from spheremouse.errors import ControlError
from spheremouse.session.config_reloader import ConfigReloader
from spheremouse.session.control.protocol import Record, Set, Snapshot, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.follower import POSE
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.record.archive import Archive
from spheremouse.session.state_monitor import StateMonitor
from spheremouse.session.states import State
from spheremouse.session.worker import Worker


class CommandHandler:
    """Answers each request, at once or when a thread of the pool has done its part."""

    def __init__(
        self,
        worker: Worker,
        monitor: StateMonitor,
        reloader: ConfigReloader,
        archive: Archive,
        workers: WorkerPool,
        *,
        pause: Callable[[bool], None],
        camera: Callable[[], str],
        log: Callable[[str], None],
    ) -> None:
        """`pause(True)` begins a pause, `pause(False)` ends it; `camera` describes the camera in a line."""
        self._worker, self._monitor, self._reloader = worker, monitor, reloader
        self._archive, self._workers = archive, workers
        self._pause, self._camera, self._log = pause, camera, log

    def handle(self, pending: PendingRequest) -> None:
        """Answer a request; ControlError refuses it."""
        request = pending.request
        if isinstance(request, Set):
            self._reloader.set(request.assignments, pending)
        elif isinstance(request, Record):
            self._record(request, pending)
        elif isinstance(request, Snapshot):
            if self._monitor.state is State.NO_CAMERA and not self._frames_arrive():
                raise self._no_picture()
            self._archive.want_snapshot(request, self._reloader.plan.configuration, pending)
        elif request.command == "reload":
            self._reloader.reload(pending)
        elif request.command == "reinit":
            self._estimate(pending)
        else:
            self._pause(request.command == "pause")
            pending.answer({"state": str(self._monitor.state)})

    def _record(self, request: Record, pending: PendingRequest) -> None:
        subject = self._worker.follower.subject
        if request.stop:
            self._archive.stop(pending)
        elif subject is None:
            raise ControlError(f"nothing to record before the camera's pose is known: {self._monitor.reason}")
        else:
            c = self._reloader.plan.configuration
            self._archive.record(request, c, subject, self._camera(), pending)

    def _estimate(self, pending: PendingRequest) -> None:
        """Estimate the camera's pose again, in a thread of the pool, until the client disconnects."""
        if self._monitor.state is State.NO_CAMERA:
            raise self._no_picture()
        if self._workers.busy(POSE):
            raise ControlError(
                "the camera's pose is being estimated already, for a client that has disconnected; ask again"
            )
        self._worker.follower.reinitialise(partial(self._answer_pose, pending), lambda: not pending.cancelled)

    def _answer_pose(self, pending: PendingRequest, error: str | None, text: str) -> None:
        if error is None:
            self._log(text)
            pending.answer({"message": text})
        else:
            self._log(f"camera pose: {error}")
            pending.answer(refused(error))

    def _frames_arrive(self) -> bool:
        """Return True if frames arrive in the state `no-camera`: a snapshot can show them."""
        return self._worker.unfit and self._monitor.reason == self._worker.trouble

    def _no_picture(self) -> ControlError:
        return ControlError(f"there is no picture now: {self._monitor.state}: {self._monitor.reason}")
