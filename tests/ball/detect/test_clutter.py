"""Pictures full of what has the targets' colours: the same targets as by trying every pair, for bounded work."""

import threading
import time
from dataclasses import replace
from itertools import permutations, product

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from raw_picture import RawPicture
from scipy import spatial

from spheremouse.ball.detect import rings
from spheremouse.ball.detect.rings import MAX_COPIES, TargetDetections, detect_targets
from spheremouse.ball.pose import Sighting, find_pose, predict_targets, resect
from spheremouse.capture.newest import Arrival
from spheremouse.errors import PoseError
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.tracker_adapter import here
from spheremouse.session.worker import Worker
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.ball.scene import default_scene
from tests.ball.detect.test_rings import INK, RADII, SETTINGS, blank, photo, target
from tests.session.test_worker import SETTINGS as TWO_VIEWS

PROPORTION = RADII / RADII[-1]
PATIENCE = 30.0  # s, for what takes a fraction of one


OCTAGON = np.array([[2, 0], [4, 0], [6, 2], [6, 4], [4, 6], [2, 6], [0, 4], [0, 2]], np.int32)  # any outline will do


def spots(rng, n, places):
    """Spots about a few places, (k, 2), so that many lie in one another; some share centre and radius."""
    at = places[rng.integers(0, len(places), n)] + rng.normal(0.0, 1.0, (n, 2)).round(1)
    radius = rng.uniform(1.5, 30.0, n).round(rng.integers(0, 3))
    return rings.Spots((OCTAGON,) * n, at, radius)


def every_pair(layers, s):
    """The outer circles of nests, best first, by the definition: the loops of the first version of this module."""
    inner, middle, outer = layers
    found = []
    for k, (centre, radius) in enumerate(zip(outer.centre, outer.radius, strict=True)):
        if radius < s.min_radius / PROPORTION[0] / s.ratio:
            continue
        inside = [
            [
                r
                for c, r in zip(layer.centre, layer.radius, strict=True)
                if np.linalg.norm(c - centre) < max(s.concentric * radius, 1.0)
                and 1.0 / s.ratio < r / (radius * share) < s.ratio
            ]
            for layer, share in zip((inner, middle), PROPORTION[:2], strict=True)
        ]
        fits = [np.ptp(np.log(np.array([a, b, radius]) / PROPORTION)) for a, b in product(*inside) if a < b]
        if fits:
            found.append((min(fits), k))
    best = []
    for _, k in sorted(found):
        if all(np.linalg.norm(outer.centre[k] - outer.centre[o]) > outer.radius[o] for o in best):
            best.append(k)
    return best


@pytest.mark.parametrize("ratio", [1.5, 4.0])
def test_nests_are_those_of_every_pair(ratio):
    """With a wide `ratio` a middle circle may be smaller than the inner one: such a pair is none."""
    settings, count = rings.RingSettings(ratio=ratio), 0
    for seed in range(15):
        rng = np.random.default_rng(seed)
        places = rng.uniform(0.0, 100.0, (8, 2))
        layers = {colour: spots(rng, int(rng.integers(0, 60)), places) for colour in "CMY"}
        candidates, more = rings.candidates_of(layers, PROPORTION, settings, (480, 640))
        most = 0
        for code in map("".join, permutations("CMY")):
            best = every_pair([layers[colour] for colour in code], settings)
            found = [c.middle for c in candidates if c.code == code]
            assert_array_equal(np.reshape(found, (-1, 2)), layers[code[2]].centre[best[:MAX_COPIES]])
            most, count = max(most, len(best)), count + len(best)
        assert more == (most > MAX_COPIES)
    assert count > 50


def dotted(rng, height, width, n):
    image = np.full((height, width, 3), 200, np.uint8)
    for _ in range(n):
        colour = INK["CMY"[rng.integers(0, 3)]].tolist()
        at = (int(rng.integers(0, width)), int(rng.integers(0, height)))
        cv2.circle(image, at, int(rng.integers(2, 5)), colour, -1, cv2.LINE_AA)
    return image


