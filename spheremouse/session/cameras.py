"""Cameras by their names: their nodes, which are locked, and pictures of them."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from spheremouse.capture import Source, open_source
from spheremouse.capture.lock import locked
from spheremouse.capture.settings import CameraSettings


def is_camera(spec: str) -> bool:
    """Return True for a device. A user may unplug it and plug it in again."""
    return spec.partition(":")[0] in ("v4l2", "opencv")


@contextmanager
def looked_through(source: str, settings: CameraSettings, realtime: bool = False) -> Iterator[Source]:
    """Open a source for pictures, not for motion. A camera gets the `settings`, and its node is locked.

    Raises SourceError if another daemon has the camera.
    """
    kind, _, argument = source.partition(":")
    node = node_of(source)
    with nullcontext() if node is None else locked(node):
        if kind == "v4l2":
            from spheremouse.capture import v4l2

            opened = v4l2.stream(argument, settings)
        else:
            opened = open_source(source, realtime=realtime)
        with opened as stream:
            yield stream


def refuse_if_taken(source: str) -> None:
    """Raise SourceError if another daemon has the camera."""
    node = node_of(source)
    if node is not None:
        with locked(node):
            pass


def node_of(source: str) -> Path | None:
    """Return the device node of a source; None if it is no camera, or outside Linux."""
    kind, _, argument = source.partition(":")
    name = argument.partition(",")[0].strip()
    if kind not in ("v4l2", "opencv") or not sys.platform.startswith("linux"):
        return None
    return Path(f"/dev/video{name}") if name.isdecimal() else Path(name)
