"""The protocol: frames byte by byte, the rules of a board, and the law that every count arrives or is reported."""

import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_world import Board, Wire, World
from simulated_board import load_protocol

from spheremouse.output.serial import messages
from spheremouse.output.serial.link import SILENCE, STEP_LIMIT, Link
from spheremouse.output.serial.messages import BODY_BYTES, Flags, Splitter, parse

BOARD: Any = load_protocol()
PAGE = (Path(__file__).parents[3] / "docs" / "protocol.md").read_text(encoding="utf-8")
bodies = st.sampled_from(sorted(BODY_BYTES.items())).flatmap(
    lambda item: st.tuples(st.just(item[0]), st.binary(min_size=item[1], max_size=item[1]))
)


def taken(data, piece):
    """Contents of the undamaged frames that the board finds."""
    line, found = BOARD.Line(), []
    for k in range(0, len(data), piece):
        part, at = data[k : k + piece], 0
        while at < len(part):
            at = line.take(part, at, len(part))
            if line.length:
                found.append(bytes(line.content[: line.length]))
    return found


# ---- frames ----


def test_types_lengths_and_check_sum_are_those_of_the_page():
    rows = re.findall(r"^\| (0x[0-9a-f]{2}) \| (\S+) \|[^|]+\| (\d+) \| (\d+) \| (\d+) \|$", PAGE, re.M)
    assert {int(code, 16): int(body) for code, _, body, _, _ in rows} == BODY_BYTES
    for code, name, body, content, line in rows:
        constant = "ASK_STATUS" if name == "STATUS?" else name
        assert getattr(messages, constant) == getattr(BOARD, constant) == int(code, 16)
        assert int(content) == int(body) + 8 <= messages.MAX_CONTENT_BYTES
        for fill in (b"\0", b"\x07", b"\xff"):
            assert len(messages.encode(int(code, 16), 0, fill * int(body))) == int(line) == int(content) + 2
    assert f"0x{zlib.crc32(b'123456789'):X}" == "0xCBF43926"
    assert "0xCBF43926" in PAGE


@given(bodies, st.integers(0, 2**16 - 1))
def test_the_board_makes_the_same_bytes(body, number):
    kind, data = body
    frame = bytearray(len(data) + 10)
    frame[1 : 5 + len(data)] = bytes([1, kind, 0, 0]) + data
    BOARD.seal(frame, number)
    assert bytes(frame) == messages.encode(kind, number, data)


@settings(max_examples=150)
@given(
    st.lists(st.one_of(bodies.map(lambda b: messages.encode(b[0], 9, b[1])), st.binary(max_size=90))), st.integers(1, 9)
)
def test_both_ends_find_the_same_frames_in_any_bytes(pieces, cut):
    """Noise, cuts and floods: the two decoders are independent, and must agree."""
    data = b"".join(pieces) + b"\0"
    splitter, frames = Splitter(), []
    for k in range(0, len(data), cut):
        frames += splitter.take(data[k : k + cut])
    known = [c for c in taken(data, cut) if c[0] != 1 or BODY_BYTES.get(c[1]) == len(c) - 8]
    assert [(f.version, f.type, f.number, f.body) for f in frames] == [
        (c[0], c[1], int.from_bytes(c[2:4], "little"), c[4:-4]) for c in known
    ]


@given(bodies, st.integers(0, 2000), st.integers(1, 255))
def test_one_damaged_byte_is_always_noticed(body, at, change):
    coded = bytearray(messages.encode(body[0], 77, body[1]))
    coded[at % (len(coded) - 1)] ^= change
    assert [c for c in taken(bytes(coded), len(coded)) if len(c) == BODY_BYTES[body[0]] + 8] == []
    assert [f for f in Splitter().take(bytes(coded)) if f.version == 1] == []


def test_a_name_of_control_characters_stays_off_the_terminal():
    body = bytes(28) + b"\x1b[2Jdesk\x07".ljust(16, b"\0")
    (found,) = map(parse, Splitter().take(messages.encode(messages.IDENTITY, 0, body)))
    assert isinstance(found, messages.Identity)
    assert found.board == "?[2Jdesk?"


