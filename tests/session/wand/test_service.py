"""The wand before a live camera, in this process: a film behind a scripted camera, and faults at each edge.

Laws that hold in every test, checked at its end: nothing is sent but while the ball is seen; what frames gave is what
was sent or was counted as unsent; every shot was given back.
"""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spheremouse.capture import fetch as capture_module
from spheremouse.errors import DamagedFrameError, OutputError, SourceError
from spheremouse.output import OutputClosed
from spheremouse.output import reporter as reporter_module
from spheremouse.output.axes import AxesOutput, AxesText
from spheremouse.output.pointer import PointerSettings
from spheremouse.session.process import realtime
from spheremouse.session.settings import Configuration
from spheremouse.session.wand.messages import Told
from spheremouse.session.wand.plan import Outputs
from spheremouse.session.wand.service import WandLive
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.tracker import Frame
from spheremouse.wand.track import build
from spheremouse.wand.warm import warm_up

DT = 1.0 / 30.0
PATIENCE = 30.0  # s


class Shot:
    def __init__(self, world, stamp, sequence, place):
        self.stamp, self.sequence, self.place, self._world, self._out = stamp, sequence, place, world, True

    def frame(self, colour):
        assert self._out, "a shot that was given back is looked at"
        assert colour
        fault, image = self._world.fault, self._world.images[self.place]
        if fault == "damaged":
            raise DamagedFrameError("half of it is missing")
        if fault == "internal":
            raise ZeroDivisionError("as if we had made a mistake")
        if fault == "hidden":
            image = np.full_like(image, 90)
        if fault == "size":
            image = image[:240, :320]
        if fault == "grey":
            image = image[:, :, 0]
        if fault == "buffer":  # a driver's: rows with gaps, and not to be written
            image = np.pad(image, ((0, 0), (0, 5), (0, 0)))[:, :-5]
            image.flags.writeable = False
        return Frame(image, self.stamp, self.sequence)

    def release(self):
        if self._out:
            self._out = False
            self._world.given_back()


