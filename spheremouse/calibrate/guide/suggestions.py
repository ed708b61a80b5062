"""Commands for a calibration's folder, ready to copy into a terminal."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from spheremouse.calibrate.board import board_options
from spheremouse.calibrate.guide.folder import (
    BOARD,
    CAMERA_FILE,
    CONFIG_FILE,
    DEVICE,
    DEVICE_FILE,
    RIG_FILE,
    practice_film,
    read_camera,
    read_config,
)
from spheremouse.capture.nodes import default_camera, in_size
from spheremouse.errors import ConfigurationError
from spheremouse.files.device import untouched

DEFAULT = Path("cabinet")
INSTALL = "sudo spheremouse service install"
START = "sudo systemctl restart spheremouse.service"


def default_folder() -> Path:
    """Return the folder meant if none is named: the current one if it has contents, else `cabinet`."""
    has_contents = any(Path(name).exists() for name in (DEVICE_FILE, CAMERA_FILE, BOARD))
    return Path() if has_contents and not DEFAULT.exists() else DEFAULT


def init_command(folder: Path) -> str:
    """Return the command that makes the folder."""
    return _calibrate("init", folder)


def print_command(folder: Path) -> str:
    """Return the command that makes the pages to print."""
    return _calibrate("print", "--out", folder / "print")


def next_command(folder: Path) -> str:
    """Return the command that shows the next step."""
    return _calibrate("next", *_unless_default(folder))


def photos_command(folder: Path, what: Literal["camera", "device"], more: Sequence[str] = ()) -> str:
    """Return the command that takes photos into the folder."""
    return _calibrate("photos", *_unless_default(folder), "--for", what, *more)


def camera_command(folder: Path, board: Sequence[str] = (), *, again: bool = False) -> str:
    """Return the command that makes camera.yaml from the photos in the folder."""
    options = board or board_options(folder)
    return _calibrate("camera", folder / BOARD, *options, "--out", folder / CAMERA_FILE, again=again)


def device_command(folder: Path, *, again: bool = False) -> str:
    """Return the command that makes rig.yaml from the photos in the folder."""
    options = ("--device", folder / DEVICE_FILE, "--camera", folder / CAMERA_FILE)
    return _calibrate("device", folder / DEVICE, *options, "--out", folder / RIG_FILE, again=again)


def rolling_command(folder: Path, *, again: bool = False) -> str:
    """Return the command that makes rig.yaml without photos of the device."""
    options: list[str | Path] = ["--source", _source(folder), "--camera", folder / CAMERA_FILE]
    if (folder / DEVICE_FILE).exists() and not untouched(folder / DEVICE_FILE):  # its targets give the axes
        options += ["--device", folder / DEVICE_FILE]
    return _calibrate("rolling", *options, "--out", folder / RIG_FILE, again=again)


def axes_command(rig: Path, source: str | None = None) -> str:
    """Return the command that finds the player's position, by default with the camera that took the photos."""
    folder = rig.parent
    config = _config_or_empty(folder)
    options = [] if rig.name == RIG_FILE and "rig" in config else ["--rig", str(rig)]
    if source or practice_film(folder) or "source" not in config:
        options += ["--source", source or practice_film(folder) or _source(folder)]
    return shlex.join(["spheremouse", "axes", "--config", str(folder / CONFIG_FILE), *options])


def run_command(folder: Path, *more: str) -> str:
    """Return the command that tracks."""
    return shlex.join(["spheremouse", "run", "--config", str(folder / CONFIG_FILE), *more])


def copy_command(folder: Path, to: Path) -> str:
    """Return the command that gives the service this calibration."""
    return shlex.join(["sudo", "cp", str(folder / RIG_FILE), str(to / RIG_FILE)])


def own_cabinet_command(practice: Path) -> str:
    """Return the command that begins, or continues, the calibration of a real device after a practice set."""
    if practice.resolve() == DEFAULT.resolve():
        return init_command(Path("my-cabinet"))
    return next_command(DEFAULT) if DEFAULT.is_dir() else init_command(DEFAULT)


def _calibrate(*words: str | Path, again: bool = False) -> str:
    return shlex.join(["spheremouse", "calibrate", *map(str, words), *(["--force"] if again else [])])


def _unless_default(folder: Path) -> list[Path]:
    return [] if folder == default_folder() else [folder]


def _source(folder: Path) -> str:
    """Return the camera that took the photos, in the calibrated mode."""
    camera, source = read_camera(folder), _config_or_empty(folder).get("source")
    return in_size(source if isinstance(source, str) else default_camera(), None if camera is None else camera.size)


def _config_or_empty(folder: Path) -> dict[str, Any]:
    """Read the configuration; empty if it is damaged, which the checklist reports in a step of its own."""
    try:
        return read_config(folder)
    except ConfigurationError:
        return {}
