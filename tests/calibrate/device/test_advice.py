"""Advice: work that is advised makes the calibration better, and faults are named."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from experiments.kit import observations
from experiments.kit.observations import simulated_calibration

from spheremouse.calibrate.device.adjust import adjust_bundle
from spheremouse.calibrate.device.advice import advise, missing_sides, photo_scatter

FRONT = ((0.0, 5.0), (-10.0, 3.0), (10.0, 4.0), (-5.0, -14.0), (6.0, 8.0))  # degrees to the right, up
ROUND = ((0.0, 5.0), (-50.0, 10.0), (50.0, 5.0), (-10.0, 45.0), (10.0, -35.0), (30.0, 25.0))
EDGES = ((1, 2), (2, 3), (3, 4), (4, 1))


@cache
def calibrated(stations, pairs=EDGES, tape=0.001, seed=0, worse=None, bulge=0.0):
    """A calibration from photos at stations; `worse` (photo, factor) is less sharp, discs stand `bulge` m off."""
    rng = np.random.default_rng(seed)
    s = simulated_calibration(rng, not pairs, interior=False, stations=stations, pairs=pairs, tape=tape, bulge=bulge)
    if worse is not None:
        for points in (s.views.image, s.discs.image):
            mine = points.photo == worse[0]
            points.centre[mine] += 0.05 * np.sqrt(worse[1] ** 2 - 1.0) * rng.standard_normal((mine.sum(), 2))
    return observations.calibrated(s)


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
    every = missing_sides(middle + np.array([[0.0, 0.0, 2.6]]), middle)
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


def test_a_second_adjustment_finds_the_same_shape():
    """The first one ends with the discs on a sphere. The second one frees them again for its tests."""
    s = simulated_calibration(np.random.default_rng(0), interior=False, stations=ROUND, bulge=0.0035)
    first = adjust_bundle(s.views, s.discs, s.start, s.device, s.camera)
    again = adjust_bundle(s.views, s.discs, first.solution.block, s.device, s.camera)
    assert first.problem.out_of_round > 0.002
    assert again.problem.out_of_round == pytest.approx(first.problem.out_of_round, rel=1e-3)
    np.testing.assert_array_equal(again.used, first.used)


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
