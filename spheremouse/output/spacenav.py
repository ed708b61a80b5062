"""`spacenav[:SOCKET][,full=DEG_PER_S,dead=FRACTION,...]`: a 6-axis mouse, in place of the driver spacenavd.

Programs that use libspnav connect to SOCKET, by default the value of SPNAV_SOCKET or /var/run/spnav.sock. The options
are those of `Response`. The object on the screen turns as the ball does for its player. An event of zeros ends the
motion. x, y and z are always 0.

An event is eight native 32-bit integers: type 0 (motion), x, y, z, rx, ry, rz, and ms since the last event. A client
that requests a protocol gets version 0. Its only other request is a 32-bit float, a factor on its units (libspnav 1.0).
"""

import contextlib
import errno
import os
import socket
import struct
import time
from collections.abc import Sequence
from pathlib import Path

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, absent, ok
from spheremouse.output import Output, Report
from spheremouse.output.deflection import CHECK_PERIOD, RELEASE_TIME, pointer_rate
from spheremouse.output.line_server import Client, Server
from spheremouse.output.response import STICK_RESPONSE, Response, parse_response

RESPONSE = STICK_RESPONSE
FULL_DEFLECTION = 350  # units, of 3Dconnexion's mice
_NO_DEFLECTION = [0.0, 0.0, 0.0]
_CHANGE_PROTOCOL = 0x7FAA5500  # request; its last byte is the version
_GREETING_TIME = 0.1  # s, for a client's first request; libspnav would take an event for the answer
_MAX_FACTOR = 1e6


def to_rotation(report: Report, response: Response) -> list[float] | None:
    """Return rx, ry and rz, (3,) units, 350 at full deflection; None if the frame is not confirmed."""
    rate, sample = pointer_rate(report, response), report.pointing_sample
    if rate is None or sample is None:
        return rate
    x, y, z = response.to_axes(rate)
    # about the player's right, up and ahead, the last one clockwise
    turn = (y, z, x) if sample.coordinates == "obj" else (-y, -x, z)
    return [FULL_DEFLECTION * d for d in response.deflection(turn)]


class _Client(Client):
    def __init__(self) -> None:
        self._sensitivity, self._unread = 1.0, b""
        self._ready_at = time.monotonic() + _GREETING_TIME

    @property
    def ready(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return time.monotonic() >= self._ready_at

    def receive(self, data: bytes) -> tuple[bytes, bool]:
        self._unread, answer = self._unread + data, b""
        while len(self._unread) >= 4:
            request, self._unread = self._unread[:4], self._unread[4:]
            (word,), (value,) = struct.unpack("=I", request), struct.unpack("=f", request)
            if word & 0xFFFFFF00 == _CHANGE_PROTOCOL:
                answer, self._ready_at = struct.pack("=I", _CHANGE_PROTOCOL), 0.0
            elif abs(value) <= _MAX_FACTOR:
                self._sensitivity = value
        return answer, bool(data)

    def event(self, rotation: Sequence[float], period: int) -> bytes:
        """Return the event of a rotation, (3,) units, `period` ms after the last one."""
        units = [round(r * self._sensitivity) for r in rotation]
        return struct.pack("=8i", 0, 0, 0, 0, *units, period)


def _listen(path: Path) -> socket.socket:
    """Return a socket that every account may connect to. A socket without a server is replaced."""
    listener = socket.socket(socket.AF_UNIX)
    try:
        with contextlib.suppress(ConnectionRefusedError, FileNotFoundError), socket.socket(socket.AF_UNIX) as other:
            other.connect(str(path))
            raise OSError(errno.EADDRINUSE, "another driver serves it")
        if path.is_socket():
            path.unlink()
        listener.bind(str(path))
        node = os.open(path, os.O_PATH | os.O_NOFOLLOW)
        os.chmod(f"/proc/self/fd/{node}", 0o666)
        os.close(node)
        listener.listen()
    except (OSError, ValueError) as e:
        listener.close()
        problem = f"spacenav: {path}: {getattr(e, 'strerror', None) or e}"
        raise OutputError(problem, "stop spacenavd, or name another socket") from None
    return listener


class SpaceNav(Server[_Client], Output):
    """Turns the objects of libspnav's clients, over a UNIX socket."""

    blocks = False
    period = CHECK_PERIOD

    def __init__(self, path: Path, response: Response) -> None:
        self._path, self._response = path, response
        self._moving, self._last, self._confirmed = False, time.monotonic(), 0.0  # s, monotonic
        super().__init__("spacenav", _listen(path), _Client)

    def send(self, report: Report) -> None:
        """Send the rotation to each client. Without a confirmed frame the last one stays, for 0.3 s at most."""
        rotation, now = to_rotation(report, self._response), time.monotonic()
        if rotation is not None:
            self._confirmed = now
            self._turn(rotation)
            self.blocks = self.has_many_clients
        elif now > self._confirmed + RELEASE_TIME:
            self._turn(_NO_DEFLECTION)

    def close(self) -> None:
        """End the motion and the connections, and remove the socket."""
        self._turn(_NO_DEFLECTION)
        super().close()
        self._path.unlink(missing_ok=True)

    def _turn(self, rotation: list[float]) -> None:
        """Send rx, ry and rz, (3,) units, to each client; those of rest only once."""
        if any(rotation) or self._moving:
            now = time.monotonic()
            period, self._last = min(round(1000.0 * (now - self._last)), 2**31 - 1), now
            self.broadcast(lambda client: client.event(rotation, period))
        self._moving = any(rotation)


def open(argument: str) -> SpaceNav:
    return SpaceNav(*check(argument))


def check(argument: str) -> tuple[Path, Response]:
    """Return the socket and the response. Raise OutputError if the argument is invalid or the system is not Linux."""
    first, _, rest = argument.partition(",")
    name, rest = ("", argument) if "=" in first else (first, rest)
    response = parse_response(rest, f"spacenav:{argument}", RESPONSE)
    if not hasattr(os, "O_PATH"):
        raise OutputError("spacenav: needs Linux", "use another output, for example osc")
    return Path(name or os.environ.get("SPNAV_SOCKET") or "/var/run/spnav.sock"), response


def probe(argument: str) -> list[Finding]:
    path, _ = check(argument)
    if os.access(path.parent, os.W_OK):
        return [ok("spacenav", f"serves {path}")]
    return [absent("spacenav", f"{path.parent} may not be written", "name another socket")]
