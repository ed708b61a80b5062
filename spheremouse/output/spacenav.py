"""`spacenav[:SOCKET][,full=DEG_PER_S,dead=FRACTION]`: a 6-axis mouse, in place of the driver spacenavd.

Programs that use libspnav connect to SOCKET, by default the value of SPNAV_SOCKET or /var/run/spnav.sock. The object on
the screen turns as the ball does for its player. An event of zeros ends the motion. x, y and z are always 0.
"""

import os
import threading
from pathlib import Path

import numpy as np

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, absent, ok
from spheremouse.geometry.rotation import Array
from spheremouse.output import Output, Report
from spheremouse.output.deflection import Response, Watchdog, parse_response, pointer_rate
from spheremouse.output.spnav_server import SpnavServer

FULL_DEFLECTION = 350  # units, of 3Dconnexion's mice
_ROTATIONS = {  # from the pointer's rate to rotations about the player's right, up and ahead, the last one clockwise
    "obj": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "cam": np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}


def to_rotation(report: Report, response: Response) -> Array | None:
    """Return rx, ry and rz, (3,) units; None if the frame is not confirmed and the rotation goes on."""
    rate, sample = pointer_rate(report), report.pointing_sample
    if rate is None or sample is None:
        return rate
    return FULL_DEFLECTION * response.deflection(_ROTATIONS[sample.coordinates] @ rate)


class SpaceNav(Output):
    """Turns the objects of libspnav's clients."""

    def __init__(self, path: Path, response: Response) -> None:
        self._response, self._server = response, SpnavServer(path)
        self._lock, self._moving = threading.Lock(), False
        self._watchdog = Watchdog(lambda: self._turn(np.zeros(3)))

    def send(self, report: Report) -> None:
        """Send the rotation to each client."""
        rotation = to_rotation(report, self._response)
        if rotation is not None:
            self._watchdog.feed()
            self._turn(rotation)

    def describe(self, report: Report) -> str:
        """Return the rotation, as in `rx +120 ry +0 rz -7`; empty if the one before goes on."""
        rotation = to_rotation(report, self._response)
        return "" if rotation is None else "rx {:+d} ry {:+d} rz {:+d}".format(*np.rint(rotation).astype(int).tolist())

    def close(self) -> None:
        """End the motion and the connections, and remove the socket."""
        self._watchdog.close()
        self._turn(np.zeros(3))
        self._server.close()

    def _turn(self, rotation: Array) -> None:
        """Send a rotation; that of rest only once."""
        with self._lock:
            if rotation.any() or self._moving:
                self._server.send(rotation)
            self._moving = bool(rotation.any())


def open(argument: str) -> SpaceNav:
    """Create the socket."""
    return SpaceNav(*check(argument))


def check(argument: str) -> tuple[Path, Response]:
    """Return the socket and the response. Raise OutputError if the argument is invalid or the system is not Linux."""
    first, _, rest = argument.partition(",")
    name, rest = ("", argument) if "=" in first else (first, rest)
    response = parse_response(rest, f"spacenav:{argument}", ("full", "dead"))
    if not hasattr(os, "O_PATH"):
        raise OutputError("spacenav: needs Linux", "use another output, for example osc")
    return Path(name or os.environ.get("SPNAV_SOCKET") or "/var/run/spnav.sock"), response


def probe(argument: str) -> list[Finding]:
    """Return whether this account may create the socket."""
    path, _ = check(argument)
    if os.access(path.parent, os.W_OK):
        return [ok("spacenav", f"serves {path}")]
    return [absent("spacenav", f"{path.parent} may not be written", "name another socket")]
