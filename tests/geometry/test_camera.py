"""The camera model, against OpenCV, finite differences and densely sampled outlines."""

import cv2
import numpy as np
import pytest
from conftest import central_differences
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.geometry.camera import (
    InteriorOrientation,
    Pose,
    distort,
    fold_in_picture,
    interior_jacobian,
    pose_from_matrix,
    project,
    project_circle,
    project_sphere,
    reduced_to_pixel,
    unproject,
)
from spheremouse.geometry.rotation import exp, tangent_basis

STRONG = np.array([-0.49, 0.3, -1e-4, -1e-4, -0.11])
FOLD = np.sqrt(np.min(np.roots([7 * -0.11, 5 * 0.3, 3 * -0.49, 1]).real))  # where that lens stops growing: 1.12
CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1398.0, 967.0, 540.0, STRONG)
PINHOLE = InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0)


def points_in_view(n, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform([-0.65, -0.4], [0.65, 0.4], (n, 2))
    z = rng.uniform(0.5, 4.0, (n, 1))
    return np.concatenate([xy * z, z], axis=1)


@pytest.mark.parametrize("camera", [CAMERA, PINHOLE])
def test_project_is_opencvs(camera):
    points = points_in_view(500)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    uv, _ = project(points, camera)
    assert_allclose(uv, expected[:, 0], atol=1e-9)
    behind = project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [0.1, 0.1, 1.0]]), camera)[0]
    assert_array_equal(np.isnan(behind).all(axis=1), [True, True, False])


FORWARD = points_in_view(50)
PIXELS = np.random.default_rng(1).uniform([200.0, 100.0], [1700.0, 980.0], (50, 2))


@pytest.mark.parametrize(
    ("function", "at", "step", "tolerance"),
    [
        (project, FORWARD, 1e-6, 1e-4),
        (distort, FORWARD[:, :2], 1e-6, 1e-6),
        (reduced_to_pixel, FORWARD[:, :2], 1e-6, 1e-6),
        (unproject, PIXELS, 1e-3, 1e-9),
    ],
)
def test_jacobians_are_finite_differences(function, at, step, tolerance):
    _, J = function(at, CAMERA)
    for p, j in zip(at, J, strict=True):
        numeric = central_differences(lambda x: function(x[None], CAMERA)[0][0], p, step)
        assert_allclose(j, numeric, rtol=1e-5, atol=tolerance)


@pytest.mark.parametrize("camera", [CAMERA, PINHOLE])
def test_interior_jacobian_is_the_finite_difference(camera):
    def pixels(p):
        return reduced_to_pixel(xy, InteriorOrientation(camera.width, camera.height, *p[:4], p[4:]))[0]

    xy = points_in_view(50)[:, :2]
    numeric = central_differences(pixels, np.array([*camera.intrinsic, *camera.distortion]), 1e-4)
    assert_allclose(interior_jacobian(xy, camera), numeric, atol=1e-6)


def polar(radii):
    angle = np.linspace(0.0, 2 * np.pi, 36, endpoint=False)
    return np.stack([np.outer(radii, np.cos(angle)).ravel(), np.outer(radii, np.sin(angle)).ravel()], axis=1)


@pytest.mark.parametrize("camera", [CAMERA, PINHOLE])
def test_unproject_inverts_project_over_the_whole_image(camera):
    u, v = np.meshgrid(np.arange(0.0, camera.width, 16.0), np.arange(0.0, camera.height, 16.0))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    xy, _ = unproject(uv, camera)
    seen = ~np.isnan(xy).any(axis=1)
    assert np.mean(seen) > 0.95  # the outermost corners of that lens are folded
    back, _ = project(np.concatenate([xy[seen], np.ones((seen.sum(), 1))], axis=1), camera)
    assert_allclose(back, uv[seen], atol=1e-8)
    near = polar(np.linspace(0.0, 0.99 * FOLD, 40))  # every ray on the near side of the fold
    assert_allclose(unproject(reduced_to_pixel(near, camera)[0], camera)[0], near, atol=1e-9)


@pytest.mark.parametrize("terms", [STRONG, np.array([-0.5, 0.1, 0.0, 0.0, 0.0])])
def test_unproject_beyond_the_fold_gives_nan(terms):
    """The second lens grows once more behind its fold: Newton's method ends there if nothing stops it."""
    camera = InteriorOrientation(640, 480, 300.0, 300.0, 320.0, 240.0, terms)
    r = np.linspace(0.0, 1.3, 100_000)
    largest = np.max(r * (1 + terms[0] * r**2 + terms[1] * r**4 + terms[4] * r**6))
    xy, J = unproject(polar(np.linspace(1.01 * largest, 4.0 * largest, 60)) * 300.0 + (320.0, 240.0), camera)
    assert np.isnan(xy).all()
    assert np.isfinite(J).all()


