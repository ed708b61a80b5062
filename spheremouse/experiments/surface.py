"""How well a disc's place on the ball is known, all over what a camera sees of it, and how much that is.

Wittich 2017, table 13 and figure 39. Covariances are those that `intersect` carries from image, pose and ball; beside
them stands the scatter of simulated detections, and of calibrations and poses that are off by chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import assign
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.points import SpherePoints, intersect
from spheremouse.ball.pose import PoseSettings, Sighting, predict_targets, resect
from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import VISIBLE
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Job, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.plot import THESIS, plain_numbers
from spheremouse.experiments.kit.report import failures
from spheremouse.experiments.kit.thesis import THESIS_TABLES, calibrated_rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, euler_rate_matrix, tangent_basis, to_euler
from spheremouse.simulate.ball.film import HandVisit, Renderer, RenderOptions, Scene, View, default_scene
from spheremouse.simulate.ball.hands import draw_hand, place_hand
from spheremouse.simulate.shapes import Sphere, look

TITLE = "Points on the ball: covariances over the visible cap, visible area"

_VIEWS: tuple[View, ...] = ("far", "near")
_DISCS = 74  # as many as the thesis' fullest ball: more places at once
_NOISE = 3.0  # grey values
_BIN = 6.0  # deg, from the point that faces the camera
_RINGS, _SPOKES = 24, 61  # of a map
_DISTANCES = (0.7, 0.8, 0.9, 1.0, 1.2, 1.35, 1.6, 2.0, 2.35, 2.7, 3.0)  # m
_POINTS = 20_000  # spread over the sphere to be counted

# Wittich 2017, table 13: place (mm), correlations XY, XZ, YZ, standard deviations (mm).
_TABLE_13 = (
    ((9.4, 401.3, 424.4), (-0.174, 0.136, -0.959), (1.2, 1.5, 1.7)),
    ((-322.1, 316.5, 370.6), (-0.501, 0.930, -0.714), (2.5, 1.2, 3.0)),
    ((-73.0, 70.5, 575.3), (0.276, 0.652, 0.155), (1.2, 0.9, 0.7)),
    ((165.1, -177.3, 531.5), (-0.297, -0.691, 0.756), (0.9, 1.5, 0.8)),
    ((-141.0, -279.7, 493.1), (0.675, 0.708, 0.917), (1.3, 2.1, 1.5)),
)
_TABLE_11 = ((0.7, 0.9, 3.3, 2.7), ((-0.333,), (-0.460, 0.858), (0.457, -0.858, -0.998)))  # centre, radius: mm
_SIGMA_B = 0.1  # px, of a centre in the thesis, section 4.5
_RADIUS = 0.6  # m
_LEVELS = (0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0)  # mm, of the map
_TURN = np.linspace(0.0, 2.0 * np.pi, _SPOKES)
_FIGURE_39 = {"far": (2.35, 2.74), "near": (1.35, 2.16)}  # m, m²


def jobs(request: Request) -> list[Job]:
    """The cap before each camera, and the areas."""
    frames, draws = (8, 4) if request.quick else (60, 60)
    work = [Job(f"cap-{view}", cap, {"view": view, "frames": frames, "draws": draws}) for view in _VIEWS]
    return [*work, Job("area", areas, {"points": _POINTS // 4 if request.quick else _POINTS})]


# ---- covariances ----


@dataclass(frozen=True, slots=True)
class _AnyWay:
    """A ball that lies another way in every frame of 30 Hz."""

    seed: int
    seconds: float = 1e9

    def attitude(self, t: Array) -> Array:
        """(n, 3, 3), all attitudes alike likely."""
        return np.array([_any_rotation(np.random.default_rng([self.seed, round(30.0 * x)])) for x in t])

    def rate(self, t: Array) -> Array:
        """It rests in each."""
        return np.zeros((len(t), 3))


def _any_rotation(rng: np.random.Generator) -> Array:
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0.0 else -q


@dataclass(frozen=True, slots=True)
class _Sights:
    """Detections of wholly visible discs in many frames, and where those discs are."""

    detections: Detections
    directions: Array  # (n, 3) unit vectors, obj, true


def cap(view: View, frames: int, draws: int) -> Result:
    """Errors of points on the ball and what is claimed of them; the map of that; table 13 for the far camera."""
    scene = default_scene(_DISCS, view, 1)
    sights = _sights(scene, frames)
    known = [_device(scene, seed) for seed in range(draws)]
    angle = _angle(sights.directions, scene)
    exact = scene.rig()
    image = _errors(sights, exact, scene.pose)
    total = [_errors(sights, rig, rig.pose or scene.pose) for rig in known]
    rig = known[0]
    result: Result = {
        "sights": len(sights.directions),
        "bins": _bins(angle, image, total),
        "chi_square_image": _chi_square([image]),
        "chi_square_total": _chi_square(total),
        "map": _map(scene, rig, angle, sights.detections),
    }
    if view == "far":
        result["table 13"] = _five(scene, rig)
    return result


def _sights(scene: Scene, frames: int) -> _Sights:
    renderer, rng = Renderer(scene, RenderOptions(noise=_NOISE)), np.random.default_rng(1)
    detector = disc_detector(kit.settings_of().discs, scene.rig(), scene.pose)
    found, directions = [], []
    for k in range(frames):
        shot = renderer.frame(_AnyWay(1), k / 30.0, k, rng)
        seen = detector.detect(shot.frame.image)
        whole = np.flatnonzero(shot.discs.state == VISIBLE)
        i, j = assign(np.linalg.norm(shot.discs.centre[whole][:, None] - seen.centre[None], axis=2), 3.0)
        found.append(seen.take(j))
        directions.append(scene.disc_directions[shot.discs.disc[whole[i]]] @ shot.attitude.T)
    joined = found[0]
    for other in found[1:]:
        joined = joined.joined(other)
    return _Sights(joined, np.concatenate(directions))


def _device(scene: Scene, seed: int) -> Rig:
    """A rig as calibrated, with the camera's pose from targets that are off by the floor of one view."""
    rng, sigma = np.random.default_rng([seed, 5]), PoseSettings().target_sigma
    exact, rig = scene.rig(), calibrated_rig(seed, scene.camera)
    centre = predict_targets(scene.pose, exact)
    seen = [
        Sighting(code, c + sigma * rng.standard_normal(2), sigma**2 * np.eye(2), 30)
        for code, c in zip(exact.targets.codes, centre, strict=True)
    ]
    blank = np.zeros((scene.camera.height, scene.camera.width), np.uint8)
    return replace(rig, pose=resect(seen, rig, blank).pose)


