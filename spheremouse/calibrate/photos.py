"""Photos of a board or a device: paths and folders in, checked photos of one camera mode out.

Pixels are in the order of the sensor, without the rotation flag, as a lens is calibrated on the sensor. `image` reads a
photo when it is needed; none stays in memory.
"""

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from spheremouse import __version__
from spheremouse.calibrate.outputs import note
from spheremouse.errors import CalibrationError, os_errors_as
from spheremouse.files.pictures import MAX_BYTES, PHOTO_PIXELS, Header, Size, decode, px, read_header
from spheremouse.files.safe_files import read_bytes
from spheremouse.geometry.camera import InteriorOrientation

ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp")
_MAX_NAMED = 6

# As in the printed instructions. Three views of a plane determine a lens (Zhang 2000); four tilts, near and far, and
# four corners of the picture need more. Of the device: front, both sides, above, below, and one between.
BOARD_ENOUGH, BOARD_MOST = 10, 20  # as coverage.VIEWS
DEVICE_ENOUGH, DEVICE_MOST = 6, 12


@dataclass(frozen=True, slots=True)
class Photo:
    """A photo that can be read; `image` returns its pixels."""

    path: Path
    size: Size  # px, width and height on the sensor
    sha256: str  # of the file
    rotated: bool  # it carries a rotation flag (EXIF orientation other than 1), which is ignored


def read_photos(paths: Sequence[Path], note: Callable[[str], None] = note) -> list[Photo]:
    """Read photos, and those in folders, all of one size; CalibrationError with a line for each problem.

    Photos keep their order; those of a folder are in natural order (2 before 10). `note` gets remarks: the same photo
    twice, rotation flags.
    """
    if not paths:
        raise CalibrationError("no photos; name photos or a folder with photos")
    photos, problems = [], []
    for path in [file for given in paths for file in (_in_folder(given) if given.is_dir() else [given])]:
        try:
            photos.append(_read(path))
        except CalibrationError as e:
            problems.append(str(e))
    if problems:
        more = [f"and {len(problems) - _MAX_NAMED} more photos like these"] if len(problems) > _MAX_NAMED else []
        raise CalibrationError("\n".join(problems[:_MAX_NAMED] + more))
    photos = _without_duplicates(photos, note)
    _check_one_size(photos)
    if flagged := [p.path for p in photos if p.rotated]:
        note(f"{_names(flagged)}: with a rotation flag, which is ignored: pixels are taken as the sensor read them")
    return photos


def has_photos(folder: Path) -> bool:
    """Return True for a folder with files named like photos."""
    try:
        return any(p.suffix.lower() in ENDINGS and not p.name.startswith(".") for p in folder.iterdir())
    except OSError:
        return False


def image(photo: Photo) -> NDArray[np.uint8]:
    """Return the pixels of a photo, (h, w, 3) BGR, as on the sensor; CalibrationError if the file has changed."""
    data = _bytes(photo.path)
    if _header(photo.path, data).size != photo.size:
        raise CalibrationError(f"{photo.path}: has changed meanwhile; run it again")
    with os_errors_as(CalibrationError, f"{photo.path}"):
        return decode(data)


def check_size(photos: Sequence[Photo], camera: InteriorOrientation, camera_path: Path) -> None:
    """Raise CalibrationError if a photo has another size than the camera file, whose lens holds for one mode.

    The message names the first such photo.
    """
    mode = camera.width, camera.height
    other = next((p for p in photos if p.size != mode), None)
    if other is None:
        return
    raise CalibrationError(
        f"{other.path}: is {px(other.size)}, and {camera_path} is for the mode {px(mode)}: another mode, or turned by "
        "software; take originals in that mode, or calibrate the mode you use from photos of a board"
    )


