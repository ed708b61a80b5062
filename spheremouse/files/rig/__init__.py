"""Write and read rig.yaml and camera.yaml, the results of a calibration.

Units, frames and conventions are those of `rig` and `camera`: metres, `obj`, OpenCV's k1 k2 p1 p2 k3. The
reader checks every value, so the core does not.
"""

import contextlib
import dataclasses
from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from spheremouse.ball.rig import UNKNOWN_READOUT, Ball, Rig, Targets, found_from_picture
from spheremouse.errors import ConfigurationError
from spheremouse.files.rig.checks import camera_problems, rig_problems
from spheremouse.files.rig.models import CameraFile, CameraPart, RigFile, block_diagonal, matrix, targets_covariance
from spheremouse.files.safe_files import write_atomically
from spheremouse.files.validate import read_checked
from spheremouse.files.yaml import SCHEMAS
from spheremouse.geometry.camera import InteriorOrientation, Pose, pose_from_matrix
from spheremouse.geometry.rotation import Array


def load_rig(path: Path) -> Rig:
    """Read a rig from a file; ConfigurationError with a line for each problem."""
    with contextlib.suppress(PermissionError, ValueError):  # which the reader reports
        if not path.exists():
            advice = "calibrate (`spheremouse calibrate next`), or check the path"
            raise ConfigurationError(f"{path}: no such file; {advice}")
    document, file = read_checked(path, RigFile, "rig")
    if problems := [*camera_problems(file.camera), *rig_problems(file)]:
        raise document.error(problems)
    discs = np.array(file.discs)
    return Rig(
        camera=_interior(file.camera),
        ball=Ball(file.ball.radius, np.array(file.ball.center), matrix(file.ball.covariance, 4)),
        targets=Targets(
            ids=tuple(t.id for t in file.targets),
            codes=tuple(t.code for t in file.targets),
            position=np.array([t.position for t in file.targets]).reshape(-1, 3),
            covariance=targets_covariance(file),
            radii=np.array(file.target_radii or (0.0, 0.0, 0.0)),
            normal=np.array(file.target_normal),
        ),
        disc_radius=file.disc_radius,
        readout_s=file.readout_s or 0.0,
        readout_sigma_s=UNKNOWN_READOUT if file.readout_s is None else 0.0,
        exposure_s=file.exposure_s,
        pose=_pose(file),
        disc_directions=discs / np.linalg.norm(discs, axis=1, keepdims=True) if file.discs else None,
        cross_covariance=None if file.targets_ball_covariance is None else np.array(file.targets_ball_covariance),
        scale_free=file.scale == "free",
    )


def load_camera(path: Path) -> InteriorOrientation:
    """Read the interior orientation of a camera file; ConfigurationError with a line for each problem."""
    document, file = read_checked(path, CameraFile, "rig")
    if problems := list(camera_problems(file.camera)):
        raise document.error(problems)
    return _interior(file.camera)


