"""Actions of the page's buttons. Each but `undo` is also a command of `spheremouse` or `spheremouse ctl`."""

import asyncio
import math
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from spheremouse.errors import ConfigurationError, ControlError, printable
from spheremouse.files.calibration_folder import default_folder
from spheremouse.files.edit import save_settings
from spheremouse.files.exchange import defaults, exported, imported, values_of
from spheremouse.files.figures import read_figures
from spheremouse.files.yaml import parse_bytes
from spheremouse.session.control.client import Client, settings_to_save
from spheremouse.session.process import child
from spheremouse.view.daemon import DaemonLink, Values
from spheremouse.view.guide import Guide
from spheremouse.view.recordings import Recordings

_REQUESTS = ("reinit", "pause", "resume", "reload", "record", "replay", "snapshot", "profile")
_WORDS = {"replay": "", "pause": "Paused.", "resume": "Resumed.", "reload": "Configuration read again."}


class Done(NamedTuple):
    """The answer to an action: a sentence, and data for the panel."""

    message: str = ""
    data: Mapping[str, Any] = MappingProxyType({})


class Actions:
    """The actions of one page."""

    def __init__(self, daemon: DaemonLink, guide: Guide) -> None:
        self._daemon, self._guide = daemon, guide
        self.recordings = Recordings(daemon, self._run)

    async def set(self, values: Values, gesture: str) -> Done:
        """Change settings. Raises ControlError with the daemon's reason if it refuses."""
        return Done(_message(await self._daemon.set(values, gesture), "Applied."))

    async def do(self, action: str, arguments: dict[str, Any]) -> Done:
        """Carry out an action by its name.

        Raises ControlError if it is refused or unknown, and ConfigurationError for invalid keys or an invalid file.
        """
        if action in _REQUESTS:
            return Done(_message(await self._daemon.ask(action, **arguments), _WORDS.get(action, "Done.")))
        if action == "undo":
            return Done(_message(await self._daemon.undo(), "Undone."))
        if action == "reset":
            return await self._set_all(defaults(self._daemon.settings, arguments.get("keys", [])), "reset")
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
            return Done(data=await self._guide.do(str(arguments.get("do", "steps")), arguments))
        if action == "export":
            return Done(data={"text": exported(self._daemon.settings)})
        if action == "import":
            document = parse_bytes(str(arguments.get("text", "")).encode(), "the imported file")
            return await self._set_all(imported(self._daemon.settings, document), "import")
        raise ControlError(f"{action}: there is no such action")

    async def _calibration(self) -> dict[str, Any]:
        """Return the reports beside the rig and in the folder of the calibration."""
        rig, folder = (self._daemon.status or {}).get("rig"), self._guide.folder or default_folder()
        folders = [*([] if rig is None else [Path(rig).parent]), folder.absolute()]
        return {"reports": await asyncio.to_thread(read_figures, folders), "folders": [str(f) for f in folders]}

    async def _set_all(self, values: Values, name: str) -> Done:
        if not values:
            return Done("Nothing differs.")
        return await self.set(values, f"{name} {time.monotonic()}")

    def _save(self) -> str:
        """Have the daemon save what was set, or write it into its configuration file with this process's rights."""
        with Client(self._daemon.socket) as client:
            place = settings_to_save(client)
            if place is None:
                return _message(client.ask("save"), "Saved.")
        file, changes = place
        if not changes:
            return "Nothing was set that is not in the file."
        keyed = {tuple(key.split(".")): value for key, value in values_of(changes).items()}
        try:
            save_settings(file, keyed, root=None)
        except ConfigurationError as e:
            raise ControlError(f"{e}", "while a recording plays, go back to the camera first") from None
        return f"{file}: saved {', '.join(changes)}"

    async def _run(self, *words: str, codes: tuple[int, ...] = (0,)) -> dict[str, Any]:
        """Return the JSON that a command of ours prints for this daemon."""
        return await child.answer(self._daemon.socket, *words, codes=codes)


def _seconds(value: Any) -> float | None:
    if value is None or (isinstance(value, int | float) and 0.0 <= value < math.inf):
        return value
    raise ControlError(f"{printable(str(value))[:50]}: is no time in s")


def _message(reply: dict[str, Any], otherwise: str) -> str:
    for key in ("message", "file"):
        if reply.get(key):
            return printable(str(reply[key]))
    return otherwise
