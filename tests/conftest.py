"""Where the reference recordings are, and what to do without them."""

import hashlib
import os
import pickle
import signal
import sys
from collections import OrderedDict
from dataclasses import fields
from pathlib import Path

import cv2
import hypothesis
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from spheremouse import commands as cli
from spheremouse.session.process import realtime
from spheremouse.simulate.ball import backdrop, render
from spheremouse.simulate.wand import render as wand_render

_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP") if hasattr(signal, name)]

for _name in ("CI", "BUILD_NUMBER"):  # with these, pytest compares large bytes that differ for minutes
    os.environ.pop(_name, None)
threadpool_limits(1)  # as the command line does
hypothesis.settings.register_profile("untimed", deadline=None, max_examples=60)  # machines are shared
hypothesis.settings.load_profile("untimed")


def shared(make, key_of, most=12):
    """`make`, asked once of what is alike; what it gave cannot be written to."""
    made = OrderedDict()

    def once(*args, **kwargs):
        key = hashlib.sha256(pickle.dumps(key_of(*args, **kwargs))).digest()
        if key not in made:
            made[key] = make(*args, **kwargs)
            while len(made) > most:
                made.popitem(last=False)
        made.move_to_end(key)
        return made[key]

    return once


def _backdrop(scene, *, ball=True):
    found = _render_backdrop(scene, ball=ball)
    for part in fields(found):
        getattr(found, part.name).flags.writeable = False
    return found


def _looks(scene, *, ball=True):
    """What a backdrop is made of: no disc is."""
    look = scene.surroundings, scene.lighting, scene.ball_radius, scene.ball_colour, scene.disc_colour
    return scene.camera, scene.pose, look, ball


def _background(camera, outdoors, clutter, rng):
    """With the state in which the generator is left."""
    picture = _render_background(camera, outdoors, clutter, rng)
    picture.flags.writeable = False
    return picture, rng.bit_generator.state


def _background_with_its_luck(camera, outdoors, clutter, rng):
    picture, rng.bit_generator.state = _shared_background(camera, outdoors, clutter, rng)
    return picture


_render_backdrop, _render_background = backdrop.render_backdrop, wand_render.background
_shared_backdrop = shared(_backdrop, _looks)
_shared_background = shared(_background, lambda *args: (*args[:-1], args[-1].bit_generator.state))
for _module in (backdrop, render):
    vars(_module)["render_backdrop"] = _shared_backdrop
wand_render.background = _background_with_its_luck


def datasets_dir() -> Path:
    """Folder of the reference recordings; skips the test that asks where it does not exist."""
    path = Path(os.environ.get("SPHEREMOUSE_DATASETS", Path(__file__).parents[2] / "shared" / "datasets"))
    if not path.is_dir():
        pytest.skip(f"reference recordings not found at {path} (set SPHEREMOUSE_DATASETS)")
    return path


@pytest.fixture
def far26() -> Path:
    return datasets_dir() / "far26"


def write_video(path, images, codec="FFV1", fps=30.0):
    """Write images, (h, w, 3), as a video. Return it as a source."""
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, images[0].shape[1::-1])
    for image in images:
        video.write(image)
    video.release()
    return f"video:{path}"


class Program:
    """Runs the program in this process: (*words) -> exit code, standard output, standard error."""

    def __init__(self, monkeypatch, capfd):
        self._monkeypatch, self._capfd = monkeypatch, capfd

    def __call__(self, *words):
        self._capfd.readouterr()
        self._monkeypatch.setattr(sys, "argv", ["spheremouse", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code or 0, *self._capfd.readouterr()

    def succeed(self, *words):
        """Return standard output and error of a run that must succeed."""
        code, out, err = self(*words)
        assert code == 0, err
        return out, err

    def fail(self, *words):
        """Return what a run says that must be refused in one line, before it prints anything."""
        code, out, err = self(*words)
        assert (code, out, err.count("\n"), err.partition(": ")[0]) == (2, "", 1, "spheremouse"), err
        return err.removeprefix("spheremouse: ").removesuffix("\n")


@pytest.fixture
def spheremouse(monkeypatch, capfd):
    """The program, without what it would ask of the system for the whole process.

    That is not for the tests after it: real-time scheduling, locked memory, code folded up.
    """
    monkeypatch.setattr(realtime, "prepare", lambda wanted=True: "as it is")
    monkeypatch.setattr(realtime, "claim", lambda _: False)
    before = {s: signal.getsignal(s) for s in _SIGNALS}
    yield Program(monkeypatch, capfd)
    for number, handler in before.items():
        signal.signal(number, handler)


def seeds(quick, more):
    """Return the numbers from 0 on, of which all but the first `quick` are for slow tests."""
    return [*range(quick), *(pytest.param(k, marks=pytest.mark.slow) for k in range(quick, more))]


def central_differences(f, x, h=1e-6):
    """Return df/dx, (..., k), of a function of one (k,) vector."""
    return np.stack([(f(x + d) - f(x - d)) / (2 * h) for d in h * np.eye(len(x))], axis=-1)


def covariance_of(sigmas, seed):
    """Return a covariance with these standard deviations and strong correlations."""
    C = np.cov(np.random.default_rng(seed).normal(size=(len(sigmas), 3 * len(sigmas))))
    s = np.asarray(sigmas) / np.sqrt(np.diag(C))
    return C * np.outer(s, s)


def directions(n: int, seed: int, least: float = 0.2) -> np.ndarray:
    """Unit vectors, (n, 3), of which no two are nearer than `least` rad."""
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < n:
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        if all(d @ other < np.cos(least) for other in found):
            found.append(d)
    return np.array(found)
