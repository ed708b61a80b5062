"""The camera that a command names where nobody has named one, and the size it is asked for."""

import sys
from pathlib import Path

_BY_ID = Path("/dev/v4l/by-id")


def usual_camera(by_id: Path = _BY_ID) -> str:
    """Its source: the first camera by the name that it keeps; by number where the system has no such names."""
    if not sys.platform.startswith("linux"):
        return "opencv:0"
    try:
        named = sorted(by_id.glob("*-video-index0"))
    except OSError:
        named = []
    return f"v4l2:{named[0] if named else '/dev/video0'}"


def in_size(source: str, size: tuple[int, int] | None) -> str:
    """The source of a camera with its size, where it says none itself and can be asked for one."""
    if size is None or source.partition(":")[0] not in ("v4l2", "opencv") or "width=" in source:
        return source
    return f"{source},width={size[0]},height={size[1]}"
