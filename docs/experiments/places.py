"""Expected attitude and rate errors by direction and distance of the camera.

Wittich 2017, chapter 5, asks for as many cameras as possible. The map is the posterior Cramer-Rao bound of a
camera at each place, by geometry alone. It depends on the discs that are wholly in view past the device's frame, on
their size in the picture, and on the noise of centres of that size, which pictures give first. The camera points at the
middle of ball and frame. Azimuth 0° and elevation 0° are straight before the frame.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.kit import film as kit
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import ATTITUDE, RATE, Part, Plot, Table, tidy, where
from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.truth import VISIBLE, Truth
from spheremouse.evaluation.bound import MATCH, Sight, posterior_bound
from spheremouse.geometry.camera import project
from spheremouse.geometry.matching import assign, distances
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.simulate.ball.film import Renderer, RenderOptions, Scene, default_scene
from spheremouse.simulate.ball.profile import thesis
from spheremouse.simulate.ball.stills import looking

TITLE = "Where to put the camera (Wittich 2017, chapter 5)"
DISCS = 50
NOISE = 3.0  # grey values
_FPS = 30.0  # Hz
_FRAMES = 150
_AIM = np.array([0.0, -0.17, 0.0])  # m, obj: the middle of ball and frame
FAR = 2.35  # m, from the ball's centre: the thesis' far camera
FOCAL = 640.0  # px, its lens
_FILL = 0.9  # share of the picture's height that the ball fills before a lens chosen for its distance
_RIM = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)  # where a disc is looked at, beside its centre
_RING = 2.5  # px across: narrower rings of targets are not found (`targets`)
_MIN_CENTRES = 15  # centres that make a size class
POSED = 3  # targets that make a pose
TOP = 60.0  # times the least error: more is not drawn
LENSES = ("same lens", "ball fills the picture")

AZIMUTHS = tuple(range(-90, 91, 15))  # deg, to the right of the device's front
ELEVATIONS = tuple(range(-20, 81, 10))  # deg
DISTANCES = (0.9, 1.0, 1.15, 1.35, 1.6, 2.0, 2.35, 2.8, 3.3, 3.8)  # m


class Place(NamedTuple):
    azimuth: float  # deg
    elevation: float  # deg
    distance: float  # m, from the ball's centre
    focal: float  # px, of a picture of 640x480


_PICTURED = (
    *(Place(0, 0, distance, FOCAL) for distance in (1.1, FAR, 3.7)),
    *(Place(azimuth, elevation, FAR, FOCAL) for azimuth, elevation in ((-45, 45), (60, 15))),
)


def fitted(distance: float) -> float:
    """px, the focal length with which the ball fills the picture."""
    return float(0.5 * _FILL * 480.0 * np.sqrt((distance / 0.6) ** 2 - 1.0))


def lens_of(name: str, distance: float) -> float:
    return FOCAL if name == LENSES[0] else fitted(distance)


def jobs(request: Request) -> list[Job]:
    frames, layouts, pictures, pictured = (45, 1, 6, 3) if request.quick else (_FRAMES, 3, 16, len(_PICTURED))
    common = {"layouts": layouts, "frames": frames, "pictures": pictures, "pictured": pictured}
    return [
        Job(
            name, mapped, {"places": [list(p) for p in places], **common},
            cost=pictured * (1.5 + 0.04 * pictures) + 0.001 * frames * layouts * len(places)
        )
        for name, places in _maps(request.quick)
    ]  # fmt: skip


def _maps(quick: bool) -> list[tuple[str, list[Place]]]:
    if quick:
        return [("directions-0", [Place(a, e, FAR, FOCAL) for e in ELEVATIONS[::3] for a in AZIMUTHS[::3]])]
    half = len(ELEVATIONS) // 2
    halves = [
        [Place(a, e, FAR, FOCAL) for e in rows for a in AZIMUTHS] for rows in (ELEVATIONS[:half], ELEVATIONS[half:])
    ]
    along = [Place(0, 0, d, lens_of(lens, d)) for lens in LENSES for d in DISTANCES]
    return [("directions-0", halves[0]), ("directions-1", halves[1]), ("distances", along)]


# ---- the map ----


def scene_from(place: Place, layout: int) -> Scene:
    """The device before a camera of 640x480 in a place."""
    scene = default_scene(DISCS, "far", layout)
    a, e = np.radians([place.azimuth, place.elevation])
    away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    camera = replace(scene.camera, fx=place.focal, fy=place.focal)
    return replace(scene, camera=camera, pose=looking(place.distance * away, _AIM, 0.0))


def mapped(places: Sequence[Sequence[float]], layouts: int, frames: int, pictures: int, pictured: int) -> Result:
    """Return the bound at all places, RMS over layouts of the discs."""
    noise = measured_noise(pictures, pictured)
    return {
        "noise": [list(row) for row in noise],
        "map": [expected(Place(*p), range(layouts), frames, noise) for p in places],
    }


class Size(NamedTuple):
    """Discs of a size in the picture."""

    area: float  # px², geometric mean of its bounds
    sigma: float  # px, RMS per axis of the error of those that are found
    share: float  # that is found
    discs: int


def measured_noise(pictures: int, places: int = len(_PICTURED)) -> list[Size]:
    """Return the accuracy of centres by octave of disc area, from pictures at several places."""
    settings = kit.settings_of().discs
    areas, errors = [], []
    for k, place in enumerate(_PICTURED[:places]):
        scene = scene_from(place, k)
        renderer, rng = Renderer(scene, RenderOptions(noise=NOISE)), np.random.default_rng([k, 7])
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
        if np.count_nonzero(here) >= _MIN_CENTRES:
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
        seen = sights_at(scene, motion.attitude, noise)
        discs.append(float(np.mean([len(s.disc) for s in seen])))
        limit = posterior_bound(motion, seen, scene.disc_directions, scene.rig(), scene.pose)
        squares.append([np.mean(np.trace(P[1:], axis1=1, axis2=2)) for P in (limit.attitude, limit.rate)])
    attitude, rate = np.degrees(np.sqrt(np.mean(squares, axis=0)))
    return {
        "place": list(place), "attitude_deg": float(attitude), "rate_deg_s": float(rate),
        "discs": float(np.mean(discs)), "targets": targets_in_view(scene)
    }  # fmt: skip


def sights_at(scene: Scene, attitude: Array, noise: Sequence[Size]) -> list[Sight]:
    """The discs wholly in view at attitudes (n, 3, 3), each as certain as its size allows."""
    n, m = len(attitude), len(scene.disc_directions)
    toward = (scene.disc_directions @ attitude.transpose(0, 2, 1)).reshape(-1, 3)
    seen = appearance(toward, scene.rig(), scene.pose)
    sigma = centre_sigma(seen.area, noise)
    row = np.flatnonzero(seen.whole & np.isfinite(sigma))
    row = row[_in_view(scene, toward[row])]
    ends = np.searchsorted(row, m * np.arange(n + 1))
    return [Sight(row[a:b] - k * m, sigma[row[a:b]]) for k, (a, b) in enumerate(pairwise(ends))]


def centre_sigma(area: Array, noise: Sequence[Size]) -> Array:
    """Return the noise of centres by area, (n,) px²: px per axis, inf for areas below the smallest detected one.

    A disc that is found every other time tells half as much.
    """
    known, worth = np.array([s.area for s in noise]), np.array([s.sigma / np.sqrt(s.share) for s in noise])
    sigma = np.exp(np.interp(np.log(area), np.log(known), np.log(worth)))
    return np.where(area >= known[0] / np.sqrt(2.0), sigma, np.inf)  # nan compares false


def _in_view(scene: Scene, toward: Array) -> NDArray[np.bool_]:
    """Return which discs, (n, 3) unit vectors in obj, are on the near side, wholly in the picture and not hidden."""
    angle = scene.disc_angle
    around = np.stack([np.cos(_RIM), np.sin(_RIM)], axis=1) @ tangent_basis(toward).transpose(0, 2, 1)
    points = np.concatenate([toward[:, None], np.cos(angle) * toward[:, None] + np.sin(angle) * around], axis=1)
    cam = scene.pose.to_cam(scene.ball_radius * points)
    first, _ = scene.viewpoint().cast(cam[..., :2] / cam[..., 2:])
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
    _, depth = scene.viewpoint().cast(cam[..., :2] / cam[..., 2:])
    return int(np.count_nonzero(_in_picture(cam, scene) & np.all(depth > cam[..., 2] - 1e-3, axis=1)))


def _in_picture(cam: Array, scene: Scene) -> NDArray[np.bool_]:
    """Return which groups of points, (n, k, 3) in cam, are all in the picture."""
    uv = project(cam.reshape(-1, 3), scene.camera)[0].reshape(*cam.shape[:2], 2)
    return np.all((uv >= 0.0) & (uv <= (scene.camera.width - 1, scene.camera.height - 1)), axis=(1, 2))


# ---- section ----


def section(results: Results) -> list[Part]:
    maps = [{"part": key.partition("-")[0], **_entry(e)} for key, r in results.items() for e in r.get("map", ())]
    rows = tidy(maps, ["part", *_PLACE, ATTITUDE, RATE, "discs in view", "targets in view"])
    around, along = (
        where(rows, part=part).drop(columns="part").sort_values(ATTITUDE) for part in ("directions", "distances")
    )
    seen = around[around["targets in view"] >= POSED]
    sizes = next((r["noise"] for r in results.values()), [])
    return [
        Table(
            "The best and the worst direction, of all and of those that see three targets",
            pd.concat([around[:1], around[-1:], seen[:1], seen[-1:]])
        ),
        Table("The bound by distance, straight before the frame", along.sort_values(["lens", "distance, m"]), ["lens"]),
        Table("Noise by size", pd.DataFrame(sizes, columns=list(_SIZE))),
        Plot(
            "places-directions", "The bound by the direction of the camera.",
            around.sort_values(["elevation, °", "azimuth, °"]), "azimuth, °", [ATTITUDE, RATE], "elevation, °", log="y"
        ),
        Plot(
            "places-distances", "The bound against the distance, straight before the frame.",
            along[along[ATTITUDE] <= TOP * along[ATTITUDE].min()], "distance, m", [ATTITUDE, RATE], "lens", log="xy"
        )
    ]  # fmt: skip


_PLACE = ["azimuth, °", "elevation, °", "distance, m", "focal length, px", "lens"]
_SIZE = ("area, px²", "centre RMS per axis, px", "share found", "discs")


def _entry(entry: Result) -> Result:
    place = Place(*entry["place"])
    found = {ATTITUDE: entry["attitude_deg"], RATE: entry["rate_deg_s"]}
    found |= {"discs in view": entry["discs"], "targets in view": entry["targets"]}
    return {**dict(zip(_PLACE, (*place, LENSES[place.focal != FOCAL]), strict=True)), **found}
