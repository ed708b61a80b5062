"""Corners of a board in an image, and the camera they give: against OpenCV, against truth, against chance."""

import cv2
import numpy as np
import pytest
from boards import CAMERA, PATTERN, picture, places, views
from conftest import datasets_dir
from scipy.stats import chi2

from spheremouse.calibrate.board import Pattern
from spheremouse.calibrate.camera import bundle as bundle_module
from spheremouse.calibrate.camera.adjust import calibrate_board
from spheremouse.calibrate.camera.bundle import View
from spheremouse.calibrate.camera.corners import find_board, measure_in_plane
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import exp, log

SIZE = CAMERA.width, CAMERA.height
TRUTH = np.concatenate([CAMERA.intrinsic, CAMERA.distortion])
CHARUCO = Pattern(9, 6, 0.03, 0.0225)
STILLS = np.array([1404.0, 1404.0, 967.0, 540.0, -0.49, 0.3, -0.0001, -0.0001, -0.11])


def nine(camera):
    return np.concatenate([camera.intrinsic, camera.distortion])


def scene(seed, n, **how):
    """A generator of random numbers, and n places of the board by it."""
    rng = np.random.default_rng(seed)
    return rng, *places(n, rng, **how)


def test_corners_lie_where_the_board_projects():
    """Refined in the board's plane they are nearer than `cornerSubPix` leaves them."""
    rng, R, t = scene(1, 3)
    before, after = [], []
    for k in range(3):
        image = picture(R[k], t[k], rng=rng, noise=1.5)
        seen = find_board(image, PATTERN)
        assert np.array_equal(seen.ids, np.arange(54))
        truth, _ = project(PATTERN.corners() @ R[k].T + t[k], CAMERA)
        if np.linalg.norm(seen.uv[0] - truth[0]) > 10.0:  # found from its other end
            turn = exp(np.array([0.0, 0.0, np.pi]))
            far = PATTERN.corners()[-1]
            R[k], t[k] = R[k] @ turn, t[k] + R[k] @ far
            truth = truth[::-1]
        fine = measure_in_plane(image, PATTERN, seen, CAMERA, R[k], t[k])
        before.append(seen.uv - truth)
        after.append(fine.uv - truth[fine.ids])
        assert len(fine.ids) == 54
    rms = [np.sqrt(np.mean(np.sum(np.concatenate(e) ** 2, axis=1))) for e in (before, after)]
    assert rms[0] < 0.1
    assert rms[1] < 0.75 * rms[0]
    assert rms[1] < 0.06


def test_a_faint_row_beside_the_board_is_not_a_part_of_it():
    """Infrared photographs of a 9x6 board have such rows, and OpenCV's search for the largest board takes them."""
    rng, R, t = scene(3, 8)
    for k in range(2):
        image, longer = (picture(R[k], t[k], pattern).astype(float) for pattern in (PATTERN, Pattern(9, 7, 0.03)))
        image = np.rint(0.7 * image + 0.3 * longer + rng.normal(0.0, 1.5, image.shape)).clip(0, 255).astype(np.uint8)
        largest = cv2.findChessboardCornersSBWithMeta(image, (3, 3), cv2.CALIB_CB_LARGER)[2]
        assert largest.size == 63
        seen = find_board(image, PATTERN)
        assert len(seen.ids) == 54
        truth, _ = project(PATTERN.corners() @ R[k].T + t[k], CAMERA)
        truth = min(truth, truth[::-1], key=lambda uv: float(np.abs(uv - seen.uv).max()))
        assert np.abs(seen.uv - truth).max() < 0.5


def test_another_count_is_no_board_and_is_told():
    _, R, t = scene(3, 1, tilt=(10.0, 25.0))
    image = picture(R[0], t[0])
    for columns, rows in ((8, 5), (10, 6), (5, 4), (10, 8)):
        seen = find_board(image, Pattern(columns, rows, 0.03))
        assert len(seen.ids) == 0
        assert seen.grid == (9, 6)


def test_rows_and_columns_may_be_exchanged():
    _, R, t = scene(4, 1)
    image = picture(R[0], t[0])
    along, across = find_board(image, PATTERN), find_board(image, Pattern(6, 9, 0.03))
    assert len(across.ids) == 54
    gap = np.linalg.norm(along.uv[:, None] - across.uv[None], axis=2).min(axis=1)
    assert gap.max() < 0.1  # the same corners in another order
    homography, _ = cv2.findHomography(Pattern(6, 9, 0.03).corners()[:, :2], across.uv)
    assert np.linalg.det(homography) > 0.0  # not mirrored


