"""The outline of a ball: through points of it, and found in films by what turns, within its stated covariance."""

import cv2
import numpy as np
import pytest

from spheremouse.calibrate.outline.find import find_outline
from spheremouse.calibrate.outline.fit import R_OBJ_CAM, fit_outline, pinhole, rays_of, rig_of, rotation_scale
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, sphere_outline
from spheremouse.geometry.rotation import tangent_basis
from spheremouse.geometry.statistics import gate
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate

CAMERA = InteriorOrientation(640, 480, 600.0, 600.0, 330.0, 230.0, np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))
CENTRE = np.array([0.4, -0.3, 4.0])
PX = 1.0 / 600.0


def error(outline, centre):
    """Return the errors of direction, along the outline's axes, and of the angular radius, for a ball of radius 1."""
    distance = np.linalg.norm(centre)
    across = tangent_basis(outline.direction).T @ (centre / distance)
    return np.array([*across, np.arcsin(1.0 / distance) - outline.angle])


def seen(centre, camera, n):
    return sphere_outline(centre, 1.0, camera, n)


@pytest.mark.parametrize("n", [3, 4, 50])
def test_points_on_the_outline_give_the_ball_also_through_a_bent_lens(n):
    outline = fit_outline(rays_of(seen(CENTRE, CAMERA, n), CAMERA), PX)
    np.testing.assert_allclose(outline.centre, CENTRE, atol=1e-9)


def test_the_covariance_is_the_scatter_of_fits_to_noisy_points():
    rng, points = np.random.default_rng(1), seen(CENTRE, CAMERA, 12)
    fits = [fit_outline(rays_of(points + rng.normal(size=points.shape), CAMERA), PX) for _ in range(300)]
    nees = np.mean([error(o, CENTRE) @ np.linalg.solve(o.covariance, error(o, CENTRE)) for o in fits])
    assert 2.0 < nees < 3.6  # the covariance grows if 9 residuals scatter more than stated, and never shrinks


def test_a_robust_fit_leaves_out_what_hides_the_outline():
    points = seen(CENTRE, CAMERA, 120)
    points[:20] += 15.0
    outline = fit_outline(rays_of(points, CAMERA), PX, robust=True)
    np.testing.assert_allclose(outline.centre, CENTRE, atol=1e-6)


@pytest.mark.parametrize("points", [[(10, 10), (20, 20), (30, 30)], [(5, 5)] * 4, [(0, 0), (639, 0), (320, 1)]])
def test_points_that_are_on_no_outline_are_refused(points):
    with pytest.raises(CalibrationError, match="give points all around it"):
        fit_outline(rays_of(np.array(points, float), CAMERA), PX)


def test_the_camera_of_the_rig_sees_the_ball_where_its_outline_is_and_the_place_has_its_covariance():
    outline = fit_outline(rays_of(seen(CENTRE, CAMERA, 8), CAMERA), PX)
    rig = rig_of(outline, CAMERA)
    assert rig.scale_free
    assert rig.disc_radius is None
    np.testing.assert_allclose(rig.pose.to_cam(np.zeros(3)), CENTRE, atol=1e-9)
    np.testing.assert_array_equal(rig.pose.rotation, R_OBJ_CAM)
    rng = np.random.default_rng(2)
    draws = rng.multivariate_normal(np.zeros(3), outline.covariance, 4000)
    centres = []
    for a, b, c in draws:
        u = outline.direction + tangent_basis(outline.direction) @ (a, b)
        centres.append(-R_OBJ_CAM @ u / np.linalg.norm(u) / np.sin(outline.angle + c))
    expected = rig.pose.covariance[:3, :3]
    np.testing.assert_allclose(np.cov(np.transpose(centres)), expected, atol=0.1 * np.abs(expected).max())


def test_the_effect_of_a_wrong_focal_length_is_that_of_the_motion_in_the_middle_of_the_ball():
    assumed, true = pinhole((640, 480), 45.0), pinhole((640, 480), 41.0)
    points = seen(np.array([0.0, 0.0, 4.0]), true, 20)
    outline = fit_outline(rays_of(points, assumed), PX)

    def pixels(camera, distance):  # of a radian in the middle
        return camera.fx / (distance - 1.0)

    measured = pixels(true, 4.0) / pixels(assumed, 1.0 / np.sin(outline.angle))
    assert rotation_scale(outline, true.fx / assumed.fx) == pytest.approx(measured, rel=1e-9)


