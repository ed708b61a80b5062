"""Advice: work that is advised makes the calibration better, and faults are named."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from spheremouse.ball.device import Axes, Device, Distance
from spheremouse.calibrate.device.adjust import DiscViews, adjust_bundle, shift_to_ball
from spheremouse.calibrate.device.advice import advise, missing_sides, photo_scatter
from spheremouse.calibrate.device.bundle import Block, ImagePoints, Problem, predicted
from spheremouse.calibrate.device.start import TargetViews
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import fibonacci_sphere
from spheremouse.simulate.ball.stills import looking

CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1404.0, 960.0, 540.0)
TARGETS = np.array([[-0.33, 0.2, 0.57], [-0.33, -0.6, 0.57], [0.33, -0.6, 0.57], [0.33, 0.2, 0.57]])
RADIUS = 0.6
ORIGIN = -TARGETS[1]  # from obj to the frame of the bundle
FRONT = ((0.0, 5.0), (-12.0, 8.0), (12.0, 4.0), (-5.0, -7.0), (6.0, 15.0))  # degrees to the right, up
ROUND = ((0.0, 5.0), (-50.0, 10.0), (50.0, 5.0), (-10.0, 45.0), (10.0, -35.0), (30.0, 25.0))
EDGES = ((1, 2), (2, 3), (3, 4), (4, 1))


def station(azimuth, height, distance=2.6):
    a, h = np.radians([azimuth, height])
    middle = np.array([0.0, -0.1, 0.28])
    return looking(middle + distance * np.array([np.sin(a) * np.cos(h), np.sin(h), np.cos(a) * np.cos(h)]), middle, 0.0)


@cache
def calibrated(stations, pairs=EDGES, tape=0.001, seed=0, discs=70, worse=None, bulge=0.0):
    """A calibration from photos at stations; `worse` (photo, factor) is less sharp, discs stand `bulge` m off."""
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
    image = replace(image, centre=predicted(true, image, Problem(device, CAMERA, image, not distances))[0] + noise)
    is_target = point < 4
    depth = np.concatenate([p.to_cam(TARGETS)[:, 2] for p in poses])
    seen, number = np.unique(point[~is_target], return_inverse=True)
    targets = image.take(is_target)
    views = TargetViews(tuple(range(k)), targets, np.stack([depth, 0.02 * depth], axis=1), ())
    seen_discs = DiscViews(
        photo[~is_target], number, image.centre[~is_target], image.covariance[~is_target], points[seen]
    )
    start = replace(true, points=points[:4])
    return shift_to_ball(adjust_bundle(views, seen_discs, start, device, CAMERA), views, device)


NAMES = [f"photo {k}" for k in range(1, 10)]


def said(calibration):
    return [a.text for a in advise(calibration, NAMES)]


@pytest.fixture(scope="module")
def good():
    return calibrated(ROUND)


def ball_sigmas(calibration):
    """Those of the ball at unit variance factor, without the luck of the residuals."""
    return np.sqrt(np.diag(calibration.ball_covariance) / np.mean(calibration.variance_factors))


def test_photos_from_the_missing_sides_make_the_ball_more_certain():
    """Without metres, so that only photos count."""
    front = calibrated(FRONT, ())
    (advice,) = [t for t in said(front) if t.startswith("No photo is")]
    assert advice.startswith("No photo is from the left or from the right or from above: take two from each such side")
    sides = ((-60.0, 5.0), (-42.0, 5.0), (60.0, 5.0), (42.0, 5.0), (0.0, 45.0), (10.0, 30.0))
    after = calibrated((*FRONT, *sides), (), seed=1)
    assert not any("No photo is" in t for t in said(after))
    assert np.all(ball_sigmas(front) / ball_sigmas(after) > 1.5)


@pytest.mark.parametrize(
    ("azimuth", "height", "side"),
    [(-60, 0, "from the left"), (60, 0, "from the right"), (0, 45, "from above"), (0, -30, "from below")],
)
def test_a_photo_from_a_side_is_wanted_no_more(azimuth, height, side):
    middle = np.array([0.1, -0.2, 0.3])
    every = missing_sides(middle + station(0.0, 0.0).position[None] * [0.0, 0.0, 1.0], middle)
    a, h = np.radians([azimuth, height])
    place = middle + 2.6 * np.array([np.sin(a) * np.cos(h), np.sin(h), np.cos(a) * np.cos(h)])
    assert set(every) - set(missing_sides(place[None], middle)) == {side}


def test_distances_that_limit_the_radius_make_it_more_certain_when_more_are_measured(good):
    (advice,) = [t for t in said(good) if "scale rests on" in t]
    told = float(re.search(r"leave the radius uncertain by ([\d.]+) mm", advice)[1])
    assert told == pytest.approx(1e3 * np.sqrt(good.ball_covariance[3, 3]), rel=0.3)
    more = calibrated(ROUND, (*EDGES, (1, 3), (2, 4)))
    assert more.ball_covariance[3, 3] < good.ball_covariance[3, 3] / 1.5
    assert not any("scale rests on" in t for t in said(calibrated(ROUND, tape=0.00001)))


def test_verdict_goes_by_the_share_of_the_radius(good):
    assert advise(good, NAMES)[0].kind == "good"
    bad = calibrated(ROUND, pairs=((1, 2),), tape=0.008)
    assert np.sqrt(bad.ball_covariance[3, 3]) > 2.5e-3 * bad.radius
    assert advise(bad, NAMES)[0].kind == "warning"
    assert advise(bad, NAMES)[0].text.startswith("Not good yet")


def test_one_distance_is_not_checked_and_none_is_free():
    assert any("rests on one tape distance, 1 to 2" in t for t in said(calibrated(ROUND, ((1, 2),))))
    assert any("scale is free" in t for t in said(calibrated(ROUND, ())))


def test_distances_that_contradict_each_other_are_named(good):
    assert not any("contradict" in t for t in said(good))
    at = 2 * len(good.problem.image)
    residual = good.solution.residual.copy()
    residual[at:] = 4.0
    solution = replace(good.solution, residual=residual)
    assert any("distances contradict each other" in t for t in said(replace(good, solution=solution)))


def test_a_blurred_photo_is_named_and_no_other():
    c = calibrated(ROUND, worse=(3, 4.0))
    assert np.argmax(photo_scatter(c)[0]) == 3
    assert next(t for t in said(c) if "worse than the others" in t).startswith("photo 4 ")
    assert not any(re.match(r"photo [12356] fits", t) for t in said(c))


def test_a_ball_out_of_round_is_told_with_its_figure(good):
    assert not any("out of round" in t for t in said(good))
    assert any(re.search(r"out of round.*are [234]\.\d mm off", t) for t in said(calibrated(ROUND, bulge=0.0035)))


def test_what_is_odd_is_said_and_only_then(good):
    before = said(good)
    for change, words in (
        ({"ring_scale": 1.07}, "rings look 7 % larger"),
        ({"ring_scale": 0.9}, "rings look 10 % smaller"),
        ({"variance_factors": (9.0, 1.0)}, "targets fit the photos 3.0 times worse"),
        ({"variance_factors": (1.0, 25.0)}, "discs fit the photos 5.0 times worse"),
        ({"skipped": ((6, "2 of 4 targets found"),)}, "photo 7 was left out: 2 of 4 targets found."),
        ({"doubtful": ((2, "the ball was turned"),)}, "photo 3: only its targets were used"),
        ({"sightings": np.full(len(good.discs), 2)}, "discs are seen in three photos or more"),
    ):
        assert not any(words in t for t in before)
        assert any(words in t for t in said(replace(good, **change)))