class World:
    """The camera, the output, and the run between them."""

    asked = False  # to stop

    def __init__(self, film, shots):
        self.film, self.images = film, [s.frame.image for s in shots]
        self.rotation = np.array([s.rotation[0] for s in shots])
        self.missing = self.fault = self.broken = ""
        self.place, self._way, self.moves, self.sequence, self.out, self.opened = 0, 1, 0, 0, 0, 0
        self.stamp = time.monotonic()
        self.shown, self.frames, self.sent, self.said, self.closed = [], [], [], [], False
        self._free, self._lock = threading.Event(), threading.Lock()
        self._free.set()
        self.axes = None
        self.error = None

    # the camera

    def open_camera(self):
        if self.missing:
            raise SourceError(self.missing)
        self.opened += 1
        return self

    def next(self, timeout):
        if self.missing:
            raise SourceError(self.missing)
        if not self._free.wait(timeout):
            return None
        time.sleep(0.001)
        if self.moves > 0:
            self.moves -= 1
            self.place += self._way
            if self.place in (0, len(self.images) - 1):
                self._way = -self._way
        self.shown.append(self.place)
        self.stamp += DT
        self.sequence += 1
        self._free.clear()
        with self._lock:
            self.out += 1
        return Shot(self, self.stamp, self.sequence, self.place)

    def given_back(self):
        with self._lock:
            self.out -= 1
        self._free.set()

    def describe(self):
        return "a film"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    # the output

    def open_output(self):
        if self.broken:
            raise OutputError(self.broken)
        return Sink(self)

    @property
    def counts(self):
        return np.sum([m.counts for m in self.sent], axis=0) if self.sent else np.zeros(3)

    # the run

    def start(self, axes=None, frames=None):
        tracker = build(self.film.scene.camera, (self.film.scene.balls[0].ball,))
        settings = Configuration(realtime="off", pointer=PointerSettings(horizon=0.0))
        outputs = Outputs(self.open_output, None if axes is None else axes.open, () if axes is None else (axes,))
        self.live = WandLive(
            tracker, settings, self.open_camera, outputs, Told(),
            say=self.said.append, show=lambda epoch, made: self.frames.append((epoch, made)), frames=frames,
        )  # fmt: skip
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self):
        try:
            self.live.run(self)
        except BaseException as e:
            self.error = e

    def until(self, condition, what=""):
        end = time.monotonic() + PATIENCE
        while not condition():
            if self.error is not None:
                raise self.error
            assert time.monotonic() < end, f"it never came to be: {what}; {self.said}"
            time.sleep(0.002)

    def heard(self, text, times=1):
        self.until(lambda: sum(text in line for line in self.said) >= times, text)

    def settle(self, frames=3):
        n = len(self.frames) + frames
        self.until(lambda: len(self.frames) > n, "frames")
        time.sleep(0.02)

    def turn(self, frames):
        """(3,) counts of the true turn of so many frames, which are played."""
        self.settle()
        before, first = self.counts, len(self.shown) - 1
        self.moves = frames
        self.until(lambda: self.moves == 0, "frames played")
        self.settle()
        R = Rotation.from_matrix(self.rotation[self.shown[first:]])
        x, y, z = (R[1:] * R[:-1].inv()).as_rotvec().sum(axis=0)
        return self.counts - before, 1800 * np.array([y, x, -z])

    def turned_unseen(self, place):
        """The ball is turned while nobody sees it, by more than 200 counts."""
        turn = Rotation.from_matrix(self.rotation[place] @ self.rotation[self.place].T).magnitude()
        assert 1800 * turn > 200
        self.place = place

    def join(self):
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()

    def check_laws(self):
        given = np.sum([m.motion.counts for _, m in self.frames], axis=0) if self.frames else np.zeros(3)
        status = self.live._reporters[0].status()
        left = np.sum([g.motion.counts for g in self.live._reporters[0]._given] or [(0, 0, 0)], axis=0)
        assert np.array_equal(self.counts + status.unsent + left, given)
        seen = {e.frame.stamp for e, _ in self.frames if e.poses[0].seen}
        assert all(m.stamp in seen for m in self.sent if any(m.counts))
        assert self.out == 0


class Sink:
    def __init__(self, world):
        self._world = world

    def send(self, motion):
        if self._world.broken:
            raise OutputError(self._world.broken)
        if self._world.closed:
            raise OutputClosed("sink")
        self._world.sent.append(replace(motion))

    def describe(self, motion):
        return ""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


@pytest.fixture(scope="module")
def film():
    warm_up()
    made = prepare_wand(WandOptions("hand", seed=3, fps=30.0, seconds=1.0, size=(640, 480)))
    return made, list(simulate_wand(made))


@pytest.fixture
def world(film, monkeypatch):
    monkeypatch.setattr("spheremouse.session.wand.service._TICK", 0.02)
    monkeypatch.setattr(capture_module, "BACK_OFF", (0.01, 0.02))
    monkeypatch.setattr(reporter_module, "BACK_OFF", (0.01, 0.02))
    monkeypatch.setattr(reporter_module, "LATE", PATIENCE)
    monkeypatch.setattr(realtime, "_give_back", lambda: None)
    monkeypatch.setattr(realtime, "_fold_up_code", lambda: 0)
    made, threads = World(*film), threading.active_count()
    yield made
    made.asked = True
    made.join()
    if made.error is not None:
        raise made.error
    made.check_laws()
    made.until(lambda: threading.active_count() <= threads, "threads end")


@pytest.fixture
def playing(world):
    world.start()
    world.heard("tracking: grzonka is followed")
    return world


def near(counts, true):
    """Play takes up two standard deviations of 0.6 degrees, and at either end the pose is off by three at most."""
    assert np.abs(counts - true).max() < 1800 * np.radians(8 * 0.6) < np.abs(true).max()


