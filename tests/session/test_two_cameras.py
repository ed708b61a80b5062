"""Two cameras of one ball in a run: each takes part while it can, and log and status name the one that cannot."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false, reportPossiblyUnboundVariable=false

import time
from dataclasses import replace

import numpy as np
import pytest
from daemon_world import DT, Film, World
from raw_picture import RawPicture

from spheremouse.ball.rig import in_axes
from spheremouse.capture.newest import Arrival
from spheremouse.errors import ConfigurationError, ControlError, PoseError
from spheremouse.files.rig import load_rig, save_rig
from spheremouse.geometry.rotation import exp, log
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.run_config import CommandLineOverrides, check_kinds, read_run_config
from spheremouse.session.settings import Configuration
from spheremouse.session.worker import Worker
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Status

ASIDE = exp(np.array([0.0, 0.5 * np.pi, 0.0]))  # R_first_obj of the camera at the side
LENGTH = 16  # pictures
SETTINGS = Configuration()


@pytest.fixture(scope="module")
def films():
    front = Film.render()
    front = Film(front.colour[:LENGTH], front.grey[:LENGTH], front.attitude[:LENGTH], front.rig)
    return front, Film.of(default_scene(), aside=ASIDE, rendered=LENGTH)


@pytest.fixture(scope="module")
def rigs():
    """With the cameras' poses, in the axes of the first."""
    scene = default_scene()
    side, pose = in_axes(scene.rig(), scene.pose, ASIDE)
    return replace(scene.rig(), pose=scene.pose), replace(side, pose=pose)


class Play:
    def __init__(self, films, rigs):
        self.films, self.said, self.k = films, [], 0
        self.first = 0  # the camera whose frames come first, 1 ms before those of the other
        self.adapter = BallAdapter(rigs, SETTINGS, None, self.said.append)
        self.worker = Worker(self.adapter, self.said.append, 2)

    def show(self, camera, place, late=0.0, part=slice(None)):
        """The next frame, of a camera, of the ball at a place of its film."""
        self.k += camera == self.first
        film, stamp = self.films[camera], DT * self.k + 1e-3 * (camera != self.first) - late
        pictures = (np.ascontiguousarray(images[place][part]) for images in (film.colour, film.grey))
        raw = RawPicture(*pictures, stamp, self.k)
        return self.worker.work(Arrival(raw, time.monotonic(), camera))

    def error(self, made, place):
        """rad, of the attitude in the axes of the first camera."""
        R = self.films[0].attitude[place] @ self.films[0].attitude[0].T
        return float(np.linalg.norm(log(made.epoch.estimate.rotation @ R.T)))


def test_a_camera_that_dies_and_returns_leaves_the_ball_tracked(films, rigs):
    """Only the second sees it turn there, and its motion counts; then the first takes part again."""
    play = Play(films, rigs)
    for place in (*[0] * 4, *range(LENGTH)):
        for camera in (0, 1):
            made = play.show(camera, place)
    play.first = 1
    for place in (*range(LENGTH)[::-1], *[0] * 4):
        made = play.show(1, place)
        assert play.adapter.status is Status.TRACKING
    assert np.degrees(play.error(made, 0)) < 0.2
    for _ in range(3):
        made = play.show(0, 0)
    assert (made.frame.camera, made.epoch.estimate.confirmed) == (0, True)
    assert play.worker.frames_of == [LENGTH + 7, 2 * LENGTH + 8]


@pytest.mark.parametrize("first", [0, 1])
def test_the_ball_is_tracked_by_the_camera_that_is_there_first(films, rigs, first):
    """The pose of the other follows from its targets later."""
    known = list(rigs)
    known[1 - first] = replace(known[1 - first], pose=None)
    play = Play(films, known)
    play.first = first
    assert play.adapter.waiting == ""
    for _ in range(3):
        made = play.show(first, 0)
    assert play.adapter.status is Status.TRACKING
    assert play.adapter.trouble_of(1 - first) == "the ring targets are looked for"
    for _ in range(SETTINGS.pose.frames + 3):
        play.show(first, 0)
        made = play.show(1 - first, 0)
    assert made.frame.camera == 1 - first
    assert play.adapter.trouble_of(1 - first) == ""
    assert any(text.startswith(f"camera {2 - first}: camera pose: ") for text in play.said)
    place = [play.adapter.pose_of(camera).position_m for camera in (0, 1)]
    np.testing.assert_allclose(ASIDE @ place[0], place[1], atol=1e-3)


