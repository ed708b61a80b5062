"""No compilation during tracking, in a separate process, because other tests compile the functions in this one."""

import subprocess
import sys

import pytest

FILM = """
import sys
from dataclasses import replace

import numpy as np

from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.build import build
from spheremouse.wand.settings import WandSettings
from spheremouse.output.wand_mapping import PointingSettings
from spheremouse.output.wand_mapping import WandMapping
from spheremouse.session.offline import make_wand_ready, track_wand


def compiled():
    return {
        f"{f.__module__}.{f.__name__}": len(f.signatures)
        for name, module in list(sys.modules.items())
        if name.startswith("spheremouse") and ".simulate" not in name
        for f in vars(module).values()
        if hasattr(f, "py_func")
    }


film = prepare_wand(WandOptions("hand", seed=2, fps=15.0, seconds=2.4, size=(480, 360), balls=2))
images = [s.frame for s in simulate_wand(film)]
make_wand_ready()
before = compiled()


def frames():
    for k, frame in enumerate(images):
        if 10 <= k < 22:  # dark
            frame = replace(frame, image=np.full_like(frame.image, 90))
        yield frame


for settings in (WandSettings(), WandSettings(method="rims"), WandSettings(region=False, outline=False)):
    tracker = build(film.scene.camera, tuple(b.ball for b in film.scene.balls), settings)
    hand = WandMapping(PointingSettings())
    phases = set()
    for epoch in track_wand(frames(), tracker):
        hand.counts(epoch.estimate)
        phases |= {pose.phase for pose in epoch.poses}
    assert settings.method == "rims" or len(phases) >= 2, phases
late = {name: n for name, n in compiled().items() if n != before.get(name, 0)}
assert before and not late, late
"""


@pytest.mark.slow
def test_tracking_compiles_nothing_after_warm_up():
    made = subprocess.run([sys.executable, "-c", FILM], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
