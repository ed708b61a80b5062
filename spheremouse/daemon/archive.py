"""What is kept of the pictures when somebody asks for it: recordings and snapshots. Written in the background."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from spheremouse import config
from spheremouse.camera import Pose
from spheremouse.daemon.background import Background
from spheremouse.daemon.control import Reply
from spheremouse.daemon.protocol import Record, Snapshot, refused
from spheremouse.daemon.recorder import Recorder, next_name, recordings_folder
from spheremouse.daemon.settings import Configuration
from spheremouse.daemon.snapshot import snapshot
from spheremouse.daemon.worker import Step
from spheremouse.errors import ControlError, SpheremouseError
from spheremouse.rig import Rig
from spheremouse.track import Tracker


class Archive:
    """One recording at a time, and any number of snapshots. Called by the worker's thread."""

    def __init__(
        self,
        background: Background,
        ask: Callable[[Callable[[], None]], None],
        say: Callable[[str], None],
    ) -> None:
        """`ask` has something done in the worker's thread; `say` takes lines for the log, from any thread."""
        self._background, self._ask, self._say = background, ask, say
        self._recorder: Recorder | None = None
        self._first = _nothing  # tells who asked for a recording that it has its first frame
        self._bare = False  # the recording has no frame in colour yet
        self._snapshots: list[tuple[Path, Reply]] = []

    @property
    def wants_colour(self) -> bool:
        """Is the next frame needed in colour? A snapshot is; and what tracks a recording needs the targets' colours."""
        return self._bare or bool(self._snapshots)

    def keep(self, made: Step, tracker: Tracker | None, everything: bool) -> None:
        """A tracked frame, for all that want it; its image is copied. `everything`: snapshots of whole pictures."""
        frame = made.epoch.frame
        if self._recorder is not None and self._recorder.add(frame, None if tracker is None else tracker.pose):
            self._bare &= frame.image.ndim != 3
            self._tell_first()
        if self._snapshots and tracker is not None:
            self._take_snapshots(made, tracker, everything)

    def interrupted(self, reason: str) -> None:
        """No frames come any more: who waits for one is told."""
        self._tell_first()  # it begins when they come again
        waiting, self._snapshots = self._snapshots, []
        for _, reply in waiting:
            reply(refused(f"there is no picture now: {reason}"))

    def tend(self) -> None:
        """End a recording that has reached its bounds."""
        if self._recorder is not None and self._recorder.status().ended is not None:
            self._end(lambda _: None)

    def close(self) -> None:
        """End what is being recorded."""
        if self._recorder is not None:
            self._end(lambda _: None)

    # ---- recordings ----

    def record(self, request: Record, c: Configuration, rig: Rig, pose: Pose, described: str, reply: Reply) -> None:
        """Begin a recording with the rig and the pose in use; `described` is the camera in a line.

        ControlError where one is being made.
        """
        if self._recorder is not None:
            raise ControlError(f"recording into {self._recorder.status().folder} already; end it with record --stop")
        settings = replace(
            c.record,
            seconds=c.record.seconds if request.seconds is None else request.seconds,
            everything=c.record.everything or request.everything,
        )
        places = recordings_folder(settings)
        folder = next_name(places) if request.folder is None else places / request.folder
        kept = "whole pictures" if settings.everything else "the ball and the targets"
        words = f"{folder}: recording {kept}, {settings.seconds:g} s at most"
        told = {"folder": str(folder), "seconds": settings.seconds, "message": words}

        def begin() -> None:
            try:
                recorder = Recorder(
                    folder,
                    rig,
                    pose,
                    settings,
                    described,
                    tracker=c,
                    configuration=config.dump(_of_the_tracker(c), type(c)()),
                )
            except (SpheremouseError, OSError) as e:
                reply(refused(str(e)))
            else:
                self._ask(lambda: self._begun(recorder, told, reply))

        self._background.begin(begin)

    def _begun(self, recorder: Recorder, told: dict[str, Any], reply: Reply) -> None:
        if self._recorder is not None:  # two asked at once
            recorder.stop()
            reply(refused(f"recording into {self._recorder.status().folder} already"))
            return
        self._recorder, self._bare = recorder, True
        self._say(f"record: {told['message']}")
        self._first = lambda: reply(told)

    def _tell_first(self) -> None:
        tell, self._first = self._first, _nothing
        tell()

    def stop(self, reply: Reply) -> None:
        """End the recording. ControlError where there is none."""
        if self._recorder is None:
            raise ControlError("nothing is being recorded")
        self._end(reply)

    def configuration_changes(self) -> None:
        """A recording is of one configuration."""
        if self._recorder is not None:
            self._say("record: ended, for the configuration changes: a recording is of one")
            self._end(lambda _: None)

    def _end(self, reply: Reply) -> None:
        recorder, self._recorder, self._bare = self._recorder, None, False
        assert recorder is not None
        self._tell_first()

        def finish() -> None:
            try:
                path = recorder.finish()
            except SpheremouseError as e:
                self._say(f"record: {e}")
                reply(refused(str(e)))
                return
            status = recorder.status()
            self._say(f"record: {status.ended}")
            reply({"folder": str(path), "frames": status.frames, "message": status.ended})

        self._background.begin(finish)

    def status(self) -> dict[str, Any] | None:
        """Of the recording; from any thread."""
        recorder = self._recorder
        if recorder is None:
            return None
        s = recorder.status()
        return {
            "folder": str(s.folder), "frames": s.frames, "seconds": s.seconds, "bytes": s.bytes, "dropped": s.dropped,
        }  # fmt: skip

    # ---- snapshots ----

    def want_snapshot(self, request: Snapshot, c: Configuration, reply: Reply) -> None:
        """Of the next frame, in colour."""
        places = recordings_folder(c.record)
        path = next_name(places, suffix=".png") if request.file is None else places / request.file
        self._snapshots.append((path, reply))

    def _take_snapshots(self, made: Step, tracker: Tracker, everything: bool) -> None:
        wanted, self._snapshots = self._snapshots, []
        epoch = replace(made.epoch, frame=replace(made.epoch.frame, image=made.epoch.frame.image.copy()))

        def write() -> None:
            for path, reply in wanted:
                try:
                    path.parent.mkdir(parents=True, exist_ok=True)
                    snapshot(path, epoch, tracker, everything=everything)
                except (SpheremouseError, OSError) as e:
                    reply(refused(str(e)))
                else:
                    self._say(f"snapshot: {path}")
                    reply({"file": str(path)})

        self._background.begin(write)


def _of_the_tracker(c: Configuration) -> Configuration:
    """Without what belongs to this computer: its devices, files and doors. A replay brings its own."""
    plain = type(c)()
    return replace(
        c,
        source=None, output=None, rig=None, camera_file=None, map=None,
        control=plain.control, record=plain.record, metrics=plain.metrics,
    )  # fmt: skip


def _nothing() -> None:
    """There is nothing to tell."""
