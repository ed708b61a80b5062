"""The reporter: outputs that fail, hang and come back, and a ledger that is always even."""

import contextlib
import os
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from reporting import PATIENCE, report, until

from spheremouse.errors import OutputError
from spheremouse.output import Output, OutputClosed, log_file, open_output
from spheremouse.output import reporter as module
from spheremouse.output.pointer import PointerSettings
from spheremouse.output.reporter import OutputThread

EXACT = PointerSettings(horizon=0.0)
NONE = (0.0, 0.0, 0.0)


@dataclass
class World:
    """Outputs as the test wants them, and what became of them."""

    reports: list[Any] = field(default_factory=list)
    opened: int = 0
    entered: int = 0  # opened with success
    closed: list[Any] = field(default_factory=list)  # error with which each was left
    broken: BaseException | None = None  # raised by send
    missing: BaseException | None = None  # raised on opening
    gate: threading.Event | None = None  # sending waits for it
    door: threading.Event | None = None  # opening waits for it
    said: list[str] = field(default_factory=list)
    senders: list[threading.Thread] = field(default_factory=list)
    non_blocking: bool = False

    def open(self):
        self.opened += 1
        if self.door is not None:
            assert self.door.wait(PATIENCE)
        if self.missing is not None:
            raise self.missing
        return (NonBlocking if self.non_blocking else Fake)(self)

    @property
    def sum(self):
        return tuple(np.sum([m.counts for m in self.reports], axis=0)) if self.reports else (0, 0, 0)


class Fake(Output):
    """An output that keeps its reports."""

    paced = True

    def __init__(self, world):
        self._world = world

    def send(self, report):
        if self._world.gate is not None:
            assert self._world.gate.wait(PATIENCE)
        self._world.senders.append(threading.current_thread())
        if self._world.broken is not None:
            raise self._world.broken
        self._world.reports.append(report)

    def __enter__(self):
        self._world.entered += 1
        return self

    def __exit__(self, kind, error, trace):
        self._world.closed.append(error)
        raise RuntimeError("leaving fails as well")


class NonBlocking(Fake):
    paced = blocks = False


class Frames:
    """Frames that are submitted, with their sum."""

    def __init__(self, reporter):
        self._reporter, self.sum, self.frames = reporter, np.zeros(3, int), 0

    def __call__(self, *counts, rate=NONE, taken=None, wanted=True):
        self.frames += 1
        given = report(*counts, stamp=float(self.frames), counts_rate=rate)
        self.sum += counts
        self._reporter.submit(given, time.monotonic() if taken is None else taken, wanted=wanted)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(module, "RETRY_DELAYS", (0.005, 0.02))
    monkeypatch.setattr(module, "MAX_QUEUE_TIME", PATIENCE)  # a test machine may hang as well


@pytest.fixture
def start():
    """Reporters that end with the test."""
    started = []

    def begin(world, settings=EXACT, open_it=None):
        reporter = OutputThread(open_it or world.open, settings, world.said.append)
        started.append(reporter)
        return reporter, Frames(reporter)

    yield begin
    for reporter in started:
        reporter.close()


def even(reporter, given):
    """Submitted counts = sent + unsent - ahead, and nothing is ahead at horizon 0."""
    status = reporter.status()
    return np.array_equal(np.add(status.sent, status.unsent), given.sum + status.ahead)


# ---- frames ----


def test_every_frame_is_sent_once_even_if_it_is_empty(start):
    """Some outputs want to know that the tracker lives."""
    world = World()
    reporter, given = start(world)
    for counts in ((3, -2, 1), (0, 0, 0), (5, 0, 0)):
        given(*counts)
        until(lambda n=given.frames: len(world.reports) == n)
    assert [m.counts for m in world.reports] == [(3, -2, 1), (0, 0, 0), (5, 0, 0)]
    assert [m.stamp for m in world.reports] == [1.0, 2.0, 3.0]
    until(lambda: reporter.status().reports == 2)
    status = reporter.status()
    assert (status.failed, status.sent, status.unsent, status.ahead) == (None, (8, -2, 1), (0, 0, 0), (0, 0, 0))


