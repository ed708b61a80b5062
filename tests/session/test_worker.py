"""The worker: what becomes of each raw frame, without a thread; the film is that of tests/daemon_world.py."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from daemon_world import DT, Film
from raw_picture import RawPicture

from spheremouse.capture.newest import Arrival
from spheremouse.errors import DamagedFrameError
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.rotation import exp
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.settings import Configuration
from spheremouse.session.tracker_adapter import POSE, here
from spheremouse.session.worker import Worker
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Status

SETTINGS = replace(Configuration(), pose=replace(Configuration().pose, frames=2))


class Play:
    def __init__(self, film, do=here):
        self.said, self.k, self.film = [], 0, film
        self.adapter = BallAdapter((film.rig,), SETTINGS, None, self.said.append, do)
        self.worker = Worker(self.adapter, self.said.append)

    def __call__(self, place=0, error=None):
        self.k += 1
        raw = RawPicture(self.film.colour[place], self.film.grey[place], self.k * DT, self.k, error)
        made = self.worker.work(Arrival(raw, time.monotonic() - 0.5))
        self.asked = raw.asked
        return made


def test_targets_first_in_colour_then_the_ball_in_grey(film):
    play = Play(film)
    assert play.adapter.tracker is None
    assert play() is None
    assert play.asked == [True]
    assert play() is None  # the second view
    assert play.adapter.waiting == ""
    assert play.said[0].startswith("camera pose: x ")
    made = [play(k) for k in range(24)]
    assert all(m is not None for m in made)
    assert play.asked == [False]
    assert made[-1].samples[0].estimate.confirmed
    assert made[-1].epoch.state.status is Status.TRACKING
    assert (play.worker.frames, play.worker.seen) == (24, 26)
    assert set(play.worker.times) == {"wait", "decode", "detect", "filter"}
    assert 0.5 <= play.worker.times["wait"].recent_quantile(0.5) < 1.0
    rates = np.array([m.samples[0].rate for m in made])
    assert np.abs(rates[:2]).max() < np.abs(rates[8:16]).max()


def test_the_scene_is_the_device_and_the_map_in_its_axes(film):
    """Seen from the camera, each target and the ball are where the rig has them."""
    play, rig = Play(film), film.rig
    for k in (0, 0, *range(24)):
        play(k)
    scene, status = play.adapter.scene(), play.adapter.tracker_status(True)
    camera, R = scene["camera"], np.reshape(scene["camera"]["rotation"], (3, 3))
    assert (camera["size"], scene["radius"], scene["balls"]) == ([640, 480], rig.ball.radius, None)
    assert {t["code"] for t in scene["targets"]} == set(rig.targets.codes)
    for target in scene["targets"]:
        seen = R @ (np.array(target["position"]) - camera["position"])
        expected = project(play.adapter.pose.to_cam(np.array([target["position"]])), rig.camera)[0][0]
        assert np.allclose(camera["focal"] * seen[:2] / seen[2] + camera["centre"], expected, atol=1.0)
    assert np.allclose(np.linalg.norm(scene["discs"], axis=1), 1.0)
    assert len(scene["discs"]) == status.discs_known > 5
    assert np.allclose(np.sqrt(np.diag(np.reshape(camera["covariance"], (3, 3)))) * 1e3, status.pose.sigma_mm)


def test_frames_of_read_only_memory_are_tracked_the_same(film):
    """A driver's buffer may not be written."""
    locked = replace(film, colour=[image.view() for image in film.colour], grey=[image.view() for image in film.grey])
    for image in locked.colour + locked.grey:
        image.flags.writeable = False
    counts = []
    for each in (film, locked):
        play = Play(each)
        made = [play(k) for k in (0, 0, *range(24))]
        estimates = [m.samples[0].estimate for m in made if m is not None]
        counts.append([play.adapter.mapping.counts(e)[0] for e in estimates])
    assert counts[0] == counts[1]
    assert np.abs(np.sum(counts[0], axis=0)).max() > 50


def test_a_frame_that_is_none_changes_nothing(film):
    play = Play(film)
    for _ in range(5):
        play()
    state = play.adapter.state
    assert play(error=DamagedFrameError("half")) is None
    assert play.worker.damaged == 1
    assert play.worker.trouble == ""  # one is nothing
    play.worker.last_good_at -= 10.0
    play(error=DamagedFrameError("half"))
    assert play.worker.trouble.startswith("nothing but damaged frames for 10 s (half)")
    assert play.adapter.state is state
    assert play() is not None
    assert play.worker.trouble == ""
    small = RawPicture(film.colour[0][:10], film.grey[0][:10], 9 * DT, 9)
    assert play.worker.work(Arrival(small, 0.0)) is None
    assert "calibrated at 640x480" in play.worker.trouble


