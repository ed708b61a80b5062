"""How the camera films: tiny films, thinned ones."""

from dataclasses import replace

import numpy as np
import pytest
from experiments.kit import film as kit
from experiments.kit import tour as tour_module
from experiments.kit.tour import thinned, tour
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.geometry.rotation import log


@pytest.fixture(scope="module")
def film():
    return tour_module.filmed({"fps": 60.0, "size": [320, 240]}, 1, 0.6)


def test_the_tour_leaves_no_axis_out_and_its_rate_is_that_of_its_attitude():
    for seed in (1, 2):
        profile = tour(seed, 3.5)
        t = np.linspace(0.0, 3.5, 3501)
        R, w = profile.attitude(t), profile.rate(t)
        middle = 0.5 * (w[1:] + w[:-1])
        assert_allclose(log(R[1:] @ R[:-1].transpose(0, 2, 1)) / 1e-3, middle, atol=1e-3)
        assert np.all(w[t < 0.19] == 0.0)
        spread = np.linalg.svd(w, compute_uv=False)
        assert spread[2] > 0.2 * spread[0]


def test_a_thinned_film_is_the_film_at_the_slower_rate(film):
    fewer = thinned(film, 2)
    slow = tour_module.filmed({"size": [320, 240]}, 1, 0.6)
    assert [f.sequence for f in fewer.frames] == list(range(18))
    assert_allclose([f.stamp for f in fewer.frames], [f.stamp for f in slow.frames])
    assert_allclose(fewer.truth.motion.attitude, slow.truth.motion.attitude, atol=1e-12)
    for name in ("frame", "disc", "state"):
        assert_array_equal(getattr(fewer.truth.discs, name), getattr(slow.truth.discs, name))
    assert_allclose(fewer.truth.discs.centre, slow.truth.discs.centre, atol=1e-9)
    # the pictures differ by their noise of 3 grey values alone
    difference = fewer.frames[7].image.astype(float) - slow.frames[7].image
    assert np.std(difference) < 5.0


def test_the_classic_filters_are_told_the_true_acceleration(film):
    motion = film.truth.motion
    steady = replace(motion, rate=np.outer(motion.stamp, [3.0, 0.0, 0.0]))
    assert tour_module.acceleration(steady) == pytest.approx(np.sqrt(3.0))
    said = kit.settings_of([tour_module.suited(steady)]).euler.acceleration_sigma
    assert said == pytest.approx(np.sqrt(3.0))