def test_a_report_to_an_output_that_never_blocks_is_sent_by_its_caller(start):
    """So no thread wakes for it. The thread opens the output, also after a failure. No count is missing."""
    world = World(non_blocking=True)
    reporter, given = start(world)
    until(lambda: world.entered == 1)
    for k in range(5):
        given(3, -2, 1)
        until(lambda: reporter.queued == (0, 0, 0))  # the thread may still have its turn
        assert len(world.reports) == k + 1
    assert world.senders[-1] is threading.current_thread()
    world.broken = OutputError("broken")
    given(1, 1, 1)
    assert reporter.failed == "broken"
    world.broken = None
    until(lambda: world.entered == 2)
    until(lambda: reporter.failed is None)
    given(7, 0, 0)
    until(lambda: world.sum == (22, -10, 5))
    assert even(reporter, given)
    assert reporter.status().unsent == (1, 1, 1)


@pytest.mark.parametrize("form", ["json", "counts"])
def test_a_file_gets_the_lines_of_a_second_at_once_even_if_no_frame_follows(start, tmp_path, monkeypatch, form):
    monkeypatch.setattr(log_file, "PERIOD_S", 0.05)
    path = tmp_path / "log"
    reporter, given = start(World(), open_it=lambda: open_output(f"text:{path},format={form}"))
    for _ in range(4):
        given(3, -2, 1)
    until(lambda: path.exists() and path.read_text().count("\n") == 4 + (form == "counts"))  # with its header
    monkeypatch.setattr(log_file, "PERIOD_S", 100.0)
    given(7, 0, 0)
    reporter.close()
    assert path.read_text().count("\n") == 5 + (form == "counts")
    assert even(reporter, given)


def test_motion_is_carried_on_to_the_horizon_and_no_further(start):
    world = World()
    reporter, given = start(world, PointerSettings(horizon=0.1))
    now = time.monotonic()
    given(0, 0, 0, rate=(900.0, -900.0, 0.0), taken=now - 1 / 30)
    given(30, -30, 0, rate=(900.0, -900.0, 1e6), taken=now)
    until(lambda: world.sum == (120, -120, 0))
    assert len([m for m in world.reports if any(m.counts)]) >= 2  # the first had its share alone
    until(lambda: reporter.status().ahead == (90, -90, 0))
    assert even(reporter, given)
    stamps = [m.stamp for m in world.reports]
    assert stamps == sorted(stamps)
    assert all(bool(m.samples) == (m.stamp in (1.0, 2.0)) for m in world.reports)  # a sample is sent once
    given(80, 0, 0, taken=now + 1 / 30)  # less than what was overshot
    given(13, 1, 0, taken=now + 2 / 30)
    until(lambda: world.sum == (123, -119, 0))  # and of y, which turned round, all
    until(lambda: reporter.status().ahead == (0, -90, 0))
    assert even(reporter, given)


def test_the_latency_is_from_the_stamp_to_the_end_of_send(start):
    world = World(gate=(gate := threading.Event()))
    reporter, given = start(world)
    assert reporter.status().latency is None
    taken = time.monotonic()
    given(1, 0, 0, taken=taken)
    time.sleep(0.02)
    gate.set()
    until(lambda: reporter.status().latency is not None)
    latency = reporter.status().latency
    assert 0.02 <= latency.p50 == latency.p99 == latency.max <= time.monotonic() - taken


def test_submitting_never_waits_and_counts_of_a_full_queue_are_unsent(start, monkeypatch):
    monkeypatch.setattr(module, "MAX_QUEUED_FRAMES", 5)
    world = World(gate=(gate := threading.Event()))
    reporter, given = start(world)
    for _ in range(200):
        given(1, 2, 3)
    assert world.reports == []  # all were given while the output hung
    gate.set()
    until(lambda: even(reporter, given))
    assert 1 <= len(world.reports) <= 6
    assert world.sum == reporter.status().sent


