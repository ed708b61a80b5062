"""The commands that fit an evening's folder, as they are copied into a terminal."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from spheremouse.calibrate.board_file import options_of
from spheremouse.calibrate.guide.folder import (
    BOARD,
    CAMERA_FILE,
    CONFIG_FILE,
    DEVICE,
    DEVICE_FILE,
    RIG_FILE,
    camera_in,
    configured,
    film_in,
)
from spheremouse.capture.default_camera import default_camera, in_size
from spheremouse.errors import ConfigurationError
from spheremouse.files.device import untouched

DEFAULT = Path("cabinet")


def default_folder() -> Path:
    """The folder meant where none is named: the one we are in where that has begun, else `cabinet`."""
    begun = any(Path(name).exists() for name in (DEVICE_FILE, CAMERA_FILE, BOARD))
    return Path() if begun and not DEFAULT.exists() else DEFAULT


def init_command(folder: Path) -> str:
    """Command that makes the folder."""
    return _command("init", folder)


def next_command(folder: Path) -> str:
    """Command that tells what comes next."""
    return _command("next", *_named(folder))


def photos_command(folder: Path, what: Literal["camera", "device"], more: Sequence[str] = ()) -> str:
    """Command that takes photos into the folder."""
    return _command("photos", *_named(folder), "--for", what, *more)


def camera_command(folder: Path, board: Sequence[str] = (), *, again: bool = False) -> str:
    """Command that makes camera.yaml of the photos in the folder."""
    given = board or options_of(folder)
    return _command("camera", folder / BOARD, *given, "--out", folder / CAMERA_FILE, again=again)


def device_command(folder: Path, *, again: bool = False) -> str:
    """Command that makes rig.yaml of the photos in the folder."""
    given = ("--device", folder / DEVICE_FILE, "--camera", folder / CAMERA_FILE)
    return _command("device", folder / DEVICE, *given, "--out", folder / RIG_FILE, again=again)


def rolling_command(folder: Path, *, again: bool = False) -> str:
    """Command that makes rig.yaml without photos of the device."""
    given: list[str | Path] = ["--source", _source(folder), "--camera", folder / CAMERA_FILE]
    if (folder / DEVICE_FILE).exists() and not untouched(folder / DEVICE_FILE):  # its targets give the axes
        given += ["--device", folder / DEVICE_FILE]
    return _command("rolling", *given, "--out", folder / RIG_FILE, again=again)


def axes_command(rig: Path, source: str | None = None) -> str:
    """Command that asks which way is right, and keeps it beside a rig; by default with the camera of the photos."""
    folder = rig.parent
    said = _said(folder)
    given = [] if rig.name == RIG_FILE and "rig" in said else ["--rig", str(rig)]
    if source or film_in(folder) or "source" not in said:
        given += ["--source", source or film_in(folder) or _source(folder)]
    return shlex.join(["spheremouse", "axes", "--config", str(folder / CONFIG_FILE), *given])


def run_command(folder: Path, *more: str) -> str:
    """Command that tracks."""
    return shlex.join(["spheremouse", "run", "--config", str(folder / CONFIG_FILE), *more])


def _command(*words: str | Path, again: bool = False) -> str:
    return shlex.join(["spheremouse", "calibrate", *map(str, words), *(["--force"] if again else [])])


def _named(folder: Path) -> list[Path]:
    """A folder as a command needs it."""
    return [] if folder == default_folder() else [folder]


def _source(folder: Path) -> str:
    """The camera that took the photos, in the mode that was calibrated."""
    camera, said = camera_in(folder), _said(folder).get("source")
    return in_size(said if isinstance(said, str) else default_camera(), None if camera is None else camera.size)


def _said(folder: Path) -> dict[str, Any]:
    """What the configuration says; one that is damaged is told by its own step."""
    try:
        return configured(folder)
    except ConfigurationError:
        return {}
