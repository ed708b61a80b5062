"""Every detector obeys the same laws of motion, from a frame to messages, marks, recordings and figures."""

import json
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from beacons import Beacons, with_attitude
from invoking import invoke, succeed

from spheremouse.ball.build import DETECTORS, Choice, build
from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.phases.method import SO3
from spheremouse.commands import app
from spheremouse.files.dataset.write import TruthWriter, dataset_folder
from spheremouse.geometry.rotation import exp, log
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.ball.recorded import recorded_mask
from spheremouse.session.offline import track
from spheremouse.session.overlay.pen import masked
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.to_dataset import scene_description
from spheremouse.tracker import Status

OPTIONS = SimulationOptions(motion="thesis", seconds=2.0, noise=3.0, size=(320, 240), seed=3)
FILMS = {
    "discs": OPTIONS,
    "texture": replace(OPTIONS, pattern="speckle"),
    "both": replace(OPTIONS, pattern="marble", discs=12),
    "beacons": replace(OPTIONS, pattern="speckle"),  # that of the texture, with other first pixels
}
HIDDEN = range(45, 51)  # frames: a loss would count from the tenth


class Watched(NamedTuple):
    adapter: BallAdapter
    estimates: list
    discs: list  # in use, by the status
    marks: list
    log: str


@pytest.fixture(params=FILMS)
def name(request, monkeypatch):
    if request.param == "beacons":
        monkeypatch.setitem(DETECTORS, "texture", lambda: Choice(Beacons(), SO3))
    return request.param


@cache
def film(name):
    if name == "beacons":
        rig, frames, attitudes = film("texture")
        return rig, list(map(with_attitude, frames, attitudes)), attitudes
    simulation = prepare(FILMS[name])
    filmed = list(simulate(simulation))
    rig = replace(simulation.scene.rig(), pose=simulation.scene.pose)
    return rig, [f.frame for f in filmed], np.array([f.attitude for f in filmed])


def settings_of(name):
    return Configuration(detector="both" if name == "both" else "default")


@cache
def watched(name, hidden=range(0)):
    rig, frames, _ = film(name)
    seen = Watched(BallAdapter((rig,), settings_of(name), None, lambda _: None), [], [], [], "")
    support, lines = seen.adapter.tracker.detector.support_mask(rig, rig.pose, settings_of(name)) > 0, []
    for k, frame in enumerate(frames):
        image = frame.image.copy()
        image[support & (k in hidden)] = 3
        made = seen.adapter.follow(replace(frame, image=image))
        seen.estimates.append(made.samples[0].estimate)
        seen.discs.append(seen.adapter.tracker_status(True).discs)
        seen.marks.append(seen.adapter.annotations(made))
        lines.append(seen.adapter.take_messages().change)
    return seen._replace(log="; ".join(filter(None, lines)))


def errors(estimates, truth):
    """(n, 3) rad, of the attitudes of tracked frames, relative to the first of them; and their numbers, (n,)."""
    which = [k for k, e in enumerate(estimates) if e.status is Status.TRACKING]
    first = estimates[which[0]].rotation @ truth[which[0]].T
    return np.array([log(estimates[k].rotation @ truth[k].T @ first.T) for k in which]), np.array(which)


def test_the_attitude_is_right_to_its_standard_deviation(name):
    seen, truth = watched(name), film(name)[2]
    error, which = errors(seen.estimates, truth)
    assert len(which) > 40
    assert np.degrees(np.sqrt(np.mean(np.sum(error**2, axis=1)))) < 0.15
    covariance = np.array([seen.estimates[k].covariance[:3, :3] for k in which[1:]])  # the first is the reference
    assert 0.2 < np.mean(np.einsum("ni,nij,nj->n", error[1:], np.linalg.inv(covariance), error[1:])) < 9.0


@pytest.mark.parametrize("hidden", [range(0), HIDDEN], ids=["seen", "hidden for a while"])
def test_the_sum_of_increments_is_the_motion(name, hidden):
    seen, truth = watched(name, hidden), film(name)[2]
    confirmed = [k for k, e in enumerate(seen.estimates) if e.confirmed]
    turned = np.eye(3)
    for k in confirmed[1:]:
        turned = exp(seen.estimates[k].increment[:3]) @ turned
    first, last = confirmed[0], confirmed[-1]
    assert last == len(truth) - 1
    assert np.degrees(np.linalg.norm(log(turned @ (truth[last] @ truth[first].T).T))) < 0.3


def test_no_motion_leaves_while_it_sees_nothing(name):
    seen = watched(name, HIDDEN)
    blind = seen.estimates[HIDDEN.start : HIDDEN.stop]
    assert not any(e.confirmed for e in blind)
    assert not any(e.increment.any() for e in blind)
    assert f"no {seen.adapter.tracker.detector.words.part} in view" in seen.log


def test_status_marks_and_log_show_its_points_in_its_words(name):
    seen, words = watched(name), watched(name).adapter.tracker.detector.words
    assert max(seen.discs) > 2
    ball = ball_mask(seen.adapter.rig, seen.adapter.rig.pose)
    detected = seen.marks[-1]["detected"]
    assert sum(mark["used"] for mark in detected) == seen.discs[-1]
    assert all(ball[round(mark["y"]), round(mark["x"])] for mark in detected + seen.marks[-1]["predicted"])
    assert f" {words.parts} in view" in seen.log
    others = {choice().detector.words.parts for choice in DETECTORS.values()} - {words.parts}
    assert not any(other in seen.log for other in others)


def test_a_masked_recording_gives_the_same_track(name):
    rig, frames, _ = film(name)
    tracker, keep = build(rig, rig.pose, settings_of(name)), recorded_mask(rig, rig.pose, settings_of(name))
    black = (replace(frame, image=masked(frame.image, keep)) for frame in frames)
    for was, now in zip(watched(name).estimates, track(black, tracker), strict=True):
        np.testing.assert_array_equal(was.rotation, now.estimate.rotation)
        np.testing.assert_array_equal(was.covariance, now.estimate.covariance)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["beacons"], indirect=True)
def test_commands_need_no_line_for_a_new_detector(name, tmp_path):
    simulation = prepare(replace(FILMS[name], seconds=1.0, size=(640, 480)))
    folder = tmp_path / "film"
    with dataset_folder(folder, scene_description(simulation, "film")) as made:
        writer = TruthWriter(made, centres=False, discs=False)
        for f in simulate(simulation):
            writer.add(with_attitude(f.frame, f.attitude), f.attitude, f.rate, f.discs, f.centre)
    output = succeed(app, "evaluate", folder, "--pose", "known", "--json", tmp_path / "r.json")
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["attitude_rmse_deg"]["combined"] < 0.05
    output = succeed(app, "run", "--source", f"dataset:{folder}", "--output", "null", "--overlay", tmp_path / "a.png")
    assert "beacons in view" in " ".join(output.split())
    assert "is followed by its beacons" in " ".join(invoke(app, "tune", folder)[1].split())
