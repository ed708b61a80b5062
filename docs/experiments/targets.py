"""Number, size and kind of targets on the frame: rings of three colours against ArUco and AprilTag tags.

Wittich 2017, chapter 5, leaves number, size and type open. All have the same places and sizes and are painted onto the
same picture (noise of 3 grey values). The camera's pose comes from the same adjustment (`resect`), for tags from all
their corners. Each seed has another camera, also turned about its own axis. Errors are lengths of error vectors, RMS
over the cameras with a pose. The claimed standard deviation includes 0.05 px for print and lens, which a rendered
target does not have.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Plot, Table, by, tidy, where
from experiments.kit.tags import painted, tag, tag_cells, tag_corners
from spheremouse.ball.detect.rings import TargetDetections, detect_targets
from spheremouse.ball.pose import Sighting, gather, predict_targets, resect
from spheremouse.ball.rig import CODES, Rig, Targets
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, exp, log
from spheremouse.simulate.ball.backdrop import render_backdrop
from spheremouse.simulate.ball.film import Scene, default_scene
from spheremouse.simulate.ball.scene import frame, ring_target, room
from spheremouse.simulate.light import expose
from spheremouse.simulate.shapes import Shape

USUAL, NUMBER = 36, 4  # mm, outer radius, and how many, as the thesis has them
TITLE = "Targets on the frame: number, size, kind (Wittich 2017, chapter 5)"
STRAY = (0.04, np.radians(1.0), np.radians(15.0))  # m, rad, rad about the line of sight: how cameras differ
_HALF_PIXEL = 0.5  # px: AprilTag's corners count from a pixel's corner, all others from its centre
MATCH = 5.0  # px: a detection farther off is another object
SURE = 0.95  # share of targets found that counts as all
_Z = 0.5629  # m, of the targets

NUMBERS = (3, 4, 5, 6, 7, 8)
SIZES = (8, 11, 14, 18, 24, 30, 36, 48)  # mm, radius of the outer circle, half the side of a tag


FAMILIES = {"aruco": cv2.aruco.DICT_4X4_50, "april": cv2.aruco.DICT_APRILTAG_36h11}
KINDS = {"rings": "rings", "aruco": "ArUco 4×4", "april": "AprilTag 36h11"}
_NOISE, _VIEWS = 3.0, 2  # grey values, pictures


def jobs(request: Request) -> list[Job]:
    if request.quick:
        what = {"numbers": [4], "sizes": [14, 36]}
        return [Job("camera-0", filmed, {"seed": 0, **what}, 5.0)]
    what = {"numbers": list(NUMBERS), "sizes": list(SIZES)}
    return [Job(f"camera-{seed}", filmed, {"seed": seed, **what}, 20.0) for seed in range(5)]


# ---- what is put up ----


def places(number: int) -> Array:
    """Targets on the two struts, (number, 3) m, obj; four are those of the thesis."""
    left, right = -0.3244, 0.3256
    top, low, middle = 0.1546, -0.5954, (0.1546 - 0.5954) / 2.0
    upper, lower = top - 0.25, low + 0.25
    corners = [(left, top), (left, low), (right, low), (right, top)]
    beside = {
        3: [], 4: [], 5: [(left, middle)], 6: [(left, middle), (right, middle)],
        7: [(left, upper), (left, lower), (right, middle)],
        8: [(left, upper), (left, lower), (right, upper), (right, lower)]
    }  # fmt: skip
    chosen = [*corners[: min(number, 4)], *beside[number]]
    return np.array([(x, y, _Z) for x, y in chosen])


def _radii(size: float) -> Array:
    """m, of a ring target whose outer radius is `size` mm."""
    return 1e-3 * size * np.array([1.0, 2.0, 3.0]) / 3.0


def _sheets(kind: str, number: int, size: float) -> list[list[Shape]]:
    where = places(number)
    if kind == "rings":
        return [ring_target(p, _radii(size), code) for p, code in zip(where, CODES, strict=False)]
    return [tag(p, 1e-3 * size, tag_cells(FAMILIES[kind], i)) for i, p in enumerate(where)]


def rig_of(kind: str, scene: Scene, number: int, size: float) -> Rig:
    """Return the rig with its known targets. Of tags, each corner is a target without extent."""
    points = places(number)
    codes: tuple[str, ...] = CODES[:number]
    radii = _radii(size)
    if kind != "rings":
        points, radii = tag_corners(points, 1e-3 * size).reshape(-1, 3), np.full(3, 1e-9)
        codes = tuple(f"{i}.{k}" for i in range(number) for k in range(4))
    n = len(points)
    return replace(scene.rig(), targets=Targets(tuple(range(n)), codes, points, np.zeros((3 * n, 3 * n)), radii))


def camera_of(seed: int) -> Scene:
    """The device with bare struts before a camera near the thesis' far one."""
    rng = np.random.default_rng([seed, 11])
    scene = default_scene(26, "far", seed)
    none = replace(scene.targets, ids=(), codes=(), position=np.zeros((0, 3)), covariance=np.zeros((0, 0)))
    pose = scene.pose
    turn = exp(STRAY[1] * rng.standard_normal(3))
    roll = exp(np.array([0.0, 0.0, rng.uniform(-STRAY[2], STRAY[2])]))
    moved = Pose(turn @ pose.rotation @ roll, pose.position + STRAY[0] * rng.standard_normal(3))
    return replace(scene, pose=moved, surroundings=(*frame(none, 0.0105), *room()))


