"""Advice: what is promised comes true when it is done, and what is odd is said.

The promises are checked against calibrations that really have the photos and distances that were advised.
"""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from spheremouse.ball.device import Axes, Device, Distance
from spheremouse.calibrate.device.adjust import DiscViews, adjust_device
from spheremouse.calibrate.device.advice import advise, photo_px, photo_scatter
from spheremouse.calibrate.device.bundle import Block, ImagePoints, Problem, predicted
from spheremouse.calibrate.device.plans import ENOUGH, MIN_GAIN
from spheremouse.calibrate.device.start import TargetViews
from spheremouse.calibrate.device.what_if import network, sigmas, visible_targets, with_distances, with_photos
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import fibonacci_sphere

CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1404.0, 960.0, 540.0)
TARGETS = np.array([[-0.33, 0.2, 0.57], [-0.33, -0.6, 0.57], [0.33, -0.6, 0.57], [0.33, 0.2, 0.57]])
RADIUS = 0.6
ORIGIN = -TARGETS[1]  # from obj to the frame of the bundle
FRONT = ((0.0, 5.0), (-12.0, 8.0), (12.0, 4.0), (-5.0, -7.0), (6.0, 15.0))  # degrees to the right, up
ROUND = ((0.0, 5.0), (-50.0, 10.0), (50.0, 5.0), (-10.0, 45.0), (10.0, -35.0), (30.0, 25.0))
EDGES = ((1, 2), (2, 3), (3, 4), (4, 1))


def station(azimuth, height, distance=2.6):
    a, h = np.radians([azimuth, height])
    z = -np.array([np.sin(a) * np.cos(h), np.sin(h), np.cos(a) * np.cos(h)])
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), np.array([0.0, -0.1, 0.28]) - distance * z)


@cache
def calibrated(stations, pairs=EDGES, tape=0.001, seed=0, discs=70, worse=None, bulge=0.0, aslant=None):
    """A calibration from photos at stations; `worse` (photo, factor) is less sharp, discs stand `bulge` m off.

    Of a photo some discs are `aslant` (photo, factor), less certain and known to be.
    """
    rng = np.random.default_rng(seed)
    distances = tuple(
        Distance(a, b, float(np.linalg.norm(TARGETS[a - 1] - TARGETS[b - 1]) + tape * rng.standard_normal()), tape)
        for a, b in pairs
    )
    radii = np.array([0.012, 0.024, 0.036])
    device = Device((1, 2, 3, 4), ("MCY", "CYM", "YMC", "CMY"), radii, 0.02, Axes(2, 1, 3), distances)
    normals = fibonacci_sphere(discs)
    on_ball = (RADIUS + bulge * rng.standard_normal((discs, 1))) * normals
    poses = tuple(station(*s) for s in stations)
    away = np.array([p.position for p in poses])[:, None] - on_ball
    sees = np.sum(away * normals, axis=2) > np.cos(np.radians(65.0)) * np.linalg.norm(away, axis=2)
    sees &= np.sum(sees, axis=0) >= 2
    photo, disc = np.nonzero(sees)
    k = len(poses)
    photo, point = np.r_[np.repeat(np.arange(k), 4), photo], np.r_[np.tile(np.arange(4), k), 4 + disc]
    points = np.concatenate([TARGETS, on_ball]) + ORIGIN
    true = Block(CAMERA, tuple(Pose(p.rotation, p.position + ORIGIN) for p in poses), points)
    covariance = np.tile(0.05**2 * np.eye(2), (len(photo), 1, 1))
    image = ImagePoints(photo, point, np.zeros((len(photo), 2)), covariance)
    noise = 0.05 * rng.standard_normal((len(photo), 2))
    if worse is not None:
        noise[photo == worse[0]] *= worse[1]
    if aslant is not None:
        some = (photo == aslant[0]) & (point >= 4) & (np.arange(len(photo)) % 3 == 0)
        noise[some] *= aslant[1]
        image = replace(image, covariance=np.where(some[:, None, None], aslant[1] ** 2, 1.0) * covariance)
    image = replace(image, centre=predicted(true, image, Problem(device, CAMERA, image, not distances))[0] + noise)
    is_target = point < 4
    depth = np.concatenate([p.to_cam(TARGETS)[:, 2] for p in poses])
    seen, number = np.unique(point[~is_target], return_inverse=True)
    targets = image.take(is_target)
    return adjust_device(
        TargetViews(tuple(range(k)), targets, np.stack([depth, 0.02 * depth], axis=1), ()),
        DiscViews(photo[~is_target], number, image.centre[~is_target], image.covariance[~is_target], points[seen]),
        replace(true, points=points[:4]),
        device,
        CAMERA,
    )


