"""An uncertain standard deviation of the directions: small residuals are evidence, and the probability stays exact."""

import numpy as np
import pytest
from conftest import directions

from spheremouse.ball.associate import identify
from spheremouse.ball.constellation.identify import IdentificationPrior, attitude
from spheremouse.geometry.rotation import exp, log, tangent_basis

CAMERA = np.array([0.0, 0.0, 1.0])
HORIZON = 0.25
MODEL = IdentificationPrior()
EDGE = HORIZON + MODEL.limb_cosine
RATIO = MODEL.sigma_scales[-1] ** 2 / MODEL.sigma_scales[0]  # of two neighbours of the grid


def any_attitude(rng):
    return exp(rng.uniform(0.0, np.pi) * directions(1, rng.integers(1 << 30))[0])


def scattered(p, sigma, rng):
    """Return directions with noise of `sigma` rad per axis, a number or (n, 1)."""
    e = tangent_basis(p) @ (np.broadcast_to(sigma, (len(p), 1)) * rng.normal(size=(len(p), 2)))[:, :, None]
    p = p + e[:, :, 0]
    return p / np.linalg.norm(p, axis=1, keepdims=True)


def anywhere(n, least, rng):
    """Return directions, (n, 3), with a cosine to the camera's of at least `least`."""
    z, a = rng.uniform(least, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)


def test_three_exact_directions_suffice_though_their_sigma_is_uncertain():
    """Three of twelve discs among ten false directions: found by their small residuals, and never wrong."""
    sigma, right, coarse = 3e-3, 0, 0
    for seed in range(60):
        rng = np.random.default_rng([11, seed])
        known, R = directions(12, seed), any_attitude(rng)
        p = known @ R.T
        p = p[np.argsort(-p[:, 2])[:3]]
        seen = np.vstack([scattered(p, 3e-4, rng), anywhere(10, EDGE, rng)])
        for least in (3e-4, sigma):
            found = attitude(seen, known, sigma, CAMERA, HORIZON, min_sigma=least)
            if found is not None and found.error_probability < 1e-3:
                assert np.linalg.norm(log(found.rotation @ R.T)) < 5e-3
                right, coarse = right + (least < sigma), coarse + (least == sigma)
    assert right >= 0.8 * 60
    assert coarse < 0.1 * 60


@pytest.mark.slow
def test_probability_of_error_equals_the_frequency_of_errors():
    """Balls drawn from the model, with noise of 4 degrees or a third, in three classes of the probability."""
    rng = np.random.default_rng(7)
    said, wrong = [], []
    sigma = np.deg2rad(4.0)
    for i in range(1000):
        known, R = directions(20, i % 30, least=0.35), any_attitude(rng)
        p = known @ R.T
        visible = 1.0 / (1.0 + np.exp((EDGE - p[:, 2]) / MODEL.limb_width))
        p = p[rng.random(20) < (1.0 - rng.choice(MODEL.miss_probabilities)) * visible]
        cosine = np.clip(p[:, 2:], 0.3, 1.0)
        more = np.sqrt(1.0 + 0.5 * MODEL.pixel_noise_fraction * (1.0 / cosine**2 - 1.0))
        scale = rng.choice(MODEL.sigma_scales) * rng.choice([1.0, 1.0 / RATIO])
        k = rng.geometric(1.0 / (1.0 + MODEL.false_mean)) - 1
        p = np.vstack([scattered(p, scale * sigma * more, rng), anywhere(k, HORIZON, rng)])
        found = attitude(p, known, sigma, CAMERA, HORIZON, min_sigma=sigma / RATIO) if len(p) >= 3 else None
        if found is not None:
            said.append(found.error_probability)
            wrong.append(np.linalg.norm(log(found.rotation @ R.T)) > 0.35)
    said, wrong = np.array(said), np.array(wrong)
    for low, high in ((0.0, 0.05), (0.05, 0.5), (0.5, 1.0)):
        these = (said >= low) & (said < high)
        expected = np.sum(said[these])
        assert np.sum(these) > 30
        spread = np.sqrt(np.sum(said[these] * (1.0 - said[these])))
        assert np.sum(wrong[these]) < expected + 4.0 * spread, (low, high)
        assert np.sum(wrong[these]) > 0.4 * expected - 4.0 * spread, (low, high)


@pytest.mark.parametrize("least", [0.0, 0.02])
def test_a_least_sigma_is_above_0_and_at_most_sigma(least):
    with pytest.raises(ValueError, match=f"^min_sigma {least} is no standard deviation up to 0.01"):
        identify(np.eye(3), np.eye(3), sigma=0.01, view_axis=CAMERA, min_sigma=least)
