"""Simulated films as datasets on a disk."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spheremouse.files.dataset.wand import WAND_COLUMNS, columns_of, wand_scene
from spheremouse.files.dataset.write import TruthWriter, dataset_folder, device_description
from spheremouse.simulate.ball.film import Simulation, simulate
from spheremouse.simulate.wand.film import WandFilm, simulate_wand


def scene_description(simulation: Simulation, name: str) -> dict[str, Any]:
    """The content of scene.json, but for `frames`; the truth under keys that begin with `truth_`."""
    scene = simulation.scene
    description: dict[str, Any] = {
        "name": name,
        "made_by": "spheremouse simulate",
        "fps": simulation.fps,
        **device_description(scene.rig()),
        "truth_T_obj_cam": scene.pose.matrix().tolist(),
    }
    if simulation.azimuth:
        description["truth_R_first_obj"] = simulation.turn.tolist()
    if len(scene.disc_directions):
        description["truth_disc_directions"] = scene.disc_directions.tolist()
    if scene.pattern is not None:
        description |= {"pattern": scene.pattern.name, "truth_pattern_seed": scene.pattern.seed}
    changes: list[dict[str, Any]] = []
    for change in simulation.changes:
        description["truth_changes"] = changes
        changes.append({"t": change.time, "what": change.what})
        if change.what == "bump":
            description["truth_bump"] = {"t": change.time, "T_obj_cam": change.scene.pose.matrix().tolist()}
        else:
            changes[-1]["disc"] = change.disc
        if change.what == "disc moved":
            changes[-1]["direction"] = change.scene.disc_directions[change.disc].tolist()
    return description


def write_simulation(path: Path | str, simulation: Simulation, *, replace: bool = False) -> Iterator[int]:
    """Film a simulation into a dataset folder, giving the number of frames done after each; complete at the end.

    Raises DatasetError as `dataset_folder` does. An iterator that is closed early writes nothing.
    """
    description, centres = scene_description(simulation, Path(path).absolute().name), simulation.options.reach > 0.0
    with dataset_folder(path, description, replace=replace) as made:
        writer = TruthWriter(made, centres=centres, discs=len(simulation.scene.disc_directions) > 0)
        for done, filmed in enumerate(simulate(simulation), start=1):
            writer.add(filmed.frame, filmed.attitude, filmed.rate, filmed.discs, filmed.centre)
            yield done


def write_wand(path: Path | str, film: WandFilm, *, replace: bool = False) -> Iterator[int]:
    """As `write_simulation`, for a film of a wand."""
    balls = tuple(b.ball for b in film.scene.balls)
    description = {
        "name": Path(path).absolute().name,
        "made_by": "spheremouse wand simulate",
        "fps": float(film.fps),
        "exposure_s": float(film.scene.exposure_s),
        **wand_scene(film.scene.camera, balls),
        "camera_frame": "OpenCV: x right, y down, z forward; truth.csv x,y,z = ball centre in it (m); r11..r33 "
        "row-major, P_cam = R P_ball + (x,y,z)",
    }
    with dataset_folder(path, description, replace=replace) as made:
        poses = [name for k in range(len(balls)) for name in columns_of(k)]
        rows = made.table("truth.csv", (*WAND_COLUMNS[:2], *poses))
        for shot in simulate_wand(film):
            made.pictures.add(shot.frame.image)
            placed = zip(shot.position, shot.rotation, strict=True)
            numbers = [shot.frame.stamp, *(x for p, R in placed for x in (*p, *R.ravel()))]
            rows.writerow([shot.frame.sequence, *(repr(float(x)) for x in numbers)])
            yield shot.frame.sequence + 1