def test_counts_that_waited_too_long_are_unsent(start, monkeypatch):
    monkeypatch.setattr(module, "MAX_QUEUE_TIME", 0.0)
    world = World()
    reporter, given = start(world)
    given(1, 2, 3)
    until(lambda: reporter.status().unsent == (1, 2, 3))
    assert world.reports == []


# ---- pause ----


def test_while_paused_nothing_is_sent(start):
    world = World()
    reporter, given = start(world)
    given(1, 1, 1)
    until(lambda: world.sum == (1, 1, 1))
    reporter.set_paused(True)
    for _ in range(10):
        given(7, 0, -7)
    reporter.set_paused(False)  # maybe before the thread has seen any of them
    given(5, 0, 0, wanted=False)
    given(2, 2, 2)
    until(lambda: world.sum == (3, 3, 3))
    assert reporter.status().unsent == (75, 0, -70)
    assert even(reporter, given)


def test_the_end_of_the_prediction_sends_nothing_more_and_is_no_line_of_a_log(start, tmp_path):
    world = World()
    reporter, given = start(world, PointerSettings(horizon=0.25, smooth=0.0))
    now = time.monotonic()
    given(0, 0, 0, taken=now - 0.01)
    given(100, 0, 0, rate=(1000.0, 0.0, 0.0), taken=now)
    reporter.end_prediction(time.monotonic())
    until(lambda: world.reports and reporter.queued == (0, 0, 0))
    time.sleep(0.02)  # for the empty report that ends it
    sent = world.sum
    time.sleep(0.3)
    assert world.sum == sent
    assert even(reporter, given)
    path = tmp_path / "lines"
    reporter, given = start(World(), EXACT, lambda: open_output(f"text:{path},format=counts"))
    given(1, 2, 3)
    reporter.end_prediction(time.monotonic())
    given(4, 5, 6)
    until(lambda: path.exists() and path.read_text().count("\n") == 3)  # a header


def test_a_pause_ends_the_prediction(start):
    world = World()
    reporter, given = start(world, PointerSettings(horizon=0.25, smooth=1.0))
    now = time.monotonic()
    given(0, 0, 0, taken=now - 1.0)
    given(100_000, 0, 0, rate=(1e5, 0.0, 0.0), taken=now)
    until(lambda: len(world.reports) >= 2)
    reporter.set_paused(True)
    until(lambda: even(reporter, given) and reporter.status().ahead == (0, 0, 0))
    sent = len(world.reports)
    time.sleep(0.05)
    assert len(world.reports) == sent


# ---- outputs that fail ----


def test_the_end_sends_what_is_queued_even_if_the_thread_runs_late():
    world, threads = World(), []
    reporter = OutputThread(world.open, EXACT, world.said.append, threads.append)
    for _ in range(100):
        reporter.submit(report(1, 0, 0, stamp=0.0), time.monotonic())
    reporter.close()
    threads[0].start()
    threads[0].join(PATIENCE)
    assert world.sum == reporter.status().sent == (100, 0, 0)


def test_the_end_opens_no_failed_output_again(start, monkeypatch):
    monkeypatch.setattr(module, "RETRY_DELAYS", (0.0,))
    world = World(gate=threading.Event(), broken=OutputError("gone"))
    reporter, given = start(world)
    for _ in range(100):
        given(1, 0, 0)
    until(lambda: reporter.queued[0] == 99)
    threading.Timer(0.1, world.gate.set).start()  # `close` waits by then
    reporter.close()
    until(lambda: len(world.closed) == 1 and even(reporter, given))
    assert (world.opened, reporter.unsent) == (1, (100, 0, 0))


def test_a_failure_at_the_end_is_logged(start):
    world = World()
    reporter, given = start(world)
    given(1, 0, 0)
    reporter.close()
    assert world.said == ["output: leaving fails as well"]


