"""Particle filter: resampling, means, and an unchanged posterior for any proposal."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spheremouse.geometry.rotation import exp, log
from spheremouse.native import kernels
from spheremouse.wand.particles import (
    MotionMixture,
    Particles,
    PeakMixture,
    effective_number,
    low_variance_indices,
    mean_pose,
    move,
    normalise,
    propose,
    regularised_covariance,
    scatter,
)
from tests.wand import twins

ONE = np.diag([0.02**2, 0.02**2, 0.05**2, 0.2**2, 0.1**2, 0.15**2])


def motions(shift, probability=(0.6, 0.399), birth=1e-9):
    return MotionMixture(np.array([np.zeros(6), shift]), np.stack([ONE, 0.25 * ONE]), np.array(probability), birth)


def test_low_variance_resampling_draws_each_particle_by_its_weight_to_within_one():
    w = np.array([0.5, 0.0, 0.26, 0.24])
    for start in np.linspace(0.0, 0.999, 7):
        count = np.bincount(low_variance_indices(w, 100, start), minlength=4)
        assert np.all(np.abs(count - 100 * w) < 1.0 + 1e-9)
        assert count[1] == 0


def test_mean_and_covariance_equal_those_of_the_sample():
    rng = np.random.default_rng(4)
    R = exp(np.array([2.0, -1.0, 0.5]))
    cloud = scatter(np.array([0.1, 0.2, 1.0]), R, ONE, 60_000, rng)
    p, mean, covariance = mean_pose(cloud)
    np.testing.assert_allclose(p, [0.1, 0.2, 1.0], atol=1e-3)
    assert np.linalg.norm(log(mean @ R.T)) < 3e-3
    np.testing.assert_allclose(covariance, ONE, atol=8e-4)
    # SciPy's chordal mean is close for a narrow sample
    assert np.linalg.norm(log(mean @ Rotation.from_matrix(cloud.rotation).mean().as_matrix().T)) < 1e-3


def test_mean_rotation_is_equivariant():
    rng = np.random.default_rng(5)
    w = rng.random(30)
    cloud = Particles(np.zeros((30, 3)), exp(rng.normal(size=(30, 3)) * 0.5), w / w.sum())
    turn = exp(np.array([1.0, 2.0, -0.3]))
    _, mean, _ = mean_pose(cloud)
    _, turned, _ = mean_pose(Particles(cloud.position, turn @ cloud.rotation, cloud.weight))
    np.testing.assert_allclose(turned, turn @ mean, atol=1e-9)


def test_covariance_of_few_particles_is_the_expected_one():
    np.testing.assert_allclose(regularised_covariance(np.zeros((6, 6)), 0.0, ONE), ONE)
    np.testing.assert_allclose(regularised_covariance(2 * ONE, 1e9, ONE), 2 * ONE)


def test_proposals_do_not_change_the_posterior():
    """The likelihood is a Gaussian. The proposal uses a displaced one, three times as wide, or the motion alone."""
    rng, n = np.random.default_rng(6), 20_000
    parents = scatter(np.array([0.0, 0.0, 1.0]), np.eye(3), 0.1 * ONE, n, rng)
    m = motions(np.array([0.03, 0.0, 0.02, 0.1, -0.1, 0.0]))
    to, toR = np.array([0.02, -0.01, 1.03]), exp(np.array([0.15, 0.02, -0.1]))
    L = 0.3 * ONE

    def likelihood(cloud):
        d = np.concatenate([cloud.position - to, log(cloud.rotation @ toR.T)], axis=1)
        return -0.5 * np.einsum("ni,ij,nj->n", d, np.linalg.inv(L), d)

    alone = move(parents, m, rng)
    w, _ = normalise(likelihood(alone))
    p, R, covariance = mean_pose(Particles(alone.position, alone.rotation, w))

    wide = 3.0 * L
    peaks = PeakMixture((to + 0.005)[None], (exp(np.full(3, 0.03)) @ toR)[None], wide[None], np.array([0.0]))
    drawn, ratio, nearest = propose(parents, m, peaks, 0.1, n, rng)
    assert np.all(nearest == 0)
    v, _ = normalise(ratio + likelihood(drawn))
    q, S, spread = mean_pose(Particles(drawn.position, drawn.rotation, v))
    assert effective_number(v) > 2.0 * effective_number(w)
    scale = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(q - p) < 0.06 * scale[:3])
    assert np.all(np.abs(log(S @ R.T)) < 0.06 * scale[3:])
    np.testing.assert_allclose(np.diag(spread) / np.diag(covariance), 1.0, atol=0.12)


def test_births_reach_a_peak_beyond_all_motions():
    rng = np.random.default_rng(7)
    parents = scatter(np.array([0.0, 0.0, 1.0]), np.eye(3), 0.01 * ONE, 500, rng)
    far = np.array([0.8, 0.3, 2.0])
    peaks = PeakMixture(far[None], exp(np.array([[2.0, 0, 0]])), 0.01 * ONE[None], np.array([0.0]))
    drawn, ratio, _ = propose(parents, motions(np.zeros(6)), peaks, 0.1, 500, rng)
    near = np.linalg.norm(drawn.position - far, axis=1) < 0.1
    assert 0.8 < near.mean() < 0.97  # except the blind ones
    assert np.ptp(ratio[near]) < 25.0


def test_native_functions_of_the_proposal_equal_their_twins():
    """Three motions, two peaks; particles near and far, turned by up to half a turn."""
    rng = np.random.default_rng(8)
    wide = MotionMixture(
        rng.normal(size=(3, 6)) * 0.05, np.stack([ONE, 0.25 * ONE, 4.0 * ONE]), np.array([0.5, 0.3, 0.199]), 1e-9
    )
    peaks = PeakMixture(
        np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.1]]), exp(rng.normal(size=(2, 3))), np.stack([0.1 * ONE, 0.3 * ONE]),
        np.array([3.0, -2.0]),
    )  # fmt: skip
    cloud = scatter(peaks.position[0], peaks.rotation[0], 2.0 * ONE, 30, rng)
    twin = twins.Proposal(wide, peaks)
    native = kernels.Proposal(
        wide.shift, wide.covariance, wide.probability, wide.birth,
        peaks.position, peaks.rotation, peaks.covariance, peaks.log_mass,
    )  # fmt: skip
    score, difference = native.score(cloud.position, cloud.rotation)
    chosen, normal = np.arange(30) % 8, rng.normal(size=(30, 6))
    position, rotation = native.draw(chosen, difference, normal)
    share = rng.dirichlet(np.ones(8), 30)
    ratio, nearest = native.log_ratio(cloud.position, cloud.rotation, position, rotation, difference, share, 0.1)
    for i in range(30):
        base = cloud.position[i], cloud.rotation[i]
        expected, d = twin.score(*base)
        np.testing.assert_allclose(score[i], expected, rtol=1e-9)
        np.testing.assert_allclose(difference[i], d, rtol=1e-9, atol=1e-12)
        p, R = twin.draw(chosen[i], d, normal[i])
        np.testing.assert_allclose(position[i], p, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(rotation[i], R, rtol=1e-9, atol=1e-12)
        value, peak = twin.log_ratio(base, (p, R), d, share[i], 0.1)
        assert ratio[i] == pytest.approx(value, rel=1e-9, abs=1e-9)
        assert nearest[i] == peak
