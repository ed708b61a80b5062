"""Where the files are that the operating system or a microcontroller reads: those of the repository's `service/`."""

from pathlib import Path

import spheremouse
from spheremouse.errors import ServiceError


def service_files(name: str = "") -> Path:
    """The folder `service/`, or a folder in it, in the repository or within the installed package.

    ServiceError where it is in neither.
    """
    package = Path(spheremouse.__file__).parent
    for path in (package.parent / "service", package / "_service"):
        if (path / "firmware").is_dir() and (path / name).is_dir():
            return path / name
    raise ServiceError("the files of the service and the firmware are not here; install spheremouse again")
