"""Simulated calibration photos of a device and of a chessboard, with their ground truth.

`prepare_stills` builds device, lens and places, and `photos` takes the pictures one by one. The hand-held camera takes
the views of the written instructions: the device from all sides that show three targets, and the board aslant, near,
and in every part of the picture.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.rig import Rig
from spheremouse.errors import ConfigurationError
from spheremouse.files.dataset.write import device_description
from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import Array, exp
from spheremouse.simulate.ball import board
from spheremouse.simulate.ball.options import StillsOptions
from spheremouse.simulate.ball.profile import still
from spheremouse.simulate.ball.render import Renderer
from spheremouse.simulate.ball.scene import LAMPS, STRIPS, Scene, default_scene, frame, room
from spheremouse.simulate.light import Lighting, expose
from spheremouse.simulate.shapes import circle, unit

_AIM = np.array([0.0, -0.17, 0.0])  # m, obj: the middle of ball and frame
_MIN_DISTANCE_M, _MAX_DISTANCE_M = 1.8, 3.3  # m
_WALLS = np.array([[-2.5, -1.0, 0.9], [2.5, 2.3, 3.8]])  # m, obj: where the room leaves space for a photographer
_BORDER_MARGIN_PX = 6.0  # px between required objects and the picture's border
_MIN_RING_PX = 3.5  # px across the narrowest ring: pixels on both its edges mix with its neighbours'
_CELLS = (16, 9)  # of a picture, in each of which a corner is wanted
_CANDIDATE_POSES = 300
_TILTS = (30.0, 45.0, 15.0, 40.0, 0.0, 35.0)  # deg
_BOARD_ROLLS = (0.0, 10.0, 90.0, -25.0, 180.0, -90.0, 45.0)  # deg, about the line of sight
_GOLDEN_ANGLE_DEG = 137.5  # deg between the directions of successive tilts: never twice the same

# Places of a careful person: azimuth and elevation (deg), distance (m), roll (deg).
_STATIONS = (
    (1.0, 6.0, 2.45, 0.0),  # front
    (-45.0, 8.0, 2.5, 0.0),  # left
    (46.0, 5.0, 2.45, 0.0),  # right
    (-18.0, 36.0, 2.5, -10.0),  # high
    (20.0, -10.0, 2.4, 3.0),  # low
    (24.0, 26.0, 2.8, 90.0),  # rolled
)
_ROLLS = (0.0, -90.0, 0.0, 90.0, 0.0, 180.0)  # deg, of the photos beyond these, in turn
_R2 = 1.0 / 1.324717957244746 ** np.array([1.0, 2.0])  # steps that fill a square evenly (Roberts 2018)


# ---- around the device ----


def device_stations(scene: Scene, n: int, rng: np.random.Generator) -> tuple[Pose, ...]:
    """Poses for `n` photos that show the whole ball and three targets or more.

    The first ones as a careful person takes them, the others from all directions in turn. Raises ConfigurationError if
    no place shows enough.
    """
    stations = list(_STATIONS[:n])
    for k in range(n - len(stations)):
        azimuth, elevation = np.array([-60.0, -14.0]) + (120.0, 58.0) * np.mod(0.5 + (k + 1) * _R2, 1.0)
        stations.append((azimuth, elevation, rng.uniform(2.1, 2.9), _ROLLS[k % len(_ROLLS)]))
    return tuple(_station(scene, station, rng) for station in stations)


def _station(scene: Scene, station: tuple[float, float, float, float], rng: np.random.Generator) -> Pose:
    """Return a hand-held pose near this place that has all in view.

    If need be it is farther away, or closer if the rings would be too narrow, or nearer to the front.
    """
    azimuth, elevation, distance, roll = station
    start = np.clip(distance, _MIN_DISTANCE_M, _MAX_DISTANCE_M)
    farther, closer = np.arange(start, _MAX_DISTANCE_M + 0.01, 0.1), np.arange(start, _MIN_DISTANCE_M, -0.1)
    for nearer in np.linspace(1.0, 0.0, 21):
        dx, dy, dr = rng.normal(0.0, (1.5, 1.5, 2.0))
        a, e = np.radians((nearer * azimuth + dx, nearer * elevation + dy))
        direction = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        for reach in (*farther, *closer[1:]):
            pose = looking(_AIM + reach * direction, _AIM, np.radians(roll + dr))
            if _in_room(pose) and _shows(replace(scene, pose=pose)):
                return pose
    raise ConfigurationError(
        f"--focal {scene.camera.fx:g}: no place in the room shows the whole ball and three targets with rings of "
        f"{_MIN_RING_PX:g} px or more; take another focal length or a larger --size"
    )


def _in_room(pose: Pose) -> bool:
    return bool(np.all(pose.position > _WALLS[0]) and np.all(pose.position < _WALLS[1]))


def looking(position: Array, at: Array, roll: float) -> Pose:
    """A camera at `position` (3,) m that has `at` (3,) in its middle and is turned by `roll` rad clockwise."""
    z = unit(at - position)
    x = unit(np.cross(z, (0.0, 1.0, 0.0)))
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    return Pose(np.stack([c * x + s * y, c * y - s * x, z], axis=1), position)


def _shows(scene: Scene) -> bool:
    """The whole ball in the picture, and three targets of it or more, wholly, facing the camera enough."""
    toward = unit(scene.pose.position)
    side = unit(np.cross(toward, (0.2, 1.0, 0.1)))
    limb = scene.ball_radius * circle(24) @ np.array([side, np.cross(toward, side)])
    whole = np.all(_in_picture(scene.pose.to_cam(limb), scene.camera)) and np.sum(_legible_targets(scene)[0]) >= 3
    return bool(whole and np.sum(seen_targets(scene)) >= 3)  # rays take most of the time


def seen_targets(scene: Scene) -> NDArray[np.bool_]:
    """Return True, (n,), for targets that are whole, that nothing hides and that have rings wide enough."""
    legible, cam = _legible_targets(scene)
    _, depth = scene.viewpoint().cast(cam[..., :2] / cam[..., 2:])
    return legible & np.all(depth > cam[..., 2] - 1e-3, axis=1)


def _legible_targets(scene: Scene) -> tuple[NDArray[np.bool_], Array]:
    """Return `seen_targets` if nothing hides one, and points of their rims, (n, 16, 3) m in `cam`."""
    targets = scene.targets
    rim = 0.98 * targets.radii[2] * np.column_stack([circle(16), np.zeros(16)])
    cam = scene.pose.to_cam(targets.position[:, None] + rim)
    inside = np.all(_in_picture(cam.reshape(-1, 3), scene.camera).reshape(cam.shape[:2]), axis=1)
    to_camera = scene.pose.position - targets.position
    distance = np.linalg.norm(to_camera, axis=1)
    width = np.min(np.diff(targets.radii, prepend=0.0)) * scene.camera.fx / distance * to_camera[:, 2] / distance
    return inside & (width > _MIN_RING_PX), cam


def _in_picture(points: Array, camera: InteriorOrientation) -> NDArray[np.bool_]:
    """Points in `cam`, (n, 3), that the lens maps into the picture with some margin, (n,)."""
    uv, _ = project(points, camera)
    xy = points[:, :2] / points[:, 2:]
    reached = np.sum(xy * xy, axis=1) < 0.9 * camera.fold_r2
    border = np.array([camera.width, camera.height]) - 1.0 - _BORDER_MARGIN_PX
    return reached & np.all((uv > _BORDER_MARGIN_PX) & (uv < border), axis=1) & (points[:, 2] > 0.0)


# ---- before the board ----


def board_stations(camera: InteriorOrientation, n: int, rng: np.random.Generator) -> tuple[Pose, ...]:
    """Return poses for `n` photos of the whole board. Together they fill the picture, with tilts in all directions.

    Of many random hand-held poses, each photo takes the one with most corners in regions with few corners so far.
    Raises ConfigurationError if the board does not fit into the picture.
    """
    filled = np.zeros((_CELLS[1], _CELLS[0]))  # photos with a corner in each cell of the picture
    found: list[Pose] = []
    for k in range(n):
        view = _TILTS[k % len(_TILTS)], _GOLDEN_ANGLE_DEG * k, _BOARD_ROLLS[k % len(_BOARD_ROLLS)]
        kept = [pose for _ in range(_CANDIDATE_POSES) if (pose := _before_board(camera, view, rng))]
        if not kept:
            raise ConfigurationError(
                f"--focal {camera.fx:g}: the board does not fit into the picture anywhere in the room; take a shorter "
                "focal length"
            )
        cells = np.zeros((len(kept), *filled.shape))
        for mine, pose in zip(cells, kept, strict=True):
            uv, _ = project(pose.to_cam(board.corners()), camera)
            column, row = np.floor(uv / (camera.width, camera.height) * _CELLS).astype(int).T
            mine[row, column] = 1.0
        best = int(np.argmax(np.sum(cells / (1.0 + filled), axis=(1, 2))))
        found.append(kept[best])
        filled += cells[best]
    return tuple(found)


def _before_board(
    camera: InteriorOrientation, view: tuple[float, float, float], rng: np.random.Generator
) -> Pose | None:
    """Return a pose with the board anywhere in the picture, or None if it is not whole.

    `view`: how much the board is tilted, in which direction, and turned in the picture, deg.
    """
    tilt, towards, turn = np.radians([view[0] + rng.normal(0.0, 2.0), view[1] + rng.normal(0.0, 10.0), view[2]])
    direction = np.array([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), np.cos(tilt)])
    picture = np.array([camera.width / camera.fx, camera.height / camera.fy])  # its size at unit distance
    reach = rng.uniform(0.8, 2.0) * np.max(board.SIZE / picture)
    pose = looking(board.MIDDLE + reach * direction, board.MIDDLE, turn + rng.normal(0.0, 0.1))
    # turned about the projection centre, so that the board's middle is seen elsewhere
    x, y = rng.uniform(-0.4, 0.4, 2) * picture
    pose = Pose(pose.rotation @ exp(np.array([y, -x, 0.0])), pose.position)
    whole = np.all(_in_picture(pose.to_cam(board.outline(0.5 * board.SQUARE)), camera))
    return pose if whole and _in_room(pose) else None


# ---- the photos ----

_LENS_SIGMA_PX = 0.5  # px, standard deviation of a lens in focus
_REFERENCE = (1920, 1080, 1404.0)  # px: width, height and focal length of a wide webcam
_OFF_MIDDLE = (7.0, -5.0)  # px at that size, the principal point
_DISCS = 50
_BOLT_OVER_DISC = 0.525  # radii of a disc: as in the reference recordings


@dataclass(frozen=True, slots=True)
class Stills:
    """Everything that `photos` needs."""

    scene: Scene  # with the pose of the first photo; `ball` equals `obj`
    device_poses: tuple[Pose, ...]
    board_poses: tuple[Pose, ...]  # in the board's room
    noise: float  # grey values
    seed: int


class Photo(NamedTuple):
    name: str  # in its folder: device/device_0 or board/chess_00, without ending
    image: NDArray[np.uint8]  # (h, w, 3) blue, green, red


def prepare_stills(options: StillsOptions, device: tuple[Rig, Array] | None = None) -> Stills:
    """Return device, lens and camera places. Raise ConfigurationError if no picture is possible with the options.

    `device` is the one to photograph, with unit vectors (n, 3), obj, to its discs; None: the default one.
    """
    rng = np.random.default_rng([options.seed, 3])
    scene = _scene(options, device)
    stations = device_stations(scene, options.photos, rng)
    boards = board_stations(scene.camera, options.boards, rng)
    scene = replace(scene, pose=stations[0]) if stations else scene
    return Stills(scene, stations, boards, options.noise, options.seed)


def photos(stills: Stills) -> Iterator[Photo]:
    """All pictures, those of the device first."""
    rng = np.random.default_rng([stills.seed, 4])
    places = [(f"device/device_{k}", device_picture, pose) for k, pose in enumerate(stills.device_poses)]
    places += [(f"board/chess_{k:02d}", board.render_board, pose) for k, pose in enumerate(stills.board_poses)]
    for name, render, pose in places:
        sharp = render(replace(stills.scene, pose=pose))
        blurred = np.asarray(cv2.GaussianBlur(sharp, (0, 0), _LENS_SIGMA_PX), dtype=np.float32)
        yield Photo(name, expose(blurred, stills.noise, rng))


def device_picture(scene: Scene) -> NDArray[np.float32]:
    """The scene with the ball at rest, (h, w, 3) grey values, before lens blur and noise."""
    return Renderer(scene).picture(still(), 0.0, np.zeros(3))[0]


def truth_of(stills: Stills) -> dict[str, Any]:
    """Content of truth.json: camera, device and device poses (T_obj_cam), all in `obj`."""
    scene, known = stills.scene, device_description(stills.scene.rig())
    return {
        "made_by": "spheremouse calibrate practice",
        **{key: known[key] for key in ("width", "height", "camera", "disc_radius", "target_radii", "targets")},
        "board": {"inner_corners": [board.COLUMNS, board.ROWS], "square": board.SQUARE},
        "ball": {"radius": scene.ball_radius, "center": [0, 0, 0]},
        "discs_obj": (scene.ball_radius * scene.disc_directions).tolist(),
        "device_poses": {f"device_{k}": pose.matrix().tolist() for k, pose in enumerate(stills.device_poses)},
    }


def _scene(options: StillsOptions, device: tuple[Rig, Array] | None) -> Scene:
    """Return the scene of the photos: camera, ball and device by the options."""
    width, height = options.size
    # The diagonal sets the scale: the lens folds in the outermost corners, as far out at every aspect ratio.
    scale = math.hypot(width, height) / math.hypot(_REFERENCE[0], _REFERENCE[1])
    focal = _REFERENCE[2] * scale if options.focal is None else options.focal
    cx, cy = 0.5 * width + _OFF_MIDDLE[0] * scale, 0.5 * height + _OFF_MIDDLE[1] * scale
    camera = InteriorOrientation(width, height, focal, focal, cx, cy, np.array(options.dist, dtype=float))
    discs = _DISCS if options.discs is None else options.discs
    try:
        scene = replace(default_scene(discs if device is None else 1, seed=options.seed), camera=camera)
    except ValueError as e:
        raise ConfigurationError(f"--discs: {e}") from None
    if device is None:
        return scene
    rig, directions = device
    radius = rig.disc_radius or scene.disc_radius
    return replace(
        scene,
        ball_radius=rig.ball.radius,
        disc_directions=directions,
        disc_radius=radius,
        targets=rig.targets,
        surroundings=(*frame(rig.targets, _BOLT_OVER_DISC * radius), *room()),
        lighting=Lighting(LAMPS, STRIPS, rig.ball.radius),
    )