def save_rig(path: Path, rig: Rig, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a rig file, whole or not at all; it reads back to the same rig."""
    write_atomically(path, rig_text(rig, provenance))


def save_camera(path: Path, camera: InteriorOrientation, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a camera file, whole or not at all; it reads back to the same interior orientation."""
    write_atomically(path, f"schema: {SCHEMAS['rig']}\n{_provenance_text(provenance)}{_camera_text(camera)}")


def rig_text(rig: Rig, provenance: Mapping[str, Any] | None = None) -> str:
    """Return a rig as YAML. `provenance` holds date, version, photos (file, sha256) and notes for people."""
    units = "Pixels, and lengths in a unit of their own" if rig.scale_free else "Metres and pixels"
    readout = "null" if rig.readout_sigma_s > 0.0 else repr(float(rig.readout_s))
    lines = [
        f"# A device as calibrated. {units}; obj: ball centre, X right, Y up, Z towards the camera.",
        f"schema: {SCHEMAS['rig']}",
        *_provenance_text(provenance).splitlines(),
        *(["scale: free  # without a measured length, counts are per radian"] if rig.scale_free else []),
        _camera_text(rig.camera).rstrip(),
        "ball:",
        f"  radius: {float(rig.ball.radius)!r}",
        f"  center: {_flow(rig.ball.centre)}",
        *_covariance_lines(rig.ball.covariance, "  covariance", "  # m², of centre x, y, z and radius"),
        *([] if rig.disc_radius is None else [f"disc_radius: {float(rig.disc_radius)!r}  # along the ball's surface"]),
        f"readout_s: {readout}  # time a rolling shutter takes over all rows; 0: global; null: unknown",
        f"exposure_s: {float(rig.exposure_s)!r}  # time the shutter is open; 0: unknown",
    ]
    if np.any(rig.targets.radii):
        lines.append(f"target_radii: {_flow(rig.targets.radii)}  # inner disc, middle ring, outer ring")
    if rig.targets.normal[2] != 1.0:
        lines.append(
            f"target_normal: {_flow(rig.targets.normal)}  # that they face, in the axes of another camera's rig"
        )
    lines += _targets_lines(rig)
    if rig.pose is not None:
        lines += _matrix_lines(rig.pose.matrix(), "T_obj_cam", "  # a point in camera coordinates to obj")
        lines += _covariance_lines(
            rig.pose.covariance, "pose_covariance", "  # m and rad, position and rotation in obj"
        )
        lines += _covariance_lines(rig.pose.ball_covariance, "pose_ball_covariance", "  # with centre x, y, z, radius")
        if np.any(rig.pose.by_focal != found_from_picture(rig.pose, rig.ball.centre).by_focal):
            lines.append(f"pose_by_focal: {_flow(rig.pose.by_focal)}  # m and rad, by a relative error of fx, fy")
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
    """Return the YAML lines of n targets, with a covariance each or, if they are correlated, a joint one, (3n, 3n)."""
    joint, n = rig.targets.covariance, len(rig.targets.ids)
    own = joint.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]
    correlated = bool(np.any(joint != block_diagonal(own))) if n else False
    lines = ["targets:  # colours inside to outside" if n else "targets: []"]
    for id_, code, position, covariance in zip(
        rig.targets.ids, rig.targets.codes, rig.targets.position, own, strict=True
    ):
        lines += [f"  - id: {int(id_)}", f"    code: {code}", f"    position: {_flow(position)}"]
        lines += [] if correlated else _covariance_lines(covariance, "    covariance", "  # m²")
    lines += _matrix_lines(joint, "targets_covariance", "  # m², of x, y, z of each target") if correlated else []
    if rig.cross_covariance is not None:
        comment = "  # m², rows x, y, z of each target, columns the ball's x, y, z and radius"
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


def _flow(values: Array) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


def _matrix_lines(rows: Array, name: str, comment: str) -> list[str]:
    indent = " " * (len(name) - len(name.lstrip()) + 2)
    return [f"{name}:{comment}", *(f"{indent}- {_flow(row)}" for row in rows)]


def _covariance_lines(matrix: Array, name: str, comment: str) -> list[str]:
    return _matrix_lines(matrix, name, comment) if np.any(matrix) else []


def _interior(c: CameraPart) -> InteriorOrientation:
    covariance = matrix(c.covariance, 9)
    return InteriorOrientation(c.width, c.height, c.fx, c.fy, c.cx, c.cy, np.array(c.dist), covariance)


def _pose(file: RigFile) -> Pose | None:
    if file.T_obj_cam is None:
        return None
    pose = pose_from_matrix(matrix(file.T_obj_cam, 4), matrix(file.pose_covariance, 6))
    pose = dataclasses.replace(pose, ball_covariance=matrix(file.pose_ball_covariance, 6, 4))
    if file.pose_by_focal is not None:
        return dataclasses.replace(pose, by_focal=np.array(file.pose_by_focal))
    return found_from_picture(pose, np.array(file.ball.center))
