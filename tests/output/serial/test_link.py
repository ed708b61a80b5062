"""The protocol: both ends byte by byte, and the law of it: what was given arrives, whatever the line does."""

import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_world import PROTOCOL as BOARD
from serial_world import Board, Wire, World, exchange

from spheremouse.output.serial import link as host
from spheremouse.output.serial import messages
from spheremouse.output.serial.link import Link
from spheremouse.output.serial.messages import Flags, Splitter, parse, signed

PAGE = (Path(__file__).parents[3] / "docs" / "protocol.md").read_text(encoding="utf-8")
u16, u32 = st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1)
bodies = st.sampled_from(sorted(messages._BODY.items())).flatmap(
    lambda item: st.tuples(st.just(item[0]), st.binary(min_size=item[1], max_size=item[1]))
)


def taken(data, piece=None):
    """Contents of the whole frames that the board's end finds, and how many were damaged."""
    line, found = BOARD.Line(), []
    for k in range(0, len(data), piece or max(1, len(data))):
        part, at = data[k : k + (piece or len(data))], 0
        while at < len(part):
            at = line.take(part, at, len(part))
            if line.length:
                found.append(bytes(line.content[: line.length]))
    return found, line.damaged


def sealed(content, number):
    """A frame of the board's making; `content` without number and CRC."""
    frame = bytearray(len(content) + 6)
    frame[1 : 1 + len(content)] = content
    BOARD.seal(frame, number)
    return bytes(frame)


# ---- frames ----


def test_the_check_sum_is_the_one_of_the_page():
    assert f"0x{zlib.crc32(b'123456789'):X}" == "0xCBF43926"
    assert "0xCBF43926" in PAGE
    content = b"\x01\x03\x00\x00"
    whole = content + zlib.crc32(content).to_bytes(4, "little")
    assert zlib.crc32(whole) ^ 0xFFFFFFFF == 0xDEBB20E3
    assert "0xDEBB20E3" in PAGE


def test_types_and_lengths_are_those_of_the_page():
    rows = re.findall(r"^\| (0x[0-9a-f]{2}) \| (\S+) \|[^|]+\| (\d+) \| (\d+) \| (\d+) \|$", PAGE, re.M)
    assert {int(code, 16): int(body) for code, _, body, _, _ in rows} == messages._BODY
    for code, name, body, content, line in rows:
        constant = "ASK_STATUS" if name == "STATUS?" else name
        assert getattr(messages, constant) == getattr(BOARD, constant) == int(code, 16)
        assert int(content) == int(body) + 8 <= messages.MOST
        for fill in (b"\0", b"\x07", b"\xff"):
            assert len(messages.encode(int(code, 16), 0, fill * int(body))) == int(line) == int(content) + 2


@given(bodies, u16)
def test_the_board_makes_the_same_bytes(body, number):
    kind, data = body
    assert sealed(bytes([1, kind, 0, 0]) + data, number) == messages.encode(kind, number, data)


@given(st.lists(st.tuples(bodies, u16), max_size=5), st.integers(1, 40))
def test_the_board_reads_what_the_host_writes_however_it_is_cut(frames, piece):
    coded = [messages.encode(kind, number, data) for (kind, data), number in frames]
    found, damaged = taken(b"\0" + b"".join(coded), piece)
    assert found == [cobs.decode(c[:-1]) for c in coded]
    assert damaged == 0


@settings(max_examples=300)
@given(
    st.lists(st.one_of(bodies.map(lambda b: messages.encode(b[0], 9, b[1])), st.binary(max_size=90))), st.integers(1, 9)
)
def test_both_ends_find_the_same_frames_in_any_bytes(pieces, cut):
    """Noise, cuts and floods: the two decoders were written apart; they must agree."""
    data = b"".join(pieces) + b"\0"
    found, _ = taken(data, cut)
    splitter, frames = Splitter(), []
    for k in range(0, len(data), cut):
        frames += splitter.take(data[k : k + cut])
    known = [c for c in found if c[0] != 1 or messages._BODY.get(c[1]) == len(c) - 8]
    assert [(f.version, f.type, f.number, f.body) for f in frames] == [
        (c[0], c[1], int.from_bytes(c[2:4], "little"), c[4:-4]) for c in known
    ]


@given(bodies, st.integers(0, 2000), st.integers(1, 255))
def test_one_damaged_byte_is_always_noticed(body, at, change):
    coded = bytearray(messages.encode(body[0], 77, body[1]))
    coded[at % (len(coded) - 1)] ^= change
    assert [c for c in taken(bytes(coded))[0] if len(c) == messages._BODY[body[0]] + 8] == []
    assert [f for f in Splitter().take(bytes(coded)) if f.version == 1] == []


