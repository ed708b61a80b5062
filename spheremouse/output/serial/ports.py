"""Serial ports, and which of them is a board of ours."""

import contextlib
import os
import select
import time
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.output.serial.messages import VERSION

PRODUCT = "spheremouse"
CIRCUITPYTHON = (0x239A, 0x2E8A)  # USB vendors of its boards with RP2040 and RP2350: Adafruit, Raspberry Pi
ADAPTERS = {  # USB vendor and product of chips that are nothing but a serial adapter
    (0x10C4, 0xEA60): "CP210x",
    (0x1A86, 0x7522): "CH340",
    (0x1A86, 0x7523): "CH340",
    (0x1A86, 0x55D3): "CH343",
    (0x1A86, 0x55D4): "CH9102",
    (0x0403, 0x6001): "FT232R",
    (0x0403, 0x6014): "FT232H",
    (0x0403, 0x6015): "FT231X",
    (0x067B, 0x2303): "PL2303",
    (0x067B, 0x23A3): "PL2303GC",
    (0x067B, 0x23B3): "PL2303GB",
    (0x067B, 0x23C3): "PL2303GT",
    (0x067B, 0x23D3): "PL2303GL",
    (0x067B, 0x23E3): "PL2303GE",
    (0x067B, 0x23F3): "PL2303GS",
    (0x2E8A, 0x000C): "Debug Probe",
}


class PortGoneError(Exception):
    """The port cannot be used any more."""


class Port:
    """A serial port that never waits but to read."""

    def __init__(self, name: str, baud: int) -> None:
        """Raises OutputError where it cannot be opened."""
        import serial

        port = None
        try:
            port = serial.Serial(name, baud, timeout=0.0, write_timeout=0.0, exclusive=True)
            port.reset_input_buffer()
        except Exception as e:  # termios.error, for one, is no OSError
            with contextlib.suppress(Exception):
                if port is not None:
                    port.close()
            raise OutputError(f"serial: {_refusal(name, e)}") from None
        with contextlib.suppress(Exception):
            port.set_low_latency_mode(True)  # an FTDI chip holds answers back for 16 ms otherwise
        self._port, self.name = port, name
        self._posix = os.name == "posix"

    def read(self, timeout: float) -> bytes:
        """Bytes that have come in; waits for `timeout` s at most."""
        try:
            if not self._posix:
                return self._read_elsewhere(timeout)
            if not select.select([self._port.fileno()], [], [], timeout)[0]:
                return b""
            data = os.read(self._port.fileno(), 4096)
        except BlockingIOError:
            return b""
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None
        if not data:
            raise PortGoneError("unplugged")
        return data

    def write(self, data: bytes) -> int:
        """Bytes that were taken, without waiting."""
        try:
            return os.write(self._port.fileno(), data) if self._posix else int(self._port.write(data) or 0)
        except BlockingIOError:
            return 0
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None

    def queued(self) -> int:
        """Bytes that the system has taken and not sent."""
        try:
            return int(self._port.out_waiting)
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None

    def close(self) -> None:
        """Close it, whatever has become of it; what is still queued is not waited for."""
        with contextlib.suppress(Exception):
            self._port.reset_output_buffer()
        with contextlib.suppress(Exception):
            self._port.close()

    def _read_elsewhere(self, timeout: float) -> bytes:
        """Windows has no `select` for ports."""
        until = time.perf_counter() + timeout
        while not (waiting := self._port.in_waiting) and time.perf_counter() < until:
            time.sleep(0.001)
        return self._port.read(waiting) if waiting else b""


