"""Live pictures of a run, and a recording in the place of its camera."""

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
from spheremouse.session.control.protocol import Replay, Request
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.live_run import LiveRun
from spheremouse.session.offline import track
from spheremouse.session.picture_feed import PictureFeed
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.service import Daemon
from spheremouse.session.setup import open_replay

ADAPTER = SimpleNamespace(annotations=lambda made: {"sequence": made})


@pytest.fixture
def log():
    return []


@pytest.fixture
def feed(log):
    return PictureFeed(log.append)


def request(feed, now):
    """Request a picture; the replies to it."""
    replies = []
    feed.request(now, PendingRequest(Request(command="picture"), replies.append))
    return replies


def show(feed, now, made=1, camera=0, cameras=1, adapter=ADAPTER, error=None):
    """Show the feed a frame whose pixels are its number, and return it."""
    raw = RawPicture(None, np.full((4, 8), made % 256, np.uint8), 3.5, made, error)
    feed.show(now, Arrival(raw, now, camera), adapter, made, cameras)
    return raw


def test_without_a_request_nothing_is_copied_and_requests_share_a_picture(feed):
    assert not show(feed, 0.0).copied
    first, second = request(feed, 0.0), request(feed, 0.0)
    assert show(feed, 0.1, 7).copied == 1
    assert first == second
    marks = {"camera": 0, "sequence": 7}
    expected = {"stamp": 3.5, "format": "grey", "width": 8, "height": 4, "annotations": marks}
    assert first == [expected | {"bytes": 32, "pixels": 32 * b"\x07"}]
    third = request(feed, 0.1)
    shown = [show(feed, 0.1 + k / 100).copied for k in range(1, 8)]
    assert (shown, len(third)) == ([0, 0, 1, 0, 0, 0, 0], 1)


@pytest.mark.parametrize(("cameras", "shown"), [((0, 1), [0, 1, 0, 1, 0, 1]), ((1,), [1] * 6)])
def test_two_cameras_take_turns_and_one_goes_on_alone(feed, cameras, shown):
    seen, waiting = [], request(feed, 0.0)
    for k in range(18):  # 0.6 s
        for camera in cameras:
            now = k / 30 + 1e-3 * camera
            show(feed, now, camera=camera, cameras=2)
            if waiting:
                seen.append(waiting[0]["annotations"]["camera"])
                waiting = []
        if k % 3 == 2:
            waiting = request(feed, now + 1e-3)
    assert seen == shown


def test_a_damaged_frame_is_passed_over_and_an_error_in_the_marks_is_logged_and_the_next_picture_comes(feed, log):
    replies = request(feed, 0.0)
    show(feed, 0.0, error=DamagedFrameError("half of it is missing"))
    assert (replies, log) == ([], [])
    show(feed, 0.5, adapter=SimpleNamespace(annotations=lambda made: 1 / 0))
    assert "ZeroDivisionError" in log[0]
    show(feed, 0.9, 3)
    assert replies[0]["annotations"] == {"camera": 0, "sequence": 3}


def test_a_request_without_a_frame_is_refused(feed):
    late, recent = request(feed, 0.0), request(feed, 0.5)
    feed.refuse_late(1.1, "unplugged")
    assert (late, recent) == ([{"ok": False, "error": "there is no picture now: unplugged"}], [])
    show(feed, 1.2)
    assert recent[0]["bytes"] == 32


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