# ---- the board's rules; the other firmwares answer the same (test_firmware.py) ----


def asked(board, data, now=0) -> Any:
    """The board's answers, parsed."""
    return [parse(f) for f in Splitter().take(board.turn(data, now))]


def begun(session=7, number=100, now=0) -> Any:
    board = Board()
    (identity,) = asked(board, messages.hello(number, session), now)
    assert identity.session == session
    return board


def test_identity_has_the_figures_of_the_page():
    (found,) = asked(Board(), messages.hello(1, 0xDEADBEEF))
    assert (found.session, found.last, found.counters, found.first) == (0xDEADBEEF, 0, (0, 0, 0, 0), 0xDEADBEEF)
    assert (found.step, found.silence) == (STEP_LIMIT, 1000 * SILENCE) == (1200, 100)
    assert (found.firmware, found.kind, found.board) == (BOARD.FIRMWARE, 3, "simulator")


def test_counters_are_passed_on_and_acknowledged():
    board = begun()
    (ack,) = asked(board, messages.motion(101, (3, -4, 5, -6), 0b10), 10)
    assert (ack.number, ack.counters) == (101, (3, 2**16 - 4, 5, 2**16 - 6))
    assert ack.flags == Flags.RUNNING | Flags.USB_READY | Flags.WHEEL_FINE | Flags.PAN_FINE
    assert (board.moved, board.buttons) == ([3, -4, 5, -6], 0b10)


def test_repeated_and_late_frames_change_nothing_and_lost_ones_are_counted():
    board = begun(number=0xFFFC)
    asked(board, messages.motion(0xFFFD, (10, 0, 0, 0), 0) + messages.motion(0xFFFE, (20, 0, 0, 0), 1))
    for old in (messages.motion(0xFFFE, (20, 0, 0, 0), 0), messages.motion(0xFFFD, (10, 0, 0, 0), 0)):
        (ack,) = asked(board, old)
        assert ack.flags & Flags.RUNNING
    assert (board.moved[0], board.buttons, ack.refused, ack.lost) == (20, 1, 2, 0)
    assert asked(board, messages.motion(0x0003, (21, 0, 0, 0), 0))[0].lost == 4
    asked(board, messages.hello(0x4000, 8))  # another session's numbers begin anywhere
    assert asked(board, messages.motion(0x4001, (1, 0, 0, 0), 0))[0].lost == 4


@pytest.mark.parametrize(("step", "obeyed"), [(1200, True), (-1200, True), (1201, False), (-1201, False)])
@pytest.mark.parametrize("axis", range(4))
def test_a_step_larger_than_a_hand_can_turn_is_refused_and_ends_the_session(axis, step, obeyed):
    board = begun()
    counters = [0, 0, 0, 0]
    counters[axis] = step
    (ack,) = asked(board, messages.motion(101, counters, 1))
    assert bool(ack.flags & Flags.TOO_LARGE) != obeyed
    assert bool(ack.flags & Flags.RUNNING) == obeyed
    assert board.moved[axis] == (step if obeyed else 0)
    assert (board.buttons, ack.refused) == (obeyed, not obeyed)


def test_silence_releases_buttons_and_ends_the_session():
    board = begun(now=2**29 - 50)  # the ticks wrap meanwhile
    asked(board, messages.motion(101, (5, 0, 0, 0), 0b11111), 2**29 - 40)
    board.turn(messages.encode(messages.ASK_STATUS, 102), 59)  # does not restart the timer
    assert board.buttons == 0b11111
    board.turn(b"", 60)
    assert board.buttons == 0
    (ack,) = asked(board, messages.motion(103, (9, 0, 0, 0), 1), 61)
    assert not ack.flags & Flags.RUNNING
    assert (board.moved[0], board.buttons) == (5, 0)
    (identity,) = asked(board, messages.hello(104, 8), 62)
    assert (identity.last, identity.counters, identity.first) == (7, (5, 0, 0, 0), 7)


