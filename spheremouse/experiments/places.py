"""Where to put the camera: attitude and rate errors to expect from each direction and distance, and films as a check.

Wittich 2017, chapter 5, asks for as many cameras as possible. The map is the posterior Cramer-Rao bound of what a
camera there would measure, by geometry alone: which discs are wholly in view past the device's frame, how large they
are in the picture, and how well centres of that size are measured (which is taken from pictures first).
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import assign
from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.truth import VISIBLE, Truth
from spheremouse.errors import PoseError
from spheremouse.evaluate.bound import posterior_bound
from spheremouse.evaluate.centres import MATCH, Sight, distances
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Job, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.plot import BOUND
from spheremouse.experiments.kit.report import failures, value
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.simulate.ball.film import Renderer, RenderOptions, Scene, default_scene, prepare
from spheremouse.simulate.ball.profile import thesis
from spheremouse.simulate.ball.stations import looking
from spheremouse.simulate.shapes import Sphere, Viewpoint, look

TITLE = "Where to put the camera"

_DISCS = 50
_NOISE = 3.0  # grey values
_FPS = 30.0  # Hz
_FRAMES = 150
_AIM = np.array([0.0, -0.17, 0.0])  # m, obj: the middle of ball and frame
_FAR = 2.35  # m, from the ball's centre: the thesis' far camera
_FOCAL = 640.0  # px, its lens
_FILL = 0.9  # share of the picture's height that the ball fills before a lens chosen for its distance
_RIM = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)  # where a disc is looked at, beside its centre
_RING = 2.5  # px across: narrower rings of targets are not found (`targets`)
_LEAST = 15  # centres that make a size class
_NEAR_BEST = 1.25  # times the least error: as good as the best place
_TOP = 60.0  # times the least error: more is not drawn
_LENSES = ("same lens", "ball fills the picture")

AZIMUTHS = tuple(range(-90, 91, 15))  # deg, to the right of the device's front
ELEVATIONS = tuple(range(-20, 81, 10))  # deg
DISTANCES = (0.9, 1.0, 1.15, 1.35, 1.6, 2.0, 2.35, 2.8, 3.3, 3.8)  # m
_CHECKED = ((0, 0), (0, 30), (0, 60), (-30, 0), (45, 10), (-45, 50), (75, 0), (-75, 30), (30, -20))  # deg
_CHECKED_DISTANCES = {_LENSES[0]: (1.0, 1.35, 3.3), _LENSES[1]: (1.0, 1.35, 3.3)}  # m


class Place(NamedTuple):
    """A camera that looks at the device."""

    azimuth: float  # deg
    elevation: float  # deg
    distance: float  # m, from the ball's centre
    focal: float  # px, of a picture of 640x480

    @property
    def key(self) -> str:
        """Of its job."""
        return f"film-{self.azimuth:g}-{self.elevation:g}-{self.distance:g}-{self.focal:.0f}"


_PICTURED = (
    *(Place(0, 0, distance, _FOCAL) for distance in (1.1, _FAR, 3.7)),
    *(Place(azimuth, elevation, _FAR, _FOCAL) for azimuth, elevation in ((-45, 45), (60, 15))),
)


def fitted(distance: float) -> float:
    """px, the focal length with which the ball fills the picture."""
    return float(0.5 * _FILL * 480.0 * np.sqrt((distance / 0.6) ** 2 - 1.0))


def _lens(name: str, distance: float) -> float:
    return _FOCAL if name == _LENSES[0] else fitted(distance)


def _checked(quick: bool) -> tuple[list[Place], list[Place]]:
    """Places that are filmed: of the map of directions, and of the distances."""
    if quick:
        return [Place(0, 10, _FAR, _FOCAL)], []
    far = [Place(a, e, _FAR, _FOCAL) for a, e in _CHECKED]
    return far, [Place(0, 0, d, _lens(lens, d)) for lens, found in _CHECKED_DISTANCES.items() for d in found]


def jobs(request: Request) -> list[Job]:
    """Two maps and the films that check them."""
    around, along = _checked(request.quick)
    frames, layouts, pictures, pictured = (45, 1, 6, 3) if request.quick else (_FRAMES, 3, 16, len(_PICTURED))
    common = {"layouts": layouts, "frames": frames, "pictures": pictures, "pictured": pictured}
    work = []
    for name, places, checked in _maps(request.quick, around, along):
        cost = pictured * (1.5 + 0.04 * pictures) + 0.001 * frames * layouts * len(places)
        plain = {"places": [list(p) for p in places], "checked": [list(p) for p in checked]}
        work.append(Job(name, mapped, {**plain, **common}, cost=cost))
    return work + [
        Job(place.key, filmed, {"place": list(place), "frames": frames}, cost=2.5 + 0.03 * frames)
        for place in (*around, *along)
    ]


def _maps(quick: bool, around: list[Place], along: list[Place]) -> list[tuple[str, list[Place], list[Place]]]:
    """Name, places, and those of them that are filmed."""
    if quick:
        return [("directions-0", [Place(a, e, _FAR, _FOCAL) for e in ELEVATIONS[::3] for a in AZIMUTHS[::3]], around)]
    half = len(ELEVATIONS) // 2
    halves = [
        [Place(a, e, _FAR, _FOCAL) for e in rows for a in AZIMUTHS] for rows in (ELEVATIONS[:half], ELEVATIONS[half:])
    ]
    distances_ = [Place(0, 0, d, _lens(lens, d)) for lens in _LENSES for d in DISTANCES]
    return [("directions-0", halves[0], around), ("directions-1", halves[1], []), ("distances", distances_, along)]


# ---- the map ----


def scene_from(place: Place, layout: int) -> Scene:
    """The device before a camera of 640x480 in a place."""
    scene = default_scene(_DISCS, "far", layout)
    a, e = np.radians([place.azimuth, place.elevation])
    away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    camera = replace(scene.camera, fx=place.focal, fy=place.focal)
    return replace(scene, camera=camera, pose=looking(place.distance * away, _AIM, 0.0))


def mapped(
    places: Sequence[Sequence[float]],
    checked: Sequence[Sequence[float]],
    layouts: int,
    frames: int,
    pictures: int,
    pictured: int,
) -> Result:
    """The bound at all places, RMS over layouts of the discs; at those that are filmed, with the film's discs."""
    noise = measured_noise(pictures, pictured)
    return {
        "noise": [list(row) for row in noise],
        "map": [expected(Place(*p), range(layouts), frames, noise) for p in places],
        "checked": [expected(Place(*p), (0,), frames, noise) for p in checked],
    }