def provenance(
    command: str, photos: Sequence[Photo], left_out: Mapping[int, str], more: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the provenance of a file made from photos: program, date, `more`, and the photos used and left out.

    `left_out` has the reason for each of their indices.
    """
    return {
        "made_by": f"spheremouse {__version__}, {command}",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        **more,
        "photos": [{"file": p.path.name, "sha256": p.sha256} for i, p in enumerate(photos) if i not in left_out],
        "left_out": [
            {"file": photos[i].path.name, "why": why, "sha256": photos[i].sha256} for i, why in left_out.items()
        ],
    }


# ---- which files ----


def _in_folder(folder: Path) -> list[Path]:
    with os_errors_as(CalibrationError, f"{folder}: cannot be read"):
        files = [p for p in folder.iterdir() if not p.name.startswith(".") and p.is_file()]
    if found := sorted((p for p in files if p.suffix.lower() in ENDINGS), key=_natural):
        return found
    raise CalibrationError(
        f"{folder}: no photos in it ({', '.join(ENDINGS)}); put them there, convert others (HEIC) to JPEG, "
        "or name another folder"
    )


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Sorts IMG_2 before IMG_10."""
    parts = re.split(r"(\d+)", path.name.lower())
    return [(int(p), "") if i % 2 else (0, p) for i, p in enumerate(parts)], path.name


def _without_duplicates(photos: list[Photo], note: Callable[[str], None]) -> list[Photo]:
    first: dict[str, Photo] = {}
    for photo in photos:
        before = first.setdefault(photo.sha256, photo)
        if before is not photo and photo.path.absolute() != before.path.absolute():
            note(f"{photo.path}: the same photo as {before.path}; used once")
    return list(first.values())


def _check_one_size(photos: Sequence[Photo]) -> None:
    sizes = Counter(p.size for p in photos).most_common()
    if len(sizes) == 1:
        return
    most = sizes[0][0]
    lines = [
        f"{_names([p.path for p in photos if p.size == size])}: {px(size)}, and the others {px(most)}: another mode or "
        "zoom, or turned by software; take originals in the mode you calibrate, and leave the rest out"
        for size, _ in sizes[1:]
    ]
    raise CalibrationError("\n".join(lines))


# ---- one file ----


def _read(path: Path) -> Photo:
    """Read a photo. Raise CalibrationError, with the remedy, if it is damaged or cannot be used."""
    data = _bytes(path)
    size, orientation = _header(path, data, to_the_end=True)
    if data.startswith(b"\xff\xd8"):
        try:
            simplejpeg.decode_jpeg(data, colorspace="GRAY", strict=True)
        except ValueError as e:
            if "remature end" in str(e):
                problem = "ends before the picture does; copy it from the camera again, or leave it out"
                raise CalibrationError(f"{path}: {problem}") from None
    if orientation != 1 and data[:2] in (b"II", b"MM"):  # the decoders always rotate a TIFF
        raise CalibrationError(f"{path}: a TIFF with a rotation flag; save it without one, or take the JPEG")
    return Photo(path, size, hashlib.sha256(data).hexdigest(), orientation != 1)


def _bytes(path: Path) -> bytes:
    """Read a photo's bytes. Raise CalibrationError if it is missing, unreadable, too large or empty."""
    try:
        data = read_bytes(path, MAX_BYTES, "photo")
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such photo or folder; check the path") from None
    except OSError as e:
        raise CalibrationError(f"{path}: cannot be read: {e.strerror or e}") from None
    except ValueError:  # a NUL in the name
        raise CalibrationError(f"{str(path)!r}: no such photo or folder; check the path") from None
    if not data:
        raise CalibrationError(f"{path}: an empty file; copy it from the camera again, or leave it out")
    return data


def _header(path: Path, data: bytes, *, to_the_end: bool = False) -> Header:
    with os_errors_as(CalibrationError, f"{path}"):
        return read_header(data, PHOTO_PIXELS, to_the_end=to_the_end)


# ---- words ----


def _names(paths: Sequence[Path]) -> str:
    names = [str(paths[0]), *(p.name for p in paths[1:_MAX_NAMED])]
    more = f" and {len(paths) - _MAX_NAMED} more" if len(paths) > _MAX_NAMED else ""
    return ", ".join(names) + more
