"""Outputs that hang: a board, a pipe and a call that take no report fail in time, and the ledger is even."""

import contextlib
import os
import threading
import time

import numpy as np
import pytest
from reporter_world import Frames, World, even
from reporting import until

from spheremouse.output import open_output
from spheremouse.output.pointer import PointerSettings

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
