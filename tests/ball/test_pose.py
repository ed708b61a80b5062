"""The camera's pose from targets: exact projections, Monte-Carlo scatter, eccentricity, ambiguity, refusals."""

from dataclasses import replace
from functools import cache
from itertools import permutations

import cv2
import numpy as np
import pytest
from ball_world import image_of, other
from conftest import central_differences
from numpy.testing import assert_allclose
from ray_cast import photo, polygon_moments, ray_cast, to_image
from scipy.linalg import block_diag
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.rings import TargetDetections
from spheremouse.ball.points import intersect
from spheremouse.ball.pose import Sighting, describe, find_pose, gather, predict_targets, resect
from spheremouse.ball.rig import CODES, Ball, Rig, Targets, considered_covariance
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import log, tangent_basis

SIGMA = 0.05  # px
CORNERS = np.array([[-0.3244, 0.1546, 0.5629], [-0.3244, -0.5954, 0.5629], [0.3256, -0.5954, 0.5629]])
CORNERS = np.vstack([CORNERS, [0.3256, 0.1546, 0.5629]])
RADII = np.array([0.012, 0.024, 0.036])
BLACK = np.zeros((480, 640, 3), np.uint8)


def pose_of(euler_deg, position):
    """Wittich 2017, table 2: Rx Ry Rz, and a camera that looks along its z axis."""
    return Pose(Rotation.from_euler("XYZ", euler_deg, degrees=True).as_matrix(), np.array(position))


FAR = InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0)
NEAR = InteriorOrientation(640, 480, 320.0, 320.0, 320.0, 240.0)
BENT = InteriorOrientation(640, 480, 320.0, 318.0, 322.0, 241.0, np.array([-0.2, 0.05, 1e-3, -5e-4, 0.0]))
VIEWS = {
    "far": (FAR, pose_of([180.0, 0.0, 90.0], [0.0, 0.0, 2.35])),
    "near": (NEAR, pose_of([-170.0, 0.0, 0.0], [0.0, -0.45, 1.27])),
    "bent": (BENT, pose_of([-172.0, 4.0, 20.0], [0.05, -0.4, 1.4])),
}
views = pytest.mark.parametrize("view", VIEWS)


def rig_of(camera, position=CORNERS, codes=CODES, sigma=0.0):
    n = len(position)
    covariance = sigma**2 * np.eye(3 * n)
    return Rig(camera, Ball(0.6), Targets(tuple(range(n)), codes[:n], position, covariance, RADII), 0.02)


def seen_centroids(rig, pose, n=720):
    """Mean centroid of each target's three circles: their rims projected by OpenCV, moments of the polygons."""
    t = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    circle = np.stack([np.cos(t), np.sin(t), np.zeros(n)], axis=1)

    def centroid(place, radius):
        return polygon_moments(to_image(place + radius * circle, rig, pose))[1]

    return np.array([np.mean([centroid(p, r) for r in rig.targets.radii], axis=0) for p in rig.targets.position])


def seen_from(view, *arguments):
    """Rig and pose of a camera of `VIEWS`."""
    camera, pose = VIEWS[view]
    return rig_of(camera, *arguments), pose


@cache
def picture_of_ball(view, shift=(0.0, 0.0, 0.0)):
    """The ball, shifted by so many m, without discs."""
    rig, pose = seen_from(view)
    return photo(ray_cast(np.zeros((0, 3)), rig, replace(pose, position=pose.position - shift)))


def sightings(centres, codes=CODES, sigma=SIGMA):
    return [Sighting(c, uv, sigma**2 * np.eye(2), 30) for c, uv in zip(codes, centres, strict=False)]


def pose_error(found, true):
    """(6,) m, rad, in the pose's own error model."""
    return np.concatenate([found.position - true.position, log(found.rotation @ true.rotation.T)])


@views
@pytest.mark.parametrize("n", [4, 6])
def test_exact_sightings_give_the_exact_pose(view, n):
    extra = np.array([[0.0, 0.5, 0.45], [0.45, -0.2, 0.3]])  # out of the plane of the others
    rig, pose = seen_from(view, np.vstack([CORNERS, extra])[:n])
    found = resect(sightings(seen_centroids(rig, pose)), rig, picture_of_ball(view))
    error = pose_error(found.pose, pose)
    assert np.abs(error).max() < 5e-5  # without the eccentricity, 1.5e-4 in the near view
    assert np.abs(found.residual).max() < 5e-3
    assert found.codes == CODES[:n]
    assert_allclose(predict_targets(found.pose, rig), seen_centroids(rig, pose), atol=0.01)


