"""The service with a wand, in this process: a film behind a scripted camera, and faults at each edge.

Laws that hold in every test, checked at its end: nothing is sent but while the ball is seen; what frames gave is what
was sent or was counted as unsent; every raw frame was given back.
"""

import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from daemon_world import Film, World, left_over
from scipy.spatial.transform import Rotation

from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import open_wand
from spheremouse.files.wand import wand_text
from spheremouse.geometry.camera import project
from spheremouse.session.control.client import Client
from spheremouse.session.control.status import StatusReport
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.setup import Setup
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand

CONFIG = """\
schema: 2
tracker: wand
source: film:played
output: sink:quiet
realtime: "off"
pointer: {{horizon: 0}}
control: {{socket: {folder}/s}}
record: {{folder: {folder}/recordings, seconds: 20}}
wand: {{points: 1}}
"""


class WandWorld(World):
    colour_alone = True

    def __init__(self, film, shots, folder):
        (folder / "config.yaml").write_text(CONFIG.format(folder=folder))
        images = [s.frame.image for s in shots]
        super().__init__(Film(images, images, np.array([s.rotation[0] for s in shots]), None), folder)
        self.scene, self.setup = film.scene, Setup(camera=film.scene.camera)
        self.position = np.array([s.position[0] for s in shots])

    def image(self, place, colour, fault):
        assert colour
        image = self.film.colour[place]
        if fault == "hidden":
            return np.full_like(image, 90)
        return image[:, :, 0] if fault == "grey" else image

    def start(self, frames=None):
        self.config.write_text(CONFIG.format(folder=self.folder))
        super().start(watch=lambda made, report, _: self.frames.append((made.epoch, report)), frames=frames)

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
        super().turn(frames)
        R = Rotation.from_matrix(self.film.attitude[list(self.shown.values())[first:]])
        x, y, z = (R[1:] * R[:-1].inv()).as_rotvec().sum(axis=0)
        return self.counts - before, 1800 * np.array([y, x, -z])

    def turned_unseen(self, place):
        """The ball is turned while nobody sees it, by more than 200 counts."""
        turn = Rotation.from_matrix(self.film.attitude[place] @ self.film.attitude[self.place].T).magnitude()
        assert 1800 * turn > 200
        self.place = place

    def check_laws(self):
        given = np.sum([r.counts for _, r in self.frames], axis=0) if self.frames else np.zeros(3)
        assert np.array_equal(self.counts + self.daemon.parts.outputs.unsent + left_over(self.daemon), given)
        seen = {e.frame.stamp for e, _ in self.frames if e.poses[0].seen}
        assert all(m.stamp in seen for m in self.sent if any(m.counts))


@pytest.fixture(scope="module")
def film():
    made = prepare_wand(WandOptions("hand", seed=3, fps=30.0, seconds=1.0, size=(640, 480)))
    return made, list(simulate_wand(made))


@pytest.fixture
def world(film, tmp_path, quick_daemon):
    yield from quick_daemon(WandWorld(*film, tmp_path))


@pytest.fixture
def playing(world):
    world.start()
    world.heard("tracking: grzonka is followed")
    world.until(lambda: world.frames, "a frame that is shown")
    return world


def near(counts, true):
    """Play takes up two standard deviations of 0.6 degrees, and at either end the pose is off by three at most."""
    assert np.abs(counts - true).max() < 1800 * np.radians(8 * 0.6) < np.abs(true).max()


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


# ---- what is asked of it ----


def test_status_tells_where_the_ball_is(playing):
    status = playing.ask("status")
    StatusReport.model_validate({k: v for k, v in status.items() if k != "ok"})
    assert (status["state"], status["tracker"], status["reason"]) == ("tracking", "wand", "grzonka is followed")
    assert status["discs"] is None
    assert status["pose"] is None
    (ball,) = status["balls"]
    assert (ball["name"], ball["state"]) == ("grzonka", "tracking")
    assert np.linalg.norm(ball["position_m"]) == pytest.approx(np.linalg.norm(playing.position[playing.place]), rel=0.1)
    assert all(0.0 < s < 100.0 for s in ball["sigma_mm"])
    playing.until(lambda: set(playing.ask("status")["stages_ms"]) == {"wait", "decode", "track"})
    playing.fault = "hidden"
    playing.heard("lost: ")
    (ball,) = playing.ask("status")["balls"]
    assert (ball["state"], ball["position_m"]) == ("lost", None)
    assert playing.ask("status")["lost_count"] == 1