def test_a_fault_of_ours_begins_anew_and_five_in_a_minute_are_too_many(film, monkeypatch):
    play = Play(film)
    for _ in range(5):
        play()
    for k in range(4):
        assert play(error=ZeroDivisionError("as if")) is None
        assert play.adapter.state is None
        assert len([s for s in play.said if "Traceback" in s]) == k + 1
    assert play() is not None  # goes on with the pose it has
    now = time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: now() + 100.0)
    assert play(error=ZeroDivisionError("as if")) is None  # the others are long ago
    for _ in range(3):
        assert play(error=ZeroDivisionError("as if")) is None
    with pytest.raises(ZeroDivisionError):
        play(error=ZeroDivisionError("as if"))


def test_views_from_before_an_interruption_are_not_mixed_with_those_after(film):
    play = Play(film)
    play()
    play.adapter.interrupted("unplugged")
    assert play() is None
    assert play.adapter.tracker is None  # one view of the new two
    play()
    assert play.adapter.tracker is not None


def test_grey_frames_cannot_show_the_targets(film):
    play = Play(film)
    for k in range(2):
        play.worker.work(Arrival(RawPicture(film.grey[0], film.grey[0], k * DT, k), 0.0))
    assert "grey" in play.adapter.waiting


def in_a_thread(kind, work):
    """The pose's work in a thread of its own, as by a crew."""
    if kind == POSE:
        threading.Thread(target=here, args=(kind, work)).start()
    else:
        here(kind, work)


def test_a_pose_asked_for_is_answered_once_whatever_happens(film):
    play, answers = Play(film, do=in_a_thread), []
    play.adapter.reinitialise(lambda *a: answers.append(a), lambda: True)
    assert answers == [(None, "the pose is being looked for: the ring targets are looked for")]
    for _ in range(4):
        play()
    play.adapter.reinitialise(lambda *a: answers.append(a), lambda: True)
    play.adapter.reinitialise(lambda *a: answers.append(("second", *a)), lambda: True)
    assert answers[1][:2] == ("second", "the camera's pose is being estimated already; wait for its end")
    play()
    assert play.asked == [True]
    play.adapter.interrupted("unplugged")
    assert answers[2:] == [("unplugged; the pose before stays", "")]
    play()
    play.adapter.reinitialise(lambda *a: answers.append(a), lambda: True)
    pose = play.adapter.pose
    end = time.monotonic() + 20.0
    while len(answers) < 4:
        assert time.monotonic() < end
        play()
    assert answers[3][0] is None
    assert answers[3][1].startswith("camera pose: x ")
    play()
    assert play.adapter.pose is not pose


@pytest.fixture(scope="module")
def bumped():
    """The camera 14 mm off, and turned by 0.6°."""
    scene = default_scene()
    turn = exp(np.radians(0.6) * np.array([0.6, 0.8, 0.0]))
    moved = Pose(turn @ scene.pose.rotation, scene.pose.position + np.array([0.010, -0.006, 0.008]))
    return Film.of(replace(scene, pose=moved), 4), moved


def play_until(play, condition, place=0):
    for _ in range(90):
        play(place)
        if condition():
            return
    raise AssertionError("not within 3 s")


def is_at(play, pose):
    tracker = play.adapter.tracker
    return tracker is not None and np.abs(tracker.pose.position - pose.position).max() < 2e-3


def test_after_an_internal_error_a_bumped_camera_keeps_its_new_pose(film, bumped):
    play, (moved_film, moved) = Play(film), bumped
    for k in range(24):
        play(k)
    play.film = moved_film
    play_until(play, lambda: is_at(play, moved))
    play(error=ZeroDivisionError("as if we had made a mistake"))
    assert play.adapter.status is Status.SEARCHING
    play()
    assert is_at(play, moved)


def test_a_pose_of_frames_before_the_camera_was_bumped_is_refused(film, bumped):
    held, answers = [], []
    play, (moved_film, moved) = Play(film, do=lambda kind, work: held.append(work) if kind == POSE else work()), bumped
    for k in range(24):
        play(k)
    play.adapter.reinitialise(lambda *a: answers.append(a), lambda: True)
    while not answers:
        play(place=0)
        if len(held) == 2:
            play.film = moved_film  # before the second view was searched
            play_until(play, lambda: is_at(play, moved))
        for work in held[-1:] if held else ():
            work()
            held[-1:] = [lambda: None]
    assert "the targets are not where the frames before showed them" in answers[0][0]
    assert is_at(play, moved)
