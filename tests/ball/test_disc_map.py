"""Two maps: the same ball in any frame is found, another one is not, and every disc's fate is told rightly."""

import numpy as np
import pytest
from conftest import directions
from scipy.spatial.transform import Rotation

from spheremouse.ball.disc_map import DiscMap, compare, compare_at, in_words, turned
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
    found = compare(seen(d, 1), seen(d @ R.T, 2))
    assert found is not None
    np.testing.assert_array_equal(found.stayed[:, 0], found.stayed[:, 1])
    assert len(found.stayed) == 26
    error = Rotation.from_matrix(found.rotation @ R.T).magnitude()
    assert error < 5 * SIGMA / np.sqrt(26 / 3)  # two maps, 26 discs
    assert compare(seen(d, 1), seen(directions(26, 100 + seed), 2)) is None


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
    found = compare(seen(d, 1, 3e-4), seen(later @ R.T, 2, 3e-4))
    assert found is not None
    assert found.gone.tolist() == [3]
    assert found.new.tolist() == [19]
    assert sorted(found.moved.tolist()) == [[5, 4], [8, 7]]
    assert len(found.stayed) == 17
    assert in_words(found) == "17 discs stayed, 2 moved, 1 gone, 1 new"


def test_half_of_the_smaller_map_must_agree():
    d = directions(24, 7)
    other = directions(24, 8)
    mixed = np.concatenate([d[:9], other[9:]])
    assert not compare_at(seen(d, 1), seen(mixed, 2), np.eye(3)).same_ball
    mixed = np.concatenate([d[:14], other[14:]])
    assert compare_at(seen(d, 1), seen(mixed, 2), np.eye(3)).same_ball
    assert compare_at(seen(d, 1), seen(d[:7], 2), np.eye(3)).same_ball  # a map just begun
    assert not compare_at(seen(d, 1), seen(d[:2], 2), np.eye(3)).same_ball


def test_a_turned_map_has_the_covariance_of_turned_samples():
    rng = np.random.default_rng(1)
    d = directions(5, 9)
    A = rng.normal(size=(10, 10)) * 1e-3
    before = DiscMap(d, A @ A.T, np.arange(5))
    R = Rotation.random(rng=2).as_matrix()
    after = turned(before, R)
    e = rng.multivariate_normal(np.zeros(10), before.covariance, size=40_000)
    samples = (d + np.einsum("mij,kmj->kmi", tangent_basis(d), e.reshape(-1, 5, 2))) @ R.T
    errors = np.einsum("mij,kmi->kmj", tangent_basis(after.directions), samples - d @ R.T).reshape(-1, 10)
    sigma = np.sqrt(np.diag(after.covariance))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(np.cov(errors.T) / scale, after.covariance / scale, atol=0.03)
    back = turned(after, R.T)
    np.testing.assert_allclose(back.covariance, before.covariance, atol=1e-16)
    np.testing.assert_allclose(back.directions, d, atol=1e-15)
    np.testing.assert_array_equal(back.sightings, before.sightings)
