"""The service with a wand, in this process: a film behind a scripted camera, and faults at each edge.

Laws that hold in every test, checked at its end: nothing is sent but while the ball is seen; what frames gave is what
was sent or was counted as unsent; every raw frame was given back.
"""

import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spheremouse.capture import fetch as capture_module
from spheremouse.errors import ControlError, DamagedFrameError, OutputError, SourceError
from spheremouse.files.dataset.wand import open_wand, read_wand_frames
from spheremouse.files.wand import wand_text
from spheremouse.output import OutputClosed
from spheremouse.output import reporter as reporter_module
from spheremouse.session.control.client import Client
from spheremouse.session.control.status import StatusReport
from spheremouse.session.plan import Request, read_plan
from spheremouse.session.process import realtime
from spheremouse.session.service import Daemon
from spheremouse.session.wand.setup import WandSetup
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.tracker import Frame
from spheremouse.wand.events import SecondBall
from spheremouse.wand.warm import warm_up

DT = 1.0 / 30.0
CONFIG = """\
schema: 2
tracker: wand
source: film:played
output: sink:quiet
realtime: "off"
pointer: {{horizon: 0}}
control: {{socket: {folder}/s}}
record: {{folder: {folder}/recordings, seconds: 20}}
wand: {{axes: {axes}}}
"""
PATIENCE = 30.0  # s


class RawFrame:
    def __init__(self, world, stamp, sequence, place):
        self.stamp, self.sequence, self.place, self._world, self._out = stamp, sequence, place, world, True

    def frame(self, colour):
        assert self._out, "a raw frame that was given back is looked at"
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

    def __init__(self, film, shots, folder):
        self.folder, self.config = folder, folder / "config.yaml"
        self.film, self.images = film, [s.frame.image for s in shots]
        self.rotation = np.array([s.rotation[0] for s in shots])
        self.position = np.array([s.position[0] for s in shots])
        self.missing = self.fault = self.broken = ""
        self.place, self._way, self.moves, self.sequence, self.out, self.opened, self.outputs = 0, 1, 0, 0, 0, 0, 0
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
        return RawFrame(self, self.stamp, self.sequence, self.place)

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
        self.outputs += 1
        if self.broken:
            raise OutputError(self.broken)
        return Sink(self)

    @property
    def counts(self):
        return np.sum([m.counts for m in self.sent], axis=0) if self.sent else np.zeros(3)

    # the run

    def start(self, axes=None, frames=None):
        self.config.write_text(CONFIG.format(axes="null" if axes is None else axes, folder=self.folder))
        self.request = Request(self.config)
        plan = read_plan(self.request)
        self.daemon = Daemon(
            self.request, plan, WandSetup(camera=self.film.scene.camera), self.open_camera, lambda _: self.open_camera,
            say=self.said.append, show=lambda made, _: self.frames.append((made.epoch, made.report)), frames=frames,
        )  # fmt: skip
        self.client = Client(self.folder / "s")
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self):
        try:
            self.daemon.run(self)
        except BaseException as e:
            self.error = e

    def until(self, condition, what=""):
        end = time.monotonic() + PATIENCE
        while not condition():
            if self.error is not None:
                raise self.error
            assert time.monotonic() < end, f"it never came to be: {what}; {self.said}"
            time.sleep(0.002)

    def news(self):
        """What was said since it began to track."""
        return self.said[next(k for k, line in enumerate(self.said) if line.startswith("tracking")) :]

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

    def film_position(self):
        """(3,) m, of the picture that is shown."""
        return self.position[self.place]

    def turned_unseen(self, place):
        """The ball is turned while nobody sees it, by more than 200 counts."""
        turn = Rotation.from_matrix(self.rotation[place] @ self.rotation[self.place].T).magnitude()
        assert 1800 * turn > 200
        self.place = place

    def join(self):
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()

    def check_laws(self):
        given = np.sum([r.counts for _, r in self.frames], axis=0) if self.frames else np.zeros(3)
        status = self.daemon._outputs.pointer.status()
        left = np.array(self.daemon._outputs.pointer.queued)
        assert np.array_equal(self.counts + status.unsent + left, given)
        seen = {e.frame.stamp for e, _ in self.frames if e.poses[0].seen}
        assert all(m.estimate.stamp in seen for m in self.sent if any(m.counts))
        assert self.out == 0


