"""Targets: where they are put, poses from rings and tags on a tiny case."""

import json

import numpy as np
import pytest
from experiments import targets
from experiments.targets import KINDS, NUMBERS, key, places

from spheremouse.simulate.ball.scene import default_scene


@pytest.fixture(scope="module")
def camera():
    """Four targets of the usual size and of one that is too small, from one camera."""
    return json.loads(json.dumps(targets.filmed(1, [4], [6, 36])))


def test_four_targets_are_the_thesis_own_and_none_lie_on_one_another():
    scene = default_scene(1)
    assert places(4) == pytest.approx(scene.targets.position)
    for n in NUMBERS:
        where = places(n)
        assert where.shape == (n, 3)
        apart = np.linalg.norm(where[:, None] - where[None], axis=2) + 10.0 * np.eye(n)
        assert apart.min() > 2.0 * 1.22 * 0.048 * np.sqrt(2.0)  # the largest sheets, corner to corner


def test_rings_and_tags_give_the_pose_and_what_is_too_small_none(camera):
    for kind in KINDS:
        usual = camera["sizes"][key(kind, 4, 36)]
        assert usual["found"] == 1.0
        assert np.linalg.norm(usual["position_mm"]) < 30.0
        assert np.all(np.array(usual["sigma_position_mm"]) > 0.1)
        small = camera["sizes"][key(kind, 4, 6)]
        assert small["found"] < 1.0
    rings, tags = (camera["sizes"][key(k, 4, 36)]["point_px"] for k in ("rings", "aruco"))
    assert rings < 0.05
    assert rings < tags < 1.0
    assert camera["sizes"][key("rings", 4, 6)]["error"]
    assert camera["px_per_mm"] == pytest.approx(2e-3 * 640.0 / 1.79, rel=0.06)
