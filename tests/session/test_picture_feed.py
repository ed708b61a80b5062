"""Live pictures of a run: only while a lease lasts, and no more than were asked for."""

import os
from types import SimpleNamespace

import numpy as np
import pytest

from spheremouse.capture import Payload
from spheremouse.errors import DamagedFrameError
from spheremouse.session.control.pictures import PictureReader
from spheremouse.session.control.protocol import LEASE
from spheremouse.session.picture_feed import PictureFeed

SIZE = (8, 4)
DT = 1 / 60


class Raw:
    """A raw frame whose bytes are its number."""

    stamp = 3.5

    def __init__(self, number=1, size=SIZE, damaged=False):
        self._number, self._size, self._damaged, self.copied = number % 256, size, damaged, 0

    def payload(self):
        if self._damaged:
            raise DamagedFrameError("half of it is missing")
        self.copied += 1
        w, h = self._size
        return Payload("grey", w, h, np.full(w * h, self._number, np.uint8).data)


ADAPTER = SimpleNamespace(annotations=lambda made: {"sequence": made})


@pytest.fixture
def log():
    return []


@pytest.fixture
def feed(log):
    feed = PictureFeed(log.append)
    yield feed
    feed.close()


def reader_of(feed, now=0.0, interval=0.1, size=SIZE):
    return PictureReader(feed.lease(now, interval, size).duplicate())


def test_a_picture_is_the_raw_frame_with_the_marks_of_the_tracker(feed):
    reader = reader_of(feed)
    feed.show(0.0, Raw(7), ADAPTER, 41)
    picture = reader.latest()
    assert (picture.format, picture.width, picture.height, picture.stamp) == ("grey", 8, 4, 3.5)
    assert picture.pixels == 32 * b"\7"
    assert picture.annotations == {"sequence": 41}


@pytest.mark.parametrize(("fps", "interval"), [(60.0, 1 / 15), (30.0, 0.05), (187.0, 0.1), (29.97, 1 / 15)])
def test_the_mean_interval_is_the_one_requested_at_any_rate_of_the_camera(feed, fps, interval):
    frames = int(2.0 * fps)
    raws = [Raw() for _ in range(frames)]
    for k, raw in enumerate(raws):
        if k % 20 == 0:
            feed.lease(k / fps, interval, SIZE)
        feed.show(k / fps, raw, ADAPTER, k)
    shown = np.flatnonzero([raw.copied for raw in raws]) / fps
    assert np.mean(np.diff(shown)) == pytest.approx(max(interval, 1 / fps), rel=0.03)
    assert np.diff(shown).min() > 0.5 * interval - 1e-9


def test_without_a_lease_nothing_is_copied_and_no_memory_is_held(feed):
    before, raw = len(os.listdir("/proc/self/fd")), Raw()
    feed.show(0.0, raw, ADAPTER, 1)
    ring = feed.lease(1.0, 0.1, SIZE)
    assert len(os.listdir("/proc/self/fd")) > before
    for now in (1.0, 1.0 + 0.9 * LEASE):
        feed.expire(now)
        feed.show(now, raw, ADAPTER, 1)
    assert raw.copied == 2
    feed.expire(1.1 + LEASE)
    feed.show(1.1 + LEASE, raw, ADAPTER, 1)
    assert raw.copied == 2
    assert len(os.listdir("/proc/self/fd")) == before
    assert feed.lease(9.0, 0.1, SIZE) is not ring


def test_of_several_clients_the_fastest_decides(feed):
    raws = [Raw() for _ in range(120)]
    for k, raw in enumerate(raws):
        if k % 60 == 0:
            feed.lease(k * DT, 0.5, SIZE)
            feed.lease(k * DT, 0.05, SIZE)
        feed.show(k * DT, raw, ADAPTER, k)
    assert sum(raw.copied for raw in raws) == pytest.approx(40, abs=2)


def test_a_larger_frame_gets_a_larger_ring_and_numbers_go_on(feed):
    reader = reader_of(feed)
    feed.show(0.0, Raw(1), ADAPTER, 1)
    first = reader.latest().number
    feed.show(1.0, Raw(2, (640, 480)), ADAPTER, 2)
    larger = reader_of(feed, 1.0).latest(first)
    assert (larger.width, larger.pixels[0]) == (640, 2)
    assert larger.number > first


def test_damaged_frames_are_passed_over(feed):
    reader = reader_of(feed)
    feed.show(0.0, Raw(damaged=True), ADAPTER, 1)
    assert reader.latest() is None


def test_an_error_in_the_marks_is_logged_and_the_next_picture_comes(feed, log):
    reader = reader_of(feed)
    feed.show(0.0, Raw(), SimpleNamespace(annotations=lambda made: 1 / 0), 1)
    feed.show(1.0, Raw(), SimpleNamespace(annotations=lambda made: {"x": float("nan")}), 1)
    feed.show(2.0, Raw(), ADAPTER, 3)
    assert reader.latest().annotations == {"sequence": 3}
    assert ["ZeroDivisionError" in log[0], "ValueError" in log[1]] == [True, True]