class Sink:
    def __init__(self, world):
        self._world = world

    def send(self, report):
        if self._world.broken:
            raise OutputError(self._world.broken)
        if self._world.closed:
            raise OutputClosed("sink")
        self._world.sent.append(report)

    def describe(self, report):
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
def world(film, tmp_path, monkeypatch):
    monkeypatch.setattr("spheremouse.session.service._TICK", 0.02)
    monkeypatch.setattr(capture_module, "BACK_OFF", (0.01, 0.02))
    monkeypatch.setattr(reporter_module, "RETRY_DELAYS", (0.01, 0.02))
    monkeypatch.setattr(reporter_module, "MAX_QUEUE_TIME", PATIENCE)
    monkeypatch.setattr(realtime, "_give_back", lambda: None)
    monkeypatch.setattr(realtime, "_fold_up_code", lambda: 0)
    made, threads = World(*film, tmp_path), threading.active_count()
    monkeypatch.setattr("spheremouse.session.wand.follower.open_output", lambda _: made.open_output())
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
    world.until(lambda: world.frames, "a frame that is shown")
    return world


def near(counts, true):
    """Play takes up two standard deviations of 0.6 degrees, and at either end the pose is off by three at most."""
    assert np.abs(counts - true).max() < 1800 * np.radians(8 * 0.6) < np.abs(true).max()


def test_counts_are_the_turn_of_the_ball(playing):
    counts, true = playing.turn(28)
    near(counts, true)
    playing.settle(20)
    assert playing.news() == ["tracking: grzonka is followed"]
    assert playing.daemon.latency is not None


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
    [
        ("size", "is 320x240, the camera was calibrated at"),
        ("grey", "the frames are grey"),
        ("damaged", "nothing but damaged frames"),
    ],
)
def test_frames_that_cannot_be_used_are_told_and_the_camera_is_opened_anew(playing, monkeypatch, fault, reason):
    monkeypatch.setattr("spheremouse.session.service._USELESS", 0.1)
    monkeypatch.setattr("spheremouse.session.worker._DAMAGED", 0.05)
    playing.fault = fault
    playing.heard("no-camera: ")
    playing.heard(reason)
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


def test_it_ends_when_the_reader_has_gone_and_after_as_many_frames_as_were_wanted(world, film, tmp_path_factory):
    world.start()
    world.settle()
    world.closed = True
    world.join()
    world.closed = False
    other = World(*film, tmp_path_factory.mktemp("other"))
    other.start(frames=4)
    other.join()
    assert len(other.frames) == 4
    assert other.error is None


def test_axes_are_written_beside_the_pointer(world, tmp_path):
    path = tmp_path / "axes.txt"
    world.start(path)
    world.turn(10)
    world.asked = True
    world.join()
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    stamps = {repr(e.frame.stamp): r.counts for e, r in world.frames}
    assert len(rows) > 10
    assert all(tuple(map(int, row[13:16])) == stamps[row[0]] for row in rows)


# ---- what is asked of it ----


def test_status_tells_where_the_ball_is(playing):
    status = playing.client.ask("status")
    StatusReport.model_validate({k: v for k, v in status.items() if k != "ok"})
    assert (status["state"], status["tracker"], status["reason"]) == ("tracking", "wand", "grzonka is followed")
    assert status["discs"] is None
    assert status["pose"] is None
    (ball,) = status["balls"]
    assert (ball["name"], ball["state"]) == ("grzonka", "tracking")
    assert np.linalg.norm(ball["position_m"]) == pytest.approx(np.linalg.norm(playing.film_position()), rel=0.1)
    assert all(0.0 < s < 100.0 for s in ball["sigma_mm"])
    playing.until(lambda: set(playing.client.ask("status")["stages_ms"]) == {"wait", "decode", "track"})
    playing.fault = "hidden"
    playing.heard("lost: ")
    (ball,) = playing.client.ask("status")["balls"]
    assert (ball["state"], ball["position_m"]) == ("lost", None)
    assert playing.client.ask("status")["lost_count"] == 1


