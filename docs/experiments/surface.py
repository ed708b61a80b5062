"""Covariances of points on the ball, and the area of its visible part.

Wittich 2017, table 13 and figure 39. Covariances are those that `intersect` carries from image, pose and ball. The
thesis does not give the place of its real camera; ours is that of S2.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Plot, Table
from experiments.kit.thesis import THESIS_TABLES, calibrated_rig
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.points import SpherePoints, intersect
from spheremouse.ball.pose import TARGET_SIGMA_PX, Sighting, predict_targets, resect
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, euler_rate_matrix, fibonacci_sphere, to_euler
from spheremouse.simulate.ball.events import HandVisit, place_hand
from spheremouse.simulate.ball.options import View
from spheremouse.simulate.ball.scene import Scene, default_scene

TITLE = "Points on the ball: covariances over the visible cap, visible area"
VIEWS: tuple[View, ...] = ("far", "near")
_DISTANCES = (0.7, 0.8, 0.9, 1.0, 1.2, 1.35, 1.6, 2.0, 2.35, 2.7, 3.0)  # m
_POINTS = 20_000  # spread over the sphere to be counted

# Wittich 2017, table 13: place (mm), correlations XY, XZ, YZ, standard deviations (mm).
TABLE_13 = (
    ((9.4, 401.3, 424.4), (-0.174, 0.136, -0.959), (1.2, 1.5, 1.7)),
    ((-322.1, 316.5, 370.6), (-0.501, 0.930, -0.714), (2.5, 1.2, 3.0)),
    ((-73.0, 70.5, 575.3), (0.276, 0.652, 0.155), (1.2, 0.9, 0.7)),
    ((165.1, -177.3, 531.5), (-0.297, -0.691, 0.756), (0.9, 1.5, 0.8)),
    ((-141.0, -279.7, 493.1), (0.675, 0.708, 0.917), (1.3, 2.1, 1.5)),
)
_TABLE_11 = ((0.7, 0.9, 3.3, 2.7), ((-0.333,), (-0.460, 0.858), (0.457, -0.858, -0.998)))  # centre, radius: mm
SIGMA_B = 0.1  # px, of a centre in the thesis, section 4.5
RADIUS = 0.6  # m
FIGURE_39 = {"far": (2.35, 2.74), "near": (1.35, 2.16)}  # m, m²


def jobs(request: Request) -> list[Job]:
    points = Job("points", points_of_table_13)
    return [points, Job("area", areas, {"points": _POINTS // 4 if request.quick else _POINTS})]


# ---- covariances ----


def points_of_table_13() -> Result:
    """The five places of table 13 before the far camera, with the thesis' noise of a centre; with all its inputs."""
    scene = default_scene(1, "far")
    rig = _device(scene, 0)
    place = np.array([p for p, _, _ in TABLE_13])
    directions = place / np.linalg.norm(place, axis=1, keepdims=True)
    sigma = np.full(len(place), SIGMA_B)
    assert rig.pose is not None, "the device stands before a camera"
    apart = replace(rig, pose=replace(rig.pose, ball_covariance=np.zeros((6, 4))))
    return {
        name: [_described(P) for P in seen_points(directions, sigma, device, scene).covariance]
        for name, device in (("ours", rig), ("uncorrelated", apart), ("as the thesis", _as_the_thesis(scene)))
    }


def _device(scene: Scene, seed: int) -> Rig:
    """A rig as calibrated, with the camera's pose from targets that are off by the floor of one view."""
    rng, sigma = np.random.default_rng([seed, 5]), TARGET_SIGMA_PX
    exact, rig = scene.rig(), calibrated_rig(seed, scene.camera)
    centre = predict_targets(scene.pose, exact)
    seen = [
        Sighting(code, c + sigma * rng.standard_normal(2), sigma**2 * np.eye(2), 30)
        for code, c in zip(exact.targets.codes, centre, strict=True)
    ]
    blank = np.zeros((scene.camera.height, scene.camera.width), np.uint8)
    return replace(rig, pose=resect(seen, rig, blank).pose)


