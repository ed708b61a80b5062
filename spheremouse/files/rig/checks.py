"""Find contradictory values of a rig.yaml, each with its place and its remedy."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from spheremouse.files.rig.models import BallPart, CameraPart, Matrix, RigFile, matrix, targets_covariance
from spheremouse.files.yaml import Key, Problem
from spheremouse.geometry.camera import too_large
from spheremouse.geometry.rotation import Array

_MAX_RADII = 100.0  # of the ball, standard deviation of a length: beyond, it carries no information


def camera_problems(c: CameraPart) -> Iterator[Problem]:
    if problem := too_large(c.width, c.height):
        yield Problem(("camera",), problem)
    for name, value, size in (("cx", c.cx, c.width), ("cy", c.cy, c.height)):
        if not -size <= value <= 2 * size:
            text = f"is {value:g}, far outside an image of {size} px; it is given in px, and lies near {size / 2:g}"
            yield Problem(("camera", name), text)
    yield from _covariance_problems(("camera", "covariance"), c.covariance, [math.inf] * 9)


def rig_problems(file: RigFile) -> Iterator[Problem]:
    spread = [_MAX_RADII * file.ball.radius] * 3
    ball = list(_covariance_problems(("ball", "covariance"), file.ball.covariance, [*spread, spread[0]]))
    yield from ball
    if file.disc_radius is not None and file.disc_radius >= file.ball.radius:
        yield Problem(("disc_radius",), f"is {file.disc_radius:g} m, not smaller than the ball; both are in metres")
    yield from _target_problems(file)
    targets = list(_targets_covariance_problems(file, spread))
    yield from targets
    pose = list(_pose_problems(file, spread))
    yield from pose
    if not ball and not targets:
        key = ("targets_ball_covariance",)
        yield from _cross_problems(key, targets_covariance(file), file.targets_ball_covariance, file.ball)
    if not ball and not pose:
        key = ("pose_ball_covariance",)
        yield from _cross_problems(key, matrix(file.pose_covariance, 6), file.pose_ball_covariance, file.ball)
    if abs(np.linalg.norm(file.target_normal) - 1.0) > 1e-6:
        length = np.linalg.norm(file.target_normal)
        yield Problem(("target_normal",), f"has length {length:.4g}; give a unit vector")
    for i, disc in enumerate(file.discs):
        if abs(np.linalg.norm(disc) - 1.0) > 1e-3:
            yield Problem(("discs", i), f"has length {np.linalg.norm(disc):.4g}; give a unit vector")


def _target_problems(file: RigFile) -> Iterator[Problem]:
    radii = file.target_radii
    if radii is not None and not radii[0] < radii[1] < radii[2]:
        yield Problem(
            ("target_radii",), f"are {', '.join(f'{r:g}' for r in radii)}; they must grow from inside to outside"
        )
    if radii is None and file.targets:
        yield Problem((), "target_radii: missing; give [inner disc, middle ring, outer ring] in m")
    yield from repeated_targets([(t.id, t.code) for t in file.targets])
    for i, target in enumerate(file.targets):
        if target.position in (t.position for t in file.targets[:i]):
            yield Problem(("targets", i, "position"), "another target is in this very place; measure one of them again")


def repeated_targets(targets: Sequence[tuple[int, str]]) -> Iterator[Problem]:
    """Yield ids and codes of (id, code) that an earlier target has."""
    for i, (id_, code) in enumerate(targets):
        if id_ in (other for other, _ in targets[:i]):
            yield Problem(("targets", i, "id"), f"{id_} names another target already; give each its own")
        if code in (other for _, other in targets[:i]):
            yield Problem(("targets", i, "code"), f"{code} is on another target already; each code appears once")


def _targets_covariance_problems(file: RigFile, spread: list[float]) -> Iterator[Problem]:
    for i, target in enumerate(file.targets):
        key = ("targets", i, "covariance")
        yield from _covariance_problems(key, target.covariance, spread)
        if target.covariance is not None and file.targets_covariance is not None:
            yield Problem(key, "stands in targets_covariance, too; remove one of them")
    yield from _covariance_problems(("targets_covariance",), file.targets_covariance, spread * len(file.targets))


def _pose_problems(file: RigFile, spread: list[float]) -> Iterator[Problem]:
    for name in ("pose_covariance", "pose_by_focal"):
        if getattr(file, name) is not None and file.T_obj_cam is None:
            yield Problem((name,), "belongs to T_obj_cam, which is missing; give both or none")
    if file.pose_ball_covariance is not None and file.pose_covariance is None:
        yield Problem(("pose_ball_covariance",), "belongs to pose_covariance, which is missing; give both or none")
    yield from _covariance_problems(("pose_covariance",), file.pose_covariance, [*spread, *[math.pi] * 3])
    if file.T_obj_cam is None:
        return
    key: Key = ("T_obj_cam",)
    if problem := _shape_problem(file.T_obj_cam, 4, 4):
        yield Problem(key, problem)
        return
    T = matrix(file.T_obj_cam, 4)
    R = T[:3, :3]
    if not np.array_equal(T[3], [0, 0, 0, 1]) or np.abs(R.T @ R - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        yield Problem(key, "is no [R, t; 0, 0, 0, 1] with a right-handed rotation R; copy all digits")
    elif np.linalg.norm(T[:3, 3] - file.ball.center) <= file.ball.radius:
        yield Problem(key, "puts the camera inside the ball; is it T_cam_obj, or not in metres?")


def _covariance_problems(key: Key, rows: Matrix | None, most: Sequence[float]) -> Iterator[Problem]:
    """Yield problems of a covariance; its standard deviations are at most `most`."""
    if rows is None:
        return
    if problem := _shape_problem(rows, len(most), len(most)):
        yield Problem(key, problem)
        return
    C = matrix(rows, len(most))
    if not _is_covariance(C):
        text = "must be symmetric, with variances of at least 0 and correlations of at most 1; copy all digits"
        yield Problem(key, text)
    for i in map(int, np.flatnonzero(np.diag(C) > np.square(most))):
        text = f"has the variance {C[i, i]:g}, of a standard deviation above {most[i]:g}: that is not known at all"
        yield Problem((*key, i), text)


def _cross_problems(key: Key, C: Array, rows: Matrix | None, ball: BallPart) -> Iterator[Problem]:
    """Yield problems of the block between the covariance C, (n, n), and the ball: the whole must be a covariance."""
    if rows is None:
        return
    if problem := _shape_problem(rows, len(C), 4):
        yield Problem(key, problem)
        return
    X = np.array(rows)
    if not _is_covariance(np.block([[C, X], [X.T, matrix(ball.covariance, 4)]])):
        text = "does not go with the covariances of its rows and of the ball: some correlation is beyond 1"
        yield Problem(key, f"{text}; copy all digits")


def _is_covariance(C: Array) -> bool:
    """Return True if a matrix is symmetric and positive semidefinite, within the digits of a file."""
    scale = np.sqrt(np.abs(np.outer(np.diag(C), np.diag(C))))  # units differ from row to row
    if np.any(np.diag(C) < 0) or np.any(np.abs(C - C.T) > 1e-6 * scale):
        return False
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(scale > 0, C / scale, np.where(C == 0, 0.0, np.inf))
    return bool(np.isfinite(correlation).all() and np.linalg.eigvalsh(correlation).min(initial=0.0) >= -1e-6)


def _shape_problem(rows: Matrix, n: int, m: int) -> str:
    """Return what is wrong with the shape of a matrix of n rows and m columns; empty if nothing is."""
    if len(rows) == n and all(len(row) == m for row in rows):
        return ""
    lengths = "/".join(sorted({str(len(row)) for row in rows})) or 0
    return f"must be {n} rows of {m} numbers, is {len(rows)} rows of {lengths}"
