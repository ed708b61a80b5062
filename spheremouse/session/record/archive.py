"""Recordings and snapshots, which threads of the pool write.

If a client disconnects before the recording's first frame, or before the snapshot is written, its request is cancelled.
Later a recording continues without its client.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from spheremouse.errors import ControlError, OutputError, SpheremouseError, internal_error_text
from spheremouse.output import Counts
from spheremouse.session.control.protocol import Record, Snapshot, internal_error, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.control.status import RecordingStatus
from spheremouse.session.overlay.file import write_picture
from spheremouse.session.overlay.pen import Image
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.record.places import FILE, made_folder, next_name, recordings_folder, refuse_full_disk
from spheremouse.session.record.recorder import Recorder
from spheremouse.session.settings import Configuration, RecordSettings
from spheremouse.session.tracker_adapter import FrameResult, Subject, TrackerAdapter
from spheremouse.tracker import Frame

RECORDING, SNAPSHOT = "recording", "snapshot"  # threads of the pool
_CANCELLED = ControlError("given up: the client has disconnected")


class Archive:
    """One recording at a time, and one snapshot. Called by the worker's thread."""

    def __init__(self, workers: WorkerPool, log: Callable[[str], None]) -> None:
        """`log` takes lines for the log, from any thread."""
        self._workers, self._log = workers, log
        self._recorder: Recorder | None = None  # the present or the last one
        self._begun: tuple[PendingRequest, dict[str, Any]] | None = None  # answered at the first frame
        self._ending: PendingRequest | None = None  # answered at the end
        self._bare = False  # the recording has no frame in colour yet
        self._closed = False
        self._wanted: tuple[Path, PendingRequest, RecordSettings] | None = None  # the snapshot of the next frame

    @property
    def wants_colour(self) -> bool:
        """True if the next frame is needed in colour: for a snapshot, and for the targets in a recording."""
        return (self._bare and self._active is not None) or self._wanted is not None

    def keep(self, result: FrameResult, adapter: TrackerAdapter, counts: Callable[[], Counts]) -> None:
        """Copy the image of a tracked frame for recording and snapshot; `counts` returns the sum of the sent counts."""
        self.cancel_abandoned()
        first = result.frame.camera == 0  # a recording is of one camera
        if self._recorder is not None and first and self._recorder.add(result.frame, adapter.subject):
            self._bare &= result.frame.image.ndim != 3
            self._answer_begun()
        self._take_snapshot(lambda everything: adapter.picture(result, counts(), everything))

    def look(self, frame: Frame, adapter: TrackerAdapter) -> None:
        """Copy the image of a frame that was not tracked for a snapshot."""
        self.cancel_abandoned()
        self._take_snapshot(lambda everything: adapter.sight(frame, everything))

    def interrupted(self, reason: str) -> None:
        """Refuse all requests that wait for a frame, since no frames come."""
        self.cancel_abandoned()
        self._answer_begun()  # it begins when they come again
        if self._wanted is not None:
            (_, pending, _), self._wanted = self._wanted, None
            pending.answer(refused(f"there is no picture now: {reason}"))

    def close(self) -> None:
        """End the recording, if there is one."""
        self._closed = True
        if self._recorder is not None:
            self._recorder.stop()

    def cancel_abandoned(self) -> None:
        """Cancel requests without a client that have no frame yet."""
        if self._wanted is not None and self._wanted[1].cancelled:
            (_, pending, _), self._wanted = self._wanted, None
            pending.answer(refused(str(_CANCELLED)))
        if self._begun is not None and self._begun[0].cancelled and self._recorder is not None:
            self._begun = None
            self._recorder.stop()

    # ---- recordings ----

    @property
    def _active(self) -> Recorder | None:
        """The recording that takes frames, or will."""
        return self._recorder if self._recorder is not None and self._recorder.active else None

    def record(
        self, request: Record, c: Configuration, subject: Subject, described: str, pending: PendingRequest
    ) -> None:
        """Begin a recording; `described` is the camera in a line. Raise ControlError if there is one already."""
        if (recorder := self._active) is not None:
            raise ControlError(f"recording into {recorder.status().folder} already; end it with record --stop")
        if self._workers.busy(RECORDING):
            raise ControlError("the recording before this is still being written; ask again when it is done")
        settings = replace(
            c.record,
            seconds=c.record.seconds if request.seconds is None else request.seconds,
            everything=c.record.everything or request.everything,
        )
        places = recordings_folder(settings)
        folder = next_name(places) if request.folder is None else places / request.folder
        kept = "whole pictures" if settings.everything else subject.parts
        words = f"{folder}: recording {kept}, {settings.seconds:g} s at most"
        told = {"folder": str(folder), "seconds": settings.seconds, "message": words}

        def write() -> dict[str, Any]:
            if pending.cancelled:
                raise _CANCELLED
            recorder = Recorder(folder, subject, settings, described)
            self._begun, self._bare, self._ending = (pending, told), True, None
            self._recorder = recorder  # last, since the worker looks at it
            if self._closed:
                recorder.stop()
            try:
                text = recorder.write()
            except SpheremouseError as e:
                if not pending.cancelled:
                    self._log(f"record: {e}")
                raise
            finally:
                self._begun = None
            self._log(f"record: {text}")
            return {"folder": str(folder), "frames": recorder.status().frames, "message": text}

        def answered(reply: dict[str, Any]) -> None:
            pending.answer(reply)  # ignored if the first frame has answered it
            if self._ending is not None:
                self._ending.answer(reply)

        self._workers.submit(RECORDING, lambda: self._run_and_answer(write, answered))

    def _answer_begun(self) -> None:
        begun, self._begun = self._begun, None
        if begun is not None:
            pending, reply = begun
            self._log(f"record: {reply['message']}")
            pending.answer(reply)

    def stop(self, pending: PendingRequest) -> None:
        """End the recording. Raise ControlError if there is none."""
        self._ending = pending  # first, since the recording may be ending
        if (recorder := self._active) is None:
            self._ending = None
            raise ControlError("nothing is being recorded")
        recorder.stop()

    def configuration_changes(self) -> bool:
        """End the recording, since it is of one configuration. Return True if there was one."""
        recorder = self._active
        if recorder is not None:
            recorder.stop()
        return recorder is not None

    def status(self) -> RecordingStatus | None:
        """Return the status of the recording, from any thread; None while nothing is recorded."""
        recorder = self._active
        return None if recorder is None else recorder.status()

    # ---- snapshots ----

    def want_snapshot(self, request: Snapshot, c: Configuration, pending: PendingRequest) -> None:
        """Take a snapshot of the next frame, in colour."""
        places = recordings_folder(c.record)
        path = next_name(places, suffix=".png") if request.file is None else places / request.file
        self._wanted = path, pending, replace(c.record, everything=c.record.everything or request.everything)

    def _take_snapshot(self, picture: Callable[[bool], Callable[[], Image]]) -> None:
        """Draw the requested snapshot, if there is one; `picture` returns the function that draws it."""
        if self._wanted is None:
            return
        (path, pending, settings), self._wanted = self._wanted, None
        draw = picture(settings.everything)

        def write() -> dict[str, Any]:
            if pending.cancelled:
                raise _CANCELLED
            made_folder(path.parent, OutputError)
            refuse_full_disk(path, settings)
            snapshot(path, draw)
            self._log(f"snapshot: {path}")
            return {"file": str(path)}

        self._workers.submit(SNAPSHOT, lambda: self._run_and_answer(write, pending.answer))

    def _run_and_answer(
        self, work: Callable[[], dict[str, Any]], answer: Callable[[dict[str, Any]], None]
    ) -> Callable[[], None]:
        """Do the work, in a thread of the pool, and return the call that answers. An error is answered too."""
        try:
            reply = work()
        except (SpheremouseError, OSError) as e:
            reply = refused(str(e))
        except Exception as e:
            self._log(internal_error_text())
            reply = refused(internal_error(e))
        return partial(answer, reply)


def snapshot(path: Path, draw: Callable[[], Image]) -> Path:
    """Draw a picture and write it. OutputError where the file is there already or cannot be written."""
    if path.exists():
        raise OutputError(f"{path}: is there already; give another name")
    write_picture(path, draw(), FILE)
    return path
