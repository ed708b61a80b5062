"""The daemon between a camera and a mouse of a real kernel: a film is written to v4l2loopback, events are read back.

Run by tests/system/run, in the order of this file: one daemon lives through it. FILMS names what film.py made.
The guest is slow, so no deadline here is tight.
"""

import os
import queue
import re
import subprocess
import sys
import threading
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from film import SLOW
from modules import insert, remove

from spheremouse.errors import SpheremouseError
from spheremouse.geometry.rotation import log
from spheremouse.output import uinput
from spheremouse.session.control.client import Client

linuxpy = pytest.importorskip("linuxpy.video.device")
evdev = pytest.importorskip("evdev")

FILMS = Path(os.environ["FILMS"])
PATIENCE = 240.0  # s, for what takes a few
INTERVAL = 0.2  # s between two pictures, on a guest that is fast enough
LONGEST = 0.5  # s; three of them are less than what a camera may be silent
W, H = 640, 480
COUNTS = 600.0  # per radian: the default, 1 per mm of a ball of 0.6 m
AXES = [uinput.REL_X, uinput.REL_Y, uinput.REL_RZ]


def until(condition, words):
    """Return what the condition gives once it is true."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, words if isinstance(words, str) else words()
        time.sleep(0.05)
    return found


class Film:
    def __init__(self, folder):
        self.folder = folder
        self.attitude = np.load(folder / "attitude.npy")
        self.pictures = np.memmap(folder / "YUYV", np.uint8, "r").reshape(-1, 2 * W * H)

    def counts(self, way):
        """(3,) counts of the motion along the pictures of `way`, and of the length of its path."""
        rotations = np.array([log(b @ a.T) for a, b in pairwise(self.attitude[way])])
        turns = COUNTS * rotations[:, [2, 0, 1]] * (1, -1, 1)  # of a player on the far side
        return turns.sum(axis=0), np.abs(turns).sum(axis=0)


class Writer:
    """A thread that writes a film to a loopback device. It rests on a picture until it is asked to play."""

    def __init__(self, film, node, at):
        self._pictures, self._at, self._asked = film.pictures, at, queue.Queue()
        self._device = linuxpy.Device.from_id(node)
        self._device.open()
        self._device.set_format(linuxpy.BufferType.VIDEO_OUTPUT, W, H, "YUYV")
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()
        self.play([at], INTERVAL)

    def play(self, way, interval):
        """Write the pictures of `way`; None leaves one out."""
        done = threading.Event()
        self._asked.put((list(way), interval, done))
        assert done.wait(4 * len(way) * interval + PATIENCE), "the film is not played"

    def end(self):
        self._asked.put(None)
        self._thread.join(PATIENCE)
        self._device.close()

    def _write(self):
        way, interval, done, rested, due = [], INTERVAL, threading.Event(), 0, time.monotonic()
        while True:
            shown = way.pop(0) if way else self._at
            if shown is not None:
                os.write(self._device.fileno(), self._pictures[shown])
                self._at = shown
            rested = 0 if way else rested + 1
            if rested == 3:
                done.set()
            due = max(due + interval, time.monotonic())
            with suppress(queue.Empty):
                asked = self._asked.get(timeout=max(0.0, due - time.monotonic()))
                if asked is None:
                    return
                (way, interval, done), rested = asked, 0


def mice():
    found = [evdev.InputDevice(path) for path in evdev.list_devices()]
    return [device for device in found if device.name == uinput.NAME]


class Reader:
    """A thread that adds up the events of the mouse until that goes."""

    def __init__(self):
        (self._device,) = until(mice, "there is no mouse")
        self.node = Path(self._device.path)
        self._sums, self.gone, self._dropped = np.zeros(3, dtype=int), False, False
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        try:
            for event in self._device.read_loop():
                self._dropped |= (event.type, event.code) == (evdev.ecodes.EV_SYN, evdev.ecodes.SYN_DROPPED)
                if event.type == evdev.ecodes.EV_REL:
                    self._sums[AXES.index(event.code)] += event.value
        except OSError:
            self.gone = True

    @property
    def counts(self):
        assert not self._dropped
        return self._sums.copy()


CONFIG = """\
schema: 2
source: v4l2:{folder}/camera
output: "uinput:third=rz"
rig: rig.yaml
pose: {{frames: 2}}
loss: {{lost_after: {slow.lost_after}, reset_after: {slow.reset_after}}}
pointer: {{horizon: 0}}
control: {{socket: {folder}/socket}}
record: {{folder: {folder}/recordings, seconds: 600}}
"""


class Cabinet:
    def __init__(self, folder, film):
        self.folder, self.film, self.client = folder, film, Client(folder / "socket")
        (folder / "config.yaml").write_text(CONFIG.format(folder=folder, slow=SLOW.loss))
        (folder / "rig.yaml").write_text((film.folder / "rig.yaml").read_text())
        self._place = 0  # in the film played forwards and backwards
        self.plug(9)
        with (folder / "log").open("w") as file:
            command = [sys.executable, "-m", "spheremouse", "run", "--config", str(folder / "config.yaml")]
            self.daemon = subprocess.Popen(command, stderr=file)
        self.reach("tracking")
        self.mouse = Reader()

    @property
    def said(self):
        return (self.folder / "log").read_text()

    def plug(self, number, turned=0):
        """A camera under its lasting name; the ball has been turned by so many pictures."""
        self._place += turned
        link = self.folder / "camera.new"
        link.symlink_to(f"/dev/video{number}")
        self.writer = Writer(self.film, number, self.onward(0)[0])
        link.rename(self.folder / "camera")

    def status(self):
        """What it says of itself, as soon as it answers: a guest can stand still for seconds."""
        said = {}

        def answers():
            assert self.daemon.poll() is None, f"it has ended with {self.daemon.poll()}: {self.said}"
            with suppress(SpheremouseError):
                said.update(self.client.ask("status"))
            return said

        until(answers, lambda: f"no answer: {self.said}")
        return said

    def reach(self, state):
        last = {}

        def there():
            last.clear()
            last.update(self.status())
            return last.get("state") == state

        until(there, lambda: f"not {state} but {last}: {self.said}")
        return last

    def settle(self, frames=4):
        n = self.status()["frames"] + frames
        until(lambda: self.status()["frames"] >= n, "no frames come")
        time.sleep(0.3)

    def onward(self, n):
        """The picture that is shown and n more, the film played forwards and backwards."""
        last = len(self.film.attitude) - 1
        return [last - abs(last - k % (2 * last)) for k in range(self._place, self._place + n + 1)]

    def play(self, way):
        before = self.mouse.counts
        self._place += len(way) - 1
        until(lambda: "decode" in self.status()["stages_ms"], "no frame was timed")  # they are, once a second
        work = sum(self.status()["stages_ms"][stage]["p50"] for stage in ("decode", "detect", "filter"))
        self.writer.play(way, min(max(INTERVAL, 2e-3 * work), LONGEST))
        self.settle()
        return self.mouse.counts - before, *self.film.counts([k for k in way if k is not None])


def check(title, play, slack=0.0):
    """Within 1 % of the path, and a count for what is not whole yet."""
    counts, truth, path = play
    off = counts - truth
    print(f"{title}: events {counts.tolist()}, off {np.round(off, 1).tolist()} of a path of {np.round(path).tolist()}")
    assert np.all(np.abs(off) <= 0.01 * path + 1.0 + slack), title


def at_rest(counts, before):
    """No events for a ball that stood still; the filter, which may still converge, can make one begun count whole."""
    assert np.all(np.abs(counts - before) <= 1), (counts, before)


@pytest.fixture(scope="module")
def cabinet(tmp_path_factory):
    """With a camera at rest on the first picture, and a daemon that tracks it."""
    insert("v4l2loopback", video_nr=9, max_buffers=8)
    made = Cabinet(tmp_path_factory.mktemp("cabinet"), Film(FILMS / "play"))
    yield made
    made.daemon.kill()
    made.writer.end()
    print(made.said)
    remove("v4l2loopback")


def test_the_sum_of_events_is_what_the_ball_has_turned_with_frames_missing(cabinet):
    n = len(cabinet.film.attitude)
    for _ in range(4):  # at five frames/s, a guest that is held up in between lets the ball turn by half a disc's way
        before = cabinet.status()
        way = [None if 0 < k < n - 1 and (k % 5 == 3 or k % 17 in (8, 9)) else k for k in cabinet.onward(n - 1)]
        played = cabinet.play(way)
        status = cabinet.status()
        missed = sum(status[key] - before[key] for key in ("skipped", "dropped"))  # the daemon or its driver was behind
        print(f"{way.count(None)} of {n} pictures left out, {missed} more were missed")
        if missed == 0:
            break
    check("exact", played)
    assert status["state"] == "tracking"
    assert all(status[key] == before[key] for key in ("lost_count", "unseen_s"))
    assert status["outputs"][0]["unsent"] == [0, 0, 0]
    assert 0 < status["latency_ms"]["p50"] <= status["latency_ms"]["p99"] <= status["latency_ms"]["max"] < 60_000
    print({key: status[key] for key in ("fps", "latency_ms", "stages_ms", "skipped", "dropped", "memory_mb")})


def test_the_camera_goes_and_comes_back_as_the_same_node_and_as_another(cabinet):
    mouse, before = cabinet.mouse.node.stat(), cabinet.mouse.counts
    for number, turned in ((9, 0), (11, 20)):
        lost = cabinet.status()["camera_restarts"]
        cabinet.writer.end()
        print(f"no-camera: {cabinet.reach('no-camera')['reason']}")
        if number == 11:
            remove("v4l2loopback")
            insert("v4l2loopback", video_nr=number, max_buffers=8)
        cabinet.plug(number, turned=turned)
        assert cabinet.reach("tracking")["camera_restarts"] == lost + 1
        cabinet.settle()
        at_rest(cabinet.mouse.counts, before)
        before = cabinet.mouse.counts
    now = cabinet.mouse.node.stat()
    assert (now.st_ino, now.st_rdev, now.st_ctime) == (mouse.st_ino, mouse.st_rdev, mouse.st_ctime)
    assert not cabinet.mouse.gone
    check("after it came back", cabinet.play(cabinet.onward(12)), 1.0)


def test_stopped_it_leaves_nothing_and_has_sent_what_the_frames_said(cabinet):
    cabinet.client.ask("stop")
    assert cabinet.daemon.wait(PATIENCE) == 0
    until(lambda: cabinet.mouse.gone, "the mouse has stayed")
    assert mice() == []
    assert not (cabinet.folder / "socket").exists()
    told = re.search(r"counts x ([+-]\d+), y ([+-]\d+), third ([+-]\d+)", cabinet.said)
    assert cabinet.mouse.counts.tolist() == list(map(int, told.groups()))
    assert "internal error" not in cabinet.said