def seen_points(directions: Array, sigma: Array, rig: Rig, scene: Scene) -> SpherePoints:
    """Points of the ball at (n, 3), seen from where the camera is; centres are certain to `sigma`, (n,) px."""
    assert rig.pose is not None, "the device stands before a camera"
    centre = seen_at(directions, scene.rig(), scene.pose)
    seen = Detections(centre, sigma[:, None, None] ** 2 * np.eye(2), np.zeros(len(sigma)))
    return intersect(seen, rig, replace(rig.pose, rotation=scene.pose.rotation, position=scene.pose.position))


def _described(P: Array) -> Result:
    sigma = np.sqrt(np.diag(P))
    R = P / np.outer(sigma, sigma)
    return {"correlation": [R[0, 1], R[0, 2], R[1, 2]], "sigma": (1e3 * sigma).tolist()}


def _as_the_thesis(scene: Scene) -> Rig:
    """A rig with the covariances that Wittich 2017, tables 11 and 12, print for ball and camera pose."""
    pose = THESIS_TABLES["12"]
    unit = np.array([1e-3] * 3 + [np.radians(1.0)] * 3)
    J = np.eye(6)
    J[3:, 3:] = euler_rate_matrix(to_euler(scene.pose.rotation))
    P = J @ _covariance(unit * pose["sigma"], pose["correlation"]) @ J.T
    ball = _covariance(1e-3 * np.array(_TABLE_11[0]), _TABLE_11[1])
    rig = scene.rig()
    return replace(rig, ball=replace(rig.ball, covariance=ball), pose=replace(scene.pose, covariance=P))


def _covariance(sigma: Array, below: Sequence[Sequence[float]]) -> Array:
    """From standard deviations and the correlations below the diagonal."""
    R = np.eye(len(sigma))
    for i, row in enumerate(below, start=1):
        R[i, :i] = R[:i, i] = row
    return R * np.outer(sigma, sigma)


# ---- areas ----


def areas(points: int) -> Result:
    """Return the visible area, m²: of the bare ball by distance, and in both views behind frame and hands."""
    sphere = fibonacci_sphere(points)
    scene = default_scene(1, "far")
    whole = 4.0 * np.pi * scene.ball_radius**2
    alone = [
        whole * float(np.mean(_met(sphere, scene, replace(scene.pose, position=np.array([0.0, 0.0, d])), around=False)))
        for d in _DISTANCES
    ]
    views = {}
    for view in VIEWS:
        scene = default_scene(1, view)
        free, shown = (_met(sphere, scene, scene.pose, around) for around in (False, True))
        views[view] = {
            "distance": float(np.linalg.norm(scene.pose.position)),
            "alone": whole * float(np.mean(free)),
            "behind frame": whole * float(np.mean(shown)),
            "one hand": whole * _behind_hands(sphere[shown], scene, 1) * float(np.mean(shown)),
            "two hands": whole * _behind_hands(sphere[shown], scene, 2) * float(np.mean(shown)),
        }
    return {"distance": list(_DISTANCES), "alone": alone, "views": views}


