"""How the camera films: tiny films, thinned ones."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import viewing
from experiments.kit import film as kit
from experiments.kit import tour as tour_module
from experiments.kit.tour import thinned, tour
from experiments.viewing import KINDS
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.geometry.rotation import log


@pytest.fixture(scope="module")
def film():
    return tour_module.filmed({"fps": 60.0, "size": [320, 240]}, 1, 0.6)


def row(error, lost=0):
    return {"attitude": error, "rate": 20.0 * error, "lost": lost, "tracked": 90, "frames": 90}


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


def test_one_film_is_followed_at_every_rate_it_holds(monkeypatch):
    monkeypatch.setattr(viewing, "FASTEST", 60)  # a smaller film
    found = json.loads(json.dumps(viewing.at_rates(1, 0.8, [30, 60])))["points"]
    assert [found[r]["rows"]["so3"]["frames"] for r in ("30", "60")] == [24, 48]
    assert set(found["30"]["rows"]) == set(KINDS["rate"].shown)
    for at in found.values():
        assert at["rows"]["so3"]["tracked"] == at["rows"]["so3"]["frames"]
        assert (
            at["rows"]["ekf2"]["rate"] < at["rows"][tour_module.PUBLISHED]["rate"]
        )  # it is told how lively the ball is
        assert 0.0 < at["bound"]["attitude"] < 1.0
    assert found["60"]["bound"]["rate"] < found["30"]["bound"]["rate"]


def test_a_readout_that_is_not_considered_costs_attitude():
    found = viewing.with_film(1, 4.0, {"readout": 0.03})
    assert found["pose"] is None  # nothing was amiss
    off = {
        name: found["rows"][name]["attitude"]
        for name in (tour_module.KNOWN, tour_module.ESTIMATED, tour_module.IGNORED)
    }
    assert off[tour_module.IGNORED] > 2.0 * off[tour_module.KNOWN]
    assert off[tour_module.ESTIMATED] < off[tour_module.IGNORED]


def test_where_no_target_is_found_the_true_pose_is_taken_and_said():
    found = viewing.with_film(1, 0.4, {"size": [320, 240]})
    assert "targets found" in found["pose"]
    assert found["rows"]["so3"]["tracked"] > 0


def test_the_classic_filters_are_told_the_true_acceleration(film):
    motion = film.truth.motion
    steady = replace(motion, rate=np.outer(motion.stamp, [3.0, 0.0, 0.0]))
    assert tour_module.acceleration(steady) == pytest.approx(np.sqrt(3.0))
    said = kit.settings_of([tour_module.suited(steady)]).euler.acceleration_sigma
    assert said == pytest.approx(np.sqrt(3.0))


def test_a_lost_film_is_one_that_says_so_or_is_far_off_or_has_nothing():
    assert tour_module.is_lost(row(0.1, lost=1))
    assert tour_module.is_lost(row(1.2))
    assert tour_module.is_lost({**row(0.1), "attitude": None})
    assert not tour_module.is_lost(row(0.9))
