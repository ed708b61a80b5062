"""A ball away from its place, as when it is lifted off its bearings: its picture is shifted, the rest stays.

The ball alone, the room without it and what stands before it are rendered once. The ball's picture then follows its
outline, by a shift and a scale: shade and gloss travel with it, which no truth depends on. Discs are not in these
pictures; `caps` puts them exactly where they are.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import reduced_to_pixel, unproject
from spheremouse.geometry.conics import project_sphere
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import Backdrop, render_backdrop
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.shapes import look


class Layers(NamedTuple):
    """Layers of a picture of the ball in any place; grey values 0..255, blue, green, red."""

    scene: Scene
    alone: Backdrop  # the ball and nothing else: white and black are 0 beside it
    room: NDArray[np.float32]  # (h, w, 3) everything but the ball
    front: NDArray[np.float32]  # (h, w, 1) share of each pixel that stands before the ball
    painted: NDArray[np.float32]  # (h, w, 3) what stands there, times that share

    def backdrop(self, centre: Array) -> Backdrop:
        """With the ball's centre at (3,) m in obj."""
        h, w = self.front.shape[:2]
        M = self._shift(centre)
        white, black, outline = (
            np.asarray(cv2.warpAffine(image, M, (w, h)), dtype=np.float32)
            for image in (self.alone.white, self.alone.black, self.alone.outline)
        )
        behind = np.float32(1.0) - self.front
        rest = self.painted + behind * (np.float32(1.0) - outline[..., None]) * self.room
        return Backdrop(
            _single(rest + behind * white), _single(rest + behind * black), behind[..., 0] * outline, outline
        )

    def _shift(self, centre: Array) -> Array:
        """The affine map of the image, (2, 3), that takes the ball's outline to where it is from `centre`."""
        scene = self.scene
        here, there = (project_sphere(scene.pose.to_cam(c), scene.ball_radius) for c in (np.zeros(3), centre))
        scale = float((np.linalg.det(there[1]) / np.linalg.det(here[1])) ** 0.25)
        uv, _ = reduced_to_pixel(np.array([here[0], there[0]]), scene.camera)
        return np.column_stack([scale * np.eye(2), uv[1] - scale * uv[0]])


def _single(image: NDArray[np.floating]) -> NDArray[np.float32]:
    return image.astype(np.float32, copy=False)


def render_layers(scene: Scene, backdrop: Backdrop) -> Layers:
    """Render the parts of a scene that `backdrop` shows together."""
    alone = render_backdrop(replace(scene, surroundings=()))
    room = render_backdrop(scene, ball=False).white
    h, w = alone.outline.shape
    inside = alone.outline > 0.99
    front = np.where(inside, 1.0 - backdrop.ball / np.maximum(alone.outline, 1e-3), _before(scene, h, w))[..., None]
    painted = np.where(inside[..., None], backdrop.white - (1.0 - front) * alone.white, front * room)
    return Layers(scene, alone, room, front.astype(np.float32), painted.astype(np.float32))


def _before(scene: Scene, h: int, w: int) -> NDArray[np.float64]:
    """1 where something is nearer than the ball's limb, (h, w), else 0."""
    v, u = np.mgrid[0:h, 0:w]
    xy, _ = unproject(np.stack([u.ravel(), v.ravel()], axis=1).astype(float), scene.camera)
    _, depth = look(scene.surroundings, scene.pose.position, scene.pose.rotation).cast(xy.reshape(h, w, 2))
    distance = np.linalg.norm(scene.pose.position)
    limb = scene.pose.to_cam(scene.pose.position * (scene.ball_radius / distance) ** 2)
    return (depth < limb[2]).astype(float)