NAMES = [f"photo {k}" for k in range(1, 10)]


def said(calibration):
    return [a.text for a in advise(calibration, NAMES)]


@pytest.fixture(scope="module")
def good():
    return calibrated(ROUND)


@pytest.mark.parametrize("pairs", [EDGES, ()])
def test_design_alone_gives_the_sigmas_of_the_calibration(pairs):
    c = calibrated(ROUND, pairs)
    s = sigmas(network(c), len(c.discs))
    assert s.ball == pytest.approx(np.sqrt(np.diag(c.ball_covariance)), rel=1e-3)
    here = c.block("targets")
    assert s.targets == pytest.approx(np.sqrt(np.mean(np.diag(c.covariance)[here])), rel=1e-3)
    blocks = [c.covariance[i : i + 3, i : i + 3] for i in range(c.block("discs").start, len(c.covariance), 3)]
    assert s.disc == pytest.approx(np.sqrt(max(np.linalg.eigvalsh(b)[-1] for b in blocks)), rel=1e-3)


def test_photos_that_are_taken_bring_what_was_promised():
    """Without metres, so that only photos count."""
    before = calibrated(FRONT, ())
    new = ((-60.0, 5.0), (-42.0, 5.0), (60.0, 5.0), (42.0, 5.0))
    net = network(before)
    moved = tuple(Pose(p.rotation, p.position + before.centre * before.unit) for p in (station(*s) for s in new))
    promised = sigmas(with_photos(net, moved), len(before.discs))
    after = calibrated((*FRONT, *new), (), seed=1)
    factor = np.sqrt(np.mean(after.variance_factors) / np.mean(before.variance_factors))  # luck of the residuals
    real = np.sqrt(np.diag(after.ball_covariance)) / factor
    now = np.sqrt(np.diag(before.ball_covariance))
    assert np.all(now / real > 1.5)  # else the promise would be none
    assert promised.ball == pytest.approx(real, rel=0.2)


def test_distances_that_are_measured_bring_what_was_promised(good):
    promised = sigmas(with_distances(network(good), ((1, 3), (2, 4)), 0.001), len(good.discs))
    after = calibrated(ROUND, (*EDGES, (1, 3), (2, 4)))
    assert promised.ball == pytest.approx(np.sqrt(np.diag(after.ball_covariance)), rel=0.05)
    assert promised.ball[3] < np.sqrt(good.ball_covariance[3, 3]) / MIN_GAIN


def test_photos_from_the_front_alone_ask_for_photos_from_the_sides():
    c = calibrated(FRONT[:3], tape=0.00005)
    work = [a for a in advise(c, NAMES) if a.gain is not None]
    assert work[0].text.startswith("All photos are from the front: two more photos from the far left and two from ")
    assert work[0].gain is not None
    assert work[0].gain > 1.5
    figures = re.search(r"([\d.]+) times better, from ([\d.]+) mm to ([\d.]+) mm", work[0].text)
    assert figures is not None
    gain, now, then = (float(g) for g in figures.groups())
    assert now / then == pytest.approx(gain, rel=0.1)
    assert work[0].improves in work[0].text


def test_tape_is_asked_for_where_it_limits_and_photos_are_not(good):
    work = [a.text for a in advise(good, NAMES) if a.gain is not None]
    assert "The scale rests on 4 distances, ± 1 mm each" in work[0]
    assert not any("photos from" in text for text in work)


def test_every_gain_is_worth_the_work_and_there_are_three_at_most():
    for c in (calibrated(FRONT[:3], tape=0.003), calibrated(ROUND), calibrated(FRONT, ())):
        gains = [a.gain for a in advise(c, NAMES) if a.gain is not None]
        assert len(gains) <= 3
        assert all(g >= MIN_GAIN for g in gains)


