"""Read the figures that the calibrations write as JSON, as rows for people."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from spheremouse.errors import ConfigurationError
from spheremouse.files import plain_json
from spheremouse.files.safe_files import read_bytes

_MAX_BYTES = 5_000_000
_MAX_FILES = 50
_LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_PIXEL_PARAMETERS = 4  # of the lens parameters are in px

Row = tuple[str, str, str]  # quantity, value with its unit, standard deviation with its unit


def read_figures(folders: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the reports of calibrations in these folders, at most `_MAX_FILES`, in the order of their paths.

    A report has `file`, `kind`, `date`, `rows`, `photos` and `advice`. A photo has `file`, `rms_px`, `points`, and
    `why` it is left out. A damaged report has `file` and `problem`. Other JSON files count as damaged reports if a YAML
    file of the same name is beside them, and are left out otherwise. A missing folder has no reports. Raises
    ConfigurationError if a folder cannot be read.
    """
    try:
        files = {path.resolve() for folder in folders if folder.is_dir() for path in folder.iterdir()}
    except OSError as e:
        raise ConfigurationError(f"{e.filename}: cannot be read ({e.strerror})") from None
    found = [_read_report(path) for path in sorted(f for f in files if f.suffix == ".json")[:_MAX_FILES]]
    return [each for each in found if "problem" not in each or os.path.exists(Path(each["file"]).with_suffix(".yaml"))]


def _read_report(path: Path) -> dict[str, Any]:
    try:
        data = plain_json.loads(read_bytes(path, _MAX_BYTES, "report"))
        written = time.strftime("%Y-%m-%d %H:%M", time.localtime(path.stat().st_mtime))
        return {
            "file": str(path), "kind": _kind_of(data)[0], "date": written, "rows": list(figure_rows(data)),
            "photos": list(photo_rows(data)),
            "advice": [str(a["text"] if isinstance(a, dict) else a) for a in data.get("advice", [])],
        }  # fmt: skip
    except OSError as e:
        return {"file": str(path), "problem": e.strerror or str(e)}
    except (StopIteration, ValueError, TypeError, KeyError, IndexError, AttributeError):
        return {
            "file": str(path),
            "problem": "is no valid report of a calibration; calibrate again, or remove the file",
        }


def figure_rows(data: dict[str, Any]) -> Iterator[Row]:
    """Yield the figures of a calibration as rows. Raises StopIteration for other data."""
    return _kind_of(data)[1](data)


def _kind_of(data: dict[str, Any]) -> "tuple[str, Callable[[dict[str, Any]], Iterator[Row]]]":
    return next((kind, rows) for kind, key, rows in _KINDS if key in data)


def photo_rows(data: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield `file`, `rms_px`, `points` and `why` of the photos, also of those that are left out."""
    for photo in [*data.get("board_views", []), *data.get("photos", []), *data.get("skipped", [])]:
        rms, points = photo.get("rms_px"), photo.get("corners", photo.get("points"))
        yield {
            "file": str(photo["file"]),
            "rms_px": None if rms is None else float(rms),
            "points": None if points is None else int(points),
            "why": str(photo.get("why") or ""),
        }


def _camera_rows(data: dict[str, Any]) -> Iterator[Row]:
    camera = data["camera"]
    yield "picture", f"{int(camera['width'])}x{int(camera['height'])} px", ""
    values = [*(camera[name] for name in _LENS[:_PIXEL_PARAMETERS]), *camera["dist"]]
    for k, (name, value, sigma) in enumerate(zip(_LENS, values, camera["sigma"], strict=True)):
        yield (
            (name, f"{value:.2f} px", f"{sigma:.2f} px")
            if k < _PIXEL_PARAMETERS
            else (name, f"{value:.6f}", f"{sigma:.6f}")
        )
    yield "corners, RMS", f"{data['rms_px']:.3f} px", ""


def _device_rows(data: dict[str, Any]) -> Iterator[Row]:
    unit, size = ("radii", 1.0) if data["scale_free"] else ("mm", 1e3)
    ball = data["ball"]
    for axis, value in zip("XYZ", ball["center"], strict=True):
        yield f"ball {axis}", f"{size * value:.2f} {unit}", f"{size * ball['sigma'][axis]:.2f} {unit}"
    yield "ball's radius", f"{size * ball['radius']:.2f} {unit}", f"{size * ball['sigma']['R']:.2f} {unit}"
    for target in data["targets"]:
        place, sigma = (", ".join(f"{size * v:.2f}" for v in target[key]) for key in ("position", "sigma"))
        yield f"target {target['code']}", f"{place} {unit}", f"{sigma} {unit}"
    for d in data["distances"]:
        words = f"{1e3 * d['adjusted']:.1f} mm, {1e3 * d['residual']:+.1f} mm from the tape"
        yield f"{d['from']} to {d['to']}", words, f"{1e3 * d['adjusted_sigma']:.1f} mm"
    yield "points, RMS", f"{data['rms_px']:.3f} px", ""


def _rolling_rows(data: dict[str, Any]) -> Iterator[Row]:
    size, unit = (1.0, "R") if data["scale"] == "free" else (1e3, "mm")
    digits = 2 if unit == "mm" and data["ball"]["radius"] >= 0.1 else 4
    yield "distance over radius", f"{data['ratio']:.6f}", f"{data['ratio_sigma']:.6f}"
    yield "direction of the centre", "", f"{data['center_direction_sigma_deg']:.4f}°"
    places = [row[3] for row in data["T_obj_cam"][:3]], data["sigma_position"]
    place, sigma = (" ".join(f"{size * v:.{digits}f}" for v in values) for values in places)
    yield "camera's place", f"{place} {unit}", f"{sigma} {unit}"
    yield "camera's angles", "", ", ".join(f"{v:.3f}°" for v in data["sigma_angle_deg"])
    yield "axes", str(data["axes"]), ", ".join(f"{v:.3f}°" for v in data["axes_sigma_deg"])
    if unit == "mm":
        radius, sigma = (f"{size * data['ball'][key]:.{digits}f} mm" for key in ("radius", "sigma"))
        yield "ball's radius", radius, sigma
    if data["eccentric"]:
        off, sigma = (f"{size * data[key]:.{digits}f} {unit}" for key in ("eccentricity", "eccentricity_sigma"))
        yield "ball off its pivot by", off, sigma
    if 0.0 < data["readout_sigma_s"] < 1e-3 and data["readout_s"] > 2e-3:  # a rolling shutter
        yield "readout of all rows", f"{1e3 * data['readout_s']:.1f} ms", f"{1e3 * data['readout_sigma_s']:.1f} ms"
    yield "frames used", f"{int(data['frames'])} of {int(data['frames_given'])}", ""
    yield "sightings of discs", f"{int(data['sightings'])}, {int(data['rejected'])} of them set aside", ""
    yield "discs, RMS", f"{data['rms_px']:.3f} px", ""


# kind, a key that only its figures have, and their rows
_KINDS: tuple[tuple[str, str, Callable[[dict[str, Any]], Iterator[Row]]], ...] = (
    ("camera", "board_views", _camera_rows),
    ("device", "ring_scale", _device_rows),
    ("rolling", "center_direction", _rolling_rows),
)
