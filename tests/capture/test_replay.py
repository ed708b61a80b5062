"""A replay: its order, pace, section and pauses, with a tracker that releases frames late or not at all."""

import time

import numpy as np
import pytest

from spheremouse.capture import Stream
from spheremouse.capture.fetch import EndOfSource
from spheremouse.capture.replay import Controls, Replay
from spheremouse.errors import DatasetError
from spheremouse.tracker import Frame

STEP = 0.01  # s between two stamps
COUNT = 10
FAST = Controls(speed=20.0)


def stream(count=COUNT, error=None):
    def frames():
        for k in range(count):
            yield Frame(np.zeros((2, 2), np.uint8), 5.0 + STEP * k, 100 + k)
        if error is not None:
            raise error

    return Stream(frames(), count=count)


@pytest.fixture
def replay():
    with Replay(stream(), stream, "film") as replay:
        yield replay


def played(replay, count):
    """The numbers of the next frames, each released at once."""
    numbers = []
    for _ in range(count):
        raw = replay.next(1.0)
        assert raw is not None
        numbers.append(replay.frame)
        assert raw.sequence == 100 + replay.frame
        assert replay.seconds == pytest.approx(STEP * replay.frame)
        raw.release()
    return numbers


def test_every_frame_comes_once_and_then_again(replay):
    replay.control(FAST)
    assert played(replay, 2 * COUNT + 1) == [*range(COUNT), *range(COUNT), 0]


def test_a_frame_waits_until_the_one_before_is_released(replay):
    raw = replay.next(1.0)
    assert replay.next(5 * STEP) is None
    raw.release()
    assert replay.next(1.0) is not None
    assert replay.frame == 1


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_the_pace_is_that_of_the_stamps_times_the_speed(replay, speed):
    expected, spent = (COUNT - 1) * STEP / speed, []
    for _ in range(5):  # a busy computer makes a pass longer, never shorter
        begun = time.monotonic()
        replay.control(Controls(speed=speed), rewind=True)
        played(replay, COUNT)
        spent.append(time.monotonic() - begun)
    assert min(spent) >= expected
    assert min(spent) == pytest.approx(expected, rel=0.3)


def test_the_section_is_played_and_each_pass_begins_anew(replay):
    replay.control(FAST._replace(begin=2.5 * STEP, end=5.5 * STEP))
    firsts = []
    for expected in (3, 4, 5, 3, 4):
        raw = replay.next(1.0)
        assert replay.frame == expected
        firsts.append(replay.is_first(raw))
        raw.release()
    assert firsts == [True, False, False, True, False]


def test_an_empty_section_plays_the_whole_recording(replay):
    replay.control(FAST._replace(begin=100.0))
    assert played(replay, 2) == [0, 1]


def test_a_pause_holds_a_step_gives_one_frame_and_rewinding_goes_back(replay):
    replay.control(FAST)
    played(replay, 3)
    replay.set_paused(True)
    assert replay.next(3 * STEP) is None
    replay.control(FAST, steps=1)
    assert played(replay, 1) == [3]
    assert replay.next(3 * STEP) is None
    replay.control(FAST, rewind=True)
    replay.set_paused(False)
    assert [replay.next(0.0), *played(replay, 2)] == [None, 0, 1]


def test_without_loop_it_pauses_at_the_end_and_begins_again_when_it_goes_on(replay):
    replay.control(FAST._replace(loop=False))
    assert played(replay, COUNT) == [*range(COUNT)]
    assert replay.next(3 * STEP) is None
    assert replay.paused
    replay.set_paused(False)
    assert played(replay, 1) == [0]


def test_a_recording_that_breaks_off_ends_with_its_error():
    with Replay(stream(2, DatasetError("truncated")), stream, "film") as replay:
        replay.control(FAST)
        played(replay, 2)
        with pytest.raises(EndOfSource, match="truncated"):
            replay.next(1.0)