@views
def test_the_order_of_the_targets_does_not_matter(view):
    """Whichever way round they are listed; the plane they lie in is not z = 0."""
    found = []
    for order in permutations(range(4)):
        rig, pose = seen_from(view, CORNERS[list(order)])
        found.append(resect(sightings(seen_centroids(rig, pose)), rig, BLACK).pose)
    assert_allclose([p.position for p in found], np.tile(pose.position, (24, 1)), atol=1e-4)


SHIFT = np.array([0.7e-3, 0.9e-3, 3.3e-3])  # m, of all targets against the ball's centre: Wittich 2017, table 11
UNSURE_RADIUS = 2.7e-3  # m
OWN = 3e-4  # m, of each target by itself


def calibrated(camera):
    """A rig whose targets share the error of the ball's centre; that in Z and the radius are correlated to 0.998."""
    shared = np.kron(np.ones((4, 4)), np.diag(SHIFT**2))
    cross = np.zeros((12, 4))
    cross[2::3, 3] = 0.998 * SHIFT[2] * UNSURE_RADIUS
    rig = rig_of(camera)
    targets = replace(rig.targets, covariance=shared + OWN**2 * np.eye(12))
    ball = replace(rig.ball, covariance=np.diag([0.0, 0.0, 0.0, UNSURE_RADIUS**2]))
    return replace(rig, targets=targets, ball=ball, cross_covariance=cross)


def sampled(rig, rng):
    """A device as it may be in truth, and the error of the rig's radius."""
    R = rig.ball.covariance[3, 3]
    whole = np.block([[rig.targets.covariance, rig.cross_covariance[:, 3:]], [rig.cross_covariance[:, 3:].T, R]])
    e = rng.multivariate_normal(np.zeros(13), whole)
    position = rig.targets.position - e[:12].reshape(4, 3)
    ball = replace(rig.ball, radius=rig.ball.radius - e[12])
    return replace(rig, targets=replace(rig.targets, position=position), ball=ball), e[12]


def directions_of(d, true, true_pose, rig, pose):
    """Where directions d, (n, 3), are thought to be, and d_direction_d(pose, ball), (n, 3, 10): without image noise."""
    uv, exactly = image_of(d, true, true_pose), np.zeros(10)
    seen = Detections(uv, np.zeros((len(uv), 2, 2)), np.full(len(uv), 100.0))

    def direction(e):
        return intersect(seen, *other(rig, pose, e)).direction

    return direction(exactly), central_differences(direction, exactly)


@pytest.mark.parametrize("view", [pytest.param(v, marks=[] if v == "bent" else pytest.mark.slow) for v in VIEWS])
def test_a_calibrated_rig_gives_a_pose_and_directions_with_true_covariances(view):
    """Targets shifted in common, correlated with the radius: pose, its covariance with the ball, and what both give."""
    camera, pose = VIEWS[view]
    rig = calibrated(camera)
    picture = picture_of_ball(view)
    rng = np.random.default_rng(6)
    seen = pose.position / np.linalg.norm(pose.position) + np.array([[0.35, -0.3, 0.0], [0.0, 0.1, 0.0]])
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    errors, nees, apart, found = [], [], [], None
    for _ in range(200):
        true, radius_error = sampled(rig, rng)
        found = resect(sightings(seen_centroids(true, pose, 90) + SIGMA * rng.normal(size=(4, 2))), rig, picture)
        if found.variance_factor > 1.0:  # then the covariance is enlarged; residuals tell nothing of the pose's error
            continue
        e = np.append(pose_error(found.pose, pose), radius_error)
        errors.append(e)
        P = considered_covariance(found.pose, rig.ball)
        direction, J = directions_of(seen, true, pose, rig, found.pose)
        off = tangent_basis(seen[0]).T @ (direction[0] - seen[0])
        D = tangent_basis(seen[0]).T @ J[0]
        nees.append([e[:6] @ np.linalg.solve(P[:6, :6], e[:6]), off @ np.linalg.solve(D @ P @ D.T, off)])
        block = block_diag(P[:6, :6], P[6:, 6:])
        apart.append(off @ np.linalg.solve(D @ block @ D.T, off))
    n = len(nees)
    assert n > 80
    for mean, freedom in zip(np.mean(nees, axis=0), (6, 2), strict=True):
        low, high = chi2.ppf([0.0005, 0.9995], freedom * n) / n
        assert low < mean < high
    assert np.mean(apart) < np.mean(nees, axis=0)[1]  # without the correlation the directions pass for less certain
    sd = np.sqrt(np.diag(P))[[0, 1, 2, 3, 4, 5, 9]]
    expected = P[:6, 9] / sd[:6] / sd[6]
    assert expected[2] > 0.9
    assert_allclose(np.corrcoef(np.array(errors).T)[:6, 6], expected, atol=4.0 / np.sqrt(n))


