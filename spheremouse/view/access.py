"""Access to the page: exact hosts and origins, a token beyond this computer, and headers that forbid foreign content.

A request comes from the owner if it carries the token, at first in the address and from then on in a cookie. On this
computer others get a masked page without buttons; from elsewhere they get nothing.
"""

import hmac
import ipaddress
import os
import secrets
import socket
from collections.abc import Sequence
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import NamedTuple

from spheremouse.errors import ControlError
from spheremouse.files import safe_files

COOKIE = "spheremouse"
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
    "Connection": "close",  # a slow second request could hold the connection open
}
_TOKEN_FILE = "view.token"
_TOKEN_BYTES = 32
_SYSTEM_TOKEN = Path("/var/lib/spheremouse-view") / _TOKEN_FILE  # of the system's service

ADDRESS, PORT = "127.0.0.1", 8765  # of the page, unless others are given
_MAX_TOKEN_FILE_BYTES = 1000


class Visitor(NamedTuple):
    """A request that may pass."""

    owner: bool


class Access:
    """The rules for one address and port."""

    def __init__(self, token: str, port: int, names: Sequence[str] = ()) -> None:
        """`names` are further host names under which browsers find this computer."""
        self._token = token
        known = ("localhost", socket.gethostname(), f"{socket.gethostname()}.local", *names)
        self._names, self._port = {name.lower() for name in known}, port

    def visitor(
        self, client: str, host: str, origin: str | None, cookies: str = "", given: str | None = None
    ) -> Visitor | None:
        """Return the visitor of a request; None if it must be refused.

        `client` is the address of the other side. `host`, `origin` and `cookies` are its headers, and `given` is the
        token in the address. A page of another origin, or a foreign name for this computer, is refused.
        """
        if not self._is_ours(host) or origin not in (None, f"http://{host}", f"https://{host}"):
            return None
        owner = self.is_token(given) or self.is_token(_cookie(cookies))
        return Visitor(owner) if owner or _is_loopback(client) else None

    def is_token(self, text: str | None) -> bool:
        """Return True if the text is the token."""
        return text is not None and hmac.compare_digest(text.encode("utf-8", "replace"), self._token.encode())

    def _is_ours(self, host: str) -> bool:
        """Return True if `Host` is an address, which no foreign page can point elsewhere, or one of our names."""
        name, _, port = host.rpartition(":") if not host.endswith("]") and ":" in host else (host, "", "80")
        if port != str(self._port):
            return False
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name.lower() in self._names
        return True


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
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            safe_files.replace(path, f"{secrets.token_urlsafe(_TOKEN_BYTES)}\n".encode(), 0o640)
        except OSError as e:
            raise ControlError(f"{path}: cannot be written ({e.strerror})", "name another --token-file") from None
    return read_token(path)


def token_path() -> Path:
    """Return the path of the token that this process makes: in systemd's state folder, else in the user's."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given) / _TOKEN_FILE
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path.home() / ".local/state") / "spheremouse" / _TOKEN_FILE


def present_token() -> Path:
    """Return the path of the token of the page that runs: the user's own one, else the system's."""
    own = token_path()
    return _SYSTEM_TOKEN if not own.exists() and os.path.lexists(_SYSTEM_TOKEN.parent) else own


def owners_address(address: str, port: int, token: str) -> str:
    """Return the address of the page with the token."""
    host = "localhost" if address in ("0.0.0.0", "::") else f"[{address}]" if ":" in address else address
    return f"http://{host}:{port}/?token={token}"


def _cookie(header: str) -> str | None:
    try:
        found = SimpleCookie(header).get(COOKIE)
    except CookieError:
        return None
    return None if found is None else found.value


def _is_loopback(client: str) -> bool:
    try:
        address = ipaddress.ip_address(client)
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback
