"""Check the files and devices that a configuration names, without disturbing a run.

Only files are opened, and nothing is changed.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from spheremouse import capture, output
from spheremouse.ball.build import map_kind
from spheremouse.errors import ConfigurationError, SpheremouseError
from spheremouse.files.access import STATE_FOLDER
from spheremouse.files.ball_map import check_fits, load_map
from spheremouse.files.config import key_of
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.wand import load_wand
from spheremouse.files.yaml import Key, Problem
from spheremouse.finding import Finding, Verdict
from spheremouse.session.config_reloader import AT_START
from spheremouse.session.run_config import beside, contradictions
from spheremouse.session.settings import Configuration

T = TypeVar("T")


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
    _files(file, c, found)
    for source in c.sources:
        _probe(("source",), capture.probe, source, found)
    found.wrong += [Problem((key,), problem) for key, problem in contradictions(c)]
    for name, assignments in c.profiles.items():
        at_start = (key for key in map(key_of, assignments) if key.partition(".")[0] in AT_START)
        found.wrong += [
            Problem(("profiles", name, key), "read at the start only; move it out of the profile") for key in at_start
        ]
    for spec in c.outputs:
        _probe(("output",), output.probe, spec, found)
    return found


# ---- files ----


def _files(file: Path, c: Configuration, found: Found) -> None:
    rigs = [_read_if_valid(("rig",), beside(file, name), load_rig, found) for name in c.rigs]
    rig = rigs[0] if rigs else None
    camera, size = _read_if_valid(("camera_file",), beside(file, c.camera_file), load_camera, found), c.camera.size
    for known in [each.camera for each in rigs if each is not None] if camera is None else [camera]:
        if size is not None and size != (known.width, known.height):
            problem = f"{size[0]}x{size[1]}: the camera was calibrated at {known.width}x{known.height}; set that size"
            found.wrong.append(Problem(("camera", "size"), problem))
    if (path := beside(file, c.map)) is not None and _folder_there(("map",), path, found) and path.exists():
        saved = _read_if_valid(("map",), path, load_map, found)
        if saved is not None and rig is not None:
            _read_if_valid(("map",), path, lambda p: check_fits(saved, rig, p, map_kind(rig, c)), found)
    for k, name in enumerate(c.wand.balls):
        _read_if_valid(("wand", "balls", k), beside(file, name), load_wand, found)
    folder = beside(file, c.record.folder)
    if folder is not None and folder.exists() and not folder.is_dir():
        found.wrong.append(Problem(("record", "folder"), f"{folder}: is no folder; name another"))


def _read_if_valid(key: Key, path: Path | None, read: Callable[[Path], T], found: Found) -> T | None:
    """Return what `read` reads from a path; None without a path, or if it is refused."""
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


def _probe(key: Key, probe: Callable[[str], list[Finding]], spec: str, found: Found) -> None:
    try:
        findings = probe(spec)
    except SpheremouseError as e:
        found.refused(key, e)
        return
    for f in findings:
        if f.verdict is Verdict.WRONG:
            (found.now if f.passing else found.wrong).append(Problem(key, "; ".join(filter(None, (f.text, f.advice)))))
