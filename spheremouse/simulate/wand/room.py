"""Surroundings of a wand: floor, wall and objects in a room or outdoors, drawn once, and moving objects.

Flat faces, farther ones first, drawn finely and averaged down. A red mug and a blue book stand in every room (the
single-coloured things that Grzonka 2005, section 4.3, found harmless). Nothing here is known to a tracker.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from spheremouse.geometry.camera import InteriorOrientation, project, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.light import reflectance
from spheremouse.simulate.shapes import Colour, Face, box, post
from spheremouse.simulate.wand.ball import Layer
from spheremouse.simulate.wand.path import CAMERA_HEIGHT, world_to_cam

_FINE = 4  # subpixels across a pixel where things are drawn
_SHIFT = 4  # bits of the fixed point numbers that OpenCV draws with
_NEAR = 0.05  # m, what is nearer to the camera's plane is not drawn
_TILE, _PER_METRE = 1024, 256  # px of the floor's texture, and per m
_WALL = 6.2  # m, world z
_LAMP = np.array([-0.3, -0.85, -0.43])  # towards the light, world

_LINES = (0.15, 0.10, 0.004)  # m: between lines across and along the field (Grzonka 2005, fig. 9), and their width


def paint_faces(faces: Sequence[tuple[Array, Colour]], camera: InteriorOrientation, margin: int = 1) -> Layer | None:
    """Polygons in `cam`, (k, 3) m, with their light (blue, green, red; linear), the first ones behind the others."""
    outlines, colours = [], []
    for corners, colour in faces:
        if np.all(corners[:, 2] > _NEAR):
            outlines.append(project(corners, camera)[0])
            colours.append(colour)
    if not outlines or not all(np.all(np.isfinite(o)) for o in outlines):
        return None
    every = np.concatenate(outlines)
    low = np.clip(np.floor(every.min(axis=0)).astype(int) - margin, 0, (camera.width, camera.height))
    high = np.clip(np.ceil(every.max(axis=0)).astype(int) + margin + 1, 0, (camera.width, camera.height))
    if np.any(high <= low):
        return None
    w, h = (high - low).tolist()
    drawn = np.zeros((h * _FINE, w * _FINE), dtype=np.uint8)
    for index, outline in enumerate(outlines, start=1):
        fine = (outline - low + 0.5) * _FINE - 0.5
        cv2.fillPoly(drawn, [np.rint(fine * (1 << _SHIFT)).astype(np.int32)], (index,), shift=_SHIFT)
    lights = np.zeros((len(colours) + 1, 4), dtype=np.float32)
    lights[1:, :3], lights[1:, 3] = colours, 1.0
    return Layer((int(low[0]), int(low[1])), _averaged(drawn, lights, w, h))


def _averaged(drawn: NDArray[np.uint8], lights: NDArray[np.float32], w: int, h: int) -> NDArray[np.float32]:
    """Paint of the colours that subpixels name, (h, w, 4): by table where a pixel is all one colour."""
    cells = drawn.reshape(h, _FINE, w, _FINE).transpose(0, 2, 1, 3)
    first = drawn[::_FINE, ::_FINE]
    mixed = cv2.resize(drawn, (w, h), interpolation=cv2.INTER_AREA) != first
    mixed |= drawn[_FINE - 1 :: _FINE, _FINE - 1 :: _FINE] != first
    paint = lights[first]
    paint[mixed] = lights[cells[mixed]].mean(axis=(1, 2))
    return paint


# ---- what stands still ----


def background(
    camera: InteriorOrientation, outdoors: bool, clutter: bool, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Everything but what moves, (h, w, 3) linear light."""
    picture = _ground(camera, outdoors, rng)
    things = _outdoors(rng) if outdoors else _indoors(rng)
    things += _lines()
    if clutter:
        things += _mug_and_book(rng)
    R = world_to_cam()
    for thing in things:  # one by one: a thing hides what is behind it
        layer = paint_faces([(f.corners @ R.T, _lit(f)) for f in _visible(thing)], camera)
        if layer is not None:
            lay(picture, layer)
    return picture