@pytest.mark.parametrize("error", [OutputError("uinput: gone"), ValueError(), RuntimeError("two\nlines")])
def test_an_output_that_fails_is_opened_again_and_nothing_jumps(start, error):
    world = World()
    reporter, given = start(world)
    given(1, 0, 0)
    until(lambda: world.sum == (1, 0, 0))
    world.missing = world.broken = error
    given(10, 0, 0)
    until(lambda: reporter.status().failed is not None)
    status = reporter.status()
    assert status.failed
    assert "\n" not in status.failed
    for _ in range(5):
        given(100, 0, 0)
    until(lambda: reporter.status().unsent == (510, 0, 0))
    until(lambda: world.opened > 3)
    world.missing = world.broken = None
    until(lambda: reporter.status().failed is None)
    given(2, 0, 0)
    until(lambda: world.sum == (3, 0, 0))
    assert world.closed == [error]
    until(lambda: len(world.said) == 2)
    assert world.said == [f"output: {status.failed}; trying again until it works", "output: works again"]
    assert even(reporter, given)


def test_an_output_that_can_be_opened_but_not_written_is_one_line(start):
    world = World(broken=OutputError("the disk is full"))
    reporter, given = start(world)

    def opened_often():
        given(1, 0, 0)
        return world.opened > 3

    until(opened_often)
    world.broken = None
    until(lambda: given(1, 0, 0) or len(world.said) > 1)
    assert world.said == ["output: the disk is full; trying again until it works", "output: works again"]
    until(lambda: even(reporter, given))


def test_an_output_of_frames_loses_none_to_a_slow_opening(start):
    """A table is opened while its library loads."""
    world = World(door=threading.Event(), non_blocking=True)
    reporter, given = start(world)
    given(3, -2, 1)
    until(lambda: "it cannot be opened" in str(reporter.failed))
    given(5, 0, 0)
    world.door.set()
    until(lambda: world.sum == (8, -2, 1))
    assert even(reporter, given)
    assert reporter.status().unsent == (0, 0, 0)


def test_counts_submitted_during_an_opening_are_unsent(start):
    world = World(broken=OutputError("gone"))
    reporter, given = start(world)
    world.door = threading.Event()
    world.door.set()
    until(lambda: world.entered == 1)
    world.door.clear()
    given(1, 0, 0)
    until(lambda: world.opened == 2)  # and waits for the door
    world.broken = None
    given(50, 0, 0)  # not late yet, when the door opens
    world.door.set()
    until(lambda: reporter.status().unsent == (51, 0, 0))
    assert world.reports == []


@pytest.mark.parametrize("fault", [{"missing": OutputError("not there")}, {"broken": OutputError("refuses")}])
def test_the_time_between_two_openings_grows_until_a_report_is_sent(start, monkeypatch, fault):
    """A device that is created and refuses each report must not come and go hundreds of times a second."""
    monkeypatch.setattr(module, "RETRY_DELAYS", (0.0, 0.0, 3600.0))
    world = World(**fault)
    _, given = start(world)
    for _ in range(3):
        before = len(world.said) + world.opened + len(world.closed)
        given(1, 0, 0)
        until(lambda n=before: world.opened == 3 or len(world.said) + world.opened + len(world.closed) > n)
        time.sleep(0.02)
    given(1, 0, 0)
    time.sleep(0.05)
    assert world.opened == 3


def test_after_a_report_that_was_sent_the_next_opening_comes_soon(start, monkeypatch):
    monkeypatch.setattr(module, "RETRY_DELAYS", (0.0, 3600.0))
    world = World()
    reporter, given = start(world)
    for opened in (1, 2, 3):
        until(lambda n=opened: world.opened == n and reporter.status().failed is None)
        world.broken = None
        given(1, 0, 0)
        until(lambda n=opened: len(world.reports) == n)
        world.broken = OutputError("refuses")
        given(1, 0, 0)
    until(lambda: world.opened == 4)


