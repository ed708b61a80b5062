"""How a disc looks: predicted ellipses against a cap sampled densely and projected point by point with OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ray_cast import looking_at, polygon_moments, to_image

from spheremouse.ball.detect.appearance import appearance, ball_mask, ball_outline, clear_mask, largest_disc
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig, Targets
from spheremouse.geometry.camera import InteriorOrientation, Pose

STRONG = InteriorOrientation(1920, 1080, 1404.0, 1390.0, 967.0, 540.0, np.array([-0.4, 0.2, 2e-3, -1e-3, -0.05]))
PLAIN = InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0)


def device(camera, disc_radius=0.02, station=(0.5, -0.45, 1.6)):
    station, centre = np.array(station), np.array([0.01, -0.02, 0.005])
    # Beside the ball: its image is far from the middle, where distortion is strong
    aim = centre + np.array([0.35, 0.2, 0.0])
    return Rig(camera, Ball(0.6, centre), NO_TARGETS, disc_radius), Pose(looking_at(aim, station), station)


def frame_of(direction):
    """Two unit vectors perpendicular to a direction."""
    a = np.cross(direction, [1.0, 0.2, -0.3])
    a /= np.linalg.norm(a)
    return a, np.cross(direction, a)


def rim(direction, rig, n=720):
    alpha = rig.disc_radius / rig.ball.radius
    a, b = frame_of(direction)
    t = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)[:, None]
    d = np.cos(alpha) * direction + np.sin(alpha) * (np.cos(t) * a + np.sin(t) * b)
    return rig.ball.centre + rig.ball.radius * d


def directions(rig, pose, least_margin=0.02):
    """Directions all over the near side, up to `least_margin` rad from where a rim meets the horizon."""
    towards = pose.position - rig.ball.centre
    distance = np.linalg.norm(towards)
    axis = towards / distance
    widest = np.arccos(rig.ball.radius / distance) - rig.disc_radius / rig.ball.radius - least_margin
    a, b = frame_of(axis)
    out = [axis]
    for tilt in np.linspace(0.2, 1.0, 5) * widest:
        for t in np.linspace(0.0, 2.0 * np.pi, 7, endpoint=False):
            out.append(np.cos(tilt) * axis + np.sin(tilt) * (np.cos(t) * a + np.sin(t) * b))
    return np.array(out)


@pytest.mark.parametrize("camera", [PLAIN, STRONG], ids=["plain", "distorted"])
@pytest.mark.parametrize("disc_radius", [0.005, 0.02, 0.05])
def test_area_and_centroid_are_those_of_the_projected_rim(camera, disc_radius):
    rig, pose = device(camera, disc_radius)
    u = directions(rig, pose)
    seen = appearance(u, rig, pose)
    assert seen.whole.all()
    for i, d in enumerate(u):
        area, centroid = polygon_moments(to_image(rim(d, rig), rig, pose))
        assert_allclose(seen.centroid[i], centroid, atol=0.01)
        assert_allclose(seen.area[i], area, rtol=0.02, atol=0.05)
        offset = to_image(rim(d, rig, 90), rig, pose) - seen.centroid[i]
        rho = np.sqrt(np.einsum("ki,ij,kj->k", offset, np.linalg.inv(seen.shape[i]), offset))
        semi = np.sqrt(np.linalg.eigvalsh(seen.shape[i])[0])
        assert np.abs(rho - 1.0).max() * semi < (1e-6 if camera is PLAIN else 0.3)  # px from the rim to the ellipse
    centre = to_image(rig.ball.centre + rig.ball.radius * u, rig, pose)
    assert_allclose(seen.centre, centre, atol=1e-6)
    if disc_radius > 0.01:
        assert np.linalg.norm(seen.centroid - seen.centre, axis=1).max() > 0.1  # eccentricity is not nothing


def test_whole_is_where_all_of_the_rim_faces_the_camera():
    rig, pose = device(PLAIN, 0.03)
    rng = np.random.default_rng(0)
    u = rng.normal(size=(2000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    seen = appearance(u, rig, pose)
    facing = np.empty(len(u), dtype=bool)
    for i, d in enumerate(u):
        p = rim(d, rig, 360)
        normal = (p - rig.ball.centre) / rig.ball.radius
        facing[i] = np.all(np.sum(normal * (pose.position - p), axis=1) > 0.0)
    assert np.mean(seen.whole != facing) < 0.005  # the sampled rim misses its lowest point by a hair
    assert np.all(np.isnan(seen.area[~seen.whole]))
    assert np.all(np.isfinite(seen.centroid[seen.whole]))


def test_outline_and_mask_of_the_ball():
    """Against the silhouette of many points of the sphere."""
    rig, pose = device(PLAIN, station=(0.2, 0.1, 2.4))
    rng = np.random.default_rng(1)
    d = rng.normal(size=(40000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    uv = to_image(rig.ball.centre + rig.ball.radius * d, rig, pose)
    outline = ball_outline(rig, pose)
    hull = cv2.convexHull(uv.astype(np.float32))
    distance = [cv2.pointPolygonTest(hull, (float(x), float(y)), True) for x, y in outline]
    assert np.abs(distance).max() < 0.3
    mask = ball_mask(rig, pose)
    assert mask.shape == (480, 640)
    inside = (uv > 1).all(axis=1) & (uv < [638, 478]).all(axis=1)
    pixel = np.rint(uv[inside]).astype(int)
    assert np.mean(mask[pixel[:, 1], pixel[:, 0]] == 255) > 0.99
    area, _ = polygon_moments(np.clip(outline, -0.5, [639.5, 479.5]))
    assert_allclose(np.count_nonzero(mask), area, rtol=0.02)


def test_largest_disc_is_larger_than_any_other():
    for camera in (PLAIN, STRONG):
        rig, pose = device(camera)
        u = directions(rig, pose)
        axes = np.sqrt(np.linalg.eigvalsh(appearance(u, rig, pose).shape)[:, 1])
        assert largest_disc(rig, pose) > 1.6 * axes.max()
        assert largest_disc(rig, pose) < 2.2 * axes.max()


def test_no_directions_no_appearance():
    rig, pose = device(PLAIN)
    seen = appearance(np.zeros((0, 3)), rig, pose)
    assert len(seen.area) == len(seen.whole) == 0
    assert seen.shape.shape == (0, 2, 2)
    hidden = appearance(-directions(rig, pose)[:3], rig, pose)
    assert_array_equal(hidden.whole, False)


@pytest.mark.parametrize(("height", "covers"), [(0.9, True), (-0.9, False)])
def test_a_ring_target_covers_the_ball_if_it_is_in_front_of_it(height, covers):
    rig, pose = device(PLAIN)
    at = rig.ball.centre + height * (pose.position - rig.ball.centre) / np.linalg.norm(pose.position)
    targets = Targets((0,), ("CMY",), at[None], np.zeros((3, 3)), np.array([0.01, 0.02, 0.03]))
    mask = clear_mask(replace(rig, targets=targets), pose)
    edge, beside = at + np.array([0.029, 0.0, 0.0]), at + np.array([0.05, 0.0, 0.0])
    inside, outside = (to_image(p[None], rig, pose)[0] for p in (edge, beside))
    values = [mask[round(float(v)), round(float(u))] for u, v in (inside, outside)]
    assert values == [0 if covers else 255, 255]