def test_frames_of_one_camera_that_cannot_be_used_are_no_trouble_of_the_run(films, rigs):
    play = Play(films, rigs)
    play.show(0, 0)
    play.show(1, 0, part=np.s_[:240, :320])
    assert play.worker.trouble == ""
    assert "is 320x240, the camera was calibrated at 640x480" in play.worker.refused[1]
    play.show(0, 0, part=np.s_[:240, :320])
    assert "is 320x240" in play.worker.trouble
    play.show(1, 0)
    assert (play.worker.trouble, list(play.worker.refused)) == ("", [0])


def test_a_frame_that_is_older_than_the_last_of_the_other_camera_is_left_out(films, rigs):
    play = Play(films, rigs)
    for _ in range(40):
        play.show(0, 0)
        assert play.show(1, 0, late=DT) is None
    assert play.adapter.trouble_of(1).startswith("its frames are 32 ms older than those of the other camera")
    assert play.show(1, 0) is not None
    assert play.adapter.trouble_of(1) == ""


def test_a_camera_whose_view_does_not_fit_that_of_the_other_is_named(films, rigs):
    """As if it had been pushed, and had no targets in view that show it."""
    play = Play(films, rigs)
    for place in (*[0] * 3, *range(LENGTH), *[LENGTH - 1] * 3):
        for camera in (0, 1):
            play.show(camera, place)
    assert play.adapter.trouble_of(1) == ""
    for _ in range(35):
        play.k += 2
        play.show(0, LENGTH - 1)
        play.show(1, LENGTH - 1, part=np.s_[::-1])  # upside down
    assert play.adapter.trouble_of(1).startswith("its discs are not where the other camera has them")
    assert (play.adapter.trouble_of(0), play.adapter.status) == ("", Status.TRACKING)
    for _ in range(35):
        play.k += 2
        play.show(0, LENGTH - 1)
        play.show(1, LENGTH - 1)
    assert play.adapter.trouble_of(1) == ""


def test_both_cameras_are_initialised_again(films, rigs):
    play, answers = Play(films, rigs), []
    for camera in (0, 1):
        play.show(camera, 0)
    play.adapter.reinitialise(lambda *answer: answers.append(answer), lambda: True)
    for _ in range(SETTINGS.pose.frames + 2):
        for camera in (0, 1):
            play.show(camera, 0)
    ((error, text),) = answers
    assert error is None
    assert text.startswith("camera 1: camera pose: ")
    assert "; camera 2: camera pose: " in text