def test_a_flood_costs_no_memory_and_one_frame():
    good = messages.hello(3, 5)
    splitter = Splitter()
    for _ in range(1000):
        assert list(splitter.take(b"\xaa" * 1000)) == []
    assert len(splitter._rest) <= messages.MOST + 1
    assert len(list(splitter.take(b"\0" + good))) == 1
    assert splitter.damaged == 1
    found, damaged = taken(b"\xaa" * 100_000 + b"\0" + good, 64)
    assert len(found) == damaged == 1


@given(st.integers(-(10**9), 10**9))
def test_differences(n):
    assert signed(n) == BOARD.signed(n) == (n + 2**15) % 2**16 - 2**15


# ---- the board by itself ----


def asked(board, data, now=0):
    """What the board answers, parsed."""
    return [parse(f) for f in Splitter().take(board.turn(data, now))]


def begun(session=7, number=100, now=0):
    board = Board()
    (identity,) = asked(board, messages.hello(number, session), now)
    assert identity.session == session
    return board


def test_identity_says_what_the_page_says():
    (found,) = asked(Board(), messages.hello(1, 0xDEADBEEF))
    assert (found.session, found.last, found.counters, found.first) == (0xDEADBEEF, 0, (0, 0, 0, 0), 0xDEADBEEF)
    assert (found.step, found.silence) == (host.STEP, 1000 * host.SILENCE) == (1200, 100)
    assert (found.firmware, found.kind, found.board) == (BOARD.FIRMWARE, 3, "world")


def test_counters_are_passed_on_and_acknowledged():
    board = begun()
    (ack,) = asked(board, messages.motion(101, (3, -4, 5, -6), 0b10), 10)
    assert (ack.number, ack.counters) == (101, (3, 2**16 - 4, 5, 2**16 - 6))
    assert ack.flags == Flags.RUNNING | Flags.USB_READY | Flags.WHEEL_FINE | Flags.PAN_FINE
    assert (board.moved, board.buttons) == ([3, -4, 5, -6], 0b10)


def test_twice_and_late_frames_change_nothing():
    board = begun()
    asked(board, messages.motion(101, (10, 0, 0, 0), 0) + messages.motion(102, (20, 0, 0, 0), 1))
    for old in (messages.motion(102, (20, 0, 0, 0), 0), messages.motion(101, (10, 0, 0, 0), 0)):
        (ack,) = asked(board, old)
        assert ack.flags & Flags.RUNNING
    assert (board.moved[0], board.buttons, ack.refused) == (20, 1, 2)


def test_lost_frames_are_counted_by_their_numbers():
    board = begun(number=0xFFFE)
    (ack,) = asked(board, messages.motion(0x0003, (1, 0, 0, 0), 0))
    assert ack.lost == 4
    assert board.moved[0] == 1


@pytest.mark.parametrize(("step", "taken"), [(1200, True), (-1200, True), (1201, False), (-1201, False)])
@pytest.mark.parametrize("axis", range(4))
def test_a_step_larger_than_a_hand_can_turn_is_refused_and_ends_the_session(axis, step, taken):
    board = begun()
    counters = [0, 0, 0, 0]
    counters[axis] = step
    (ack,) = asked(board, messages.motion(101, counters, 1))
    assert bool(ack.flags & Flags.TOO_LARGE) != taken
    assert bool(ack.flags & Flags.RUNNING) == taken
    assert board.moved[axis] == (step if taken else 0)
    assert board.buttons == taken
    assert ack.refused == (not taken)


def test_silence_releases_buttons_and_ends_the_session():
    board = begun(now=2**29 - 50)  # the ticks wrap meanwhile
    asked(board, messages.motion(101, (5, 0, 0, 0), 0b11111), 2**29 - 40)
    board.turn(b"", 59)
    assert board.buttons == 0b11111
    board.turn(messages.encode(messages.ASK_STATUS, 102), 59)  # is no motion
    board.turn(b"", 60)
    assert board.buttons == 0
    (ack,) = asked(board, messages.motion(103, (9, 0, 0, 0), 1), 61)
    assert not ack.flags & Flags.RUNNING
    assert (board.moved[0], board.buttons) == (5, 0)
    (identity,) = asked(board, messages.hello(104, 8), 62)
    assert (identity.last, identity.counters, identity.first) == (7, (5, 0, 0, 0), 7)


