"""The ATmega32U4's firmware: its protocol code compiled here, byte by byte against the Pico's."""

import re

import avr_board
import numpy as np
import pytest
from serial_world import conversation

from spheremouse.output.serial import messages
from spheremouse.output.serial.firmware import load_protocol


@pytest.fixture(scope="session")
def code():
    return avr_board.build()


def answers(data):
    """Answers as the host reads them; none is damaged."""
    frames = messages.Splitter()
    found = [messages.parse(frame) for frame in frames.take(data)]
    assert frames.damaged == 0
    assert None not in found
    return found


def test_the_descriptor_is_that_of_the_page(code):
    text = (avr_board.REPOSITORY / "docs/protocol.md").read_text(encoding="utf-8")
    listing = text.split("## The mouse")[1].split("```text\n")[1].split("```")[0]
    documented = bytes.fromhex("".join(re.match(r"(?:[0-9a-f]{2} )+", row)[0] for row in listing.splitlines()))
    ours = bytes((avr_board.ctypes.c_uint8 * len(documented)).in_dll(code, "sm_descriptor"))
    assert ours == documented
    assert f"{len(ours)} bytes" in text


def test_identity_and_a_clock_that_wraps(code):
    board = avr_board.Board(code, now=2**32 - 60)
    (identity,) = answers(board.turn(messages.hello(0, 0x12345678), 2**32 - 60))
    assert (identity.kind, identity.board, identity.session) == (2, "test", 0x12345678)
    board.turn(messages.motion(1, (3, 0, 0, 0), 1), 2**32 - 50)
    board.turn(b"", 49)
    assert board.buttons == 1
    board.turn(b"", 50)
    assert board.buttons == 0


class Pico:
    """The Pico's protocol.py, turned as the AVR's bench turns."""

    def __init__(self):
        self.protocol = load_protocol()
        self.device = self.protocol.Device(self.protocol.AVR, b"test")
        self.device.usb_ready = True
        self.lines = [self.protocol.Line(), self.protocol.Line()]
        self.takes, self.moved, self.reports = True, [0] * 4, 0
        self.device.tick(0)

    def usb(self, ready, takes):
        self.device.set_usb(ready)
        self.takes = takes

    def _pass_on(self):
        if not self.device.due():
            return
        if not self.takes:
            self.device.not_passed_on()
            return
        report = self.device.report
        for k in range(4):
            self.moved[k] += int.from_bytes(report[1 + 2 * k : 3 + 2 * k], "little", signed=True)
        self.reports += 1
        self.device.passed_on()

    def turn(self, data, now, line):
        self.device.tick(now)
        self._pass_on()
        came = self.lines[line]
        for at in range(len(data)):
            came.take(data, at, at + 1)
            if came.length:
                self.device.handle(came, now)
            self._pass_on()
        found = b""
        for each in self.lines:
            while (frame := self.device.answer(each)) is not None:
                found += bytes(frame)
        return found


@pytest.mark.parametrize("seed", range(8))
def test_the_same_bytes_as_the_pico(code, seed):
    """Whatever comes, both boards give the same answers and the same reports."""
    rng, avr, pico, kinds = np.random.default_rng(seed), avr_board.Board(code), Pico(), set()
    for now, line, data in conversation(rng):
        if rng.random() < 0.02:
            ready, takes = bool(rng.random() < 0.7), bool(rng.random() < 0.9)
            avr.usb(ready, takes)
            pico.usb(ready, takes)
        if rng.random() < 0.02:
            feature = int(rng.integers(16))
            avr.multipliers(feature)
            pico.device.set_multipliers(feature)
        said = avr.turn(data, now, line)
        assert said == pico.turn(data, now, line)
        kinds |= {type(a) for a in answers(said)}
        assert (list(avr.moved), avr.reports, avr.buttons) == (pico.moved, pico.reports, pico.device.reported)
    assert kinds == {messages.Identity, messages.Ack, messages.Status}
    assert avr.reports > 100
