"""Rays meet the ball: closed form, the published Gauss-Helmert model, and the scatter of samples."""

from dataclasses import fields, replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.ball.detect.detections import Detections, no_detections
from spheremouse.ball.points import intersect
from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.geometry.camera import InteriorOrientation, Pose, row_of, unproject
from spheremouse.geometry.rotation import exp

CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1404.0, 967.0, 540.0, np.array([-0.49, 0.3, -1e-4, -1e-4, -0.11]))
NO_TARGETS = Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3))
INCIDENCE = np.radians([0.0, 15.0, 40.0, 60.0, 72.0])  # between ray and normal: from the middle to near the limb


def spd(sigmas, seed):
    """A covariance with these standard deviations and strong correlations."""
    rng = np.random.default_rng(seed)
    C = np.cov(rng.normal(size=(len(sigmas), 3 * len(sigmas))))
    s = np.asarray(sigmas) / np.sqrt(np.diag(C))
    return C * np.outer(s, s)


WHOLE = spd([4e-4, 3e-4, 6e-4, 3e-4, 2e-4, 1e-4, 5e-4, 4e-4, 6e-4, 3e-4], 1)  # pose and ball, correlated
BALL = Ball(0.6, np.array([0.002, -0.003, 0.001]), WHOLE[6:, 6:])


