"""What an evening's folder holds: photos, the files made from them, and what these say of their making."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spheremouse.calibrate.board_file import options_made_of
from spheremouse.calibrate.photos import Photo, check_size, read_photos
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.yaml import read_document, without_schema

BOARD, DEVICE = "board", "device"  # folders of photos
CAMERA_FILE, DEVICE_FILE, RIG_FILE, CONFIG_FILE = "camera.yaml", "device.yaml", "rig.yaml", "config.yaml"
FILM = "film"  # in a practice set: a dataset of three gestures


@dataclass(frozen=True, slots=True)
class Photos:
    """Content of a folder of photos."""

    folder: Path
    photos: tuple[Photo, ...] = ()
    problem: tuple[str, ...] = ()  # why they cannot be used

    @property
    def found(self) -> str:
        if self.problem:
            return "cannot be used as they are"
        if not self.photos:
            return "none yet"
        width, height = self.photos[0].size
        return f"{count(len(self.photos), 'photo')} of {width}x{height} in {self.folder}"


@dataclass(frozen=True, slots=True)
class Result:
    """A file made from others, and what it says of its making."""

    path: Path
    found: str  # in words
    problem: tuple[str, ...] = ()  # why it cannot be used
    hashes: frozenset[str] = frozenset()  # of all it was made from
    photo_hashes: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()  # hashes of photos
    board: tuple[str, ...] = ()  # options of the camera command
    size: tuple[int, int] | None = None  # px, of a camera
    doubts: tuple[str, ...] = ()  # what the calibration itself warned of

    def precedes(self, path: Path, sha256: str) -> bool:
        """Whether a file came later than this result, and is not what it was made from."""
        if sha256 in self.hashes:
            return False
        state = path.stat()
        return max(state.st_mtime_ns, state.st_ctime_ns) > self.path.stat().st_mtime_ns  # ctime: when it was copied

    def changed(self, photos: Sequence[Photo]) -> str:
        """Difference of the photos from those it was made from; nothing where there is none, or none are left."""
        new = sum(self.precedes(p.path, p.sha256) for p in photos)
        here = {p.sha256 for p in photos}
        gone = len(self.photo_hashes - here) if self.photo_hashes & here else 0
        words = [f"{count(new, 'photo')} came later"] if new else []
        words += [f"{count(gone, 'photo')} it was made from {'is' if gone == 1 else 'are'} gone"] if gone else []
        return ", ".join(words)


def photos_in(folder: Path, camera_path: Path | None = None) -> Photos:
    """The photos in a folder, and whether they are of the mode of a camera file."""
    try:
        there = any(p.is_file() and not p.name.startswith(".") for p in folder.iterdir())
        photos = read_photos([folder], note=lambda _: None) if there else []
        if photos and camera_path is not None:
            check_size(photos, load_camera(camera_path), camera_path)
    except OSError:
        return Photos(folder)
    except CalibrationError as e:
        return Photos(folder, problem=tuple(str(e).splitlines()))
    return Photos(folder, tuple(photos))


def camera_in(folder: Path) -> Result | None:
    """The camera file."""
    path = folder / CAMERA_FILE
    if not path.exists():
        return None
    try:
        camera = load_camera(path)
    except ConfigurationError as e:
        return Result(path, "cannot be used", tuple(str(e).splitlines()))
    made = _provenance(path)
    words = f"{camera.width}x{camera.height}, focal length {camera.fx:.1f} px"
    size = camera.width, camera.height
    used, left_out = _hashes(made.get("photos")), _hashes(made.get("left_out"))
    return Result(path, words, (), _hashes(made), used, left_out, options_made_of(made), size)


def rig_in(folder: Path) -> Result | None:
    """The rig file."""
    path = folder / RIG_FILE
    if not path.exists():
        return None
    try:
        rig = load_rig(path)
    except ConfigurationError as e:
        return Result(path, "cannot be used", tuple(str(e).splitlines()))
    made = _provenance(path)
    size = "scale free" if rig.scale_free else f"ball of {rig.ball.radius:.3f} m radius"
    words = f"{size}, {count(len(rig.targets.ids), 'target')}"
    said = made.get("warnings")
    doubts = tuple(str(w) for w in said) if isinstance(said, tuple | list) else ()
    return Result(path, words, (), _hashes(made), _hashes(made.get("photos")), doubts=doubts)


def film_in(folder: Path) -> str | None:
    """The film of a practice set as a source."""
    film = folder / FILM
    return f"dataset:{film}" if (film / "scene.json").is_file() else None


def configured(folder: Path) -> dict[str, Any]:
    """What the configuration file says, section by section; ConfigurationError where it cannot be read."""
    path = folder / CONFIG_FILE
    data = without_schema(read_document(path), "configuration").data if path.exists() else {}
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigurationError(f"{path}: must be lines like `motion: ...`")
    return data


def count(n: int, thing: str) -> str:
    """Number and noun."""
    return f"{n} {thing}{'' if n == 1 else 's'}"


def _provenance(path: Path) -> dict[str, Any]:
    data = read_document(path).data
    made = data.get("provenance") if isinstance(data, dict) else None
    return made if isinstance(made, dict) else {}


def _hashes(part: Any) -> frozenset[str]:
    """All SHA-256 in a part of a file, wherever they stand."""

    def walk(value: Any) -> Iterator[str]:
        if isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value):
            yield value
        for inner in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
            yield from walk(inner)

    return frozenset(walk(part))
