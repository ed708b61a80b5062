"""The guide from an empty folder to the service. It runs the commands of `calibrate next`, one at a time.

A browser names a step and the number of its command, never a command or a path. It can also give the length of the
board's square and the text of device.yaml.
"""

import asyncio
import base64
import contextlib
import json
import shlex
import signal
import tempfile
from asyncio.subprocess import STDOUT, Process
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from spheremouse.errors import ControlError, os_errors_as, printable
from spheremouse.files import safe_files
from spheremouse.files.validate import Part
from spheremouse.session.process import child

LOOK = "camera"  # the step before all others
_LOOK_INTERVAL = 0.3  # s between two pictures
_MAX_LINES = 40
_MAX_DEVICE_BYTES = 100_000
_STOP_TIMEOUT = 10.0  # s until a command has ended by itself
_STOPPED = (-signal.SIGTERM, 128 + signal.SIGTERM, 128 + signal.SIGINT)  # exit codes
_NO_STEP: dict[str, Any] = {"name": "", "command": "", "otherwise": ()}


class GuideOptions(NamedTuple):
    """Inputs of the guide; None stands for the default of its commands."""

    folder: Path | None = None  # of the calibration
    source: str | None = None  # the camera


class GuideStep(Part):
    """An action of the guide, and its arguments; see `Guide.do`."""

    do: Literal["look", "run", "stop", "describe", "steps"] = "steps"
    step: str = ""
    number: int = -1  # of the command
    square: str = Field("", pattern=r"^(\d{1,4}(\.\d{1,3})?)?$", description="write a length in mm, as 20 or 20.1")
    text: str = ""


class Guide:
    """The guide of one page. All methods are called in the event loop."""

    def __init__(self, options: GuideOptions, socket: Path | None, publish: Callable[[dict[str, Any]], None]) -> None:
        """`publish` takes messages for the owner's browsers."""
        self.folder, self._source = options.folder, options.source
        self._socket, self._publish = socket, publish
        self._process: Process | None = None
        self._following: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()
        self._steps: dict[str, Any] = {}  # as read last
        self._lines: deque[str] = deque(maxlen=_MAX_LINES)
        self._state: dict[str, Any] = {"running": "", "check": None, "picture": None, "problem": ""}
        self._folder = tempfile.TemporaryDirectory(prefix="spheremouse-view-")
        self._picture = Path(self._folder.name) / "camera.jpg"

    def state(self) -> dict[str, Any]:
        """Return the message of the command that runs, or ended last."""
        return {"type": "guide", "lines": list(self._lines), **self._state}

    async def do(self, given: GuideStep) -> dict[str, Any]:
        """Carry out an action of the page, and return its answer: the steps, or an empty object.

        - `look`: start the camera's preview. `run`: start a command of the next step (`_command` has the arguments).
          Both end the command before.
        - `stop`: end the command.
        - `describe`: write the argument `text` into device.yaml, and return the steps as `steps` does.
        - `steps`: return the steps as `calibrate next --json` prints them. If the next one is to fill in device.yaml,
          `device` has its text.

        Raises ControlError if an action is refused or fails.
        """
        if given.do == "look":
            source = [] if self._source is None else [self._source]
            options = ("--every", f"{_LOOK_INTERVAL}", "--json", "--out", f"{self._picture}")
            await self._start(LOOK, "preview", *source, *options)
        elif given.do == "stop":
            await self.stop()
        elif given.do == "run":
            await self._start(given.step, *self._command(given))
        else:
            if given.do == "describe":
                self._describe(given.text)
            self._steps = await self._read_steps()
            return self._steps
        return {}

    async def stop(self, name: str | None = None) -> None:
        """End the command that runs, but only that of step `name` if given. After 10 s it is killed. Photos stay."""
        process = self._process
        if process is None or name not in (None, self._state["running"]):
            return
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(_STOP_TIMEOUT):
                await process.wait()
        except TimeoutError:
            process.kill()
        if self._following is not None:
            await self._following

    async def _read_steps(self) -> dict[str, Any]:
        folder = [] if self.folder is None else [str(self.folder)]
        steps = await child.answer(self._socket, "calibrate", "next", *folder, "--json", "-")
        if any(step["state"] == "next" and step["name"] == "device.yaml" for step in steps["steps"]):
            with contextlib.suppress(OSError, UnicodeError):
                path = Path(steps["folder"]) / "device.yaml"
                steps["device"] = safe_files.read_text(path, _MAX_DEVICE_BYTES, "device")
        return steps

    def _command(self, given: GuideStep) -> list[str]:
        """Return the words after `spheremouse` of the next step's command with this number.

        Raises ControlError if the step or number is not in the last list, or the command is not permitted.
        """
        step = next((s for s in self._steps.get("steps", ()) if s["state"] == "next"), _NO_STEP)
        commands = [step["command"], *(command for _, command in step["otherwise"])]
        if given.step != step["name"] or not 0 <= given.number < len(commands):
            raise ControlError("guide: the steps have changed; look at the list again")
        program, *words = shlex.split(commands[given.number]) or [""]
        if program != "spheremouse":
            raise ControlError(f"guide: the page may not run it; in a terminal: {commands[given.number]}")
        if words[1:2] == ["photos"]:
            words += ["--json", "--picture", str(self._picture)]
            words += [] if self._source is None else ["--source", self._source]
        words += ["--square", f"{given.square}mm"] if given.square else []
        if words[0] == "run" and self._socket is not None:
            words += ["--set", f"control.socket={self._socket}"]
        return words

    def _describe(self, text: str) -> None:
        """Write device.yaml. `calibrate next` reports its mistakes."""
        if "device" not in self._steps:
            raise ControlError("guide: the steps have changed; look at the list again")
        path = Path(self._steps["folder"]) / "device.yaml"
        with os_errors_as(ControlError, f"{path}: cannot be written"):
            safe_files.replace(path, text.encode())

    async def _start(self, name: str, *words: str) -> None:
        """Start a command. It ends another one, which may have the camera."""
        async with self._starting:
            await self.stop()
            self._picture.unlink(missing_ok=True)
            self._lines.clear()
            self._state = {"running": name, "check": None, "picture": None, "problem": ""}
            self._process = await child.start(self._socket, *words, stderr=STDOUT)
            self._following = asyncio.create_task(self._follow(self._process))
        self._publish(self.state())

    async def _follow(self, process: Process) -> None:
        """Take the lines of a step's process, and publish how it ended."""
        assert process.stdout is not None
        with contextlib.suppress(ValueError):  # a line without an end
            async for line in process.stdout:
                self._take(printable(line.decode(errors="replace").rstrip()))
        code, self._process = await process.wait(), None
        failed = code not in (0, *_STOPPED)
        problem = child.problem_in(list(self._lines)) or f"ended with exit code {code}"
        self._state |= {"running": "", "problem": problem if failed else ""}
        self._publish(self.state())

    def _take(self, line: str) -> None:
        """Publish a line of the command: JSON of a frame, or text."""
        try:
            check = json.loads(line)
        except ValueError:
            check = None
        if not isinstance(check, dict) or "text" in check:
            self._lines.append(str(check["text"]) if isinstance(check, dict) else line)
        else:
            with contextlib.suppress(OSError):
                self._state["picture"] = base64.b64encode(self._picture.read_bytes()).decode()
            self._state["check"] = check
        self._publish(self.state())
