"""The daemon between a camera and a mouse of a real kernel: a film is written to v4l2loopback, events are read back.

Run by tests/system/run, in the order of this file: one daemon lives through it. FILMS names what film.py made.
The guest is slow: a daemon is this process forked, with all imported, and `spheremouse` called in it. No
deadline here is tight.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from film import SLOW
from modules import insert, remove

from spheremouse import commands as cli
from spheremouse.commands import ctl as cli_ctl
from spheremouse.commands import run as cli_run
from spheremouse.errors import SpheremouseError
from spheremouse.geometry.rotation import log
from spheremouse.output import uinput
from spheremouse.session import service as run
from spheremouse.session.control.client import Client

linuxpy = pytest.importorskip("linuxpy.video.device")

IMPORTED = (cli_ctl, cli_run, run)  # once, before the forks
FILMS = Path(os.environ["FILMS"])
PATIENCE = 120.0  # s, for what takes a few
INTERVAL = 0.2  # s between two pictures, on a guest that is fast enough
LONGEST = 0.5  # s; three of them are less than what a camera may be silent
W, H = 640, 480
COUNTS = 600.0  # per radian: the default, 1 per mm of a ball of 0.6 m

# A second process: one line per event of an input device, code and value; its name, last, when the device goes.
READER = """
import struct, sys
with open(sys.argv[1], "rb", buffering=0) as device:
    print("ready", flush=True)
    try:
        while True:
            for _, _, kind, code, value in struct.iter_unpack("llHHi", device.read(24 * 64)):
                print("dropped" if (kind, code) == (0, 3) else f"{code} {value}" if kind == 2 else "", flush=True)
    except OSError:
        print("gone", flush=True)