def test_nothing_moves_while_it_is_paused_and_nothing_jumps_after(playing):
    playing.client.ask("pause")
    before = playing.counts
    _, true = playing.turn(20)
    assert np.array_equal(playing.counts, before)
    playing.client.ask("resume")
    playing.settle()
    assert np.abs(playing.counts - before).max() < 20 < 0.2 * np.abs(true).max()
    near(*playing.turn(8))


def test_reinit_looks_for_the_balls_anew(playing):
    followed = playing.frames[-1][0].state.tracks[0]
    counts = playing.counts
    assert playing.client.ask("reinit")["message"] == "grzonka: looked for anew"
    playing.settle()
    assert playing.frames[-1][0].state.tracks[0].pose_velocity.velocity is not followed.pose_velocity.velocity
    assert np.abs(playing.counts - counts).max() < 30
    near(*playing.turn(20))


def test_other_parameters_are_used_and_the_ball_is_followed_on(playing):
    answer = playing.client.ask("set", assignments=["wand.particles=60", "wand.pointing.scale_x=2"])
    assert answer["changed"] == ["tracker", "motion"]
    playing.settle()
    assert len(playing.frames[-1][0].state.tracks[0].particles.position) == 60
    counts, true = playing.turn(20)
    near(counts / [2, 1, 1], true)
    assert not any("lost" in line for line in playing.said)
    assert playing.client.ask("reload")["changed"] == ["tracker", "motion"]