def test_a_repeated_hello_changes_nothing_and_that_of_the_last_session_is_refused():
    board = begun(7)
    asked(board, messages.motion(101, (5, 0, 0, 0), 0))
    (again,) = asked(board, messages.hello(102, 7))
    assert again.last == 0
    assert asked(board, messages.motion(103, (6, 0, 0, 0), 0))[0].counters[0] == 6
    (other,) = asked(board, messages.hello(104, 8))
    assert (other.last, other.counters[0]) == (7, 6)
    assert asked(board, messages.hello(105, 7)) == []
    assert asked(board, messages.motion(106, (1, 0, 0, 0), 0))[0].flags & Flags.RUNNING
    assert board.moved[0] == 7


def test_a_session_without_a_motion_leaves_no_trace():
    board = begun(7)
    asked(board, messages.motion(101, (5, 0, 0, 0), 0))
    asked(board, messages.hello(102, 8), 1)  # its answer is lost
    board.turn(b"", 150)
    (again,) = asked(board, messages.hello(103, 8), 160)
    assert (again.session, again.last, again.counters[0]) == (8, 7, 5)


def test_counts_of_a_sleeping_computer_stay_due_and_buttons_are_sent_again_on_waking():
    board = begun()
    asked(board, messages.motion(101, (1, 0, 0, 0), 1))
    board.awake = False
    (ack,) = asked(board, messages.motion(102, (7, 0, 130, 0), 1))
    assert (ack.counters, bool(ack.flags & Flags.USB_READY)) == ((1, 0, 0, 0), False)
    board.awake, board.buttons = True, 0  # a restarted computer knows no button
    (ack,) = asked(board, messages.motion(103, (9, 0, 130, 0), 1))
    assert (ack.counters, board.moved, board.buttons) == ((9, 0, 130, 0), [9, 0, 130, 0], 1)


def test_another_version_is_answered_with_ours():
    board = Board()
    (found,) = asked(board, messages.encode(messages.HELLO, 1, b"\1\2\3\4", version=2))
    assert found.session == 0
    assert not board.device.running
    assert board.turn(messages.encode(messages.MOTION, 1, bytes(9), version=2), 0) == b""


@given(st.lists(st.integers(-400, 400), max_size=30))
def test_whole_notches_if_the_computer_has_set_no_multiplier(turns):
    board, at = Board(fine=0), 0
    asked(board, messages.hello(0, 7))
    for k, n in enumerate(turns):
        at += n
        (ack,) = asked(board, messages.motion(k + 1, (0, 0, at, -at), 0))
        assert ack.counters[2] == at % 2**16
        assert abs(at - board.moved[2]) < 120
        assert board.moved[3] == -board.moved[2]


def test_status_counts():
    board = begun()
    asked(board, messages.motion(101, (1, 0, 0, 0), 1) + b"\1\2\3\0", 5)
    (status,) = asked(board, messages.encode(messages.ASK_STATUS, 103), 50)
    assert (status.session, status.frames, status.damaged, status.lost, status.reports) == (7, 3, 1, 1, 1)
    assert (status.buttons, status.uptime) == (1, 0)
    board.turn(b"", 2050)
    assert asked(board, messages.encode(messages.ASK_STATUS, 104), 2060)[0].uptime == 2


# ---- both ends, and the line between them ----


def world(seed=0, there=0, back=0, **wire):
    """A host and a board, and the delays between them, ms."""
    rng = np.random.default_rng(seed)
    return World(Board(), Wire(rng, **wire, delay=there), Wire(rng, **wire, delay=back), begin_ms=2**29 - 500)


