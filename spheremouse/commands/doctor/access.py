"""May this account use a device, and if not: which group, or which rule, is missing?"""

import os
from pathlib import Path


def refusal(path: Path) -> tuple[str, str] | None:
    """The reason why a node may not be read and written, and what to do; None where it may."""
    if os.access(path, os.R_OK | os.W_OK):
        return None
    who, group, mode = account(), group_of(path), path.stat().st_mode
    if mode & 0o060 != 0o060 or group in (None, "root"):
        return (
            f"{path} may be used by its owner alone",
            "as root: spheremouse service install, which places the udev rules; or unplug it and plug it in again",
        )
    if group in _enrolled(who):
        return (
            f"{path} is for the group {group}, of which {who} is, but not yet in this session",
            "log out and in again",
        )
    return (
        f"{path} is for the group {group}, of which {who} is not",
        f"as root: usermod -aG {group} {who}, then log in again",
    )


def account() -> str:
    """The name of the account that asks."""
    try:
        import pwd

        return pwd.getpwuid(os.geteuid()).pw_name
    except (ImportError, KeyError):
        return os.environ.get("USER", "this account")


def group_of(path: Path) -> str | None:
    """The name of a node's group."""
    try:
        return path.group()
    except (OSError, KeyError, NotImplementedError):
        return None


def groups() -> list[str]:
    """Those of this session, sorted."""
    try:
        import grp
    except ImportError:
        return []
    found = []
    for number in {*os.getgroups(), os.getegid()}:
        try:
            found.append(grp.getgrgid(number).gr_name)
        except KeyError:
            found.append(str(number))
    return sorted(found)


def _enrolled(who: str) -> list[str]:
    import grp

    return [g.gr_name for g in grp.getgrall() if who in g.gr_mem]
