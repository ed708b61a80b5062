"""Likelihood: greatest at the truth, no gain by hidden points, curvature of the refinement, outline, glare."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from experiments.kit.balls import contrast_ball

from spheremouse.geometry.camera import InteriorOrientation, project, project_sphere
from spheremouse.geometry.rotation import exp, log
from spheremouse.native import kernels
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.colour import DEFAULT_COLOURS, colour_fields
from spheremouse.wand.likelihood import (
    DIRECTIONS,
    disc_weights,
    log_likelihood,
    measure_edges,
    outline_log_likelihood,
    refine_pose,
    support,
)
from spheremouse.wand.model import ball_model
from spheremouse.wand.published.track import log_product
from tests.wand import twins

BALL = grzonka_ball()
DISCS = np.array([[*d.direction, d.angle] for d in BALL.discs])
NONE = np.zeros((DIRECTIONS, 5))


@pytest.fixture(scope="module")
def view():
    """Return fields, model, position, rotation and picture of a frame from the independent renderer."""
    film = prepare_wand(WandOptions(motion="hand", seed=2, seconds=0.1, size=(640, 480), focal=1000.0, distance=1.6))
    shot = next(iter(simulate_wand(film)))
    m = ball_model(BALL, film.scene.camera)
    return (
        colour_fields(shot.frame.image, DEFAULT_COLOURS, BALL.colours),
        m,
        shot.position[0],
        shot.rotation[0],
        shot.frame.image,
    )


def image_of(disc, view, reach):
    """Return the pixels, (h, w), of a disc's image of `reach` times its size."""
    seen, m, p, R, _ = view
    x, y, z = p + BALL.radius * R @ disc.direction
    rows, columns = np.mgrid[: seen.weight.shape[1], : seen.weight.shape[2]]
    square = (columns - m.lens[0] * x / z - m.lens[2]) ** 2 + (rows - m.lens[1] * y / z - m.lens[3]) ** 2
    return square < (reach * disc.angle * BALL.radius * m.lens[0] / p[2]) ** 2


def values(view, position, rotation, weigh=log_likelihood):
    seen, m, *_ = view
    return weigh(np.atleast_2d(position), np.reshape(rotation, (-1, 3, 3)), m, seen)


def test_the_true_pose_has_the_greatest_likelihood(view):
    """On each axis, among thousands of attitudes, beside the ball, and against the bare side.

    There the thesis' product over no points would be one.
    """
    _, _, p, R, _ = view
    (value,), (match,) = values(view, p, R)
    assert match > 0.9
    rng = np.random.default_rng(0)
    v = rng.normal(size=(3000, 3))
    turned = exp(v / np.linalg.norm(v, axis=1)[:, None] * rng.uniform(0.3, np.pi, (3000, 1))) @ R
    assert value > values(view, np.repeat(p[None], 3000, 0), turned)[0].max() + 20
    for step in np.eye(3) * [0.008, 0.008, 0.1]:
        assert max(values(view, p + s * step, R)[0][0] for s in (-1, 1)) < value - 10
    assert values(view, p + np.array([0.25, 0.0, 0.0]), R)[0][0] < 10
    away = exp(np.array([np.pi, 0.0, 0.0])) @ R
    other, match = values(view, p, away)
    assert other[0] < value - 50
    assert match[0] < 0.5
    assert values(view, p, away, log_product)[0][0] < values(view, p, R, log_product)[0][0]


