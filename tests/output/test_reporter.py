"""The reporter: outputs that fail and come back, and a ledger that is always even."""

import json
import threading
import time

import numpy as np
import pytest
from reporter_world import EXACT, World, even
from reporting import PATIENCE, report, until

from spheremouse.errors import OutputError
from spheremouse.output import OutputClosed, log_file, open_output
from spheremouse.output import reporter as module
from spheremouse.output.pointer import PointerSettings
from spheremouse.output.reporter import OutputThread


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
    for k in range(4):
        given(k, -k, 0, rate=(1e4, 1e4, 0.0))
    until(lambda: path.exists() and path.read_text().count("\n") == 4 + (form == "counts"))  # with its header
    monkeypatch.setattr(log_file, "PERIOD_S", 100.0)
    given(7, 0, 0)
    reporter.close()
    lines = path.read_text().splitlines()
    if form == "counts":
        assert lines[1:] == ["1.0 0 0 0", "2.0 1 -1 0", "3.0 2 -2 0", "4.0 3 -3 0", "5.0 7 0 0"]
    else:
        assert [json.loads(line)["counts"][0] for line in lines] == [0, 1, 2, 3, 7]
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