def test_a_reader_that_has_gone_is_the_end(start):
    world = World(broken=OutputClosed("standard output"))
    reporter, given = start(world)
    given(1, 0, 0)
    until(lambda: reporter.status().ended)
    given(2, 0, 0)
    until(lambda: reporter.status().unsent == (3, 0, 0))
    assert world.opened == 1
    assert reporter.status().failed == "the reader of the output is gone"


def test_the_ledger_stays_even_whatever_happens(start):
    """Faults at random, motion all the while; then it comes to rest."""
    rng = np.random.default_rng(1)
    world = World()
    reporter, given = start(world, PointerSettings(rate=1000.0))
    for _ in range(300):
        counts = rng.integers(-50, 50, 3)
        given(*counts.tolist(), rate=tuple(30.0 * counts))
        world.broken = OutputError("gone") if rng.random() < 0.1 else None
        world.missing = OutputError("missing") if rng.random() < 0.1 else None
        if rng.random() < 0.05:
            reporter.set_paused(bool(rng.random() < 0.5))
        time.sleep(float(rng.uniform(0.0, 0.004)))
    world.broken = world.missing = None
    reporter.set_paused(False)
    until(lambda: even(reporter, given) and tuple(world.sum) == reporter.status().sent)
    assert world.said


# ---- logs ----


def test_a_log_has_a_line_per_frame_as_the_frames_say(start, tmp_path):
    path = tmp_path / "log.txt"
    world = World()
    reporter, given = start(world, PointerSettings(), lambda: open_output(f"text:{path},format=counts"))
    for k in range(40):
        given(k, -k, 0, rate=(1e4, 1e4, 0.0))
    until(lambda: even(reporter, given) and reporter.status().sent[0] == 780)
    reporter.close()
    lines = [line.split() for line in path.read_text().splitlines()[1:]]
    assert lines == [[f"{k + 1.0}", str(k), str(-k), "0"] for k in range(40)]


def test_a_log_of_reports_has_a_line_per_report(start, tmp_path):
    path = tmp_path / "log.txt"
    reporter, given = start(World(), PointerSettings(), lambda: open_output(f"text:{path},format=reports"))
    now = time.monotonic()
    given(0, 0, 0, rate=(900.0, 0.0, 0.0), taken=now - 1 / 30)
    given(30, 0, 0, rate=(900.0, 0.0, 0.0), taken=now)
    until(lambda: reporter.status().sent == (120, 0, 0))
    reporter.close()
    lines = [line.split() for line in path.read_text().splitlines()[1:]]
    assert len(lines) > 2
    assert sum(int(line[1]) for line in lines) == 120
    assert lines[0][:2] == ["1.0", "0"]
    assert float(lines[-1][0]) > 2.0


# ---- outputs that hang ----

WITHIN = 1.0  # s from the fault to `failed`
BUSY = 4.0  # s more that a test machine may be busy with something else


class Playing:
    """Frames of 7 counts at 100 Hz, as of a daemon that withholds them while the output fails."""

    def __init__(self, reporter):
        self.reporter, self.given, self._over = reporter, Frames(reporter), threading.Event()
        self.failed, self.since = [], None  # reasons; s, when the first of them came
        self.after = 0  # counts of x given while it has not failed, after it once had
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._over.wait(0.01):
            failed = self.reporter.failed
            if failed is not None:
                self.since = self.since or time.monotonic()
                self.failed.append(failed)
            elif self.failed:
                self.after += 7
            self.given(7, -3, 0, wanted=failed is None)

    def __enter__(self):
        self._thread.start()
        return self

    def stop(self):
        self._over.set()
        self._thread.join()

    def __exit__(self, *_):
        self.stop()

    def fails(self, began):
        """Why, once it does; in time."""
        until(lambda: self.failed)
        assert self.since - began < WITHIN + BUSY
        return self.failed[0]


