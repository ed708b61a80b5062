"""A calibration's folder: photos, the files made from them with their provenance, and commands for all of them."""

import json
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spheremouse.ball.rig import Rig
from spheremouse.calibrate.board import board_options
from spheremouse.calibrate.photos import Photo, check_size, read_photos
from spheremouse.capture.nodes import default_camera, in_size
from spheremouse.errors import CalibrationError, ConfigurationError, format_count
from spheremouse.files.calibration_folder import (
    BOARD,
    CAMERA_FILE,
    CONFIG_FILE,
    DEVICE,
    DEVICE_FILE,
    RIG_FILE,
    default_folder,
)
from spheremouse.files.device import is_untouched
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.safe_files import read_bytes
from spheremouse.files.yaml import read_document, without_schema
from spheremouse.geometry.camera import InteriorOrientation

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
        return f"{format_count(len(self.photos), 'photo')} of {width}x{height} in {self.folder}"


@dataclass(frozen=True, slots=True)
class Result:
    """A file that a calibration wrote, with its provenance."""

    path: Path
    found: str  # in words
    problem: tuple[str, ...] = ()  # why it cannot be used
    provenance: dict[str, Any] = field(default_factory=dict)
    size: tuple[int, int] | None = None  # px, of a camera

    def hashes(self, part: str) -> frozenset[str]:
        """Return all SHA-256 in a part of the provenance; empty without the part."""

        def walk(value: Any) -> Iterator[str]:
            if isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value):
                yield value
            for inner in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
                yield from walk(inner)

        return frozenset(walk(self.provenance.get(part)))

    def changes(self, photos: Sequence[Photo]) -> str:
        """Describe how photos differ from the sources of this result; empty if they are the same, or all gone."""
        used, present = self.hashes("photos"), {p.sha256 for p in photos}
        new = len(present - used - self.hashes("left_out")) if used else 0
        removed = len(used - present) if used & present else 0
        words = [f"{format_count(new, 'photo')} came later"] if new else []
        if removed:
            words.append(f"{format_count(removed, 'photo')} it was made from {'is' if removed == 1 else 'are'} gone")
        return ", ".join(words)


def read_photo_folder(folder: Path, camera_path: Path | None = None) -> Photos:
    """Read the photos in a folder, and check that they have the mode of a camera file."""
    try:
        has_files = any(p.is_file() and not p.name.startswith(".") for p in folder.iterdir())
        photos = read_photos([folder], note=lambda _: None) if has_files else []
        if photos and camera_path is not None:
            check_size(photos, load_camera(camera_path), camera_path)
    except OSError:
        return Photos(folder)
    except CalibrationError as e:
        return Photos(folder, problem=tuple(str(e).splitlines()))
    return Photos(folder, tuple(photos))


def read_result(path: Path, load: Callable[[Path], InteriorOrientation | Rig]) -> Result | None:
    """Return a calibration's file with its content in words, or with its problem; None if it is missing."""
    if not path.exists():
        return None
    try:
        content = load(path)
    except ConfigurationError as e:
        return Result(path, "cannot be used", tuple(str(e).splitlines()))
    if isinstance(content, Rig):
        camera = content.camera
        size = "scale free" if content.scale_free else f"ball of {content.ball.radius:.3f} m radius"
        words = f"{size}, {format_count(len(content.targets.ids), 'target')}"
    else:
        camera, words = content, f"{content.width}x{content.height}, focal length {content.fx:.1f} px"
    data = read_document(path).data
    source = data.get("provenance") if isinstance(data, dict) else None
    return Result(path, words, (), source if isinstance(source, dict) else {}, (camera.width, camera.height))


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


# ---- commands for the folder, ready to copy into a terminal ----


def init_command(folder: Path) -> str:
    return calibrate_command("init", folder)


def next_command(folder: Path) -> str:
    """Return the command that shows the next step."""
    return calibrate_command("next", *_unless_default(folder))


def photos_command(folder: Path, kind: Literal["camera", "device"], more: Sequence[str] = ()) -> str:
    """Return the command that takes photos into the folder."""
    return calibrate_command("photos", *_unless_default(folder), "--for", kind, *more)


def camera_command(folder: Path, board: Sequence[str] = (), *, again: bool = False) -> str:
    """Return the command that makes camera.yaml from the photos in the folder."""
    options = board or board_options(folder)
    return calibrate_command("camera", folder / BOARD, *options, "--out", folder / CAMERA_FILE, again=again)


def device_command(folder: Path, *, again: bool = False) -> str:
    """Return the command that makes rig.yaml from the photos in the folder."""
    options = ("--device", folder / DEVICE_FILE, "--camera", folder / CAMERA_FILE)
    return calibrate_command("device", folder / DEVICE, *options, "--out", folder / RIG_FILE, again=again)


def rolling_command(folder: Path, *, again: bool = False) -> str:
    """Return the command that makes rig.yaml without photos of the device."""
    options: list[str | Path] = ["--source", _source(folder), "--camera", folder / CAMERA_FILE]
    if (folder / DEVICE_FILE).exists() and not is_untouched(folder / DEVICE_FILE):  # its targets give the axes
        options += ["--device", folder / DEVICE_FILE]
    return calibrate_command("rolling", *options, "--out", folder / RIG_FILE, again=again)


def axes_command(rig: Path, source: str | None = None) -> str:
    """Return the command that finds the player's position, by default with the camera that took the photos."""
    folder = rig.parent
    config = _config_or_empty(folder)
    options = [] if rig.name == RIG_FILE and "rig" in config else ["--rig", str(rig)]
    if source or practice_film(folder) or "source" not in config:
        options += ["--source", source or practice_film(folder) or _source(folder)]
    return shlex.join(["spheremouse", "axes", "--config", str(folder / CONFIG_FILE), *options])


def calibrate_command(*words: str | Path, again: bool = False) -> str:
    """Return a command of `spheremouse calibrate`; `again` replaces its files."""
    return shlex.join(["spheremouse", "calibrate", *map(str, words), *(["--force"] if again else [])])


def _unless_default(folder: Path) -> list[Path]:
    return [] if folder == default_folder() else [folder]


def _source(folder: Path) -> str:
    """Return the camera that took the photos, in the calibrated mode."""
    camera, source = read_result(folder / CAMERA_FILE, load_camera), _config_or_empty(folder).get("source")
    return in_size(source if isinstance(source, str) else default_camera(), None if camera is None else camera.size)


def _config_or_empty(folder: Path) -> dict[str, Any]:
    """Read the configuration; empty if it is damaged, which the checklist reports in a step of its own."""
    try:
        return read_config(folder)
    except ConfigurationError:
        return {}
