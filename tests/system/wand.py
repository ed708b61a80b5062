"""A hand-held ball between a camera and a mouse of a real kernel: a film on v4l2loopback; events and samples read back.

Run by tests/system/run after daemon.py, whose camera, mouse and processes it shares. FILMS names what film.py made.
The camera gives YUYV, in which two columns share a colour: so the pictures are not those of the simulation.
"""

import json
import signal
import subprocess
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from daemon import FILMS, INTERVAL, LONGEST, H, Program, Reader, W, Writer, remove, told_at_the_end, until
from modules import insert

from spheremouse.geometry.rotation import log
from spheremouse.output.wand_mapping import PointingSettings
from spheremouse.session import service, setup

IMPORTED = (service, setup)  # once, before the forks


COUNTS = np.radians(PointingSettings().counts_per_radian)  # per degree


class Hand:
    def __init__(self, folder):
        self.folder = folder
        self.rotation, self.position = np.load(folder / "attitude.npy"), np.load(folder / "position.npy")

    def __len__(self):
        return len(self.rotation)

    def pictures(self, name):
        data = np.memmap(self.folder / name, np.uint8, "r").reshape(len(self), -1)
        return lambda k: data[k].tobytes()

    def counts(self, way):
        turns = np.array([log(b @ a.T) for a, b in pairwise(self.rotation[way])])
        counts = turns @ PointingSettings().matrix().T
        return counts.sum(axis=0), np.abs(counts).sum(axis=0)


class CameraRun:
    def __init__(self, folder):
        self.folder, self.film, self.samples = folder, Hand(FILMS / "wand"), folder / "samples.jsonl"
        self.writer = Writer(self.film, 9, "YUYV", 0)
        source = f"v4l2:/dev/video9,width={W},height={H}"
        words = ["--camera", self.film.folder / "camera.yaml", "--output", "uinput:third=rz"]
        words += ["--output", f"text:{self.samples}"]
        words += ["--set", "pointer.horizon=0"]  # what is predicted too far on so slow a guest would stay ahead
        words += ["--set", f"control.socket={folder / 's'}"]
        self.program = Program(folder, "run", "--tracker", "wand", "--source", source, *words)
        self.reach("tracking")
        self.mouse = Reader(folder)
        self.settle()
        self.missed = self.counts() - self.mouse.counts  # while the first poses settled, and nobody read yet

    def counts(self):
        whole = self.samples.read_text().split("\n")[:-1]
        return np.sum([json.loads(line)["counts"] for line in whole], axis=0)

    def last(self):
        lines = self.samples.read_text().split("\n") if self.samples.exists() else []
        return json.loads(lines[-2]) if len(lines) > 1 else {}

    def reach(self, state):
        def there():
            assert self.program.ended() is None, self.program.said
            return self.last().get("status") == state

        until(there, lambda: f"not {state} but {self.last()}: {self.program.said}")

    def settle(self, seconds=4.0):
        now = float(self.last()["stamp"])
        until(lambda: float(self.last()["stamp"]) > now + seconds, "no frames come")

    def play(self, way):
        before = self.mouse.counts
        self.writer.play(way, min(2.0 * INTERVAL, LONGEST))
        self.settle()
        return self.mouse.counts - before


def sigma_of(sample):
    """Largest standard deviation of the attitude, degrees."""
    return np.degrees(np.sqrt(np.diag(sample["attitude_covariance"]).max()))


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """With the film at rest on its first picture, and the ball found."""
    with suppress(subprocess.CalledProcessError):
        insert("v4l2loopback", video_nr=9, max_buffers=8)
    made = CameraRun(tmp_path_factory.mktemp("desk"))
    yield made
    for end in (made.program.kill, made.mouse.close, made.writer.end):
        with suppress(Exception):
            end()
    print(made.program.said)
    remove("v4l2loopback")


def test_the_sum_of_events_is_what_the_hand_has_turned(desk):
    way = list(range(len(desk.film)))
    events = desk.play(way)
    truth, path = desk.film.counts(way)
    off, last = events - truth, desk.last()
    sigma = sigma_of(last)
    print(f"hand: events {events.tolist()}, off {np.round(off).tolist()} of a path of {np.round(path).tolist()}")
    print(f"      the last pose is good to {sigma:.2f} degrees, of {COUNTS:.0f} counts")
    skipped = np.abs(desk.film.counts(way[::4])[0] - truth)  # turns do not commute: a frame may stand for several
    # the play, 2 standard deviations, at either end, and 3 of the last pose and of the first
    assert np.all(np.abs(off) <= (4.0 + 3.0 * 2**0.5) * sigma * COUNTS + skipped)
    assert np.any(np.abs(truth) > 300.0), "nothing was asked"


def test_samples_have_the_position_of_the_ball(desk):
    last = desk.last()
    off = np.array(last["position"]) - desk.film.position[-1]
    print(f"position: off by {np.round(1e3 * off, 1).tolist()} mm")
    sigma = np.sqrt(np.diag(last["position_covariance"]))
    assert np.all(np.abs(off) < 4.0 * sigma + (1e-3, 1e-3, 5e-3))
    assert np.all(sigma < (3e-3, 3e-3, 3e-2))


def test_ended_it_has_sent_what_it_tells(desk):
    assert desk.program.kill(signal.SIGTERM) == 0
    until(lambda: desk.mouse.gone, "the mouse is still there")
    # the mouse's ledger: a frame under way at the pause may be in the samples and not here, or here and not there
    np.testing.assert_array_equal(told_at_the_end(desk.program), desk.mouse.counts + desk.missed)
    assert "internal error" not in desk.program.said
    assert Path("/dev/video9").exists()
