"""Frames of a hand-held ball or a ball on a robot: moving objects painted over a background that is drawn once.

Light is mixed linearly, blurred as by a lens, then converted to grey values. Sensor noise is added last.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, project
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.layers import Layer, lay, window
from spheremouse.simulate.light import develop, expose
from spheremouse.simulate.wand.ball import WandLight, disc_paints, paint_ball
from spheremouse.simulate.wand.path import R_CAM_WORLD, WandPath
from spheremouse.simulate.wand.room import Passing, background, card, hand_at, held, robot
from spheremouse.wand.ball import WandBall

_LENS_SIGMA_PX = 0.45  # px, standard deviation of a lens in focus
_BLUR_MARGIN_PX = 3  # px around moving objects, for that blur
_MAX_MOMENTS = 16  # of an exposure


@dataclass(frozen=True, slots=True)
class Carried:
    """A ball, its path, and the robot or hand that carries it."""

    ball: WandBall
    path: WandPath
    carrier: Literal["robot", "stick", "nothing"]


@dataclass(frozen=True, slots=True)
class WandScene:
    """The contents of the camera's view."""

    camera: InteriorOrientation
    balls: tuple[Carried, ...]
    light: WandLight
    outdoors: bool = False
    clutter: bool = True  # red mug and blue book
    exposure_s: float = 0.0
    noise: float = 0.0  # grey values
    hands: tuple[Passing, ...] = ()
    cards: tuple[Passing, ...] = ()
    seed: int = 0  # of background, paints and noise
    vary: float = 0.0  # share by which paints differ from their nominal values


def indoor_light() -> WandLight:
    """Return lamps at the ceiling and a window at the right."""
    towards = np.array([[-0.35, -0.85, -0.45], [0.75, -0.35, -0.55]])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    power = np.array([[0.44, 0.47, 0.50], [0.22, 0.20, 0.19]])
    above, below = np.array([[0.52, 0.54, 0.56], [0.30, 0.33, 0.36]])
    return WandLight(towards @ R_CAM_WORLD.T, power, above, below, gloss=0.25, polish=60.0)


def outdoor_light(rng: np.random.Generator) -> WandLight:
    """Sun on the camera's side, 30 to 60 degrees high: bright, with glare on the ball; blue light from the sky."""
    high, side = np.radians(rng.uniform(30.0, 60.0)), np.radians(rng.uniform(-60.0, 60.0))
    sun = np.array([[np.sin(side) * np.cos(high), -np.sin(high), -np.cos(side) * np.cos(high)]])
    above, below = np.array([[0.42, 0.36, 0.32], [0.14, 0.22, 0.20]])
    return WandLight(sun @ R_CAM_WORLD.T, np.array([[0.95, 1.08, 1.15]]), above, below, gloss=2.5, polish=45.0)


class WandRenderer:
    """Renders frames of one scene. The constructor takes a second or two, a frame some milliseconds."""

    def __init__(self, scene: WandScene) -> None:
        self.scene = scene
        rng = np.random.default_rng([scene.seed, 11])
        self._still = background(scene.camera, scene.outdoors, scene.clutter, rng)
        self._grey = _develop(self._still)
        self._brightness = float(np.mean(scene.light.above + 0.5 * scene.light.power.sum(axis=0)))
        self._paints = [_vary(disc_paints(b.ball), scene.vary, rng) for b in scene.balls]

    def picture(self, t: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The picture of time `t` (s, mid-exposure), (h, w, 3) blue, green, red."""
        grey = self._grey
        if layers := self._layers(t):
            left, top, right, bottom = np.array([layer.window for layer in layers]).T
            ends = np.array([[left.min(), top.min()], [right.max() - 1, bottom.max() - 1]])
            near, around = (window(ends, k * _BLUR_MARGIN_PX, self.scene.camera) for k in (1, 2))
            rows, columns = (
                slice(a - b, c - b) for a, b, c in zip(near[1::-1], around[1::-1], near[:1:-1], strict=True)
            )
            light, grey = self._still[around.slices].copy(), grey.copy()
            for layer in layers:
                lay(light, layer, around[:2])
            grey[near.slices] = _develop(light)[rows, columns]
        return expose(grey, self.scene.noise, rng)

    def _layers(self, t: float) -> list[Layer]:
        """Return the layers of the moving objects at the mid-exposure `t`, s, farther centres first.

        A ball and its carrier stay together. A ball is painted at as many moments of the exposure as its motion needs,
        its carrier at the middle one. Objects out of view give no layer.
        """
        found: list[tuple[float, list[Layer | None]]] = []
        scene, camera, light = self.scene, self.scene.camera, self._brightness
        for carried, paints in zip(scene.balls, self._paints, strict=True):
            moments = list(zip(*carried.path.pose(self._moments(carried, t)), strict=True))
            c, R = moments[len(moments) // 2]
            group = [paint_ball(carried.ball, paints, moments, camera, scene.light)]
            if carried.carrier == "robot":
                group = [*robot(c, R, camera, light), *group]
            elif carried.carrier == "stick":
                stick_and_hand = held(c, R, carried.ball.radius, camera, light)
                pole_faces_camera = R[2, 2] < 0.0  # the upper one; the hand is below the lower pole
                group = [*stick_and_hand, *group] if pole_faces_camera else [*group, *stick_and_hand]
            found.append((float(c[2]), group))
        for passing in scene.hands:
            if (place := passing.at(t)) is not None:
                found.append((place[2], [hand_at(place, passing.velocity, camera, light)]))
        for passing in scene.cards:
            if (place := passing.at(t)) is not None:
                found.append((place[2], [card(place, scene.balls[0].ball.colours, camera, light)]))
        found.sort(key=lambda item: -item[0])
        return [layer for _, group in found for layer in group if layer is not None]

    def _moments(self, carried: Carried, t: float) -> Array:
        """Times within the exposure, an odd number, so near that the ball moves by half a pixel in between."""
        exposure = self.scene.exposure_s
        if exposure == 0.0:
            return np.array([t])
        centres, rotations = carried.path.pose(t + exposure * np.array([-0.5, 0.0, 0.5]))
        uv = project(centres, self.scene.camera)[0]
        shift = float(np.max(np.linalg.norm(np.diff(uv, axis=0), axis=1)))
        across = self.scene.camera.fx * carried.ball.radius / max(float(centres[1, 2]), 0.1)
        turn = across * float(np.max(np.linalg.norm(rotations[1:] - rotations[:-1], axis=(1, 2)))) / np.sqrt(2.0)
        needed = np.nan_to_num(4.0 * (shift + turn), nan=1.0)
        n = 2 * int(np.clip(np.ceil(0.5 * needed), 0, _MAX_MOMENTS // 2)) + 1
        return t + exposure * ((np.arange(n) + 0.5) / n - 0.5)


def _vary(paints: Array, share: float, rng: np.random.Generator) -> Array:
    """Return varied paints, the same for each colour of a ball."""
    if share == 0.0:
        return paints
    kinds, which = np.unique(paints, axis=0, return_inverse=True)
    factors = 1.0 + share * rng.uniform(-1.0, 1.0, kinds.shape)
    return np.clip(kinds * factors, 0.0, 0.95)[which.ravel()]


def _develop(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the grey values of light behind the lens."""
    return develop(np.asarray(cv2.GaussianBlur(light, (0, 0), _LENS_SIGMA_PX), dtype=np.float32))