def looking_at(target, position):
    """R_obj_cam of a camera at `position` that looks at `target`, a little rolled."""
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross([0.3, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


STATION = np.array([0.5, -0.45, 2.2])
POSE = Pose(looking_at(BALL.centre, STATION), STATION, WHOLE[:6, :6], WHOLE[:6, 6:])
RIG = Rig(CAMERA, BALL, NO_TARGETS, 0.02)


def to_pixels(points, pose=POSE):
    """OpenCV's projection of points in obj, (n, 3)."""
    R = pose.rotation.T
    uv, _ = cv2.projectPoints(
        np.asarray(points, dtype=float).reshape(-1, 1, 3),
        cv2.Rodrigues(R)[0],
        -R @ pose.position,
        CAMERA.matrix,
        CAMERA.distortion,
    )
    return uv[:, 0]


def places():
    """One point of the ball for each angle of incidence, each in another direction from the middle."""
    to_camera = POSE.position - BALL.centre
    distance = np.linalg.norm(to_camera)
    middle = to_camera / distance
    side = np.cross(middle, [0.2, 1.0, 0.1])
    side /= np.linalg.norm(side)
    # law of sines in the triangle camera, centre, point
    from_middle = INCIDENCE - np.arcsin(0.6 / distance * np.sin(INCIDENCE))
    directions = [exp(middle * 1.3 * k) @ (np.cos(a) * middle + np.sin(a) * side) for k, a in enumerate(from_middle)]
    return BALL.centre + BALL.radius * np.array(directions)


def detections(uv, sigma=0.1):
    n = len(uv)
    covariance = sigma**2 * np.broadcast_to(np.array([[1.0, 0.3], [0.3, 0.7]]), (n, 2, 2))
    return Detections(np.asarray(uv, dtype=float), covariance.copy(), np.full(n, 100.0))


def first_hit(position, rotation, centre, radius, xy):
    """Nearer intersection by projecting the centre onto the ray; all arguments (..., k), another way than intersect."""
    ray = np.einsum("...ij,...j->...i", rotation, np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1))
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    s = np.sum(ray * (centre - position), axis=-1)
    foot = position + s[..., None] * ray
    half_chord = np.sqrt(radius**2 - np.sum((foot - centre) ** 2, axis=-1))
    return foot - half_chord[..., None] * ray


def test_points_come_back_from_their_projections():
    truth = places()
    cosine = np.sum((truth - BALL.centre) * (POSE.position - truth), axis=1) / (
        BALL.radius * np.linalg.norm(POSE.position - truth, axis=1)
    )
    assert_allclose(np.arccos(cosine), INCIDENCE, atol=1e-6)  # the places are what they say
    points = intersect(detections(to_pixels(truth)), RIG, POSE)
    assert_allclose(points.position, truth, atol=1e-9)
    assert_allclose(points.direction, (truth - BALL.centre) / BALL.radius, atol=1e-9)
    assert_array_equal(points.index, np.arange(5))


def test_points_lie_on_the_ray_and_on_the_near_side_of_the_ball():
    rng = np.random.default_rng(3)
    uv = rng.uniform([0, 0], [1919, 1079], (2000, 2))
    points = intersect(detections(uv), RIG, POSE)
    assert 200 < len(points) < 1000
    assert_allclose(np.linalg.norm(points.position - BALL.centre, axis=1), BALL.radius, atol=1e-12)
    assert_allclose(to_pixels(points.position), uv[points.index], atol=1e-8)
    facing = np.sum(points.direction * (POSE.position - points.position), axis=1)
    assert np.all(facing > 0.0)


def test_rays_that_miss_are_dropped_and_only_those():
    """Truth is the distance of each ray from the ball's centre."""
    rng = np.random.default_rng(4)
    uv = rng.uniform([0, 0], [1919, 1079], (2000, 2))
    xy, _ = unproject(uv, CAMERA)
    folded = np.isnan(xy).any(axis=1)
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ POSE.rotation.T
    to_centre = BALL.centre - POSE.position
    distance = np.linalg.norm(np.cross(ray, to_centre), axis=1) / np.linalg.norm(ray, axis=1)
    assert folded.any()  # the corners of that lens: no ray, so no point either
    expected = np.flatnonzero(~folded & (np.nan_to_num(distance, nan=np.inf) < BALL.radius))
    points = intersect(detections(uv), RIG, POSE)
    assert_array_equal(points.index, expected)
    for array in (points.position, points.covariance, points.dposition_dpose, points.dposition_dball):
        assert np.isfinite(array).all()


def test_a_ball_behind_the_camera_is_not_hit():
    behind = replace(POSE, rotation=POSE.rotation @ np.diag([1.0, -1.0, -1.0]))
    assert len(intersect(detections(to_pixels(places())), RIG, behind)) == 0


def test_no_detections_give_no_points():
    points = intersect(no_detections(), RIG, POSE)
    assert len(points) == 0
    assert points.covariance.shape == (0, 3, 3)
    assert points.dposition_dpose.shape == (0, 3, 6)
    assert points.dposition_dball.shape == (0, 3, 4)


def test_take_selects_every_field():
    points = intersect(detections(to_pixels(places())), RIG, POSE)
    some = points.take(np.array([True, False, False, True, False]))
    assert_array_equal(some.index, [0, 3])
    for field in fields(points):
        assert_array_equal(getattr(some, field.name), getattr(points, field.name)[[0, 3]])


def test_take_knows_masks_indices_and_slices():
    points = intersect(detections(to_pixels(places())), replace(RIG, readout_s=0.02), POSE)
    for keep, rows in ((np.array([4, 1]), [4, 1]), (slice(1, 3), [1, 2]), (np.zeros(5, dtype=bool), [])):
        some = points.take(keep)
        assert len(some) == len(rows)
        assert_array_equal(some.index, rows)
        assert_array_equal(some.delay, points.delay[rows])


def central_differences(f, n, h):
    return np.stack([(f(d) - f(-d)) / (2 * h) for d in h * np.eye(n)], axis=-1)


def test_pose_jacobian_is_the_finite_difference_of_its_error_model():
    """position + d, exp(theta) @ rotation, both in obj."""
    seen = detections(to_pixels(places()))

    def moved(e):
        pose = replace(POSE, position=POSE.position + e[:3], rotation=exp(e[3:]) @ POSE.rotation)
        return intersect(seen, RIG, pose).position

    points = intersect(seen, RIG, POSE)
    assert_allclose(points.dposition_dpose, central_differences(moved, 6, 1e-6), rtol=1e-6, atol=1e-7)


def test_ball_jacobian_is_the_finite_difference():
    seen = detections(to_pixels(places()))

    def changed(e):
        ball = replace(BALL, centre=BALL.centre + e[:3], radius=BALL.radius + e[3])
        return intersect(seen, replace(RIG, ball=ball), POSE).position

    points = intersect(seen, RIG, POSE)
    assert_allclose(points.dposition_dball, central_differences(changed, 4, 1e-6), rtol=1e-6, atol=1e-7)


def test_image_covariance_is_that_of_the_finite_difference():
    uv = to_pixels(places())
    seen = detections(uv)
    J = central_differences(lambda e: intersect(detections(uv + e), RIG, POSE).position, 2, 1e-3)
    points = intersect(seen, RIG, POSE)
    assert_allclose(points.image_covariance, J @ seen.covariance @ J.transpose(0, 2, 1), rtol=1e-4, atol=1e-13)


def test_covariance_is_the_sum_of_its_sources():
    points = intersect(detections(to_pixels(places())), RIG, POSE)
    exact = replace(POSE, covariance=np.zeros((6, 6)), ball_covariance=np.zeros((6, 4)))
    image_only = intersect(detections(to_pixels(places())), replace(RIG, ball=Ball(0.6, BALL.centre)), exact)
    assert_allclose(image_only.covariance, points.image_covariance, atol=1e-18)
    J, K = points.dposition_dpose, points.dposition_dball
    shared = J @ POSE.ball_covariance @ K.transpose(0, 2, 1)
    total = (
        points.image_covariance
        + J @ POSE.covariance @ J.transpose(0, 2, 1)
        + K @ BALL.covariance @ K.transpose(0, 2, 1)
    )
    assert_allclose(points.covariance, total + shared + shared.transpose(0, 2, 1), rtol=1e-10)
    apart = intersect(detections(to_pixels(places())), RIG, replace(POSE, ball_covariance=np.zeros((6, 4))))
    assert_allclose(apart.covariance, total, rtol=1e-12)


@pytest.mark.parametrize("place", range(len(INCIDENCE)))
def test_covariance_is_that_of_the_gauss_helmert_model(place):
    """Wittich 2017, eq. 114-120 with eq. 45, 46: conditions on the point as unknown, numeric derivatives throughout."""
    B = places()[place]
    uv = to_pixels(B)[0]
    seen = detections(uv[None])

    def conditions(unknown, observed):
        pose = replace(POSE, position=POSE.position + observed[:3], rotation=exp(observed[3:6]) @ POSE.rotation)
        collinear = to_pixels(unknown, pose)[0] - (uv + observed[10:])
        on_ball = BALL.radius + observed[9] - np.linalg.norm(unknown - (BALL.centre + observed[6:9]))
        return np.append(collinear, on_ball)

    A = central_differences(lambda e: conditions(B + e, np.zeros(12)), 3, 1e-6)
    Bm = central_differences(lambda e: conditions(B, e), 12, 1e-6)
    sigma_ll = np.zeros((12, 12))
    sigma_ll[:10, :10] = WHOLE
    sigma_ll[10:, 10:] = seen.covariance[0]
    sigma_ww = Bm @ sigma_ll @ Bm.T
    N = A.T @ np.linalg.solve(sigma_ww, A)
    expected = np.linalg.inv(N)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    actual = intersect(seen, RIG, POSE).covariance[0]
    assert_allclose(actual / scale, expected / scale, atol=1e-5)


def test_covariance_is_the_scatter_of_samples():
    """20,000 poses, balls and image points; the bound is five standard deviations of a sample covariance."""
    n = 20_000
    rng = np.random.default_rng(5)
    uv = to_pixels(places())
    seen = detections(uv)
    points = intersect(seen, RIG, POSE)
    error = rng.multivariate_normal(np.zeros(10), WHOLE, n)
    pose, ball = error[:, :6], np.append(BALL.centre, BALL.radius) + error[:, 6:]
    rotation = exp(pose[:, 3:]) @ POSE.rotation
    for k in range(len(uv)):
        xy, _ = unproject(uv[k] + rng.multivariate_normal(np.zeros(2), seen.covariance[k], n), CAMERA)
        hits = first_hit(POSE.position + pose[:, :3], rotation, ball[:, :3], ball[:, 3], xy)
        whiten = np.linalg.inv(np.linalg.cholesky(points.covariance[k]))
        scatter = whiten @ np.cov(hits.T) @ whiten.T
        assert_allclose(scatter, np.eye(3), atol=5 * np.sqrt(2.0 / n))
        assert_allclose(whiten @ (hits.mean(axis=0) - points.position[k]), 0.0, atol=5 / np.sqrt(n))


def test_delay_is_the_time_of_a_points_row_after_the_middle_row():
    """Row v of h is read (v + 1/2) / h of the readout after the first; the stamp is half of it after."""
    uv = to_pixels(places())
    assert_array_equal(intersect(detections(uv), RIG, POSE).delay, 0.0)  # a global shutter
    rolling = replace(RIG, readout_s=0.03)
    points = intersect(detections(uv), rolling, POSE)
    assert_allclose(points.delay, 0.03 * ((uv[:, 1] + 0.5) / 1080 - 0.5), atol=1e-15)
    assert_allclose(0.03 * row_of(uv[:, 1], CAMERA.height), points.delay, atol=1e-15)
    middle = intersect(detections(np.array([[967.0, 539.5]])), rolling, POSE)
    assert_allclose(middle.delay, 0.0, atol=1e-15)
    lower = intersect(detections(np.array([[967.0, 539.5 + 270.0]])), rolling, POSE)
    assert_allclose(lower.delay, 0.03 / 4)  # a row further down is read later


def test_row_is_told_whatever_is_known_of_the_shutter():
    """From -1/2 above the first row to 1/2 below the last: what a readout that is learnt later multiplies."""
    uv = to_pixels(places())
    row = (uv[:, 1] + 0.5) / 1080 - 0.5
    for readout in (0.0, 0.03):
        points = intersect(detections(uv), replace(RIG, readout_s=readout), POSE)
        assert_allclose(points.row, row, atol=1e-15)
        assert_allclose(points.delay, readout * points.row, atol=1e-15)
    assert np.ptp(points.row) > 0.1


def test_delay_stays_with_its_point_when_rays_miss():
    rng = np.random.default_rng(6)
    uv = rng.uniform([0, 0], [1919, 1079], (300, 2))
    points = intersect(detections(uv), replace(RIG, readout_s=0.03), POSE)
    assert 20 < len(points) < 200
    assert len(points.delay) == len(points.row) == len(points)
    assert_allclose(points.row, (uv[points.index, 1] + 0.5) / 1080 - 0.5, atol=1e-15)
    assert_allclose(points.delay, 0.03 * ((uv[points.index, 1] + 0.5) / 1080 - 0.5), atol=1e-15)


def test_a_pixel_no_ray_maps_to_is_a_miss():
    """nan in, nothing out; the corners of that lens fold back."""
    uv = np.vstack([to_pixels(places())[:1], [[np.nan, 500.0]], [[1e5, -1e5]]])
    points = intersect(detections(uv), RIG, POSE)
    assert_array_equal(points.index, [0])
    assert np.isfinite(points.covariance).all()