def _met(sphere: Array, scene: Scene, pose: Pose, around: bool) -> NDArray[np.bool_]:
    """Return the points of the ball that the renderer's ray meets first, with the objects `around` or without."""
    cam = pose.to_cam(scene.ball_radius * sphere)
    xy = cam[:, :2] / cam[:, 2:]
    parts = np.array_split(np.lexsort((xy[:, 1], np.round(xy[:, 0], 1))), max(1, len(xy) // 64))
    met = np.zeros(len(xy), dtype=bool)
    view = replace(scene, pose=pose, surroundings=scene.surroundings if around else ()).viewpoint()
    for part in parts:
        first, depth = view.cast(xy[part][None])
        met[part] = (first[0] == 0) & (np.abs(depth[0] - cam[part, 2]) < 1e-6)
    inside = (cam[:, 2] > 0.0) & _in_picture(xy, scene)
    return met & inside if around else met & (cam[:, 2] > 0.0)


def _in_picture(xy: Array, scene: Scene) -> NDArray[np.bool_]:
    c = scene.camera
    u, v = c.fx * xy[:, 0] + c.cx, c.fy * xy[:, 1] + c.cy
    return (u > -0.5) & (u < c.width - 0.5) & (v > -0.5) & (v < c.height - 0.5)


def _behind_hands(sphere: Array, scene: Scene, hands: int) -> float:
    """Share of points of the ball that playing hands leave uncovered, mean over two seconds of play."""
    uv = np.rint(seen_at(sphere, scene.rig(), scene.pose)).astype(int)
    visits = [HandVisit(0.0, 3.0, right) for right in (True, False)[:hands]]
    free = []
    for t in np.linspace(0.5, 2.5, 9):
        open_ = np.ones(len(sphere), dtype=bool)
        for visit in visits:
            hand = place_hand(visit, scene, float(t))
            if hand is None:
                continue
            cover = np.zeros((scene.camera.height, scene.camera.width), np.float32)
            cover[hand.window.slices] = hand.paint[..., 3]
            open_ &= cover[np.clip(uv[:, 1], 0, cover.shape[0] - 1), np.clip(uv[:, 0], 0, cover.shape[1] - 1)] < 0.5
        free.append(np.mean(open_))
    return float(np.mean(free))


def visible_cap(distance: float, radius: float) -> float:
    """Area of a sphere that is seen from `distance` to its centre, m²."""
    return 2.0 * np.pi * radius**2 * (1.0 - radius / distance)


# ---- section ----


def section(results: Results) -> list[Part]:
    points = _table_13(results["points"]) if "points" in results else []
    return [*points, *(_areas(results["area"]) if "area" in results else [])]


def _table_13(found: Result) -> list[Part]:
    """The places of table 13, by the thesis and by each choice of pose and ball."""
    records = []
    for k, (place, correlation, sigma) in enumerate(TABLE_13):
        described = {name: (of[k]["correlation"], of[k]["sigma"]) for name, of in found.items()}
        for name, (r, s) in {"thesis": (correlation, sigma), **described}.items():
            columns = ("ρ XY", "ρ XZ", "ρ YZ", "σ X, mm", "σ Y, mm", "σ Z, mm")
            values = dict(zip(columns, (*r, *s), strict=True))
            records.append({"X, Y, Z, mm": ", ".join(f"{x:.0f}" for x in place), "pose and ball": name, **values})
    points = pd.DataFrame(records)
    return [Table("Points on the ball (table 13)", points, ["X, Y, Z, mm"])]


def _areas(area: Result) -> list[Part]:
    views = pd.DataFrame.from_dict(area["views"], "index").rename_axis("camera").reset_index()
    table = views.assign(
        thesis=[FIGURE_39[v][1] for v in views["camera"]], formula=[visible_cap(d, RADIUS) for d in views["distance"]]
    )
    counted = {"bare ball": (area["distance"], area["alone"]), "thesis": tuple(zip(*FIGURE_39.values(), strict=True))}
    for name in ("behind frame", "two hands"):
        counted[name] = (views["distance"], views[name])
    fine = np.linspace(RADIUS, 3.0, 25)
    counted["formula"] = (fine, [visible_cap(d, RADIUS) for d in fine])
    curves = pd.concat(
        [
            pd.DataFrame(dict(zip(("distance, m", "area, m²"), c, strict=True))).assign(of=name)
            for name, c in counted.items()
        ]
    )
    return [
        Table("Visible area of the ball, m² (fig. 39)", table),
        Plot(
            "surface-area", "Visible area against the camera's distance from the ball's centre.", curves, "distance, m",
            ["area, m²"], "of"
        )
    ]  # fmt: skip
