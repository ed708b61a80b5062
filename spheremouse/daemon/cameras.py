"""From `KIND:ARGUMENT` to what the capture thread opens, again and again."""

import sys
from collections.abc import Callable
from pathlib import Path

from spheremouse.daemon.capture import Streamed
from spheremouse.daemon.lock import Claimed, claimed
from spheremouse.daemon.plan import Plan
from spheremouse.source import Camera, Source, open_source


def is_v4l2(spec: str) -> bool:
    """Is it a camera that hands over its own buffers, stamps and all?"""
    return spec.partition(":")[0] == "v4l2"


def opener(plan: Plan, first: Source | None = None) -> Callable[[], Camera]:
    """What opens the camera of a plan; the first time it is `first`, where that has been opened already."""
    kind, _, argument = plan.source.partition(":")
    if kind == "v4l2":
        from spheremouse.source import v4l2

        return lambda: v4l2.open_camera(argument, plan.configuration.camera)
    waiting = [] if first is None else [first]

    def open_again() -> Camera:
        source = waiting.pop() if waiting else open_source(plan.source, realtime=True)
        return Streamed(source, plan.source)

    return open_again


def held(plan: Plan, open_camera: Callable[[], Camera]) -> Callable[[], Camera]:
    """The same, with the device's node held against a second daemon. SourceError where it is held by one already."""
    if node_of(plan) is None:
        return open_camera

    def open_held() -> Camera:
        node = node_of(plan)  # anew each time: a camera that comes back may be another node
        return open_camera() if node is None else Claimed(node, open_camera)

    with claimed(node_of(plan) or Path("/nonexistent")):
        return open_held


def node_of(plan: Plan) -> Path | None:
    """The device of a live source on Linux."""
    kind, _, argument = plan.source.partition(":")
    name = argument.partition(",")[0].strip()
    if kind not in ("v4l2", "opencv") or not sys.platform.startswith("linux"):
        return None
    return Path(f"/dev/video{name}") if name.isdecimal() else Path(name)
