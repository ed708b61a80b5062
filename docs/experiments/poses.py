"""The camera's pose from the targets: standard deviations, correlations, true errors, and how many views are worth it.

Wittich 2017, tables 12, 21 and 22. Cameras stand a little elsewhere for every seed, since a still scene looks alike in
all its views: only another place has other errors of sampling. Standard deviations and correlations are those of a
camera at the thesis' place, errors the RMS over all. Targets are known exactly or as calibrated from six photos with a
tape. 0.05 px are assumed for errors that averages cannot remove (print, lens, sampling). A rendered target has neither
print nor lens. The thesis counts its 30 views as independent.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import gammaincinv

from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Claim, Part, Plot, Table, by, lengths, rms, tidy, where
from experiments.kit.thesis import THESIS_TABLES, calibrated_rig
from spheremouse.ball.detect.rings import TargetDetections, detect_targets
from spheremouse.ball.pose import TARGET_SIGMA_PX, Sighting, gather, predict_targets, resect
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import euler_rate_matrix, exp, log, to_euler
from spheremouse.simulate.ball.events import degraded
from spheremouse.simulate.ball.film import Renderer, RenderOptions, Scene, View, default_scene
from spheremouse.simulate.ball.profile import still
from spheremouse.tracker import Frame

TITLE = "The camera's pose from four targets (Wittich 2017, tables 12, 21 and 22)"
VIEWS: tuple[View, ...] = ("far", "near")
VIEWS_USED = 30  # of the tables: a second of video
_COUNTS = (1, 2, 3, 5, 10, 20, 30, 50, 100)
NOISE, STRONG = 3.0, 15.0  # grey values: of the tables; of the figure, the strongest of table 24
NAMES = ("X0", "Y0", "Z0", "ω0", "φ0", "κ0")
_STRAY = (0.01, np.radians(0.5))  # m, rad: by which cameras differ from the thesis'


def jobs(request: Request) -> list[Job]:
    """Cameras that film, errors that are drawn, and the shared recording."""
    seeds, counts, draws = (2, (1, 3, 10), 4) if request.quick else (16, _COUNTS, 80)
    work = [
        Job(f"{view}-{seed}", filmed, {"view": view, "seed": seed, "counts": list(counts)})
        for view in VIEWS
        for seed in range(seeds)
    ]
    work += [Job(f"drawn-{view}", drawn, {"view": view, "seeds": draws}) for view in VIEWS]
    if request.datasets is not None:
        path = str(request.datasets / "far26")
        work.append(Job("far26", recorded, {"path": path, "counts": list(counts)}))
    return work


# ---- jobs ----


def filmed(view: View, seed: int, counts: Sequence[int]) -> Result:
    """Poses from the first of `counts` frames of a still scene, with exact targets and with calibrated ones.

    Seed 0 is the thesis' camera itself.
    """
    scene = default_scene(50, view, seed)
    scene = scene if seed == 0 else replace(scene, pose=strayed_pose(scene, np.random.default_rng([seed, 1])))
    rigs = {"exact": scene.rig(), "calibrated": calibrated_rig(seed, scene.camera)}
    backdrop = None
    result: Result = {}
    for name, noise, wanted in _films(counts):
        renderer, rng = Renderer(scene, RenderOptions(noise=noise), backdrop), np.random.default_rng([seed, 2])
        backdrop = renderer.backdrop
        frames = (renderer.frame(still(), k / 30.0, k, rng).frame for k in range(max(wanted)))
        result[name] = _poses(frames, rigs, scene.pose, wanted)
    return result


def recorded(path: str, counts: Sequence[int]) -> Result:
    """The same of a dataset with noise added; it knows its targets exactly."""
    film = kit.film_from_dataset(Path(path), max(counts))
    assert film.truth.pose is not None, "a dataset for this knows the camera's pose"
    return {
        name: _poses(
            degraded(iter(film.frames[: max(wanted)]), noise, 0.0), {"exact": film.rig}, film.truth.pose, wanted
        )
        for name, noise, wanted in _films(counts)
    }


def drawn(view: View, seeds: int) -> Result:
    """Return poses from calibrated targets, with errors of the centres drawn from the covariance of one view."""
    sigma = TARGET_SIGMA_PX
    scene = default_scene(50, view)
    exact = scene.rig()
    centre = predict_targets(scene.pose, exact)
    entries = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 3])
        seen = [
            Sighting(code, c + sigma * rng.standard_normal(2), sigma**2 * np.eye(2), VIEWS_USED)
            for code, c in zip(exact.targets.codes, centre, strict=True)
        ]
        entries.append(pose_result(seen, calibrated_rig(seed, scene.camera), scene.pose))
    return {"entries": entries}


def _films(counts: Sequence[int]) -> tuple[tuple[str, float, Sequence[int]], ...]:
    """Name, noise and numbers of views: for the tables, and for the figure."""
    return ("table", NOISE, (VIEWS_USED,)), ("figure", STRONG, counts)


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


def _poses(frames: Iterable[Frame], rigs: dict[str, Rig], true: Pose, counts: Sequence[int]) -> Result:
    settings = kit.settings_of()
    exact = rigs["exact"]
    views: list[TargetDetections] = []
    image = None
    for frame in frames:
        image = frame.image if image is None else image
        views.append(detect_targets(frame.image, exact.targets.radii, settings.rings))
    assert image is not None, "there are frames"
    by_count = {
        str(n): {
            name: pose_result(gather(views[:n]), replace(rig, pose=None), true, image) for name, rig in rigs.items()
        }
        for n in counts
    }
    return {"counts": by_count, **_centres(views, exact, true)}


def _centres(views: list[TargetDetections], rig: Rig, true: Pose) -> Result:
    """Return the RMS per axis, px, of the errors common to all views, and of their differences."""
    expected = dict(zip(rig.targets.codes, predict_targets(true, rig), strict=True))
    off = [[c - expected[k] for k, c in zip(v.codes, v.centre, strict=True) if k in expected] for v in views]
    whole = np.array([o for o in off if len(o) == len(expected)])  # (views, targets, 2)
    near = np.linalg.norm(whole, axis=2).max(axis=1) < 3.0
    whole = whole[near]
    return {
        "common_px": float(np.sqrt(np.mean(whole.mean(axis=0) ** 2))),
        "scatter_px": float(np.sqrt(np.mean(whole.var(axis=0, ddof=1)))) if len(whole) > 1 else 0.0,
    }


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
    """Tables 12, 21 and 22, errors against what is claimed, and what more views bring."""
    poses = tidy(_records(results))
    cameras = poses[poses["camera"] != "far26"]
    tables, figure = where(cameras, film="table"), where(poses, film="figure")
    parts: list[Part] = []
    for number, view, targets, words in (
        ("12", "far", "calibrated", "R1: far camera, targets and ball as calibrated"),
        ("21", "far", "exact", "S2: far camera, targets known exactly"),
        ("22", "near", "exact", "S4: near camera, targets known exactly"),
    ):
        parts.append(Table(f"{words} (table {number})", _beside(where(tables, view=view, targets=targets), number)))
    largest = (cameras[_ERROR].abs().to_numpy() / cameras[_SIGMA].to_numpy()).max(axis=1)
    keys = ["view", "film", "targets"]
    honest = by(
        cameras.assign(largest=largest, cameras=0), keys, {"cameras": "size", "chi_square": "mean", "largest": "max"}
    )
    high = gammaincinv(3.0 * honest["cameras"], 0.975) / (3.0 * honest["cameras"])  # 95 % of an honest mean are below
    over_six = honest["chi_square"] / 6.0
    honest = honest.assign(chi_square=over_six, **{"95 % below": high}).rename(
        columns={"chi_square": "chi-square / 6", "largest": "largest error / standard deviation"}
    )
    off = {what: lengths(figure, names[:3]) for what, names in (("error", _ERROR), ("sigma", _SIGMA))}
    figure = figure.assign(**{"position, mm": off["error"], "claimed, mm": off["sigma"]})
    figure = figure.assign(targets=figure["targets"].where(figure["camera"] != "far26", "exact, far26"))
    curves = by(figure, ["view", "targets", "views"], {"position, mm": rms, "claimed, mm": rms})
    shared = where(poses, camera="far26", film="table")
    ends = where(curves, targets="calibrated").groupby("view")["position, mm"]
    return [
        *parts,
        Table("How honest the covariances are: errors squared over covariance, 1 is honest", honest),
        Claim("No covariance is too small.", (over_six <= high).all()),
        Table("far26, the shared recording of the far camera (table 21)", _beside(shared, "21")),
        Table(f"Position by the number of views, with noise of {STRONG:g} grey values", curves, ["view", "targets"]),
        Claim(
            "More views remove noise and nothing else: with calibrated targets the error stays.",
            len(ends) > 0 and (ends.last() > 0.9 * ends.first()).all(),
        ),
        Plot(
            "poses-views",
            "Error of the camera's position and its claimed standard deviation by the number of views of a "
            "still scene.",
            curves,
            "views",
            ["position, mm", "claimed, mm"],
            "targets",
            "view",
            log="xy",
        ),
    ]


_ERROR, _SIGMA = ([f"{what}.{name}" for name in NAMES] for what in ("error", "sigma"))


def _records(results: Results) -> Iterator[dict[str, Any]]:
    """A pose each: of a camera from so many views, with targets known exactly or as calibrated."""
    for key, result in results.items():
        view, _, camera = key.partition("-")
        if view == "drawn":
            about = {"view": camera, "camera": "drawn", "film": "drawn", "targets": "calibrated", "views": VIEWS_USED}
            yield from ({**about, **_named(entry)} for entry in result["entries"])
            continue
        for film, found in result.items():
            for views, by_targets in found["counts"].items():
                for targets, entry in by_targets.items():
                    about = {"view": "far" if view == "far26" else view, "camera": camera or key, "film": film}
                    yield {**about, "targets": targets, "views": int(views), **_named(entry)}


def _named(entry: Result) -> Result:
    """Values by the names of the pose's parameters."""
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