def test_live_pictures_and_the_scene_show_the_ball(playing):
    """The outline lies around the ball's true place, and the discs within it."""
    with Client(playing.socket) as client:
        picture, scene = client.picture(), client.ask("scene")
    outline = np.array(picture.annotations["outline"])
    true = project(playing.position[[playing.shown[picture.stamp]]], playing.scene.camera)[0][0]
    radius = np.linalg.norm(outline - outline.mean(axis=0), axis=1).mean()
    assert np.linalg.norm(outline.mean(axis=0) - true) < 0.15 * radius
    for disc in picture.annotations["detected"]:
        assert np.linalg.norm([disc["x"], disc["y"]] - true) < 1.1 * radius
    assert scene["balls"] == [carried.ball.name for carried in playing.scene.balls]
    assert scene["camera"]["position"] == [0.0, 0.0, 0.0]
    assert len(scene["discs"]) == len(playing.scene.balls[0].ball.discs)


def test_reinit_looks_for_the_balls_anew(playing):
    followed = playing.frames[-1][0].state.tracks[0]
    counts = playing.counts
    assert playing.ask("reinit")["message"] == "grzonka: searched again"
    playing.settle()
    assert playing.frames[-1][0].state.tracks[0].pose_velocity.velocity is not followed.pose_velocity.velocity
    assert np.abs(playing.counts - counts).max() < 30
    near(*playing.turn(20))


def test_other_parameters_are_used_and_the_ball_is_followed_on(playing):
    answer = playing.ask("set", assignments=["wand.particles=60", "wand.pointing.scale_x=2"])
    assert answer["changed"] == ["tracker", "motion"]
    playing.settle()
    assert len(playing.frames[-1][0].state.tracks[0].particles.position) == 60
    counts, true = playing.turn(20)
    near(counts / [2, 1, 1], true)
    assert not any("lost" in line for line in playing.said)
    assert playing.ask("reload")["changed"] == ["tracker", "motion"]


def test_other_balls_are_looked_for_and_a_changed_file_is_heard_of(playing, monkeypatch):
    monkeypatch.setattr("spheremouse.session.service._CHECK_INTERVAL_S", 0.05)
    ball = playing.scene.balls[0].ball
    (playing.folder / "mine.yaml").write_text(wand_text(replace(ball, name="mine")))
    playing.config.write_text(playing.config.read_text().replace("points: 1", "balls: [mine.yaml]"))
    playing.heard("configuration applied: wand.balls [] → ['mine.yaml'], balls")
    playing.heard("tracking: mine is followed")
    (playing.folder / "mine.yaml").write_text(wand_text(replace(ball, name="hers")))
    playing.heard("tracking: hers is followed")
    near(*playing.turn(20))


def test_a_recording_is_tracked_again_to_the_last_bit(world, tmp_path):
    """Poses, covariances and counts, of a recording that was begun before the ball was in view."""
    world.start()
    world.heard("tracking: grzonka is followed")
    world.fault = "hidden"
    world.heard("lost: ")
    world.ask("record", folder="made", everything=True)
    world.settle()
    world.fault = ""
    world.heard("tracking: grzonka is followed", times=2)
    world.turn(20)
    world.ask("record", stop=True)
    folder = world.folder / "recordings" / "made"
    recording = open_wand(folder)
    live = {e.frame.stamp: (e, r) for e, r in world.frames}
    setup = Setup(camera=recording.camera)
    given = (f"source=dataset:{folder}", "output=null")
    plan = read_run_config(CommandLineOverrides(folder / "config.yaml", given))
    adapter = setup.adapter(plan, lambda _: None, lambda _, work: work())
    assert adapter.subject.parts == ""  # whole pictures alone, which have to be asked for
    seen = 0
    for frame in read_frames(recording):
        epoch, report = live[frame.stamp]
        assert np.array_equal(frame.image, epoch.frame.image)
        assert frame.sequence == epoch.frame.sequence
        made = adapter.follow(frame)
        assert adapter.mapping.counts(made.samples[0].estimate)[0] == report.counts
        (a,), (b,) = made.epoch.poses, epoch.poses
        assert a.seen == b.seen
        if a.seen:
            seen += 1
            assert np.array_equal(a.position, b.position)
            assert np.array_equal(a.rotation, b.rotation)
            assert np.array_equal(a.covariance, b.covariance)
    assert seen > 20


def test_a_snapshot_shows_the_balls_and_nothing_else(playing):
    """Neither the person who holds them, nor what hides them."""
    image = cv2.imread(playing.ask("snapshot", file="seen.png")["file"])
    assert image.shape == (960, 1280, 3)
    assert np.mean(image[:-80].any(axis=2)) < 0.5
    assert image[:-80].any()
    playing.ask("set", assignments=["wand.lost_after=30"])
    playing.settle()
    playing.fault = "hidden"
    playing.until(lambda: playing.ask("status")["balls"][0]["state"] == "hidden", "hidden")
    image = cv2.imread(playing.ask("snapshot", file="hidden.png")["file"])
    assert np.mean(image[:-80].any(axis=2)) < 0.05  # outlines alone
