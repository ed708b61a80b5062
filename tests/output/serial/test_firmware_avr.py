"""The ATmega32U4's firmware: its protocol code compiled here, byte by byte against the host's and the Pico's."""

import itertools
import random
import re

import avr_board
import numpy as np
import pytest

from spheremouse.files.service import service_files
from spheremouse.output.serial import link as host
from spheremouse.output.serial import messages
from spheremouse.output.serial.firmware import PICO, load_protocol

HELLO_1 = messages.hello(0, 0xABCD0001)
FINE = 0b0101  # both resolution multipliers


@pytest.fixture(scope="session")
def code():
    return avr_board.build()


@pytest.fixture
def board(code):
    found = avr_board.Board(code)
    found.multipliers(FINE)
    return found


def answers(data):
    """Answers as the host reads them; none is damaged."""
    frames = messages.Splitter()
    found = [messages.parse(frame) for frame in frames.take(data)]
    assert frames.damaged == 0
    assert None not in found
    return found


def begin(board, session=7, number=0, now=0, line=0):
    (identity,) = answers(board.turn(messages.hello(number, session), now, line))
    assert isinstance(identity, messages.Identity)
    assert identity.session == session
    return identity


# ---- the rules ----


def test_descriptor_is_that_of_the_protocol():
    text = (avr_board.REPOSITORY / "docs/protocol.md").read_text(encoding="utf-8")
    listing = text.split("## The mouse")[1].split("```text\n")[1].split("```")[0]
    documented = bytes.fromhex("".join(re.match(r"(?:[0-9a-f]{2} )+", row)[0] for row in listing.splitlines()))
    code = avr_board.build()
    ours = bytes((avr_board.ctypes.c_uint8 * len(documented)).in_dll(code, "sm_descriptor"))
    assert ours == documented
    assert f"{len(ours)} bytes" in text


def test_identity_and_status(board):
    identity = begin(board, session=0x12345678)
    assert (identity.kind, identity.board, identity.firmware) == (2, "test", (1, 0, 0))
    assert (identity.step, identity.silence) == (host.STEP, round(1000 * host.SILENCE))
    assert (identity.first, identity.last, identity.counters) == (0x12345678, 0, (0, 0, 0, 0))
    (status,) = answers(board.turn(b"\x05nonsense\0" + messages.encode(messages.ASK_STATUS, 1), 65))
    assert (status.session, status.frames, status.damaged, status.uptime) == (0x12345678, 2, 1, 0)
    (status,) = answers(board.turn(messages.encode(messages.ASK_STATUS, 2), 70_001))
    assert (status.session, status.frames, status.uptime) == (0, 3, 70)


def test_motions_become_reports(board):
    begin(board)
    (ack,) = answers(board.turn(messages.motion(1, (5, -7, 120, -3), 0b10001), 1))
    assert (ack.number, messages.Flags(ack.flags)) == (1, messages.Flags(0x1D))
    assert [messages.signed(c) for c in ack.counters] == [5, -7, 120, -3]
    assert (board.moved, board.reports, board.buttons) == ((5, -7, 120, -3), 1, 0b10001)
    board.turn(messages.motion(1, (9, 9, 9, 9), 0), 2)  # not newer
    board.turn(messages.motion(0, (9, 9, 9, 9), 0), 2)
    assert board.moved == (5, -7, 120, -3)
    (ack,) = answers(board.turn(messages.motion(4, (-1195, 1193, 1320, -1203), 0), 3))
    assert (ack.refused, ack.lost) == (2, 2)
    assert board.moved == (-1195, 1193, 1320, -1203)  # a step of 1200 passes


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize("step", [1201, -1201, 32767, -32768])
def test_a_step_that_no_hand_makes_ends_the_session(board, axis, step):
    begin(board)
    board.turn(messages.motion(1, (1, 1, 1, 1), 1), 1)
    counters = [1, 1, 1, 1]
    counters[axis] += step
    (ack,) = answers(board.turn(messages.motion(2, counters, 3), 2))
    assert ack.flags & (messages.Flags.RUNNING | messages.Flags.TOO_LARGE) == messages.Flags.TOO_LARGE
    assert (board.moved, board.buttons) == ((1, 1, 1, 1), 0)
    assert begin(board, session=8, number=3, now=3).counters == (1, 1, 1, 1)


def test_counters_wrap(board):
    begin(board)
    for n in range(1, 201):
        board.turn(messages.motion(n, (1200 * n, -1200 * n, 0, 0), 0), n)
    assert board.moved == (240_000, -240_000, 0, 0)


