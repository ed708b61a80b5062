"""Simulated films as datasets on a disk."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spheremouse.files.dataset.wand import WAND_COLUMNS, columns_of, wand_scene
from spheremouse.files.dataset.write import TruthWriter, dataset_folder, device_description
from spheremouse.simulate.ball.film import Change, Simulation, simulate
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
    if len(scene.disc_directions):
        description["truth_disc_directions"] = scene.disc_directions.tolist()
    if scene.pattern is not None:
        description |= {"pattern": scene.pattern.name, "truth_pattern_seed": scene.pattern.seed}
    if simulation.changes:
        description["truth_changes"] = [_change(change) for change in simulation.changes]
        bumps = [change for change in simulation.changes if change.what == "bump"]
        if bumps:
            description["truth_bump"] = {"t": bumps[0].time, "T_obj_cam": bumps[0].scene.pose.matrix().tolist()}
    return description


def _change(change: Change) -> dict[str, Any]:
    said: dict[str, Any] = {"t": change.time, "what": change.what}
    if change.disc is not None:
        said["disc"] = change.disc
    if change.what == "disc moved":
        said["direction"] = change.scene.disc_directions[change.disc].tolist()
    return said


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


def wand_scene_description(film: WandFilm, name: str) -> dict[str, Any]:
    """The content of scene.json, but for `frames`."""
    balls = tuple(b.ball for b in film.scene.balls)
    return {
        "name": name,
        "made_by": "spheremouse wand simulate",
        "fps": float(film.fps),
        "exposure_s": float(film.scene.exposure_s),
        **wand_scene(film.scene.camera, balls),
        "camera_frame": "OpenCV: x right, y down, z forward; truth.csv x,y,z = ball centre in it (m); r11..r33 "
        "row-major, P_cam = R P_ball + (x,y,z)",
    }


def write_wand(path: Path | str, film: WandFilm, *, replace: bool = False) -> Iterator[int]:
    """Film into a dataset folder, giving the number of frames done after each; complete at the end.

    Raises DatasetError where `path` is there and not empty (unless `replace`, and it holds a dataset), or cannot be
    written. An iterator that is closed early writes nothing.
    """
    with dataset_folder(path, wand_scene_description(film, Path(path).absolute().name), replace=replace) as made:
        poses = [name for k in range(len(film.scene.balls)) for name in columns_of(k)]
        rows = made.table("truth.csv", (*WAND_COLUMNS[:2], *poses))
        for shot in simulate_wand(film):
            made.pictures.add(shot.frame.image)
            placed = zip(shot.position, shot.rotation, strict=True)
            numbers = [shot.frame.stamp, *(x for p, R in placed for x in (*p, *R.ravel()))]
            rows.writerow([shot.frame.sequence, *(repr(float(x)) for x in numbers)])
            yield shot.frame.sequence + 1