class Size(NamedTuple):
    """Discs of a size in the picture."""

    area: float  # px², geometric mean of its bounds
    sigma: float  # px, RMS per axis of the error of those that are found
    share: float  # that is found
    discs: int


def measured_noise(pictures: int, places: int = len(_PICTURED)) -> list[Size]:
    """How well centres are measured by the size of discs, from pictures at several places, in octaves of area."""
    settings = kit.settings_of().discs
    areas, errors = [], []
    for k, place in enumerate(_PICTURED[:places]):
        scene = scene_from(place, k)
        renderer, rng = Renderer(scene, RenderOptions(noise=_NOISE)), np.random.default_rng([k, 7])
        detector = disc_detector(settings, scene.rig(), scene.pose)
        for picture in range(pictures):
            shot = renderer.frame(thesis(), 9.0 * picture / pictures, picture, rng)
            found = detector.detect(shot.frame.image).centre
            whole = shot.discs.state == VISIBLE
            centre = shot.discs.centre[whole]
            i, j = assign(distances(centre, found), MATCH)
            error = np.full(centre.shape, np.nan)
            error[i] = found[j] - centre[i]
            areas.append(shot.discs.area[whole])
            errors.append(error)
    area, error = np.concatenate(areas), np.concatenate(errors)
    octave = np.floor(np.log2(area))
    sizes = []
    for o in np.unique(octave):
        here = octave == o
        known = here & np.isfinite(error[:, 0])
        if np.count_nonzero(here) >= _LEAST:
            sigma = float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else float("inf")
            share = float(np.count_nonzero(known) / np.count_nonzero(here))
            if share > 0.0:
                sizes.append(Size(float(2.0 ** (o + 0.5)), sigma, share, int(np.count_nonzero(here))))
    return sizes