@pytest.mark.parametrize("outlined", [False, True])
def test_refinement_finds_the_peak_and_its_curvature(view, outlined):
    """The mean loss of log-likelihood over samples of the peak's Gaussian is 6 / 2."""
    seen, m, p, R, image = view
    edges = measure_edges(image, p, R, DISCS, m, seen.factor) if outlined else NONE

    def total(position, rotation):
        position = np.atleast_2d(position)
        outline = outline_log_likelihood(position, np.zeros(len(position), np.int64), edges[None], m, seen.factor)
        return values(view, position, rotation)[0] + outline

    rng = np.random.default_rng(1)
    start = p + np.array([0.002, -0.002, 0.03])
    peak = refine_pose(start, exp(np.array([0.08, -0.06, 0.05])) @ R, m, seen, edges, 8)
    peak = refine_pose(peak.position, peak.rotation, m, seen, edges, 3)
    assert np.linalg.norm(log(peak.rotation @ R.T)) < np.deg2rad(2.5)
    assert np.all(np.abs(peak.position - p) < [0.002, 0.002, 0.02 if outlined else 0.05])
    d = rng.standard_normal((3000, 6)) @ np.linalg.cholesky(peak.covariance).T
    moved = total(peak.position + d[:, :3], exp(d[:, 3:]) @ peak.rotation)
    assert 1.5 < (total(peak.position, peak.rotation) - moved).mean() < 6.0


def test_outline_equals_that_of_the_projected_sphere():
    camera = InteriorOrientation(1280, 960, 900.0, 900.0, 640.0, 480.0)
    c = np.array([0.3, -0.2, 0.8])
    centre, shape = project_sphere(c, 0.05)
    points = twins.outline(c, 0.05)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.05)
    for uv in project(c + points, camera)[0]:
        xy = (uv - [640, 480]) / 900.0 - centre
        assert xy @ np.linalg.solve(shape, xy) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("factor", [1, 2])
def test_measured_edges_lie_on_the_true_outline(view, factor):
    """The predicted ball is 3 % too close."""
    _, m, p, R, image = view
    found = measure_edges(image, 0.97 * p, R, DISCS, m, factor)
    good = found[:, 4] > 0
    assert good.sum() >= 8
    camera = InteriorOrientation(640, 480, *m.lens[:4], m.lens[4:])
    outline = project(p + twins.outline(p, BALL.radius), camera)[0]
    r = np.sum((found[:, :2] - outline) * found[:, 2:4], axis=1)[good]
    edge = np.abs(r) < factor  # the others belong to the room
    assert edge.mean() > 0.5
    assert np.median(r[edge]) == pytest.approx(0.0, abs=0.15)
    middle = project(p[None], camera)[0][0]
    out = (found[good, :2] - middle) / np.linalg.norm(found[good, :2] - middle, axis=1, keepdims=True)
    assert np.all(np.sum(out * found[good, 2:4], axis=1) > 0.98)  # outward normals


@pytest.mark.parametrize(("inside", "outside"), [(0.8, 0.02), pytest.param(0.02, 0.8, marks=pytest.mark.slow)])
def test_an_edge_is_where_a_pixel_has_half_the_light(view, inside, outside):
    """Light mixes linearly, and grey values do not: half the light of 0.8 is far more than half its grey value."""
    _, m, p, R, image = view
    camera, share = InteriorOrientation(640, 480, *m.lens[:4], m.lens[4:]), np.zeros(image.shape[:2])
    u, v = np.rint(project(p[None], camera)[0][0]).astype(int)
    columns, rows = (middle - 64 + (np.arange(1280) - 4.5) / 10.0 for middle in (u, v))  # ten to a pixel
    x, y = np.meshgrid((columns - m.lens[2]) / m.lens[0], (rows - m.lens[3]) / m.lens[1])
    on_ball = (x * p[0] + y * p[1] + p[2]) ** 2 > (x**2 + y**2 + 1.0) * (p @ p - BALL.radius**2)
    share[v - 64 : v + 64, u - 64 : u + 64] = on_ball.reshape(128, 10, 128, 10).mean(axis=(1, 3))
    share = cv2.GaussianBlur(share, (0, 0), 0.7)
    grey = np.rint(255.0 * (outside + (inside - outside) * share) ** (1.0 / 2.2)).astype(np.uint8)
    found = measure_edges(cv2.merge([grey] * 3), p, R, DISCS, m, 1)
    at = project(p + twins.outline(p, BALL.radius), camera)[0]
    r = np.sum((found[:, :2] - at) * found[:, 2:4], axis=1)[found[:, 4] > 0]
    assert len(r) > 8
    assert np.abs(np.median(r)) < 0.2  # px; grey values would be off by 0.4


