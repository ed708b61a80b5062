"""The AVR firmware's protocol code, compiled here with cc, as an object: bytes in, bytes and mouse reports out."""

import ctypes
import functools
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
SOURCES = REPOSITORY / "service/firmware/avr/spheremouse"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wno-sign-conversion", "-Werror"]

Counts = tuple[int, int, int, int]


def compiler() -> str:
    found = shutil.which(os.environ.get("CC", "cc"))
    if found is None:
        import pytest  # not where this runs without tests

        pytest.skip("no C compiler here (apt-get install gcc libc6-dev)")
    return found


def library(folder: Path) -> Path:
    """The protocol and its test bench as a shared library."""
    path = folder / "firmware_avr.so"
    bench = REPOSITORY / "tests/firmware_avr.c"
    sources = [str(SOURCES / "protocol.c"), str(bench)]
    subprocess.run(
        [compiler(), *STRICT, "-O2", "-shared", "-fPIC", f"-I{SOURCES}", "-o", str(path), *sources], check=True
    )
    return path


def load(path: Path) -> ctypes.CDLL:
    found = ctypes.CDLL(str(path))
    found.board_new.restype = ctypes.c_void_p
    found.board_moved.restype = ctypes.c_int64
    found.board_reports.restype = ctypes.c_uint32
    found.board_buttons.restype = ctypes.c_uint8
    found.board_due.restype = ctypes.c_bool
    return found


@functools.cache
def build() -> ctypes.CDLL:
    with tempfile.TemporaryDirectory() as folder:
        return load(library(Path(folder)))  # stays mapped after the file is gone


class Board:
    """An ATmega32U4 without its hardware. Times in ms."""

    def __init__(self, code: ctypes.CDLL, now: int = 0) -> None:
        self._code, self._out = code, ctypes.create_string_buffer(1 << 16)
        self._board = ctypes.c_void_p(code.board_new(ctypes.c_uint32(now)))

    def __del__(self) -> None:
        self._code.board_free(self._board)

    def turn(self, data: bytes, now: int, line: int = 0, step: int = 0) -> bytes:
        """Bytes come in on a line, `step` a ms or all at once; what the board answers."""
        n = self._code.board_turn(
            self._board, line, data, ctypes.c_size_t(len(data)), step, ctypes.c_uint32(now), self._out, 1 << 16
        )
        return ctypes.string_at(self._out, n)

    def usb(self, ready: bool, takes: bool = True) -> None:
        """Whether the computer is awake; whether a report that is sent goes through."""
        self._code.board_usb(self._board, ready, takes)

    def multipliers(self, feature: int) -> None:
        """The computer writes feature report 2."""
        self._code.board_multipliers(self._board, feature)

    @property
    def moved(self) -> Counts:
        """Sum of all reports."""
        x, y, wheel, pan = (self._code.board_moved(self._board, k) for k in range(4))
        return x, y, wheel, pan

    @property
    def reports(self) -> int:
        return self._code.board_reports(self._board)

    @property
    def buttons(self) -> int:
        """Of the last report."""
        return self._code.board_buttons(self._board)

    def due(self) -> bytes | None:
        """The report to send now, from the first call on by the caller; `sent` says what became of it."""
        report = ctypes.create_string_buffer(9)
        return report.raw if self._code.board_due(self._board, report) else None

    def sent(self, taken: bool) -> None:
        """Whether USB took it."""
        self._code.board_sent(self._board, taken)
