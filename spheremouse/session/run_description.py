"""The description of a run for the files of its outputs: configuration, calibrated device, source and versions."""

import hashlib
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from spheremouse import __version__
from spheremouse.files.dataset.format import FILES
from spheremouse.session.run_config import RunConfig


def describe_run(plan: RunConfig, source: str = "") -> dict[str, Any]:
    """Return the description of a run as JSON; `source` is the camera or recording in words.

    Files are given with the SHA-256 of their contents, None if they cannot be read. That of a recording takes a second
    a gigabyte.
    """
    return {
        "configuration": asdict(plan.configuration),
        "rig": _file(plan.rig_path),  # None: the source brings its own
        "camera_file": _file(plan.camera_path),
        "balls": [_file(path) for path in plan.ball_paths],
        "map": None if plan.map_path is None else str(plan.map_path.absolute()),
        "source": {"spec": plan.source, "description": source, "recording": _recording(plan.source)},
        "outputs": list(plan.outputs),
        "versions": {
            "spheremouse": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
            "system": platform.platform(),
        },
    }


def _recording(spec: str) -> dict[str, Any] | None:
    """Return path and hash of a recording: of a folder, the hash of the lines `SHA-256 NAME` of its files, by name."""
    kind, _, argument = spec.partition(":")
    path = Path(argument)
    if kind not in ("dataset", "video") or not argument:
        return None
    if not path.is_dir():
        return _file(path)
    files = sorted(p for name in FILES for p in ((path / name).rglob("*") if name == "frames" else (path / name,)))
    lines = [f"{_sha256(file)}  {file.relative_to(path).as_posix()}\n" for file in files if file.is_file()]
    return {"file": str(path.absolute()), "sha256": hashlib.sha256("".join(lines).encode()).hexdigest()}


def _file(path: Path | None) -> dict[str, Any] | None:
    return None if path is None else {"file": str(path.absolute()), "sha256": _sha256(path)}


def _sha256(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