def test_a_common_shift_adds_to_the_pose_and_is_not_enlarged_by_residuals():
    """Least squares with the covariance Q + A M Aᵀ: the same pose, and M on top (Rao's identity), whatever misfits."""
    rig, pose = seen_from("far")
    M = np.diag(SHIFT**2)
    shifted = replace(rig, targets=replace(rig.targets, covariance=np.kron(np.ones((4, 4)), M)))
    centres = seen_centroids(rig, pose) + np.array([[0.4, 0], [-0.4, 0], [0.4, 0], [-0.4, 0]])
    sharp, found = (resect(sightings(centres), r, BLACK) for r in (rig, shifted))
    assert found.variance_factor > 10.0
    sd = np.sqrt(np.diag(found.pose.covariance))
    assert_allclose(pose_error(found.pose, sharp.pose) / sd, 0.0, atol=1e-6)
    expected = sharp.pose.covariance + block_diag(M, np.zeros((3, 3)))
    assert_allclose(found.pose.covariance / np.outer(sd, sd), expected / np.outer(sd, sd), atol=1e-6)


def test_misfit_of_uncertain_targets_is_laid_to_the_image():
    """Between the covariance with the weights as given, and all of it enlarged; the residuals are then as expected."""
    camera, pose = VIEWS["far"]
    centres = seen_centroids(rig_of(camera), pose) + np.array([[0.4, 0], [-0.4, 0], [0.4, 0], [-0.4, 0]])
    believed = rig_of(camera, sigma=OWN)
    found = resect(sightings(centres), believed, BLACK)
    assert found.variance_factor > 3.0
    exact = resect(sightings(seen_centroids(rig_of(camera), pose)), believed, BLACK).pose.covariance
    ratio = np.diag(found.pose.covariance) / np.diag(exact)
    assert np.all(ratio > 1.5)
    # with image noise that makes the residuals fit, the weights as given make the covariance as it is found
    component = brentq(
        lambda f: resect(sightings(centres, sigma=SIGMA * f**0.5), believed, BLACK).variance_factor - 1.0, 1.0, 1e4
    )
    fitting = resect(sightings(centres, sigma=SIGMA * component**0.5), believed, BLACK).pose.covariance
    assert_allclose(np.diag(found.pose.covariance), np.diag(fitting), rtol=0.05)


def view_of(pairs):
    codes = tuple(c for c, _ in pairs)
    centre = np.array([uv for _, uv in pairs], dtype=float).reshape(-1, 2)
    return TargetDetections(codes, centre, np.full(len(codes), 12.0), tuple(np.zeros((4, 2), np.int32) for _ in codes))


def test_views_are_averaged_but_not_below_the_floor():
    rng = np.random.default_rng(3)
    place = np.array([100.0, 50.0])
    seen = [view_of([("CMY", place + 0.2 * rng.normal(size=2))]) for _ in range(400)]
    (s,) = gather(seen)
    assert s.code == "CMY"
    assert s.views > 380
    assert np.abs(s.centre - place).max() < 0.05
    assert_allclose(s.covariance, SIGMA**2 * np.eye(2) + 0.2**2 / 400 * np.eye(2), atol=3e-5)


def test_what_is_seen_now_and_then_or_moves_is_left_out():
    views = []
    for k in range(30):
        pairs = [("CMY", (100.0, 50.0)), ("MYC", (20.0 * k, 200.0))]
        if k < 5:
            pairs.append(("YCM", (300.0, 300.0)))
        views.append(view_of(pairs))
    assert [s.code for s in gather(views)] == ["CMY"]


def test_a_brushed_target_and_a_copy():
    rng = np.random.default_rng(4)
    views = []
    for k in range(30):
        at = np.array([100.0, 50.0]) + 0.02 * rng.normal(size=2) + (3.0 if k in (7, 8) else 0.0)
        views.append(view_of([("CMY", at), ("CMY", (400.0, 50.0))]))
    first, copy = gather(views)
    assert np.abs(first.centre - [100.0, 50.0]).max() < 0.05
    assert first.views == 28
    assert_allclose(copy.centre, [400.0, 50.0])


@views
def test_three_targets_and_the_outline_give_the_right_pose(view):
    rig, pose = seen_from(view)
    truth = seen_centroids(rig, pose)
    picture = picture_of_ball(view)
    for left_out in range(4):
        three = [s for i, s in enumerate(sightings(truth)) if i != left_out]
        found = resect(three, rig, picture)
        assert np.abs(pose_error(found.pose, pose)[:3]).max() < 1e-3
        assert found.variance_factor == 1.0