# ---- jobs ----


def filmed(seed: int, numbers: Sequence[int], sizes: Sequence[float]) -> Result:
    """From one camera: numbers of targets of the usual size, and sizes."""
    scene = camera_of(seed)
    bare = render_backdrop(scene).white
    found: Result = {"numbers": {}, "sizes": {}}
    for kind in KINDS:
        for n in numbers:
            if kind != "rings" or n <= len(CODES):
                found["numbers"][key(kind, n, USUAL)] = _tried(kind, scene, bare, n, USUAL, seed)
        for size in sizes:
            found["sizes"][key(kind, NUMBER, size)] = _tried(kind, scene, bare, NUMBER, size, seed)
    depth = scene.pose.to_cam(places(NUMBER))[:, 2]
    found["px_per_mm"] = float(np.mean(2e-3 * scene.camera.fx / depth))  # of diameter per radius
    return found


def _tried(kind: str, scene: Scene, bare: NDArray[np.float32], n: int, size: float, seed: int) -> Result:
    """Share of targets found, and the pose from them with its error."""
    picture, rig = painted(bare, scene, _sheets(kind, n, size)), rig_of(kind, scene, n, size)
    images = list(noisy_pictures(picture, seed))
    return _posed([_detected(kind, image, rig) for image in images], rig, scene.pose, images[0])


def key(kind: str, number: int, size: float) -> str:
    return f"{kind}/{number}/{size:g}"


def noisy_pictures(picture: NDArray[np.float32], seed: int) -> Iterable[NDArray[np.uint8]]:
    """Yield the picture with noise, in bytes."""
    rng = np.random.default_rng([seed, 12])
    for _ in range(_VIEWS):
        yield expose(picture, _NOISE, rng)


def _detected(kind: str, image: NDArray[np.uint8], rig: Rig) -> TargetDetections:
    """Return the detections of the rig's targets; of tags, their corners."""
    if kind == "rings":
        return detect_targets(image, rig.targets.radii, kit.settings_of().rings)
    found = corners_of(kind, image, rig, exact=False)
    better = corners_of(kind, image, rig, exact=True) if len(found) else found  # ten times as long
    return better if len(better) >= len(found) else found


