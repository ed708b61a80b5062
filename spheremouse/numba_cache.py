"""Cache folder of Numba for an account that owns neither the program's folder nor a home.

Must be settled before numba is imported. Everybody else keeps numba's own places: beside the source, or `~/.cache`.
"""

import os
import stat
from pathlib import Path


def keep_somewhere() -> None:
    """Set NUMBA_CACHE_DIR where numba would find no place of its own: a service's cache folder, or a private one."""
    if "NUMBA_CACHE_DIR" in os.environ or _writable(Path(__file__).parent) or _writable(_users()):
        return
    given = os.environ.get("CACHE_DIRECTORY", "").split(":")[0]  # systemd: CacheDirectory=
    os.environ["NUMBA_CACHE_DIR"] = given if given and _writable(Path(given)) else str(_private())


def _users() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(home)


def _writable(folder: Path) -> bool:
    """Return whether files can be created in a folder, or the folder itself."""
    while not os.path.exists(folder) and folder != folder.parent:  # pathlib's raises where it may not look
        folder = folder.parent
    return os.path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)


def _private() -> Path:
    """Return the same folder of this account each time, in which no other account can place code."""
    import tempfile  # dear, and seldom needed

    if not hasattr(os, "getuid"):
        return Path(tempfile.mkdtemp(prefix="spheremouse-"))
    folder = Path(tempfile.gettempdir()) / f"spheremouse-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        info = folder.lstat()
    except OSError:
        return Path(tempfile.mkdtemp(prefix="spheremouse-"))
    own = stat.S_ISDIR(info.st_mode) and info.st_uid == os.getuid() and not info.st_mode & 0o077
    return folder if own else Path(tempfile.mkdtemp(prefix="spheremouse-"))