def expected(place: Place, layouts: Sequence[int], frames: int, noise: Sequence[Size]) -> Result:
    """Bound of attitude (deg) and rate (deg/s), discs in use, and targets that the camera sees."""
    times = np.arange(frames) / _FPS
    motion = Truth(times, thesis().attitude(times), thesis().rate(times))
    squares, discs = [], []
    scene = scene_from(place, 0)
    for layout in layouts:
        scene = scene_from(place, layout)
        seen = _sights(scene, motion.attitude, noise)
        discs.append(float(np.mean([len(s.disc) for s in seen])))
        limit = posterior_bound(motion, seen, scene.disc_directions, scene.rig(), scene.pose)
        squares.append([np.mean(np.trace(P[1:], axis1=1, axis2=2)) for P in (limit.attitude, limit.rate)])
    attitude, rate = np.degrees(np.sqrt(np.mean(squares, axis=0)))
    return {
        "place": list(place),
        "attitude_deg": float(attitude),
        "rate_deg_s": float(rate),
        "discs": float(np.mean(discs)),
        "targets": targets_in_view(scene),
    }


def _sights(scene: Scene, attitude: Array, noise: Sequence[Size]) -> list[Sight]:
    """The discs wholly in view at attitudes (n, 3, 3), each as certain as its size allows."""
    n, m = len(attitude), len(scene.disc_directions)
    toward = (scene.disc_directions @ attitude.transpose(0, 2, 1)).reshape(-1, 3)
    seen = appearance(toward, scene.rig(), scene.pose)
    sigma = _sigma(seen.area, noise)
    row = np.flatnonzero(seen.whole & np.isfinite(sigma))
    row = row[_in_view(scene, toward[row])]
    ends = np.searchsorted(row, m * np.arange(n + 1))
    return [Sight(row[a:b] - k * m, sigma[row[a:b]]) for k, (a, b) in enumerate(pairwise(ends))]


def _sigma(area: Array, noise: Sequence[Size]) -> Array:
    """px per axis by area, (n,) px²; inf for what is smaller than all that was found.

    A disc that is found every other time tells half as much.
    """
    known, worth = np.array([s.area for s in noise]), np.array([s.sigma / np.sqrt(s.share) for s in noise])
    sigma = np.exp(np.interp(np.log(area), np.log(known), np.log(worth)))
    return np.where(area >= known[0] / np.sqrt(2.0), sigma, np.inf)  # nan compares false


def _in_view(scene: Scene, toward: Array) -> NDArray[np.bool_]:
    """Which discs at (n, 3) unit vectors in obj, on the near side, are wholly in the picture and hidden by nothing."""
    angle = scene.disc_angle
    around = np.stack([np.cos(_RIM), np.sin(_RIM)], axis=1) @ tangent_basis(toward).transpose(0, 2, 1)
    points = np.concatenate([toward[:, None], np.cos(angle) * toward[:, None] + np.sin(angle) * around], axis=1)
    cam = scene.pose.to_cam(scene.ball_radius * points)
    first, _ = _shapes(scene).cast(cam[..., :2] / cam[..., 2:])
    return _in_picture(cam, scene) & np.all(first == 0, axis=1)