@pytest.mark.parametrize("turned", [0.0, 60.0, 90.0, 120.0, 180.0])
def test_expected_field_equals_the_convolution_at_the_limb(turned):
    """Numerical convolution of a disc's rim and the ball's limb as two straight edges at an angle."""
    facing, scale, sigma = 0.35, 26.0, 1.2
    aside = np.sqrt(1.0 - facing**2)
    # a rim whose outward normal in the picture makes the angle with that of the limb
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    outward = np.array([c * facing, s]) / np.hypot(c * facing, s)  # on the ball: radial, aside
    along = -outward[1] * aside  # the tangent's part along the line of sight
    point = [[along, outward[0] * aside, facing, scale, 0.0, 3.0, 0.0, 0.0, 1e-3]]
    (e,), (g,) = kernels.expected_field(np.array(point, dtype=np.float32))
    grid = np.arange(-8.0, 8.0, 0.05)
    x, y = np.meshgrid(grid, grid)
    weight = np.exp(-0.5 * (x**2 + y**2) / sigma**2)
    ball = x < scale * (1.0 - aside)
    disc = c * x + s * y < 0.0
    assert e == pytest.approx(np.sum(weight * (ball & disc)) / np.sum(weight), abs=0.03)
    moved = c * x + s * y < 0.3
    assert g == pytest.approx((np.sum(weight * (ball & moved)) / np.sum(weight) - e) / 0.3, abs=0.06)


@pytest.mark.parametrize("ball", [BALL, contrast_ball()], ids=lambda b: b.name)
def test_a_moving_ball_has_the_greatest_likelihood_with_the_motion_of_its_exposure(ball):
    """At the true pose, against the same picture without that motion and with twice the motion."""
    options = WandOptions(motion="hand", seed=3, seconds=1.0, fps=10.0, size=(640, 480), focal=800.0, distance=0.8)
    film = prepare_wand(replace(options, speed=0.8, rate=90.0, blur=0.012), ball)
    truth, path, m = film.truth(0), film.scene.balls[0].path, ball_model(ball, film.scene.camera)
    gain = []
    for shot in simulate_wand(film):
        k = shot.frame.sequence
        ends = path.pose(truth.stamp[k] + np.array([-0.006, 0.006]))
        motion = np.concatenate([ends[0][1] - ends[0][0], log(ends[1][1] @ ends[1][0].T)])
        seen = colour_fields(shot.frame.image, DEFAULT_COLOURS, ball.colours)
        of = [replace(seen, exposure_motion=part * motion) for part in (0.0, 1.0, 2.0)]
        value = [log_likelihood(shot.position, shot.rotation, m, each)[0][0] for each in of]
        gain.append([value[1] - value[0], value[1] - value[2]])
    assert np.all(np.sum(gain, axis=0) > [200.0, 100.0]), np.sum(gain, axis=0)


def test_glare_is_no_evidence(view):
    """A picture in glare has no evidence. With one disc in glare, the others have theirs."""
    seen, m, p, R, _ = view
    everywhere = np.full((1, *seen.weight.shape[1:]), 255, dtype=np.uint8)
    turned = exp(np.array([0.4, 1.1, -0.3])) @ R
    poses = np.array([p, p]), np.array([R, turned])
    value, match = log_likelihood(*poses, m, replace(seen, glare=everywhere))
    np.testing.assert_allclose(value, 0.0, atol=1e-9)
    np.testing.assert_array_equal(match, 0.0)

    spot = image_of(next(d for d in BALL.discs if (R @ d.direction)[2] < -0.5), view, 1.4)
    gone = replace(seen, weight=np.where(spot, 0, seen.weight).astype(np.uint8))
    veiled = replace(gone, glare=(255 * spot[None]).astype(np.uint8))
    whole, _ = log_likelihood(*poses, m, seen)
    without, _ = log_likelihood(*poses, m, gone)
    with_glare, match = log_likelihood(*poses, m, veiled)
    assert without[0] + 20.0 < with_glare[0] < whole[0] - 5.0
    assert match[0] > 0.9
    as_before, _ = log_likelihood(*poses, m, replace(seen, glare=veiled.glare))
    assert with_glare[0] - 1e-6 < as_before[0] < whole[0]  # a visible colour is evidence
    assert with_glare[0] > with_glare[1] + 20.0