class Counted(spatial.KDTree):
    """A tree that counts what it gives for a look."""

    given = 0

    def query_ball_point(self, *args, **kwargs):
        near = super().query_ball_point(*args, **kwargs)
        Counted.given += sum(map(len, near))
        return near


def bullseye(height, width, step=4):
    image = np.full((height, width, 3), 200, np.uint8)
    for k, radius in enumerate(range(height // 2 - 2, 1, -step)):
        cv2.circle(image, (width // 2, height // 2), radius, INK["CMY"[k % 3]].tolist(), -1)
    return image


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dots", "cells", "within one another", "dots within rings"])
def test_the_pairs_that_are_looked_at_are_in_proportion_to_the_picture(kind, monkeypatch):
    """Not to the square of the spots: as many of one size as a place has room for, whatever else lies there."""
    monkeypatch.setattr(spatial, "KDTree", Counted)
    shares = []
    for height, width in ((240, 320), (480, 640), (960, 1280)):
        rng = np.random.default_rng(0)
        if kind == "cells":
            cells = np.array([INK[c] for c in "CMYW"], np.uint8)[rng.integers(0, 4, (height // 5, width // 5))]
            image = np.repeat(np.repeat(cells, 5, axis=0), 5, axis=1)
        elif kind == "within one another":
            image = bullseye(height, width)
        else:
            image = dotted(rng, height, width, height * width // 100)
            if kind == "dots within rings":
                y, x = np.mgrid[:height, :width]
                far = np.hypot(x - width // 2, y - height // 2) > height // 6
                image[far] = bullseye(height, width)[far]
        Counted.given = 0
        detect_targets(image, RADII, SETTINGS)
        shares.append(Counted.given / (height * width))
    assert max(shares) < 0.02
    assert shares[-1] < 1.5 * shares[0] + 1e-3


def test_targets_among_a_thousand_dots_are_found_and_measured():
    image = dotted(np.random.default_rng(1), 480, 640, 1000).astype(float)
    truth = {"CMY": (100.2, 90.4), "MYC": (500.7, 120.1), "YCM": (320.3, 400.8), "CYM": (560.5, 390.2)}
    for code, centre in truth.items():
        cv2.circle(image, (round(centre[0]), round(centre[1])), 24, (200.0, 200.0, 200.0), -1)
        target(image, code, centre, 16.0)
    seen = detect_targets(photo(image), RADII, SETTINGS)
    assert sorted(seen.codes) == sorted(truth)
    assert not seen.crowded
    for code, centre in zip(seen.codes, seen.centre, strict=True):
        assert np.abs(centre - truth[code]).max() < 0.03


def test_of_many_copies_the_best_are_measured_and_that_there_are_more_is_said():
    image = blank(260, 320)
    for k in range(MAX_COPIES + 5):
        target(image, "CMY", (30.0 + 60 * (k % 5), 30.0 + 60 * (k // 5)), 16.0)
    target(image, "YMC", (30.0, 230.0), 16.0)
    seen = detect_targets(photo(image), RADII, SETTINGS)
    assert seen.codes == ("CMY",) * MAX_COPIES + ("YMC",)
    assert seen.crowded
    few = detect_targets(photo(image[180:]), RADII, SETTINGS)
    assert few.codes == ("YMC",)
    assert not few.crowded


def test_what_is_measured_is_no_more_than_two_pictures():
    """Circles within circles are targets of all codes, each as high as the picture: the smaller ones are measured."""
    image = np.concatenate([bullseye(240, 240, 3)[8:-8, 8:-8]] * 4, axis=1)
    seen = detect_targets(image, RADII, SETTINGS)
    assert seen.crowded
    assert len(seen) > 1
    assert np.sum((2.0 * seen.radius) ** 2) <= 2 * image.shape[0] * image.shape[1]


def sightings(copies):
    """Targets of the default scene, and copies elsewhere in the picture."""
    scene, rng = default_scene(), np.random.default_rng(0)
    rig = scene.rig()
    places = predict_targets(scene.pose, rig)
    made = [
        Sighting(code, place + (rng.uniform(-150, 150, 2) if k else 0.0), 0.0025 * np.eye(2), 30)
        for code, place in zip(rig.targets.codes, places, strict=True)
        for k in range(copies)
    ]
    return rig, scene.pose, made


def test_copies_of_every_target_are_told_from_the_real_ones():
    rig, pose, made = sightings(3)
    found = resect(made, rig, np.zeros((480, 640), np.uint8))
    assert np.linalg.norm(found.pose.position - pose.position) < 1e-3


def test_more_copies_than_can_be_tried_are_refused():
    rig, _, made = sightings(10)
    with pytest.raises(PoseError, match=r"too many copies of .*targets .*10 of .*cover the copies"):
        resect(made, rig, np.zeros((480, 640), np.uint8))


@pytest.mark.parametrize("crowded", [False, True])
def test_a_crowded_picture_is_why_targets_are_missing(crowded):
    view = TargetDetections((), np.zeros((0, 2)), np.zeros(0), (), crowded)
    with pytest.raises(PoseError) as refused:
        find_pose([view], default_scene().rig(), np.zeros((480, 640), np.uint8))
    assert ("cover or remove colourful objects, or narrow the hues" in str(refused.value)) == crowded


class Elsewhere:
    """Another thread's work, done when the test says so."""

    def __init__(self):
        self.waiting = []

    def __call__(self, kind, work):
        self.waiting.append(work)

    def do(self):
        for work in self.waiting:
            thread = threading.Thread(target=work)
            thread.start()
            thread.join(PATIENCE)
        self.waiting.clear()


def film(seconds, **options):
    """Raw frames of a simulated ball, and of what scene the last is."""
    sim = prepare(SimulationOptions(motion="roll", turns=1.0, noise=3.0, seconds=seconds, **options))
    frames = []
    for k, made in enumerate(simulate(sim)):
        colour = made.frame.image
        grey = np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        frames.append(RawPicture(colour, grey, k / 30.0, k))
    return sim, frames


def adapter(rig, do):
    return BallAdapter((rig,), TWO_VIEWS, None, lambda _: None, do)


def work(adapter, raw):
    return Worker(adapter, lambda _: None).work(Arrival(raw, time.monotonic()))


def test_whole_pictures_are_looked_through_elsewhere_and_the_pose_is_that_of_here():
    sim, frames = film(0.1)
    at_once, elsewhere = adapter(sim.scene.rig(), here), Elsewhere()
    for _ in range(2):
        work(at_once, frames[0])
    worker = adapter(sim.scene.rig(), elsewhere)
    for _ in range(2):
        for _ in range(5):  # no frame waits, and only the first is looked through
            work(worker, frames[0])
        assert len(elsewhere.waiting) == 1
        assert worker.tracker is None
        elsewhere.do()
    work(worker, frames[0])
    assert worker.waiting == ""
    assert np.array_equal(worker.pose.position, at_once.pose.position)


@pytest.mark.slow
@pytest.mark.parametrize("stale", [False, True])
def test_a_camera_that_was_moved_is_sought_elsewhere_while_frames_go_on(stale):
    """And where it was moved on before that was done, what was found is of the past, and it is sought again."""
    sim, frames = film(1.2, bump=0.3, bump_by=(5.0, -40.0, 20.0, 3.0, -4.0, 1.0))
    elsewhere = Elsewhere()
    worker = adapter(replace(sim.scene.rig(), pose=sim.scene.pose), elsewhere)
    before = frames[:8]
    for raw in frames[:24]:
        assert work(worker, raw) is not None
    assert len(elsewhere.waiting) == 1
    assert worker.pose is worker.tracker.pose
    assert np.array_equal(worker.pose.position, sim.scene.pose.position)
    elsewhere.do()
    if stale:
        for k, raw in enumerate(before):
            work(worker, RawPicture(raw.frame(True).image, raw.frame(False).image, (24 + k) / 30.0, 24 + k))
        assert np.array_equal(worker.pose.position, sim.scene.pose.position)
    else:
        work(worker, frames[24])
        assert "camera was moved" in worker.take_messages().change
        assert np.linalg.norm(worker.pose.position - sim.changes[0].scene.pose.position) < 5e-3
