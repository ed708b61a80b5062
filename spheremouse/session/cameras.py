"""Open the camera of a plan, as often as it is needed."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from spheremouse.capture import Camera, OpenCamera, Source, open_source
from spheremouse.capture.fetch import Streamed
from spheremouse.capture.lock import locked, locked_camera
from spheremouse.capture.settings import CameraSettings
from spheremouse.session.run_config import RunConfig


def is_camera(spec: str) -> bool:
    """Return True for a device. A user may unplug it and plug it in again."""
    return spec.partition(":")[0] in ("v4l2", "opencv")


def opener(
    plan: RunConfig, open_recording: Callable[[RunConfig], Source], opened: list[Source] | None = None
) -> OpenCamera:
    """Return a function that opens a plan's camera and locks its node. It takes a source that is `opened` already."""

    def open_it() -> Camera:
        kind, _, argument = plan.source.partition(":")
        if kind == "v4l2":
            from spheremouse.capture import v4l2

            return v4l2.open_camera(argument, plan.configuration.camera)
        if opened:
            source = opened.pop()
        elif is_camera(plan.source):
            source = open_source(plan.source, realtime=True)
        else:
            source = open_recording(plan)
        return Streamed(source, plan.source)

    def open_held() -> AbstractContextManager[Camera]:
        node = node_of(plan)  # each time: a camera that comes back may have another node
        return open_it() if node is None else locked_camera(node, open_it)

    return open_held


@contextmanager
def looked_through(source: str, settings: CameraSettings, realtime: bool = False) -> Iterator[Source]:
    """Open a source for pictures, not for motion. A camera gets the `settings`, and its node is locked.

    Raises SourceError if another daemon has the camera.
    """
    kind, _, argument = source.partition(":")
    node = node_of_source(source)
    with nullcontext() if node is None else locked(node):
        if kind == "v4l2":
            from spheremouse.capture import v4l2

            opened = v4l2.stream(argument, settings)
        else:
            opened = open_source(source, realtime=realtime)
        with opened as stream:
            yield stream


def refuse_if_taken(plan: RunConfig) -> None:
    """Raise SourceError if another daemon has the camera."""
    with held(plan):
        pass


def held(plan: RunConfig) -> AbstractContextManager[None]:
    """Lock the camera's node before it is opened. SourceError if another daemon has it."""
    node = node_of(plan)
    return nullcontext() if node is None else locked(node)


def node_of(plan: RunConfig) -> Path | None:
    """Return the device node of a plan's camera; None for another source, or outside Linux."""
    return node_of_source(plan.source)


def node_of_source(source: str) -> Path | None:
    """Return the device node of a source; None if it is no camera, or outside Linux."""
    kind, _, argument = source.partition(":")
    name = argument.partition(",")[0].strip()
    if kind not in ("v4l2", "opencv") or not sys.platform.startswith("linux"):
        return None
    return Path(f"/dev/video{name}") if name.isdecimal() else Path(name)