"""


# ---- the camera ----


class Film:
    def __init__(self, folder):
        self.folder = folder
        self.attitude = np.load(folder / "attitude.npy")

    def __len__(self):
        return len(self.attitude)

    def pictures(self):
        data = np.memmap(self.folder / "YUYV", np.uint8, "r")
        return lambda k: data[k * 2 * W * H : (k + 1) * 2 * W * H].tobytes()

    def counts(self, way):
        turns = COUNTS * self.turns(way)[:, [2, 0, 1]] * (1, -1, 1)  # of a player on the far side
        return turns.sum(axis=0), np.abs(turns).sum(axis=0)

    def turns(self, way):
        """(n, 3) rad, from picture to picture along `way`."""
        return np.array([log(b @ a.T) for a, b in pairwise(self.attitude[way])])


class Writer:
    """A process that writes a film to a loopback device: rests on a picture until it is asked to play."""

    def __init__(self, film, node, at):
        context = get_context("fork")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_write, args=(film, node, at, there), daemon=True)
        self._process.start()
        self._expect("writing")

    def play(self, way, interval):
        self._here.send((list(way), interval))
        self._expect("played", 4 * len(way) * interval + PATIENCE)

    def end(self):
        if self._process.is_alive():
            self._here.send(None)
            self._process.join(PATIENCE)
        assert self._process.exitcode == 0

    def _expect(self, word, patience=PATIENCE):
        assert self._here.poll(patience), f"the writer is not {word}"
        assert self._here.recv() == word


def _write(film, node, at, pipe):
    device = linuxpy.Device.from_id(node)
    device.open()
    device.set_format(linuxpy.BufferType.VIDEO_OUTPUT, W, H, "YUYV")
    picture = film.pictures()
    way, interval, word, rested, due = [], INTERVAL, "writing", 0, time.monotonic()
    while True:
        shown = way.pop(0) if way else at
        if shown is not None:
            os.write(device.fileno(), picture(shown))
            at = shown
        rested = 0 if way else rested + 1
        if rested == 3 and word:
            pipe.send(word)
            word = ""
        due = max(due + interval, time.monotonic())
        if pipe.poll(max(0.0, due - time.monotonic())):
            asked = pipe.recv()
            if asked is None:
                break
            (way, interval), word, rested = asked, "played", 0
    device.close()


# ---- the mouse ----


def mice():
    return [
        Path("/dev/input") / p.name
        for p in Path("/sys/class/input").glob("event*")
        if (p / "device" / "name").read_text().strip() == uinput.NAME
    ]


class Reader:
    def __init__(self, folder):
        (self.node,) = until(mice, "there is no mouse")
        self._lines = folder / f"events{time.monotonic_ns()}"
        with self._lines.open("wb") as file:
            command = [sys.executable, "-I", "-S", "-c", READER, str(self.node)]
            self._process = subprocess.Popen(command, stdout=file)
        until(self._read, "the mouse is not read")

    def _read(self):
        return self._lines.read_text().split("\n")[:-1]

    @property
    def gone(self):
        return "gone" in self._read()

    @property
    def counts(self):
        codes = {uinput.REL_X: 0, uinput.REL_Y: 1, uinput.REL_RZ: 2}
        sums = np.zeros(3, dtype=int)
        for line in self._read():
            assert line != "dropped"
            if " " in line:
                code, value = map(int, line.split())
                sums[codes[code]] += value
        return sums

    def close(self):
        self._process.kill()
        self._process.wait()


# ---- the program ----


class Program:
    def __init__(self, folder, *arguments):
        self._name = folder / f"program{time.monotonic_ns()}"
        self.pid = os.fork()
        if self.pid == 0:
            _be(self._name, [str(a) for a in arguments])
        self.code = None

    @property
    def out(self):
        return Path(f"{self._name}.out").read_text() if Path(f"{self._name}.out").exists() else ""

    @property
    def said(self):
        return Path(f"{self._name}.err").read_text() if Path(f"{self._name}.err").exists() else ""

    def ended(self):
        if self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
        return self.code

    def wait(self):
        until(lambda: self.ended() is not None, "it does not end")
        return self.code

    def kill(self, number=signal.SIGKILL):
        if self.ended() is None:
            os.kill(self.pid, number)
        return self.wait()


def _be(name, arguments):
    """The rest of this process is the program."""
    code = 70
    try:
        for number, suffix in ((1, "out"), (2, "err")):
            os.dup2(os.open(f"{name}.{suffix}", os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
        sys.argv = ["spheremouse", *arguments]
        cli.main()
    except SystemExit as e:
        code = e.code if isinstance(e.code, int) else 1
    finally:
        with suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def until(condition, words, patience=PATIENCE):
    """What the condition gives once it is true."""
    end = time.monotonic() + patience
    while not (found := condition()):
        assert time.monotonic() < end, words if isinstance(words, str) else words()
        time.sleep(0.05)
    return found


# ---- the cabinet ----

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
        self.folder, self.film = folder, film
        self.config, self.socket = folder / "config.yaml", folder / "socket"
        self.config.write_text(CONFIG.format(folder=folder, slow=SLOW.loss))
        (folder / "rig.yaml").write_text((film.folder / "rig.yaml").read_text())
        self.writer = self.daemon = self.mouse = None
        self._place = 0  # in the film played forwards and backwards

    # the camera

    def plug(self, number, turned=0):
        """A camera under its lasting name; the ball has been turned by so many pictures."""
        self._place += turned
        link = self.folder / "camera.new"
        link.symlink_to(f"/dev/video{number}")
        self.writer = Writer(self.film, number, self.onward(0)[0])
        link.rename(self.folder / "camera")

    # the daemon

    def start(self, *arguments):
        self.daemon = Program(self.folder, "run", "--config", self.config, *arguments)

    def status(self):
        """What it says of itself, {} while it does not."""
        assert self.daemon.ended() is None, f"it has ended with {self.daemon.ended()}: {self.daemon.said}"
        with suppress(SpheremouseError), Client(self.socket) as client:
            return client.ask("status")
        return {}

    def reach(self, state):
        last = {}

        def there():
            last.clear()
            last.update(self.status())
            return last.get("state") == state

        until(there, lambda: f"not {state} but {last}: {self.daemon.said}")
        return last

    def ctl(self, *arguments):
        """`spheremouse ctl`: exit code, output, complaint."""
        asked = Program(self.folder, "ctl", *arguments, "--socket", self.socket)
        return asked.wait(), asked.out, asked.said

    def missed(self):
        """Frames that were there and were not worked on: the daemon or its driver was behind."""
        status = self.status()
        return status["skipped"] + status["dropped"]

    def settle(self, frames=4):
        n = self.status()["frames"] + frames
        until(lambda: self.status()["frames"] >= n, "no frames come")
        time.sleep(0.3)

    def onward(self, n):
        """The picture that is shown and n more, the film played forwards and backwards."""
        last = len(self.film) - 1
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


def told_at_the_end(program):
    """(3,) counts of all frames, as the program says when it ends."""
    return np.array(re.search(r"counts x ([+-]\d+), y ([+-]\d+), third ([+-]\d+)", program.said).groups(), dtype=int)


@pytest.fixture(scope="module")
def cabinet(tmp_path_factory):
    """With a camera at rest on the first picture, and a daemon that tracks it."""
    insert("v4l2loopback", video_nr=9, max_buffers=8)
    made = Cabinet(tmp_path_factory.mktemp("cabinet"), Film(FILMS / "play"))
    made.plug(9)
    made.start()
    made.reach("tracking")
    made.mouse = Reader(made.folder)
    yield made
    for end in (made.daemon.kill, made.mouse.close, made.writer.end):
        with suppress(Exception):
            end()
    print(made.daemon.said)
    remove("v4l2loopback")


# ---- what it is for ----


def test_the_sum_of_events_is_what_the_ball_has_turned_with_frames_missing(cabinet):
    n = len(cabinet.film)
    for _ in range(4):  # at five frames/s, a guest that is held up in between lets the ball turn by half a disc's way
        before = cabinet.missed()
        way = [None if 0 < k < n - 1 and (k % 5 == 3 or k % 17 in (8, 9)) else k for k in cabinet.onward(n - 1)]
        played = cabinet.play(way)
        print(f"{way.count(None)} of {n} pictures left out, {cabinet.missed() - before} more were missed")
        if cabinet.missed() == before:
            break
    check("exact", played)
    code, out, said = cabinet.ctl("status", "--json")
    assert code == 0, said
    status = json.loads(out)
    assert status["state"] == "tracking"
    assert status["lost_count"] == 0
    assert status["unseen_s"] == 0
    assert status["outputs"][0]["unsent"] == [0, 0, 0]
    assert 0 < status["latency_ms"]["p50"] <= status["latency_ms"]["p99"] <= status["latency_ms"]["max"] < 60_000
    print({key: status[key] for key in ("fps", "latency_ms", "stages_ms", "skipped", "dropped", "memory_mb")})


# ---- what may happen ----


def test_the_camera_goes_and_comes_back_as_the_same_node_and_as_another(cabinet):
    mouse, before = cabinet.mouse.node.stat(), cabinet.mouse.counts
    for number, turned in ((9, 0), (11, 20)):
        lost = cabinet.status()["camera_restarts"]
        cabinet.writer.end()
        status = cabinet.reach("no-camera")
        print(f"no-camera: {status['reason']}")
        if number == 11:
            remove("v4l2loopback")
            cabinet.reach("no-camera")
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
    code, _, said = cabinet.ctl("stop")
    assert code == 0, said
    assert cabinet.daemon.wait() == 0
    assert mice() == []
    assert not cabinet.socket.exists()
    np.testing.assert_array_equal(told_at_the_end(cabinet.daemon), cabinet.mouse.counts)
    assert "internal error" not in cabinet.daemon.said
