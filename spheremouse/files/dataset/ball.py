"""Read recordings of a ball in its frame, with truth (`open_dataset`) or without (`open_frames`): docs/datasets.md."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from spheremouse.ball.rig import UNKNOWN_READOUT, Ball, Rig, Targets
from spheremouse.ball.truth import DiscTruth, Truth
from spheremouse.errors import ConfigurationError, DatasetError
from spheremouse.files.dataset import format as scene_format
from spheremouse.files.dataset.format import CameraEntry, Entry, Positive, SceneEntry, described
from spheremouse.files.dataset.frames import Recorded, fractional, recorded_fields
from spheremouse.files.rig import load_rig
from spheremouse.files.rig.models import Code
from spheremouse.files.tables import read_columns
from spheremouse.files.yaml import Document
from spheremouse.geometry.camera import Pose, pose_from_matrix
from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedBall(Recorded):
    """The checked description of a dataset, as far as a tracker may know it."""

    rig: Rig  # from rig.yaml, or from the geometry in scene.json: then all covariances are zero


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording(RecordedBall):
    """The checked description of a dataset with its truth."""

    pose: Pose | None  # the true pose of the camera
    truth: Truth | None
    discs: DiscTruth | None
    truth_directions: Array | None  # (m, 3) true unit vectors to the discs, ball
    turn: Array  # (3, 3) R_first_obj, true, from the axes of this recording to those of the first camera of a film


_Vector = tuple[float, float, float]
_Row4 = tuple[float, float, float, float]
_Matrix4 = tuple[_Row4, _Row4, _Row4, _Row4]


class _Ball(Entry):
    radius: Positive


class _Target(Entry):
    id: int
    code: Code
    position: _Vector


class _Scene(SceneEntry):
    readout_s: Annotated[float, Field(ge=0)] | None = None
    camera: CameraEntry
    ball: _Ball
    disc_radius: Positive | None = None
    targets: tuple[_Target, ...] = ()
    target_radii: tuple[Positive, Positive, Positive] | None = None
    T_obj_cam: _Matrix4 | None = None
    truth_T_obj_cam: _Matrix4 | None = None  # noqa: N815
    truth_R_first_obj: tuple[_Vector, _Vector, _Vector] | None = None  # noqa: N815
    truth_disc_directions: tuple[_Vector, ...] | None = None


def open_frames(path: Path) -> RecordedBall:
    """Read a dataset as `open_dataset` does, but of its truth the stamps alone: a table of discs takes long to read."""
    times, table = None, path / "truth.csv"
    scene = scene_format.read_description(path, _read_scene)
    if table.exists():
        times = _read_motion(table, scene_format.MOTION_COLUMNS[:2], scene.frames)["t"]
    return RecordedBall(**_recording_fields(path, scene, times))


def open_dataset(path: Path | str) -> Recording:
    """Read and check the description of a dataset folder; DatasetError names the invalid file."""
    path = Path(path)
    scene = scene_format.read_description(path, _read_scene)
    truth = _read_truth(path / "truth.csv", scene.frames) if (path / "truth.csv").exists() else None
    discs = _read_discs(path / "discs.csv", scene.frames) if (path / "discs.csv").exists() else None
    directions = None
    if scene.truth_disc_directions is not None:
        directions = np.array(scene.truth_disc_directions, dtype=float).reshape(-1, 3)
    return Recording(
        **_recording_fields(path, scene, None if truth is None else truth.stamp),
        pose=_pose(f"{path / 'scene.json'}: ", "truth_T_obj_cam", scene.truth_T_obj_cam),
        truth=truth,
        discs=discs,
        truth_directions=directions,
        turn=_turn(path, scene),
    )


def _recording_fields(path: Path, scene: _Scene, truth_times: Array | None) -> dict[str, Any]:
    rig = _recorded_rig(path / "rig.yaml", scene) if (path / "rig.yaml").exists() else _described_rig(scene)
    return {**recorded_fields(path, scene, rig.camera, truth_times), "rig": rig}


def _turn(path: Path, scene: _Scene) -> Array:
    turn = np.eye(3) if scene.truth_R_first_obj is None else np.array(scene.truth_R_first_obj, dtype=float)
    if not scene_format.is_rotation(turn):
        raise DatasetError(f"{path / 'scene.json'}: truth_R_first_obj: not a rotation (3 x 3)")
    return turn


def _read_scene(document: Document) -> _Scene:
    data, n = document.data, document.name
    if isinstance(data, dict) and "wand" in data and "ball" not in data:
        raise DatasetError(f"{n}this is a recording of a wand; use --tracker wand")
    scene = described(document, _Scene)
    if scene.targets and scene.target_radii is None:
        raise DatasetError(f"{n}target_radii: missing; targets need it")
    if min(len({t.id for t in scene.targets}), len({t.code for t in scene.targets})) < len(scene.targets):
        raise DatasetError(f"{n}targets: ids and codes must differ from one another")
    _pose(n, "T_obj_cam", scene.T_obj_cam)
    return scene


def _described_rig(scene: _Scene) -> Rig:
    """Return the rig of a scene.json, of which a tracker does not see the keys that begin with `truth_`.

    The places of the targets are exact, (n, 3) m in `obj`. Without `readout_s` the readout is unknown, and without
    `T_obj_cam` the camera's pose.
    """
    n = len(scene.targets)
    targets = Targets(
        ids=tuple(t.id for t in scene.targets),
        codes=tuple(t.code for t in scene.targets),
        position=np.array([t.position for t in scene.targets], dtype=float).reshape(n, 3),
        covariance=np.zeros((3 * n, 3 * n)),
        radii=np.array(scene.target_radii if scene.target_radii is not None else (0.0, 0.0, 0.0), dtype=float),
    )
    return Rig(
        camera=scene.interior_orientation(scene.camera),
        ball=Ball(scene.ball.radius),
        targets=targets,
        disc_radius=scene.disc_radius,
        readout_s=scene.readout_s or 0.0,
        readout_sigma_s=UNKNOWN_READOUT if scene.readout_s is None else 0.0,
        exposure_s=scene.exposure_s,
        pose=None if scene.T_obj_cam is None else pose_from_matrix(np.array(scene.T_obj_cam)),
    )


def _recorded_rig(path: Path, scene: _Scene) -> Rig:
    """Return the rig of a rig file. Its pose is exact, which another orthonormalisation would change."""
    try:
        rig = load_rig(path)
    except ConfigurationError as e:
        raise DatasetError(str(e)) from None
    if (rig.camera.width, rig.camera.height) != (scene.width, scene.height):
        raise DatasetError(
            f"{path}: is for pictures of {rig.camera.width}x{rig.camera.height}, "
            f"but scene.json has {scene.width}x{scene.height}"
        )
    if rig.pose is None or scene.T_obj_cam is None:
        return rig
    T = np.array(scene.T_obj_cam, dtype=float)
    if not np.allclose(T, rig.pose.matrix(), rtol=0.0, atol=1e-12):  # a user has edited the rig file
        return rig
    return replace(rig, pose=replace(rig.pose, rotation=np.ascontiguousarray(T[:3, :3])))


def _pose(place: str, key: str, matrix: _Matrix4 | None) -> Pose | None:
    if matrix is None:
        return None
    T = np.array(matrix, dtype=float)
    if not scene_format.is_rotation(T[:3, :3]) or not np.allclose(T[3], (0.0, 0.0, 0.0, 1.0)):
        raise DatasetError(f"{place}{key}: not a rotation and a translation (4 x 4, last row 0 0 0 1)")
    return pose_from_matrix(T)


def _read_truth(path: Path, frames: int) -> Truth:
    table = _read_motion(path, scene_format.MOTION_COLUMNS, frames)
    attitude = scene_format.rotations(path, table, scene_format.MATRIX_COLUMNS)
    return Truth(table["t"], attitude, np.stack([table[c] for c in ("wx", "wy", "wz")], axis=1))


def _read_motion(path: Path, columns: tuple[str, ...], frames: int) -> dict[str, Array]:
    """Read columns of truth.csv, with frame and t. Raises DatasetError unless they increase with the rows."""
    table = read_columns(path, columns, most=frames)
    scene_format.check_frames(path, table, frames)
    scene_format.check_times(path, table["t"])
    return table


def _read_discs(path: Path, frames: int) -> DiscTruth:
    """Read discs.csv; nan for empty cells of blob and area. DatasetError: a number is not whole or not in range."""
    table = read_columns(path, scene_format.DISC_COLUMNS, optional=scene_format.BLOB_COLUMNS)
    frame, *others = (table[c] for c in ("frame", "disc", "state"))
    if any(map(fractional, (frame, *others))) or np.any((frame < 0) | (frame >= frames)):
        raise DatasetError(f"{path}: frame, disc and state must be whole numbers, frame from 0 to {frames - 1}")
    return DiscTruth(  # popped, so that a long table is not in memory twice
        frame=table.pop("frame").astype(np.intp),
        disc=table.pop("disc").astype(np.intp),
        centre=np.stack([table.pop("u_center"), table.pop("v_center")], axis=1),
        blob_centre=np.stack([table.pop("u_blob"), table.pop("v_blob")], axis=1),
        area=table.pop("area_px"),
        state=table.pop("state").astype(np.intp),
    )
