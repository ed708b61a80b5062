"""List the recordings in a folder, by their descriptions alone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from spheremouse.errors import ConfigurationError
from spheremouse.files import plain_json
from spheremouse.files.safe_files import read_bytes

_MAX_SCENE_BYTES = 1_000_000
_MAX_LISTED = 200


class Listed(NamedTuple):
    """A folder with a `scene.json`."""

    path: Path
    frames: int = 0
    seconds: float = 0.0
    wand: bool = False
    truth: bool = False
    problem: str = ""  # why it cannot be read; then the other values are unknown


def list_recordings(folders: Sequence[Path]) -> list[Listed]:
    """Return the recordings in these folders, the newest first, at most 200.

    If two folders have a recording of the same name, the first folder's counts. Raises ConfigurationError if a folder
    cannot be read.
    """
    found: dict[str, Path] = {}
    try:
        for folder in folders:
            for path in folder.iterdir() if folder.is_dir() else ():
                if not path.name.startswith(".") and (path / "scene.json").is_file():
                    found.setdefault(path.name, path)
    except OSError as e:
        raise ConfigurationError(f"{e.filename}: cannot be read ({e.strerror})", "add yourself to its group") from None
    newest = sorted(found.values(), key=lambda path: path.stat().st_mtime, reverse=True)
    return [_read(path) for path in newest[:_MAX_LISTED]]


def _read(path: Path) -> Listed:
    try:
        scene: Any = plain_json.loads(read_bytes(path / "scene.json", _MAX_SCENE_BYTES, "scene"))
        frames, fps = int(scene["frames"]), float(scene["fps"])
        return Listed(path, frames, frames / fps, "wand" in scene, (path / "truth.csv").is_file())
    except OSError as e:
        return Listed(path, problem=f"scene.json: {e.strerror or e}")
    except (ValueError, TypeError, KeyError, ZeroDivisionError, OverflowError):
        return Listed(path, problem="scene.json: is no description of a recording")