@dataclass(frozen=True, slots=True)
class _Errors:
    """Along the surface, in the axes in which it is least and best known."""

    index: NDArray[np.intp]  # (n,) of the sights whose rays meet the ball
    error: Array  # (n, 2) mm, along the worst and the best direction
    sigma: Array  # (n, 2) mm, as claimed


def _errors(sights: _Sights, rig: Rig, pose: Pose) -> _Errors:
    points = intersect(sights.detections, rig, pose)
    true = _RADIUS * sights.directions[points.index]
    variance, axes = _along_surface(points)
    off = np.einsum("nij,ni->nj", axes, points.position - true)
    return _Errors(points.index, 1e3 * off[:, ::-1], 1e3 * np.sqrt(variance[:, ::-1]))


def _along_surface(points: SpherePoints) -> tuple[Array, Array]:
    """Eigenvalues, (n, 2) m², rising, and axes, (n, 3, 2), of the covariance along the surface."""
    basis = tangent_basis(points.direction)
    flat = basis.transpose(0, 2, 1) @ points.covariance @ basis
    variance, vectors = np.linalg.eigh(flat)
    return np.maximum(variance, 0.0), basis @ vectors


def _bins(angle: Array, image: _Errors, total: Sequence[_Errors]) -> list[Result]:
    """RMS errors and claims by the angle from the point that faces the camera, deg."""
    found = []
    for low in np.arange(0.0, 90.0, _BIN):
        here = (angle >= low) & (angle < low + _BIN)
        if np.count_nonzero(here[image.index]) < 5:
            continue
        entry: Result = {"angle": float(low + 0.5 * _BIN), "sights": int(np.count_nonzero(here))}
        for name, cases in (("image", [image]), ("total", total)):
            chosen = [here[c.index] for c in cases]
            for what in ("error", "sigma"):
                values = np.concatenate([getattr(c, what)[w] for c, w in zip(cases, chosen, strict=True)])
                entry[f"{name} {what}"] = np.sqrt(np.mean(values**2, axis=0)).tolist()
        found.append(entry)
    return found


