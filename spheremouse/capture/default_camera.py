"""The camera that a command uses if the user names none, and its image size."""

import sys
from pathlib import Path

_BY_ID = Path("/dev/v4l/by-id")


def default_camera(by_id: Path = _BY_ID) -> str:
    """Return the source of the first camera, by its persistent name if the system has one, otherwise by its number."""
    if not sys.platform.startswith("linux"):
        return "opencv:0"
    try:
        named = sorted(by_id.glob("*-video-index0"))
    except OSError:
        named = []
    return f"v4l2:{named[0] if named else '/dev/video0'}"


def in_size(source: str, size: tuple[int, int] | None) -> str:
    """Return the source with a size, unless it already has one or is no camera."""
    if size is None or source.partition(":")[0] not in ("v4l2", "opencv") or "width=" in source:
        return source
    return f"{source},width={size[0]},height={size[1]}"