def test_three_targets_of_which_several_poses_fit_are_refused_without_the_outline():
    rig, pose = seen_from("near")
    three = sightings(seen_centroids(rig, pose))[:3]
    points, uv = CORNERS[:3], np.array([s.centre for s in three])
    count = cv2.solveP3P(points, uv[:, None], rig.camera.matrix, None, flags=cv2.SOLVEPNP_P3P)[0]
    assert count > 1  # else the refusal below would prove nothing
    with pytest.raises(PoseError, match="uncover a fourth target, or the edge of the ball"):
        resect(three, rig, BLACK)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_targets_name_the_missing(n):
    rig, pose = seen_from("far")
    with pytest.raises(PoseError) as e:
        resect(sightings(seen_centroids(rig, pose))[:n], rig, BLACK)
    message = str(e.value)
    assert message.startswith(f"{n} of 4 targets found")
    assert "\n" not in message
    missing = message.split("missing: ")[1]
    assert all(code in missing for code in CODES[n:4])
    assert not any(code in missing for code in CODES[:n])


@pytest.mark.parametrize(("sigma", "expected"), [(0.0, False), (2.0, True)])
def test_a_blurred_picture_is_named_as_the_cause(sigma, expected):
    picture = picture_of_ball("far")
    picture = cv2.GaussianBlur(picture, (0, 0), sigma) if sigma else picture
    with pytest.raises(PoseError) as e:
        find_pose([], seen_from("far")[0], picture)
    assert ("focus the lens" in str(e.value)) is expected


@views
@pytest.mark.parametrize("place", [[60.0, 60.0], [500.0, 400.0]])
def test_a_copy_of_a_target_elsewhere_in_the_room(view, place):
    rig, pose = seen_from(view)
    true = sightings(seen_centroids(rig, pose))
    copy = Sighting(CODES[1], np.array(place), SIGMA**2 * np.eye(2), 30)
    for order in ([copy, *true], [*true, copy]):
        found = resect(order, rig, picture_of_ball(view))
        assert np.abs(pose_error(found.pose, pose)[:3]).max() < 1e-4
        assert len(found.codes) == 4


@views
def test_a_copy_while_the_real_one_is_hidden(view):
    rig, pose = seen_from(view)
    true = sightings(seen_centroids(rig, pose))
    true[1] = Sighting(CODES[1], np.array([60.0, 60.0]), SIGMA**2 * np.eye(2), 30)
    try:
        found = resect(true, rig, picture_of_ball(view))
    except PoseError:
        return
    assert np.abs(pose_error(found.pose, pose)[:3]).max() < 1e-3


@views
@pytest.mark.parametrize(
    ("places", "shown"),
    [
        (CORNERS * [1.15, 0.85, 1.0] + [[0.05, 0, 0], [0, 0.04, 0], [0, 0, 0], [0, -0.05, 0]], range(4)),
        *((CORNERS + np.random.default_rng(k).normal(size=(4, 3)) * [0.06, 0.06, 0.0], range(3)) for k in range(4)),
        (CORNERS[[1, 0, 2, 3]], range(4)),
    ],
    ids=["another device", *["three of another device"] * 4, "exchanged codes"],
)
def test_targets_of_another_device_are_refused(view, places, shown):
    """Three targets always fit some pose, but the ball is not where that pose has it."""
    rig, pose = seen_from(view)
    seen = [sightings(seen_centroids(seen_from(view, places)[0], pose))[k] for k in shown]
    with pytest.raises(PoseError):
        resect(seen, rig, picture_of_ball(view))


LINE = np.stack([np.linspace(-0.3, 0.3, 4), np.zeros(4), np.full(4, 0.56)], axis=1)


@pytest.mark.parametrize("places", [LINE[:3], LINE, np.tile(CORNERS[:1], (4, 1))], ids=["three", "four", "one place"])
def test_targets_that_leave_a_rotation_open_are_refused(places):
    rig, pose = seen_from("far", places)
    with pytest.raises(PoseError):
        resect(sightings(seen_centroids(rig, pose)), rig, picture_of_ball("far"))


def test_describe_reads_like_table_12():
    rig, pose = seen_from("far")
    found = resect(sightings(seen_centroids(rig, pose)), rig, picture_of_ball("far"))
    text = describe(found, rig)
    lines = text.split("\n")
    assert lines[0].startswith("targets CMY, CYM, MCY, MYC; residual RMS 0.0")
    sigma = np.sqrt(np.diag(found.pose.covariance))
    (row,) = [line for line in lines if line.startswith("sigma")]
    values = [float(x) for x in row.replace("mm", " ").replace("°", " ").split()[1:]]
    assert_allclose(values, [*1e3 * sigma[:3], *np.rad2deg(sigma[3:])], atol=6e-3)
    correlation = found.pose.covariance / np.outer(sigma, sigma)
    (row,) = [line for line in lines if line.startswith("rot Z")]
    assert_allclose([float(x) for x in row.split()[2:]], correlation[5, :5], atol=6e-4)
    assert lines[-1].split()[0] == "position"
    assert "2350 mm" in lines[-1]