def find_board(identifier: str | None = None, ports: list[Any] | None = None, adapters: bool = True) -> str:
    """The port of the board by its USB identity; `ports` as pyserial lists them.

    Where none is ours, the only adapter there is, if `adapters` are allowed.
    """
    ports = [p for p in (connected_ports() if ports is None else ports) if p.vid is not None]
    boards = [board for board in _boards(ports) if _data_port(board) is not None]
    if identifier is not None:
        found = [b for b in boards if b[-1].serial_number == identifier]
    else:
        found = [b for b in boards if _is_ours(b)]
        if not found and adapters:
            found = [b for b in boards if _id(b) in ADAPTERS]
    if len(found) == 1:
        return found[0][-1].device
    if found:
        numbers = [b[-1].serial_number for b in found]
        several = (
            f"serial:auto,id={n} ({b[-1].device})" if n and numbers.count(n) == 1 else f"serial:{b[-1].device}"
            for b, n in zip(found, numbers, strict=True)
        )
        raise OutputError(f"serial:auto: several boards; write {' or '.join(several)}")
    there = ", ".join(p.device for p in ports)
    raise OutputError(
        "serial:auto: no board "
        + (f"with id={identifier}" if identifier is not None else "of ours")
        + (f" among {there}; name its port: serial:PORT" if there else " is plugged in; plug it in")
        + ", or see `spheremouse firmware install`"
    )


def connected_ports() -> list[Any]:
    """All serial ports, as pyserial lists them."""
    from serial.tools import list_ports

    try:
        return list(list_ports.comports())
    except (TypeError, ValueError, OSError):  # what it reads of a board that is just being unplugged is gone
        raise OutputError("serial:auto: ports are changing just now; try again") from None


def _boards(ports: list[Any]) -> list[list[Any]]:
    """The ports of each board, data ports last."""
    found: dict[Any, list[Any]] = {}
    for port in sorted(ports, key=_interface):
        place = (port.location or ("" if port.serial_number else port.device)).partition(":")[0]
        found.setdefault((port.vid, port.pid, port.serial_number, place), []).append(port)
    return list(found.values())


def _interface(port: Any) -> tuple[int, str, int, str]:
    """Data ports behind consoles: by the interface's name, else by its number, else by the port's name."""
    number = (port.location or "").rpartition(":")[2]
    return (int("CDC2" in (port.interface or "")), number, len(port.device), port.device)


def _id(board: list[Any]) -> tuple[int, int]:
    return board[-1].vid, board[-1].pid


def _says_ours(board: list[Any]) -> bool:
    return any(PRODUCT in f"{p.product} {p.serial_number}".lower() for p in board)


def _is_ours(board: list[Any]) -> bool:
    """By name; where the system tells none (Windows), CircuitPython with a data port, which is rare elsewhere."""
    return _says_ours(board) or (len(board) == 2 and board[-1].vid in CIRCUITPYTHON and board[-1].product is None)


def _data_port(board: list[Any]) -> Any | None:
    """Never CircuitPython's console: a Ctrl-C among the bytes of a frame would stop the program there."""
    port = board[-1]
    interface = port.interface or ""
    if "CDC2" in interface or _id(board) in ADAPTERS:
        return port
    if "CircuitPython CDC" in interface:
        return None
    alone = len(board) == 1 and port.vid in CIRCUITPYTHON and not _says_ours(board)
    return None if alone else port


def foreign_text(version: int) -> str:
    advice = (
        "update spheremouse"
        if version > VERSION
        else "load this program's firmware: `spheremouse firmware install`, or as docs/microcontroller.md says"
    )
    return f"the board speaks version {version} of the protocol, this program {VERSION}; {advice}"


def _refusal(name: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if isinstance(error, FileNotFoundError) or number == 2:
        return f"{name} does not exist; {_there()}"
    if isinstance(error, PermissionError) or number == 13:
        return f"{name} may not be used; be in its group (dialout on Debian: sudo adduser $USER dialout), log in again"
    if number in (11, 16) or "exclusively lock" in str(error):
        return f"{name} is in use by another program; end that one"
    return f"{name} cannot be opened: {_reason(error)}"


def _there() -> str:
    try:
        names = [p.device for p in connected_ports()]
    except OutputError:
        names = []
    return f"there is {', '.join(names)}" if names else "there is no serial port here: plug the board in"


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error.args[-1] if error.args else error)  # termios.error: (5, "...")
    return " ".join(text.split())


def nobody(damaged: int) -> str:
    if damaged:
        return (
            "something answers, but garbled; use shorter wires, see that GND is connected and that both ends have the "
            "same baud rate"
        )
    return (
        "no board of ours answers; see `spheremouse firmware check`, and on a plain serial line whether RX and TX are "
        "exchanged"
    )


def example_port() -> str:
    return "COM5" if os.name == "nt" else "/dev/ttyACM1"
