"""A process of its own that replays a recording, with its socket and its log in a private folder."""

import asyncio
import contextlib
import json
import resource
import shutil
import tempfile
from asyncio.subprocess import Process
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from spheremouse.files.config import key_of
from spheremouse.files.listing import Listed
from spheremouse.session.control.client import Client, NoDaemonError
from spheremouse.session.process import child

_MAX_BYTES = 2 << 30  # of writable memory, with the stacks of the threads; 0.7 GB on two cores
_POLL_S = 0.1  # s
_OF_THE_COMPUTER = ("source", "output", "rig", "camera_file", "map", "realtime", "control", "metrics", "record")


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


def options_of(status: dict[str, Any], values: dict[str, Any], recording: Listed) -> list[str]:
    """Return options of `run` and `evaluate` that give a recording the settings of a daemon.

    These are its configuration file, the saved settings, and those of its command line with their `values` by key. They
    exclude settings of this computer. `--tracker` is added if the daemon's does not fit the recording.
    """
    config, given = status.get("config"), [key for key in status.get("given") or [] if key in values]
    words = [] if config is None else ["--config", str(config)]
    for assignment in (*(status.get("saved") or ()), *(f"{key}={json.dumps(values[key])}" for key in given)):
        key = key_of(assignment)
        if key != "wand.balls" and key.partition(".")[0] not in _OF_THE_COMPUTER:
            words += ["--set", assignment]
    if (status.get("tracker") == "wand") != recording.wand:
        words += ["--tracker", "wand" if recording.wand else "so3"]
    return words
