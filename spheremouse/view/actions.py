"""Actions of the page's buttons. Each but `undo` and `stop` is also a command of `spheremouse` or `spheremouse ctl`."""

import asyncio
import time
from collections.abc import Callable
from inspect import isawaitable
from pathlib import Path
from typing import Any

from pydantic import Field

from spheremouse.errors import ConfigurationError, ControlError, printable
from spheremouse.files.calibration_folder import default_folder
from spheremouse.files.edit import save_settings
from spheremouse.files.exchange import defaults, export_settings, import_settings, values_of
from spheremouse.files.figures import read_figures
from spheremouse.files.plain_json import tuples
from spheremouse.files.validate import Part, validate
from spheremouse.files.yaml import Document, parse_bytes
from spheremouse.session.control.client import Client, settings_to_save
from spheremouse.session.process import child
from spheremouse.view.daemon import DaemonLink, Message, Values
from spheremouse.view.guide import Guide, GuideStep
from spheremouse.view.recordings import Recordings

# Requests of the daemon, and the words for a reply without a message.
_REQUESTS = {"replay": "", "pause": "Paused.", "resume": "Resumed.", "reload": "Configuration read again."}
_REQUESTS |= dict.fromkeys(("reinit", "record", "snapshot", "profile"), "Done.")


class _Keys(Part):
    keys: tuple[str, ...]


class _Text(Part):
    text: str


class _Name(Part):
    name: str


class _Section(_Name):
    begin: float = Field(0.0, ge=0.0, description="in s")
    end: float | None = Field(None, ge=0.0, description="in s; 0 is the end of the recording")


class Actions:
    """The actions of one page. Each returns a sentence, or data for the panel."""

    def __init__(self, daemon: DaemonLink, guide: Guide) -> None:
        self._daemon, self._guide = daemon, guide
        recordings = self.recordings = Recordings(daemon)
        self._own: dict[str, tuple[type[Part], Callable[[Any], Any]]] = {
            "undo": (Part, lambda _: self._undo()),
            "reset": (_Keys, lambda given: self._set_all(defaults(daemon.described.settings, given.keys), "reset")),
            "save": (Part, lambda _: asyncio.to_thread(self._save)),
            "doctor": (Part, lambda _: child.answer(daemon.socket, "doctor", "--json", codes=(0, 1))),
            "recordings": (Part, lambda _: recordings.listed()),
            "play": (_Name, lambda given: recordings.play(given.name)),
            "leave": (Part, lambda _: recordings.leave()),
            "compare": (_Section, lambda given: recordings.compare(given.name, given.begin, given.end)),
            "stop": (Part, lambda _: recordings.stop()),
            "calibration": (Part, lambda _: self._calibration()),
            "guide": (GuideStep, guide.do),
            "export": (Part, lambda _: {"text": export_settings(daemon.described.settings)}),
            "import": (_Text, lambda given: self._import(given.text)),
        }

    async def set(self, values: Values, gesture: str) -> str:
        """Change settings. Raises ControlError with the daemon's reason if it refuses."""
        return _message(await self._daemon.set(values, gesture), "Applied.")

    async def do(self, action: str, arguments: dict[str, Any]) -> str | Message:
        """Carry out an action by its name.

        Raises ControlError if it is unknown or refused, ConfigurationError for invalid arguments or an invalid file.
        """
        if action in self._own:
            model, method = self._own[action]
            answer = method(validate(Document(f"{action}: ", tuples(arguments)), model))
            return await answer if isawaitable(answer) else answer
        if action not in _REQUESTS:
            raise ControlError(f"{action}: there is no such action")
        for name in arguments.keys() & {"command", "id"}:
            raise ControlError(f"{action}: {name}: unknown key")
        return _message(await self._daemon.ask(action, **arguments), _REQUESTS[action])

    async def _undo(self) -> str:
        return _message(await self._daemon.undo(), "Undone.")

    async def _import(self, text: str) -> str:
        document = parse_bytes(text.encode(), "the imported file")
        return await self._set_all(import_settings(self._daemon.described.settings, document), "import")

    async def _calibration(self) -> Message:
        """Return the reports beside the rig and in the folder of the calibration."""
        rig, folder = (self._daemon.status or {}).get("rig"), self._guide.folder or default_folder()
        folders = [*([] if rig is None else [Path(rig).parent]), folder.absolute()]
        return {"reports": await asyncio.to_thread(read_figures, folders), "folders": [str(f) for f in folders]}

    async def _set_all(self, values: Values, name: str) -> str:
        return await self.set(values, f"{name} {time.monotonic()}") if values else "Nothing differs."

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
            raise ControlError(f"{e}", "if a recording plays, leave it first; else use Export in Expert") from None
        return f"{file}: saved {', '.join(changes)}"


def _message(reply: Message, otherwise: str) -> str:
    return printable(str(reply.get("message") or reply.get("file") or otherwise))
