"""The ATmega32U4's whole program: built with Debian's toolchain, and run in simavr with a computer at its USB port.

Needs arduino-core-avr (with gcc-avr), and libsimavr-dev with libelf-dev for what runs; without them it is skipped.
"""

import itertools
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import avr_board
import numpy as np
import pytest

from spheremouse.output.serial import link as host
from spheremouse.output.serial import messages

FIRMWARE = avr_board.SOURCES.parent
CORE = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino")
SESSIONS = itertools.count(1)  # never one twice
MOST_FLASH, MOST_RAM = 28672, 2560  # bytes: a Leonardo's without its boot loader


def make(source, target):
    command = ["make", "-s", "-j2", "-C", str(source), f"BUILD={target}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    return target / "spheremouse.elf"


@pytest.fixture(scope="module")
def elf(tmp_path_factory):
    if not all(map(shutil.which, ("make", "avr-g++"))) or not CORE.is_dir():
        pytest.skip("no AVR toolchain here (apt-get install make arduino-core-avr)")
    return make(FIRMWARE, tmp_path_factory.mktemp("avr") / "build")


def test_it_fits_and_allocates_nothing(elf):
    table = subprocess.run(["avr-size", str(elf)], capture_output=True, text=True, check=True).stdout
    text, data, bss = map(int, table.splitlines()[1].split()[:3])
    print(f"flash {text + data} bytes, RAM {data + bss} bytes")
    assert text + data < MOST_FLASH
    assert data + bss < MOST_RAM / 2  # the other half for the stack
    names = subprocess.run(["avr-nm", str(elf)], capture_output=True, text=True, check=True).stdout
    assert " main\n" in names
    assert not re.search(r" (malloc|realloc|_Znwj)\n", names)


def test_the_same_bytes_wherever_it_is_built(elf, tmp_path):
    copy = tmp_path / "another place"
    shutil.copytree(FIRMWARE, copy, ignore=shutil.ignore_patterns("build"))
    again = make(copy, tmp_path / "out")
    assert again.with_suffix(".hex").read_bytes() == elf.with_suffix(".hex").read_bytes()


# ---- in the simulator ----


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    path = tmp_path_factory.mktemp("simavr") / "simulator"
    source = avr_board.REPOSITORY / "tests/firmware_simavr.c"
    done = subprocess.run(
        [avr_board.compiler(), "-O2", "-o", str(path), str(source), "-lsimavr", "-lelf"],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        if Path("/usr/include/simavr").is_dir() and Path("/usr/include/libelf.h").exists():
            pytest.fail(done.stderr)
        pytest.skip("no simavr here (apt-get install libsimavr-dev libelf-dev)")
    return path


class Computer:
    """A computer that the board is plugged into. Time is that of the simulated crystal, in ms."""

    def __init__(self, simulator, elf):
        self._process: Any = subprocess.Popen([simulator, elf], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.now, self.moved, self.buttons, self.reports = 0, [0] * 4, 0, 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        assert self._process.wait(10) == 0

    def _ask(self, data, answers=1) -> Any:
        self._process.stdin.write(data)
        self._process.stdin.flush()
        found = []
        for _ in range(answers):
            (n,) = struct.unpack("<H", self._process.stdout.read(2))
            found.append(None if n == 0xFFFF else self._process.stdout.read(n))
        return found

    def control(self, kind, request, value, index, length, data=b"") -> Any:
        """A control transfer; None where the board refuses."""
        setup = struct.pack("<BBHHH", kind, request, value, index, length)
        return self._ask(b"C" + setup + struct.pack("<H", len(data)) + data)[0]

    def descriptor(self, kind, number=0, kind_of_request=0x80, index=0) -> Any:
        return self.control(kind_of_request, 6, kind << 8 | number, index, 255)

    def enumerate(self, fine=True):
        """As an operating system does it: reset, descriptors, configuration, the port opened, multipliers set."""
        self._ask(b"R")
        self.device = self.descriptor(1)
        self.configuration = self.descriptor(2)
        assert self.control(0x00, 9, 1, 0, 0) == b""
        self.report_descriptor = self.descriptor(0x22, kind_of_request=0x81, index=2)
        assert self.control(0x21, 0x0A, 0, 2, 0) == b""  # SET_IDLE
        assert self.control(0x21, 0x22, 3, 0, 0) == b""  # DTR and RTS
        if fine:
            assert self.control(0x21, 9, 0x0302, 2, 2, bytes([2, 5])) == b""  # SET_REPORT

    def turn(self, ms, data=b"", line=b"T"):
        """Time passes while data goes out; what came back. Line `T` is USB, `P` the pins."""
        self.now += ms
        said, reports = self._ask(line + struct.pack("<HH", ms, len(data)) + data, 2)
        assert len(reports) % 10 == 0
        for number, buttons, *moves in struct.iter_unpack("<BB4h", reports):
            assert number == 1
            self.buttons = buttons
            self.reports += 1
            self.moved = [a + b for a, b in zip(self.moved, moves, strict=True)]
        return said


@pytest.fixture
def computer(simulator, elf):
    with Computer(simulator, elf) as found:
        found.enumerate()
        yield found


def test_the_computer_sees_a_mouse_and_a_serial_port(computer):
    assert struct.unpack("<HH", computer.device[8:12]) == (0x2341, 0x8036)
    names = [computer.descriptor(3, computer.device[k])[2:].decode("utf-16-le") for k in (15, 16)]
    assert names == ["spheremouse", "spheremouse"]  # product, serial number
    found, interfaces, at = computer.configuration, [], 0
    while at < len(found):
        if found[at + 1] == 4:
            interfaces.append(tuple(found[at + 5 : at + 8]))
        at += found[at]
    assert interfaces == [(2, 2, 0), (10, 0, 0), (3, 0, 0)]  # ACM, its data, HID
    (size,) = struct.unpack("<H", found[at - 7 - 2 : at - 7])  # in its HID descriptor
    descriptor = (avr_board.ctypes.c_uint8 * size).in_dll(avr_board.build(), "sm_descriptor")
    assert computer.report_descriptor == bytes(descriptor)  # which test_firmware.py compares with the Pico's


def test_multipliers_are_kept_until_the_next_reset(computer):
    def multipliers():
        return computer.control(0xA1, 1, 0x0302, 2, 2)

    assert multipliers() == bytes([2, 5])
    assert computer.control(0x21, 9, 0x0302, 2, 2, bytes([2, 1])) == b""
    assert multipliers() == bytes([2, 1])
    assert computer.control(0x21, 9, 0x0202, 2, 2, bytes([2, 1])) is None  # no such output report
    computer.enumerate(fine=False)
    assert multipliers() == bytes([2, 0])


def play(computer, moves, buttons=lambda n: 0, line=b"T", every=1):
    """The host's ledger at one end of the cable, the program at the other: a motion `every` ms. The link, at rest."""
    link = host.Link(SESSIONS.__next__)
    waiting, n = link.port_opened(computer.now / 1000), 0
    while n < len(moves) or not link.settled:
        assert n < len(moves) + 1000
        now = computer.now / 1000
        if n < len(moves):
            link.add(moves[n], now)
        else:
            link.keep_alive(now)
        link.buttons = buttons(n)
        n += 1
        while (frame := link.next_frame(now)) is not None:
            waiting += frame
        link.receive(computer.turn(every, waiting, line), computer.now / 1000)
        waiting = b""
    computer.turn(3)  # what was passed on to USB is fetched at the next ms
    return link


def test_a_thousand_motions_a_second(computer):
    rng = np.random.default_rng(32)
    moves = rng.integers(-60, 61, (2000, 4)).tolist()
    link = play(computer, moves)
    assert computer.moved == np.sum(moves, axis=0).tolist()
    assert link.dropped == link.uncertain == [0] * 4
    assert link.sessions == 1
    said = computer.turn(2, messages.encode(messages.ASK_STATUS, 60_000))
    (status,) = [f for f in map(messages.parse, messages.Splitter().take(said)) if isinstance(f, messages.Status)]
    assert (status.damaged, status.refused, status.usb_errors) == (0, 0, 0)
    assert link.motions > 1900  # it kept up: nearly each motion had a frame of its own
    print(f"{len(moves)} motions in {link.motions} frames, {link.acks} answers, {computer.reports} reports")


def test_two_computers_the_pins_at_115200_baud(computer):
    rng = np.random.default_rng(35)
    moves = rng.integers(-60, 61, (500, 4)).tolist()
    link = play(computer, moves, line=b"P", every=2)
    assert computer.moved == np.sum(moves, axis=0).tolist()
    assert (link.sessions, link.damaged) == (1, 0)
    assert link.motions > 490  # 500 frames a second
    print(f"pins: {len(moves)} motions in {link.motions} frames, {link.acks} answers")


def test_a_flood_and_a_computer_that_does_not_read(computer):
    rng = np.random.default_rng(34)
    for junk in (rng.integers(0, 256, 3000, dtype=np.uint8).tobytes(), b"\1" * 3000, messages.hello(1, 9) * 200):
        computer.turn(60, junk)
    play(computer, [(2, -1, 0, 0)] * 50)
    assert computer.moved == [100, -50, 0, 0]


def test_plugged_in_again(computer):
    play(computer, [(2, -1, 0, 0)] * 30, buttons=lambda n: 1)
    computer.enumerate()
    computer.turn(150)
    play(computer, [(2, -1, 0, 0)] * 30)
    assert computer.moved == [120, -60, 0, 0]