def test_a_charuco_board_may_be_cut_off():
    _, R, t = scene(6, 1, tilt=(10.0, 30.0))
    image = picture(R[0], t[0], CHARUCO)
    truth, _ = project(CHARUCO.corners() @ R[0].T + t[0], CAMERA)
    whole = find_board(image, CHARUCO)
    assert len(whole.ids) == 54
    assert np.sqrt(np.mean(np.sum((whole.uv - truth) ** 2, axis=1))) < 0.15
    fine = measure_in_plane(image, CHARUCO, whole, CAMERA, R[0], t[0])
    assert np.sqrt(np.mean(np.sum((fine.uv - truth[fine.ids]) ** 2, axis=1))) < 0.1
    image[:, int(np.percentile(truth[:, 0], 60)) :] = 120
    part = find_board(image, CHARUCO)
    assert 12 <= len(part.ids) < 54
    assert np.linalg.norm(part.uv - truth[part.ids], axis=1).max() < 0.5


def test_another_charuco_board_has_no_corners():
    _, R, t = scene(7, 1, tilt=(10.0, 30.0))
    image = picture(R[0], t[0], CHARUCO)
    for other in (Pattern(8, 6, 0.03, 0.0225), Pattern(9, 6, 0.03, 0.0225, "DICT_4X4_100")):
        assert len(find_board(image, other).ids) == 0


def test_jacobian_is_the_finite_difference():
    rng, R, t = scene(8, 3)
    bundle = bundle_module.Bundle(views(R, t, rng, 0.5), SIZE, np.ones(13, bool))
    shape = np.array([0.002, 0.005, -0.003, 0.004])
    x = np.concatenate([TRUTH, shape, np.stack([[log(r) for r in R], t], axis=1).ravel()])
    sigma = np.array([0.1, 0.2, 0.3])
    J = bundle.jacobian(x, sigma)[1].toarray()
    steps = np.concatenate([np.full(4, 1e-3), np.full(5, 1e-6), np.full(4, 1e-5), np.full(18, 1e-6)])
    for k, step in enumerate(steps):
        d = step * np.eye(len(x))[k]
        plus, minus = (bundle.jacobian(bundle.retract(x, s * d), sigma)[0] for s in (1.0, -1.0))
        difference = (plus - minus) / (2.0 * step)
        assert np.allclose(J[:, k], difference, rtol=1e-5, atol=1e-5 * np.abs(difference).max())


@pytest.mark.slow
def test_covariance_is_the_scatter_of_errors():
    """NEES of the nine unknowns over calibrations with the same noise; and of the poses."""
    rng = np.random.default_rng(10)
    runs, camera_nees, pose_nees, spread = 50, 0.0, 0.0, []
    for _ in range(runs):
        R, t = places(8, rng)
        sigma = rng.uniform(0.05, 0.2, 8)
        given = [views(R[k : k + 1], t[k : k + 1], rng, sigma[k])[0] for k in range(8)]
        found = calibrate_board(given, SIZE)
        error = nine(found.camera) - TRUTH
        camera_nees += error @ np.linalg.solve(found.camera.covariance, error)
        turn = log(found.rotations[2] @ R[2].T)
        error = np.concatenate([turn, found.translations[2] - t[2]])
        pose_nees += error @ np.linalg.solve(found.covariance[21:27, 21:27], error)
        spread.append(found.sigma / sigma)
    for value, size in ((camera_nees, 9), (pose_nees, 6)):
        low, high = chi2.ppf((0.025, 0.975), runs * size)
        assert low < value < high
    assert np.mean(spread) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("zoom", [1.1, 1.2, 1.6])
def test_a_view_of_another_zoom_is_left_out(zoom):
    rng, R, t = scene(11, 10)
    given = views(R, t, rng, 0.08)
    middle = np.array([CAMERA.cx, CAMERA.cy])
    given[4] = View(given[4].points, (given[4].uv - middle) * zoom + middle)
    found = calibrate_board(given, SIZE)
    assert np.flatnonzero(~found.used).tolist() == [4]
    assert found.view_rms()[4] > 4.0 * found.rms
    assert np.all(np.abs(nine(found.camera) - TRUTH) < 3.5 * found.deviations)


def test_a_false_corner_is_left_out():
    rng, R, t = scene(12, 10)
    given = views(R, t, rng, 0.08)
    given[3].uv[17] += (2.0, -1.0)
    found = calibrate_board(given, SIZE)
    assert [np.flatnonzero(~k).tolist() for k in found.kept] == [[17] if v == 3 else [] for v in range(10)]


