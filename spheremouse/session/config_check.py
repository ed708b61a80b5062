"""Check the files, devices and sizes that a configuration names, without disturbing a run.

Only files are opened, and nothing is changed.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from spheremouse import capture, output
from spheremouse.errors import ConfigurationError, SpheremouseError
from spheremouse.files.access import STATE_FOLDER
from spheremouse.files.config import key_of
from spheremouse.files.disc_map import check_fits, load_map
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.wand import load_wand
from spheremouse.files.yaml import Key, Problem
from spheremouse.finding import Finding, Verdict
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.config_reloader import AT_START
from spheremouse.session.run_config import beside
from spheremouse.session.settings import Configuration

T = TypeVar("T")
Size = tuple[int, int]  # width and height, px


@dataclass(slots=True)
class Found:
    """Problems, each with the key that names the file or device."""

    wrong: list[Problem] = field(default_factory=list)
    now: list[Problem] = field(default_factory=list)  # may be absent only now, as an unplugged device
    elsewhere: list[str] = field(default_factory=list)  # problems of the files named, with their own lines

    def refused(self, key: Key, error: SpheremouseError, path: Path | None = None) -> None:
        """Add an error. One with lines of the file at `path` names its place itself."""
        text = str(error)
        if path is None or text.startswith(f"{path}: "):
            self.wrong.append(Problem(key, text))
        else:
            self.elsewhere += text.splitlines()


def validate(file: Path, c: Configuration) -> Found:
    """Check all files and devices that the configuration `c` of a file names."""
    found = Found()
    calibrated = _files(file, c, found)
    if c.source is not None and _probe(("source",), capture.probe, c.source, found):
        kind, _, argument = c.source.partition(":")  # of other sources, no size is known before there is a picture
        size, key = _camera_size(argument, c) if kind == "v4l2" else (None, ("source",))
        where = "rig" if c.camera_file is None else "camera_file"
        if size is not None and calibrated is not None:
            problem = size_problem(size, (calibrated.width, calibrated.height), where)
            found.wrong += [] if problem is None else [Problem(key, "; ".join(problem))]
    for name, assignments in c.profiles.items():
        late = (key for key in map(key_of, assignments) if key.partition(".")[0] in AT_START)
        found.wrong += [
            Problem(("profiles", name, key), "read at the start only; move it out of the profile") for key in late
        ]
    for spec in c.outputs:
        _probe(("output",), output.probe, spec, found)
    return found


# ---- files ----


def _files(file: Path, c: Configuration, found: Found) -> InteriorOrientation | None:
    """Check rig, camera, map, balls and recordings. Return the calibrated camera, if one is named."""
    rig = _read(("rig",), beside(file, c.rig), load_rig, found)
    camera = _read(("camera_file",), beside(file, c.camera_file), load_camera, found)
    if (path := beside(file, c.map)) is not None and _folder_there(("map",), path, found) and path.exists():
        saved = _read(("map",), path, load_map, found)
        if saved is not None and rig is not None:
            _read(("map",), path, lambda p: check_fits(saved, rig, p), found)
    for k, name in enumerate(c.wand.balls):
        _read(("wand", "balls", k), beside(file, name), load_wand, found)
    folder = beside(file, c.record.folder)
    if folder is not None and folder.exists() and not folder.is_dir():
        found.wrong.append(Problem(("record", "folder"), f"{folder}: is no folder; name another"))
    return camera or (None if rig is None else rig.camera)


def _read(key: Key, path: Path | None, read: Callable[[Path], T], found: Found) -> T | None:
    if path is None:
        return None
    try:
        return read(path)
    except ConfigurationError as e:
        found.refused(key, e, path)
    return None


def _folder_there(key: Key, path: Path, found: Found) -> bool:
    if path.parent.is_dir() or path.parent == STATE_FOLDER:
        return path.parent.is_dir()
    found.wrong.append(Problem(key, f"{path.parent}: no such folder; make it, or name another"))
    return False


# ---- source and output ----


def _probe(key: Key, probe: Callable[[str], list[Finding]], spec: str, found: Found) -> bool:
    """Report the findings about a source or an output. Return False if its text is invalid."""
    try:
        findings = probe(spec)
    except SpheremouseError as e:
        found.refused(key, e)
        return False
    for f in findings:
        if f.verdict is Verdict.WRONG:
            (found.now if f.passing else found.wrong).append(Problem(key, "; ".join(filter(None, (f.text, f.advice)))))
    return True


def _camera_size(argument: str, c: Configuration) -> tuple[Size | None, Key]:
    """Return the size that is requested of a V4L2 camera, None for its largest one, and the key that names it."""
    from spheremouse.capture.v4l2 import parse

    size = parse(argument, c.camera)[1].size
    return size, ("camera", "size") if size is not None and size == c.camera.size else ("source",)


def size_problem(size: Size, calibrated: Size, where: str) -> tuple[str, str] | None:
    """Return problem and remedy if pictures have another size than the calibration of `where`; None if they agree."""
    if size == calibrated:
        return None
    return (
        f"pictures of {size[0]}x{size[1]}, but {where} was calibrated at {calibrated[0]}x{calibrated[1]}",
        f"set camera.size: [{calibrated[0]}, {calibrated[1]}], or calibrate at this size",
    )