def targets_in_view(scene: Scene) -> int:
    """Targets wholly in the picture, hidden by nothing, with rings wide enough for their detector."""
    targets, pose = scene.targets, scene.pose
    rim = np.stack([np.cos(_RIM), np.sin(_RIM), np.zeros(len(_RIM))], axis=1)
    cam = pose.to_cam(targets.position[:, None] + 0.98 * targets.radii[-1] * rim)
    away = pose.position - targets.position
    distance = np.linalg.norm(away, axis=1)
    width = np.min(np.diff(targets.radii, prepend=0.0)) * scene.camera.fx * away[:, 2] / distance**2
    seen = (width > _RING) & np.all(cam[..., 2] > 0.0, axis=1)
    cam = cam[seen]
    _, depth = _shapes(scene).cast(cam[..., :2] / cam[..., 2:])
    return int(np.count_nonzero(_in_picture(cam, scene) & np.all(depth > cam[..., 2] - 1e-3, axis=1)))


def _in_picture(cam: Array, scene: Scene) -> NDArray[np.bool_]:
    """Which groups of points, (n, k, 3) in cam, are all in the picture."""
    uv = project(cam.reshape(-1, 3), scene.camera)[0].reshape(*cam.shape[:2], 2)
    return np.all((uv >= 0.0) & (uv <= (scene.camera.width - 1, scene.camera.height - 1)), axis=(1, 2))


def _shapes(scene: Scene) -> Viewpoint:
    shapes = [Sphere(np.zeros(3), scene.ball_radius, scene.ball_colour), *scene.surroundings]
    return look(shapes, scene.pose.position, scene.pose.rotation)


# ---- films ----


def filmed(place: Sequence[float], frames: int) -> Result:
    """What `so3` makes of a film from there, with the pose it finds and with the true one, and the film's own bound."""
    where = Place(*place)
    simulation = prepare(kit.options_of({"discs": _DISCS, "noise": _NOISE, "seconds": frames / _FPS}))
    film = kit.made(replace(simulation, scene=scene_from(where, 0)), where.key)
    tracked = kit.tracked(film, kit.settings_of(), own_pose=False)
    result: Result = {"place": list(where), "true pose": tracked.report, "bound": kit.bound(film, tracked)}
    try:
        result["own pose"] = kit.tracked(film, kit.settings_of()).report
    except PoseError as e:
        result["own pose"] = {"error": str(e)}
    return result


# ---- for a reader ----

_POSED = 3  # targets that make a pose
_SPAN = 1.5  # times the least error: the least that colours tell apart
_QUANTITIES = (
    ("attitude_deg", "attitude_rmse_deg", "attitude", "°", 4),
    ("rate_deg_s", "rate_rmse_deg_s", "rate", "°/s", 3),
)


def section(request: Request, results: Results) -> Section:
    """The maps, the films beside them, and where to put the camera."""
    around = [entry for key in ("directions-0", "directions-1") for entry in _of(results, key, "map")]
    along = _of(results, "distances", "map")
    rows = _films(results)
    first = next((r for k, r in results.items() if "noise" in r), None)
    frames = jobs(request)[0].parameters["frames"]
    parts: list[str | Table | Figure] = [
        f"{_DISCS} discs, the device's frame, 640x480 pixels, the first {frames} frames of the thesis' motion, noise "
        f"of {_NOISE:g} grey values. What is mapped is the Cramér-Rao bound, by geometry alone: the discs that are "
        "wholly in view, and how well centres of their size are measured. The camera looks at the middle of ball and "
        "frame. "
        "At some places films were rendered and tracked; their own bound has the noise of their own centres."
    ]
    if around:
        parts += [_said_of_directions(around), _figure_directions(around, rows)]
    if along:
        parts += [_said_of_distances(along), _figure_distances(along, rows)]
    if rows:
        parts += [_table(rows, results), _agreement(rows, results)]
    if first is not None:
        parts.append(_noise_table(first["noise"]))
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), dict(results))


def _of(results: Results, key: str, name: str) -> list[Result]:
    """What a map's job found; nothing where it failed."""
    return results.get(key, {}).get(name, [])


def _films(results: Results) -> list[tuple[Place, Result]]:
    return [(Place(*r["place"]), r) for k, r in results.items() if k.startswith("film-") and "error" not in r]


def _expected_at(results: Results, place: Place) -> Result | None:
    """The map's value with the film's own discs."""
    entries = [e for key in ("directions-0", "distances") for e in _of(results, key, "checked")]
    return next((e for e in entries if Place(*e["place"]).key == place.key), None)


def _said_of_directions(entries: list[Result]) -> str:
    """The best direction, how much it matters, and where the targets are seen."""
    seen = [e for e in entries if e["targets"] >= _POSED]
    best, worst = (pick(entries, key=lambda e: e["attitude_deg"]) for pick in (min, max))
    share = np.mean([e["attitude_deg"] <= _NEAR_BEST * best["attitude_deg"] for e in entries])
    text = (
        f"Over all {len(entries)} directions at {_FAR:g} m the bound of the attitude goes from "
        f"{best['attitude_deg']:.4f}° ({_direction(best)}; {best['discs']:.1f} discs in view) to "
        f"{worst['attitude_deg']:.4f}° ({_direction(worst)}; {worst['discs']:.1f}), that of the rate from "
        f"{min(e['rate_deg_s'] for e in entries):.3f} to {max(e['rate_deg_s'] for e in entries):.3f} °/s; "
        f"{100.0 * share:.0f} % of them are within {100.0 * (_NEAR_BEST - 1.0):.0f} % of the best attitude. "
    )
    if not seen:
        return text + "From none of them three targets are seen."
    chosen = min(seen, key=lambda e: e["attitude_deg"])
    azimuth, elevation = ([e["place"][i] for e in seen] for i in (0, 1))
    limits = (
        f"What limits the choice is the targets: three or more are seen from {len(seen)} of the {len(entries)} "
        f"directions only, all {_within(azimuth)} of azimuth and {_within(elevation)} of elevation. "
        if len(seen) < len(entries)
        else "Three targets or more are seen from all of them. "
    )
    return text + (
        f"{limits}Advice: put the camera at {_direction(chosen)} "
        f"({chosen['attitude_deg']:.4f}°, {chosen['rate_deg_s']:.3f} °/s), or anywhere where it sees the targets "
        f"({max(e['attitude_deg'] for e in seen):.4f}° at worst); for another place move the targets along."
    )


def _within(degrees: list[float]) -> str:
    low, high = min(degrees), max(degrees)
    return f"at {low:g}°" if low == high else f"within {low:g}° to {high:g}°"


def _direction(entry: Result) -> str:
    place = Place(*entry["place"])
    return f"azimuth {place.azimuth:g}°, elevation {place.elevation:g}°"


def _said_of_distances(entries: list[Result]) -> str:
    """What distance does, with a lens that stays and with one that is chosen for it."""
    said = []
    for lens in _LENSES:
        here = _with_lens(entries, lens)
        if here:
            best = min(here, key=lambda e: e["attitude_deg"])
            near = [e["place"][2] for e in here if e["attitude_deg"] <= _NEAR_BEST * best["attitude_deg"]]
            said.append(
                f"{_lens_named(lens)} the attitude is best from {best['place'][2]:g} m ({best['attitude_deg']:.4f}°, "
                f"{best['discs']:.1f} discs in view) and within {100.0 * (_NEAR_BEST - 1.0):.0f} % of that from "
                f"{', '.join(f'{d:g}' for d in sorted(near))} m"
            )
    ranges = [e["place"][2] for e in _with_lens(entries, _LENSES[1]) if e["targets"] >= _POSED]
    from_ = ", ".join(f"{r:g}" for r in sorted(ranges))
    seen = f" With a lens that fits, three targets are in the picture from {from_} m." if ranges else ""
    return "; ".join(said) + "." + seen


