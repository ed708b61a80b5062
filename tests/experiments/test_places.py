"""Where to put the camera: visibility and bounds by geometry against films."""

import numpy as np
import pytest
from experiments import places
from experiments.kit.job import Request
from experiments.places import Place, Size, expected, scene_from, targets_in_view

from spheremouse.ball.truth import VISIBLE
from spheremouse.simulate.ball.profile import thesis
from spheremouse.simulate.ball.render import Renderer

QUICK, WHOLE = Request(True, None), Request(False, None)
FRONT = Place(0, 0, 2.35, 640.0)
NOISE = [Size(11.0, 0.1, 0.5, 50), Size(90.0, 0.02, 1.0, 50)]


def with_noise(sigma):
    return [Size(1e-3, sigma, 1.0, 50), Size(1e4, sigma, 1.0, 50)]


def test_the_discs_in_view_are_those_that_the_renderer_shows_whole():
    scene = scene_from(Place(-30, 20, 2.2, 600.0), 3)
    renderer, times = Renderer(scene), np.linspace(0.0, 9.0, 6)
    seen = places.sights_at(scene, thesis().attitude(times), with_noise(0.05))
    agree = total = 0
    for k, t in enumerate(times):
        truth = renderer.frame(thesis(), float(t), k, np.random.default_rng(0)).discs
        shown, ours = set(truth.disc[truth.state == VISIBLE].tolist()), set(seen[k].disc.tolist())
        agree, total = agree + len(shown & ours), total + len(shown | ours)
    assert total > 60
    assert agree / total > 0.95  # a strut that covers a hundredth of a disc is seen by one of the two


def test_the_bound_is_proportional_to_the_noise_of_centres_where_motion_is_well_known():
    one, two = (expected(FRONT, (0,), 20, with_noise(s)) for s in (0.02, 0.04))
    assert 1.5 < two["attitude_deg"] / one["attitude_deg"] < 2.05
    assert one["targets"] == 4


def test_discs_that_are_seldom_found_tell_less_and_smaller_ones_nothing():
    sigma = places.centre_sigma(np.array([11.0, 90.0, 300.0, 5.0, np.nan]), NOISE)
    assert sigma[0] == pytest.approx(0.1 / np.sqrt(0.5))
    assert sigma[1:3] == pytest.approx([0.02, 0.02])
    assert np.all(np.isinf(sigma[3:]))


def test_targets_are_in_view_from_the_front_and_not_from_the_side_or_too_near():
    assert targets_in_view(scene_from(FRONT, 0)) == 4
    assert targets_in_view(scene_from(Place(75, 0, 2.35, 640.0), 0)) == 0
    assert targets_in_view(scene_from(Place(0, 0, 1.0, 640.0), 0)) == 0
    assert targets_in_view(scene_from(Place(0, 0, 2.35, 320.0), 0)) == 0  # the rings are too narrow
