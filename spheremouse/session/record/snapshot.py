"""One picture of what the tracker sees, as PNG."""

from collections.abc import Callable
from pathlib import Path

from spheremouse.errors import OutputError
from spheremouse.session.overlay.file import write_picture
from spheremouse.session.overlay.pen import Image
from spheremouse.session.record.places import FILE


def snapshot(path: Path, draw: Callable[[], Image]) -> Path:
    """Draw a picture and write it. OutputError where the file is there already or cannot be written."""
    if path.exists():
        raise OutputError(f"{path}: is there already; give another name")
    write_picture(path, draw(), FILE)
    return path