@pytest.mark.parametrize("part", [0.4, 0.8, 1.0])
def test_glare_in_place_of_discs_is_no_evidence(view, part):
    """Pale spots at the places of the discs, without their colours."""
    seen, m, p, R, _ = view
    pale = np.zeros(seen.weight.shape[1:], dtype=np.uint8)
    for d in BALL.discs:
        if (R @ d.direction) @ (p + BALL.radius * R @ d.direction) < 0.0:
            pale[image_of(d, view, part)] = 255
    glare = cv2.GaussianBlur(pale, (5, 5), 0.0)[None]
    value, match = log_likelihood(p[None], R[None], m, replace(seen, weight=np.zeros_like(seen.weight), glare=glare))
    assert value[0] < 0.0
    assert match[0] < 0.5


# ---- native functions and their twins ----


def poses(p, R, n, spread):
    d = np.random.default_rng(7).normal(size=(n, 6)) * spread * [0.01, 0.01, 0.1, 0.3, 0.3, 0.3]
    return p + d[:, :3], exp(d[:, 3:]) @ R


def test_expected_field_equals_its_twin():
    """Single precision in the same order of operations: the same bits but for the last ones of wider registers."""
    rng = np.random.default_rng(3)
    low, high = [-1.0, -1.0, -1.0, 1.0, -0.2, 0.0, 0.5, -1.5, 0.3], [1.0, 1.0, 1.0, 300.0, 0.3, 0.6, 9.0, 0.5, 3.0]
    points = rng.uniform(low, high, (500, 9)).astype(np.float32)
    for got, expected in zip(kernels.expected_field(points), twins.expected_field(points), strict=True):
        np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("spread", [0.1, 1.0, 20.0])
@pytest.mark.parametrize(("glare", "motion"), [(False, 0.0), (True, 0.0), (False, 1.0)])
def test_likelihood_equals_its_twin(view, spread, glare, motion):
    """Poses near the truth and anywhere, some behind the camera or beside the picture.

    The tables of |m - e| have steps of 1/511, so a residual is off by at most 1/1022: per unit weight that is the
    slope of the log density there, at most 1 / (2 * 511 * 0.065) of a unit for each of about a hundred points. Their
    signs are random, so the sum has a standard deviation of 0.09.
    """
    seen, m, p, R, _ = view
    if glare:
        veil = np.random.default_rng(1).integers(0, 256, (1, 12, 16), dtype=np.uint8)
        veil = np.asarray(cv2.resize(veil[0], seen.weight.shape[:0:-1]))[None]
        seen = replace(seen, glare=veil)
    seen = replace(seen, exposure_motion=motion * np.array([0.004, -0.006, 0.02, 0.05, 0.02, -0.04]))
    position, rotation = poses(p, R, 60, spread)
    value, match = log_likelihood(position, rotation, m, seen)
    expected = np.array([twins.log_likelihood(*pose, m, seen) for pose in zip(position, rotation, strict=True)])
    np.testing.assert_allclose(value, expected[:, 0], atol=0.45)
    np.testing.assert_allclose(match, expected[:, 1], atol=2e-3)


def test_support_is_0_for_a_hidden_ball_and_near_1_in_a_clear_view(view):
    seen, m, p, R, _ = view
    p, R = p[None], R[None]
    value, _ = log_likelihood(p, R, m, seen)
    assert 0.85 < support(value, p, R, m, seen)[0] < 1.0
    hidden = replace(seen, weight=np.zeros_like(seen.weight))
    value, _ = log_likelihood(p, R, m, hidden)
    assert support(value, p, R, m, hidden)[0] == pytest.approx(0.0, abs=0.01)