@pytest.mark.slow
@pytest.mark.parametrize(("bow", "stretch"), [(0.0, 0.0), (0.02, 0.0), (0.0, 0.004), (-0.01, -0.002)])
def test_a_board_need_not_be_flat_or_printed_true(bow, stretch):
    """A plate that bows by `bow` of half its diagonal, or a print stretched along its columns, shifts no camera."""
    rng = np.random.default_rng(21)
    corners = PATTERN.corners()
    plate = bundle_module.Plate.of(corners)
    errors, chi_squares = [], []
    for _ in range(8):
        R, t = places(10, rng)
        angle = rng.uniform(0.0, np.pi)
        c, s = np.cos(angle), np.sin(angle)
        shape = np.array([stretch, *(bow * np.array([c * c, 2.0 * c * s, s * s]))])
        true = corners + plate.by_shape(corners) @ shape
        given = views(R, t, rng, 0.05, true)
        found = calibrate_board(given, SIZE)
        error = nine(found.camera) - TRUTH
        chi_squares.append(error @ np.linalg.solve(found.camera.covariance, error))
        off = float(np.abs(true[:, 2]).max())
        errors.append([(found.bow[0] - off) / found.bow[1], (found.stretch[0] - stretch) / found.stretch[1]])
    assert np.sum(chi_squares) < chi2.isf(0.001, 72)
    assert np.abs(errors).max() < 4.0


def test_errors_common_to_a_view_widen_the_covariance():
    """A print that bends as it is held: its errors are not independent, and corners alone would not tell."""
    rng = np.random.default_rng(13)
    beyond, plain = [], []
    for _ in range(6):
        R, t = places(10, rng)
        corners = PATTERN.corners()
        mean = corners.mean(axis=0)
        given = []
        for rotation, translation in zip(R, t, strict=True):
            along = rng.normal(size=2)
            bend = 2e-3 * (((corners - mean)[:, :2] @ along / np.linalg.norm(along)) / 0.12) ** 2  # m; as it is held
            bent = corners + np.array([0.0, 0.0, 1.0]) * bend[:, None]
            given += views(rotation[None], translation[None], rng, 0.05, bent)
        found = calibrate_board(given, SIZE)
        error = nine(found.camera) - TRUTH
        nees = error @ np.linalg.solve(found.camera.covariance, error) / 9.0
        beyond.append(nees)
        plain.append(nees * found.contradiction)
    assert np.mean(plain) > 5.0
    assert np.mean(beyond) < 0.4 * np.mean(plain)


def test_terms_that_are_held_stay_zero():
    rng, R, t = scene(15, 8)
    given = views(R, t, rng, 0.1)
    for terms in (0, 2, 4):
        found = calibrate_board(given, SIZE, terms)
        assert np.all(found.camera.distortion[terms:] == 0.0)
        assert np.all(found.deviations[4 + terms :] == 0.0)
        assert np.all(found.deviations[: 4 + terms] > 0.0)


@pytest.mark.parametrize(
    ("n", "how", "words"),
    [(2, {}, "2 views do not determine"), (6, {"tilt": (0.0, 0.0)}, "leave the focal length open")],
)
def test_views_that_do_not_determine_the_camera_are_refused(n, how, words):
    rng, R, t = scene(17, n, **how)
    with pytest.raises(CalibrationError, match=words):
        calibrate_board(views(R, t, rng, 0.1), SIZE)


@pytest.mark.slow
def test_reference_photos():
    """Nearer to the truth than OpenCV alone, and by no more than the standard deviations say."""
    folder = datasets_dir() / "stills" / "board"
    pattern = Pattern(11, 8, 0.086)
    images = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in sorted(folder.glob("*.jpg"))]
    seen = [find_board(image, pattern) for image in images]
    assert [len(s.ids) for s in seen] == [88] * 15
    first = calibrate_board([View(pattern.corners()[s.ids], s.uv) for s in seen], (1920, 1080))
    fine = [
        measure_in_plane(image, pattern, s, first.camera, R, t)
        for image, s, R, t in zip(images, seen, first.rotations, first.translations, strict=True)
    ]
    found = calibrate_board([View(pattern.corners()[s.ids], s.uv) for s in fine], (1920, 1080))
    error = nine(found.camera) - STILLS
    assert np.all(np.abs(error[:2]) < 5e-4 * 1404.0)
    assert np.all(np.abs(error[2:4]) < 0.5)
    assert found.rms < 0.06
    assert np.all(np.abs(error) < 3.5 * found.deviations)
    assert error @ np.linalg.solve(found.camera.covariance, error) < chi2.isf(0.01, 9)