def test_silence_of_100_ms_ends_the_session_and_releases(board):
    begin(board)
    board.turn(messages.motion(1, (3, 0, 0, 0), 1), 50)
    board.turn(messages.encode(messages.ASK_STATUS, 2), 149)  # does not break it
    assert board.buttons == 1
    board.turn(b"", 150)
    assert board.buttons == 0
    (ack,) = answers(board.turn(messages.motion(3, (9, 0, 0, 0), 1), 151))
    assert not ack.flags & messages.Flags.RUNNING
    assert board.moved == (3, 0, 0, 0)
    identity = begin(board, session=8, number=4, now=160)
    assert (identity.last, identity.counters, identity.first) == (7, (3, 0, 0, 0), 7)
    assert board.turn(messages.hello(5, 7) + b"\0", 161) == b""  # a HELLO that strayed


def test_time_wraps(code):
    board = avr_board.Board(code, now=2**32 - 60)
    begin(board, now=2**32 - 60)
    board.turn(messages.motion(1, (3, 0, 0, 0), 1), 2**32 - 50)
    board.turn(b"", 49)
    assert board.buttons == 1
    board.turn(b"", 50)
    assert board.buttons == 0


def test_stop_releases(board):
    begin(board)
    board.turn(messages.motion(1, (3, 0, 0, 0), 31), 1)
    (ack,) = answers(board.turn(messages.encode(messages.STOP, 2), 2))
    assert (ack.number, ack.flags & messages.Flags.RUNNING, board.buttons) == (2, 0, 0)


def test_a_computer_that_sleeps_gets_it_when_it_wakes(board):
    begin(board)
    board.turn(messages.motion(1, (3, 0, 0, 0), 1), 1)
    board.usb(ready=False)
    (ack,) = answers(board.turn(messages.motion(2, (50, 0, 0, 0), 3), 2))
    assert (ack.counters[0], ack.flags & messages.Flags.USB_READY) == (3, 0)
    board.usb(ready=True, takes=False)
    board.turn(b"", 3)
    assert board.moved[0] == 3
    board.usb(ready=True)
    board.turn(b"", 4)
    assert (board.moved[0], board.buttons) == (50, 3)


def test_a_computer_that_wakes_is_told_the_buttons_anew(board):
    begin(board)
    board.turn(messages.motion(1, (3, 0, 0, 0), 1), 1)
    before = board.reports
    board.usb(ready=False)
    board.turn(b"", 2)
    board.usb(ready=True)
    board.turn(b"", 3)
    board.turn(b"", 4)
    assert (board.reports, board.buttons) == (before + 1, 1)


def test_a_hello_of_another_session_is_no_gap(board):
    begin(board, session=1, number=40_000)
    board.turn(messages.motion(40_001, (1, 0, 0, 0), 0), 1)
    begin(board, session=2, number=0, now=5)
    (ack,) = answers(board.turn(messages.motion(1, (1, 0, 0, 0), 0), 6))
    assert ack.lost == 0
    board.turn(messages.hello(4, 2), 7)
    assert answers(board.turn(messages.motion(5, (1, 0, 0, 0), 0), 8))[0].lost == 2  # of its own one there is


def test_two_lines(board):
    begin(board, session=7)
    board.turn(messages.motion(1, (3, 0, 0, 0), 1), 1)
    begin(board, session=8, line=1, now=2)
    assert board.buttons == 0
    (ack,) = answers(board.turn(messages.motion(2, (9, 0, 0, 0), 1), 3))
    assert not ack.flags & messages.Flags.RUNNING
    (ack,) = answers(board.turn(messages.motion(1, (4, 0, 0, 0), 0), 4, line=1))
    assert ack.flags & messages.Flags.RUNNING
    assert board.moved[0] == 7


def test_another_version_is_told(board):
    (identity,) = answers(board.turn(messages.encode(messages.HELLO, 0, bytes(4), version=2), 0))
    assert identity.session == 0
    (ack,) = answers(board.turn(messages.motion(1, (1, 0, 0, 0), 0), 1))
    assert not ack.flags & messages.Flags.RUNNING


