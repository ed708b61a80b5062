"""Constant parts of all frames, rendered once: the scene with a plain ball, and with one that is all disc.

A frame is a mixture of the two, weighted by the fraction of each pixel that the discs cover. If the ball leaves its
place, for example lifted off its bearings, three layers are combined: the ball alone, the room without it, and the
objects before it. The ball's picture then follows its outline by an affine map. Shade and gloss move with it; no truth
depends on them. These pictures have no discs. `surface` adds the discs at their exact places.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import sqrtm

from spheremouse.geometry.camera import ellipse_to_pixel, project_sphere
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.cast import PARTS, Surfaces, Viewpoint
from spheremouse.simulate.layers import Window
from spheremouse.simulate.light import develop

_STRIPE = np.arange(PARTS)
_TONES = 1.0 + 0.16 * np.sin(2.4 * _STRIPE + 0.8) * np.sin(0.7 * _STRIPE)  # of the stripes of a face


@dataclass(frozen=True, slots=True)
class Backdrop:
    """Grey values 0..255, blue, green, red."""

    white: NDArray[np.float32]  # (h, w, 3) with a ball without discs (white, unless the scene has another colour)
    black: NDArray[np.float32]  # (h, w, 3) with a ball that is one big disc
    ball: NDArray[np.float32]  # (h, w) share of each pixel that shows the ball
    outline: NDArray[np.float32]  # (h, w) the same with nothing in front of it


def render_backdrop(scene: Scene, *, ball: bool = True) -> Backdrop:
    """Return the pictures of a scene. Without `ball`, all but the ball is there."""
    whole = Window(0, 0, scene.camera.width, scene.camera.height)
    view, alone = (s.viewpoint(ball=ball) for s in (scene, replace(scene, surroundings=())))
    picture = view.paint(whole, scene.camera, partial(grey_values, scene, view))
    outline = alone.paint(whole, scene.camera, lambda surfaces, _: (surfaces > 0).astype(float)[:, None])
    white, black, shown = (np.ascontiguousarray(picture[..., k]) for k in (slice(0, 3), slice(3, 6), 6))
    return Backdrop(white, black, shown, outline[..., 0])


def grey_values(scene: Scene, view: Viewpoint, surfaces: Surfaces, points: Array) -> NDArray[np.float32]:
    """Return grey values with a white and with a black ball, and 1 on the ball, (n, 7). No surface is black."""
    index, eye = surfaces // PARTS - 1, view.pose.position
    ball, room = np.flatnonzero(index == 0), np.flatnonzero(index > 0)
    out = np.zeros((len(points), 7), dtype=np.float32)
    at = points[ball]
    at *= scene.ball_radius / np.linalg.norm(at, axis=1, keepdims=True)
    light, gloss = scene.lighting.on_ball(at), scene.lighting.gloss(at, eye)
    shades = (develop(np.array(colour) * light + gloss) for colour in (scene.ball_colour, scene.disc_colour))
    out[ball] = np.column_stack([*shades, np.ones(len(ball))])
    at, index = points[room], index[room]
    normals = np.empty_like(at)  # on either side
    for i in np.unique(index):
        normals[index == i] = view.shapes[i].normal(at[index == i])
    normals *= np.where(np.sum(normals * (eye - at), axis=1) < 0.0, -1.0, 1.0)[:, None]
    tone = _TONES[surfaces[room] % PARTS]
    grey = develop(view.colours[index] * tone[:, None] * scene.lighting.on_room(at, normals))
    out[room, :3] = out[room, 3:6] = grey
    return out


class Layers(NamedTuple):
    """Layers of a picture of the ball in any place; grey values 0..255, blue, green, red."""

    scene: Scene
    alone: Backdrop  # the ball and nothing else: white and black are 0 beside it
    front: NDArray[np.float32]  # (h, w, 1) fraction of each pixel with objects before the ball
    before: NDArray[np.float32]  # (h, w, 3) these objects, times that fraction
    beside: NDArray[np.float32]  # (h, w, 3) all else but the ball, times the rest of the pixel

    def backdrop(self, centre: Array) -> Backdrop:
        """With the ball's centre at (3,) m in obj."""
        scene, (h, w) = self.scene, self.front.shape[:2]
        here, there = (project_sphere(scene.pose.to_cam(c), scene.ball_radius) for c in (np.zeros(3), centre))
        uv, shapes = ellipse_to_pixel(np.array([here[0], there[0]]), np.array([here[1], there[1]]), scene.camera)
        # symmetric roots map the unit circle onto an ellipse, so A maps the ball's ellipse onto that in its place
        A = np.real(sqrtm(shapes[1]) @ np.linalg.inv(sqrtm(shapes[0])))
        M = np.column_stack([A, uv[1] - A @ uv[0]])
        white, black, outline = (
            np.asarray(cv2.warpAffine(image, M, (w, h)), dtype=np.float32)
            for image in (self.alone.white, self.alone.black, self.alone.outline)
        )
        behind = np.float32(1.0) - self.front
        rest = self.before + (np.float32(1.0) - outline[..., None]) * self.beside
        pictures = (rest + behind * white, rest + behind * black, behind[..., 0] * outline, outline)
        return Backdrop(*(np.asarray(picture, dtype=np.float32) for picture in pictures))


def render_layers(scene: Scene) -> Layers:
    """Render the parts of a scene."""
    view, distance = scene.viewpoint(ball=False), np.linalg.norm(scene.pose.position)
    limb = scene.pose.to_cam(scene.pose.position * (scene.ball_radius / distance) ** 2)[2]

    def values(surfaces: Surfaces, points: Array) -> Array:
        """Return grey values of objects nearer than the ball's limb, those of others, and 1 on the near, (n, 7)."""
        front = ((surfaces > 0) & (scene.pose.to_cam(points)[:, 2] < limb))[:, None]
        grey = grey_values(scene, view, surfaces, points)[:, :3]
        return np.column_stack([front * grey, ~front * grey, front])

    whole = Window(0, 0, scene.camera.width, scene.camera.height)
    picture = view.paint(whole, scene.camera, values)
    before, beside, front = picture[..., :3], picture[..., 3:6], picture[..., 6:]
    return Layers(scene, render_backdrop(replace(scene, surroundings=())), front, before, beside)
