"""The rights of this account on a device node, the service's folder, and the files that come with the program."""

import os
from pathlib import Path

import spheremouse
from spheremouse.errors import ServiceError

STATE_FOLDER = Path("/var/lib/spheremouse")  # systemd makes it at the service's first start


def service_state_folder() -> Path | None:
    """Return the state folder that systemd gives this process; None without one."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None


def state_folder() -> Path:
    """Return the folder of maps, recordings and tokens that this process makes: the service's, else the user's."""
    home = os.environ.get("XDG_STATE_HOME")
    return service_state_folder() or (Path(home) if home else Path.home() / ".local/state") / "spheremouse"


def access_problem(path: Path) -> tuple[str, str] | None:
    """Return the reason why this account may not read and write a node, and the remedy; None if it may."""
    if os.access(path, os.R_OK | os.W_OK):
        return None
    user, group, mode = account(), group_of(path), path.stat().st_mode
    if mode & 0o060 != 0o060 or group in (None, "root"):
        return (
            f"{path} may be used by its owner alone",
            "as root: spheremouse service install, which places the udev rules; or unplug it and plug it in again",
        )
    import grp

    if any(g.gr_name == group and user in g.gr_mem for g in grp.getgrall()):
        return (
            f"{path} belongs to the group {group}, and {user} is a member only from the next login on",
            "log out and in again",
        )
    return (
        f"{path} belongs to the group {group}, and {user} is no member",
        f"as root: usermod -aG {group} {user}, then log in again",
    )


def account() -> str:
    try:
        import pwd

        return pwd.getpwuid(os.geteuid()).pw_name
    except (ImportError, KeyError):
        return os.environ.get("USER", "this account")


def group_of(path: Path) -> str | None:
    """Return the name of a node's group; None if the node or the name does not exist."""
    try:
        return path.group()
    except (OSError, KeyError, NotImplementedError):
        return None


def service_files(name: str = "") -> Path:
    """Return the folder `service/`, or one in it, of repository or package. ServiceError: neither has it."""
    package = Path(spheremouse.__file__).parent
    for path in (package.parent / "service", package / "_service"):
        if (path / "firmware").is_dir() and (path / name).is_dir():
            return path / name
    raise ServiceError("the files of the service and the firmware are not here; install spheremouse again")


def shipped(path: str) -> str:
    """Return the text of a file of the repository that the installed package has too, by its path in the repository."""
    package = Path(spheremouse.__file__).parent
    sibling = package.parent / path
    return (sibling if sibling.is_file() else package / "_service" / sibling.name).read_text("utf-8")