@pytest.fixture
def board():
    pytest.importorskip("pty", reason="no pseudo-terminals here")
    from simulated_board import Simulator

    with Simulator() as simulator:
        yield simulator


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("unplugged", "plug the board in again"),
        ("stalled", "the board does not answer"),
        ("asleep", "the mouse's computer takes no moves"),
    ],
)
def test_a_board_that_takes_nothing_is_a_failed_output_and_unconfirmed_counts_are_unsent(
    start, board, fault, reason, tmp_path
):
    link = tmp_path / "board"
    link.symlink_to(board.port)
    reporter, _ = start(World(), open_it=lambda: open_output(f"serial:{link}"))
    with Playing(reporter) as playing, type(board)() as second:
        until(lambda: reporter.status().sent[0] > 100)
        board.stalled, board.awake = fault == "stalled", fault != "asleep"
        if fault == "unplugged":
            link.unlink()  # first: another test's board may get the name of the port that is gone
            board.unplug()
        playing.fails(time.monotonic())
        until(lambda: any(reason in why for why in playing.failed) and len(playing.failed) > 30)
        status, arrived = reporter.status(), list(board.moved)
        untold = arrived[0] - status.sent[0]  # with the cable an answer may be lost
        assert 0 <= untold <= (600 if fault == "unplugged" else 0)
        assert status.ahead == (0, 0, 0)
        if fault == "unplugged":
            link.symlink_to(second.port)
        board.stalled, board.awake = False, True
        until(lambda: reporter.failed is None)
        assert reporter.status().reports <= status.reports + 3  # it has not been said to be sent meanwhile
        until(lambda: reporter.status().sent[0] > arrived[0] + 100)
        playing.stop()
        until(lambda: even(reporter, playing.given) and reporter.status().ahead == (0, 0, 0))
        moved = np.add(board.moved, second.moved)[:2]
        assert reporter.status().sent[0] == moved[0] - untold
        under_way = 600 if fault == "stalled" else 0  # lies in the line, and is obeyed
        assert moved[0] - arrived[0] <= playing.after + under_way  # nothing is made up for
        reporter.close()
        assert even(reporter, playing.given)


def read(pipe):
    """Lines that are in it now."""
    found = b""
    with contextlib.suppress(BlockingIOError):
        while more := os.read(pipe, 1 << 16):
            found += more
    return found.decode().splitlines()


def test_a_full_pipe_is_a_failed_output(start, tmp_path):
    """A reader that stands still, and goes on."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    reporter, _ = start(World(), PointerSettings(horizon=0.0), lambda: open_output(f"text:{path},format=reports"))
    with Playing(reporter) as playing:
        until(lambda: reporter.status().sent[0] > 70)
        fill = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(fill, b"#" * 63 + b"\n")
        os.close(fill)
        assert "its reader does not read" in playing.fails(time.monotonic())
        playing.stop()
        assert reporter.status().ahead == (0, 0, 0)
        assert even(reporter, playing.given)
        lines = read(pipe)
        until(lambda: reporter.failed is None)
        until(lambda: even(reporter, playing.given))
        reporter.close()
        lines += read(pipe)
        counts = [int(line.split()[1]) for line in lines if not line.startswith("#")]
        assert sum(counts) == reporter.status().sent[0]
        assert set(counts) == {7}
    os.close(pipe)


def test_an_output_that_hangs_in_a_call_is_one_that_failed(start):
    """When it goes on, nothing is made up for."""
    world = World(gate=(gate := threading.Event()))
    reporter, _ = start(world)
    with Playing(reporter) as playing:
        assert "takes no report" in playing.fails(time.monotonic())
        time.sleep(0.1)
        gate.set()
        until(lambda: reporter.failed is None)
    until(lambda: even(reporter, playing.given) and tuple(world.sum) == reporter.status().sent)
    assert [line.partition(" for ")[0] for line in world.said] == [
        "output: the output hangs: it takes no report",
        "output: works again",
    ]
