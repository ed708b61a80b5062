"""Serial ports, and the search for the port of a spheremouse board."""

import contextlib
import os
import select
import time
from typing import Any

from spheremouse.errors import OutputError
from spheremouse.output.serial.messages import VERSION

PRODUCT = "spheremouse"
CIRCUITPYTHON = (0x239A, 0x2E8A)  # USB vendors of boards with RP2040 and RP2350: Adafruit, Raspberry Pi
ADAPTERS = {  # USB products by vendor, of chips that are only a serial adapter
    0x0403: (0x6001, 0x6014, 0x6015),  # FT232R, FT232H, FT231X
    0x067B: (0x2303, 0x23A3, 0x23B3, 0x23C3, 0x23D3, 0x23E3, 0x23F3),  # PL2303 of all series
    0x10C4: (0xEA60,),  # CP210x
    0x1A86: (0x7522, 0x7523, 0x55D3, 0x55D4),  # CH340, CH343, CH9102
    0x2E8A: (0x000C,),  # Debug Probe
}


class PortGoneError(Exception):
    """The port does not work any more."""


class Port:
    """A serial port. Only `read` and `write_all` wait."""

    def __init__(self, name: str, baud: int) -> None:
        """Open a port. Raise OutputError if it does not open."""
        import serial

        port = None
        try:
            port = serial.Serial(name, baud, timeout=0.0, write_timeout=0.0, exclusive=True)
            port.reset_input_buffer()
        except Exception as e:  # for example termios.error, which is no OSError
            with contextlib.suppress(Exception):
                if port is not None:
                    port.close()
            raise _refusal(name, e) from None
        with contextlib.suppress(Exception):
            port.set_low_latency_mode(True)  # otherwise an FTDI chip delays answers by 16 ms
        self._port, self.name = port, name
        self._posix = os.name == "posix"

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most `timeout` (s). Raises PortGoneError if the port fails."""
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
        """Write without waiting; return the number of bytes that the system took. Raises PortGoneError if it fails."""
        try:
            return os.write(self._port.fileno(), data) if self._posix else int(self._port.write(data) or 0)
        except BlockingIOError:
            return 0
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None

    def write_all(self, data: bytes, end: float) -> None:
        """Write everything and wait until it is sent, until `end` (s, of `time.perf_counter`) at most."""
        while data and time.perf_counter() < end:
            data = data[self.write(data) :]
            time.sleep(0.001 if data else 0.0)
        while self.queued() and time.perf_counter() < end:
            time.sleep(0.001)

    def queued(self) -> int:
        """Return the number of bytes in the system's queue. Raises PortGoneError if the port fails."""
        try:
            return int(self._port.out_waiting)
        except (OSError, ValueError, TypeError) as e:
            raise PortGoneError(_reason(e)) from None

    def close(self) -> None:
        """Close the port, also a broken one. Bytes in the queue are dropped."""
        with contextlib.suppress(Exception):
            if self.queued():  # always 0 on a pseudo-terminal, where a flush drops unread bytes
                self._port.reset_output_buffer()
        with contextlib.suppress(Exception):
            self._port.close()

    def _read_elsewhere(self, timeout: float) -> bytes:
        """Windows has no `select` for ports."""
        end = time.perf_counter() + timeout
        while not (waiting := self._port.in_waiting) and time.perf_counter() < end:
            time.sleep(0.001)
        return self._port.read(waiting) if waiting else b""


def find_board(identifier: str | None = None, ports: list[Any] | None = None, adapters: bool = True) -> str:
    """Return the port of the board with a USB serial number, or of the only board; `ports` as pyserial lists them.

    If no board is found and `adapters` are allowed, return the port of the only adapter. Raises OutputError if none or
    several are found.
    """
    ports = [p for p in (connected_ports() if ports is None else ports) if p.vid is not None]
    boards = [board for board in _boards(ports) if _has_data_port(board)]
    if identifier is not None:
        found = [b for b in boards if b[-1].serial_number == identifier]
    else:
        found = [b for b in boards if _is_spheremouse(b)]
        if not found and adapters:
            found = [b for b in boards if _is_adapter(b)]
    if len(found) == 1:
        return found[0][-1].device
    if found:
        numbers = [b[-1].serial_number for b in found]
        several = (
            f"serial:auto,id={n} ({b[-1].device})" if n and numbers.count(n) == 1 else f"serial:{b[-1].device}"
            for b, n in zip(found, numbers, strict=True)
        )
        raise OutputError("serial:auto: several boards", f"write {' or '.join(several)}")
    names = ", ".join(p.device for p in ports)
    description = "of ours" if identifier is None else f"with id={identifier}"
    raise OutputError(
        f"serial:auto: no board {description} {f'among {names}' if names else 'is plugged in'}",
        f"{'name its port: serial:PORT' if names else 'plug it in'}, or see `spheremouse firmware install`",
    )


