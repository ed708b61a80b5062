"""What a configuration names, looked at as far as that disturbs nobody: kinds, files, devices, the camera's sizes.

A run reads the same when it starts; here nothing is opened but files and the camera's node, and nothing is changed.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from spheremouse import capture as sources
from spheremouse import output as outputs
from spheremouse.ball.rig import Rig
from spheremouse.errors import ConfigurationError, OutputError, SourceError, SpheremouseError
from spheremouse.files.disc_map import check_fits, load_map
from spheremouse.files.registry import check
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.wand import load_wand
from spheremouse.files.yaml import Key, Problem
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.cameras import node_of_source
from spheremouse.session.plan import beside
from spheremouse.session.settings import Configuration

T = TypeVar("T")
Size = tuple[int, int]  # width and height, px

_NODES = Path("/sys/class/video4linux")
_UINPUT = Path("/dev/uinput")
_STATE = Path("/var/lib/spheremouse")  # systemd makes it at the service's first start


@dataclass(slots=True)
class Found:
    """What is not as it is named."""

    wrong: list[Problem] = field(default_factory=list)
    now: list[Problem] = field(default_factory=list)  # may be only so now: what is unplugged comes back
    elsewhere: list[str] = field(default_factory=list)  # problems of the files named, with their own lines

    def refused(self, key: Key, error: SpheremouseError, path: Path | None = None) -> None:
        """An error of what `key` names; one that tells lines of the file at `path` says where by itself."""
        told = str(error)
        if path is None or told.startswith(f"{path}: "):
            self.wrong.append(Problem(key, told))
        else:
            self.elsewhere += told.splitlines()


def look(file: Path, c: Configuration) -> Found:
    """Everything that the configuration `c` of a file names."""
    found = Found()
    calibrated = _files(file, c, found)
    if c.source is not None and _known(("source",), sources, "source", c.source, SourceError, found):
        size, key = _planned_size(c, found)
        there = None if calibrated is None else (calibrated.width, calibrated.height)
        if size is not None and there is not None and size != there:
            found.wrong.append(Problem(key, _other_size(size, there, c)))
    if c.output is not None and _known(("output",), outputs, "output", c.output, OutputError, found):
        _output(c.output, found)
    return found


# ---- files ----


def _files(file: Path, c: Configuration, found: Found) -> InteriorOrientation | None:
    """Rig, camera, map, balls and recordings; gives the camera as calibrated, where one is named."""
    rig = _read(("rig",), beside(file, c.rig), _rig, found)
    camera = _read(("camera_file",), beside(file, c.camera_file), load_camera, found)
    if (path := beside(file, c.map)) is not None and _folder_there(("map",), path, found) and path.exists():
        saved = _read(("map",), path, load_map, found)
        if saved is not None and rig is not None:
            _read(("map",), path, lambda p: check_fits(saved, rig, p), found)
    for k, name in enumerate(c.wand.balls):
        _read(("wand", "balls", k), beside(file, name), load_wand, found)
    if c.wand.axes and c.wand.axes != "-":
        _folder_there(("wand", "axes"), Path(c.wand.axes), found)
    folder = beside(file, c.record.folder)
    if folder is not None and folder.exists() and not folder.is_dir():
        found.wrong.append(Problem(("record", "folder"), f"{folder}: is no folder; name another"))
    return camera or (None if rig is None else rig.camera)


def _rig(path: Path) -> Rig:
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file; calibrate (`spheremouse calibrate next`), or check the path")
    return load_rig(path)


def _read(key: Key, path: Path | None, read: Callable[[Path], T], found: Found) -> T | None:
    if path is None:
        return None
    try:
        return read(path)
    except ConfigurationError as e:
        found.refused(key, e, path)
    return None


def _folder_there(key: Key, path: Path, found: Found) -> bool:
    """Is there a folder for a file that a run writes?"""
    if path.parent.is_dir() or path.parent == _STATE:
        return path.parent.is_dir()
    found.wrong.append(Problem(key, f"{path.parent}: no such folder; make it, or name another"))
    return False


# ---- source and output ----


def _known(key: Key, package: Any, what: str, spec: str, error: type[SpheremouseError], found: Found) -> bool:
    """Is there this kind, and no slip in what it is told?"""
    try:
        check(package, what, spec, error)
    except SpheremouseError as e:
        found.refused(key, e)
        return False
    return True


def _planned_size(c: Configuration, found: Found) -> tuple[Size | None, Key]:
    """Size of the pictures, where it is known before there is one, and the key that says so."""
    kind, _, argument = (c.source or "").partition(":")
    if kind in ("dataset", "video") and not os.path.exists(argument):
        seen = "" if Path(argument).is_absolute() else ", seen from this folder"
        report = found.wrong if Path(argument).is_absolute() else found.now
        report.append(Problem(("source",), f"{argument}: not there{seen}; check the path"))
    node = node_of_source(c.source or "") if kind == "opencv" and _NODES.is_dir() else None
    if node is not None and not node.exists():
        found.now.append(Problem(("source",), f"{node} is not there now; plug the camera in"))
    if kind != "v4l2":
        return None, ("source",)
    return _camera_size(argument, c, found)


def _camera_size(argument: str, c: Configuration, found: Found) -> tuple[Size | None, Key]:
    from spheremouse.capture import v4l2

    _, asked = v4l2.parse(argument, c.camera)
    key: Key = ("camera", "size") if c.camera.size is not None and asked.size == c.camera.size else ("source",)
    if _is_software(argument.partition(",")[0]):
        return asked.size, key
    try:
        return v4l2.planned_size(argument, c.camera), key
    except SourceError as e:
        plain = replace(c.camera, size=None, format="auto")
        there = _is_there(argument.partition(",")[0], plain)
        (found.wrong if there else found.now).append(Problem(key if there else ("source",), _said(e, there)))
    return asked.size, key


def _is_software(name: str) -> bool:
    """Is it a camera without hardware? v4l2loopback ends the stream of who films when somebody else closes the node."""
    from spheremouse.capture.v4l2.device import find

    return "/devices/virtual/" in os.path.realpath(_NODES / find(name).resolve().name)


def _is_there(name: str, settings: Any) -> bool:
    """Is it the wish that cannot be had, and not the camera?"""
    from spheremouse.capture import v4l2

    try:
        v4l2.planned_size(name, settings)
    except SourceError:
        return False
    return True


def _said(error: SourceError, there: bool) -> str:
    return str(error) if there else f"not there now, or not to be opened: {error}"


def _other_size(size: Size, there: Size, c: Configuration) -> str:
    where = "camera_file" if c.camera_file is not None else "rig"
    return (
        f"pictures of {size[0]}x{size[1]}, but {where} was calibrated at {there[0]}x{there[1]}; "
        f"set camera.size: [{there[0]}, {there[1]}], or calibrate at this size"
    )


def _output(spec: str, found: Found) -> None:
    """The device behind an output; `auto` and `desktop` take what is there at the start."""
    kind, _, argument = spec.partition(":")
    key: Key = ("output",)
    if kind == "uinput" and not _UINPUT.exists():
        found.now.append(Problem(key, f"{_UINPUT} is not there now; as root: modprobe uinput"))
    if kind == "serial":
        from spheremouse.output.serial import check as parsed
        from spheremouse.output.serial.ports import find_board

        name, identifier, *_ = parsed(argument)
        try:
            port = find_board(identifier) if name == "auto" else name
        except OutputError as e:
            found.now.append(Problem(key, f"not there now: {e}"))
        else:
            if os.name == "posix" and not os.path.exists(port):
                found.now.append(Problem(key, f"{port} is not there now; plug the board in, or write serial:auto"))
    if kind == "text" and argument not in ("", "-"):
        _folder_there(key, Path(argument), found)
