"""A daemon that replays a recording: exactly, under control of its clients."""

import threading
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from reporting import until

from spheremouse.ball.build import build
from spheremouse.errors import ControlError, SourceError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.session.control.client import Client
from spheremouse.session.offline import track
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.service import Daemon
from spheremouse.session.setup import open_replay

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"
ON_CLIP = (f"source=dataset:{CLIP}", "output=null")
PATIENCE = 60.0  # s


class Run:
    def __init__(self, folder):
        settings = ("realtime=off", f"control.socket={folder / 's'}", *ON_CLIP)
        overrides = CommandLineOverrides(None, settings, no_map=True)
        plan = read_run_config(overrides)
        setup = open_replay(plan)
        self.results = []
        self.daemon = Daemon(overrides, plan, setup, lambda _: setup.open_replay, log=lambda _: None, show=self._show)
        self.client = Client(folder / "s")
        self._stop = SimpleNamespace(asked=False)
        self._thread = threading.Thread(target=self.daemon.run, args=(self._stop,))
        self._thread.start()

    def _show(self, made, _, __):
        estimate = made.epoch.estimate
        self.results.append((made.frame.sequence, estimate.rotation, estimate.rate, estimate.increment))

    def ask(self, command, **arguments):
        return self.client.ask(command, **arguments)

    def close(self):
        self.client.close()
        self._stop.asked = True
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()


@pytest.fixture
def run(tmp_path):
    run = Run(tmp_path)
    try:
        until(lambda: run.results)
        yield run
    finally:
        run.close()


def test_each_pass_is_exactly_that_of_the_recording_tracked_frame_by_frame(run):
    run.ask("replay", speed=20.0)
    until(lambda: [r[0] for r in run.results].count(0) > 3)
    starts = [k for k, result in enumerate(run.results) if result[0] == 0]
    passes = [run.results[a:b] for a, b in pairwise(starts)][-2:]
    recording = open_dataset(CLIP)
    assert run.daemon.adapter.pose is not None
    tracker = build(recording.rig, run.daemon.adapter.pose, read_run_config(
        CommandLineOverrides(None, ON_CLIP)).configuration)  # fmt: skip
    expected = [(e.frame.sequence, e.estimate.rotation, e.estimate.rate, e.estimate.increment)
                for e in track(read_frames(recording), tracker)]  # fmt: skip
    for results in passes:
        assert len(results) == len(expected) == recording.frames
        for found, true in zip(results, expected, strict=True):
            assert all(np.array_equal(a, b) for a, b in zip(found, true, strict=True))


def test_nonsense_is_refused_in_words_and_changes_nothing(run):
    for wrong in ({"speed": 0.0}, {"begin": -1.0}, {"end": "late"}, {"step": 1}, {"end": 1.0, "begin": 1.0}):
        with pytest.raises(ControlError, match=f"replay: {next(iter(wrong))}: "):
            run.ask("replay", **wrong)
    controls = run.ask("status")["source"]["replay"]
    assert (controls["begin"], controls["end"], controls["speed"]) == (0.0, None, 1.0)


def test_a_camera_is_no_recording():
    with pytest.raises(SourceError, match="is no recording"):
        open_replay(read_run_config(CommandLineOverrides(None, ("source=v4l2:/dev/video0", "output=null"))))