def corners_of(kind: str, image: NDArray[np.uint8], rig: Rig, exact: bool) -> TargetDetections:
    """Return the corners of a family's tags, by OpenCV's refinement "AprilTag" if `exact`, else by "subpix"."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG if exact else cv2.aruco.CORNER_REFINE_SUBPIX
    if not exact:
        parameters.cornerRefinementWinSize = 2  # px
        parameters.relativeCornerRefinmentWinSize = 10.0  # of a cell: the window is never smaller
    family = cv2.aruco.getPredefinedDictionary(FAMILIES[kind])
    corners, ids, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)
    codes, points, radii = [], [], []
    for quad, number in zip(corners, [] if ids is None else ids.ravel(), strict=True):
        for k, corner in enumerate(quad[0]):
            if f"{number}.{k}" in rig.targets.codes:
                codes.append(f"{number}.{k}")
                points.append(corner - (_HALF_PIXEL if exact else 0.0))
                radii.append(0.5 * float(np.linalg.norm(quad[0][2] - quad[0][0])))
    return TargetDetections(tuple(codes), np.array(points, dtype=float).reshape(-1, 2), np.array(radii), ())


def _posed(views: list[TargetDetections], rig: Rig, true: Pose, image: NDArray[np.uint8]) -> Result:
    """Share found over views, error of the centres or corners, pose error and standard deviations."""
    share = [len(set(v.codes) & set(rig.targets.codes)) / len(rig.targets.codes) for v in views]
    best: dict[str, Sighting] = {}
    for s in gather(views):
        if s.code not in best or s.views > best[s.code].views:
            best[s.code] = s
    result: Result = {"found": float(np.mean(share)), **_off(best.values(), rig, true)}
    try:
        pose = resect(list(best.values()), rig, image).pose
    except PoseError as e:
        return {**result, "error": str(e)}
    sigma = np.sqrt(np.diag(pose.covariance))
    return {
        **result, "position_mm": (1e3 * (pose.position - true.position)).tolist(),
        "angle_deg": np.degrees(log(pose.rotation @ true.rotation.T)).tolist(),
        "sigma_position_mm": (1e3 * sigma[:3]).tolist(), "sigma_angle_deg": np.degrees(sigma[3:]).tolist()
    }  # fmt: skip


def _off(seen: Iterable[Sighting], rig: Rig, true: Pose) -> Result:
    """RMS per axis of what was measured, px; without those that are something else."""
    expected = dict(zip(rig.targets.codes, predict_targets(true, rig), strict=True))
    errors = np.array([s.centre - expected[s.code] for s in seen if s.code in expected]).reshape(-1, 2)
    errors = errors[np.linalg.norm(errors, axis=1) < MATCH]
    return {"point_px": float(np.sqrt(np.mean(errors**2))) if len(errors) else None}


# ---- section ----


def section(results: Results) -> list[Part]:
    tried = _tried_rows(results)
    how = {
        "found, %": "mean", "poses": "count", "centres or corners, px": _rms, **dict.fromkeys(_VECTORS.values(), _rms)
    }  # fmt: skip
    means = by(tried.assign(poses=tried["position, mm"]), ["group", "targets", "size, mm", "kind"], how)
    numbers, sizes = (where(means, group=group).drop(columns="group") for group in ("numbers", "sizes"))
    return [
        Table("Poses by the number of targets", numbers.drop(columns="size, mm"), ["targets"]),
        Table("Size (outer radius, mm) from which on all are found", _smallest(sizes)),
        Plot(
            "targets-size", "Error of the camera's position, and share of the targets that is found, by their size.",
            where(tried, group="sizes"), "across, px", ["position, mm", "found, %"], "kind", log="x"
        )
    ]  # fmt: skip


_VECTORS = {
    "position_mm": "position, mm", "sigma_position_mm": "claimed, mm", "angle_deg": "angle, °",
    "sigma_angle_deg": "claimed, °"
}  # fmt: skip


def _tried_rows(results: Results) -> pd.DataFrame:
    """A row for each camera and set of targets."""
    records: list[dict[str, Any]] = []
    scale = float(np.mean([camera["px_per_mm"] for camera in results.values()]))
    for camera in results.values():
        for group in ("numbers", "sizes"):
            for trial, found in camera[group].items():
                kind, number, size = trial.split("/")
                about = {"group": group, "targets": int(number), "size, mm": float(size), "kind": KINDS[kind]}
                about |= {"across, px": round(scale * float(size), 1)}
                about |= {name: np.linalg.norm(found[key]) for key, name in _VECTORS.items() if key in found}
                about |= {"found, %": 100.0 * found["found"], "centres or corners, px": found["point_px"]}
                records.append(about)
    order = {name: k for k, name in enumerate(KINDS.values())}
    return tidy(records).sort_values(["targets", "size, mm", "kind"], key=lambda column: column.replace(order))


def _rms(values: "pd.Series[float]") -> float:
    return float(np.sqrt((values**2).mean()))


def _smallest(sizes: pd.DataFrame) -> pd.DataFrame:
    """mm, by kind; nan where no size is enough."""
    shares = sizes.pivot(index="size, mm", columns="kind", values="found, %").sort_index(ascending=False)
    all_above = (shares >= 100.0 * SURE).astype(int).cummin()
    least = all_above.mul(shares.index.to_series(), axis=0).where(all_above == 1).min()
    return least.reindex(list(KINDS.values())).to_frame().T