@pytest.mark.parametrize(
    ("assignment", "why"),
    [
        ("wand.points=2", "wand.points: is 2, but there is one ball; balls are counted from 1"),
        ("wand.balls=[none.yaml]", "none.yaml: no such file; check the path"),
        ("tracker=so3", "stop this run and start again"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_changes(playing, assignment, why):
    with pytest.raises(ControlError, match=why.replace("(", r"\(")):
        playing.client.ask("set", assignments=[assignment])
    near(*playing.turn(20))
    assert playing.client.ask("status")["state"] == "tracking"


def test_other_balls_are_looked_for_and_a_changed_file_is_heard_of(playing, monkeypatch):
    monkeypatch.setattr("spheremouse.session.service._EVERY", 0.05)
    ball = playing.film.scene.balls[0].ball
    (playing.folder / "mine.yaml").write_text(wand_text(replace(ball, name="mine")))
    playing.config.write_text(playing.config.read_text().replace("axes: null", "balls: [mine.yaml]"))
    playing.heard("configuration applied: wand.balls [] → ['mine.yaml'], balls")
    playing.heard("tracking: mine is followed")
    (playing.folder / "mine.yaml").write_text(wand_text(replace(ball, name="hers")))
    playing.heard("tracking: hers is followed")
    near(*playing.turn(20))


def rows(path):
    return [line.split() for line in path.read_text().splitlines() if not line.startswith("#")] if path.exists() else []


def test_axes_begin_when_they_are_asked_for_and_the_pointer_stays(playing):
    path, opened = playing.folder / "axes.txt", playing.outputs
    assert playing.client.ask("set", assignments=[f"wand.axes={path}"])["changed"] == ["axes"]
    playing.until(lambda: len(rows(path)) > 10, "axes")
    assert playing.outputs == opened
    near(*playing.turn(20))


def test_axes_go_on_with_other_balls(playing):
    path, ball = playing.folder / "axes.txt", playing.film.scene.balls[0].ball
    playing.client.ask("set", assignments=[f"wand.axes={path}"])
    playing.until(lambda: len(rows(path)) > 3, "axes")
    (playing.folder / "mine.yaml").write_text(wand_text(replace(ball, name="mine")))
    playing.client.ask("set", assignments=["wand.balls=[mine.yaml]"])
    playing.heard("tracking: mine is followed")
    n = len(rows(path))
    playing.until(lambda: len(rows(path)) > n + 5, "axes")


def test_without_another_thread_no_output_is_changed(playing, monkeypatch):
    path, other = playing.folder / "axes.txt", playing.folder / "other.txt"
    playing.client.ask("set", assignments=[f"wand.axes={path}"])
    playing.until(lambda: len(rows(path)) > 3, "axes")

    def none(_):
        raise ControlError("no thread to be had")

    monkeypatch.setattr("spheremouse.session.outputs.begin", none)
    with pytest.raises(ControlError, match="no thread"):
        playing.client.ask("set", assignments=[f"wand.axes={other}"])
    n = len(rows(path))
    playing.until(lambda: len(rows(path)) > n + 5, "axes")
    near(*playing.turn(20))


def test_what_another_tracker_reads_is_refused(playing):
    with pytest.raises(ControlError, match=r"motion\.scale_x: the tracker in use, wand, does not read it"):
        playing.client.ask("set", assignments=["motion.scale_x=3"])


def test_a_complaint_is_said_with_the_frame_that_finds_the_ball(world, monkeypatch):
    from spheremouse.session.wand import follower

    def complaining(state, frame, tracker):
        found = step(state, frame, tracker)
        poses = tuple(replace(p, event=SecondBall("grzonka")) if p.seen else p for p in found.state.poses)
        return found._replace(state=replace(found.state, poses=poses))

    step = follower.step
    monkeypatch.setattr(follower, "step", complaining)
    world.start()
    world.heard("tracking: grzonka is followed")
    world.heard("a second ball like grzonka")


def test_a_recording_shows_who_holds_the_ball_and_so_has_to_be_asked_for_in_whole(playing):
    with pytest.raises(ControlError, match=r"whoever holds the ball is in the picture.*--everything"):
        playing.client.ask("record")
    assert not (playing.folder / "recordings").exists() or not list((playing.folder / "recordings").iterdir())


def test_a_recording_is_tracked_again_to_the_last_bit(world, tmp_path):
    """Poses, covariances and counts, of a recording that was begun before the ball was in view."""
    world.start()
    world.heard("tracking: grzonka is followed")
    world.fault = "hidden"
    world.heard("lost: ")
    world.client.ask("record", folder="made", everything=True)
    world.settle()
    world.fault = ""
    world.heard("tracking: grzonka is followed", times=2)
    world.turn(20)
    world.client.ask("record", stop=True)
    folder = world.folder / "recordings" / "made"
    recording = open_wand(folder)
    live = {e.frame.stamp: (e, r) for e, r in world.frames}
    setup = WandSetup(camera=recording.camera)
    plan = read_plan(Request(folder / "config.yaml", source=f"dataset:{folder}", output="null"))
    follower = setup.follower(plan, lambda _: None, lambda _, work: work())
    seen = 0
    for frame in read_wand_frames(recording):
        epoch, report = live[frame.stamp]
        assert np.array_equal(frame.image, epoch.frame.image)
        assert frame.sequence == epoch.frame.sequence
        made = follower.follow(frame)
        assert made.report.counts == report.counts
        (a,), (b,) = made.epoch.poses, epoch.poses
        assert a.seen == b.seen
        if a.seen:
            seen += 1
            assert np.array_equal(a.position, b.position)
            assert np.array_equal(a.rotation, b.rotation)
            assert np.array_equal(a.covariance, b.covariance)
    assert seen > 20


def test_nothing_is_shown_of_what_hides_a_ball(playing):
    playing.client.ask("set", assignments=["wand.lost_after=30"])
    playing.settle()
    playing.fault = "hidden"
    playing.until(lambda: playing.client.ask("status")["balls"][0]["state"] == "hidden", "hidden")
    image = cv2.imread(playing.client.ask("snapshot", file="hidden.png")["file"])
    assert np.mean(image[:-80].any(axis=2)) < 0.05  # outlines alone


def test_a_ball_is_not_said_to_be_there_while_no_frames_come(playing):
    playing.missing = "unplugged"
    playing.heard("no-camera: unplugged")
    (ball,) = playing.client.ask("status")["balls"]
    assert (ball["state"], ball["position_m"]) == ("searching", None)


def test_a_snapshot_shows_the_balls_and_nobody_who_holds_them(playing):
    path = Path(playing.client.ask("snapshot", file="seen.png")["file"])
    image = cv2.imread(str(path))
    assert image.shape == (960, 1280, 3)
    assert np.mean(image[:-80].any(axis=2)) < 0.5
    assert image[:-80].any()
