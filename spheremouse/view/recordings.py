"""Recordings on the page: replays and comparisons of settings.

A replay is a process of its own, which takes the daemon's place on the page. The daemon goes on meanwhile.
"""

import asyncio
import contextlib
from pathlib import Path

from spheremouse.errors import ControlError, printable
from spheremouse.files.exchange import values_of
from spheremouse.files.listing import Listed, list_recordings
from spheremouse.session.control.client import NoDaemonError
from spheremouse.session.process import child
from spheremouse.session.replay import ReplayProcess, options_of
from spheremouse.view.daemon import DaemonLink, Message

_MAX_END_S = 3.0  # s; systemd gives the page 5 s
_MAX_COMPARED = 60.0  # s of a recording


class Recordings:
    """The recordings in the daemon's folder and in the working folder, and the replay of one of them."""

    def __init__(self, daemon: DaemonLink) -> None:
        self._daemon, self._live = daemon, daemon.socket
        self._replay: ReplayProcess | None = None
        self._comparison: asyncio.Task[Message] | None = None  # that is under way
        self._ending: asyncio.Task[str] | None = None  # waits for the end of the last replay

    async def listed(self) -> Message:
        """Return recordings as `Listed`, without paths, and the folders. Raises ControlError if one cannot be read."""
        found = await asyncio.to_thread(self._find)
        recordings = [each._asdict() | {"path": None, "name": name} for name, each in found.items()]
        return {"recordings": recordings, "folders": [str(folder) for folder in self._folders()]}

    async def play(self, name: str) -> str:
        """End the present replay, if there is one, and replay another recording with the settings that the page shows.

        Return a message. Raises ControlError. If the list has no such recording, nothing changes. If the replay ends
        before it is ready, or refuses a setting, the page shows the camera.
        """
        recording, status = await self._recording(name), self._daemon.status or {}
        self.end()
        replay = self._replay = await ReplayProcess.start(recording.path, self._options(recording))
        self._ending = asyncio.create_task(self._await_end(replay))
        try:
            if not await replay.wait_until_ready(status.get("changes") or []):
                raise ControlError(f"{name}: {await self._ending}")
        except BaseException:  # also if the browser has left
            self.end()
            raise
        self._daemon.switch(replay.socket)
        return f"The page plays {name} in place of the camera."

    async def leave(self) -> str:
        """End a comparison and the replay, and set the settings that it had changed in the daemon, as one step of undo.

        Without a daemon they are lost. Raises ControlError if the replay does not answer, or the daemon refuses them.
        """
        self.stop()
        changes = (await self._daemon.ask("status"))["changes"]
        self.end()
        with contextlib.suppress(NoDaemonError):
            present = (await self._daemon.ask("status"))["changes"]
            if new := values_of(change for change in changes if change not in present):
                await self._daemon.set(new, "replay")
        return "The page shows the camera."

    def end(self) -> None:
        """End the replay, and show the camera. Settings changed during the replay are lost."""
        replay, self._replay = self._replay, None
        if replay is not None:
            replay.end()
        self._daemon.switch(self._live)

    async def close(self) -> None:
        """End the replay, and wait until its files are removed, at most 3 s."""
        self.end()
        if self._ending is not None:
            await asyncio.wait([self._ending], timeout=_MAX_END_S)

    async def compare(self, name: str, begin: float = 0.0, end: float | None = None) -> Message:
        """Return reports of `evaluate` by the saved and by the present settings, as `before` and `after`.

        Both are of the section from `begin` to `end`, s, at most 60 s. None or 0 is the end of the recording. The
        reports of hand-held balls are of the whole recording, which can take minutes. Raises ControlError for a longer
        section, an unknown recording, one that cannot be tracked, during another comparison, and after `stop`.
        """
        if self._comparison is not None:
            raise ControlError("compare: another comparison is under way", "wait for it, or stop it")
        self._comparison = asyncio.create_task(self._compared(name, begin, end))
        try:
            return await self._comparison
        except asyncio.CancelledError:
            if (task := asyncio.current_task()) and task.cancelling():  # the browser has left
                raise
            raise ControlError("the comparison was ended before its result") from None
        finally:
            self._comparison = None

    async def _compared(self, name: str, begin: float, end: float | None) -> Message:
        recording = await self._recording(name)
        status = await self._daemon.ask("status") if self._daemon.status else {}  # with a change made just now
        end = min(end or recording.seconds, recording.seconds)
        if end - begin > _MAX_COMPARED and not recording.wand:
            raise ControlError(f"compare: {end - begin:.0f} s; choose a section of at most {_MAX_COMPARED:g} s")
        words = ["evaluate", str(recording.path), "--json", "-", *self._options(recording)]
        words += [] if recording.wand else ["--begin", str(begin), "--end", str(end)]
        changes = [word for change in status.get("changes") or [] for word in ("--set", change)]
        both = [words, [*words, *changes]] if changes else [words]
        before, *after = await child.answers(self._daemon.socket, *both)
        return {"before": before, "after": after[0] if after else before}

    def stop(self) -> str:
        """End the comparison that is under way, if there is one. Return a message."""
        if self._comparison is not None:
            self._comparison.cancel()
        return ""

    async def _await_end(self, replay: ReplayProcess) -> str:
        """Return the last line of a replay that has ended. If it was shown, report the line, and show the camera."""
        reason = await replay.ended()
        if self._daemon.socket == replay.socket:
            self.end()
            self._daemon.publish({"type": "trouble", "id": None, "text": f"the replay has ended: {reason}"})
        return reason

    def _options(self, recording: Listed) -> list[str]:
        return options_of(self._daemon.status or {}, self._daemon.values()["values"], recording)

    def _folders(self) -> list[Path]:
        given = (self._daemon.status or {}).get("recordings")
        return [*([] if given is None else [Path(given)]), Path.cwd()]

    def _find(self) -> dict[str, Listed]:
        return {each.path.name: each for each in list_recordings(self._folders())}

    async def _recording(self, name: str) -> Listed:
        """Return the recording of a name in the list. No other path is opened."""
        found = (await asyncio.to_thread(self._find)).get(name)
        if found is None or found.problem:
            raise ControlError(f"{printable(name)}: {found.problem if found else 'there is no such recording'}")
        return found
