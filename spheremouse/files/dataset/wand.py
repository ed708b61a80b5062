"""Read recordings of hand-held balls: scene.json with `wand`, the frames, and perhaps truth.csv.

`open_wand` and `frames.read_frames` read one, `write_wand` writes one. docs/datasets describes the format. With several
balls, `wands` describes all of them, the first is also `wand`, and truth.csv has columns x_1, y_1, ... of the second.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from spheremouse.errors import DatasetError
from spheremouse.files.dataset import format as scene_format
from spheremouse.files.dataset.format import CameraEntry, Entry, Positive, SceneEntry
from spheremouse.files.dataset.frames import Recorded, recorded_fields
from spheremouse.files.tables import read_columns
from spheremouse.files.wand import angles_of, disc_of
from spheremouse.files.yaml import Document
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.wand.ball import WandBall, WandTruth

WAND_COLUMNS = ("frame", "t", "x", "y", "z", *scene_format.MATRIX_COLUMNS)  # centre (m) and R_cam_ball by rows, in cam
_AXES = (
    "origin = ball centre, z = pole (away from robot / stick), x = azimuth 0, y = azimuth 90 (right-handed, "
    "counter-clockwise seen from above); disc = spherical cap, diameter = chord of its rim, "
    "angular radius = asin(diameter / 2 / radius)"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class WandRecording(Recorded):
    """The checked description of a wand dataset."""

    balls: tuple[WandBall, ...]  # one or more
    truths: tuple[WandTruth, ...]  # of each ball; empty without truth.csv

    @property
    def ball(self) -> WandBall:
        return self.balls[0]

    @property
    def truth(self) -> WandTruth | None:
        """The truth of the first ball; None if the dataset has no truth."""
        return self.truths[0] if self.truths else None


class _Camera(CameraEntry):
    dist: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


class _Disc(Entry):
    azimuth_deg: float
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    diameter: Positive  # m, of the rim
    colour: Annotated[str, Field(min_length=1)]
    points: Positive | None = None  # m from the centre to the outer points, straight


class _Wand(Entry):
    name: str = "wand"
    radius: Positive
    body: str = "white"
    discs: Annotated[tuple[_Disc, ...], Field(min_length=1)]


class _Scene(SceneEntry):
    camera: _Camera
    wand: _Wand
    wands: tuple[_Wand, ...] | None = None


def is_wand(path: Path | str) -> bool:
    """Return True for the folder of a recording of hand-held balls; False if it cannot be read."""
    try:
        data = scene_format.read_json(Path(path) / "scene.json").data
    except DatasetError:
        return False
    return isinstance(data, dict) and "wand" in data


def open_wand(path: Path | str) -> WandRecording:
    """Read scene.json, truth.csv and stamps.csv of a wand dataset. DatasetError names the invalid file."""
    path = Path(path)
    scene = scene_format.read_description(path, _read_scene)
    wands = {"wand": scene.wand} if scene.wands is None else {f"wands.{k}": w for k, w in enumerate(scene.wands)}
    truth = path / "truth.csv"
    truths = _read_truths(truth, scene.frames, len(wands)) if truth.exists() else ()
    return WandRecording(
        **recorded_fields(path, scene, scene.interior_orientation(scene.camera), truths[0].stamp if truths else None),
        balls=tuple(_wand_ball(f"{path / 'scene.json'}: {key}", wand) for key, wand in wands.items()),
        truths=truths,
    )


def _read_scene(document: Document) -> _Scene:
    if isinstance(document.data, dict) and "wand" not in document.data:
        raise DatasetError(f"{document.name}no `wand` in it; this is no recording of a wand, leave --tracker wand out")
    scene = scene_format.described(document, _Scene)
    if scene.wands == ():
        raise DatasetError(f"{document.name}wands: is empty; leave it out where there is one ball")
    if scene.wands is not None and scene.wand != scene.wands[0]:
        raise DatasetError(f"{document.name}wand: differs from the first of `wands`; correct one of the two")
    return scene


def _wand_ball(place: str, wand: _Wand) -> WandBall:
    """Return the ball at a `place` of scene.json. Raises DatasetError if a disc is larger than the ball."""
    for i, disc in enumerate(wand.discs):
        if max(disc.diameter, disc.points or 0.0) >= 2.0 * wand.radius:
            raise DatasetError(f"{place}.discs.{i}: larger than the ball of radius {wand.radius:g} m")
    discs = (disc_of(wand.radius, d.azimuth_deg, d.latitude_deg, d.diameter, d.colour, d.points) for d in wand.discs)
    return WandBall(wand.name, wand.radius, tuple(discs), wand.body)


def columns_of(ball: int) -> tuple[str, ...]:
    """Return the columns of a ball's pose in truth.csv."""
    return tuple(name if ball == 0 else f"{name}_{ball}" for name in WAND_COLUMNS[2:])


def _read_truths(path: Path, frames: int, balls: int) -> tuple[WandTruth, ...]:
    table = read_columns(path, (*WAND_COLUMNS[:2], *(c for k in range(balls) for c in columns_of(k))), most=frames)
    scene_format.check_frames(path, table, frames)
    scene_format.check_times(path, table["t"])
    truths = []
    for k in range(balls):
        position, matrix = columns_of(k)[:3], columns_of(k)[3:]
        rotation = scene_format.rotations(path, table, matrix)
        truths.append(WandTruth(table["t"], np.stack([table.pop(c) for c in position], axis=1), rotation))
    return tuple(truths)


def wand_scene(camera: InteriorOrientation, balls: tuple[WandBall, ...]) -> dict[str, Any]:
    """Return the content of scene.json, without `name`, `fps` and `frames`."""
    described = [wand_description(ball) for ball in balls]
    return {
        "width": int(camera.width),
        "height": int(camera.height),
        "camera": scene_format.camera_description(camera),
        "wand": described[0],
        **({"wands": described} if len(described) > 1 else {}),
    }


def wand_description(ball: WandBall) -> dict[str, Any]:
    """Return the description of a ball for scene.json; lengths in m."""
    discs = []
    for disc in ball.discs:
        azimuth, latitude = angles_of(disc)
        discs.append(
            {
                "azimuth_deg": round(azimuth, 9),
                "latitude_deg": round(latitude, 9),
                "diameter": float(2.0 * ball.radius * np.sin(disc.angle)),
                "colour": disc.colour,
                "angular_radius_deg": float(np.degrees(disc.angle)),
                "points": float(ball.radius * disc.points_angle),
            }
        )
    return {"name": ball.name, "radius": float(ball.radius), "body": ball.body, "frame": _AXES, "discs": discs}
