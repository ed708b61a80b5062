"""Access to the page: exact hosts and origins, a token beyond this computer, and headers that forbid foreign content.

A request comes from the owner if it carries the token, at first in the address and from then on in a cookie. Others
on this computer get a masked picture, and can change nothing. From elsewhere they get nothing.
"""

import hmac
import ipaddress
import socket
from collections.abc import Sequence
from typing import Literal

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

ADDRESS, PORT = "127.0.0.1", 8765  # of the page, unless others are given
PROOF = "/proof"  # path at which the page proves that it has a token
Visitor = Literal["owner", "stranger"]


class Access:
    """The rules for one address and port."""

    def __init__(self, token: str, port: int, names: Sequence[str] = ()) -> None:
        """`names` are further host names under which browsers find this computer."""
        self._token = token
        known = ("localhost", socket.gethostname(), f"{socket.gethostname()}.local", *names)
        self._names, self._port = {name.lower() for name in known}, port
        self.cookie = f"spheremouse-{port}"  # browsers share the cookies of all ports of a host

    def visitor(
        self, client: str, host: str, origin: str | None, cookie: str | None = None, given: str | None = None
    ) -> Visitor | None:
        """Return the visitor of a request; None if it must be refused.

        `client` is the address of the other side. `host` and `origin` are its headers, `cookie` is the value of ours,
        and `given` is the token in the address. A page of another origin, or a foreign name for this computer, is
        refused.
        """
        if not self._is_allowed_host(host) or origin not in (None, f"http://{host}", f"https://{host}"):
            return None
        if self.is_token(given) or self.is_token(cookie):
            return "owner"
        return "stranger" if _is_loopback(client) else None

    def is_token(self, text: str | None) -> bool:
        """Return True if the text is the token."""
        return text is not None and hmac.compare_digest(text.encode("utf-8", "replace"), self._token.encode())

    def proof(self, nonce: str) -> str:
        """Return proof that we have the token: HMAC-SHA256 of port and `nonce`, a text that is used once, in hex."""
        return hmac.new(self._token.encode(), f"{self._port} {nonce}".encode(), "sha256").hexdigest()

    def _is_allowed_host(self, host: str) -> bool:
        """Return True if the Host header has our port, and an IP address or one of our names.

        A foreign page can point only a name to this computer (DNS rebinding), not an address.
        """
        name, _, port = host.rpartition(":") if not host.endswith("]") and ":" in host else (host, "", "80")
        if port != str(self._port):
            return False
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name.lower() in self._names
        return True


def _is_loopback(client: str) -> bool:
    try:
        address = ipaddress.ip_address(client)
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback
