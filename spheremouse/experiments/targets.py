"""How many targets on the frame, how large, and of what kind: rings of three colours against ArUco and AprilTag tags.

Wittich 2017, chapter 5, leaves number, size and type open. All are put in the same places, as large as each other, and
painted onto the same picture (`simulate.tags`); the camera's pose comes from the same adjustment (`resect`), for tags
from all their corners or from their centres. Cameras stand elsewhere for every seed, turned about their own axis too.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.rings import TargetDetections, detect_targets
from spheremouse.ball.pose import PoseSettings, Sighting, gather, predict_targets, resect
from spheremouse.ball.rig import CODES, Rig, Targets
from spheremouse.errors import PoseError
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Job, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.plot import BOUND, THESIS, decades
from spheremouse.experiments.kit.report import failures
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.rotation import Array, exp, log
from spheremouse.simulate.ball.backdrop import render_backdrop
from spheremouse.simulate.ball.film import Scene, default_scene
from spheremouse.simulate.ball.furniture import frame, room
from spheremouse.simulate.ball.tags import Sheet, painted, ring_sheet, tag_cells, tag_corners, tag_sheet

TITLE = "Targets on the frame: number, size, kind (Wittich 2017, chapter 5)"

_USUAL, _NUMBER = 36, 4  # mm, outer radius, and how many, as the thesis has them
_STRAY = (0.04, np.radians(1.0), np.radians(15.0))  # m, rad, rad about the line of sight: how cameras differ
_HALF_PIXEL = 0.5  # px: AprilTag's corners count from a pixel's corner, all others from its centre
_MATCH = 5.0  # px: what is further off is something else
_SURE = 0.95  # share of targets found that counts as all
_NEARLY = 1.25  # times the least standard deviation is as good
_Z = 0.5629  # m, of the targets

NUMBERS = (3, 4, 5, 6, 7, 8)
SIZES = (8, 11, 14, 18, 24, 30, 36, 48)  # mm, radius of the outer circle, half the side of a tag


@dataclass(frozen=True, slots=True)
class Condition:
    """How a picture is taken."""

    noise: float  # grey values
    light: float = 1.0  # factor on grey values
    blur: float = 0.0  # px, standard deviation
    views: int = 1


CONDITIONS = {
    "plain": Condition(3.0, views=2),
    "noisy": Condition(15.0),
    "dark": Condition(3.0, light=0.2),
    "blurred": Condition(3.0, blur=1.5),
}
_ABOUT = {
    "plain": "noise of 3 grey values",
    "noisy": "noise of 15",
    "dark": "a fifth of the light, noise of 3",
    "blurred": "blur of 1.5 px, noise of 3",
}
FAMILIES = {"aruco": cv2.aruco.DICT_4X4_50, "april": cv2.aruco.DICT_APRILTAG_36h11}
KINDS = {"rings": "rings", "aruco": "ArUco 4×4", "april": "AprilTag 36h11", "aruco centres": "ArUco 4×4, centres"}
REFINEMENTS = {  # OpenCV's corners: method and half width of the window, px (None: OpenCV's own)
    "none": (cv2.aruco.CORNER_REFINE_NONE, None),
    "contour": (cv2.aruco.CORNER_REFINE_CONTOUR, None),
    "subpix": (cv2.aruco.CORNER_REFINE_SUBPIX, None),
    "subpix, 2 px": (cv2.aruco.CORNER_REFINE_SUBPIX, 2),
    "AprilTag": (cv2.aruco.CORNER_REFINE_APRILTAG, None),
}
_REFINED = ("subpix, 2 px", "AprilTag")  # that which finds more tags is taken; the last where both find as many


def jobs(request: Request) -> list[Job]:
    """A camera each."""
    if request.quick:
        what = {"numbers": [4], "sizes": [14, 36], "conditions": ["plain"]}
        return [Job("camera-0", filmed, {"seed": 0, **what}, 5.0)]
    what = {"numbers": list(NUMBERS), "sizes": list(SIZES), "conditions": list(CONDITIONS)}
    return [Job(f"camera-{seed}", filmed, {"seed": seed, **what}, 20.0) for seed in range(5)]


# ---- what is put up ----


def places(number: int) -> Array:
    """Targets on the two struts, (number, 3) m, obj; four are those of the thesis."""
    left, right = -0.3244, 0.3256
    top, low, middle = 0.1546, -0.5954, (0.1546 - 0.5954) / 2.0
    upper, lower = top - 0.25, low + 0.25
    corners = [(left, top), (left, low), (right, low), (right, top)]
    beside = {
        3: [],
        4: [],
        5: [(left, middle)],
        6: [(left, middle), (right, middle)],
        7: [(left, upper), (left, lower), (right, middle)],
        8: [(left, upper), (left, lower), (right, upper), (right, lower)],
    }
    chosen = [*corners[: min(number, 4)], *beside[number]]
    return np.array([(x, y, _Z) for x, y in chosen])


def _radii(size: float) -> Array:
    """m, of a ring target whose outer radius is `size` mm."""
    return 1e-3 * size * np.array([1.0, 2.0, 3.0]) / 3.0


def _sheets(kind: str, number: int, size: float) -> list[Sheet]:
    where = places(number)
    if kind == "rings":
        return [ring_sheet(p, _radii(size), code) for p, code in zip(where, CODES, strict=False)]
    return [tag_sheet(p, 1e-3 * size, tag_cells(FAMILIES[kind], i)) for i, p in enumerate(where)]


def rig_of(kind: str, scene: Scene, number: int, size: float) -> Rig:
    """What is known of the targets: for tags every corner, or every centre, is a target without extent."""
    points = places(number)
    codes: tuple[str, ...] = CODES[:number]
    radii = _radii(size)
    if kind != "rings":
        codes, radii = tuple(str(i) for i in range(number)), np.full(3, 1e-9)
        if not kind.endswith("centres"):
            points = tag_corners(points, 1e-3 * size).reshape(-1, 3)
            codes = tuple(f"{i}.{k}" for i in range(number) for k in range(4))
    n = len(points)
    return replace(scene.rig(), targets=Targets(tuple(range(n)), codes, points, np.zeros((3 * n, 3 * n)), radii))


def camera_of(seed: int) -> Scene:
    """The device with bare struts before a camera near the thesis' far one."""
    rng = np.random.default_rng([seed, 11])
    scene = default_scene(26, "far", seed)
    none = replace(scene.targets, ids=(), codes=(), position=np.zeros((0, 3)), covariance=np.zeros((0, 0)))
    pose = scene.pose
    turn = exp(_STRAY[1] * rng.standard_normal(3))
    roll = exp(np.array([0.0, 0.0, rng.uniform(-_STRAY[2], _STRAY[2])]))
    moved = Pose(turn @ pose.rotation @ roll, pose.position + _STRAY[0] * rng.standard_normal(3))
    return replace(scene, pose=moved, surroundings=(*frame(none, 0.0105), *room()))


# ---- jobs ----


def filmed(seed: int, numbers: Sequence[int], sizes: Sequence[float], conditions: Sequence[str]) -> Result:
    """From one camera: numbers of targets of the usual size, sizes under all conditions, refinements of corners."""
    scene = camera_of(seed)
    bare = render_backdrop(scene).white
    found: Result = {"numbers": {}, "sizes": {}}
    for kind in ("rings", *FAMILIES):
        for n in numbers:
            if kind != "rings" or n <= len(CODES):
                found["numbers"] |= _tried(kind, scene, bare, n, _USUAL, "plain", seed)
        for size in sizes:
            for condition in conditions:
                found["sizes"] |= _tried(kind, scene, bare, _NUMBER, size, condition, seed)
    picture = painted(bare, scene, _sheets("aruco", _NUMBER, _USUAL))
    image = next(_views(picture, CONDITIONS["plain"], seed))
    rig = rig_of("aruco", scene, _NUMBER, _USUAL)
    found["refinements"] = {name: _corner_errors(image, rig, scene.pose, name) for name in REFINEMENTS}
    depth = scene.pose.to_cam(places(_NUMBER))[:, 2]
    found["px_per_mm"] = float(np.mean(2e-3 * scene.camera.fx / depth))  # of diameter per radius
    return found