def _chi_square(cases: Sequence[_Errors]) -> float:
    """Mean over its two degrees of freedom."""
    return float(np.mean(np.concatenate([(c.error / c.sigma) ** 2 for c in cases])))


def _map(scene: Scene, rig: Rig, angle: Array, seen: Detections) -> Result:
    """Standard deviations over the image of the ball, mm; a centre there is as certain as discs at that angle were."""
    middle = scene.pose.position / np.linalg.norm(scene.pose.position)
    right, down = (axis - (axis @ middle) * middle for axis in scene.pose.rotation.T[:2])
    right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
    limb = np.degrees(np.arccos(scene.ball_radius / np.linalg.norm(scene.pose.position)))
    polar, turn = np.meshgrid(np.linspace(0.0, limb - 1.0, _RINGS), _TURN)
    a, t = np.radians(polar.ravel())[:, None], turn.ravel()[:, None]
    directions = np.cos(a) * middle + np.sin(a) * (np.cos(t) * right + np.sin(t) * down)
    sigma = np.interp(polar.ravel(), *_certainty(angle, seen))
    points = _seen(directions, sigma, rig, scene)
    variance, _ = _along_surface(points)
    worst, best = (np.round(1e3 * np.sqrt(v), 4).reshape(_SPOKES, _RINGS).tolist() for v in variance.T[::-1])
    return {"worst": worst, "best": best, "limb_deg": float(limb), "seen_to_deg": float(angle.max())}


def _seen(directions: Array, sigma: Array, rig: Rig, scene: Scene) -> SpherePoints:
    """Points of the ball at (n, 3), seen from where the camera is; centres are certain to `sigma`, (n,) px."""
    assert rig.pose is not None, "the device stands before a camera"
    centre = seen_at(directions, scene.rig(), scene.pose)
    seen = Detections(centre, sigma[:, None, None] ** 2 * np.eye(2), np.zeros(len(sigma)))
    return intersect(seen, rig, replace(rig.pose, rotation=scene.pose.rotation, position=scene.pose.position))


def _angle(directions: Array, scene: Scene) -> Array:
    """deg from the point of the ball that faces the camera."""
    middle = scene.pose.position / np.linalg.norm(scene.pose.position)
    return np.degrees(np.arccos(np.clip(directions @ middle, -1.0, 1.0)))


def _certainty(angle: Array, seen: Detections) -> tuple[list[float], list[float]]:
    """Angles (deg) and median standard deviations of centres there (px), as the detector gives them."""
    pixel = np.sqrt(0.5 * np.trace(seen.covariance, axis1=1, axis2=2))
    groups = [(low, pixel[(angle >= low) & (angle < low + _BIN)]) for low in np.arange(0.0, 90.0, _BIN)]
    full = [(float(low + 0.5 * _BIN), float(np.median(g))) for low, g in groups if len(g)]
    return [a for a, _ in full], [m for _, m in full]


def _five(scene: Scene, rig: Rig) -> Result:
    """The five places of table 13 before the far camera, with the thesis' noise of a centre; with all its inputs."""
    place = np.array([p for p, _, _ in _TABLE_13])
    directions = place / np.linalg.norm(place, axis=1, keepdims=True)
    sigma = np.full(len(place), _SIGMA_B)
    assert rig.pose is not None, "the device stands before a camera"
    apart = replace(rig, pose=replace(rig.pose, ball_covariance=np.zeros((6, 4))))
    return {
        name: [_described(P) for P in _seen(directions, sigma, device, scene).covariance]
        for name, device in (("ours", rig), ("uncorrelated", apart), ("as the thesis", _as_the_thesis(scene)))
    }


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
    """What is seen of the ball: alone from several distances, and in both views behind frame and hands, m²."""
    sphere = _spread(points)
    scene = default_scene(1, "far")
    whole = 4.0 * np.pi * scene.ball_radius**2
    alone = [
        whole * float(np.mean(_met(sphere, scene, replace(scene.pose, position=np.array([0.0, 0.0, d])), False)))
        for d in _DISTANCES
    ]
    views = {}
    for view in _VIEWS:
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


