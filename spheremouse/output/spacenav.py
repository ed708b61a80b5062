"""`spacenav[:SOCKET][,full=DEG_PER_S,dead=FRACTION,...]`: a 6-axis mouse, in place of the driver spacenavd.

Programs that use libspnav connect to SOCKET, by default the value of SPNAV_SOCKET or /var/run/spnav.sock. The options
are those of `Response`. The object on the screen turns as the ball does for its player. An event of zeros ends the
motion. x, y and z are always 0.
"""

import os
import threading
from pathlib import Path

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, absent, ok
from spheremouse.output import Output, Report
from spheremouse.output.deflection import Watchdog, pointer_rate
from spheremouse.output.response import STICK_RESPONSE, Response, parse_response
from spheremouse.output.spnav_server import SpnavServer

RESPONSE = STICK_RESPONSE
FULL_DEFLECTION = 350  # units, of 3Dconnexion's mice
_NO_DEFLECTION = [0.0, 0.0, 0.0]


def to_rotation(report: Report, response: Response) -> list[float] | None:
    """Return rx, ry and rz, (3,) units, 350 at full deflection; None if the frame is not confirmed."""
    rate, sample = pointer_rate(report, response), report.pointing_sample
    if rate is None or sample is None:
        return rate
    x, y, z = response.to_axes(rate)
    # about the player's right, up and ahead, the last one clockwise
    turn = (y, z, x) if sample.coordinates == "obj" else (-y, -x, z)
    return [FULL_DEFLECTION * d for d in response.deflection(turn)]


class SpaceNav(Output):
    """Turns the objects of libspnav's clients."""

    blocks = False

    def __init__(self, path: Path, response: Response) -> None:
        self._response, self._server = response, SpnavServer(path)
        self._lock, self._moving = threading.Lock(), False
        self._watchdog = Watchdog(lambda: self._turn(_NO_DEFLECTION))

    def send(self, report: Report) -> None:
        """Send the rotation to each client. Without a confirmed frame the last one stays, for 0.3 s at most."""
        rotation = to_rotation(report, self._response)
        if rotation is not None:
            self._watchdog.feed()
            self._turn(rotation)
            self.blocks = self._server.has_many_clients

    def close(self) -> None:
        """End the motion and the connections, and remove the socket."""
        self._watchdog.close()
        self._turn(_NO_DEFLECTION)
        self._server.close()

    def _turn(self, rotation: list[float]) -> None:
        """Send a rotation; that of rest only once."""
        with self._lock:
            if any(rotation) or self._moving:
                self._server.send(rotation)
            self._moving = any(rotation)


def open(argument: str) -> SpaceNav:
    """Create the socket."""
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
    """Return whether this account may create the socket."""
    path, _ = check(argument)
    if os.access(path.parent, os.W_OK):
        return [ok("spacenav", f"serves {path}")]
    return [absent("spacenav", f"{path.parent} may not be written", "name another socket")]
