"""Live pictures of a run, and a recording in the place of its camera."""

import os
import threading
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from raw_picture import RawPicture
from reporting import PATIENCE, until

from spheremouse.ball.build import build
from spheremouse.capture.newest import Arrival
from spheremouse.capture.replay import Controls
from spheremouse.errors import ControlError, DamagedFrameError, SourceError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.session.command_handler import handle
from spheremouse.session.control.client import Client
from spheremouse.session.control.pictures import PictureReader
from spheremouse.session.control.protocol import LEASE, Replay
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.live_run import LiveRun
from spheremouse.session.offline import track
from spheremouse.session.picture_feed import PictureFeed
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.service import Daemon
from spheremouse.session.setup import open_replay

SIZE = (8, 4)


def numbered(number=1, size=SIZE, error=None):
    """A raw frame whose pixels are its number."""
    w, h = size
    return RawPicture(None, np.full((h, w), number % 256, np.uint8), 3.5, number, error)


ADAPTER = SimpleNamespace(annotations=lambda made: {"sequence": made})


def show(feed, now, raw, made, camera=0, cameras=1, adapter=ADAPTER):
    feed.show(now, Arrival(raw, now, camera), adapter, made, cameras)


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


@pytest.mark.parametrize(
    ("fps", "intervals"),
    [(60.0, (1 / 15,)), (30.0, (0.05,)), (187.0, (0.1,)), (29.97, (1 / 15,)), (60.0, (0.05, 0.5)), (60.0, (0.5, 0.05))],
)
def test_the_mean_interval_is_the_shortest_one_requested_at_any_rate_of_the_camera(feed, fps, intervals):
    raws = [numbered() for _ in range(int(2.0 * fps))]
    for k, raw in enumerate(raws):
        for interval in intervals if k % 20 == 0 else ():
            feed.lease(k / fps, interval, SIZE)
        show(feed, k / fps, raw, k)
    shown, shortest = np.flatnonzero([raw.copied for raw in raws]) / fps, min(intervals)
    assert np.mean(np.diff(shown)) == pytest.approx(max(shortest, 1 / fps), rel=0.03)
    assert np.diff(shown).min() > 0.5 * shortest - 1e-9


@pytest.mark.parametrize(("cameras", "shown"), [((0, 1), [0, 1, 0, 1, 0, 1]), ((1,), [1, 1, 1, 1])])
def test_two_cameras_take_turns_and_one_goes_on_alone(feed, cameras, shown):
    reader, seen = reader_of(feed), []
    for k in range(18):  # 0.6 s
        for camera in cameras:
            show(feed, k / 30 + 1e-3 * camera, numbered(k), k, camera=camera, cameras=2)
            if (picture := reader.latest(len(seen))) is not None:
                seen.append(picture.annotations["camera"])
    assert seen == shown


def test_without_a_lease_nothing_is_copied_and_no_memory_is_held(feed):
    before, raw = len(os.listdir("/proc/self/fd")), numbered()
    show(feed, 0.0, raw, 1)
    ring = feed.lease(1.0, 0.1, SIZE)
    assert len(os.listdir("/proc/self/fd")) > before
    for now in (1.0, 1.0 + 0.9 * LEASE):
        feed.expire(now)
        show(feed, now, raw, 1)
    assert raw.copied == 2
    feed.expire(1.1 + LEASE)
    show(feed, 1.1 + LEASE, raw, 1)
    assert raw.copied == 2
    assert len(os.listdir("/proc/self/fd")) == before
    assert feed.lease(9.0, 0.1, SIZE) is not ring


def test_a_larger_frame_gets_a_larger_ring_and_numbers_go_on(feed):
    reader = reader_of(feed)
    show(feed, 0.0, numbered(1), 1)
    first = reader.latest().number
    show(feed, 1.0, numbered(2, (640, 480)), 2)
    larger = reader_of(feed, 1.0).latest(first)
    assert (larger.width, larger.pixels[0]) == (640, 2)
    assert larger.number > first


def test_a_damaged_frame_is_passed_over_and_an_error_in_the_marks_is_logged_and_the_next_picture_comes(feed, log):
    reader = reader_of(feed)
    show(feed, 0.0, numbered(error=DamagedFrameError("half of it is missing")), 1)
    assert (reader.latest(), log) == (None, [])
    show(feed, 1.0, numbered(), 1, adapter=SimpleNamespace(annotations=lambda made: 1 / 0))
    show(feed, 2.0, numbered(), 1, adapter=SimpleNamespace(annotations=lambda made: {"x": float("nan")}))
    show(feed, 3.0, numbered(), 3)
    assert reader.latest().annotations == {"camera": 0, "sequence": 3}
    assert ["ZeroDivisionError" in log[0], "ValueError" in log[1]] == [True, True]


CLIP = Path(__file__).parents[1] / "data" / "far26_clip"


def test_each_pass_is_exactly_that_of_the_recording_tracked_frame_by_frame(tmp_path):
    settings = ("realtime=off", f"control.socket={tmp_path / 's'}", f"source=dataset:{CLIP}", "output=null")
    overrides = CommandLineOverrides(None, settings, no_map=True)
    plan, results, stop = read_run_config(overrides), [], SimpleNamespace(stop_requested=False)
    setup = open_replay(plan)

    def show(made, _, __):
        estimate = made.epoch.estimate
        results.append((made.frame.sequence, estimate.rotation, estimate.rate, estimate.increment))

    parts = LiveRun(overrides, plan, setup, lambda _: lambda: setup.replay, lambda _: None)
    thread = threading.Thread(target=Daemon(parts, show=show).run, args=(stop,))
    thread.start()
    try:
        until(lambda: results)
        with Client(tmp_path / "s") as client:
            client.ask("replay", speed=20.0, rewind=True)
            assert client.ask("status")["source"]["replay"]["speed"] == 20.0
        until(lambda: [r[0] for r in results].count(0) > 3)
    finally:
        stop.stop_requested = True
        thread.join(PATIENCE)
    starts = [k for k, result in enumerate(results) if result[0] == 0]
    recording = open_dataset(CLIP)
    tracker = build(recording.rig, parts.adapter.pose, plan.configuration)
    expected = [(e.frame.sequence, e.estimate.rotation, e.estimate.rate, e.estimate.increment)
                for e in track(read_frames(recording), tracker)]  # fmt: skip
    for a, b in [*pairwise(starts)][-2:]:
        assert b - a == len(expected) == recording.frames
        for found, true in zip(results[a:b], expected, strict=True):
            assert all(np.array_equal(x, y) for x, y in zip(found, true, strict=True))


def test_a_replay_whose_end_is_not_above_its_begin_is_refused():
    run = SimpleNamespace(setup=SimpleNamespace(replay=SimpleNamespace(controls=Controls())))
    request = Replay(command="replay", begin=1.0, end=1.0)
    with pytest.raises(ControlError, match="replay: end: must be above begin, 1 s"):
        handle(run, PendingRequest(request))


def test_a_camera_is_no_recording():
    with pytest.raises(SourceError, match="is no recording"):
        open_replay(read_run_config(CommandLineOverrides(None, ("source=v4l2:/dev/video0", "output=null"))))
