"""Recordings and snapshots, which threads of the pool write.

A request whose client has disconnected is cancelled before the recording's first frame and before the snapshot is
written. Later a recording continues without its client.
"""

import contextlib
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from spheremouse.errors import ControlError, OutputError, SpheremouseError
from spheremouse.output.pointer import Counts
from spheremouse.session.control.protocol import Record, Snapshot, internal_error, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.follower import FrameResult, TrackerAdapter
from spheremouse.session.overlay.pen import Image
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.record.places import made_folder, next_name, recordings_folder, refuse_full_disk
from spheremouse.session.record.recorder import Recorder
from spheremouse.session.record.snapshot import snapshot
from spheremouse.session.settings import Configuration
from spheremouse.session.settings.record import RecordSettings
from spheremouse.session.subject import Subject
from spheremouse.tracker import Frame

RECORDING, SNAPSHOT = "recording", "snapshot"  # threads of the pool
_CANCELLED = ControlError("given up: the client has disconnected")


class Archive:
    """One recording at a time, and one snapshot. Called by the worker's thread."""

    def __init__(
        self,
        crew: WorkerPool,
        ask: Callable[[Callable[[], None]], None],
        say: Callable[[str], None],
    ) -> None:
        """`ask` has something done in the worker's thread; `say` takes lines for the log, from any thread."""
        self._crew, self._ask, self._say = crew, ask, say
        self._recorder: Recorder | None = None
        self._made: Recorder | None = None  # by the crew, and not taken over yet
        self._begun: tuple[PendingRequest, dict[str, Any]] | None = None  # answered at the first frame
        self._bare = False  # the recording has no frame in colour yet
        self._wanted: tuple[Path, PendingRequest, RecordSettings] | None = None  # the snapshot of the next frame

    @property
    def wants_colour(self) -> bool:
        """Is the next frame needed in colour? A snapshot is; and what tracks a recording needs the targets' colours."""
        return self._bare or self._wanted is not None

    def keep(self, made: FrameResult, follower: TrackerAdapter, counts: Callable[[], Counts]) -> None:
        """A tracked frame, for all that want it, and the counts sent with it; its image is copied."""
        self._give_up()
        if self._recorder is not None and self._recorder.add(made.frame, follower.subject):
            self._bare &= made.frame.image.ndim != 3
            self._tell_first()
        self._take_snapshot(lambda everything: follower.picture(made, counts(), everything))

    def look(self, frame: Frame, follower: TrackerAdapter) -> None:
        """A frame that was not tracked; its image is copied."""
        self._give_up()
        self._take_snapshot(lambda everything: follower.sight(frame, everything))

    def interrupted(self, reason: str) -> None:
        """Refuse all requests that wait for a frame, since no frames come."""
        self._give_up()
        self._tell_first()  # it begins when they come again
        if self._wanted is not None:
            (_, pending, _), self._wanted = self._wanted, None
            pending.answer(refused(f"there is no picture now: {reason}"))

    def tend(self) -> None:
        """End a recording that has reached its bounds."""
        self._give_up()
        if self._recorder is not None and self._recorder.status().ended is not None:
            self._end()

    def close(self) -> None:
        """End what is being recorded."""
        if self._recorder is not None:
            self._end()

    def discard(self) -> None:
        """Once nothing is written any more: what was begun too late for a frame."""
        if self._made is not None:
            with contextlib.suppress(SpheremouseError):
                self._made.finish(1.0)

    def _give_up(self) -> None:
        """Cancel requests without a client that have no frame yet."""
        if self._wanted is not None and self._wanted[1].cancelled:
            (_, pending, _), self._wanted = self._wanted, None
            pending.answer(refused(str(_CANCELLED)))
        if self._begun is not None and self._begun[0].cancelled and self._recorder is not None:
            (pending, _), self._begun = self._begun, None
            recorder, self._recorder, self._bare = self._recorder, None, False
            self._drop(recorder, pending)

    # ---- recordings ----

    def record(
        self, request: Record, c: Configuration, subject: Subject, described: str, pending: PendingRequest
    ) -> None:
        """Begin a recording; `described` is the camera in a line.

        ControlError where one is being made.
        """
        if self._recorder is not None:
            raise ControlError(f"recording into {self._recorder.status().folder} already; end it with record --stop")
        if self._crew.busy(RECORDING):
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

        def begin() -> None:
            if pending.cancelled:
                raise _CANCELLED
            self._made = Recorder(folder, subject, settings, described)
            self._ask(lambda: self._has_begun(told, pending))

        self._crew.do(RECORDING, lambda: self._answer(pending, begin))

    def _has_begun(self, told: dict[str, Any], pending: PendingRequest) -> None:
        recorder, self._made = self._made, None
        assert recorder is not None
        if pending.cancelled:
            self._drop(recorder, pending)
            return
        self._recorder, self._bare, self._begun = recorder, True, (pending, told)

    def _drop(self, recorder: Recorder, pending: PendingRequest) -> None:
        """A recording without a frame, of which nothing is left."""
        recorder.stop()

        def finish() -> None:
            with contextlib.suppress(SpheremouseError):  # it has no frame, and says so
                recorder.finish()
            raise _CANCELLED

        self._crew.do(RECORDING, lambda: self._answer(pending, finish))

    def _tell_first(self) -> None:
        if self._begun is not None:
            (pending, told), self._begun = self._begun, None
            self._say(f"record: {told['message']}")
            pending.answer(told)

    def stop(self, pending: PendingRequest) -> None:
        """End the recording. ControlError where there is none."""
        if self._recorder is None:
            raise ControlError("nothing is being recorded")
        self._end(pending)

    def configuration_changes(self) -> bool:
        """End what is being recorded, for a recording is of one configuration; whether there was one."""
        if self._recorder is None:
            return False
        self._end()
        return True

    def _end(self, pending: PendingRequest | None = None) -> None:
        recorder, self._recorder, self._bare = self._recorder, None, False
        assert recorder is not None
        self._tell_first()
        recorder.stop()

        def finish() -> dict[str, Any]:
            try:
                path = recorder.finish()
            except SpheremouseError as e:
                self._say(f"record: {e}")
                raise
            status = recorder.status()
            self._say(f"record: {status.ended}")
            return {"folder": str(path), "frames": status.frames, "message": status.ended}

        self._crew.do(RECORDING, lambda: self._answer(pending, finish))

    def status(self) -> dict[str, Any] | None:
        """Return the status of the recording, from any thread."""
        recorder = self._recorder
        if recorder is None:
            return None
        s = recorder.status()
        return {
            "folder": str(s.folder), "frames": s.frames, "seconds": s.seconds, "bytes": s.bytes, "dropped": s.dropped,
        }  # fmt: skip

    # ---- snapshots ----

    def want_snapshot(self, request: Snapshot, c: Configuration, pending: PendingRequest) -> None:
        """Take a snapshot of the next frame, in colour."""
        places = recordings_folder(c.record)
        path = next_name(places, suffix=".png") if request.file is None else places / request.file
        self._wanted = path, pending, replace(c.record, everything=c.record.everything or request.everything)

    def _take_snapshot(self, picture: Callable[[bool], Callable[[], Image]]) -> None:
        """The one that is wanted; `picture` gives what draws it, with everything in it or not."""
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
            self._say(f"snapshot: {path}")
            return {"file": str(path)}

        self._crew.do(SNAPSHOT, lambda: self._answer(pending, write))

    def _answer(
        self, pending: PendingRequest | None, work: Callable[[], dict[str, Any] | None]
    ) -> Callable[[], None] | None:
        """Do the work, in a thread of the pool, and return the call that answers. An error is answered too."""
        try:
            reply = work()
        except (SpheremouseError, OSError) as e:
            reply = refused(str(e))
        except Exception as e:
            self._say("internal error, please report it:\n" + traceback.format_exc().rstrip())
            reply = refused(internal_error(e))
        return None if reply is None or pending is None else partial(pending.answer, reply)
