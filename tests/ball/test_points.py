"""Rays meet the ball: closed form, the published Gauss-Helmert model, and the scatter of samples."""

from dataclasses import fields, replace

import numpy as np
import pytest
from ball_world import other
from conftest import central_differences, covariance_of
from numpy.testing import assert_allclose, assert_array_equal
from ray_cast import looking_at, to_image

from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.points import intersect
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.geometry.camera import InteriorOrientation, Pose, unproject
from spheremouse.geometry.rotation import exp

CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1404.0, 967.0, 540.0, np.array([-0.49, 0.3, -1e-4, -1e-4, -0.11]))
INCIDENCE = np.radians([0.0, 15.0, 40.0, 60.0, 72.0])  # between ray and normal: from the middle to near the limb


WHOLE = covariance_of([4e-4, 3e-4, 6e-4, 3e-4, 2e-4, 1e-4, 5e-4, 4e-4, 6e-4, 3e-4], 1)  # pose and ball, correlated
BALL = Ball(0.6, np.array([0.002, -0.003, 0.001]), WHOLE[6:, 6:])


STATION = np.array([0.5, -0.45, 2.2])
POSE = Pose(looking_at(BALL.centre, STATION), STATION, WHOLE[:6, :6], WHOLE[:6, 6:])
RIG = Rig(CAMERA, BALL, NO_TARGETS, 0.02)


def to_pixels(points, pose=POSE):
    return to_image(points, RIG, pose)


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


@pytest.mark.parametrize("readout", [0.0, 0.03])
def test_points_of_random_pixels_lie_on_ray_and_ball(readout):
    """Rays that miss are left out, and pixels without a ray. Truth is the distance of each ray from the centre."""
    rng = np.random.default_rng(4)
    uv = np.vstack([rng.uniform([0, 0], [1919, 1079], (2000, 2)), [[np.nan, 500.0], [1e5, -1e5]]])
    xy, _ = unproject(uv, CAMERA)
    folded = np.isnan(xy).any(axis=1)
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ POSE.rotation.T
    to_centre = BALL.centre - POSE.position
    distance = np.linalg.norm(np.cross(ray, to_centre), axis=1) / np.linalg.norm(ray, axis=1)
    assert folded[:-2].any()  # the corners of that lens: no ray, so no point either
    points = intersect(detections(uv), replace(RIG, readout_s=readout), POSE)
    assert_array_equal(points.index, np.flatnonzero(np.nan_to_num(distance, nan=np.inf) < BALL.radius))
    assert_allclose(np.linalg.norm(points.position - BALL.centre, axis=1), BALL.radius, atol=1e-12)
    assert_allclose(to_pixels(points.position), uv[points.index], atol=1e-8)
    assert np.all(np.sum(points.direction * (POSE.position - points.position), axis=1) > 0.0)  # the near side
    for field in fields(points)[:-1]:  # the last is of the ball
        assert len(getattr(points, field.name)) == len(points)
        assert np.isfinite(getattr(points, field.name)).all()
        assert_array_equal(getattr(points.take(np.array([4, 1])), field.name), getattr(points, field.name)[[4, 1]])
    # row v of h is read (v + 1/2) / h of the readout after the first; the stamp is half of it after
    assert_allclose(points.row, (uv[points.index, 1] + 0.5) / 1080 - 0.5, atol=1e-15)
    assert_allclose(points.delay, readout * points.row, atol=1e-15)
    assert len(intersect(detections(uv[:0]), RIG, POSE)) == 0


def test_a_ball_behind_the_camera_is_not_hit():
    behind = replace(POSE, rotation=POSE.rotation @ np.diag([1.0, -1.0, -1.0]))
    assert len(intersect(detections(to_pixels(places())), RIG, behind)) == 0


def test_directions_change_with_the_rig_as_finite_differences_do():
    """A longer focal length comes with a ball farther away along the optical axis, and with other axes of obj."""
    seen, depth, turn = detections(to_pixels(places())), POSE.along_axis(BALL.centre), np.array([0.2, -0.1, 0.3])
    pose = replace(POSE, by_focal=np.append([0.5, 0.6, 0.7], turn))

    def changed(e):
        camera = replace(CAMERA, fx=(1.0 + e[0]) * CAMERA.fx, fy=(1.0 + e[0]) * CAMERA.fy)
        ball = replace(BALL, centre=BALL.centre + e[0] * depth + e[1:])
        return intersect(seen, replace(RIG, camera=camera, ball=ball), POSE).direction @ exp(e[0] * turn).T

    points = intersect(seen, RIG, pose)
    assert_allclose(points.ddirection_drig, central_differences(changed, np.zeros(4), 1e-6), rtol=1e-5, atol=1e-6)
    error = np.array([0.01, 0.002, -0.003, 0.004])
    assert_allclose(intersect(seen, RIG, pose, error).direction, changed(error), atol=1e-12)
    assert_allclose(points.seen_with(0.01 * error), changed(0.01 * error), atol=1e-5)
    assert np.abs(changed(np.array([0.01, 0.0, 0.0, 0.0])) - points.direction).max() < 0.01  # the ball keeps its place


def test_image_covariance_is_that_of_the_finite_difference():
    uv = to_pixels(places())
    seen = detections(uv)
    J = central_differences(lambda e: intersect(detections(uv + e), RIG, POSE).position, np.zeros(2), 1e-3)
    points = intersect(seen, RIG, POSE)
    assert_allclose(points.image_covariance, J @ seen.covariance @ J.transpose(0, 2, 1), rtol=1e-4, atol=1e-13)


@pytest.mark.parametrize("place", range(len(INCIDENCE)))
def test_covariance_is_that_of_the_gauss_helmert_model(place):
    """Wittich 2017, eq. 114-120 with eq. 45, 46: conditions on the point as unknown, numeric derivatives throughout."""
    B = places()[place]
    uv = to_pixels(B)[0]
    seen = detections(uv[None])

    def conditions(unknown, observed):
        rig, pose = other(RIG, POSE, observed)
        on_ball = rig.ball.radius - np.linalg.norm(unknown - rig.ball.centre)
        return np.append(to_pixels(unknown, pose)[0] - (uv + observed[10:]), on_ball)

    A = central_differences(lambda x: conditions(x, np.zeros(12)), B, 1e-6)
    Bm = central_differences(lambda e: conditions(B, e), np.zeros(12), 1e-6)
    sigma_ll = np.zeros((12, 12))
    sigma_ll[:10, :10] = WHOLE
    sigma_ll[10:, 10:] = seen.covariance[0]
    sigma_ww = Bm @ sigma_ll @ Bm.T
    N = A.T @ np.linalg.solve(sigma_ww, A)
    expected = np.linalg.inv(N)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    actual = intersect(seen, RIG, POSE).covariance[0]
    assert_allclose(actual / scale, expected / scale, atol=1e-5)


def test_a_wrong_argument_is_named():
    seen = detections(to_pixels(places()))
    with pytest.raises(TypeError, match="noise"):
        intersect(replace(seen, centre=seen.centre[:2]), RIG, POSE)