def _spread(n: int) -> Array:
    """Unit vectors, (n, 3), each of which stands for the same area: a spiral of golden angles."""
    k = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * k / n, np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def _met(sphere: Array, scene: Scene, pose: Pose, around: bool) -> NDArray[np.bool_]:
    """Which points of the ball the renderer's ray towards them meets first, with what stands `around` or without."""
    shapes = [Sphere(np.zeros(3), scene.ball_radius, scene.ball_colour), *(scene.surroundings if around else ())]
    cam = pose.to_cam(scene.ball_radius * sphere)
    xy = cam[:, :2] / cam[:, 2:]
    parts = np.array_split(np.lexsort((xy[:, 1], np.round(xy[:, 0], 1))), max(1, len(xy) // 64))
    met = np.zeros(len(xy), dtype=bool)
    view = look(shapes, pose.position, pose.rotation)
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
    drawing = draw_hand()
    uv = np.rint(seen_at(sphere, scene.rig(), scene.pose)).astype(int)
    visits = [HandVisit(0.0, 3.0, right) for right in (True, False)[:hands]]
    free = []
    for t in np.linspace(0.5, 2.5, 9):
        open_ = np.ones(len(sphere), dtype=bool)
        for visit in visits:
            hand = place_hand(drawing, visit, scene, float(t))
            if hand is None:
                continue
            cover = np.zeros((scene.camera.height, scene.camera.width), np.float32)
            cover[hand.place] = hand.paint[..., 3]
            open_ &= cover[np.clip(uv[:, 1], 0, cover.shape[0] - 1), np.clip(uv[:, 0], 0, cover.shape[1] - 1)] < 0.5
        free.append(np.mean(open_))
    return float(np.mean(free))


def visible_cap(distance: float, radius: float) -> float:
    """Area of a sphere that is seen from `distance` to its centre, m²."""
    return 2.0 * np.pi * radius**2 * (1.0 - radius / distance)


# ---- for a reader ----

_DISCS_23 = {"near": 7.4, "far": 8.9}  # Wittich 2017, table 23
_CIRCLES = (20, 40)  # deg, on the map


def section(request: Request, results: Results) -> Section:
    """Table 13, the maps, the scatter, and the area."""
    caps = {view: results[f"cap-{view}"] for view in _VIEWS if "bins" in results.get(f"cap-{view}", {})}
    numbers: dict[str, Any] = {
        view: {k: c[k] for k in ("sights", "bins", "chi_square_image", "chi_square_total")} for view, c in caps.items()
    }
    parts: list[str | Table | Figure] = [_table_13(caps.get("far", {}).get("table 13"), numbers)]
    parts += [_about_13(caps), _scatter_table(caps)]
    if caps:
        parts += [
            _about_scatter(caps),
            Figure(
                "surface-map",
                "Standard deviation of a disc's place along the ball's surface (mm), all over what the camera sees, in "
                "the direction in which it is known worst and in the one in which it is known best. Camera pose and "
                "ball as calibrated, centres as certain as discs there were. Circles are angles from the point that "
                "faces the camera; outside the dashed one no wholly visible disc was found.",
                lambda figure: _draw_maps(figure, caps),
                (7.2, 6.6),
            ),
            Figure(
                "surface-scatter",
                "Claimed standard deviation (lines) and true error (dots, RMS) of a disc's place along the worst and "
                "the best direction, against the angle from the point of the ball that faces the camera. Filled: with "
                "errors of camera pose, ball and image; hollow, dotted: of the image alone.",
                lambda figure: _draw_scatter(figure, caps),
                (7.2, 3.6),
            ),
        ]
    area = results.get("area", {"error": "missing"})
    parts += _area_parts(area, numbers)
    failed = failures(results)
    if failed:
        parts.append("What failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), numbers)


def _table_13(five: Result | None, numbers: dict[str, Any]) -> Table:
    head = ("", "X, Y, Z, mm", "ρ XY", "ρ XZ", "ρ YZ", "σ X, mm", "σ Y, mm", "σ Z, mm")
    rows = []
    for i, (place, correlation, sigma) in enumerate(_TABLE_13):
        where = ", ".join(f"{x:.0f}" for x in place)
        rows.append((f"{i + 1}, thesis", where, *(f"{x:.2f}" for x in correlation), *(f"{x:.1f}" for x in sigma)))
        for name, title in (("as the thesis", "with the thesis' pose and ball"), ("ours", "with our calibration")):
            cells = ["failed"] * 6
            if five is not None:
                p = five[name][i]
                cells = [*(f"{x:.2f}" for x in p["correlation"]), *(f"{x:.1f}" for x in p["sigma"])]
            rows.append((title, "", *cells))
    numbers["table 13"] = five
    return Table(head, tuple(rows), "Table 13. Points on the ball")


def _about_13(caps: dict[str, Result]) -> str:
    five = caps.get("far", {}).get("table 13")
    if not five:
        return ""
    theirs = _rms([s for _, _, s in _TABLE_13])
    fed, ours, apart = (_rms([p["sigma"] for p in five[name]]) for name in ("as the thesis", "ours", "uncorrelated"))
    a, b = (
        np.array(x).ravel() for x in ([p["correlation"] for p in five["as the thesis"]], [c for _, c, _ in _TABLE_13])
    )
    strong = np.abs(b) > 0.6
    same = int(np.count_nonzero(np.sign(a[strong]) == np.sign(b[strong])))
    return (
        f"Fed with the thesis' covariances of pose and ball (tables 11 and 12) and its {_SIGMA_B:g} px, our "
        f"propagation gives {fed:.1f} mm RMS where the thesis has {theirs:.1f} mm, and {same} of its "
        f"{int(np.count_nonzero(strong))} correlations above 0.6 with their sign; where the real camera stood "
        f"is not published, ours is that of S2. With our own calibration it is {ours:.1f} mm: pose and ball are known "
        "better, and their errors are correlated and cancel in part, which is carried along; without that correlation "
        f"it would be {apart:.1f} mm."
    )


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _scatter_table(caps: dict[str, Result]) -> Table:
    head = ("camera", "discs seen", "image alone: chi-square / 2", "with pose and ball: chi-square / 2")
    rows = []
    for view in _VIEWS:
        c = caps.get(view)
        if c is None:
            rows.append((view, "failed", "", ""))
        else:
            rows.append((view, str(c["sights"]), f"{c['chi_square_image']:.2f}", f"{c['chi_square_total']:.2f}"))
    return Table(head, tuple(rows), "True errors squared over claimed variances; 1 is honest")


def _about_scatter(caps: dict[str, Result]) -> str:
    said = []
    for view, c in caps.items():
        ends = []
        for b in (c["bins"][0], c["bins"][-1]):
            whole, image = b["total sigma"][0], b["image sigma"][0]
            ends.append(
                f"{whole:.2f} mm at {b['angle']:.0f}° from the middle, the image alone {image:.2f} mm: "
                f"{100.0 * (image / whole) ** 2:.0f} % of the variance"
            )
        said.append(f"{view}: {'; '.join(ends)}")
    return (
        "Along the worst direction a single sight is certain to\n\n"
        + "\n".join(f"- {line}" for line in said)
        + "\n\nThe rest is camera pose and ball, which are off alike in every frame. "
        + _of_claims(caps)
    )


def _of_claims(caps: dict[str, Result]) -> str:
    """Whether the image's share is claimed larger or smaller than it is, from chi-square."""
    chi = {view: c["chi_square_image"] for view, c in caps.items()}
    told = ", ".join(f"{x:.2f} ({view})" for view, x in chi.items())
    if max(chi.values()) < 1.0:
        return (
            f"The image's share is claimed larger than it is (chi-square / 2: {told}; hollow dots below dotted lines): "
            "renders have neither print nor lens, for which a floor of "
            f"{kit.settings_of().discs.sigma:g} px stands in the detector."
        )
    return f"Chi-square / 2 of the image's share is {told}: above 1 it is claimed smaller than it is."


def _area_parts(area: Result, numbers: dict[str, Any]) -> list[str | Table | Figure]:
    head = (
        "camera", "distance, m", "thesis, m²", "formula, m²", "counted, m²", "frame hides", "one hand hides more",
        "two hands", "of 50 discs in view",
    )  # fmt: skip
    title = "Visible area of the ball (Wittich 2017, fig. 39)"
    if "views" not in area:
        return [Table(head, tuple((v, *["failed"] * 8) for v in _VIEWS), title)]
    numbers["area"] = area
    rows, left = [], {}
    for view, a in area["views"].items():
        left[view] = a["behind frame"]
        of_frame = a["behind frame"]
        rows.append(
            (
                view,
                f"{a['distance']:.2f}",
                f"{_FIGURE_39[view][1]:.2f}",
                f"{visible_cap(a['distance'], _RADIUS):.2f}",
                f"{a['alone']:.2f}",
                f"{100 * (1 - of_frame / a['alone']):.0f} %",
                f"{100 * (1 - a['one hand'] / of_frame):.0f} %",
                f"{100 * (1 - a['two hands'] / of_frame):.0f} %",
                f"{50 * of_frame / (4.0 * np.pi * _RADIUS**2):.1f}",
            )
        )
    v = area["views"]
    hides = {view: 100 * (1 - a["behind frame"] / a["alone"]) for view, a in v.items()}
    bare, kept = v["far"]["alone"] / v["near"]["alone"], left["far"] / left["near"]
    pairs = [*zip(area["distance"], area["alone"], strict=True), *((a["distance"], a["alone"]) for a in v.values())]
    off = max(abs(counted / visible_cap(d, _RADIUS) - 1.0) for d, counted in pairs if d > _RADIUS)
    text = (
        "The thesis' areas are too large: from 2.35 m no more than "
        f"{visible_cap(2.35, _RADIUS):.2f} m² of a ball of {_RADIUS:g} m radius can be seen. Counting which of many "
        f"points the renderer's rays meet first differs from the formula by at most {100 * off:.1f} %. The far camera "
        f"sees {_more(bare)} of the bare ball than the near one and, in the frame of the reference recordings, "
        f"{_more(kept)} of what the frame leaves: it hides {hides['near']:.0f} % before the near camera and "
        f"{hides['far']:.0f} % before the far one. {_of_thesis_frame(bare, kept)}"
    )
    figure = Figure(
        "surface-area",
        "Visible area of the ball against the camera's distance from its centre: formula, points counted with the "
        "renderer's rays, what the frame leaves of it, and the thesis' values, which no sphere of this size can have.",
        lambda canvas: _draw_area(canvas, area),
        (7.2, 3.4),
    )
    return [Table(head, tuple(rows), title), text, figure]


def _more(ratio: float) -> str:
    return f"{100 * abs(ratio - 1.0):.0f} % {'more' if ratio >= 1.0 else 'less'}"


def _of_thesis_frame(bare: float, kept: float) -> str:
    """What the thesis' frame hid, from its numbers of discs in table 23."""
    discs = _DISCS_23["far"] / _DISCS_23["near"]
    told = f"The thesis has {_more(discs).replace('less', 'fewer')} discs before its far camera"
    if discs < bare < kept:
        return f"{told}: its frame hid more from the far camera, ours hides more from the near one."
    return f"{told}."


# ---- figures ----


def _draw_maps(figure: Any, caps: dict[str, Result]) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm
    from matplotlib.patheffects import withStroke

    axes = figure.subplots(2, len(caps), squeeze=False)
    norm = BoundaryNorm(_LEVELS, colormaps["cividis"].N, extend="max")
    filled = None
    for column, (view, c) in zip(axes.T, caps.items(), strict=True):
        angle, turn = np.meshgrid(np.linspace(0.0, c["map"]["limb_deg"] - 1.0, _RINGS), _TURN)
        for ax, name in zip(column, ("worst", "best"), strict=True):
            x, y = angle * np.cos(turn), -angle * np.sin(turn)
            filled = ax.contourf(x, y, np.array(c["map"][name]), _LEVELS, norm=norm, extend="max")
            ax.set(title=f"{view} camera, {name} direction", xticks=[], yticks=[], aspect="equal")
            ax.grid(visible=False)
            for side in ax.spines.values():
                side.set_visible(False)
            edge = c["map"]["seen_to_deg"]
            ax.plot(edge * np.cos(_TURN), edge * np.sin(_TURN), color="#202020", **THESIS)
            for ring in _CIRCLES:
                x, y = ring * np.cos(_TURN), ring * np.sin(_TURN)
                ax.plot(x, y, color="w", linestyle="-", linewidth=0.6, alpha=0.8)
                text = ax.text(0.0, ring, f"{ring}°", color="w", fontsize=7, ha="center", va="center")
                text.set_path_effects([withStroke(linewidth=2.5, foreground="#202020")])
    figure.colorbar(filled, ax=axes, label="standard deviation, mm", shrink=0.6, ticks=_LEVELS, format="{x:g}")


def _draw_scatter(figure: Any, caps: dict[str, Result]) -> None:
    from matplotlib.lines import Line2D

    axes = figure.subplots(1, len(caps), sharey=True, squeeze=False)[0]
    for ax, (view, c) in zip(axes, caps.items(), strict=True):
        angle = [b["angle"] for b in c["bins"]]
        for k, colour in ((0, "C1"), (1, "C0")):
            for name, line, face in (("total", "-", colour), ("image", ":", "none")):
                ax.plot(angle, [b[f"{name} sigma"][k] for b in c["bins"]], color=colour, linestyle=line)
                ax.plot(
                    angle,
                    [b[f"{name} error"][k] for b in c["bins"]],
                    color=colour,
                    linestyle="",
                    marker="o",
                    markerfacecolor=face,
                )
        ax.set(title=f"{view} camera", xlabel="angle from the middle, °", yscale="log")
        plain_numbers(ax.yaxis)
    axes[0].set_ylabel("along the surface, mm")
    handles = [
        Line2D([], [], color="C1", marker="o", label="worst direction, all errors"),
        Line2D([], [], color="C0", marker="o", label="best direction, all errors"),
        Line2D([], [], color="C1", linestyle=":", marker="o", markerfacecolor="none", label="worst, image alone"),
        Line2D([], [], color="C0", linestyle=":", marker="o", markerfacecolor="none", label="best, image alone"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, handlelength=2.6)


def _draw_area(figure: Any, area: Result) -> None:
    ax = figure.subplots()
    d = np.linspace(_RADIUS, 3.1, 200)
    ax.plot(d, [visible_cap(x, _RADIUS) for x in d], color="C0", linestyle="-")
    ax.plot(area["distance"], area["alone"], color="C0", linestyle="", marker="o")
    ax.text(2.85, visible_cap(2.85, _RADIUS) + 0.07, "formula, counted (dots)", color="C0", ha="right")
    for view, a in area["views"].items():
        x = a["distance"]
        ax.plot([x, x], [a["two hands"], a["behind frame"]], color="C2", linestyle="-", linewidth=1.0)
        ax.plot([x], [a["behind frame"]], color="C2", linestyle="", marker="s")
        ax.plot([x], [a["two hands"]], color="C2", linestyle="", marker="v")
        ax.annotate("behind the frame", (x, a["behind frame"]), (8, -2), textcoords="offset points", color="C2")
        ax.annotate("and two hands", (x, a["two hands"]), (8, -2), textcoords="offset points", color="C2")
        where, printed = _FIGURE_39[view]
        ax.plot([where], [printed], color="C1", linestyle="", marker="x", markersize=7)
        ax.annotate(f"thesis, {view}", (where, printed), (8, -3), textcoords="offset points", color="C1")
    limit = 2.0 * np.pi * _RADIUS**2
    ax.axhline(limit, color="C1", **THESIS)
    ax.annotate("half the ball", (0.6, limit), (2, 3), textcoords="offset points", color="C1")
    ax.set(xlabel="distance of the camera from the ball's centre, m", ylabel="area seen, m²", ylim=(0.0, 3.0))
