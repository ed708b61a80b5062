"""The bundle adjustment: its Jacobian against differences, its frame, and its covariances against truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.stats import chi2

from spheremouse.ball.device import Axes, Device, Distance
from spheremouse.calibrate.device import bundle
from spheremouse.calibrate.device.adjust import _ball, _on_ball
from spheremouse.calibrate.device.bundle import Block, ImagePoints, Problem, Solution, predicted, solve_block
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array, exp, log
from spheremouse.simulate.ball.stills import looking

CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1404.0, 967.0, 540.0, np.array([-0.49, 0.3, -1e-4, -1e-4, -0.11]))
SD = np.array([0.3, 0.3, 0.3, 0.3, 1e-3, 4e-3, 5e-5, 5e-5, 5e-3])  # of an interior orientation from a board
TARGETS = np.array([[0.0, 0.75, 0.0], [0.0, 0.0, 0.0], [0.65, 0.02, 0.0], [0.65, 0.75, 0.01]])
PAIRS = ((1, 2), (1, 4), (2, 3), (3, 4))


def device(rng: np.random.Generator, *, free: bool = False) -> Device:
    tape = tuple(
        Distance(a, b, float(np.linalg.norm(TARGETS[a - 1] - TARGETS[b - 1]) + 1e-3 * rng.standard_normal()), 1e-3)
        for a, b in PAIRS
    )
    radii = np.array([0.012, 0.024, 0.036])
    return Device((1, 2, 3, 4), ("MCY", "CYM", "YMC", "CMY"), radii, 0.02, Axes(2, 1, 3), () if free else tape)


def stations(rng: np.random.Generator, to: Array, n: int = 6) -> tuple[Pose, ...]:
    """Cameras around the front, looking at `to`."""
    azimuth, height = np.radians(np.linspace(-45, 45, n)), np.radians([5, 25, -5, 30, 10, -10])[np.arange(n) % 6]
    poses = []
    for a, e in zip(azimuth, height, strict=True):
        way = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        roll = rng.uniform(-1.5, 1.5)
        poses.append(looking(to + rng.uniform(2.0, 3.0) * way, to, roll))
    return tuple(poses)


def simulated(
    seed: int, *, free: bool = False, interior: bool = True, sigma: float = 0.05
) -> tuple[Problem, Block, Block]:
    rng = np.random.default_rng(seed)
    known = device(rng, free=free)
    points = np.concatenate([TARGETS, rng.uniform([-0.1, 0.1, -0.5], [0.7, 0.9, 0.0], (8, 3))])
    true = Block(CAMERA, stations(rng, np.array([0.3, 0.5, -0.3])), points)
    photo, point = (a.ravel() for a in np.meshgrid(np.arange(6), np.arange(len(points)), indexing="ij"))
    image = ImagePoints(photo, point, np.zeros((len(photo), 2)), np.tile(sigma**2 * np.eye(2), (len(photo), 1, 1)))
    uv = predicted(true, image, Problem(known, CAMERA, image, free))[0] + sigma * rng.standard_normal((len(photo), 2))
    camera = CAMERA
    if interior:
        e = SD * rng.standard_normal(9)
        c = CAMERA
        camera = replace(
            c, fx=c.fx + e[0], fy=c.fy + e[1], cx=c.cx + e[2], cy=c.cy + e[3], distortion=c.distortion + e[4:]
        )
        camera = replace(camera, covariance=np.diag(SD**2))
    poses = tuple(
        Pose(exp(0.02 * rng.standard_normal(3)) @ p.rotation, p.position + 0.02 * rng.standard_normal(3))
        for p in true.poses
    )
    off = 0.02 * rng.standard_normal(points.shape)
    off[1] = off[0, [0, 2]] = off[2, 2] = 0.0
    if free:
        off[0, 1] = 0.0
    return Problem(known, camera, replace(image, centre=uv), free), Block(camera, poses, points + off), true


@pytest.mark.parametrize("depth", [False, True])
def test_jacobian_is_the_finite_difference(depth):
    problem, start, _ = simulated(0)
    start = replace(start, ball=np.array([0.3, 0.5, -0.3, 0.4]))
    problem = replace(problem, out_of_round=0.1)
    if depth:
        problem = replace(problem, depth=np.full((len(problem.image), 2), (2.5, 0.05)))
    columns = bundle.columns_of(problem, start)

    def at(x):
        return bundle.evaluate(problem, bundle.apply_step(start, columns, x), columns)

    # what the lens' parameters do to a ring's eccentricity is left out: a thousandth
    def limit(j):
        rows = np.full(len(J), 1e-5)
        if columns.free[j] < bundle.INTERIOR:
            rows[: 2 * len(problem.image)] = np.repeat(np.where(problem.image.point < 4, 1e-2, 1e-5), 2)
        return rows

    J = at(np.zeros(len(columns.free)))[1].toarray()
    for j, step in enumerate(1e-6 * np.eye(len(columns.free))):
        difference = (at(step)[0] - at(-step)[0]) / 2e-6
        size = np.abs(difference).max()
        assert np.all(np.abs(J[:, j] - difference) <= limit(j) * size + 1e-6)


def test_exact_observations_give_back_the_truth():
    problem, start, true = simulated(2, interior=False, sigma=1e-4)
    exact = tuple(
        replace(d, metres=float(np.linalg.norm(TARGETS[d.start - 1] - TARGETS[d.end - 1])), sigma=1e-6)
        for d in problem.device.distances
    )
    problem = replace(problem, device=replace(problem.device, distances=exact))
    block = solve_block(problem, start).block
    np.testing.assert_allclose(block.points, true.points, atol=2e-6)
    for ours, theirs in zip(block.poses, true.poses, strict=True):
        np.testing.assert_allclose(ours.matrix(), theirs.matrix(), atol=5e-6)


def test_frame_is_held_by_its_three_targets():
    problem, start, _ = simulated(3)
    solution = solve_block(problem, start)
    origin, up, plane = (solution.block.points[i] for i in (1, 0, 2))
    np.testing.assert_array_equal(origin, 0.0)
    np.testing.assert_array_equal(up[[0, 2]], 0.0)
    assert plane[2] == 0.0
    held = np.flatnonzero(np.diag(solution.covariance) == 0.0)
    assert len(held) == 6


def test_free_scale_holds_one_distance_more_and_fits_as_well():
    problem, start, true = simulated(4, free=True)
    solution = solve_block(problem, start)
    assert np.count_nonzero(np.diag(solution.covariance) == 0.0) == 7
    scale = np.linalg.norm(true.points[0]) / np.linalg.norm(solution.block.points[0])
    np.testing.assert_allclose(solution.block.points * scale, true.points, atol=5e-4)
    # a metre tape fixes what is free: the residuals are those of the same photos
    assert solution.residual @ solution.residual < chi2.ppf(0.999, len(solution.residual))


def test_pose_and_points_are_as_accurate_as_they_say():
    squares = []
    for seed in range(20):
        problem, start, true = simulated(100 + seed)
        solution = solve_block(problem, start)
        for i in range(6):
            here = solution.columns.pose(i)
            p, t = solution.block.poses[i], true.poses[i]
            e = np.concatenate([p.position - t.position, log(p.rotation @ t.rotation.T)])
            squares.append(e @ np.linalg.solve(solution.covariance[np.ix_(here, here)], e) / 6.0)
        for i in range(4, 12):
            here = solution.columns.point(i)
            e = solution.block.points[i] - true.points[i]
            squares.append(e @ np.linalg.solve(solution.covariance[np.ix_(here, here)], e) / 3.0)
    by_run = np.mean(np.reshape(squares, (20, -1)), axis=1)  # within a run they share tape and camera
    assert np.abs(by_run.mean() - 1.0) < 3.0 * by_run.std() / np.sqrt(20) + 0.02


def test_what_two_photos_do_not_fix_is_refused():
    problem, start, _ = simulated(5, interior=False)
    keep = (problem.image.point != 7) | (problem.image.photo == 0)  # one ray does not make a point
    problem = replace(problem, image=problem.image.take(keep))
    with pytest.raises(np.linalg.LinAlgError):
        solve_block(problem, start)


def test_interior_orientation_keeps_what_its_calibration_fixes():
    problem, start, _ = simulated(6)
    sure = np.diag(SD**2)
    sure[[0, 5], [0, 5]] = 0.0  # fx and k2 are held
    solution = solve_block(replace(problem, camera=replace(start.camera, covariance=sure)), start)
    assert solution.block.camera.fx == start.camera.fx
    assert solution.block.camera.distortion[1] == start.camera.distortion[1]
    after = np.diag(solution.covariance)[: bundle.INTERIOR]
    assert np.all(after <= np.diag(sure) * (1.0 + 1e-9))


@pytest.mark.parametrize(
    ("discs", "message"),
    [
        (np.zeros((0, 3)), "0 discs on the ball are known, a sphere takes at least 5"),
        (np.eye(4, 3), "4 discs on the ball are known, a sphere takes at least 5"),
        (np.pad(np.random.default_rng(0).uniform(size=(8, 2)), ((0, 0), (0, 1))), "the discs lie in a plane"),
    ],
    ids=["none", "four", "plane"],
)
def test_discs_that_fix_no_sphere_are_named(discs, message):
    problem, start, _ = simulated(7)
    block = replace(start, points=np.concatenate([TARGETS, discs]))
    columns = bundle.columns_of(problem, block)
    solution = Solution(block, columns, np.eye(columns.all), np.zeros(0), sparse.csr_array((0, len(columns.free))))
    with pytest.raises(CalibrationError, match=message):
        _ball(solution, len(TARGETS))


@pytest.mark.parametrize(("certainty", "radius"), [(0.0, 0.5), (1.0, np.nan)], ids=["singular", "no beginning"])
def test_a_sphere_that_cannot_be_adjusted_asks_for_more_of_the_ball(certainty, radius):
    problem, start, _ = simulated(8)
    solution = solve_block(problem, start)
    solution = replace(solution, covariance=certainty * solution.covariance)
    with pytest.raises(CalibrationError, match="photograph more of the ball"):
        _on_ball(problem, solution, np.array([0.3, 0.5, -0.3, radius]))
