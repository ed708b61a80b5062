"""The token of the live page's owner, in a file that only owner and group may read."""

import os
import secrets
from pathlib import Path

from spheremouse.errors import ControlError, os_errors_as
from spheremouse.files import safe_files
from spheremouse.files.access import state_folder

_TOKEN_FILE = "view.token"
_TOKEN_BYTES = 32
_SYSTEM_TOKEN = Path("/var/lib/spheremouse-view") / _TOKEN_FILE  # of the system's service
_MAX_TOKEN_FILE_BYTES = 1000


def read_token(path: Path) -> str:
    """Return the token in a file. Raises ControlError if it cannot be read or has none."""
    try:
        token = safe_files.read_text(path, _MAX_TOKEN_FILE_BYTES, "token").strip()
    except OSError as e:
        hint = "start `spheremouse view` first" if isinstance(e, FileNotFoundError) else "use sudo"
        raise ControlError(f"{path}: cannot be read ({e.strerror})", hint) from None
    if len(token) < _TOKEN_BYTES:
        raise ControlError(f"{path}: contains no token", "remove it; the next start writes another one")
    return token


def own_token(path: Path) -> str:
    """Return the token in a file, which only its owner and group may read. A missing file gets a new token."""
    if not path.exists():
        with os_errors_as(ControlError, f"{path}: cannot be written", "name another --token-file"):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            safe_files.replace(path, f"{secrets.token_urlsafe(_TOKEN_BYTES)}\n".encode(), 0o640)
    return read_token(path)


def token_path() -> Path:
    """Return the path of the token that this process makes: in systemd's state folder, else in the user's."""
    return state_folder() / _TOKEN_FILE


def token_files() -> list[Path]:
    """Return the files with the tokens of pages on this computer: the user's own one if it exists, and the system's."""
    own = token_path()
    if not os.path.lexists(_SYSTEM_TOKEN.parent):
        return [own]
    return [own, _SYSTEM_TOKEN] if own.exists() else [_SYSTEM_TOKEN]
