"""A USB device in software: one half of a cable is the kernel's gadget side, the other half its dummy_hcd port.

The device is a mouse (HID, with the firmware's own report descriptor) and a serial port (ACM), as docs/protocol.md
has it. `run` is the board in it: a process that reads /dev/ttyGS0 and writes /dev/hidg0.
"""

import contextlib
import errno
import os
import select
import sys
import time
import tty
from collections.abc import Callable
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
sys.path.insert(0, str(REPOSITORY / "tests"))

import avr_board  # noqa: E402

CONFIGFS = Path("/sys/kernel/config")
GADGET = CONFIGFS / "usb_gadget/spheremouse"
VENDOR, PRODUCT, NAME = 0x1D6B, 0x0104, "spheremouse"
HID, SERIAL = Path("/dev/hidg0"), Path("/dev/ttyGS0")


# ---- the cable ----


def create(descriptor: bytes) -> None:
    """Describe the device; it is not plugged in yet."""
    if not (CONFIGFS / "usb_gadget").is_dir():
        os.system(f"mount -t configfs configfs {CONFIGFS}")
    hid, acm, config = GADGET / "functions/hid.0", GADGET / "functions/acm.0", GADGET / "configs/c.1"
    for folder in (GADGET, GADGET / "strings/0x409", hid, acm, config, config / "strings/0x409"):
        folder.mkdir()
    for path, text in (
        ("idVendor", hex(VENDOR)),
        ("idProduct", hex(PRODUCT)),
        ("bDeviceClass", "0xef"),
        ("bDeviceSubClass", "2"),
        ("bDeviceProtocol", "1"),
        ("strings/0x409/manufacturer", NAME),
        ("strings/0x409/product", NAME),
        ("strings/0x409/serialnumber", "0001"),
        ("functions/hid.0/report_length", "10"),
        ("functions/hid.0/no_out_endpoint", "1"),  # feature reports then arrive at /dev/hidg0
    ):
        (GADGET / path).write_text(text)
    (hid / "report_desc").write_bytes(descriptor)
    (config / "hid.0").symlink_to(hid)
    (config / "acm.0").symlink_to(acm)


def plug() -> None:
    (GADGET / "UDC").write_text(os.listdir("/sys/class/udc")[0])


def unplug() -> None:
    (GADGET / "UDC").write_text("\n")


# ---- the board ----


class Port:
    """The gadget's side of both functions, for whichever firmware. Never waits, but in `wait`."""

    def __init__(self) -> None:
        self._serial = os.open(SERIAL, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._serial)
        self._hid = os.open(HID, os.O_RDWR | os.O_NONBLOCK)
        self.feature: bytes | None = None

    def wait(self) -> None:
        select.select([self._serial, self._hid], [], [], 0.002)

    def read(self) -> bytes:
        try:
            return os.read(self._serial, 64)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Answers; what the line does not take is gone, as on a wire."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._serial, data)

    def features(self) -> int | None:
        """The byte of the feature report, if the computer has set it anew."""
        try:
            data = os.read(self._hid, 64)
        except BlockingIOError:
            return None
        assert len(data) == 2, data
        assert data[0] == 2, data
        return data[1]

    def room(self, timeout: float = 0.0) -> bool:
        """Whether a report can be handed over, within `timeout` s."""
        return bool(select.select([], [self._hid], [], timeout)[1])

    def send(self, report: bytes) -> None:
        """OSError where it is not taken."""
        os.write(self._hid, b"\1" + report)


def avr(port: Port, library: Path, ready: Callable[[], None]) -> None:
    """The ATmega32U4's protocol.c, turned as its sketch does."""
    board = avr_board.Board(avr_board.load(library), _ms())
    ready()
    while True:
        port.wait()
        answer = board.turn(port.read(), _ms())
        if (feature := port.features()) is not None:
            board.multipliers(feature)
        if port.room() and (report := board.due()) is not None:
            port.send(report)
            board.sent(True)
        if answer:
            port.write(answer)


def pico(port: Port, ready: Callable[[], None]) -> None:
    """The Pico's firmware, on hardware made of the gadget."""
    sys.path.insert(0, str(REPOSITORY / "service/firmware/pico"))
    sys.modules.pop("mouse", None)  # tests/system/mouse.py
    import mouse  # type: ignore[import-not-found]
    import protocol  # type: ignore[import-not-found]

    class Hardware:
        """HID device, data port, LED and runtime in one."""

        value = False
        usb_connected = connected = True
        in_waiting, out_waiting = 1, 0

        def readinto(self, buffer: bytearray) -> int:
            data = port.read()
            buffer[: len(data)] = data
            return len(data)

        def write(self, frame: bytes) -> None:
            port.write(bytes(frame))

        def send_report(self, report: bytearray, number: int) -> None:
            if number != 1 or not port.room(2.0):  # as long as CircuitPython waits
                raise OSError(errno.EAGAIN, "busy")
            port.send(bytes(report))

        def get_last_received_report(self, number: int) -> bytes | None:
            feature = port.features() if number == 2 else None
            return None if feature is None else bytes([feature])

    class Serial(Hardware):
        """Its data port: something may always have come, and reading says so."""

        @property
        def in_waiting(self) -> int:  # type: ignore[override]
            return int(bool(select.select([port._serial], [], [], 0)[0]))

    hardware = Hardware()
    board = mouse.Mouse(protocol.CIRCUITPYTHON, b"gadget", hardware, Serial(), None, hardware, hardware)
    ready()
    while True:
        port.wait()
        board.turn(_ms() & 0x1FFFFFFF)


def _ms() -> int:
    return int(time.monotonic() * 1000)


def run(kind: str, library: Path, ready: Callable[[], None]) -> None:
    try:
        if kind == "avr":
            avr(Port(), library, ready)
        else:
            pico(Port(), ready)
    except OSError as e:
        if e.errno not in (errno.ESHUTDOWN, errno.EIO, errno.ENODEV):
            raise
