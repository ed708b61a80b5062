"""The records of a rig and of a map."""

from dataclasses import replace

import numpy as np
import pytest
from ball_world import CAMERA
from conftest import directions
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.points import directions_at, intersect
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.rig import Ball, Rig, Targets, in_metres
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import tangent_basis

SIGMA = 1e-3


def seen(d, seed, sigma=SIGMA):
    """A map of true directions `d`, (m, 3), each off by what its covariance says."""
    rng = np.random.default_rng(seed)
    moved = d + np.einsum("mij,mj->mi", tangent_basis(d), rng.normal(scale=sigma, size=(len(d), 2)))
    m = len(d)
    return DiscMap(
        moved / np.linalg.norm(moved, axis=1, keepdims=True), sigma**2 * np.eye(2 * m), np.full(m, 9, dtype=np.intp)
    )


@pytest.mark.parametrize("seed", range(10))
def test_the_same_ball_is_found_in_any_frame_and_another_is_not(seed):
    R = Rotation.random(rng=seed).as_matrix()
    d = directions(26, seed)
    found = seen(d, 1).compare(seen(d @ R.T, 2))
    assert found is not None
    np.testing.assert_array_equal(found.stayed[:, 0], found.stayed[:, 1])
    assert len(found.stayed) == 26
    error = Rotation.from_matrix(found.rotation @ R.T).magnitude()
    assert error < 5 * SIGMA / np.sqrt(26 / 3)  # two maps, 26 discs
    assert seen(d, 1).compare(seen(directions(26, 100 + seed), 2)) is None


def test_each_discs_fate():
    """Of 20 discs, 3 is gone, 5 was put 4 cm farther, 8 only 1 cm; one is new."""
    R = Rotation.random(rng=0).as_matrix()
    d = directions(20, 5)
    basis = tangent_basis(d)
    later = d.copy()
    later[5] += 0.04 / 0.6 * basis[5, :, 0]
    later[8] -= 0.01 / 0.6 * basis[8, :, 1]
    fresh = max(directions(300, 6, 0.0), key=lambda u: -np.abs(d @ u).max())  # far from all of them
    later = np.concatenate([np.delete(later, 3, axis=0), [fresh]])
    later /= np.linalg.norm(later, axis=1, keepdims=True)
    found = seen(d, 1, 3e-4).compare(seen(later @ R.T, 2, 3e-4))
    assert found is not None
    assert found.gone.tolist() == [3]
    assert found.new.tolist() == [19]
    assert sorted(found.moved.tolist()) == [[5, 4], [8, 7]]
    assert len(found.stayed) == 17
    assert found.text == "17 discs stayed, 2 moved, 1 gone, 1 new"


def test_half_of_the_smaller_map_must_agree():
    d = directions(24, 7)
    other = directions(24, 8)
    mixed = np.concatenate([d[:9], other[9:]])
    assert not seen(d, 1).compare_at(seen(mixed, 2), np.eye(3)).same_ball
    mixed = np.concatenate([d[:14], other[14:]])
    assert seen(d, 1).compare_at(seen(mixed, 2), np.eye(3)).same_ball
    assert seen(d, 1).compare_at(seen(d[:7], 2), np.eye(3)).same_ball  # a map just begun
    assert not seen(d, 1).compare_at(seen(d[:2], 2), np.eye(3)).same_ball


def test_a_turned_map_has_the_covariance_of_turned_samples():
    rng = np.random.default_rng(1)
    d = directions(5, 9)
    A = rng.normal(size=(10, 10)) * 1e-3
    before = DiscMap(d, A @ A.T, np.arange(5), eccentricity=1e-3 * d[0])
    R = Rotation.random(rng=2).as_matrix()
    after = before.turned(R)
    e = rng.multivariate_normal(np.zeros(10), before.covariance, size=40_000)
    samples = (d + np.einsum("mij,kmj->kmi", tangent_basis(d), e.reshape(-1, 5, 2))) @ R.T
    errors = np.einsum("mij,kmi->kmj", tangent_basis(after.directions), samples - d @ R.T).reshape(-1, 10)
    sigma = np.sqrt(np.diag(after.covariance))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(np.cov(errors.T) / scale, after.covariance / scale, atol=0.03)
    back = after.turned(R.T)
    np.testing.assert_allclose(back.covariance, before.covariance, atol=1e-16)
    np.testing.assert_allclose(back.directions, d, atol=1e-15)
    np.testing.assert_array_equal(back.sightings, before.sightings)
    np.testing.assert_allclose(after.eccentricity, 1e-3 * after.directions[0], atol=1e-18)


def test_a_map_with_the_centre_of_an_eccentric_ball_improves_one_without():
    round_ball = seen(directions(5, 9), 1)
    eccentric, better = (replace(round_ball, eccentricity_sigma=sigma) for sigma in (1e-3, 4e-4))
    assert eccentric.improves(round_ball)
    assert better.improves(eccentric)
    assert not round_ball.improves(eccentric)
    assert not eccentric.improves(better)


UNIT = 0.55  # m


def covariance(n, seed):
    A = np.random.default_rng(seed).normal(size=(n, n))
    return 1e-6 * A @ A.T


def in_radii():
    """A rig in radii of its ball, with something in every field that has a length."""
    whole = covariance(10, 1)
    position = np.array([[-0.6, 0.3, 0.9], [-0.6, -1.0, 0.9], [0.6, -1.0, 0.9]])
    joint = covariance(13, 2)
    return Rig(
        CAMERA,
        Ball(1.0, np.array([0.01, 0.0, -0.01]), whole[6:, 6:]),
        Targets((1, 2, 3), ("CMY", "MYC", "YCM"), position, joint[:9, :9], np.array([0.02, 0.04, 0.06])),
        0.03,
        pose=Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.2, 4.0]), whole[:6, :6], whole[:6, 6:]),
        cross_covariance=joint[:9, 9:],
        scale_free=True,
    )


def test_metres_change_what_is_seen_by_nothing_and_what_is_known_by_their_unit():
    free = in_radii()
    metric = in_metres(free, UNIT)
    assert not metric.scale_free
    assert_allclose(predict_targets(metric.pose, metric), predict_targets(free.pose, free), atol=1e-9)
    uv = np.array([[320.0, 240.0], [250.0, 300.0], [400.0, 200.0]])
    assert_allclose(directions_at(uv, metric, metric.pose)[0], directions_at(uv, free, free.pose)[0], atol=1e-12)
    seen = Detections(uv, np.tile(0.01 * np.eye(2), (3, 1, 1)), np.full(3, 50.0))
    a, b = (intersect(seen, r, r.pose) for r in (free, metric))
    assert_allclose(b.position, UNIT * a.position, atol=1e-12)
    assert_allclose(b.covariance, UNIT**2 * a.covariance, rtol=1e-9)
    joint, other = (np.block([[r.targets.covariance, r.cross_covariance]]) for r in (free, metric))
    assert_allclose(other, UNIT**2 * joint)
    assert_allclose(metric.disc_angle, free.disc_angle)
    assert in_metres(replace(free, disc_radius=None), UNIT).disc_radius is None