@pytest.mark.parametrize("sign", [1, -1])
def test_notches_are_whole_until_the_computer_asks_for_less(board, sign):
    board.multipliers(0)
    begin(board)
    for n in range(1, 61):
        board.turn(messages.motion(n, (0, 0, sign * 7 * n, -sign * 50 * n), 0), n)
    assert board.moved == (0, 0, sign * (420 // 120), -sign * (3000 // 120))
    assert board.reports < 60  # none for a part of a notch
    board.multipliers(0b0001)
    board.turn(messages.motion(61, (0, 0, sign * 421, -sign * 3000), 0), 61)
    assert board.moved == (0, 0, sign * 4, -sign * 25)


# ---- the line's accidents ----


def test_a_flood_a_cut_and_noise_harm_the_next_frame_at_most(board):
    rng = random.Random(3)
    begin(board)
    sure = 0
    for n in range(1, 300):
        junk = bytes(rng.randrange(256) for _ in range(rng.randrange(300)))
        cut = messages.motion(9999, (n + 500, 0, 0, 0), 0)[: rng.randrange(18)]
        board.turn(junk + b"\1" * rng.choice([0, 0, 5000]) + cut, n)
        assert board.moved[0] == sure
        board.turn(messages.motion(2 * n - 1, (n, 0, 0, 0), 0), n)  # may stick to the rest of the junk
        board.turn(messages.motion(2 * n, (n, 0, 0, 0), 0), n)
        sure = n
        assert board.moved[0] == n


@pytest.mark.parametrize("length", [0, 1, 7, 60, 63, 64, 65, 66, 253, 254, 255, 256, 1000])
def test_frames_of_every_length(board, length):
    begin(board)
    rng = random.Random(length)
    content = bytes(rng.randrange(256) for _ in range(length))
    before = answers(board.turn(messages.encode(messages.ASK_STATUS, 1), 1))[0].damaged
    board.turn(messages.cobs.encode(content) + b"\0", 1)
    (status,) = answers(board.turn(messages.encode(messages.ASK_STATUS, 2), 1))
    assert status.damaged == before + 1
    assert status.lost == 0


def test_reset_in_mid_stream(code):
    """Through the host's ledger: nothing doubled, at most what was under way lost, and told."""
    for at in range(2, 60, 3):
        link, boards = host.Link(itertools.count(1).__next__), [avr_board.Board(code)]
        boards[0].multipliers(FINE)
        waiting = link.opened(0.0)
        for now in range(1, 301):
            if now <= 200:
                link.add((3, -2, 1, 0), now / 1000)
            if now == at:  # between a MOTION's passing on and its ACK
                boards[-1].turn(waiting, now)
                boards.append(avr_board.Board(code, now))
                boards[-1].multipliers(FINE)
                waiting = b""
            link.receive(boards[-1].turn(waiting, now), now / 1000)
            waiting = b""
            while (frame := link.due(now / 1000)) is not None:
                waiting += frame
        moved = np.sum([b.moved for b in boards], axis=0)
        short = np.array([600, -400, 200, 0]) - moved
        assert np.all(np.abs(short) <= np.abs(link.uncertain)), (at, moved, link.uncertain)
        assert np.all(np.abs(link.uncertain) <= host.STEP)
        assert link.settled


def damage(data, rng, share=0.01):
    """Some bytes become others."""
    raw = np.frombuffer(data, np.uint8)
    hit = rng.random(len(raw)) < share
    return np.where(hit, raw ^ rng.integers(1, 256, len(raw), dtype=np.uint8), raw).tobytes()


def test_host_and_board_over_a_line_that_damages_1_percent_both_ways(board):
    rng = np.random.default_rng(26)
    moves = rng.integers(-20, 21, (100_000, 4)).tolist()
    link, now = host.Link(itertools.count(1).__next__), 0
    waiting = link.opened(0.0)
    while now < len(moves) + 500 and not (now > len(moves) and link.settled):
        if now < len(moves):
            link.add(moves[now], now / 1000)
        else:
            link.alive(now / 1000)
        now += 1
        link.receive(damage(board.turn(damage(waiting, rng), now), rng), now / 1000)
        waiting = b""
        while (frame := link.due(now / 1000)) is not None:
            waiting += frame
    assert link.settled
    assert link.dropped == link.uncertain == [0] * 4
    assert list(board.moved) == np.sum(moves, axis=0).tolist()
    (status,) = [
        s
        for s in answers(board.turn(b"\0" + messages.encode(messages.ASK_STATUS, 0), now))
        if isinstance(s, messages.Status)
    ]
    assert status.damaged > 10_000  # the line was as bad as that


def encoded(counters, buttons):
    """MOTION frames of many counters, (n, 4) u16, numbered from 1: (n, 19) bytes. Another way than the host's."""
    n = len(counters)
    content = np.zeros((n, 17), np.uint8)
    content[:, 0], content[:, 1] = 1, 2
    numbers = np.arange(1, n + 1, dtype=np.uint32).astype(np.uint16)
    content[:, 2:4] = numbers[:, None].view(np.uint8).reshape(n, 2)
    content[:, 4:12] = np.ascontiguousarray(counters, np.uint16).view(np.uint8).reshape(n, 8)
    content[:, 12] = buttons
    crc = np.full(n, 0xFFFFFFFF, np.uint32)
    for k in range(13):
        crc ^= content[:, k]
        for _ in range(8):
            crc = crc >> np.uint32(1) ^ np.where(crc & np.uint32(1), np.uint32(0xEDB88320), np.uint32(0))
    content[:, 13:] = (~crc)[:, None].view(np.uint8).reshape(n, 4)
    frames = np.zeros((n, 19), np.uint8)
    frames[:, 1:18] = content
    after = np.full(n, 18)  # where the next 0, or the end, is
    for k in range(17, -1, -1):
        zero = (frames[:, k] == 0) | (k == 0)
        frames[:, k] = np.where(zero, after - k, frames[:, k])
        after = np.where(zero, k, after)
    return frames


def test_the_fast_encoder_is_right():
    rng = np.random.default_rng(5)
    counters = rng.integers(0, 65536, (3000, 4)) * (rng.random((3000, 4)) < 0.6)
    for n, frame in enumerate(encoded(counters, 3), 1):
        assert frame.tobytes() == messages.motion(n, counters[n - 1].tolist(), 3)


def test_a_million_motions_with_1_percent_of_bytes_damaged(board):
    rng = np.random.default_rng(2017)
    moves = rng.integers(-30, 31, (1_000_000, 4), dtype=np.int32)
    totals = moves.cumsum(axis=0)
    frames = encoded(totals.astype(np.uint16), 0).tobytes()
    begin(board)
    board.turn(damage(frames, rng), 0, step=19)  # one a ms
    now = 1_000_000
    board.turn(b"\0" + messages.motion(1_000_001, totals[-1].tolist(), 0), now)  # as the host repeats it
    assert list(board.moved) == totals[-1].tolist()
    (status,) = answers(board.turn(messages.encode(messages.ASK_STATUS, 1_000_002), now))
    assert status.session == 7  # the one that was begun
    assert 150_000 < (1_000_000 - status.frames) < 200_000  # 17 % lost their frame
    print(f"{1_000_000 - status.frames} frames damaged, sums {board.moved}")


# ---- as the Pico ----


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
    if not (service_files(PICO) / "protocol.py").exists():
        pytest.skip("no firmware of the Pico here")
    rng = random.Random(seed)
    avr, pico = avr_board.Board(code), Pico()
    now, counters, number, sessions, kinds = 0, [0] * 4, [0, 0], [1, 2, 3, 0], set()
    for _ in range(1500):
        now += rng.choice([0, 0, 1, 1, 1, 2, 5, 20] if rng.random() < 0.98 else [98, 99, 100, 101])
        line = int(rng.random() < 0.1)
        number[line] = (number[line] + rng.choice([1] * 100 + [0, 2, 7, -1, 0x7FFF, 0x8000])) & 0xFFFF
        data = b""
        for _ in range(rng.choice([0, 1, 1, 1, 2])):
            what = rng.random()
            if what < 0.06:
                sessions.append(rng.randrange(1, 2**32))
                data += messages.hello(number[line], rng.choice(sessions[-3:]))
                counters = [0] * 4
            elif what < 0.9:
                most = 3000 if rng.random() < 0.01 else 100
                counters = [(c + rng.randint(-most, most)) & 0xFFFF for c in counters]
                data += messages.motion(number[line], counters, rng.choice([0, 0, 1, 0xFF]))
            elif what < 0.95:
                data += messages.encode(messages.ASK_STATUS, number[line])
            elif what < 0.97:
                data += messages.encode(messages.STOP, number[line])
            else:
                body = bytes(rng.randrange(256) for _ in range(rng.choice([0, 4, 9, 60])))
                data += messages.encode(rng.choice([0, 1, 2, 3, 4, 5, 0x82]), number[line], body, rng.choice([1, 1, 2]))
        data = bytes(b if rng.random() > 0.002 else rng.randrange(256) for b in data)
        if rng.random() < 0.02:
            ready, takes = rng.random() < 0.7, rng.random() < 0.9
            avr.usb(ready, takes)
            pico.usb(ready, takes)
        if rng.random() < 0.02:
            feature = rng.randrange(16)
            avr.multipliers(feature)
            pico.device.set_multipliers(feature)
        said = avr.turn(data, now, line)
        assert said == pico.turn(data, now, line)
        kinds |= {type(a) for a in answers(said)}
        assert (list(avr.moved), avr.reports, avr.buttons) == (pico.moved, pico.reports, pico.device.reported)
    assert kinds == {messages.Identity, messages.Ack, messages.Status}
    assert avr.reports > 100