def connected_ports() -> list[Any]:
    """Return all serial ports, as pyserial lists them. Raises OutputError while a board is being unplugged."""
    from serial.tools import list_ports

    try:
        return list(list_ports.comports())
    except (TypeError, ValueError, OSError):  # a board that is just being unplugged has no description
        raise OutputError("serial:auto: ports are changing just now", "try again") from None


def _boards(ports: list[Any]) -> list[list[Any]]:
    """Return the ports of each board, data ports last."""
    found: dict[Any, list[Any]] = {}
    for port in sorted(ports, key=_console_first):
        place = (port.location or ("" if port.serial_number else port.device)).partition(":")[0]
        found.setdefault((port.vid, port.pid, port.serial_number, place), []).append(port)
    return list(found.values())


def _console_first(port: Any) -> tuple[int, str, int, str]:
    """Sort data ports behind consoles: by the interface's name, else by its number, else by the port's name."""
    number = (port.location or "").rpartition(":")[2]
    return (int("CDC2" in (port.interface or "")), number, len(port.device), port.device)


def _is_adapter(board: list[Any]) -> bool:
    return board[-1].pid in ADAPTERS.get(board[-1].vid, ())


def _is_named(board: list[Any]) -> bool:
    return any(PRODUCT in f"{p.product} {p.serial_number}".lower() for p in board)


def _is_spheremouse(board: list[Any]) -> bool:
    """Recognise a board by name. Windows has no names; there it is CircuitPython with a data port, rare elsewhere."""
    return _is_named(board) or (len(board) == 2 and board[-1].vid in CIRCUITPYTHON and board[-1].product is None)


def _has_data_port(board: list[Any]) -> bool:
    """Return False for CircuitPython's console alone: a Ctrl-C in a frame's bytes would stop the program there."""
    port = board[-1]
    interface = port.interface or ""
    if "CDC2" in interface or _is_adapter(board):
        return True
    if "CircuitPython CDC" in interface:
        return False
    return len(board) > 1 or port.vid not in CIRCUITPYTHON or _is_named(board)


def version_mismatch(version: int, place: str = "") -> OutputError:
    """Return the error of a board with another version of the protocol."""
    hint = "load this program's firmware: `spheremouse firmware install`, or docs/microcontroller.md"
    return OutputError(
        f"{place}the board speaks version {version} of the protocol, this program {VERSION}",
        "update spheremouse" if version > VERSION else hint,
    )


def _refusal(name: str, error: Exception) -> OutputError:
    number, place = getattr(error, "errno", None), f"serial: {name}"
    if isinstance(error, FileNotFoundError) or number == 2:
        return OutputError(f"{place} does not exist", _list_ports())
    if isinstance(error, PermissionError) or number == 13:
        hint = "be in its group (dialout on Debian: sudo adduser $USER dialout), log in again"
        return OutputError(f"{place} may not be used", hint)
    if number in (11, 16) or "exclusively lock" in str(error):
        return OutputError(f"{place} is in use by another program", "end that one")
    return OutputError(f"{place} cannot be opened: {_reason(error)}")


def _list_ports() -> str:
    try:
        names = [p.device for p in connected_ports()]
    except OutputError:
        names = []
    return f"there is {', '.join(names)}" if names else "there is no serial port here: plug the board in"


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error.args[-1] if error.args else error)  # termios.error: (5, "...")
    return " ".join(text.split())


def no_answer(damaged: int, place: str) -> OutputError:
    """Return the error of a port without a valid answer, from the number of damaged ones."""
    if damaged:
        hint = "use shorter wires, see that GND is connected and that both ends have the same baud rate"
        return OutputError(f"{place}something answers, but garbled", hint)
    hint = "see `spheremouse firmware check`, and on a plain serial line whether RX and TX are exchanged"
    return OutputError(f"{place}no board of ours answers", hint)


def example_port() -> str:
    """Return a port's name as this system has it."""
    return "COM5" if os.name == "nt" else "/dev/ttyACM1"