def _tried(
    kind: str, scene: Scene, bare: NDArray[np.float32], n: int, size: float, condition: str, seed: int
) -> Result:
    """By key: share of targets found, and the pose from them with its error."""
    picture = painted(bare, scene, _sheets(kind, n, size))
    images = list(_views(picture, CONDITIONS[condition], seed))
    rig = rig_of(kind, scene, n, size)
    results = {kind: _posed([_detected(kind, image, rig) for image in images], rig, scene.pose, images[0])}
    if kind == "aruco":
        middles = rig_of("aruco centres", scene, n, size)
        seen = [_middles(_detected(kind, image, rig)) for image in images]
        results["aruco centres"] = _posed(seen, middles, scene.pose, images[0])
    return {key(k, n, size, condition): r for k, r in results.items()}


def key(kind: str, number: int, size: float, condition: str) -> str:
    """Of what was tried."""
    return f"{kind}/{number}/{size:g}/{condition}"


def _views(picture: NDArray[np.float32], condition: Condition, seed: int) -> Iterator[NDArray[np.uint8]]:
    """Through the lens, under the light, with noise, in bytes."""
    if condition.blur:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), condition.blur), dtype=np.float32)
    rng = np.random.default_rng([seed, 12])
    for _ in range(condition.views):
        noise = np.float32(condition.noise) * rng.standard_normal(picture.shape, dtype=np.float32)
        yield np.clip(np.rint(np.float32(condition.light) * picture + noise), 0, 255).astype(np.uint8)


def _detected(kind: str, image: NDArray[np.uint8], rig: Rig) -> TargetDetections:
    """What is seen of the rig's targets; of tags, their corners."""
    if kind == "rings":
        return detect_targets(image, rig.targets.radii, kit.settings_of().rings)
    quick, slow = _REFINED
    found = corners_of(kind, image, rig, quick)
    better = corners_of(kind, image, rig, slow) if len(found) else found  # ten times as long
    return better if len(better) >= len(found) else found


def corners_of(kind: str, image: NDArray[np.uint8], rig: Rig, refinement: str) -> TargetDetections:
    """Corners of a family's tags with one of OpenCV's refinements."""
    method, window = REFINEMENTS[refinement]
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = method
    if window is not None:
        parameters.cornerRefinementWinSize = window
        parameters.relativeCornerRefinmentWinSize = 10.0  # of a cell: the window is never smaller
    family = cv2.aruco.getPredefinedDictionary(FAMILIES[kind])
    corners, ids, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)
    codes, points, radii = [], [], []
    for quad, number in zip(corners, [] if ids is None else ids.ravel(), strict=True):
        for k, corner in enumerate(quad[0]):
            if f"{number}.{k}" in rig.targets.codes:
                codes.append(f"{number}.{k}")
                points.append(corner - (_HALF_PIXEL if refinement == "AprilTag" else 0.0))
                radii.append(0.5 * float(np.linalg.norm(quad[0][2] - quad[0][0])))
    return TargetDetections(tuple(codes), np.array(points, dtype=float).reshape(-1, 2), np.array(radii), ())


def _middles(seen: TargetDetections) -> TargetDetections:
    """Centres of tags whose four corners are seen: where their diagonals meet."""
    codes, points, radii = [], [], []
    for first in range(0, len(seen), 4):
        a, b, c, d = seen.centre[first : first + 4]
        s = np.linalg.solve(np.stack([c - a, b - d], axis=1), b - a)[0]
        codes.append(seen.codes[first].split(".")[0])
        points.append(a + s * (c - a))
        radii.append(float(seen.radius[first]))
    return TargetDetections(tuple(codes), np.array(points).reshape(-1, 2), np.array(radii), ())


def _posed(views: list[TargetDetections], rig: Rig, true: Pose, image: NDArray[np.uint8]) -> Result:
    """Share found over views, error of the centres or corners, pose error and standard deviations."""
    share = [len(set(v.codes) & set(rig.targets.codes)) / len(rig.targets.codes) for v in views]
    best: dict[str, Sighting] = {}
    for s in gather(views, kit.settings_of().pose):
        if s.code not in best or s.views > best[s.code].views:
            best[s.code] = s
    result: Result = {"found": float(np.mean(share)), **_off(best.values(), rig, true)}
    try:
        pose = resect(list(best.values()), rig, image).pose
    except PoseError as e:
        return {**result, "error": str(e)}
    sigma = np.sqrt(np.diag(pose.covariance))
    return {
        **result,
        "position_mm": (1e3 * (pose.position - true.position)).tolist(),
        "angle_deg": np.degrees(log(pose.rotation @ true.rotation.T)).tolist(),
        "sigma_position_mm": (1e3 * sigma[:3]).tolist(),
        "sigma_angle_deg": np.degrees(sigma[3:]).tolist(),
    }


def _off(seen: Iterable[Sighting], rig: Rig, true: Pose) -> Result:
    """RMS per axis of what was measured, px; without those that are something else."""
    expected = dict(zip(rig.targets.codes, predict_targets(true, rig), strict=True))
    errors = np.array([s.centre - expected[s.code] for s in seen if s.code in expected]).reshape(-1, 2)
    errors = errors[np.linalg.norm(errors, axis=1) < _MATCH]
    return {"point_px": float(np.sqrt(np.mean(errors**2))) if len(errors) else None}


def _corner_errors(image: NDArray[np.uint8], rig: Rig, true: Pose, refinement: str) -> Result:
    seen = corners_of("aruco", image, rig, refinement)
    where = dict(zip(rig.targets.codes, project(true.to_cam(rig.targets.position), rig.camera)[0], strict=True))
    errors = np.array([c - where[code] for code, c in zip(seen.codes, seen.centre, strict=True)]).reshape(-1, 2)
    return {"found": len(seen) / len(rig.targets.codes), "errors": np.round(errors, 4).tolist()}


# ---- for a reader ----


def section(request: Request, results: Results) -> Section:
    """Number, size and kind: figures, tables, and what to put up."""
    cameras = [r for r in results.values() if "error" not in r]
    some = f"{len(cameras)} camera{'s' if len(cameras) != 1 else ''}"
    some += f" ({len(results) - len(cameras)} more failed)" if len(results) > len(cameras) else ""
    parts: list[str | Table | Figure] = [
        f"{some} near the thesis' far one (640x480), turned about their axes by up to "
        f"{np.degrees(_STRAY[2]):.0f}°; targets known exactly; {CONDITIONS['plain'].views} views each, noise of "
        f"{CONDITIONS['plain'].noise:g} grey values unless it says otherwise. A tag is as large as a ring target: its "
        "side is the outer diameter. Tags are found by OpenCV, their corners refined by it "
        f"({' or '.join(_REFINED)}: whichever finds more of them). Errors are lengths of error vectors, RMS over "
        "the cameras that had a pose (*poses*); of centres and corners those within "
        f"{_MATCH:g} px of a true one."
    ]
    if cameras:
        numbers, sizes = _tried_of(cameras, "numbers"), _tried_of(cameras, "sizes")
        scale = float(np.mean([c["px_per_mm"] for c in cameras]))
        parts += ["### Number", _said_of_numbers(cameras, numbers)]
        if len(numbers) > 1:
            parts.append(_figure_numbers(cameras, numbers))
        parts += [
            _table_of_poses("targets", cameras, "numbers", {str(n): (n, _USUAL, "plain") for n in numbers}),
            "### Size and kind",
            _said_of_sizes(cameras, sizes, scale),
        ]
        if len(sizes) > 1:
            parts.append(_figure_sizes(cameras, sizes, scale))
        parts += [
            _table_of_sizes(cameras, sizes, scale),
            _table_of_poses("condition", cameras, "sizes", _conditions(cameras)),
            _table_of_refinements(cameras),
        ]
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), dict(results))


def _tried_of(cameras: list[Result], group: str) -> list[int]:
    """Numbers or sizes that were tried, rising."""
    place = 1 if group == "numbers" else 2
    return sorted({int(float(k.split("/")[place])) for c in cameras for k in c[group]})


def _conditions(cameras: list[Result]) -> dict[str, tuple[int, float, str]]:
    tried = {k.split("/")[3] for c in cameras for k in c["sizes"]}
    return {_ABOUT[c]: (_NUMBER, _USUAL, c) for c in CONDITIONS if c in tried}


def _entries(cameras: list[Result], group: str, kind: str, case: tuple[int, float, str]) -> list[Result]:
    name = key(kind, *case)
    return [c[group][name] for c in cameras if name in c[group]]


def _rms(entries: list[Result], name: str) -> float | None:
    """Of the lengths of vectors, over the cameras with a pose."""
    known = [np.linalg.norm(e[name]) for e in entries if name in e]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _bound(entries: list[Result]) -> float | None:
    """mm, RMS: what the best adjustment reaches with centres or corners as noisy as these were.

    The claimed standard deviation, which follows the residuals where these are larger than what is allowed for, scaled
    to the measured error where that is smaller.
    """
    allowed = PoseSettings().target_sigma
    known = [e for e in entries if "sigma_position_mm" in e and e["point_px"] is not None]
    least = [min(1.0, e["point_px"] / allowed) * np.linalg.norm(e["sigma_position_mm"]) for e in known]
    return float(np.sqrt(np.mean(np.square(least)))) if least else None


def _share(entries: list[Result]) -> float | None:
    """Of the targets found."""
    return float(np.mean([e["found"] for e in entries])) if entries else None


def _text(number: float | None, digits: int) -> str:
    return "–" if number is None else f"{number:.{digits}f}"


def _table_of_poses(first: str, cameras: list[Result], group: str, cases: dict[str, tuple[int, float, str]]) -> Table:
    rows = []
    for name, case in cases.items():
        for kind, word in KINDS.items():
            entries = _entries(cameras, group, kind, case)
            if not entries:
                rows.append((name, word, f"no: there are {len(CODES)} orders of three colours", *[""] * 7))
                continue
            share = _share(entries)
            points = [e["point_px"] for e in entries if e["point_px"] is not None]
            rows.append(
                (
                    name,
                    word,
                    _text(None if share is None else 100.0 * share, 0) + " %",
                    f"{sum('error' not in e for e in entries)} of {len(entries)}",
                    _text(float(np.sqrt(np.mean(np.square(points)))) if points else None, 3),
                    _text(_rms(entries, "position_mm"), 2),
                    _text(_rms(entries, "sigma_position_mm"), 2),
                    _text(_bound(entries), 2),
                    _text(_rms(entries, "angle_deg"), 3),
                    _text(_rms(entries, "sigma_angle_deg"), 3),
                )
            )
    head = (
        *(first, "kind", "found", "poses", "centres or corners, px"),
        *("position, mm", "claimed, mm", "bound, mm", "angle, °", "claimed, °"),
    )
    return Table(head, tuple(rows))


def _least(cameras: list[Result], kind: str, condition: str, sizes: list[int]) -> int | None:
    """mm, the smallest size from which on all targets are found."""
    least = None
    for size in reversed(sizes):
        share = _share(_entries(cameras, "sizes", kind, (_NUMBER, size, condition)))
        if share is None or share < _SURE:
            break
        least = size
    return least


def _table_of_sizes(cameras: list[Result], sizes: list[int], scale: float) -> Table:
    rows = []
    for condition in CONDITIONS:
        if not _entries(cameras, "sizes", "rings", (_NUMBER, sizes[-1], condition)):
            continue
        cells = []
        for kind in ("rings", *FAMILIES):
            least = _least(cameras, kind, condition, sizes)
            cells.append("none of these" if least is None else f"{scale * least:.0f} px ({least} mm)")
        rows.append((_ABOUT[condition], *cells))
    head = ("", *(KINDS[k] for k in ("rings", *FAMILIES)))
    title = f"Least size across at which {100.0 * _SURE:.0f} % are found (outer radius in brackets)"
    return Table(head, tuple(rows), title)


