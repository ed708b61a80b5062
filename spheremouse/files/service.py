"""Find the repository's folder `service/`, whose files the operating system or a microcontroller reads."""

from pathlib import Path

import spheremouse
from spheremouse.errors import ServiceError


def service_files(name: str = "") -> Path:
    """Return the folder `service/`, or a folder in it, from the repository or the installed package.

    Raises ServiceError if neither has it.
    """
    package = Path(spheremouse.__file__).parent
    for path in (package.parent / "service", package / "_service"):
        if (path / "firmware").is_dir() and (path / name).is_dir():
            return path / name
    raise ServiceError("the files of the service and the firmware are not here; install spheremouse again")