def test_hello_again_is_answered_the_same_and_one_from_before_is_refused():
    board = begun(7)
    asked(board, messages.motion(101, (5, 0, 0, 0), 0))
    (again,) = asked(board, messages.hello(102, 7))
    assert again.last == 0
    assert asked(board, messages.motion(103, (6, 0, 0, 0), 0))[0].counters[0] == 6
    (other,) = asked(board, messages.hello(104, 8))
    assert (other.last, other.counters[0]) == (7, 6)
    assert asked(board, messages.hello(105, 7)) == []  # strayed in
    assert asked(board, messages.motion(106, (1, 0, 0, 0), 0))[0].flags & Flags.RUNNING
    assert board.moved[0] == 7


def test_a_session_without_a_motion_leaves_no_trace():
    board = begun(7)
    asked(board, messages.motion(101, (5, 0, 0, 0), 0))
    asked(board, messages.hello(102, 8), 1)  # its answer was lost, say
    board.turn(b"", 150)
    (again,) = asked(board, messages.hello(103, 8), 160)
    assert (again.session, again.last, again.counters[0]) == (8, 7, 5)


def test_stop_releases_buttons():
    board = begun()
    asked(board, messages.motion(101, (5, 0, 0, 0), 3))
    (ack,) = asked(board, messages.encode(messages.STOP, 102))
    assert (ack.number, board.buttons) == (102, 0)
    assert not ack.flags & Flags.RUNNING


def test_a_hello_of_another_session_is_no_gap():
    board = begun(session=1, number=40_000)
    asked(board, messages.motion(40_001, (1, 0, 0, 0), 0))
    asked(board, messages.hello(0, 2))
    assert asked(board, messages.motion(1, (1, 0, 0, 0), 0))[0].lost == 0
    asked(board, messages.hello(4, 2))
    assert asked(board, messages.motion(5, (1, 0, 0, 0), 0))[0].lost == 2  # of its own one there is


def test_a_computer_that_wakes_is_told_the_buttons_anew():
    board = begun()
    asked(board, messages.motion(101, (1, 0, 0, 0), 1))
    board.usb = False
    board.turn(b"", 1)
    board.usb, board.buttons = True, 0  # it has started again, and knows of none
    board.turn(b"", 2)
    assert board.buttons == 1
    assert board.device.reports == 2
    board.turn(b"", 3)
    assert board.device.reports == 2


def test_another_version_is_told_ours():
    board = Board()
    (frame,) = Splitter().take(board.turn(messages.encode(messages.HELLO, 1, b"\1\2\3\4", version=2), 0))
    assert frame.version == 1
    found = parse(frame)
    assert found is not None
    assert found.session == 0
    assert not board.device.running
    assert board.turn(messages.encode(messages.MOTION, 1, bytes(9), version=2), 0) == b""


def test_what_usb_does_not_take_stays_due():
    board = begun()
    board.usb = False
    (ack,) = asked(board, messages.motion(101, (7, 0, 130, 0), 1))
    assert (ack.counters, bool(ack.flags & Flags.USB_READY)) == ((0, 0, 0, 0), False)
    board.usb = True
    (ack,) = asked(board, messages.motion(102, (9, 0, 130, 0), 1))
    assert (ack.counters, board.moved, board.buttons) == ((9, 0, 130, 0), [9, 0, 130, 0], 1)


@given(st.lists(st.integers(-400, 400), max_size=30))
def test_whole_notches_where_the_computer_knows_no_fine_ones(turns):
    board, at = Board(fine=0), 0
    asked(board, messages.hello(0, 7))
    for k, n in enumerate(turns):
        at += n
        (ack,) = asked(board, messages.motion(k + 1, (0, 0, at, -at), 0))
        assert ack.counters[2] == at % 2**16
        assert abs(at - 120 * board.moved[2]) < 120
        assert board.moved[3] == -board.moved[2]


def test_status_counts():
    board = begun()
    asked(board, messages.motion(101, (1, 0, 0, 0), 1) + b"\1\2\3\0", 5)
    (status,) = asked(board, messages.encode(messages.ASK_STATUS, 103), 50)
    assert (status.session, status.frames, status.damaged, status.lost, status.reports) == (7, 3, 1, 1, 1)
    assert (status.buttons, status.uptime) == (1, 0)
    board.turn(b"", 2050)
    assert asked(board, messages.encode(messages.ASK_STATUS, 104), 2060)[0].uptime == 2


# ---- both, and the line between them ----