# ---- films ----


def film(seconds=4.0, **options):
    made = prepare(SimulationOptions(motion="play", seconds=seconds, fps=10.0, noise=4.0, size=(320, 240), **options))
    rig = made.scene.rig()
    images = [picture.frame.image for picture in simulate(made)]
    return images, rig.camera, made.scene.pose.to_cam(np.zeros(3)) / rig.ball.radius


@pytest.fixture(scope="module")
def speckled():
    return film(pattern="speckle", seed=3)


@pytest.mark.parametrize(
    ("pattern", "blur"), [("patches", 0.0), pytest.param("marble", 1.0, marks=pytest.mark.slow), ("speckle", 0.6)]
)
def test_a_ball_that_turns_is_found_within_its_covariance(pattern, blur, speckled):
    images, camera, centre = speckled if pattern == "speckle" else film(pattern=pattern, seed=5)
    blurred = [cv2.GaussianBlur(image, (0, 0), blur) if blur else image for image in images]
    outline, _ = find_outline(blurred, camera)
    off = error(outline, centre)
    assert off @ np.linalg.solve(outline.covariance, off) < gate(0.999, 3)
    assert np.abs(off).max() * camera.fx < 0.6  # px
    assert outline.sigma[1] * camera.fx < 0.8


def test_hands_and_another_light_do_not_matter(speckled):
    images, camera, centre = speckled
    images = [image.copy() for image in images]
    for k in range(5, 12):
        cv2.circle(images[k], (40 + 10 * k, 20), 35, (90, 120, 160), -1)
    images[20] = (0.4 * images[20]).astype(np.uint8)
    images = [np.clip(image * (1.0 + 0.05 * (k % 3)), 0, 255).astype(np.uint8) for k, image in enumerate(images)]
    outline, _ = find_outline(images, camera)
    assert np.abs(error(outline, centre)).max() * camera.fx < 0.8


def twice(image):
    small = cv2.resize(image, (160, 120))
    return np.pad(np.hstack([small, small]), ((60, 60), (0, 0), (0, 0)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda image: image // 12, "black; light the ball"),
        (lambda image: np.full_like(image, 255), "overexposed; shorten the exposure"),
        (twice, "several balls turn"),
        (lambda image: np.roll(image, 150, axis=1) * (np.arange(320) > 150)[None, :, None].astype(np.uint8), "outline"),
    ],
)
def test_pictures_without_one_whole_ball_are_refused_with_a_remedy(speckled, change, words):
    images, camera, _ = speckled
    with pytest.raises(CalibrationError, match=words):
        find_outline([change(image) for image in images], camera)


def test_a_ball_that_rests_and_a_moving_board_are_no_ball(speckled):
    images, camera, _ = speckled
    rng = np.random.default_rng(4)
    still = [np.clip(images[0] + rng.normal(0, 2, images[0].shape), 0, 255).astype(np.uint8) for _ in range(20)]
    with pytest.raises(CalibrationError, match=r"nothing moves .*turn the ball"):
        find_outline(still, camera)
    for image in still:
        image[60:180, 80:240] = rng.integers(0, 255, (120, 160, 3))
    with pytest.raises(CalibrationError, match=r"no round outline|no ball turns"):
        find_outline(still, camera)


@pytest.mark.parametrize("vfov", [0.3, 5.0, 100.0])
def test_the_pixels_of_the_outline_do_not_depend_on_the_lens(speckled, vfov):
    images, true, centre = speckled
    camera = pinhole((320, 240), vfov)
    outline, _ = find_outline(images, camera)
    x, y = np.mean(outline.pixels(camera) - seen(centre, true, 360), axis=0)
    assert abs(x) < 0.6
    assert abs(y) < 0.6


@pytest.mark.parametrize("size", [(1, 40), (40, 1), (12, 12), (50, 60)])
def test_noise_of_any_size_is_no_ball(size):
    rng = np.random.default_rng(6)
    with pytest.raises(CalibrationError):
        find_outline([rng.integers(30, 220, size, dtype=np.uint8) for _ in range(5)], pinhole(size[::-1], 45.0))
