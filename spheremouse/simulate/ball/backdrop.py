"""Constant parts of all frames, rendered once: the scene with a plain ball, and with one that is all disc.

A frame is a mixture of the two, weighted by the fraction of each pixel that the discs cover. If the ball leaves its
place, for example lifted off its bearings, three layers are combined: the ball alone, the room without it, and the
objects before it. The ball's picture then follows its outline by an affine map. Shade and gloss move with it; no truth
depends on them. These pictures have no discs. `surface` adds the discs at their exact places.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import ellipse_to_pixel, project_sphere, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.layers import Window
from spheremouse.simulate.light import develop
from spheremouse.simulate.shapes import Face, Viewpoint, pixel_parts

_RAYS_ACROSS_PIXEL = 6  # rays across a pixel where shapes meet
_TILE_PX = 16  # px, of bundles of rays
_IDS_PER_SHAPE = 256  # stripes per shape, as in shapes


@dataclass(frozen=True, slots=True)
class Backdrop:
    """Grey values 0..255, blue, green, red."""

    white: NDArray[np.float32]  # (h, w, 3) with a ball without discs (white, unless the scene has another colour)
    black: NDArray[np.float32]  # (h, w, 3) with a ball that is one big disc
    ball: NDArray[np.float32]  # (h, w) share of each pixel that shows the ball
    outline: NDArray[np.float32]  # (h, w) the same with nothing in front of it


def render_backdrop(scene: Scene, *, ball: bool = True) -> Backdrop:
    """Cast a ray per pixel, and many rays at borders of shapes. Without `ball`, all but the ball is there."""
    h, w = scene.camera.height, scene.camera.width
    uv = Window(0, 0, w, h).pixels().reshape(-1, 2)
    xy, dxy_duv = np.empty((h * w, 2)), np.empty((h * w, 2, 2))
    for part in _parts(np.arange(h * w), 10_000):  # a part with no way back through the lens takes long
        xy[part], dxy_duv[part] = unproject(uv[part], scene.camera)
    view, alone = (s.viewpoint(ball=ball) for s in (scene, replace(scene, surroundings=())))
    ids, outline = np.empty(h * w, dtype=np.int64), np.empty(h * w)
    white, black = np.empty((h * w, 3)), np.empty((h * w, 3))
    # square tiles, of which those on the right and lower border may repeat pixels
    rows, columns = (np.minimum(np.arange(0, n, _TILE_PX)[:, None] + np.arange(_TILE_PX), n - 1) for n in (h, w))
    every = (rows[:, None, :, None] * w + columns[None, :, None, :]).reshape(-1, _TILE_PX**2)
    for tiles in _parts(every, 64):
        ids[tiles], depth = _intersect(view, xy[tiles])
        outline[tiles] = alone.cast(xy[tiles])[0] == 0
        flat = tiles.ravel()
        white[flat], black[flat] = _colours(scene, view, xy[flat], ids[flat], depth.ravel())
    shown = (ids == 0).astype(float)
    edge = np.flatnonzero((_borders(ids.reshape(h, w)) | _borders(outline.reshape(h, w))).ravel())
    for part in _parts(edge, 2000):
        fine = xy[part, None] + pixel_parts(_RAYS_ACROSS_PIXEL) @ dxy_duv[part].transpose(0, 2, 1)
        fine_ids, depth = _intersect(view, fine)
        outline[part] = (alone.cast(fine)[0] == 0).mean(axis=1)
        shown[part] = (fine_ids == 0).mean(axis=1)
        white[part], black[part] = _mix(scene, view, fine, fine_ids, depth)
    return Backdrop(*(x.reshape(h, w, *x.shape[1:]).astype(np.float32) for x in (white, black, shown, outline)))


def _parts(index: NDArray[np.intp], size: int) -> list[NDArray[np.intp]]:
    """Pieces of about `size` rows: small arrays stay in the processor's cache."""
    return np.array_split(index, max(1, len(index) // size))


def _intersect(view: Viewpoint, xy: Array) -> tuple[NDArray[np.int64], Array]:
    """Return shape * _IDS_PER_SHAPE + stripe, or < 0, and z in cam, m, that bundles of rays hit, (m, k) each."""
    first, depth = view.cast(xy)
    ids = first * _IDS_PER_SHAPE
    for index, shape in enumerate(view.shapes):
        if isinstance(shape, Face) and shape.stripes > 0.0:
            on = first == index
            ids[on] += shape.stripe(view.pose.position + depth[on][:, None] * view.rays(xy[on]))
    return ids, depth


def _mix(scene: Scene, view: Viewpoint, xy: Array, ids: NDArray[np.int64], depth: Array) -> tuple[Array, Array]:
    """Return the grey values of n pixels, (n, 3), with a white and with a black ball, from k rays each, (n, k).

    Each shape has one colour in a pixel: the colour at the mean of its visible points.
    """
    base = (len(view.shapes) + 1) * _IDS_PER_SHAPE
    key = np.arange(len(xy))[:, None] * base + ids + _IDS_PER_SHAPE
    pairs, group, count = np.unique(key, return_inverse=True, return_counts=True)
    group = group.ravel()
    place = np.concatenate([xy, np.nan_to_num(depth, posinf=0.0)[..., None]], axis=2).reshape(-1, 3)
    mean = np.stack([np.bincount(group, place[:, i]) / count for i in range(3)], axis=1)
    colours = _colours(scene, view, mean[:, :2], pairs % base - _IDS_PER_SHAPE, mean[:, 2])
    pixel, share = pairs // base, (count / xy.shape[1])[:, None]
    white, black = (
        np.array([np.bincount(pixel, column, len(xy)) for column in (share * colour).T], dtype=float).T
        for colour in colours
    )
    return white, black


def _colours(scene: Scene, view: Viewpoint, xy: Array, ids: NDArray[np.int64], depth: Array) -> tuple[Array, Array]:
    """Return the grey values at rays, (n, 3), with a white and with a black ball. A ray that hits nothing is black."""
    light, gloss, albedo = np.zeros((3, len(xy), 3))
    points = view.pose.position + np.nan_to_num(depth, posinf=0.0)[:, None] * view.rays(xy)
    on_ball, on_room = np.flatnonzero(ids == 0), np.flatnonzero(ids >= _IDS_PER_SHAPE)
    if len(on_ball):
        at = points[on_ball]
        at *= scene.ball_radius / np.linalg.norm(at, axis=1, keepdims=True)
        light[on_ball] = scene.lighting.on_ball(at)
        gloss[on_ball] = scene.lighting.gloss(at, view.pose.position)
    if len(on_room):
        at, index, stripe = points[on_room], ids[on_room] // _IDS_PER_SHAPE, ids[on_room] % _IDS_PER_SHAPE
        normals = np.empty_like(at)  # on either side
        for i in np.unique(index):
            normals[index == i] = view.shapes[i].normal(at[index == i])
        normals *= np.where(np.sum(normals * (view.pose.position - at), axis=1) < 0.0, -1.0, 1.0)[:, None]
        light[on_room] = scene.lighting.on_room(at, normals)
        tone = 1.0 + 0.16 * np.sin(2.4 * stripe + 0.8) * np.sin(0.7 * stripe)
        albedo[on_room] = np.array([shape.colour for shape in view.shapes])[index] * tone[:, None]
    black, white = albedo.copy(), albedo
    black[on_ball], white[on_ball] = scene.disc_colour, scene.ball_colour
    return develop(white * light + gloss), develop(black * light + gloss)


def _borders(ids: NDArray[np.int64] | Array) -> NDArray[np.bool_]:
    """Return a mask, (h, w), of pixels with a different neighbour, and of those above and below them."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    border = np.asarray(cv2.morphologyEx(ids.astype(np.float32), cv2.MORPH_GRADIENT, cross)) > 0.0
    return np.asarray(cv2.dilate(border.astype(np.uint8), np.ones((3, 1), dtype=np.uint8))) > 0


class Layers(NamedTuple):
    """Layers of a picture of the ball in any place; grey values 0..255, blue, green, red."""

    scene: Scene
    alone: Backdrop  # the ball and nothing else: white and black are 0 beside it
    room: NDArray[np.float32]  # (h, w, 3) everything but the ball
    front: NDArray[np.float32]  # (h, w, 1) fraction of each pixel with objects before the ball
    painted: NDArray[np.float32]  # (h, w, 3) these objects, times that fraction

    def backdrop(self, centre: Array) -> Backdrop:
        """With the ball's centre at (3,) m in obj."""
        scene, (h, w) = self.scene, self.front.shape[:2]
        here, there = (project_sphere(scene.pose.to_cam(c), scene.ball_radius) for c in (np.zeros(3), centre))
        uv, shapes = ellipse_to_pixel(np.array([here[0], there[0]]), np.array([here[1], there[1]]), scene.camera)
        A = _root(shapes[1]) @ np.linalg.inv(_root(shapes[0]))  # maps the ball's ellipse onto that in its place
        M = np.column_stack([A, uv[1] - A @ uv[0]])
        white, black, outline = (
            np.asarray(cv2.warpAffine(image, M, (w, h)), dtype=np.float32)
            for image in (self.alone.white, self.alone.black, self.alone.outline)
        )
        behind = np.float32(1.0) - self.front
        rest = self.painted + behind * (np.float32(1.0) - outline[..., None]) * self.room
        pictures = (rest + behind * white, rest + behind * black, behind[..., 0] * outline, outline)
        return Backdrop(*(np.asarray(picture, dtype=np.float32) for picture in pictures))


def _root(shape: Array) -> Array:
    """Return the symmetric root of a positive definite matrix, (2, 2): it maps the unit circle onto an ellipse."""
    values, axes = np.linalg.eigh(shape)
    return axes * np.sqrt(values) @ axes.T


def render_layers(scene: Scene, backdrop: Backdrop) -> Layers:
    """Render the parts of a scene that `backdrop` shows together."""
    ball_alone = render_backdrop(replace(scene, surroundings=()))
    room = render_backdrop(scene, ball=False).white
    inside = ball_alone.outline > 0.99
    front = np.where(inside, 1.0 - backdrop.ball / np.maximum(ball_alone.outline, 1e-3), _before(scene))[..., None]
    painted = np.where(inside[..., None], backdrop.white - (1.0 - front) * ball_alone.white, front * room)
    return Layers(scene, ball_alone, room, front.astype(np.float32), painted.astype(np.float32))


def _before(scene: Scene) -> NDArray[np.bool_]:
    """Return the pixels, (h, w), with an object nearer than the ball's limb."""
    h, w = scene.camera.height, scene.camera.width
    xy, _ = unproject(Window(0, 0, w, h).pixels(), scene.camera)
    _, depth = scene.viewpoint(ball=False).cast(xy.reshape(h, w, 2))
    distance = np.linalg.norm(scene.pose.position)
    limb = scene.pose.to_cam(scene.pose.position * (scene.ball_radius / distance) ** 2)
    return depth < limb[2]