def test_a_colour_that_the_picture_lacks_does_not_reduce_the_support(view):
    """The bounds of the colour can be wrong, which is no sign of a hidden ball."""
    seen, m, p, R, _ = view
    p, R = p[None], R[None]
    one = np.array([0, 1])[:, None, None] * np.ones_like(seen.weight)
    part = replace(seen, weight=(seen.weight * one).astype(np.uint8))
    value, _ = log_likelihood(p, R, m, part)
    hidden = support(value, p, R, m, part)[0]
    lacking = replace(part, binary=(seen.binary * one).astype(np.uint8), fraction=seen.fraction * [0, 1])
    value, _ = log_likelihood(p, R, m, lacking)
    assert hidden < 0.7
    assert support(value, p, R, m, lacking)[0] > 0.85


def test_evidence_bounds_equal_their_twin(view):
    seen, m, p, R, _ = view
    position, rotation = poses(p, R, 30, 1.0)
    found = np.array(kernels.evidence_bounds(position, rotation, m.kernel, seen.kernel))
    expected = np.array([twins.evidence_bounds(*pose, m, seen) for pose in zip(position, rotation, strict=True)])
    np.testing.assert_allclose(found.swapaxes(0, 1), expected, atol=0.25)


def test_likelihood_with_the_weights_of_a_peak_equals_its_twin(view):
    seen, m, p, R, _ = view
    position, rotation = poses(p, R, 10, 0.2)
    weights = disc_weights(position[:2], rotation[:2], m, seen.factor)
    which = np.array([0, 1, -1] * 4)[:10]
    value, _ = log_likelihood(position, rotation, m, seen, fixed_weights=(weights, which))
    for i in range(10):
        fixed = weights[which[i]] if which[i] >= 0 else None
        expected, _ = twins.log_likelihood(position[i], rotation[i], m, seen, fixed=fixed)
        assert value[i] == pytest.approx(expected, abs=0.25)


def test_likelihood_of_the_outline_equals_its_twin(view):
    _, m, p, R, image = view
    edges = np.stack([measure_edges(image, 0.97 * p, R, DISCS, m, 1), NONE])
    position, _ = poses(p, R, 40, 1.0)
    which = np.arange(40) % 2
    value = outline_log_likelihood(position, which, edges, m, 2)
    expected = [twins.outline_log_likelihood(c, edges[k], m, 2) for c, k in zip(position, which, strict=True)]
    np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-12)


def test_refinement_equals_its_twin(view):
    """One step. Residuals of single precision, 1e-6, over a step of half a pixel give derivatives to 1e-4."""
    seen, m, p, R, image = view
    for edges in (NONE, measure_edges(image, p, R, DISCS, m, 1)):
        for c, S in zip(*poses(p, R, 8, 0.3), strict=True):
            peak = refine_pose(c, S, m, seen, edges, 1)
            position, rotation = twins.refine_once(c, S, m, seen, edges)
            moved = np.abs(peak.position - c).max() + 1e-4
            np.testing.assert_allclose(peak.position, position, atol=2e-3 * moved)
            assert np.linalg.norm(log(peak.rotation @ rotation.T)) < 2e-3 * (np.linalg.norm(log(rotation @ S.T)) + 1e-3)


@pytest.mark.parametrize("factor", [1, 2])
def test_measured_edges_equal_their_twin(view, factor):
    """Poses near the truth, and one at the edge of the picture."""
    _, m, p, R, image = view
    position, rotation = poses(p, R, 12, 0.5)
    position[0, 0] += 0.5
    for c, S in zip(position, rotation, strict=True):
        got, expected = (f(image, c, S, DISCS, m, factor) for f in (measure_edges, twins.measure_edges))
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
