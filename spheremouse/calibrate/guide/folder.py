"""Contents of a calibration's folder: photos, the files made from them, and the provenance of these files."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.calibrate.board import options_from_provenance
from spheremouse.calibrate.photos import Photo, check_size, read_photos
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.safe_files import read_bytes
from spheremouse.files.yaml import read_document, without_schema

BOARD, DEVICE = "board", "device"  # folders of photos
CAMERA_FILE, DEVICE_FILE, RIG_FILE, CONFIG_FILE = "camera.yaml", "device.yaml", "rig.yaml", "config.yaml"
FILM, TRUTH_FILE = "film", "truth.json"  # of a practice set: a dataset of three gestures, and the exact device

_MAX_TRUTH_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class Photos:
    """Content of a folder of photos."""

    folder: Path
    photos: tuple[Photo, ...] = ()
    problem: tuple[str, ...] = ()  # why they cannot be used

    @property
    def found(self) -> str:
        """Number and size of the photos, in words."""
        if self.problem:
            return "cannot be used as they are"
        if not self.photos:
            return "none yet"
        width, height = self.photos[0].size
        return f"{count(len(self.photos), 'photo')} of {width}x{height} in {self.folder}"


@dataclass(frozen=True, slots=True)
class Result:
    """A file that a calibration wrote, with its provenance."""

    path: Path
    found: str  # in words
    problem: tuple[str, ...] = ()  # why it cannot be used
    hashes: frozenset[str] = frozenset()  # of all files it was made from
    photo_hashes: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()  # hashes of photos
    board: tuple[str, ...] = ()  # options of `calibrate camera`
    size: tuple[int, int] | None = None  # px, of a camera
    warnings: tuple[str, ...] = ()  # of the calibration itself

    def precedes(self, path: Path, sha256: str) -> bool:
        """Return True for a file that is newer than this result and not among its sources."""
        if sha256 in self.hashes:
            return False
        state = path.stat()
        return max(state.st_mtime_ns, state.st_ctime_ns) > self.path.stat().st_mtime_ns  # ctime: of the copying

    def changes(self, photos: Sequence[Photo]) -> str:
        """Describe how photos differ from the sources of this result; empty if they are the same, or all gone."""
        new = sum(self.precedes(p.path, p.sha256) for p in photos)
        here = {p.sha256 for p in photos}
        gone = len(self.photo_hashes - here) if self.photo_hashes & here else 0
        words = [f"{count(new, 'photo')} came later"] if new else []
        words += [f"{count(gone, 'photo')} it was made from {'is' if gone == 1 else 'are'} gone"] if gone else []
        return ", ".join(words)


def read_photo_folder(folder: Path, camera_path: Path | None = None) -> Photos:
    """Read the photos in a folder, and check that they have the mode of a camera file."""
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


def read_camera(folder: Path) -> Result | None:
    """Read the camera file; None if there is none."""
    path = folder / CAMERA_FILE
    if not path.exists():
        return None
    try:
        camera = load_camera(path)
    except ConfigurationError as e:
        return Result(path, "cannot be used", tuple(str(e).splitlines()))
    source = _provenance(path)
    words = f"{camera.width}x{camera.height}, focal length {camera.fx:.1f} px"
    size = camera.width, camera.height
    used, left_out = _hashes(source.get("photos")), _hashes(source.get("left_out"))
    return Result(path, words, (), _hashes(source), used, left_out, options_from_provenance(source), size)


def read_rig(folder: Path) -> Result | None:
    """Read the rig file; None if there is none."""
    path = folder / RIG_FILE
    if not path.exists():
        return None
    try:
        rig = load_rig(path)
    except ConfigurationError as e:
        return Result(path, "cannot be used", tuple(str(e).splitlines()))
    source = _provenance(path)
    size = "scale free" if rig.scale_free else f"ball of {rig.ball.radius:.3f} m radius"
    words = f"{size}, {count(len(rig.targets.ids), 'target')}"
    listed = source.get("warnings")
    warnings = tuple(str(w) for w in listed) if isinstance(listed, tuple | list) else ()
    return Result(path, words, (), _hashes(source), _hashes(source.get("photos")), warnings=warnings)


def practice_film(folder: Path) -> str | None:
    """Return the film of a practice set as a source; None in the folder of a real device."""
    film = folder / FILM
    return f"dataset:{film}" if (film / "scene.json").is_file() else None


def compare_with_truth(folder: Path) -> str | None:
    """Compare the rig of a practice set with its truth, in words; None without a truth, or a rig that can be read."""
    try:
        truth = json.loads(read_bytes(folder / TRUTH_FILE, _MAX_TRUTH_BYTES, "truth"))
        rig = load_rig(folder / RIG_FILE)
        positions = {t["code"]: np.array(t["position"], dtype=float) for t in truth["targets"]}
        focal, radius = float(truth["camera"]["fx"]), float(truth["ball"]["radius"])
    except (OSError, ConfigurationError, ValueError, KeyError, TypeError):
        return None
    words = [f"focal length {100.0 * (rig.camera.fx / focal - 1.0):+.3f} %"]
    scale = radius / rig.ball.radius if rig.scale_free else 1.0
    if not rig.scale_free:
        sigma = float(np.sqrt(rig.ball.covariance[3, 3]))
        words.append(f"ball's radius {1e3 * (rig.ball.radius - radius):+.2f} ± {1e3 * sigma:.2f} mm")
    pairs = [(p, positions[c]) for c, p in zip(rig.targets.codes, rig.targets.position, strict=True) if c in positions]
    if pairs:
        worst = max(float(np.linalg.norm(scale * found - true)) for found, true in pairs)
        words.append(f"targets at most {1e3 * worst:.2f} mm")
    return f"errors against {TRUTH_FILE}: {', '.join(words)}"


def read_config(folder: Path) -> dict[str, Any]:
    """Read the configuration file by sections; ConfigurationError if it cannot be read."""
    path = folder / CONFIG_FILE
    data = without_schema(read_document(path), "configuration").data if path.exists() else {}
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigurationError(f"{path}: must be lines like `motion: ...`")
    return data


def count(n: int, thing: str) -> str:
    """Return a number with its noun."""
    return f"{n} {thing}{'' if n == 1 else 's'}"


def _provenance(path: Path) -> dict[str, Any]:
    data = read_document(path).data
    source = data.get("provenance") if isinstance(data, dict) else None
    return source if isinstance(source, dict) else {}


def _hashes(part: Any) -> frozenset[str]:
    """Collect all SHA-256 in a part of a file."""

    def walk(value: Any) -> Iterator[str]:
        if isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value):
            yield value
        for inner in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
            yield from walk(inner)

    return frozenset(walk(part))