def world(seed=0, **wire):
    rng = np.random.default_rng(seed)
    return World(Board(), Wire(rng, **wire), Wire(rng, **wire), begin_ms=2**29 - 500)


def test_a_sound_line_passes_on_everything_at_once():
    w = world()
    for k in range(3000):
        w.give((k % 23 - 9, 4 - k % 8, 1, -1))
        w.step()
        if k > 3:
            assert w.short == [0, 0, 0, 0]
    assert w.link.sessions == 1
    assert w.board.device.refused == w.board.device.lost == 0


def test_one_percent_of_the_bytes_damaged():
    """The million is `python -m tests.serial_world`."""
    w = exchange(Board(), 40_000, 0.01)
    assert w.short == [0, 0, 0, 0]
    assert w.board.line.damaged > 5000
    assert w.link.damaged > 5000
    assert w.link.dropped == w.link.uncertain == [0, 0, 0, 0]
    assert max(map(abs, w.given)) > 2**15


@settings(max_examples=60)
@given(
    st.integers(0, 2**32),
    st.floats(0.0, 0.1),
    st.floats(0.0, 0.4),
    st.floats(0.0, 0.4),
    st.lists(
        st.tuples(
            st.sampled_from(["run", "cut", "half", "hang", "noise", "flood", "reopen", "sleep", "fast"]),
            st.integers(1, 300),
        ),
        max_size=12,
    ),
)
def test_nothing_is_lost_and_nothing_doubled(seed, damage, lose, twice, story):
    """Short breaks of every kind; a board that is not reset gets exactly what was given, less what the host dropped."""
    w = world(seed, damage=damage, lose=lose, twice=twice)
    rng = np.random.default_rng(seed)
    for what, ms in story:
        w.up.cut = what == "cut"
        w.down.cut = what in ("cut", "half")
        w.board.usb = what != "sleep"
        if what == "reopen":
            w.link.closed(w.now)
            w._first = w.link.opened(w.now)
        for _ in range(ms):
            noise = rng.bytes(30) if what == "noise" else b"\xaa" * 200 if what == "flood" else b""
            w.give(rng.integers(-900, 1200, 4) if what == "fast" else rng.integers(-10, 13, 4))
            w.step(noise, run=what != "hang")
            sent, known = np.array(w.link.sent), np.array(w.link.confirmed)
            assert np.abs(sent - known).max() <= host.STEP
    w.board.usb = True
    w.settle(5000)
    assert w.short == w.link.dropped
    assert w.link.uncertain == [0, 0, 0, 0]