events = st.sampled_from(["run", "cut", "half", "hang", "noise", "flood", "reopen", "sleep", "fast", "reset"])
lines = st.fixed_dictionaries(
    {"damage": st.floats(0.0, 0.1), "lose": st.floats(0.0, 0.4), "twice": st.floats(0.0, 0.4)}
)
delays = st.integers(0, 9)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32),
    lines,
    delays,
    delays,
    st.lists(st.tuples(events, st.integers(1, 300)), max_size=12),
)
def test_every_count_arrives_once_or_is_reported(seed, line, there, back, story):
    """After any story the sum is exact, less `dropped`, and off by `uncertain` at most: 600 counts for each reset."""
    rng, w = np.random.default_rng([seed, 1]), world(seed, there, back, **line)
    for event, ms in story:
        w.up.cut = event == "cut"
        w.down.cut = event in ("cut", "half")
        w.board.awake = event != "sleep"
        if event == "reopen":
            w.reopen()
        if event == "reset":
            w.reset()
        for _ in range(ms):
            noise = rng.bytes(30) if event == "noise" else b"\xaa" * 200 if event == "flood" else b""
            w.give(rng.integers(-900, 1200, 4) if event == "fast" else rng.integers(-10, 13, 4))
            w.step(noise, run=event != "hang")
    w.board.awake = True
    w.settle(20_000)
    assert w.link.settled
    uncertain = np.array(w.link.uncertain)
    assert (np.abs(np.array(w.short) - w.link.dropped) <= uncertain).all()
    assert (uncertain <= STEP_LIMIT // 2 * w.resets).all()


@settings(max_examples=40)
@given(delays, delays, st.integers(0, 2**32), st.floats(0.0, 0.5))
def test_no_step_is_refused_whatever_is_in_flight(there, back, seed, lose):
    rng, w = np.random.default_rng([seed, 1]), world(seed, there, back, lose=lose)
    for _ in range(300):
        w.give(rng.choice([-2000, -700, -100, 0, 0, 100, 700, 2000, 40_000], 4))
        w.step()
        assert not w.board.lines[0].too_large


def test_counts_of_a_long_break_are_dropped_and_reported():
    w = world()
    w.give((5, 0, 0, 0))
    w.run(10)
    w.up.cut = w.down.cut = True
    w.run(1500, (1, 0, 0, 0))
    w.settle()
    assert w.board.moved[0] == 5
    assert w.short == w.link.dropped == [1500, 0, 0, 0]


def test_buttons_are_released_when_the_host_or_its_tracker_hangs():
    w = world()
    w.give((1, 0, 0, 0))
    w.link.buttons = 0b101
    w.run(950)  # without reports the line is kept for a second
    assert w.board.buttons == 0b101
    w.run(160)
    assert w.board.buttons == 0
    w.give((1, 0, 0, 0))
    w.run(10)
    assert (w.board.moved[0], w.board.buttons) == (2, 0b101)
    for _ in range(101):
        w.step(run=False)
    assert w.board.buttons == 0


def test_the_host_program_starts_again():
    first = world()
    first.run(100, (1, 0, 0, 0))
    second = World(first.board, first.up, first.down, first.ms, first_session=50)
    second.give((1000, 0, 0, 0))
    second.settle()
    assert first.board.moved[0] == first.given[0] + 1000


def test_a_board_of_another_protocol_is_noticed():
    link = Link(lambda: 5)
    link.port_opened(0.0)
    link.receive(messages.encode(messages.IDENTITY, 0, bytes(44), version=2), 0.0)
    assert link.foreign_version == 2
    assert link.last_answer == -np.inf  # this is no answer
    link.receive(Board().turn(link.next_frame(0.0) or b"", 0), 1.0)
    assert link.last_answer == 1.0


def test_breaks_are_sessions_that_the_line_or_the_device_ended():
    w = world()
    w.run(50, (1, 0, 0, 0))
    w.run(1500)  # the tracker pauses
    w.give((1, 0, 0, 0))
    w.settle()
    assert (w.link.sessions, w.link.breaks) == (2, 0)
    w.up.cut = True
    w.run(300, (1, 0, 0, 0))
    assert sum(w.link.waiting) > 290
    w.settle()
    assert (w.link.breaks, w.link.waiting) == (1, [0, 0, 0, 0])
