"""A process of its own that replays a recording, with its socket and its log in a private folder."""

import asyncio
import contextlib
import resource
import shutil
import tempfile
from asyncio.subprocess import Process
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from spheremouse.files.config import key_of
from spheremouse.session.control.client import Client, NoDaemonError
from spheremouse.session.process import child

_MAX_BYTES = 2 << 30  # of writable memory, with the stacks of the threads; 0.7 GB on two cores
_POLL_S = 0.1  # s


class ReplayProcess:
    """A replay. Its methods are called in the event loop."""

    def __init__(self, folder: Path, process: Process) -> None:
        """See `start`."""
        self._folder, self._process = folder, process
        self.socket = folder / "s"

    @classmethod
    async def start(cls, recording: Path, options: Sequence[str]) -> Self:
        """Start a replay with further `options` of `spheremouse run`."""
        folder = Path(tempfile.mkdtemp(prefix="spheremouse-replay-"))
        with (folder / "log").open("wb") as log:
            process = await child.start(
                *(None, "run", "--replay", "--source", f"dataset:{recording}", "--output", "null", "--no-map"),
                *("--no-status", *options, "--set", f"control.socket={folder / 's'}", "--set", "control.group=null"),
                stderr=log.fileno(),
            )  # fmt: skip
        with contextlib.suppress(OSError, AttributeError):  # it has ended already; or the system has no such limit
            resource.prlimit(process.pid, resource.RLIMIT_DATA, (_MAX_BYTES, _MAX_BYTES))
        return cls(folder, process)

    async def wait_until_ready(self, changes: Sequence[str]) -> bool:
        """Wait until it takes requests, and set the `changes`, KEY=VALUE. Return False if it has ended before.

        Raises RefusedError with its reason if it refuses a change.
        """
        while self._process.returncode is None:
            if await asyncio.to_thread(self._request_changes, changes):
                return True
            await asyncio.sleep(_POLL_S)
        return False

    def end(self) -> None:
        if self._process.returncode is None:
            self._process.terminate()

    async def ended(self) -> str:
        """Wait for its end, and remove its files. Return its last line."""
        await self._process.wait()
        lines = (self._folder / "log").read_text(errors="replace").strip().splitlines()
        shutil.rmtree(self._folder, ignore_errors=True)
        return child.problem_in(lines) or "the replay has failed"

    def _request_changes(self, changes: Sequence[str]) -> bool:
        """Set the changes, but those of keys on the replay's command line. Return False if it takes no requests yet."""
        with contextlib.suppress(NoDaemonError), Client(self.socket) as client:
            status = client.ask("status")
            if status["state"] != "starting":
                settable = [change for change in changes if key_of(change) not in status["given"]]
                if settable:
                    client.ask("set", assignments=settable)
                return True
        return False
