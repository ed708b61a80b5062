"""The picture of a ball's texture: geometry, contrast, and the native functions beside their NumPy twins."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from spheremouse.ball.detect.appearance import clear_mask, seen_at
from spheremouse.ball.texture.picture import (
    align,
    anchor_directions,
    contrast_of,
    correlate,
    empty_picture,
    first_seen,
    learn,
    texture_view,
    tile_directions,
    weigh,
    without_before,
)
from spheremouse.geometry.rotation import exp, log
from spheremouse.native import kernels
from spheremouse.simulate.ball.scene import default_scene
from tests.ball.texture import twins

NOISE = 0.01
SCENE = default_scene(1, width=160, height=120)
RIG, POSE = SCENE.rig(), SCENE.pose


def waves(rng, count=40):
    """A function of directions, (n, 3): a texture with details of 10 degrees."""
    k, phase = rng.normal(size=(count, 3)) * 12.0, rng.uniform(0.0, 2.0 * np.pi, count)
    return lambda x: np.sin(x @ k.T + phase).sum(axis=1) * 0.2 / np.sqrt(count)


@pytest.fixture(scope="module")
def view():
    return texture_view(RIG, POSE, clear_mask(RIG, POSE))


def shown(view, texture, R):
    """The contrast of a ball with a texture at an attitude, each pixel as its sample; (h, w) of the window."""
    picture = np.zeros(view.inside.shape, np.float32)
    d = view.direction.reshape(-1, 3).astype(float)
    on_ball = np.isfinite(d[:, 0])
    values = np.zeros(len(d), np.float32)
    values[on_ball] = texture(d[on_ball] @ R)
    picture[:: view.step, :: view.step] = values.reshape(view.direction.shape[:2])
    return picture


def painted(view, texture, weight=5.0):
    """The picture of a texture, each cell as its direction."""
    picture = empty_picture(view)
    n = view.cells
    x = np.array([twins.direction_of(*cell, n) for cell in np.ndindex(6, n, n)])
    picture.value[:] = texture(x / np.linalg.norm(x, axis=1, keepdims=True)).reshape(6, n, n)
    picture.weight[:] = weight
    return picture


def of_samples(view, seen):
    """Contrast, (k,), and directions, (k, 3), of the samples on the ball."""
    d = view.direction.reshape(-1, 3).astype(float)
    on_ball = np.isfinite(d[:, 0])
    return seen.contrast[:: view.step, :: view.step].ravel()[on_ball].astype(float), d[on_ball], on_ball


@pytest.mark.parametrize("n", [32, 64, 248])
def test_a_cell_lies_where_its_direction_is(n):
    rng = np.random.default_rng(n)
    x = rng.normal(size=(500, 3))
    face, row, column = twins.place_on(x, n)
    back = np.array([twins.direction_of(*cell, n) for cell in zip(face, row, column, strict=True)])
    assert np.allclose(back / np.linalg.norm(back, axis=1, keepdims=True), x / np.linalg.norm(x, axis=1, keepdims=True))
    assert row.min() >= 0.0  # a cell has neighbours on its own face, beyond the edges too
    assert row.max() < n - 1
    assert column.max() < n - 1


def test_anchors_are_spread_evenly_and_each_tile_belongs_to_the_nearest(view):
    anchors = anchor_directions()
    angle = np.degrees(np.arccos(np.clip(anchors @ anchors.T - 2.0 * np.eye(42), -1.0, 1.0))).min(axis=1)
    assert anchors.shape == (42, 3)
    assert angle.min() > 31.0
    assert angle.max() < 38.0
    nearest = np.argmax(tile_directions(view.cells).reshape(-1, 3) @ anchors.T, axis=1)
    assert np.array_equal(view.anchor_of.ravel(), nearest)


@pytest.mark.parametrize("coarse", [1, 2, 4])
def test_a_sample_shows_the_direction_that_its_pixel_sees(coarse):
    view = texture_view(RIG, POSE, clear_mask(RIG, POSE), coarse)
    row, column = np.nonzero(np.isfinite(view.direction[..., 0]))
    uv = seen_at(view.direction[row, column].astype(float), RIG, POSE)
    corner = view.window[1].start, view.window[0].start
    pixel = (np.stack([column, row], axis=1) * view.step + 0.5) * view.reduction - 0.5 + corner
    assert np.abs(uv - pixel).max() < 1e-3


def test_contrast_is_that_of_the_ball_and_not_of_the_light(view):
    """Twice the light, and light that falls off by a half over the ball, change a contrast by less than 0.03."""
    rng = np.random.default_rng(0)
    height, width = RIG.camera.height, RIG.camera.width
    albedo = 0.7 + 0.3 * (cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 2.0) > 0.0)
    slope = np.linspace(1.0, 0.5, width)
    even, twice, sloped = (
        contrast_of(view, np.rint(light * albedo).astype(np.uint8)) for light in (100.0, 200.0, 200.0 * slope)
    )
    assert np.abs(even).max() > 0.1
    assert np.abs(twice - even).max() < 0.03
    assert np.abs(sloped - twice).max() < 0.03
    assert np.abs(contrast_of(view, np.full((height, width), 130, np.uint8))).max() < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_alignment_finds_the_attitude_and_its_twin_the_same(view, seed):
    rng = np.random.default_rng(seed)
    texture, R = waves(rng), exp(rng.normal(size=3))
    contrast = shown(view, texture, R) + rng.normal(0.0, NOISE, view.inside.shape).astype(np.float32)
    seen, picture = without_before(first_seen(view, contrast)), painted(view, texture)
    start = exp(rng.normal(0.0, 0.02, 3)) @ R
    found = align(view, seen, picture, start, NOISE)
    q, d, _ = of_samples(view, seen)
    twin, scale, correlation, information = twins.align(
        q, d, (picture.value.astype(float), picture.weight.astype(float)), start, NOISE, 0.15 * view.pixel, view.pixel
    )
    assert found.converged
    assert np.linalg.norm(log(found.attitude @ R.T)) < 5e-3  # noise, and values between the cells
    assert np.linalg.norm(log(found.attitude @ twin.T)) < 2e-4  # it stops a step earlier, and has single precision
    assert found.scale == pytest.approx(scale, rel=0.02)
    assert found.correlation == pytest.approx(correlation, abs=5e-3)
    assert np.allclose(found.information.sum(axis=0), information, rtol=0.03, atol=0.01 * information.max())
    assert found.pixels.sum() <= found.used


def test_the_covariance_of_an_alignment_is_the_scatter_of_alignments(view):
    rng = np.random.default_rng(5)
    texture, R = waves(rng), exp(np.array([0.3, -0.2, 0.5]))
    clear, picture, squares = shown(view, texture, R), painted(view, texture, 50.0), []
    exact = align(view, without_before(first_seen(view, clear)), picture, R, NOISE).attitude
    for _ in range(60):
        noisy = clear + rng.normal(0.0, 2.0 * NOISE, clear.shape).astype(np.float32)
        found = align(view, without_before(first_seen(view, noisy)), picture, R, NOISE)
        e = log(found.attitude @ exact.T)
        squares.append(e @ found.information.sum(axis=0) @ e)
    assert 1.5 < np.mean(squares) < 5.0  # 3 with the right covariance; Cauchy's weights state a little more


def test_an_empty_picture_and_a_plain_ball_align_with_nothing(view):
    flat = without_before(first_seen(view, np.zeros(view.inside.shape, np.float32)))
    assert not align(view, flat, empty_picture(view), np.eye(3), NOISE).converged
    assert not align(view, flat, painted(view, lambda x: np.zeros(len(x))), np.eye(3), NOISE).converged


@pytest.mark.parametrize("seed", range(3))
def test_correlation_is_one_at_the_attitude_and_its_twin_the_same(view, seed):
    rng = np.random.default_rng(seed)
    texture, R = waves(rng), exp(rng.normal(size=3))
    seen, picture = first_seen(view, shown(view, texture, R)), painted(view, texture)
    attitudes = np.stack([R, *(exp(rng.normal(size=3)) for _ in range(20))])
    q, d, _ = of_samples(view, seen)
    found = correlate(view, seen, picture, attitudes, len(q))
    assert np.allclose(found, [twins.correlate(q, d, picture[:2], A) for A in attitudes], atol=2e-3)
    assert found[0] > 0.97
    assert found[1:].max() < 0.7
    part = correlate(view, seen, picture, attitudes, 200)
    assert np.argmax(part) == 0


def test_learning_has_the_mean_of_the_views_and_its_twin_the_same(view):
    rng = np.random.default_rng(2)
    small = replace(view, cells=32, anchor_of=np.zeros((6, 4, 4), np.int64))
    contrast = cv2.GaussianBlur(rng.normal(0.0, 1.0, view.inside.shape), (0, 0), 3.0).astype(np.float32)
    seen = first_seen(small, contrast)
    seen.odds[rng.uniform(size=seen.odds.shape) < 0.1] = -5.0
    picture = empty_picture(small)
    for R in (np.eye(3), exp(np.array([0.4, 0.2, -0.3]))):
        value, weight = twins.learn(small, seen, picture, R, 1.5)
        picture = learn(small, seen, picture, R, 1.5)
        assert np.allclose(picture.weight, weight, atol=1e-5)
        assert np.allclose(picture.value, value, atol=1e-4)
    assert picture.weight.max() == pytest.approx(1.5)
    assert np.allclose(picture.known, picture.weight.reshape(6, 4, 8, 4, 8).mean(axis=(2, 4)), atol=1e-5)


def test_a_picture_forgets_what_it_took_from_pixels_that_stand_still(view):
    rng = np.random.default_rng(3)
    seen = first_seen(view, shown(view, waves(rng), np.eye(3)))
    picture = learn(view, seen, empty_picture(view), np.eye(3), 20.0)
    seen.odds[: len(seen.odds) // 2] = -5.0
    kept = learn(view, seen, picture, np.eye(3), 20.0, forget=True)
    assert 0.3 < np.count_nonzero(kept.weight) / np.count_nonzero(picture.weight) < 0.7
    assert np.array_equal(kept.weight[kept.weight > 0.0], picture.weight[kept.weight > 0.0])


@pytest.mark.parametrize("turns", [True, False])
def test_odds_tell_what_turns_from_what_stays_and_its_twin_the_same(view, turns):
    rng = np.random.default_rng(4)
    texture = waves(rng)
    picture, R = painted(view, texture), exp(np.array([0.0, 0.3, 0.0]))
    seen = first_seen(view, shown(view, texture, np.eye(3)))
    seen = seen._replace(contrast=shown(view, texture, R) if turns else seen.contrast)
    after = weigh(view, seen, picture, R, NOISE, -1)
    q, d, on_ball = of_samples(view, seen)
    mean, odds = twins.weigh(q, d, picture[:2], R, seen.mean.ravel()[on_ball], seen.odds.ravel()[on_ball], NOISE, 0.2)
    assert np.allclose(after.mean.ravel()[on_ball], mean, atol=1e-5)
    assert np.mean(np.isclose(after.odds.ravel()[on_ball], odds, atol=0.02)) > 0.99  # but at the limits
    assert np.mean(after.odds.ravel()[on_ball] * (1.0 if turns else -1.0) > 0.0) > 0.8


def test_wrong_arrays_are_named(view):
    seen, picture = first_seen(view, np.zeros(view.inside.shape, np.float32)), empty_picture(view)
    samples = (seen.contrast, view.direction, seen.odds, seen.before, view.step)
    for at, name in enumerate(("contrast", "direction", "odds", "before")):
        wrong = (*samples[:at], samples[at].astype(np.float64), *samples[at + 1 :])
        with pytest.raises(TypeError, match=name):
            kernels.correlate_texture(wrong, picture[:2], np.eye(3)[None], 10)
    with pytest.raises(TypeError, match="odds"):
        kernels.correlate_texture((*samples[:2], seen.odds[1:], *samples[3:]), picture[:2], np.eye(3)[None], 10)
    with pytest.raises(TypeError, match="value, weight"):
        kernels.correlate_texture(samples, (picture.value, picture.weight[:, 8:, 8:].copy()), np.eye(3)[None], 10)
    with pytest.raises(TypeError, match="known"):
        kernels.learn_texture(
            samples, picture[:2], picture.known[:, 1:].copy(), None, np.eye(3), (0.0, 0.0, 1.0), 1.0, -1, False
        )
