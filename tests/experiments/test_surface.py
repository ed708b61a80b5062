"""Points on the ball: covariances along it, areas."""

import json

import numpy as np
import pytest
from experiments import surface


@pytest.fixture(scope="module")
def results():
    work = {"points": surface.points_of_table_13(), "area": surface.areas(1500)}
    return json.loads(json.dumps(work))


@pytest.mark.parametrize(("distance", "area"), [(2.35, 1.685), (1.35, 1.257), (1e9, 2.262), (0.6, 0.0)])
def test_the_visible_cap(distance, area):
    assert surface.visible_cap(distance, 0.6) == pytest.approx(area, abs=1e-3)


def test_counting_agrees_with_the_formula(results):
    area = results["area"]
    formula = [surface.visible_cap(d, 0.6) for d in area["distance"]]
    assert area["alone"] == pytest.approx(formula, abs=0.01)
    for view in area["views"].values():
        assert view["alone"] == pytest.approx(surface.visible_cap(view["distance"], 0.6), abs=0.01)
        shares = [view[k] for k in ("alone", "behind frame", "one hand", "two hands")]
        assert shares == sorted(shares, reverse=True)
        assert shares[-1] > 0.2


def test_fed_with_the_thesis_covariances_table_13_comes_out(results):
    five = results["points"]["as the thesis"]
    ours = np.array([p["correlation"] for p in five]).ravel()
    theirs = np.array([c for _, c, _ in surface.TABLE_13]).ravel()
    strong = np.abs(theirs) > 0.6
    assert np.array_equal(np.sign(ours[strong]), np.sign(theirs[strong]))
    sigma = np.array([p["sigma"] for p in five]) / np.array([s for _, _, s in surface.TABLE_13])
    assert 0.7 < np.sqrt(np.mean(sigma**2)) < 1.3