def test_two_sources_have_two_rigs(tmp_path, rigs):
    for name, rig in zip(("front", "side"), rigs, strict=True):
        save_rig(tmp_path / f"{name}.yaml", rig)
    config = tmp_path / "config.yaml"

    def plan(sources, files, more=""):
        config.write_text(f"schema: 2\nsource: {sources}\nrig: {files}\noutput: 'null'\n{more}")
        return read_run_config(CommandLineOverrides(config))

    two = plan("[/dev/video0, /dev/video2]", "[front.yaml, side.yaml]")
    assert [each.source for each in two.cameras] == ["v4l2:/dev/video0", "v4l2:/dev/video2"]
    assert [each.rig_path.name for each in two.cameras] == ["front.yaml", "side.yaml"]
    np.testing.assert_allclose(two.cameras[1].rig.targets.normal, [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(load_rig(tmp_path / "side.yaml").targets.normal, two.cameras[1].rig.targets.normal)
    for sources, files, more, problem in (
        ("[/dev/video0, /dev/video2]", "front.yaml", "", "rig: 1 and not 2, the number of sources"),
        ("[/dev/video0, /dev/video0]", "[front.yaml, side.yaml]", "", "v4l2:/dev/video0 is given twice"),
        ("[/dev/video0, /dev/video2]", "[front.yaml, side.yaml]", "tracker: ekf2", "ekf2 takes one camera"),
        ("[/dev/video0, /dev/video2]", "[front.yaml, side.yaml]", "camera_file: c.yaml", "camera_file: belongs to one"),
    ):
        with pytest.raises(ConfigurationError, match=problem):
            plan(sources, files, more)
    one = plan("/dev/video0", "front.yaml")
    with pytest.raises(ConfigurationError, match="one camera more or less is another run"):
        check_kinds(two, one)
    with pytest.raises(ConfigurationError, match="no common clock"):
        check_kinds(plan("[/dev/video0, synthetic]", "[front.yaml, side.yaml]"))
    with pytest.raises(ConfigurationError, match="more than one camera"):
        BallAdapter(rigs, replace(SETTINGS, detector="texture"), None, print)
    with pytest.raises(PoseError, match="fewer than three targets"):
        BallAdapter(
            (rigs[0], replace(rigs[1], pose=None, targets=replace(rigs[1].targets, codes=()))), SETTINGS, None, print
        )


class Side(World):
    """A second camera of a world, with the same ball and clock. Its frames come 1 ms after those of the first."""

    def __init__(self, film, front):
        self.front = front
        super().__init__(film, front.folder)

    @property
    def stamp(self):
        return self.front.stamp

    @stamp.setter
    def stamp(self, value):
        self.front.stamp = value if self.front.missing else value - DT + 1e-3

    _way = property(lambda self: self.front._way, lambda self, value: setattr(self.front, "_way", value))
    place = property(lambda self: self.front.place, lambda self, value: setattr(self.front, "place", value))


@pytest.fixture
def world(films, rigs, tmp_path, quick_daemon):
    for name, rig in zip(("front", "side"), rigs, strict=True):
        save_rig(tmp_path / f"{name}.yaml", rig)
    front = World(films[0], tmp_path)
    text = front.config.read_text().replace("rig.yaml", "[front.yaml, side.yaml]")
    front.config.write_text(text.replace("film:played", "[film:front, film:side]"))
    front.second = Side(films[1], front)
    yield from quick_daemon(front)


def said(world, *texts):
    world.until(lambda: all(text in world.said for text in texts), texts)


def test_the_daemon_goes_on_with_one_camera_and_says_which_is_gone(world, monkeypatch):
    monkeypatch.setattr("spheremouse.session.captures._REPORTED_AFTER_S", 0.1)
    world.start()
    world.reach("tracking")
    world.turn()
    assert [(each["trouble"], each["restarts"]) for each in world.ask("status")["cameras"]] == [("", 0)] * 2
    discs = {}

    def both():
        shown = world.client.picture().annotations
        discs[shown["camera"]] = shown["predicted"]
        return len(discs) == 2

    world.until(both, "pictures of both")
    assert discs[0] != discs[1]
    world.missing = "unplugged"
    said(world, "camera 1: unplugged; the other goes on")
    world.second.moves = LENGTH - 1
    world.until(lambda: world.second.moves == 0, "frames of the second")
    assert world.ask("status")["cameras"][0]["trouble"] == "unplugged"
    world.missing = ""
    said(world, "camera 1 takes part again")
    world.second.missing = "its cable is cut"
    said(world, "camera 2: its cable is cut; the other goes on")
    world.missing = "unplugged"
    world.reach("no-camera")
    world.second.missing = ""
    world.reach("tracking")
    assert not any(text.startswith("lost") for text in world.said)


@pytest.mark.slow
def test_a_recording_is_of_the_first_camera_alone_also_while_it_is_gone(world):
    """What is kept of its picture would show the person in that of the other."""
    world.start()
    world.reach("tracking")
    world.ask("record", folder="a")
    world.until_recorded(3)
    world.missing = "unplugged"
    said(world, "camera 1: unplugged; the other goes on")
    before = world.ask("status")
    enough = before["cameras"][1]["frames"] + 40
    world.until(lambda: world.ask("status")["cameras"][1]["frames"] > enough, "frames of the second")
    assert world.ask("record", stop=True)["frames"] < before["recording"]["frames"] + 20


def test_settings_and_rigs_change_while_two_cameras_track(world, rigs):
    world.start()
    world.reach("tracking")
    world.turn()
    frames = [each["frames"] for each in world.ask("status")["cameras"]]
    assigned = ["discs.contrast=0.26", "so3.acceleration_sigma=2"]
    assert world.ask("set", assignments=assigned)["changed"] == ["tracker"]
    world.settle(10)
    cameras = world.ask("status")["cameras"]
    assert all(each["frames"] > before for each, before in zip(cameras, frames, strict=True))
    assert [each["trouble"] for each in cameras] == ["", ""]
    with pytest.raises(ControlError, match="more than one camera"):
        world.ask("set", assignments=["detector=texture"])
    save_rig(world.folder / "side.yaml", replace(rigs[1], exposure_s=0.001))
    world.until(lambda: any(text.endswith("0.1, rig") for text in world.said), "its new rig")
    world.reach("tracking")
    world.config.write_text(world.config.read_text().replace("[film:front, film:side]", "film:front"))
    with pytest.raises(ControlError, match="rig: 2 and not 1"):
        world.ask("reload")
