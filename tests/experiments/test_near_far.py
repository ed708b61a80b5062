"""Near and far: a short film by all trackers."""

import json

import numpy as np
import pytest
from experiments import near_far


@pytest.fixture(scope="module")
def film():
    """Twelve frames."""
    return json.loads(json.dumps(near_far.followed("far", 0, 0.4)))


def test_a_film_is_tracked_by_all_and_bounded(film):
    assert film["frames"] == 12
    for name in ("ekf1", "ekf2", "so3"):
        found = film["trackers"][name]
        assert found["tracked"] == 12
        assert found["attitude_rmse_deg"]["combined"] < 0.1
    assert film["trackers"]["ekf2, blobs"]["tracker"] == "ekf2"
    for what in ("attitude_deg", "rate_deg_s"):
        bound = np.array([film["bound"][what][axis] for axis in "xyz"])
        assert np.all((bound > 1e-4) & (bound < 5.0))


def test_a_wrong_pose_makes_the_attitude_wrong():
    """On the thesis' way about one degree is turned in 0.6 s: by what a pose is off, the attitude is by less."""
    found = near_far.posed("near", 0.6)
    assert found["lost"] == 0
    assert len(found["attitude"]) == 32
    assert found["attitude"] == sorted(found["attitude"])
    assert found["attitude"][-1] > 1.05 * found["attitude"][0]