def test_pose_maps_obj_to_cam_as_its_matrix_does():
    pose = Pose(exp(np.array([0.3, -2.0, 0.5])), np.array([0.1, -0.45, 1.27]))
    points = np.random.default_rng(2).normal(size=(5, 3))
    homogeneous = np.concatenate([points, np.ones((5, 1))], axis=1) @ np.linalg.inv(pose.matrix()).T
    assert_allclose(pose.to_cam(points), homogeneous[:, :3], atol=1e-14)
    again = pose_from_matrix(pose.matrix() * np.array([1 + 1e-9, 1, 1, 1]))
    assert_allclose(again.rotation @ again.rotation.T, np.eye(3), atol=1e-15)
    assert_allclose(again.rotation, pose.rotation, atol=1e-8)


def circles(n):
    """Circles in view with every tilt up to 80 degrees from facing the camera."""
    rng = np.random.default_rng(3)
    centre = points_in_view(n, 3)
    tilt = rng.uniform(0.0, np.radians(80.0), n)
    about = np.cross(centre, rng.normal(size=(n, 3)))
    about /= np.linalg.norm(about, axis=1, keepdims=True)
    facing = -centre / np.linalg.norm(centre, axis=1, keepdims=True)
    return centre, np.einsum("nij,nj->ni", exp(tilt[:, None] * about), facing), rng.uniform(0.01, 0.1, n)


def test_project_circle_is_the_outline_of_the_sampled_circle():
    t = np.linspace(0.0, 2 * np.pi, 4000, endpoint=False)
    centre, normal, radius = circles(40)
    c, S = project_circle(centre, normal, radius)
    basis = tangent_basis(normal)
    for k in range(40):
        rim = centre[k] + radius[k] * np.stack([np.cos(t), np.sin(t)], axis=1) @ basis[k].T
        outline = rim[:, :2] / rim[:, 2:]
        d = outline - c[k]
        assert_allclose(np.sum(d * np.linalg.solve(S[k], d.T).T, axis=1), 1.0, rtol=1e-6)
        x, y = outline.T
        twice_area = x * np.roll(y, -1) - np.roll(x, -1) * y
        area = abs(np.sum(twice_area)) / 2
        assert np.pi * np.sqrt(np.linalg.det(S[k])) == pytest.approx(area, rel=1e-5)
        centroid = np.sum((outline + np.roll(outline, -1, axis=0)) * twice_area[:, None], axis=0) / (
            3 * np.sum(twice_area)
        )
        assert_allclose(c[k], centroid, atol=1e-8)


@pytest.mark.parametrize("centre", [[0.0, 0.0, 2.35], [0.4, -0.3, 1.3], [-0.5, 0.2, 1.0]])
def test_project_sphere_is_touched_by_tangent_rays(centre):
    centre, radius = np.array(centre), 0.6
    c, S = project_sphere(centre, radius)
    distance = np.linalg.norm(centre)
    half_angle = np.arcsin(radius / distance)
    t = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    around = np.stack([np.cos(t), np.sin(t)], axis=1) @ tangent_basis(centre / distance).T
    rays = np.cos(half_angle) * centre / distance + np.sin(half_angle) * around
    closest = np.linalg.norm(np.cross(rays, centre), axis=1)
    assert_allclose(closest, radius, rtol=1e-12)  # they do touch
    d = rays[:, :2] / rays[:, 2:] - c
    assert_allclose(np.sum(d * np.linalg.solve(S, d.T).T, axis=1), 1.0, rtol=1e-9)


def test_a_fold_in_the_picture_is_where_opencvs_projection_turns_back():
    """Rays outwards from the axis, by `cv2.projectPoints`: the first that moves inwards, or leaves the picture."""
    rng, folds, whole = np.random.default_rng(0), 0, 0
    r, angle = np.linspace(1e-3, 4.0, 2000), np.linspace(0.0, 2 * np.pi, 90, endpoint=False)
    rays = np.stack(np.broadcast_arrays(np.outer(np.cos(angle), r), np.outer(np.sin(angle), r), 1.0), axis=-1)
    for _ in range(24):
        terms = rng.normal([-0.2, 0.0, 0.0, 0.0, 0.0], [0.3, 0.2, 0.002, 0.002, 0.1])
        camera = InteriorOrientation(640, 480, 450.0, 460.0, 330.0, 235.0, terms)
        uv, _ = cv2.projectPoints(rays.reshape(-1, 3), np.zeros(3), np.zeros(3), camera.matrix, terms)
        uv = uv.reshape(len(angle), len(r), 2)
        along, across = np.gradient(uv, axis=1), np.roll(uv, -1, axis=0) - np.roll(uv, 1, axis=0)
        turned = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0] <= 0.0
        outside = np.any((uv < 0.0) | (uv > [639.0, 479.0]), axis=2)
        first = np.arange(len(angle)), np.argmax(turned | outside, axis=1)
        at = uv[first][~outside[first]]
        share, distance = fold_in_picture(camera)
        if len(at) == 0:
            assert (share, distance) == (0.0, np.inf)
            whole += 1
        else:
            assert share > 0.0
            assert distance == pytest.approx(np.linalg.norm(at - (camera.cx, camera.cy), axis=1).min(), abs=12.5)
            folds += 1
    assert min(folds, whole) >= 5