def _lens_named(lens: str) -> str:
    return (
        f"With the same lens ({_FOCAL:g} px)"
        if lens == _LENSES[0]
        else "with a lens with which the ball fills the picture"
    )


def _with_lens(entries: list[Result], lens: str) -> list[Result]:
    return [e for e in entries if abs(e["place"][3] - _lens(lens, e["place"][2])) < 0.5]


def _table(rows: list[tuple[Place, Result]], results: Results) -> Table:
    lines: list[tuple[str, ...]] = []
    for place, film in rows:
        expected_ = _expected_at(results, place)
        true, own = film["true pose"], film["own pose"]
        targets = "–" if expected_ is None else str(expected_["targets"])
        where = (_named(place), targets, value(true, "mean_discs", digits=1))
        errors = {
            "map": [value(expected_, quantity, digits=d) for quantity, _, _, _, d in _QUANTITIES],
            "film's bound": [
                value(film["bound"], quantity, "combined", digits=d) for quantity, _, _, _, d in _QUANTITIES
            ],
            "`so3`, true pose": [value(true, key, "combined", digits=d) for _, key, _, _, d in _QUANTITIES],
            "`so3`, own pose": ["no pose"] * 2
            if "error" in own
            else [value(own, key, "combined", digits=d) for _, key, _, _, d in _QUANTITIES],
        }
        gone = {"`so3`, true pose": str(true["frames"] - true["tracked"])}
        gone["`so3`, own pose"] = "no pose" if "error" in own else str(own["frames"] - own["tracked"])
        for k, (name, both) in enumerate(errors.items()):
            lines.append((*(where if k == 0 else ("", "", "")), name, *both, gone.get(name, "")))
    for key, result in results.items():
        if key.startswith("film-") and "error" in result:
            lines.append((f"{key.removeprefix('film-')}: failed", *["–"] * 6))
    head = (
        *("azimuth, elevation, distance, focal length", "targets in view", "discs used", ""),
        *(f"{word}, {unit}" for _, _, word, unit, _ in _QUANTITIES),
        "frames lost",
    )
    return Table(head, tuple(lines), "Films beside the map")


def _named(place: Place) -> str:
    return f"{place.azimuth:g}°, {place.elevation:g}°, {place.distance:g} m, {place.focal:.0f} px"


def _agreement(rows: list[tuple[Place, Result]], results: Results) -> str:
    """How far films are from the map."""
    said = []
    whole = [(p, film) for p, film in rows if film["true pose"]["tracked"] == film["true pose"]["frames"]]
    for quantity, key, word, _, _ in _QUANTITIES:
        ratios = []
        for place, film in whole:
            expected_, found = _expected_at(results, place), film["true pose"][key]["combined"]
            if expected_ is not None and found is not None:
                ratios.append(found / expected_[quantity])
        if ratios:
            said.append(f"{word} {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")
    if not said:
        return ""
    return (
        f"Error of `so3` over the map's, median and range over the {len(whole)} of {len(rows)} films that were tracked "
        f"from the first frame to the last: {'; '.join(said)}. A map takes one noise for "
        f"discs of a size, wherever the light comes from; films know better.{_without_pose(rows)}{_lost_by_pose(rows)}"
    )


def _without_pose(rows: list[tuple[Place, Result]]) -> str:
    """From how many places the targets gave no pose, and what became of the ball; empty where there is none."""
    blind = [film["true pose"] for _, film in rows if "error" in film["own pose"]]
    if not blind:
        return ""
    followed = sum(f["tracked"] == f["frames"] for f in blind)
    how = f"; with the true pose the ball is tracked to the end from {followed} of them" if followed else ""
    return f" From {len(blind)} of {len(rows)} places the targets gave no pose{how}."


