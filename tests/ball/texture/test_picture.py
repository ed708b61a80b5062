"""The picture of a ball's texture: geometry, contrast, and the native functions beside their NumPy twins."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from conftest import seeds

from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import view_of
from spheremouse.ball.texture.picture import (
    align,
    contrast_of_samples,
    correlate,
    empty_picture,
    first_seen,
    forget,
    is_symmetric,
    learn,
    measure_shift,
    seen_again,
    seen_with_skew,
    tiles_in_view,
    weigh,
    with_doubtful,
    with_skew,
)
from spheremouse.ball.texture.search import texture_detector
from spheremouse.ball.texture.view import TILE, anchor_directions, cell_directions
from spheremouse.geometry.camera import row_of
from spheremouse.geometry.rotation import exp, log
from spheremouse.native import kernels
from spheremouse.simulate.ball.scene import default_scene
from tests.ball.texture import painted, twins

NOISE = 0.01
SCENE = default_scene(1, width=160, height=120)
RIG, POSE = SCENE.rig(), SCENE.pose
DETECTOR = texture_detector(RIG, POSE)


def waves(rng, count=40):
    """A function of directions, (n, 3): a texture with details of 10 degrees."""
    k, phase = rng.normal(size=(count, 3)) * 12.0, rng.uniform(0.0, 2.0 * np.pi, count)
    return lambda x: np.sin(x @ k.T + phase).sum(axis=1) * 0.2 / np.sqrt(count)


def rings(x):
    """A texture that a rotation about z does not change."""
    return 0.2 * np.sin(12.0 * x[:, 2])


@pytest.fixture(scope="module")
def view():
    return DETECTOR.fine


def shown(view, texture, R):
    """The contrast of a ball with a texture at an attitude, of each sample, (n,)."""
    return texture(directions(view) @ R).astype(np.float32)


def directions(view):
    """The directions of the samples, (n, 3)."""
    return view.direction.T.astype(float)


def picture_with(view, texture, weight=5.0):
    """The picture of a texture, each cell as its direction."""
    picture = empty_picture(view)
    picture.value[:] = texture(painted.cell_directions(view.cells).reshape(-1, 3)).reshape(picture.value.shape)
    picture.weight[:] = weight
    return picture


def test_anchors_are_spread_evenly_and_each_tile_belongs_to_the_nearest(view):
    anchors = anchor_directions()
    angle = np.degrees(np.arccos(np.clip(anchors @ anchors.T - 2.0 * np.eye(20), -1.0, 1.0))).min(axis=1)
    assert anchors.shape == (20, 3)
    assert angle.min() > 41.0
    assert angle.max() < 42.0
    nearest = np.argmax(cell_directions(view.cells // TILE).reshape(-1, 3) @ anchors.T, axis=1)
    assert np.array_equal(view.anchor_of.ravel(), nearest)


def test_a_pixel_of_the_chart_shows_its_direction_in_the_mean():
    """Towards the horizon, pixels see more and more of the ball. A mean about a pixel shows a place farther out."""
    fine, resample, rng = painted.DETECTOR.fine, painted.DETECTOR.resampling, np.random.default_rng(0)
    part = (np.arange(4) - 1.5) / 4.0  # by four by four rays to a pixel
    size = painted.RIG.camera.height, painted.RIG.camera.width
    v, u, dv, du = np.meshgrid(*(np.arange(n) for n in size), part, part, indexing="ij")
    uv = np.stack([u + du, v + dv], axis=-1).reshape(-1, 2).astype(float)
    found, index = directions_at(uv, painted.RIG, painted.POSE)
    d = fine.chart.directions()
    outside = (fine.chart.facing(d) > 0.4) & (fine.chart.facing(d) < 0.7) & (fine.inside > 0)
    d, towards = d[outside], fine.chart.axes[2]
    outward = (d @ towards)[:, None] * d - towards
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    middle = seen_at(d, painted.RIG, painted.POSE).astype(np.float32)
    shifts = []
    for _ in range(12):
        k, phase = rng.normal(size=3) * 3.0, rng.uniform(0.0, 6.0)
        light = np.zeros(len(uv))
        light[index] = np.sin(found @ k + phase)
        image = np.rint(127.0 + 120.0 * light.reshape(*size, 16).mean(axis=2)).astype(np.uint8)
        slope = np.cos(d @ k + phase) * (outward @ k)
        mean = cv2.blur(image, (resample.width,) * 2)
        plain = cv2.remap(mean, middle[None, :, 0], middle[None, :, 1], cv2.INTER_LINEAR)[0]
        for shown in (resample(image)[outside], plain):
            shifts.append((slope @ ((shown - 127.0) / 120.0 - np.sin(d @ k + phase)), slope @ slope))
    corrected, uncorrected = (np.divide(*np.sum(shifts[k::2], axis=0)) for k in (0, 1))
    assert uncorrected > 0.02 * fine.pixel
    assert abs(corrected) < 0.3 * uncorrected


def test_a_chart_has_the_grey_values_between_pixels_and_its_twin_the_same():
    rng = np.random.default_rng(0)
    image, uv = rng.integers(0, 256, (20, 30)).astype(np.uint8), rng.uniform(0.0, (29.0, 19.0), (500, 2))
    part = np.rint(kernels.PARTS * uv).astype(int)
    (column, row), (right, down) = (part // kernels.PARTS).T, (part % kernels.PARTS).T
    at, parts = (row * 30 + column).astype(np.int32), (down * kernels.PARTS + right).astype(np.uint16)
    inside = np.full((1, 500), 255, np.uint8)
    inside[0, :9] = inside[0, 100:110] = 0
    found = kernels.resample_chart(image, at[None], parts[None], inside)
    assert np.abs(found - (inside > 0) * twins.resample(image, part / kernels.PARTS)).max() < 0.501
    for wrong in (-1, image.size):
        with pytest.raises(IndexError, match="at"):
            kernels.resample_chart(image, np.full_like(at, wrong)[None], parts[None], inside)
    with pytest.raises(TypeError, match="inside"):
        kernels.resample_chart(image, at[None], parts[None], inside[:, 1:].copy())


@pytest.mark.parametrize("reach", [1, 2])
def test_contrast_on_a_chart_and_its_twin_the_same(reach):
    rng = np.random.default_rng(1)
    light, far = rng.integers(0, 256, (24, 24)).astype(np.uint8), rng.uniform(50.0, 200.0, (6, 6)).astype(np.float32)
    inside = np.tile(255 * (np.abs(np.arange(24) - 12.0) < 9.0), (24, 1)).astype(np.uint8)
    inside[:2] = 0
    light &= inside
    found, twin = kernels.contrast_on_chart(light, inside, far, reach), twins.contrast(light, inside, far, reach)
    assert np.allclose(found, twin, atol=1e-5)
    at = np.flatnonzero(inside)[::3].astype(np.int32)
    assert np.allclose(kernels.contrast_of_samples(light, at, far, reach), twin.ravel()[at], atol=1e-5)
    for given in ((light, inside[1:], far), (light, inside, far[1:].copy()), (light, inside, far[:0])):
        with pytest.raises(TypeError, match="must have"):
            kernels.contrast_on_chart(*given, reach)
    with pytest.raises(IndexError, match="reach"):
        kernels.contrast_on_chart(light, inside, far, 3)
    for wrong in (-1, light.size):
        with pytest.raises(IndexError, match="at"):
            kernels.contrast_of_samples(light, np.full_like(at, wrong), far, reach)


def test_anchors_in_view_are_points_and_their_twin_the_same(view):
    rng = np.random.default_rng(6)
    texture, R = waves(rng), exp(rng.normal(size=3))
    found = align(view, first_seen(view, shown(view, texture, R)), picture_with(view, texture), R, NOISE)
    towards = view.chart.axes[2].copy()
    facing, errors = (towards, 0.3), (0.005, 0.01, 1e-4, 0.0)
    ball = view_of(view.rig, view.pose)
    given = view.anchors, found.attitude, found.information, found.gradient
    assert np.allclose(found.known, np.eye(3), atol=1e-9)
    place, covariance, which = kernels.anchor_points(*given, errors, found.known, facing, ball)
    twin = twins.anchor_points(view, found, facing, errors)
    assert len(which) > 4
    assert np.array_equal(which, twin[2])
    assert np.allclose(place, twin[0], atol=1e-9)
    assert np.allclose(covariance, twin[1], rtol=1e-6)
    with pytest.raises(TypeError, match="gradient"):
        kernels.anchor_points(*given[:3], given[3][1:].copy(), errors, found.known, facing, ball)


def moved(view, centre):
    """Directions, (n, 3), that the samples of a ball with its centre off by `centre`, (3,) m, show: by its surface."""
    place = RIG.ball.centre + RIG.ball.radius * directions(view) - POSE.position
    ray = place / np.linalg.norm(place, axis=1, keepdims=True)
    to = POSE.position - RIG.ball.centre - centre
    along = -ray @ to - np.sqrt((ray @ to) ** 2 - to @ to + RIG.ball.radius**2)
    return (to + along[:, None] * ray) / RIG.ball.radius


@pytest.mark.parametrize("seed", seeds(2, 4))
def test_a_pattern_shows_the_place_of_a_centre_that_has_moved_and_its_twin_the_same(view, seed):
    """The attitude alone explains most of 5 mm, with an error of 0.4°."""
    rng = np.random.default_rng(seed)
    texture, R = waves(rng), exp(rng.normal(size=3))
    axes = view.chart.axes[:2]
    centre = 5e-3 * exp(rng.uniform(-np.pi, np.pi) * view.chart.axes[2]) @ axes[0]
    contrast = texture(moved(view, centre) @ R) + rng.normal(0.0, NOISE, len(view.at))
    seen, picture = first_seen(view, contrast.astype(np.float32)), picture_with(view, texture)
    alone = align(view, seen, picture, R, NOISE)
    assert np.degrees(np.linalg.norm(log(alone.attitude @ R.T))) > 0.3
    found = measure_shift(view, seen, picture, alone.attitude, NOISE)
    error = found.axes @ found.place - centre
    assert np.linalg.norm(error) < 1.5e-3
    assert (found.axes.T @ error) @ np.linalg.solve(found.covariance, found.axes.T @ error) < 12.0
    cells = picture.value.astype(float), picture.weight.astype(float)
    camera = (POSE.position - RIG.ball.centre) / RIG.ball.radius
    given = seen.contrast.astype(float), directions(view), cells, alone.attitude, NOISE, 0.1 * view.pixel, view.pixel
    twin, covariance = twins.shift(*given, camera, axes)
    assert np.allclose(found.place, RIG.ball.radius * twin, atol=1e-4)
    assert np.allclose(found.scatter, 8.0 * RIG.ball.radius**2 * covariance, rtol=0.06)


def test_a_pattern_in_its_place_shows_no_shift_and_a_plain_ball_none_at_all(view):
    rng = np.random.default_rng(5)
    texture, R = waves(rng), exp(rng.normal(size=3))
    contrast = shown(view, texture, R) + rng.normal(0.0, NOISE, len(view.at)).astype(np.float32)
    seen = first_seen(view, contrast)
    found = measure_shift(view, seen, picture_with(view, texture), R, NOISE)
    assert found.place @ np.linalg.solve(found.covariance, found.place) < 2.0
    unknown = measure_shift(view, seen, empty_picture(view), R, NOISE)
    assert not unknown.place.any()
    assert np.all(unknown.scatter.diagonal() > RIG.ball.radius**2)


def test_anchors_of_a_pattern_of_rings_have_no_place_along_them_and_their_twin_the_same(view):
    """Their rows of the information about the axis of the rings sum to nothing, and they are known across them."""
    rng = np.random.default_rng(8)
    R = exp(rng.normal(size=3))
    contrast = shown(view, rings, R) + rng.normal(0.0, NOISE, len(view.at)).astype(np.float32)
    picture = picture_with(view, rings)
    found = align(view, first_seen(view, contrast), picture, R, NOISE)
    axis = R[:, 2]
    assert np.trace(found.known) == pytest.approx(2.0)
    assert axis @ found.known @ axis < 0.01
    cells = picture.value.astype(float), picture.weight.astype(float)
    *_, known = twins.align(contrast, directions(view), cells, R, NOISE, 0.1 * view.pixel, view.pixel)
    assert np.allclose(found.known, known, atol=0.03)
    towards, errors, ball = view.chart.axes[2].copy(), (0.005, 0.01, 1e-4, 0.02), view_of(view.rig, view.pose)
    given = view.anchors, found.attitude, found.information, found.gradient, errors, found.known, (towards, 0.3), ball
    place, covariance, which = kernels.anchor_points(*given)
    twin = twins.anchor_points(view, found, (towards, 0.3), errors)
    assert np.array_equal(which, twin[2])
    assert np.allclose(place, twin[0], atol=1e-6)
    assert np.allclose(covariance, twin[1], rtol=1e-4)
    least, most = np.sqrt(np.linalg.eigvalsh(covariance)).T
    assert np.all(most > 20.0)  # px: half a radian and more
    assert np.all(least < 3.0)


SKEW = np.array([0.05, -0.08, 0.03])  # rad over all rows: 400 °/s, read out in 15 ms


def rolling(view, skew=SKEW):
    """The turn of the ball, (n, 3, 3), from the stamp to the exposure of each sample by a rolling shutter."""
    row = row_of(seen_at(directions(view), view.rig, view.pose)[:, 1], view.rig.camera.height)
    return exp(row[:, None] * skew)


def test_a_rolling_shutter_shows_each_sample_where_the_ball_has_turned_to(view):
    then = rolling(view)
    at_stamp = np.einsum("nij,ni->nj", then, directions(view))
    seen = with_skew(view, first_seen(view, np.zeros(len(view.at), np.float32)), SKEW)
    assert np.allclose(seen.direction.T, at_stamp, atol=1e-4)  # a fortieth of a pixel
    still = with_skew(view, seen, np.full(3, 1e-3))
    assert np.array_equal(still.direction, view.direction)


def test_a_frame_of_a_rolling_shutter_gives_the_attitude_at_its_stamp(view):
    rng = np.random.default_rng(9)
    texture, R = waves(rng), exp(rng.normal(size=3))
    contrast = texture(np.einsum("nij,ni->nj", rolling(view), directions(view)) @ R).astype(np.float32)
    seen, picture = first_seen(view, contrast), picture_with(view, texture)
    errors = [
        np.degrees(np.linalg.norm(log(align(view, s, picture, R, NOISE).attitude @ R.T)))
        for s in (seen, with_skew(view, seen, SKEW))
    ]
    assert errors[1] < 0.05
    assert errors[0] > 0.4


def test_a_rolling_shutter_shows_a_point_where_it_has_turned_to():
    rng = np.random.default_rng(10)
    b = rng.normal(size=(20, 3))
    b = b[b @ DETECTOR.fine.chart.axes[2] > 0.6 * np.linalg.norm(b, axis=1)]
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    at_stamp = seen_at(b, RIG, POSE)
    seen = seen_with_skew(at_stamp, RIG, POSE, SKEW)
    row = row_of(seen[:, 1], RIG.camera.height)
    assert np.allclose(seen, seen_at(np.einsum("nij,nj->ni", exp(row[:, None] * SKEW), b), RIG, POSE), atol=0.02)
    outside = np.array([[1.0, 1.0]])
    assert np.array_equal(seen_with_skew(outside, RIG, POSE, SKEW), outside)


def test_a_picture_learns_from_a_rolling_shutter_what_the_ball_shows(view):
    """The chart of the frame is the texture as each row shows it."""
    rng = np.random.default_rng(11)
    texture, R = waves(rng), exp(rng.normal(size=3))
    x = view.chart.directions()
    inside = np.isfinite(x[..., 0])
    row = row_of(seen_at(x[inside], RIG, POSE)[:, 1], RIG.camera.height)
    chart = np.zeros(view.inside.shape, np.float32)
    chart[inside] = texture(np.einsum("nij,ni->nj", exp(row[:, None] * SKEW), x[inside]) @ R)
    seen, tiles = first_seen(view, np.zeros(len(view.at), np.float32)), tiles_in_view(view, R)
    errors = []
    for turn in (np.zeros(3), SKEW):
        learnt = learn(view, with_skew(view, seen, turn), chart, empty_picture(view), R, tiles)
        known = learnt.weight > 0.5
        errors.append(np.std(learnt.value[known] - texture(cell_directions(view.cells)[known])))
    assert errors[1] < 0.3 * errors[0]


def test_the_coarse_chart_has_the_mean_of_four_by_four_pixels():
    fine, coarse = DETECTOR.fine.chart.directions(), DETECTOR.coarse.chart.directions()
    n = DETECTOR.coarse.chart.size
    mean = fine.reshape(n, 4, n, 4, 3).mean(axis=(1, 3))
    seen = np.isfinite(mean[..., 0])
    assert np.count_nonzero(seen) > 0.9 * np.count_nonzero(np.isfinite(coarse[..., 0]))
    mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
    assert np.abs(mean - coarse)[seen].max() < 0.1 * DETECTOR.coarse.pixel


def test_contrast_is_that_of_the_ball_and_not_of_the_light():
    """Twice the light, and light that falls off by a half over the ball, change a contrast by less than 0.03."""
    rng = np.random.default_rng(0)
    height, width = RIG.camera.height, RIG.camera.width
    albedo = 0.7 + 0.3 * (cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 2.0) > 0.0)
    slope = np.linspace(1.0, 0.5, width)

    def contrast(image):
        return contrast_of_samples(DETECTOR.fine, DETECTOR.light(np.rint(image).astype(np.uint8))[0][0])

    even, twice, sloped = (contrast(light * albedo) for light in (100.0, 200.0, 200.0 * slope))
    assert np.abs(even).max() > 0.1
    assert np.abs(twice - even).max() < 0.03
    assert np.abs(sloped - twice).max() < 0.03
    assert np.abs(contrast(np.full((height, width), 130.0))).max() < 1e-4


@pytest.mark.parametrize("seed", seeds(2, 4))
def test_alignment_finds_the_attitude_and_its_twin_the_same(view, seed):
    rng = np.random.default_rng(seed)
    texture, R = waves(rng), exp(rng.normal(size=3))
    contrast = shown(view, texture, R) + rng.normal(0.0, NOISE, len(view.at)).astype(np.float32)
    seen, picture = first_seen(view, contrast), picture_with(view, texture)
    start = exp(rng.normal(0.0, 0.02, 3)) @ R
    found = align(view, seen, picture, start, NOISE)
    q, d = seen.contrast.astype(float), directions(view)
    twin, scale, correlation, information, known = twins.align(
        q, d, (picture.value.astype(float), picture.weight.astype(float)), start, NOISE, 0.1 * view.pixel, view.pixel
    )
    assert found.converged
    assert np.linalg.norm(log(found.attitude @ R.T)) < 5e-3  # noise, and values between the cells
    assert np.linalg.norm(log(found.attitude @ twin.T)) < 2e-4  # it stops a step earlier, and has single precision
    assert found.scale == pytest.approx(scale, rel=0.06)  # three standard deviations of a median of 2000
    assert found.correlation == pytest.approx(correlation, abs=5e-3)
    assert np.allclose(found.information.sum(axis=0), information, rtol=0.12, atol=0.01 * information.max())
    assert np.allclose(found.known, known, atol=1e-9)
    assert found.pixels.sum() <= found.used


def test_the_covariance_of_an_alignment_is_the_scatter_of_alignments(view):
    rng = np.random.default_rng(5)
    texture, R = waves(rng), exp(np.array([0.3, -0.2, 0.5]))
    clear, picture, squares = shown(view, texture, R), picture_with(view, texture, 50.0), []
    exact = align(view, first_seen(view, clear), picture, R, NOISE).attitude
    for _ in range(60):
        noisy = clear + rng.normal(0.0, 2.0 * NOISE, clear.shape).astype(np.float32)
        found = align(view, first_seen(view, noisy), picture, R, NOISE)
        e = log(found.attitude @ exact.T)
        squares.append(e @ found.information.sum(axis=0) @ e)
    assert 1.5 < np.mean(squares) < 5.0  # 3 with the right covariance; robust weights state a little more


def test_an_empty_picture_and_a_plain_ball_align_with_nothing(view):
    flat = first_seen(view, np.zeros(len(view.at), np.float32))
    assert not align(view, flat, empty_picture(view), np.eye(3), NOISE).converged
    assert not align(view, flat, picture_with(view, lambda x: np.zeros(len(x))), np.eye(3), NOISE).converged


@pytest.mark.parametrize("seed", range(3))
def test_correlation_is_one_at_the_attitude_and_its_twin_the_same(view, seed):
    rng = np.random.default_rng(seed)
    texture, R = waves(rng), exp(rng.normal(size=3))
    seen, picture = first_seen(view, shown(view, texture, R)), picture_with(view, texture)
    attitudes = np.stack([R, *(exp(rng.normal(size=3)) for _ in range(20))])
    q, d = seen.contrast.astype(float), directions(view)
    found = correlate(seen, picture, attitudes, len(q))
    assert np.allclose(found, [twins.correlate(q, d, picture[:2], A) for A in attitudes], atol=2e-3)
    assert found[0] > 0.97
    assert found[1:].max() < 0.7
    part = correlate(seen, picture, attitudes, 200)
    assert np.argmax(part) == 0


def test_learning_has_the_mean_of_the_views_and_its_twin_the_same(view):
    rng = np.random.default_rng(2)
    small = replace(view, cells=32, anchor_of=np.zeros((6, 4, 4), np.int64))
    tiles = np.arange(6 * 4 * 4)
    contrast = cv2.GaussianBlur(rng.normal(0.0, 1.0, view.inside.shape), (0, 0), 3.0).astype(np.float32)
    seen = first_seen(small, np.zeros(len(view.at), np.float32))
    least = np.where(rng.uniform(size=seen.odds.shape) < 0.1, -5.0, 0.0).astype(np.float32)
    offset = rng.normal(0.0, 0.1, seen.odds.shape).astype(np.float32)
    seen = seen._replace(counts=least, offset=offset)
    picture = empty_picture(small)
    picture.weight[:] = 19.0
    for R in (np.eye(3), exp(np.array([0.4, 0.2, -0.3]))):
        value, weight = twins.learn(small, seen, contrast, picture, R, 20.0)
        picture = learn(small, seen, contrast, picture, R, tiles)
        assert np.allclose(picture.weight, weight, atol=1e-5)
        assert np.allclose(picture.value, value, atol=1e-4)
    assert picture.weight.max() == pytest.approx(20.0)
    assert np.allclose(picture.known, picture.weight.reshape(6, 4, 8, 4, 8).mean(axis=(2, 4)), atol=1e-5)


def test_a_picture_forgets_what_it_took_from_pixels_that_stand_still(view):
    rng = np.random.default_rng(3)
    seen = first_seen(view, shown(view, waves(rng), np.eye(3)))
    contrast = rng.normal(0.0, 0.1, view.inside.shape).astype(np.float32)
    picture = learn(view, seen, contrast, empty_picture(view), np.eye(3), tiles_in_view(view, np.eye(3)))
    least = seen.least.copy()
    least[: len(least) // 2] = -5.0
    kept = forget(view, seen._replace(counts=least), picture, np.eye(3))
    assert 0.3 < np.count_nonzero(kept.weight) / np.count_nonzero(picture.weight) < 0.7
    assert np.array_equal(kept.weight[kept.weight > 0.0], picture.weight[kept.weight > 0.0])


@pytest.mark.parametrize("turns", [True, False])
def test_odds_tell_what_turns_from_what_stays_and_its_twin_the_same(view, turns):
    rng = np.random.default_rng(4)
    texture = waves(rng)
    picture, R = picture_with(view, texture), exp(np.array([0.0, 0.3, 0.0]))
    seen = first_seen(view, shown(view, texture, np.eye(3)))
    seen = seen._replace(contrast=shown(view, texture, R) if turns else seen.contrast)
    after = weigh(view, seen, picture, R, NOISE, 0.02)
    before = seen.mean, seen.odds, seen.offset
    q, d = seen.contrast.astype(float), directions(view)
    mean, odds, offset = twins.weigh(q, d, picture[:2], R, before, NOISE, 0.02)
    assert np.allclose(after.mean, mean, atol=1e-5)
    assert np.allclose(after.offset, offset, atol=1e-5)
    assert np.mean(np.isclose(after.odds, odds, atol=0.02)) > 0.99  # but at the limits
    assert np.mean(after.odds * (1.0 if turns else -1.0) > 0.0) > 0.8


def test_what_stands_still_is_left_out_with_its_neighbourhood_but_a_single_sample_is_not(view):
    seen = first_seen(view, shown(view, waves(np.random.default_rng(0)), np.eye(3)))
    row, column = np.array(view.number.shape) // 2
    for size, out in ((1, 0), (5, None)):
        odds = np.zeros_like(seen.odds)
        odds[view.number[row : row + size, column : column + size]] = -10.0
        after = weigh(view, seen._replace(odds=odds), empty_picture(view), np.eye(3), NOISE)
        left = np.count_nonzero(after.least < -3.0)
        assert left == out if out is not None else left > size**2


def test_a_detail_that_shows_the_same_as_in_the_first_frame_is_in_doubt_until_it_is_known_to_turn(view):
    rng = np.random.default_rng(8)
    first = first_seen(view, shown(view, waves(rng), np.eye(3)))
    changed = shown(view, waves(rng), np.eye(3))
    changed[: len(changed) // 2] = first.contrast[: len(changed) // 2]
    now = seen_again(view, first, changed, NOISE)
    twin = twins.leave_out_doubtful(changed, first.first, first.odds, first.least, 3.0 * NOISE, 2.0 * NOISE)
    assert np.array_equal((now.counts, now.turning), twin)
    upper = np.arange(len(changed)) < len(changed) // 2
    detail = np.abs(changed) > 3.0 * NOISE
    differs = np.abs(changed - first.first) > 4.0 * NOISE
    assert np.all(np.isneginf(now.counts[detail & upper]))
    assert np.all(now.counts[~upper & differs | (np.abs(changed) < NOISE)] == 0.0)
    proven = seen_again(view, first._replace(odds=np.full_like(first.odds, 4.0)), changed, NOISE)
    assert np.array_equal(proven.counts, with_doubtful(now).counts)
    assert np.all(proven.counts == 0.0)


def test_the_contrast_of_light_is_learnt_while_the_ball_turns(view):
    """A shadow's edge that stands still is in each frame; the pattern below it changes."""
    rng = np.random.default_rng(7)
    texture = waves(rng)
    picture, seen = picture_with(view, texture), first_seen(view, shown(view, texture, np.eye(3)))
    light = (0.03 * np.sin(np.nonzero(view.number >= 0)[1] * 0.5)).astype(np.float32)
    for _ in range(400):
        R = exp(rng.normal(size=3))
        contrast = shown(view, texture, R) + light
        seen = weigh(view, seen._replace(contrast=contrast), picture, R, NOISE, 0.02)
    rest = seen.offset - light
    assert rest.std() < 0.2 * light.std()


def test_a_pattern_is_symmetric_if_all_frames_hide_the_same_axis_of_the_ball():
    def shown(axes):
        return sum(np.eye(3) - np.outer(a, a) / (a @ a) for a in axes)

    rng = np.random.default_rng(3)
    scattered = np.array([0.0, 0.0, 1.0]) + np.pad(rng.normal(size=(50, 2)), ((0, 0), (0, 1))) * 0.01
    assert is_symmetric(shown(scattered))  # by 0.6° about each axis, as measured ones of stripes
    assert not is_symmetric(shown(scattered) + np.eye(3))  # one frame of all axes
    assert not is_symmetric(shown(np.array([0.0, 0.0, 1.0]) + 0.1 * rng.normal(size=(50, 3))))
    assert not is_symmetric(np.zeros((3, 3)))  # no path yet
