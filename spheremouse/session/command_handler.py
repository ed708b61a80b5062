"""What the worker does about each request that waited at the desk, until it is answered."""

from collections.abc import Callable
from functools import partial

from spheremouse.errors import ControlError
from spheremouse.session.config_reloader import ConfigReloader
from spheremouse.session.control.protocol import Record, Set, Snapshot, refused
from spheremouse.session.control.request_queue import Asked
from spheremouse.session.follower import POSE
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.record.archive import Archive
from spheremouse.session.state_monitor import StateMonitor
from spheremouse.session.states import State
from spheremouse.session.worker import Worker


class CommandHandler:
    """Called by the worker's thread."""

    def __init__(
        self,
        worker: Worker,
        judgement: StateMonitor,
        loader: ConfigReloader,
        archive: Archive,
        crew: WorkerPool,
        *,
        pause: Callable[[bool], None],
        camera: Callable[[], str],
        say: Callable[[str], None],
    ) -> None:
        """`pause` begins or ends it; `camera` describes the camera in a line; `say` takes lines for the log."""
        self._worker, self._judgement, self._loader = worker, judgement, loader
        self._archive, self._crew = archive, crew
        self._pause, self._camera, self._say = pause, camera, say

    def answer(self, asked: Asked) -> None:
        """Now, or when the crew has done its part; ControlError where it is refused."""
        request = asked.request
        if isinstance(request, Set):
            self._loader.set(request.assignments, asked)
        elif isinstance(request, Record):
            self._record(request, asked)
        elif isinstance(request, Snapshot):
            if self._judgement.state is State.NO_CAMERA and not self._pictures_come():
                raise self._no_picture()
            self._archive.want_snapshot(request, self._loader.plan.configuration, asked)
        elif request.command == "reload":
            self._loader.reload(asked)
        elif request.command == "reinit":
            self._estimate(asked)
        else:
            self._pause(request.command == "pause")
            asked({"state": str(self._judgement.state)})

    def _record(self, request: Record, asked: Asked) -> None:
        subject = self._worker.follower.subject
        if request.stop:
            self._archive.stop(asked)
        elif subject is None:
            raise ControlError(f"nothing to record before the camera's pose is known: {self._judgement.reason}")
        else:
            c = self._loader.plan.configuration
            self._archive.record(request, c, subject, self._camera(), asked)

    def _estimate(self, asked: Asked) -> None:
        """The camera's pose anew, by the crew: what was begun is given up when who asked has hung up."""
        if self._judgement.state is State.NO_CAMERA:
            raise self._no_picture()
        if self._crew.busy(POSE):
            raise ControlError("the camera's pose is being estimated already, for one who has hung up; ask again")
        self._worker.follower.reinitialise(partial(self._told_pose, asked), lambda: not asked.gone)

    def _told_pose(self, asked: Asked, error: str | None, text: str) -> None:
        if error is None:
            self._say(text)
            asked({"message": text})
        else:
            self._say(f"camera pose: {error}")
            asked(refused(error))

    def _pictures_come(self) -> bool:
        """Where there is `no camera`: do frames come that are of no use but to be looked at?"""
        return self._worker.unfit and self._judgement.reason == self._worker.trouble

    def _no_picture(self) -> ControlError:
        return ControlError(f"there is no picture now: {self._judgement.state}: {self._judgement.reason}")