def test_nothing_is_asked_for_where_all_is_finer_than_paper():
    assert [a for a in advise(calibrated(ROUND, tape=0.00001), NAMES) if a.gain is not None] == []


def test_verdict_goes_by_the_share_of_the_radius(good):
    assert advise(good, NAMES)[0].kind == "good"
    bad = calibrated(ROUND, pairs=((1, 2),), tape=0.008)
    assert np.sqrt(bad.ball_covariance[3, 3]) > ENOUGH * bad.radius
    assert advise(bad, NAMES)[0].kind == "warning"
    assert advise(bad, NAMES)[0].text.startswith("Not good yet")


def test_stations_see_no_target_through_the_ball_or_from_behind(good):
    net = network(good)
    centre = good.centre
    front, side, behind = station(0.0, 0.0), station(85.0, 0.0), station(180.0, 0.0)
    assert [
        int(np.sum(visible_targets(net, Pose(p.rotation, p.position + centre)))) for p in (front, side, behind)
    ] == [
        4,
        0,
        0,
    ]
    near = station(0.0, 0.0, 0.9)
    assert np.sum(visible_targets(net, Pose(near.rotation, near.position + centre))) < 4  # out of the picture


def test_one_distance_is_not_checked_and_none_is_free():
    assert any("rests on one tape distance, 1 to 2" in t for t in said(calibrated(ROUND, ((1, 2),))))
    assert any("scale is free" in t for t in said(calibrated(ROUND, ())))


def test_distances_that_contradict_each_other_are_named(good):
    assert not any("contradict" in t for t in said(good))
    at = 2 * len(good.problem.image)
    residual = good.solution.adjusted.residual.copy()
    residual[at:] = 4.0
    solution = replace(good.solution, adjusted=replace(good.solution.adjusted, residual=residual))
    assert any("distances contradict each other" in t for t in said(replace(good, solution=solution)))


def test_a_blurred_photo_is_named_and_no_other():
    c = calibrated(ROUND, worse=(3, 4.0))
    assert np.argmax(photo_scatter(c)[0]) == 3
    assert next(t for t in said(c) if "worse than the others" in t).startswith("photo 4 ")
    assert not any(re.match(r"photo [12356] fits", t) for t in said(c))


def test_a_photo_whose_discs_are_aslant_is_told_as_it_may_be_and_no_other():
    """A third of its points are ten times less certain, and off as far: the others' px are not, and weights know it."""
    c = calibrated(ROUND, aslant=(2, 10.0))
    assert np.argmax(photo_px(c)[0]) == 2
    found, expected = photo_px(c)
    assert np.all(np.abs(np.log(found / expected)) < np.log(1.7))
    notes = [t for t in said(c) if "px off" in t]
    assert len(notes) == 1
    assert notes[0].startswith("photo 3 is 0.")
    assert "Nothing need be done" in notes[0]
    assert not any("worse than the others" in t for t in said(c))
    assert not any("px off" in t for t in said(calibrated(ROUND)))


def test_a_ball_out_of_round_is_told_with_its_figure(good):
    assert not any("out of round" in t for t in said(good))
    assert any(re.search(r"out of round.*are [234]\.\d mm off", t) for t in said(calibrated(ROUND, bulge=0.0035)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ring_scale": 1.07}, "rings look 7 % larger"),
        ({"ring_scale": 0.9}, "rings look 10 % smaller"),
        ({"variance_factors": (9.0, 1.0)}, "targets fit the photos 3.0 times worse"),
        ({"variance_factors": (1.0, 25.0)}, "discs fit the photos 5.0 times worse"),
        ({"skipped": ((6, "2 of 4 targets found"),)}, "photo 7 was left out: 2 of 4 targets found."),
        ({"doubtful": ((2, "the ball was turned"),)}, "photo 3: only its targets were used"),
        ({"sightings": 2}, "discs are seen in three photos or more"),
    ],
)
def test_what_is_odd_is_said_and_only_then(good, change, words):
    if "sightings" in change:
        change = {"sightings": np.full(len(good.discs), 2)}
    assert not any(words in t for t in said(good))
    assert any(words in t for t in said(replace(good, **change)))
