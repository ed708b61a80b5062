"""A simulated calibration evening: photos of a device and of a chessboard, with the truth behind them.

`StillsOptions` says what is photographed, `prepare_stills` puts up device, lens and tripod, `photos` takes the
pictures one by one. The device stands still; the hand-held camera goes round it, as far as the targets let it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.rig import Targets
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import render_backdrop
from spheremouse.simulate.ball.board import Board, render_board
from spheremouse.simulate.ball.caps import Caps
from spheremouse.simulate.ball.furniture import LAMPS, STRIPS, frame, room
from spheremouse.simulate.ball.options import StillsOptions
from spheremouse.simulate.ball.scene import Scene, default_scene
from spheremouse.simulate.ball.stations import board_stations, device_stations
from spheremouse.simulate.light import Lighting

_BLUR = 0.5  # px, standard deviation of a lens in focus
_REFERENCE = (1920, 1080, 1404.0)  # px: width, height and focal length of a wide webcam
_OFF_MIDDLE = (7.0, -5.0)  # px at that size, the principal point
_DISCS = 50
_BOLT = 0.525  # radii of a disc: as in the reference recordings


@dataclass(frozen=True, slots=True)
class DeviceShape:
    """A device that is to be photographed in place of the default one."""

    ball_radius: float  # m
    disc_radius: float  # m, along the ball's surface
    targets: Targets
    directions: Array  # (n, 3) unit vectors to the discs, obj: the ball lies still


@dataclass(frozen=True, slots=True)
class Stills:
    """Everything that `photos` needs."""

    scene: Scene  # with the pose of the first photo; `ball` equals `obj`
    device_poses: tuple[Pose, ...]
    board: Board
    board_poses: tuple[Pose, ...]  # in the board's room
    noise: float  # grey values
    seed: int


class Photo(NamedTuple):
    """One picture."""

    name: str  # in its folder: device/device_0 or board/chess_00, without ending
    image: NDArray[np.uint8]  # (h, w, 3) blue, green, red
    pose: Pose  # of the camera, obj


def prepare_stills(options: StillsOptions, device: DeviceShape | None = None) -> Stills:
    """Device, lens and places of the camera; ConfigurationError where the options leave no picture to take."""
    rng = np.random.default_rng([options.seed, 3])
    scene = _scene(options, device)
    stations = device_stations(scene, options.photos, rng)
    boards = board_stations(Board(), scene.camera, options.boards, rng)
    return Stills(
        replace(scene, pose=stations[0] if stations else scene.pose),
        stations,
        Board(),
        boards,
        options.noise,
        options.seed,
    )


def photos(stills: Stills) -> Iterator[Photo]:
    """All pictures, those of the device first."""
    rng = np.random.default_rng([stills.seed, 4])
    for k, pose in enumerate(stills.device_poses):
        picture = device_picture(replace(stills.scene, pose=pose))
        yield Photo(f"device/device_{k}", _exposed(picture, stills.noise, rng), pose)
    for k, pose in enumerate(stills.board_poses):
        picture = render_board(stills.board, stills.scene, pose)
        yield Photo(f"board/chess_{k:02d}", _exposed(picture, stills.noise, rng), pose)


def device_picture(scene: Scene) -> NDArray[np.float32]:
    """The scene with the ball at rest, (h, w, 3) grey values, before lens blur and noise."""
    backdrop = render_backdrop(scene)
    covered = Caps(scene).coverage(lambda times: np.broadcast_to(np.eye(3), (len(times), 3, 3)), 0.0)
    share = np.bincount(covered.pixel, covered.share, backdrop.ball.size).reshape(backdrop.ball.shape)
    picture = backdrop.white
    picture += np.minimum(share, 1.0).astype(np.float32)[..., None] * (backdrop.black - backdrop.white)
    return picture


def truth_of(stills: Stills) -> dict[str, Any]:
    """Content of truth.json: camera, device and device poses (T_obj_cam), all in `obj`."""
    scene, camera = stills.scene, stills.scene.camera
    return {
        "made_by": "spheremouse calibrate practice",
        "width": camera.width,
        "height": camera.height,
        "camera": {
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "dist": camera.distortion.tolist(),
        },
        "board": {"inner_corners": [stills.board.columns, stills.board.rows], "square": stills.board.square},
        "ball": {"radius": scene.ball_radius, "center": [0, 0, 0]},
        "disc_radius": scene.disc_radius,
        "target_radii": scene.targets.radii.tolist(),
        "targets": [
            {"id": i, "code": code, "position": position.tolist()}
            for i, code, position in zip(scene.targets.ids, scene.targets.codes, scene.targets.position, strict=True)
        ],
        "discs_obj": (scene.ball_radius * scene.disc_directions).tolist(),
        "device_poses": {f"device_{k}": pose.matrix().tolist() for k, pose in enumerate(stills.device_poses)},
    }


# ---- the scene ----


def _scene(options: StillsOptions, device: DeviceShape | None) -> Scene:
    width, height = options.size
    scale = min(max(width, height) / _REFERENCE[0], min(width, height) / _REFERENCE[1])
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
    return replace(
        scene,
        ball_radius=device.ball_radius,
        disc_directions=device.directions,
        disc_radius=device.disc_radius,
        targets=device.targets,
        surroundings=(*frame(device.targets, _BOLT * device.disc_radius), *room()),
        lighting=Lighting(LAMPS, STRIPS, device.ball_radius),
    )


# ---- the picture ----


def _exposed(picture: NDArray[np.float32], noise: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Through the lens' blur, with noise, in bytes."""
    blurred = np.asarray(cv2.GaussianBlur(picture, (0, 0), _BLUR), dtype=np.float32)
    if noise > 0.0:
        blurred += np.float32(noise) * rng.standard_normal(blurred.shape, dtype=np.float32)
    return np.clip(np.rint(blurred), 0.0, 255.0).astype(np.uint8)