@settings(max_examples=40)
@given(st.integers(0, 2**32), st.floats(0.0, 0.05), st.lists(st.integers(1, 400), min_size=1, max_size=6))
def test_a_board_that_is_reset_doubles_nothing_and_what_may_be_lost_is_told(seed, damage, times):
    w = world(seed, damage=damage)
    for ms in times:
        for _ in range(ms):
            w.give((3, 1, 2, 0))  # one way: what is doubled would show
            w.step()
        w.board.reset()
    w.settle(5000)
    short = np.array(w.short) - w.link.dropped
    assert (short >= 0).all()
    assert (short <= w.link.uncertain).all()
    assert (np.array(w.link.uncertain) <= host.STEP // 2 * len(times)).all()


def test_after_a_long_break_what_piled_up_is_dropped_and_told():
    w = world()
    w.give((5, 0, 0, 0))
    for _ in range(10):
        w.step()
    w.up.cut = w.down.cut = True
    for _ in range(1500):
        w.give((1, 0, 0, 0))
        w.step()
    w.settle()
    assert w.board.moved[0] == 5
    assert w.short == w.link.dropped == [1500, 0, 0, 0]


def test_buttons_are_released_when_the_host_is_gone_or_its_tracker_hangs():
    w = world()
    w.give((1, 0, 0, 0))
    w.link.buttons = 0b101
    for _ in range(50):
        w.step()
    assert w.board.buttons == 0b101
    for _ in range(900):  # the tracker says nothing, the line is kept
        w.step()
    assert w.board.buttons == 0b101
    for _ in range(160):
        w.step()
    assert w.board.buttons == 0
    w.give((1, 0, 0, 0))
    for _ in range(10):
        w.step()
    assert (w.board.moved[0], w.board.buttons) == (2, 0b101)
    for _ in range(101):
        w.step(run=False)
    assert w.board.buttons == 0


def test_the_host_program_starts_again():
    board = Board()
    first = World(board, Wire(np.random.default_rng(0)), Wire(np.random.default_rng(0)))
    for _ in range(100):
        first.give((1, 0, 0, 0))
        first.step()
    second = World(board, Wire(np.random.default_rng(0)), Wire(np.random.default_rng(0)), begin_ms=first.ms)
    second.link._draw = lambda: 0x12345678
    second.link._asked = 0x12345678
    second.give((1000, 0, 0, 0))
    second.settle()
    assert board.moved[0] == first.given[0] + 1000


def test_a_board_of_another_protocol_is_noticed():
    link = Link(lambda: 5)
    link.opened(0.0)
    link.receive(messages.encode(messages.IDENTITY, 0, bytes(44), version=2), 0.0)
    assert link.foreign == 2
    assert link.heard == -np.inf  # it is none that is there
    link.receive(Board().turn(link.due(0.0) or b"", 0), 1.0)
    assert link.heard == 1.0


def test_a_name_of_control_characters_stays_off_the_terminal():
    frame = bytearray(messages._IDENTITY.size)
    frame[28:] = b"\x1b[2Jdesk\x07".ljust(16, b"\0")
    (found,) = map(parse, Splitter().take(messages.encode(messages.IDENTITY, 0, bytes(frame))))
    assert isinstance(found, messages.Identity)
    assert found.board == "?[2Jdesk?"


def test_breaks_are_those_that_nobody_here_made():
    w = world()
    for _ in range(50):
        w.give((1, 0, 0, 0))
        w.step()
    for _ in range(1500):  # the tracker pauses, and goes on
        w.step()
    w.give((1, 0, 0, 0))
    w.settle()
    assert (w.link.sessions, w.link.breaks) == (2, 0)
    w.up.cut = True
    for _ in range(300):
        w.give((1, 0, 0, 0))
        w.step()
    assert sum(w.link.waiting) > 290
    w.settle()
    assert w.link.breaks == 1
    assert w.link.waiting == [0, 0, 0, 0]


def test_round_trip_times():
    w = world()
    for _ in range(100):
        w.give((1, 0, 0, 0))
        w.step()
    assert w.link.round_trip(0.5) == pytest.approx(0.002)


class LateWire(Wire):
    """Hands on what it is given some milliseconds later."""

    def __init__(self, rng, delay=0):
        super().__init__(rng)
        self._held = [b""] * delay

    def __call__(self, data):
        self._held.append(super().__call__(data))
        return self._held.pop(0)


@pytest.mark.parametrize("delay", [0, 1, 2, 3, 5, 8, 11])
def test_large_move_after_small_ones_is_not_refused_however_late_the_answers(delay):
    """What the board has passed on and not confirmed yet lies the other way: both ends must be within one step."""
    rng = np.random.default_rng(delay)
    world = World(Board(), Wire(rng), LateWire(rng, delay))
    for _ in range(60):
        world.give((-12, 7, 0, 0))
        world.step()
    world.give((40_000, -40_000, 0, 0))
    for _ in range(1500):
        world.link.alive(world.now)
        world.step()
    assert world.short == [0, 0, 0, 0]
    assert world.link.sessions == 1


@pytest.mark.parametrize("delay", [1, 3, 8])
def test_a_sharp_turn_with_answers_under_way_is_not_refused(delay):
    """The board may have obeyed any of what is under way, the way out as well as the way back."""
    rng = np.random.default_rng(delay)
    world = World(Board(), Wire(rng), LateWire(rng, delay))
    world.link.buttons, edges, buttons = 1, [], 0
    for k in range(400):
        world.link.alive(world.now)
        for at, x in ((50, 600), (51, -1200), (52 + delay, 5000)):
            if k == at:
                world.give((x, 0, 0, 0))
        world.step()
        if world.board.buttons != buttons:
            buttons = world.board.buttons
            edges.append(buttons)
    assert (world.link.sessions, world.board.device.refused, edges) == (1, 0, [1])
    assert world.short == [0, 0, 0, 0]


@settings(max_examples=40)
@given(st.integers(0, 12), st.integers(0, 12), st.integers(0, 2**32), st.floats(0.0, 0.5))
def test_no_step_is_refused_whatever_is_under_way(there, back, seed, lose):
    rng = np.random.default_rng(seed)
    world = World(Board(), LateWire(rng, there), LateWire(rng, back))
    world.up._lose = world.down._lose = lose
    for _ in range(300):
        world.give(rng.choice([-2000, -700, -100, 0, 0, 100, 700, 2000], 4))
        world.step()
        assert not world.board.line.too_large