def _table_of_refinements(cameras: list[Result]) -> Table:
    rows = []
    for name in REFINEMENTS:
        found = [c["refinements"][name] for c in cameras]
        errors = np.concatenate([np.array(f["errors"]).reshape(-1, 2) for f in found])
        cells = ["–"] * 3
        if len(errors):
            cells = [f"{np.sqrt(np.mean(errors**2)):.3f}", *(f"{x:+.3f}" for x in errors.mean(axis=0))]
        rows.append((name, f"{100.0 * np.mean([f['found'] for f in found]):.0f} %", *cells))
    head = ("refinement", "found", "corner RMS per axis, px", "mean error u, px", "mean error v, px")
    title = (
        f"Corners of ArUco tags of {_USUAL} mm by OpenCV's refinements; half a pixel was taken off AprilTag's, which "
        "count from the corner of a pixel"
    )
    return Table(head, tuple(rows), title)


def _said_of_numbers(cameras: list[Result], numbers: list[int]) -> str:
    said = []
    for kind in ("rings", *FAMILIES):
        errors = {n: _rms(_entries(cameras, "numbers", kind, (n, _USUAL, "plain")), "position_mm") for n in numbers}
        known = {n: e for n, e in errors.items() if e is not None}
        if len(known) > 1:
            low, high = min(known), max(known)
            said.append(f"{KINDS[kind]} {known[low]:.2f} mm with {low}, {known[high]:.2f} mm with {high}")
    text = f"Error of the camera's position: {'; '.join(said)}." if said else ""
    three = _entries(cameras, "numbers", "rings", (3, _USUAL, "plain"))
    if three:
        posed = sum("error" not in e for e in three)
        text += f" Three rings give a pose from {posed} of {len(three)} cameras."
    sigmas = {
        n: _rms(_entries(cameras, "numbers", "rings", (n, _USUAL, "plain")), "sigma_position_mm") for n in numbers
    }
    claimed = {n: sigma for n, sigma in sigmas.items() if sigma is not None}
    if len(claimed) > 1:
        best = min(claimed.values())
        advised = min(n for n, sigma in claimed.items() if sigma <= _NEARLY * best)
        said = [f"{sigma:.2f} mm with {n}" for n, sigma in claimed.items()]
        text += (
            f" The claimed standard deviation of rings: {', '.join(said)}. Advice: {advised} targets, which are within "
            f"{100.0 * (_NEARLY - 1.0):.0f} % of the best; with one more, one may be hidden."
        )
    return text


def _said_of_sizes(cameras: list[Result], sizes: list[int], scale: float) -> str:
    said = []
    usual = (_NUMBER, _USUAL, "plain")
    rings = _rms(_entries(cameras, "sizes", "rings", usual), "position_mm")
    for kind, word in KINDS.items():
        other = _rms(_entries(cameras, "sizes", kind, usual), "position_mm")
        if rings and other and kind != "rings":
            said.append(f"{word} {other / rings:.1f} times")
    text = (
        f"With {_NUMBER} of {_USUAL} mm ({scale * _USUAL:.0f} px across) the position error of the rings is "
        f"{rings:.2f} mm; {', '.join(said)} that. "
        if rings and said
        else ""
    )
    least = {k: _least(cameras, k, "plain", sizes) for k in ("rings", *FAMILIES)}
    named = [f"{KINDS[k]} from {scale * v:.0f} px across" for k, v in least.items() if v is not None]
    if named:
        text += f"All are found: {', '.join(named)}. "
    tried = [c for c in CONDITIONS if _entries(cameras, "sizes", "rings", (_NUMBER, sizes[-1], c))]
    hard = {c: _least(cameras, "rings", c, sizes) for c in tried}
    enough, bad = [v for v in hard.values() if v is not None], [c for c, v in hard.items() if v is None]
    if enough:
        text += (
            f"Advice: rings at least {scale * max(enough):.0f} px across in the picture"
            f"{', enough under all conditions tried' if len(tried) > 1 and not bad else ''}. "
        )
    for condition in bad:
        found = {k: _least(cameras, k, condition, sizes) for k in FAMILIES}
        others = [f"{KINDS[k]} from {scale * v:.0f} px" for k, v in found.items() if v is not None]
        text += (
            f"No size tried is enough for rings under {_ABOUT[condition]} (tags are found: "
            f"{', '.join(others) or 'none'}): mind the light. "
        )
    claimed = _rms(_entries(cameras, "sizes", "rings", usual), "sigma_position_mm")
    if rings and claimed:
        text += (
            f"The rings' claimed standard deviation is {claimed / rings:.0f} times their error: it allows "
            f"{PoseSettings().target_sigma:g} px per centre for print and lens, which a painted target has not."
        )
    return text.strip()