def _lost_by_pose(rows: list[tuple[Place, Result]]) -> str:
    """Where the ball is lost for the pose that was found; empty where it is not."""
    said = []
    for place, film in rows:
        true, own = film["true pose"], film["own pose"]
        if "error" in own or own["tracked"] >= true["tracked"] or not own["pose_error"]:
            continue
        off, sigma = (np.linalg.norm(own["pose_error"][key]) for key in ("position_mm", "sigma_position_mm"))
        said.append(
            f"from {place.distance:g} m with {place.focal:.0f} px ({place.azimuth:g}°, {place.elevation:g}°), where it "
            f"is off by {off:.0f} mm (standard deviation {sigma:.0f} mm), {true['tracked'] - own['tracked']} frames"
        )
    return f" With the pose that was found the ball is lost: {'; '.join(said)}." if said else ""


def _noise_table(noise: list[list[float]]) -> Table:
    sizes = [Size(area, sigma, share, int(discs)) for area, sigma, share, discs in noise]
    rows = [
        (
            f"{s.area / np.sqrt(2.0):.0f} to {s.area * np.sqrt(2.0):.0f}",
            str(s.discs),
            f"{100.0 * s.share:.0f} %",
            f"{s.sigma:.3f}",
        )
        for s in sizes
    ]
    return Table(
        ("area, px²", "discs", "found", "centre RMS per axis, px"), tuple(rows), "Noise by size, as in the map"
    )


def _figure_directions(entries: list[Result], rows: list[tuple[Place, Result]]) -> Figure:
    def draw(canvas: Any) -> None:
        from matplotlib.colors import LogNorm
        from matplotlib.patheffects import Normal, Stroke
        from matplotlib.ticker import NullFormatter

        axes = canvas.subplots(1, 2, sharey=True)
        azimuth, elevation = (sorted({e["place"][i] for e in entries}) for i in (0, 1))
        by_place = {(e["place"][0], e["place"][1]): e for e in entries}
        grid = [[by_place.get((a, e)) for a in azimuth] for e in elevation]
        films = [(p, r["true pose"]) for p, r in rows if p.distance == _FAR and p.focal == _FOCAL]
        for ax, (quantity, key, word, unit, digits) in zip(axes, _QUANTITIES, strict=True):
            values = np.array([[np.nan if c is None else c[quantity] for c in line] for line in grid])
            found = [(p, r[key]["combined"]) for p, r in films if r[key]["combined"] is not None]
            low = float(np.nanmin(values))
            high = max(_SPAN * low, 1.0001 * float(np.nanmax(values)), *(x for _, x in found))
            norm = LogNorm(low, high)
            shown = ax.pcolormesh(azimuth, elevation, values, norm=norm, shading="nearest", rasterized=False)
            usable = np.array([[c is not None and c["targets"] >= _POSED for c in line] for line in grid])
            _outline(ax, azimuth, elevation, usable)
            for place, x in found:
                ax.scatter(place.azimuth, place.elevation, s=60, c=[x], norm=norm, edgecolors="white", linewidths=1.2)
                ax.annotate(
                    f"{x:.{digits}f}",
                    (place.azimuth, place.elevation),
                    (0.0, -13.0),
                    textcoords="offset points",
                    ha="center",
                    fontsize=7.5,
                    color="white",  # on the map, whatever the page is
                    path_effects=[Stroke(linewidth=2.0, foreground="#222222"), Normal()],
                )
            ax.set(title=f"{word}, {unit}", xlabel="azimuth, °")
            ax.grid(visible=False)
            bar = canvas.colorbar(shown, ax=ax, location="bottom", aspect=30)
            ticks = _ticks(low, high)
            bar.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
            bar.ax.xaxis.set_minor_formatter(NullFormatter())
            bar.ax.minorticks_off()
            bar.set_label("darker: better")
        axes[0].set_ylabel("elevation, °")

    return Figure(
        "places-directions",
        f"The bound of attitude and rate by the direction of the camera, {_FAR:g} m from the ball's centre (azimuth "
        "0°, elevation 0°: straight before the frame). Outlined: three targets or more are seen: the pose can be "
        "found. Circles and numbers: the error of `so3` on films from there, the pose being known.",
        draw,
        (7.2, 4.2),
    )


