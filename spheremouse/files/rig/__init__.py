"""rig.yaml and camera.yaml: what calibration knows of a device, to and from files a person can read and mend.

Units, frames and conventions are those of `rig` and `camera`: metres, `obj`, OpenCV's k1 k2 p1 p2 k3. Everything a
file claims is checked here, so that the core may take it as true.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from ruamel.yaml import YAML
from scipy.linalg import block_diag

from spheremouse.ball.rig import CODES, MOST_DISCS, UNKNOWN_READOUT, Ball, Rig, Targets
from spheremouse.files.atomic import write_atomically
from spheremouse.files.validate import read_checked
from spheremouse.files.yaml import SCHEMA, Key, Problem
from spheremouse.geometry.camera import MAX_SIDE, InteriorOrientation, Pose, pose_from_matrix, too_large
from spheremouse.geometry.rotation import Array

Code = Literal["CMY", "CYM", "MCY", "MYC", "YCM", "YMC"]
assert get_args(Code) == CODES

# Lengths are in metres, or in any unit where the scale is free: a millionth and a million hold a ball of millimetres as
# well as one of kilometres, and their squares and quotients are numbers yet.
_GREATEST = 1e6
Length = Annotated[float, Field(ge=1.0 / _GREATEST, le=_GREATEST)]
Coordinate = Annotated[float, Field(ge=-_GREATEST, le=_GREATEST)]
Variance = Annotated[float, Field(ge=-(_GREATEST**2), le=_GREATEST**2)]
Focal = Annotated[float, Field(ge=1.0, le=_GREATEST)]  # px: the smallest picture at 170°, and a telescope's
Principal = Annotated[float, Field(ge=-MAX_SIDE, le=2 * MAX_SIDE)]  # px
Distortion = Annotated[float, Field(ge=-_GREATEST, le=_GREATEST)]  # of a long lens, k3 may come out as anything
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Row = Annotated[tuple[Variance, ...], Field(max_length=3 * len(CODES))]
Matrix = Annotated[tuple[Row, ...], Field(max_length=3 * len(CODES))]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, protected_namespaces=())


class _Camera(_Part):
    width: int = Field(gt=0, le=MAX_SIDE, description="width of the images in px")
    height: int = Field(gt=0, le=MAX_SIDE, description="height of the images in px")
    fx: Focal = Field(description="focal length in px")
    fy: Focal = Field(description="focal length in px")
    cx: Principal = Field(description="principal point in px, 0 the centre of the leftmost column")
    cy: Principal = Field(description="principal point in px, 0 the centre of the topmost row")
    dist: tuple[Distortion, Distortion, Distortion, Distortion, Distortion] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0), description="lens distortion [k1, k2, p1, p2, k3], OpenCV's order"
    )
    covariance: Matrix | None = Field(None, description="9 x 9 of fx, fy, cx, cy, k1, k2, p1, p2, k3")


class _Ball(_Part):
    radius: Length = Field(description="radius of the ball in m")
    center: Vector3 = Field((0.0, 0.0, 0.0), description="centre [x, y, z] in m, obj; the origin by definition")
    covariance: Matrix | None = Field(None, description="4 x 4 of centre x, y, z and radius in m²")


class _Target(_Part):
    id: int = Field(ge=-(2**31), lt=2**31, description="a whole number that names the target")
    code: Code = Field(description="colours inside to outside")
    position: Vector3 = Field(description="[x, y, z] in m, obj")
    covariance: Matrix | None = Field(None, description="3 x 3 in m², where the targets are not correlated")


class _Provenance(BaseModel):
    """Date, version, photos, notes, and whatever else; nothing here reads it."""

    model_config = ConfigDict(extra="allow")


class _CameraFile(_Part):
    camera: _Camera = Field(description="width, height, fx, fy, cx, cy and dist of the camera")
    provenance: _Provenance | None = Field(None, description="where the numbers come from: a section, for people")


class _RigFile(_CameraFile):
    ball: _Ball = Field(description="radius of the ball, and what else is known of it")
    scale: Literal["metric", "free"] = Field(
        "metric", description="metric: lengths are in m; free: in a unit of their own, such as the ball's radius"
    )
    disc_radius: Length = Field(description="radius of a disc in m, along the ball's surface")
    readout_s: float | None = Field(
        None, ge=0, lt=1, description="time a rolling shutter takes over all rows in s; 0: global; null: unknown"
    )
    exposure_s: float = Field(
        0.0, ge=0, lt=1, description="time the shutter is open in s, which tells the blur of a fast ball; 0: unknown"
    )
    target_radii: tuple[Length, Length, Length] | None = Field(
        None, description="[inner disc, middle ring, outer ring] in m"
    )
    targets: tuple[_Target, ...] = Field((), max_length=len(CODES), description="list of {id, code, position}")
    targets_covariance: Matrix | None = Field(
        None, description="3n x 3n in m², x, y, z of the first target, x, y, z of the second, ..."
    )
    targets_ball_covariance: Matrix | None = Field(
        None, description="3n x 4 in m² of the targets' coordinates with the ball's centre x, y, z and radius"
    )
    T_obj_cam: Matrix | None = Field(None, description="4 x 4, a point in camera coordinates to obj")
    pose_covariance: Matrix | None = Field(None, description="6 x 6 of camera position (m) and rotation (rad) in obj")
    pose_ball_covariance: Matrix | None = Field(
        None, description="6 x 4 of the pose with the ball's centre x, y, z and radius"
    )
    discs: tuple[Vector3, ...] = Field((), max_length=MOST_DISCS, description="list of unit vectors [x, y, z] in ball")


def load_rig(path: Path) -> Rig:
    """The rig of a file; ConfigurationError with a line per problem."""
    document, file = read_checked(path, _RigFile)
    if problems := [*_camera_problems(file.camera), *_rig_problems(file)]:
        raise document.error(problems)
    return Rig(
        camera=_interior(file.camera),
        ball=Ball(file.ball.radius, np.array(file.ball.center), _matrix(file.ball.covariance, 4)),
        targets=Targets(
            ids=tuple(t.id for t in file.targets),
            codes=tuple(t.code for t in file.targets),
            position=np.array([t.position for t in file.targets]).reshape(-1, 3),
            covariance=_targets_covariance(file),
            radii=np.array(file.target_radii or (0.0, 0.0, 0.0)),
        ),
        disc_radius=file.disc_radius,
        readout_s=file.readout_s or 0.0,
        readout_sigma_s=UNKNOWN_READOUT if file.readout_s is None else 0.0,
        exposure_s=file.exposure_s,
        pose=_pose(file),
        disc_directions=_unit_rows(file.discs) if file.discs else None,
        cross_covariance=None if file.targets_ball_covariance is None else np.array(file.targets_ball_covariance),
        scale_free=file.scale == "free",
    )


def load_camera(path: Path) -> InteriorOrientation:
    """The interior orientation of a camera file; ConfigurationError with a line per problem."""
    document, file = read_checked(path, _CameraFile)
    if problems := list(_camera_problems(file.camera)):
        raise document.error(problems)
    return _interior(file.camera)


def with_camera(rig: Rig, camera: InteriorOrientation) -> Rig:
    """The rig seen through another interior orientation: calibrated at another resolution, or another lens."""
    return dataclasses.replace(rig, camera=camera)


def save_rig(path: Path, rig: Rig, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a rig file that reads back to the same rig; whole or not at all."""
    write_atomically(path, rig_text(rig, provenance))