# ---- figures ----

_MARKS = dict(zip(KINDS, "osD^", strict=True))


def _line(ax: Any, x: list[float], entries: list[list[Result]], kind: str, k: int) -> None:
    """Position error with its claim (dashed) and its bound (dotted)."""
    lines = (
        ([_rms(e, "position_mm") for e in entries], {"marker": _MARKS[kind]}),
        ([_rms(e, "sigma_position_mm") for e in entries], {**THESIS, "linewidth": 0.7}),
        ([_bound(e) for e in entries], BOUND),
    )
    for values, how in lines:
        points = zip(x, values, strict=True)
        known = [(a, y) for a, y in points if y is not None]
        style = {"linestyle": "-", **how}
        ax.plot([a for a, _ in known], [y for _, y in known], color=f"C{k}", **style)
    for a, here in zip(x, entries, strict=True):
        y = _rms(here, "position_mm")
        if y is not None and any("error" in e for e in here):  # white inside: not the same cameras
            ax.plot([a], [y], color=f"C{k}", marker=_MARKS[kind], markerfacecolor=ax.get_facecolor(), linestyle="")


def _finish(ax: Any) -> None:
    ax.set_yscale("log")
    decades(ax.yaxis)


def _handles(claimed: bool = True) -> list[Any]:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=f"C{k}", marker=_MARKS[kind], linestyle="-", label=name)
        for k, (kind, name) in enumerate(KINDS.items())
    ]
    grey = [Line2D([], [], color="0.5", label=name, **how) for name, how in (("claimed", THESIS), ("bound", BOUND))]
    return [*lines, *(grey if claimed else [])]


def _figure_numbers(cameras: list[Result], numbers: list[int]) -> Figure:
    def draw(canvas: Any) -> None:
        ax = canvas.subplots()
        for k, kind in enumerate(KINDS):
            entries = [_entries(cameras, "numbers", kind, (n, _USUAL, "plain")) for n in numbers]
            _line(ax, [float(n) for n in numbers], entries, kind, k)
        _finish(ax)
        ax.set(xlabel="targets", ylabel="position of the camera, mm", xticks=numbers)
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=6)

    return Figure(
        "targets-number",
        "Error of the camera's position (RMS over cameras) against the number of targets, its claimed standard "
        f"deviation (dashed), and the bound with centres as good as they were (dotted). Hollow: not all cameras had a "
        "pose. "
        f"Rings end at {len(CODES)}: there are no more orders of three colours.",
        draw,
        (7.2, 3.3),
    )


def _figure_sizes(cameras: list[Result], sizes: list[int], scale: float) -> Figure:
    def draw(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2)
        across = [scale * s for s in sizes]
        for k, kind in enumerate(KINDS):
            entries = [_entries(cameras, "sizes", kind, (_NUMBER, s, "plain")) for s in sizes]
            _line(left, across, entries, kind, k)
            if kind.endswith("centres"):
                continue
            shares = [100.0 * (_share(e) or 0.0) for e in entries]
            right.plot(across, shares, color=f"C{k}", marker=_MARKS[kind], linestyle="-")
        _finish(left)
        for ax in (left, right):
            ax.set(xscale="log", xlabel="target across, px")
            ax.set_xticks(across, [f"{x:.0f}" for x in across])
            ax.minorticks_off()
        left.set_ylabel("position of the camera, mm")
        right.set_ylabel("found, %")
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=6)

    return Figure(
        "targets-size",
        f"Left: error of the camera's position from {_NUMBER} targets against their size in the picture, its claimed "
        "standard deviation (dashed), and the bound with centres as good as they were (dotted); hollow: not all "
        "cameras had a pose. Right: share of the targets that is found.",
        draw,
        (7.2, 3.5),
    )