def _outline(ax: Any, x: Sequence[float], y: Sequence[float], where: NDArray[np.bool_]) -> None:
    """A line around cells of a grid, seen on dark cells and on bright ones."""
    from matplotlib.collections import LineCollection

    dx, dy = (np.min(np.diff(v)) if len(v) > 1 else 10.0 for v in (x, y))
    padded, sides = np.pad(where, 1), []
    for i, j in np.argwhere(where):
        left, right, low, high = x[j] - dx / 2.0, x[j] + dx / 2.0, y[i] - dy / 2.0, y[i] + dy / 2.0
        around = {
            (1, 0): [(left, low), (left, high)],
            (1, 2): [(right, low), (right, high)],
            (0, 1): [(left, low), (right, low)],
            (2, 1): [(left, high), (right, high)],
        }
        sides += [line for (di, dj), line in around.items() if not padded[i + di, j + dj]]
    for colour, width in (("#222222", 3.4), ("white", 1.6)):  # on the map, whatever the page is
        ax.add_collection(LineCollection(sides, colors=colour, linewidths=width, capstyle="round"))


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers within bounds."""
    most = 0.5 * (high - low)
    step = 10.0 ** np.floor(np.log10(most))
    step *= max(k for k in (1.0, 2.0, 5.0) if k * step <= most)
    return (step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)).tolist()


def _figure_distances(entries: list[Result], rows: list[tuple[Place, Result]]) -> Figure:
    def draw(canvas: Any) -> None:
        from matplotlib.ticker import StrMethodFormatter

        axes = canvas.subplots(1, 2)
        for ax, (quantity, key, word, unit, _) in zip(axes, _QUANTITIES, strict=True):
            for k, lens in enumerate(_LENSES):
                here = sorted(_with_lens(entries, lens), key=lambda e: e["place"][2])
                ax.plot([e["place"][2] for e in here], [e[quantity] for e in here], color=f"C{k}", **BOUND)
                films = [
                    (p, r)
                    for p, r in rows
                    if p.azimuth == p.elevation == 0 and abs(p.focal - _lens(lens, p.distance)) < 0.5
                ]
                for name, mark in (("true pose", "o"), ("own pose", "x")):
                    points = [(p.distance, r[name][key]["combined"]) for p, r in films if key in r[name]]
                    points = [(d, x) for d, x in points if x is not None]
                    ax.plot(
                        *zip(*points, strict=True) if points else ([], []), color=f"C{k}", marker=mark, linestyle=""
                    )
            ax.set(
                xscale="log", yscale="log", xlabel="distance from the ball's centre, m", ylabel=f"{word} error, {unit}"
            )
            ax.set_ylim(top=_TOP * min(e[quantity] for e in entries))
            ax.set_xticks([1, 1.5, 2, 3, 4], ["1", "1.5", "2", "3", "4"])
            ax.minorticks_off()
            ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=4)

    return Figure(
        "places-distances",
        f"Errors against the distance, straight before the frame, with a lens of {_FOCAL:g} px and with one with which "
        f"the ball fills the picture. Lines: the bound by geometry; marks: `so3` on films. More than {_TOP:g} times "
        "the least is not drawn: there hardly a disc is in view.",
        draw,
        (7.2, 3.4),
    )


def _handles() -> list[Any]:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=f"C{k}", label=f"bound, {lens}", **BOUND) for k, lens in enumerate(_LENSES)]
    marks = (("o", "so3, true pose"), ("x", "so3, own pose"))
    return [*lines, *(Line2D([], [], color="0.5", marker=m, linestyle="", label=name) for m, name in marks)]
