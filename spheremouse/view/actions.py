"""Actions of the page's buttons. Each is one that `spheremouse ctl` has too."""

import asyncio
import base64
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from spheremouse.errors import ConfigurationError, ControlError, printable
from spheremouse.files.edit import save_settings
from spheremouse.files.exchange import read_settings, settings_text
from spheremouse.files.figures import read_figures
from spheremouse.files.yaml import parse_value
from spheremouse.session.control.client import Client, settings_to_save
from spheremouse.view.daemon import Daemon, Values
from spheremouse.view.recordings import Recordings

_REQUESTS = ("reinit", "pause", "resume", "reload", "record", "replay", "snapshot", "profile")
_WORDS = {
    "replay": "",
    "pause": "Paused.",
    "resume": "Resumed.",
    "reload": "Configuration read again.",
    "undo": "Undone.",
}
_COMMAND_TIMEOUT = 120.0  # s of another process
_MAX_IMPORTED = 50  # settings, as many as a request takes


class Done(NamedTuple):
    """The answer to an action: a sentence, and data for the panel."""

    message: str = ""
    data: Mapping[str, Any] = MappingProxyType({})


class GuideOptions(NamedTuple):
    """Inputs of the guide; None stands for the default of its commands."""

    folder: Path | None = None  # of the calibration
    source: str | None = None  # the camera


class Actions:
    """The actions of one page."""

    def __init__(self, daemon: Daemon, guide: GuideOptions) -> None:
        self._daemon, self._guide_options = daemon, guide
        self.recordings = Recordings(daemon, self._run)

    async def set(self, values: Values, gesture: str) -> Done:
        """Change settings. Raises ControlError with the daemon's reason if it refuses."""
        return Done(_message(await self._daemon.set(values, gesture), "Applied."))

    async def do(self, action: str, arguments: dict[str, Any]) -> Done:
        """Carry out an action by its name. Raises ControlError if it is refused or unknown."""
        if action in _REQUESTS:
            return Done(_message(await self._daemon.ask(action, **arguments), _WORDS.get(action, "Done.")))
        if action == "stop-record":
            return Done(_message(await self._daemon.ask("record", stop=True), "The recording has ended."))
        if action == "undo":
            return Done(_message(await self._daemon.undo(), _WORDS["undo"]))
        if action == "reset":
            return await self._set_all(self._daemon.defaults(arguments.get("keys", [])), "reset")
        if action == "save":
            return Done(await asyncio.to_thread(self._save))
        if action == "doctor":
            return Done(data=await self._run("doctor", "--json", codes=(0, 1)))
        if action == "recordings":
            return Done(data=await self.recordings.listed())
        if action == "play":
            return Done(await self.recordings.play(str(arguments.get("name"))))
        if action == "leave":
            return Done(await self.recordings.leave())
        if action == "calibration":
            return Done(data=await self._calibration())
        if action == "compare":
            begin, end = (_seconds(arguments.get(key)) for key in ("begin", "end"))
            return Done(data=await self.recordings.compare(str(arguments.get("name")), begin or 0.0, end))
        if action == "guide":
            return Done(data=await self._guide())
        if action == "export":
            return Done(data={"text": settings_text(self._daemon.changed())})
        if action == "import":
            return await self._set_all(self._daemon.differing(read_settings(str(arguments.get("text", "")))), "import")
        raise ControlError(f"{action}: there is no such action")

    async def _guide(self) -> dict[str, Any]:
        """Return the steps of the calibration and, unless a daemon has the camera, its picture with targets."""
        folder, source = self._guide_options
        steps = await self._run("calibrate", "next", *([] if folder is None else [str(folder)]), "--json", "-")
        found: dict[str, Any] = {"lines": [], "picture": None, "problem": None, **steps}
        if (status := self._daemon.status) is not None:
            words = f"the service has it, {status['state']}; its picture is under Camera"
            return found | {"camera": words}
        with tempfile.TemporaryDirectory(prefix="spheremouse-view-") as name:
            file = Path(name) / "camera.jpg"
            try:
                words = [] if source is None else [source]
                sight = await self._run("preview", *words, "--json", "--out", str(file))
            except ControlError as e:
                return found | {"camera": None, "problem": str(e)}
            picture = base64.b64encode(file.read_bytes()).decode()
        return found | {"camera": sight["source"], "lines": sight["lines"], "picture": picture}

    async def _calibration(self) -> dict[str, Any]:
        """Return the reports beside the rig and in the folder of the calibration."""
        rig, folder = (self._daemon.status or {}).get("rig"), self._guide_options.folder
        given = Path("cabinet" if Path("cabinet").is_dir() else "") if folder is None else folder
        folders = [*([] if rig is None else [Path(rig).parent]), given.absolute()]
        try:
            reports = await asyncio.to_thread(read_figures, folders)
        except OSError as e:
            raise ControlError(f"{e.filename}: cannot be read ({e.strerror})") from None
        return {"reports": reports, "folders": [str(f) for f in folders]}

    async def _set_all(self, values: Values, name: str) -> Done:
        if not values:
            return Done("Nothing differs.")
        if len(values) > _MAX_IMPORTED:
            raise ControlError(f"{name}: {len(values)} settings; at most {_MAX_IMPORTED} are changed at once")
        return await self.set(values, f"{name} {time.monotonic()}")

    def _save(self) -> str:
        """Write what was set into the daemon's configuration file, with this process's rights."""
        with Client(self._daemon.socket) as client:
            file, changes = settings_to_save(client)
        pairs = [change.partition("=") for change in changes]
        values = {tuple(key.strip().split(".")): parse_value(text, key) for key, _, text in pairs}
        if not values:
            return "Nothing was set that is not in the file."
        try:
            save_settings(file, values, None)
        except ConfigurationError as e:
            raise ControlError(f"{e}", "as root: spheremouse ctl save") from None
        return f"{file}: saved {', '.join(changes)}"

    async def _run(self, *words: str, codes: tuple[int, ...] = (0,)) -> dict[str, Any]:
        """Return the JSON that a command of ours prints for this daemon. Its memory is freed with its process."""
        socket = self._daemon.socket
        place = {} if socket is None else {"SPHEREMOUSE_SOCKET": str(socket)}
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "spheremouse", *words,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            env={**os.environ, **place},
        )  # fmt: skip
        try:
            async with asyncio.timeout(_COMMAND_TIMEOUT):
                out, error = await process.communicate()
        except TimeoutError:
            raise ControlError(f"spheremouse {words[0]}: no answer within {_COMMAND_TIMEOUT:g} s") from None
        finally:
            if process.returncode is None:
                process.kill()
        if process.returncode not in codes:
            lines = error.decode(errors="replace").strip().splitlines()
            raise ControlError(printable(lines[-1].removeprefix("spheremouse: ")) if lines else f"{words[0]}: failed")
        try:
            return json.loads(out)
        except ValueError:
            raise ControlError(f"spheremouse {words[0]}: prints no JSON; see the log of the page") from None


def _seconds(value: Any) -> float | None:
    if value is None or (isinstance(value, int | float) and 0.0 <= value < math.inf):
        return value
    raise ControlError(f"{printable(str(value))[:50]}: is no time in s")


def _message(reply: dict[str, Any], otherwise: str) -> str:
    for key in ("message", "file"):
        if reply.get(key):
            return printable(str(reply[key]))
    return otherwise