def lay(picture: NDArray[np.float32], layer: Layer, origin: tuple[int, int] = (0, 0)) -> None:
    """Paint a layer over a part of the picture whose first pixel is at `origin`, as far as it reaches."""
    x, y = layer.place[0] - origin[0], layer.place[1] - origin[1]
    h, w = layer.paint.shape[:2]
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + w, picture.shape[1]), min(y + h, picture.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    paint = layer.paint[y0 - y : y1 - y, x0 - x : x1 - x]
    part = picture[y0:y1, x0:x1]
    part *= 1.0 - paint[..., 3:]
    part += paint[..., :3]


def _ground(camera: InteriorOrientation, outdoors: bool, rng: np.random.Generator) -> NDArray[np.float32]:
    """Floor and wall, or lawn and sky, with some texture."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    xy, _ = unproject(np.stack([u.ravel(), v.ravel()], axis=1).astype(float), camera)
    rays = np.column_stack([xy, np.ones(len(xy))]) @ world_to_cam()  # to world
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = CAMERA_HEIGHT / rays[:, 1]
        at = rays[:, [0, 2]] * depth[:, None]
    floor = (rays[:, 1] > 0.0) & (at[:, 1] < _WALL)
    floor = (floor & np.isfinite(at).all(axis=1)).reshape(v.shape)
    back = rays * (_WALL / rays[:, 2])[:, None]  # where the wall is met
    texture = _texture(0.35 if outdoors else 0.10, rng)
    picture = np.empty((*v.shape, 3), dtype=np.float32)
    on_floor = _mapped(texture, np.where(floor.ravel()[:, None], at, 0.0), v.shape)
    on_wall = _mapped(_texture(0.05, rng), back[:, :2] * 0.7, v.shape)
    base = np.array(reflectance((72.0, 118.0, 104.0) if outdoors else _near((186.0, 200.0, 210.0), 12.0, rng)))
    wall = np.array(reflectance((236.0, 214.0, 190.0) if outdoors else _near((160.0, 170.0, 176.0), 14.0, rng)))
    fade = np.clip(1.15 - 0.06 * np.where(floor.ravel(), at[:, 1], 0.0), 0.6, 1.2).reshape(v.shape)
    picture[:] = np.where(
        floor[..., None], (on_floor * fade)[..., None] * base, np.nan_to_num(on_wall, nan=1.0)[..., None] * wall
    )
    return picture


def _texture(depth: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """A square that repeats, about 1, with a standard deviation of `depth`."""
    fine = np.zeros((_TILE, _TILE))
    for blur in (1.5, 6.0, 40.0):
        noise = gaussian_filter(rng.standard_normal((_TILE, _TILE)), blur, mode="wrap")
        fine += noise / noise.std()
    return np.maximum(1.0 + depth * fine / fine.std(), 0.1).astype(np.float32)


def _mapped(texture: NDArray[np.float32], metres: Array, shape: tuple[int, ...]) -> NDArray[np.float32]:
    place = np.nan_to_num(metres * _PER_METRE) % (_TILE - 1)
    x, y = (place[:, k].reshape(shape).astype(np.float32) for k in (0, 1))
    return np.asarray(cv2.remap(texture, x, y, cv2.INTER_LINEAR), dtype=np.float32)


def _visible(faces: Sequence[Face]) -> list[Face]:
    """Farther ones first."""
    return sorted(faces, key=lambda f: -float(np.linalg.norm(f.corners.mean(axis=0))))


def _lit(face: Face) -> Colour:
    normal = face.normal()
    normal = normal if normal @ face.corners.mean(axis=0) < 0.0 else -normal  # towards the camera
    light = 0.60 + 0.40 * max(float(normal @ _LAMP), 0.0)
    return light * face.colour[0], light * face.colour[1], light * face.colour[2]


def _lines() -> list[list[Face]]:
    """The ruled field on the floor."""
    across, along, wide = _LINES
    colour, y = reflectance((70.0, 70.0, 70.0)), CAMERA_HEIGHT
    found = []
    for z in np.arange(3.62, 4.45, across):
        found.append(_quad(-0.72, 0.72, float(z), float(z) + wide, y, colour))
    for x in np.arange(-0.72, 0.73, along):
        found.append(_quad(float(x), float(x) + wide, 3.62, 4.42, y, colour))
    return [[f] for f in found]


def _quad(x0: float, x1: float, z0: float, z1: float, y: float, colour: Colour) -> Face:
    return Face(np.array([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]), colour)


def _indoors(rng: np.random.Generator) -> list[list[Face]]:
    """Shelves with books, a cabinet, a chair's back, boxes: along the wall, farther ones first."""
    y = CAMERA_HEIGHT
    things = [box((-9.0, y - 0.09, _WALL - 0.02), (9.0, y, _WALL), reflectance((60.0, 80.0, 100.0)))]
    left = -2.3
    while left < 2.3:
        kind = rng.choice(["cabinet", "shelf", "gap", "carton"])
        width = float(rng.uniform(0.5, 1.0))
        if kind == "cabinet":
            grey = _near((110.0, 112.0, 112.0), 25.0, rng)
            things.append(box((left, y - 1.3, 5.6), (left + width, y, 6.1), reflectance(grey)))
        elif kind == "shelf":
            wood = reflectance(_near((62.0, 88.0, 120.0), 12.0, rng))
            for board in (0.04, 0.42, 0.80):
                things.append(box((left, y - board - 0.03, 5.7), (left + width, y - board, 6.1), wood))
                at = left + 0.03
                while board < 0.7 and at < left + width - 0.08:
                    thick, tall = float(rng.uniform(0.025, 0.07)), float(rng.uniform(0.2, 0.3))
                    colour = reflectance(_any_colour(rng))
                    things.append(box((at, y - board - tall - 0.03, 5.75), (at + thick, y - board - 0.03, 6.0), colour))
                    at += thick + 0.004
        elif kind == "carton":
            high = float(rng.uniform(0.25, 0.5))
            colour = reflectance(_near((95.0, 130.0, 165.0), 12.0, rng))
            things.append(box((left, y - high, 5.3), (left + width, y, 5.7), colour, float(rng.uniform(-0.4, 0.4))))
        left += width + float(rng.uniform(0.02, 0.25))
    return things


def _outdoors(rng: np.random.Generator) -> list[list[Face]]:
    """A hedge and a wall before the sky."""
    y, things = CAMERA_HEIGHT, []
    for x in np.arange(-3.0, 3.0, 0.25):
        high = float(rng.uniform(0.7, 1.1))
        colour = reflectance(_near((40.0, 78.0, 52.0), 14.0, rng))
        things.append(box((float(x), y - high, 5.8), (float(x) + 0.3, y, 6.1), colour))
    return things


def _mug_and_book(rng: np.random.Generator) -> list[list[Face]]:
    """Red and blue, apart from one another, beside the field."""
    side, y = float(rng.choice([-1.0, 1.0])), CAMERA_HEIGHT
    x, z = side * float(rng.uniform(0.85, 1.1)), float(rng.uniform(4.3, 5.0))
    carton = box((x - 0.18, y - 0.22, z - 0.12), (x + 0.18, y, z + 0.12), reflectance((92.0, 128.0, 160.0)))
    red, blue = reflectance(_near((26.0, 24.0, 190.0), 14.0, rng)), reflectance(_near((170.0, 60.0, 30.0), 14.0, rng))
    mug = post((x, y - 0.22, z), (x, y - 0.31, z), 0.042, red, sides=20)
    bx, bz = -side * float(rng.uniform(0.85, 1.1)), float(rng.uniform(3.9, 4.8))
    book = box((bx - 0.11, y - 0.05, bz - 0.08), (bx + 0.11, y, bz + 0.08), blue, float(rng.uniform(-0.8, 0.8)))
    return [carton, mug, book]


def _near(colour: Colour, by: float, rng: np.random.Generator) -> Colour:
    b, g, r = np.clip(np.array(colour) + rng.uniform(-by, by) + rng.uniform(-0.4 * by, 0.4 * by, 3), 0.0, 255.0)
    return float(b), float(g), float(r)


def _any_colour(rng: np.random.Generator) -> Colour:
    hsv = np.array([[[rng.uniform(0, 180), rng.uniform(20, 220), rng.uniform(30, 210)]]], dtype=np.uint8)
    b, g, r = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0].tolist()
    return float(b), float(g), float(r)
