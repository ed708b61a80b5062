"""The camera's pose from the targets: standard deviations, correlations and true errors.

Wittich 2017, tables 12, 21 and 22. Cameras stand a little elsewhere for every seed, since a still scene looks alike in
all its views: only another place has other errors of sampling. Standard deviations and correlations are those of a
camera at the thesis' place, errors the RMS over all. Targets are known exactly or as calibrated from six photos with a
tape. 0.05 px are assumed for errors that averages cannot remove (print, lens, sampling). A rendered target has neither
print nor lens. The thesis counts its 30 views as independent.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Table, by, tidy, where
from experiments.kit.thesis import THESIS_TABLES, calibrated_rig
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.pose import Sighting, gather, predict_targets, resect
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import euler_rate_matrix, exp, log, to_euler
from spheremouse.simulate.ball.events import degrade
from spheremouse.simulate.ball.options import View
from spheremouse.simulate.ball.profile import still
from spheremouse.simulate.ball.render import Renderer, RenderOptions
from spheremouse.simulate.ball.scene import Scene, default_scene
from spheremouse.tracker import Frame

TITLE = "The camera's pose from four targets (Wittich 2017, tables 12, 21 and 22)"
VIEWS: tuple[View, ...] = ("far", "near")
VIEWS_USED = 30  # of the tables: a second of video
NOISE = 3.0  # grey values
NAMES = ("X0", "Y0", "Z0", "ω0", "φ0", "κ0")
_STRAY = (0.01, np.radians(0.5))  # m, rad: by which cameras differ from the thesis'


def jobs(request: Request) -> list[Job]:
    seeds = 2 if request.quick else 16
    work = [Job(f"{view}-{seed}", filmed, {"view": view, "seed": seed}) for view in VIEWS for seed in range(seeds)]
    if request.datasets is not None:
        work.append(Job("far26", recorded, {"path": str(request.datasets / "far26")}))
    return work


def filmed(view: View, seed: int) -> Result:
    """Poses from the frames of a still scene, with exact targets and with calibrated ones.

    Seed 0 is the thesis' camera itself.
    """
    scene = default_scene(50, view, seed)
    scene = scene if seed == 0 else replace(scene, pose=strayed_pose(scene, np.random.default_rng([seed, 1])))
    rigs = {"exact": scene.rig(), "calibrated": calibrated_rig(seed, scene.camera)}
    renderer, rng = Renderer(scene, RenderOptions(noise=NOISE)), np.random.default_rng([seed, 2])
    frames = (renderer.frame(still(), k / 30.0, k, rng).frame for k in range(VIEWS_USED))
    return _poses(frames, rigs, scene.pose)


def recorded(path: str) -> Result:
    """The same of a dataset with noise added; it knows its targets exactly."""
    film = kit.film_from_dataset(Path(path), VIEWS_USED)
    assert film.truth.pose is not None, "a dataset for this knows the camera's pose"
    return _poses(degrade(iter(film.frames), NOISE, 0.0), {"exact": film.rig}, film.truth.pose)


def strayed_pose(scene: Scene, rng: np.random.Generator) -> Pose:
    """A camera near that of the scene which sees all targets whole."""
    rig, camera, pose = scene.rig(), scene.camera, scene.pose
    while True:
        turn = exp(_STRAY[1] * rng.standard_normal(3))
        other = Pose(turn @ pose.rotation, pose.position + _STRAY[0] * rng.standard_normal(3))
        depth = other.to_cam(rig.targets.position)[:, 2]
        margin = float(np.max(camera.fx * rig.targets.radii[-1] / depth)) + 5.0
        centre = predict_targets(other, rig)
        if np.all((centre > margin) & (centre < np.array([camera.width, camera.height]) - margin)):
            return other


def _poses(frames: Iterable[Frame], rigs: dict[str, Rig], true: Pose) -> Result:
    images = [frame.image for frame in frames]
    radii, settings = rigs["exact"].targets.radii, kit.settings_of().rings
    seen = gather([detect_targets(image, radii, settings) for image in images])
    return {name: pose_result(seen, replace(rig, pose=None), true, images[0]) for name, rig in rigs.items()}


def pose_result(seen: list[Sighting], rig: Rig, true: Pose, image: Any = None) -> Result:
    """A pose with its error: position in mm, omega, phi, kappa in degrees."""
    camera = rig.camera
    picture = np.zeros((camera.height, camera.width), np.uint8) if image is None else image
    pose = resect(seen, rig, picture).pose
    error = np.concatenate([pose.position - true.position, log(pose.rotation @ true.rotation.T)])
    J = np.eye(6)
    J[3:, 3:] = np.linalg.inv(euler_rate_matrix(to_euler(true.rotation)))
    unit = np.array([1e3] * 3 + [np.degrees(1.0)] * 3)
    P = J @ pose.covariance @ J.T
    sigma = np.sqrt(np.diag(P))
    return {
        "error": (unit * (J @ error)).tolist(),
        "sigma": (unit * sigma).tolist(),
        "correlation": (P / np.outer(sigma, sigma)).tolist(),
        "chi_square": float(error @ np.linalg.solve(pose.covariance, error)),
    }


# ---- section ----


def section(results: Results) -> list[Part]:
    poses = tidy(_records(results))
    cameras = poses[poses["camera"] != "far26"]
    parts: list[Part] = []
    for number, view, targets, words in (
        ("12", "far", "calibrated", "R1: far camera, targets and ball as calibrated"),
        ("21", "far", "exact", "S2: far camera, targets known exactly"),
        ("22", "near", "exact", "S4: near camera, targets known exactly"),
    ):
        parts.append(Table(f"{words} (table {number})", _beside(where(cameras, view=view, targets=targets), number)))
    largest = (cameras[_ERROR].abs().to_numpy() / cameras[_SIGMA].to_numpy()).max(axis=1)
    how = {"cameras": "size", "chi-square / 6": "mean", "largest error / standard deviation": "max"}
    shares = {"chi-square / 6": cameras["chi_square"] / 6.0, "largest error / standard deviation": largest}
    honest = by(cameras.assign(cameras=0, **shares), ["view", "targets"], how)
    return [
        *parts,
        Table("Errors squared over covariance; 1 is honest", honest),
        Table("far26, the shared recording (table 21)", _beside(where(poses, camera="far26"), "21")),
    ]


_ERROR, _SIGMA = ([f"{what}.{name}" for name in NAMES] for what in ("error", "sigma"))


def _records(results: Results) -> Iterator[dict[str, Any]]:
    """A pose each: of a camera, with targets known exactly or as calibrated."""
    for key, result in results.items():
        view, _, camera = key.partition("-")
        about = {"view": "far" if view == "far26" else view, "camera": camera or key}
        yield from ({**about, "targets": targets, **_named(entry)} for targets, entry in result.items())


def _named(entry: Result) -> Result:
    found = {what: dict(zip(NAMES, entry[what], strict=True)) for what in ("error", "sigma")}
    rows = {a: dict(zip(NAMES, row, strict=True)) for a, row in zip(NAMES, entry["correlation"], strict=True)}
    return {**found, "correlation": rows, "chi_square": entry["chi_square"]}


def _beside(cameras: pd.DataFrame, number: str) -> pd.DataFrame:
    """Correlations, standard deviations and errors, each above those of the thesis; mm and °."""
    own, typed = where(cameras, camera=["0", "far26"]).mean(numeric_only=True), THESIS_TABLES[number]
    rows: list[list[Any]] = []
    for name, below in zip(NAMES[1:], typed["correlation"], strict=True):
        values = [own.get(f"correlation.{name}.{other}", np.nan) for other in NAMES[: len(below)]]
        rows += [[f"correlation {name}", "ours", *values], ["", "thesis", *below]]
    rows += [["standard deviation", "ours", *own.reindex(_SIGMA)], ["", "thesis", *typed["sigma"]]]
    rows += [["error", "ours", *cameras[_ERROR].pow(2).mean().pow(0.5)], ["", "thesis", *typed.get("error", ())]]
    units = [f"{name}, {'mm' if k < 3 else '°'}" for k, name in enumerate(NAMES)]
    return pd.DataFrame([[*row, *[np.nan] * (8 - len(row))] for row in rows], columns=["", "by", *units])