def test_counts_are_the_turn_of_the_ball(playing):
    counts, true = playing.turn(28)
    near(counts, true)
    playing.settle(20)
    assert playing.said == ["tracking: grzonka is followed"]
    assert playing.live.latency is not None


def test_a_camera_is_missing_goes_and_comes_back(world):
    world.missing = "no such device; plug it in"
    world.start()
    world.heard("no-camera: no such device; plug it in")
    world.missing = ""
    world.heard("tracking")
    near(*world.turn(28))
    world.missing = "unplugged"
    world.heard("no-camera: unplugged")
    time.sleep(0.1)
    before = world.counts
    world.turned_unseen(3)
    world.stamp += 2.0
    world.missing = ""
    world.heard("tracking", times=2)
    world.settle()
    assert np.abs(world.counts - before).max() < 30  # and nothing jumps
    near(*world.turn(20))
    assert len(world.said) == 4
    assert world.opened == 2


def test_a_lost_ball_moves_nothing_and_nothing_jumps_when_it_is_back(playing):
    playing.fault = "hidden"
    playing.heard("lost: ")
    time.sleep(0.1)
    before = playing.counts
    playing.turned_unseen(20)
    playing.fault = ""
    playing.heard("tracking", times=2)
    playing.settle()
    assert np.abs(playing.counts - before).max() < 30
    near(*playing.turn(9))


@pytest.mark.parametrize(
    ("fault", "reason"),
    [("size", "frames are 320x240"), ("grey", "the frames are grey"), ("damaged", "nothing but damaged frames")],
)
def test_frames_that_cannot_be_used_are_told_and_the_camera_is_opened_anew(playing, monkeypatch, fault, reason):
    monkeypatch.setattr("spheremouse.session.wand.service._USELESS", 0.1)
    monkeypatch.setattr("spheremouse.session.wand.service._DAMAGED", 0.05)
    playing.fault = fault
    playing.heard(f"no-camera: {reason}")
    playing.until(lambda: playing.opened > 1, "opened anew")
    playing.fault = ""
    playing.heard("tracking", times=2)
    near(*playing.turn(10))
    assert sum(reason in line for line in playing.said) == 1


def test_a_drivers_buffer_is_as_good_as_any_picture(playing):
    playing.fault = "buffer"
    near(*playing.turn(10))


def test_a_fault_of_our_own_is_told_and_the_ball_looked_for_anew(playing):
    playing.fault = "internal"
    playing.heard("ZeroDivisionError")
    playing.fault = ""
    playing.settle()
    near(*playing.turn(10))


def test_too_many_faults_of_our_own_end_the_run(world):
    world.fault = "internal"
    world.start()
    world.join()
    assert isinstance(world.error, ZeroDivisionError)
    world.error = None


def test_an_output_that_fails_is_opened_again_and_nothing_is_sent_in_one_jump(playing):
    playing.broken = "the board is gone"
    playing.heard("output: the board is gone")
    before = playing.counts
    _, true = playing.turn(10)
    playing.broken = ""
    playing.heard("output: works again")
    playing.settle()
    assert np.abs(playing.counts - before).max() < 20 < 0.2 * np.abs(true).max()
    near(*playing.turn(10))


def test_it_ends_when_the_reader_has_gone_and_after_as_many_frames_as_were_wanted(world, film):
    world.start()
    world.settle()
    world.closed = True
    world.join()
    other = World(*film)
    other.start(frames=4)
    other.join()
    assert len(other.frames) == 4
    assert other.error is None


def test_axes_are_written_beside_the_pointer(world, tmp_path):
    path = tmp_path / "axes.txt"
    axes = AxesOutput(str(path))
    assert isinstance(axes.open(), AxesText)
    world.start(axes)
    world.turn(10)
    world.asked = True
    world.join()
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    stamps = {repr(e.frame.stamp): m.motion.counts for e, m in world.frames}
    assert len(rows) > 10
    assert all(tuple(map(int, row[13:16])) == stamps[row[0]] for row in rows)
