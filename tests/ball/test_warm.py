"""Nothing is compiled in play: in processes of their own, for here everything has been compiled by other tests."""

import subprocess
import sys

import pytest

FILM = """
import sys
from dataclasses import replace

import numpy as np

from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.session.offline import initialise, track
from spheremouse.ball.build import build
from spheremouse.ball.settings import Settings
from spheremouse.ball.warm import warm_up


def compiled():
    return {
        f"{f.__module__}.{f.__name__}": len(f.signatures)
        for name, module in list(sys.modules.items())
        if name.startswith("spheremouse")
        for f in vars(module).values()
        if hasattr(f, "py_func")
    }


settings = Settings(tracker=sys.argv[2])
warm_up(settings)
before = compiled()
recording = open_dataset(sys.argv[1])
pose = initialise(read_frames(recording), recording.rig, settings).pose


def frames():
    for k, frame in enumerate(read_frames(recording)):
        if 40 <= k < 50:  # the light goes out
            frame = replace(frame, image=np.zeros_like(frame.image))
        if k >= 60:  # the camera is pushed
            frame = replace(frame, image=np.roll(frame.image, 9, 1))
        yield frame


events = [e.events for e in track(frames(), build(recording.rig, pose, settings)) if e.events]
assert len(events) > 3, events
late = {name: n for name, n in compiled().items() if n != before.get(name, 0)}
assert before and not late, late
"""


@pytest.mark.parametrize("tracker", ["so3", pytest.param("ekf1", marks=pytest.mark.slow)])
def test_nothing_is_compiled_in_play(tracker, hands_over_the_ball):
    made = subprocess.run(
        [sys.executable, "-c", FILM, hands_over_the_ball, tracker], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr


@pytest.fixture(scope="module")
def hands_over_the_ball(tmp_path_factory):
    folder = tmp_path_factory.mktemp("film") / "hands"
    options = ["--hands", "--seconds", "3", "--size", "480x360"]
    subprocess.run([sys.executable, "-m", "spheremouse", "simulate", folder, *options], check=True, capture_output=True)
    return folder