def save_camera(path: Path, camera: InteriorOrientation, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a camera file that reads back to the same interior orientation; whole or not at all."""
    write_atomically(path, f"schema: {SCHEMA}\n{_provenance_text(provenance)}{_camera_text(camera)}")


def rig_text(rig: Rig, provenance: Mapping[str, Any] | None = None) -> str:
    """A rig as YAML. `provenance` says where it comes from: date, version, photos (file, sha256), notes.

    It is kept for people; reading the file leaves it out.
    """
    units = "Pixels, and lengths in a unit of their own" if rig.scale_free else "Metres and pixels"
    lines = [
        f"# A device as calibrated. {units}; obj: ball centre, X right, Y up, Z towards the camera.",
        f"schema: {SCHEMA}",
        *_provenance_text(provenance).splitlines(),
        *(["scale: free  # nobody measured a length: counts are per radian"] if rig.scale_free else []),
        _camera_text(rig.camera).rstrip(),
        "ball:",
        f"  radius: {float(rig.ball.radius)!r}",
        f"  center: {_flow(rig.ball.centre)}",
        *_covariance_lines(rig.ball.covariance, "  covariance", "  # m², of centre x, y, z and radius"),
        f"disc_radius: {float(rig.disc_radius)!r}  # along the ball's surface",
        f"readout_s: {_readout(rig)}  # time a rolling shutter takes over all rows; 0: global; null: unknown",
        f"exposure_s: {float(rig.exposure_s)!r}  # time the shutter is open; 0: unknown",
    ]
    if np.any(rig.targets.radii):
        lines.append(f"target_radii: {_flow(rig.targets.radii)}  # inner disc, middle ring, outer ring")
    lines += _targets_lines(rig)
    if rig.pose is not None:
        lines += _matrix_lines(rig.pose.matrix(), "T_obj_cam", "  # a point in camera coordinates to obj")
        lines += _covariance_lines(
            rig.pose.covariance, "pose_covariance", "  # m and rad, position and rotation in obj"
        )
        lines += _covariance_lines(rig.pose.ball_covariance, "pose_ball_covariance", "  # with centre x, y, z, radius")
    if rig.disc_directions is not None and len(rig.disc_directions):
        lines += _matrix_lines(rig.disc_directions, "discs", "  # unit vectors in ball")
    return "\n".join(lines) + "\n"


def _camera_text(camera: InteriorOrientation) -> str:
    return (
        f"camera:\n  width: {int(camera.width)}\n  height: {int(camera.height)}\n"
        f"  fx: {float(camera.fx)!r}\n  fy: {float(camera.fy)!r}\n"
        f"  cx: {float(camera.cx)!r}\n  cy: {float(camera.cy)!r}\n"
        f"  dist: {_flow(camera.distortion)}  # k1, k2, p1, p2, k3\n"
    ) + "".join(
        f"{line}\n"
        for line in _covariance_lines(camera.covariance, "  covariance", "  # of fx, fy, cx, cy, k1, k2, p1, p2, k3")
    )


def _targets_lines(rig: Rig) -> list[str]:
    """Each target with a covariance of its own where that is all; else what they have in common after the last."""
    joint, n = rig.targets.covariance, len(rig.targets.ids)
    own = joint.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]
    correlated = bool(np.any(joint != block_diag(*own))) if n else False
    lines = ["targets:  # colours inside to outside" if n else "targets: []"]
    for id_, code, position, covariance in zip(
        rig.targets.ids, rig.targets.codes, rig.targets.position, own, strict=True
    ):
        lines += [f"  - id: {int(id_)}", f"    code: {code}", f"    position: {_flow(position)}"]
        lines += [] if correlated else _covariance_lines(covariance, "    covariance", "  # m²")
    lines += _matrix_lines(joint, "targets_covariance", "  # m², of x, y, z of each target") if correlated else []
    if rig.cross_covariance is not None:
        comment = "  # m², of the same rows with the ball's centre x, y, z and radius"
        lines += _covariance_lines(rig.cross_covariance, "targets_ball_covariance", comment)
    return lines


def _provenance_text(provenance: Mapping[str, Any] | None) -> str:
    if not provenance:
        return ""
    yaml, stream = YAML(), StringIO()
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.width = 10_000  # a line each
    yaml.representer.ignore_aliases = lambda *_: True  # written out: aliases are not read
    yaml.dump({"provenance": dict(provenance)}, stream)
    return stream.getvalue()


def _readout(rig: Rig) -> str:
    return "null" if rig.readout_sigma_s > 0.0 else repr(float(rig.readout_s))


def _flow(values: Array) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


def _matrix_lines(rows: Array, name: str, comment: str) -> list[str]:
    indent = " " * (len(name) - len(name.lstrip()) + 2)
    return [f"{name}:{comment}", *(f"{indent}- {_flow(row)}" for row in rows)]


def _covariance_lines(matrix: Array, name: str, comment: str) -> list[str]:
    return _matrix_lines(matrix, name, comment) if np.any(matrix) else []


def _interior(c: _Camera) -> InteriorOrientation:
    covariance = _matrix(c.covariance, 9)
    return InteriorOrientation(c.width, c.height, c.fx, c.fy, c.cx, c.cy, np.array(c.dist), covariance)


def _matrix(rows: Matrix | None, n: int, m: int | None = None) -> Array:
    return np.zeros((n, m or n)) if rows is None else np.array(rows, dtype=float)


def _targets_covariance(file: _RigFile) -> Array:
    n = len(file.targets)
    if file.targets_covariance is not None or n == 0:
        return _matrix(file.targets_covariance, 3 * n)
    return np.asarray(block_diag(*(_matrix(t.covariance, 3) for t in file.targets)))


def _pose(file: _RigFile) -> Pose | None:
    if file.T_obj_cam is None:
        return None
    pose = pose_from_matrix(_matrix(file.T_obj_cam, 4), _matrix(file.pose_covariance, 6))
    return dataclasses.replace(pose, ball_covariance=_matrix(file.pose_ball_covariance, 6, 4))


def _unit_rows(vectors: tuple[Vector3, ...]) -> Array:
    v = np.array(vectors)
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _camera_problems(c: _Camera) -> Iterator[Problem]:
    if problem := too_large(c.width, c.height):
        yield Problem(("camera",), problem)
    for name, value, size in (("cx", c.cx, c.width), ("cy", c.cy, c.height)):
        if not -size <= value <= 2 * size:
            text = f"is {value:g}, far outside an image of {size} px; it is given in px, and lies near {size / 2:g}"
            yield Problem(("camera", name), text)
    yield from _covariance_problems(("camera", "covariance"), c.covariance, 9)


def _rig_problems(file: _RigFile) -> Iterator[Problem]:
    ball = list(_covariance_problems(("ball", "covariance"), file.ball.covariance, 4))
    yield from ball
    if file.disc_radius >= file.ball.radius:
        yield Problem(("disc_radius",), f"is {file.disc_radius:g} m, not smaller than the ball; both are in metres")
    yield from _spread_problems(file)
    yield from _target_problems(file)
    targets = list(_targets_covariance_problems(file))
    yield from targets
    pose = list(_pose_problems(file))
    yield from pose
    if not ball and not targets:
        key = ("targets_ball_covariance",)
        yield from _cross_problems(key, _targets_covariance(file), file.targets_ball_covariance, file.ball)
    if not ball and not pose:
        key = ("pose_ball_covariance",)
        yield from _cross_problems(key, _matrix(file.pose_covariance, 6), file.pose_ball_covariance, file.ball)
    for i, disc in enumerate(file.discs):
        if abs(np.linalg.norm(disc) - 1.0) > 1e-3:
            yield Problem(("discs", i), f"has length {np.linalg.norm(disc):.4g}; give a unit vector")


def _spread_problems(file: _RigFile) -> Iterator[Problem]:
    """Covariances so large that nothing is known: beyond a hundred of the ball's radii, or half a turn."""
    r = 100.0 * file.ball.radius
    own = [(("targets", i, "covariance"), target.covariance, [r] * 3) for i, target in enumerate(file.targets)]
    for key, rows, most in (
        (("ball", "covariance"), file.ball.covariance, [r] * 4),
        (("targets_covariance",), file.targets_covariance, [r] * (3 * len(file.targets))),
        (("pose_covariance",), file.pose_covariance, [r] * 3 + [math.pi] * 3),
        *own,
    ):
        if rows is not None and _is_square(rows, len(most)):
            for i, limit in enumerate(most):
                if rows[i][i] > limit**2:
                    text = f"has the variance {rows[i][i]:g}, of a standard deviation above {limit:g}"
                    yield Problem((*key, i), f"{text}: that is not known at all")


def _target_problems(file: _RigFile) -> Iterator[Problem]:
    radii = file.target_radii
    if radii is not None and not radii[0] < radii[1] < radii[2]:
        yield Problem(
            ("target_radii",), f"are {', '.join(f'{r:g}' for r in radii)}; they must grow from inside to outside"
        )
    if radii is None and file.targets:
        yield Problem((), "target_radii: missing; give [inner disc, middle ring, outer ring] in m")
    for i, target in enumerate(file.targets):
        before = file.targets[:i]
        if target.id in (t.id for t in before):
            yield Problem(("targets", i, "id"), f"{target.id} names another target already; give each its own")
        if target.code in (t.code for t in before):
            yield Problem(("targets", i, "code"), f"{target.code} is on another target already; each code appears once")
        if target.position in (t.position for t in before):
            yield Problem(("targets", i, "position"), "another target is in this very place; measure one of them again")


def _targets_covariance_problems(file: _RigFile) -> Iterator[Problem]:
    for i, target in enumerate(file.targets):
        key = ("targets", i, "covariance")
        yield from _covariance_problems(key, target.covariance, 3)
        if target.covariance is not None and file.targets_covariance is not None:
            yield Problem(key, "stands in targets_covariance, too; remove one of them")
    yield from _covariance_problems(("targets_covariance",), file.targets_covariance, 3 * len(file.targets))


def _pose_problems(file: _RigFile) -> Iterator[Problem]:
    if file.pose_covariance is not None and file.T_obj_cam is None:
        yield Problem(("pose_covariance",), "belongs to T_obj_cam, which is missing; give both or none")
    if file.pose_ball_covariance is not None and file.pose_covariance is None:
        yield Problem(("pose_ball_covariance",), "belongs to pose_covariance, which is missing; give both or none")
    yield from _covariance_problems(("pose_covariance",), file.pose_covariance, 6)
    if file.T_obj_cam is None:
        return
    key: Key = ("T_obj_cam",)
    if not _is_square(file.T_obj_cam, 4):
        yield Problem(key, f"must be 4 rows of 4 numbers, is {_shape(file.T_obj_cam)}")
        return
    T = _matrix(file.T_obj_cam, 4)
    R = T[:3, :3]
    if not np.array_equal(T[3], [0, 0, 0, 1]):
        yield Problem((*key, 3), "must be [0, 0, 0, 1]; is the matrix transposed?")
    elif np.abs(R.T @ R - np.eye(3)).max() > 1e-3:
        yield Problem(key, "its first 3 x 3 are not a rotation (columns of length 1 at right angles); copy all digits")
    elif np.linalg.det(R) < 0:
        yield Problem(key, "its first 3 x 3 mirror (determinant -1); all frames here are right-handed")
    elif np.linalg.norm(T[:3, 3] - file.ball.center) <= file.ball.radius:
        yield Problem(key, "puts the camera inside the ball; is it T_cam_obj, or not in metres?")


def _covariance_problems(key: Key, rows: Matrix | None, n: int) -> Iterator[Problem]:
    if rows is None:
        return
    if not _is_square(rows, n):
        yield Problem(key, f"must be {n} rows of {n} numbers, is {_shape(rows)}")
        return
    C = _matrix(rows, n)
    scale = np.sqrt(np.abs(np.outer(np.diag(C), np.diag(C))))  # units differ from row to row
    if np.any(np.diag(C) < 0):
        i = int(np.argmin(np.diag(C)))
        yield Problem((*key, i), f"has the negative variance {C[i, i]:g} on its diagonal; variances are squares")
    elif np.any(np.abs(C - C.T) > 1e-6 * scale):
        i, j = np.unravel_index(int(np.argmax(np.abs(C - C.T) - 1e-6 * scale)), C.shape)
        yield Problem(
            key, f"is not symmetric: {C[i, j]:g} against {C[j, i]:g} in rows {i + 1} and {j + 1}; make them equal"
        )
    elif not _is_covariance(C):
        yield Problem(key, "is not positive semidefinite: some correlation is beyond 1; copy all digits")


def _cross_problems(key: Key, C: Array, rows: Matrix | None, ball: _Ball) -> Iterator[Problem]:
    """Problems of the block between what has the covariance C, (n, n), and the ball: the whole must be a covariance."""
    if rows is None:
        return
    if len(rows) != len(C) or not all(len(row) == 4 for row in rows):
        yield Problem(key, f"must be {len(C)} rows of 4 numbers, is {_shape(rows)}")
        return
    X = np.array(rows)
    if not _is_covariance(np.block([[C, X], [X.T, _matrix(ball.covariance, 4)]])):
        text = "does not go with the covariances of its rows and of the ball: some correlation is beyond 1"
        yield Problem(key, f"{text}; copy all digits")


def _is_covariance(C: Array) -> bool:
    """Is a symmetric matrix with a diagonal >= 0 positive semidefinite, to the digits a file gives?"""
    scale = np.sqrt(np.outer(np.diag(C), np.diag(C)))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(scale > 0, C / scale, np.where(C == 0, 0.0, np.inf))
    return bool(np.isfinite(correlation).all() and np.linalg.eigvalsh(correlation).min(initial=0.0) >= -1e-6)


def _is_square(rows: Matrix, n: int) -> bool:
    return len(rows) == n and all(len(row) == n for row in rows)


def _shape(rows: Matrix) -> str:
    return f"{len(rows)} rows of {'/'.join(sorted({str(len(r)) for r in rows})) or 0}"
