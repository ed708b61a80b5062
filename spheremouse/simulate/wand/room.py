"""All parts of a wand's picture but the ball: floor, wall and objects, drawn once, and the other moving objects.

A red mug and a blue book are in every room. Grzonka 2005, section 4.3, found such single-coloured objects harmless. A
robot or a stick under the ball, a hand, and a card in the ball's colours move. Each has a function that takes its pose
and returns layers to paint, or None for what is out of sight. A `light` of 1 is that of a bright room.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.cast import AT_ORIGIN, PARTS, Viewpoint, reduced
from spheremouse.simulate.layers import Layer, Window, drawn_hand, hand_layer, lay, window
from spheremouse.simulate.light import reflectance, to_linear
from spheremouse.simulate.shapes import Colour, Face, Ring, box, post, unit
from spheremouse.simulate.wand.ball import paint_of
from spheremouse.simulate.wand.path import CAMERA_HEIGHT, R_CAM_WORLD

_MIN_DEPTH_M = 0.05  # m, nearer to the camera's plane nothing is drawn
_TILE, _PER_METRE = 1024, 256  # px of the floor's texture, and per m
_WALL = 6.2  # m, world z
_LAMP = np.array([-0.3, -0.85, -0.43])  # towards the light, world
# The ruled field on the floor (Grzonka 2005, fig. 9): corners and distances of its lines, m world x and z, line width
_FIELD, _GAPS, _LINE = ((-0.72, 3.62), (0.724, 4.424)), (0.10, 0.15), 0.004


def paint_shapes(
    shapes: Sequence[Face | Ring], lights: Array | float, pose: Pose, camera: InteriorOrientation, margin: int = 1
) -> Layer | None:
    """Paint shapes in their colours times `lights`, (k,) or one; `pose` is that of the camera in their frame.

    A shape nearer than 5 cm to the camera's plane is left out. The layer has `margin` px round the shapes. None if
    nothing is in the picture.
    """
    cam = [pose.to_cam(shape.outline()) for shape in shapes]
    seen = [k for k, outline in enumerate(cam) if np.all(outline[:, 2] > _MIN_DEPTH_M)]
    place = window(project(np.concatenate([np.zeros((0, 3)), *(cam[k] for k in seen)]), camera)[0], margin, camera)
    if place.empty:
        return None
    table = np.ones((len(seen) + 1, 4))
    table[0] = 0.0
    table[1:, :3] = np.array([shapes[k].colour for k in seen]) * np.broadcast_to(lights, len(shapes))[seen, None]
    view = Viewpoint([shapes[k] for k in seen], pose)
    paint = view.paint(place, camera, lambda surfaces, _: table[surfaces // PARTS])
    return Layer(place, paint.astype(np.float32))


# ---- objects that do not move ----


def background(
    camera: InteriorOrientation, outdoors: bool, clutter: bool, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw all objects that do not move, (h, w, 3) linear light."""
    picture = _ground(camera, outdoors, rng)
    faces = _outdoors(rng) if outdoors else _indoors(rng)
    if clutter:
        faces += _mug_and_book(rng)
    normals = np.array([face.normal() for face in faces])
    away = np.sign(np.sum(normals * [face.corners.mean(axis=0) for face in faces], axis=1))  # from the camera
    lights = 0.60 + 0.40 * np.maximum(-away * (normals @ _LAMP), 0.0)
    # of faces in one plane the last one is in front
    layer = paint_shapes(faces[::-1], lights[::-1], Pose(R_CAM_WORLD.T, np.zeros(3)), camera)
    if layer is not None:
        lay(picture, layer)
    return picture


def _ground(camera: InteriorOrientation, outdoors: bool, rng: np.random.Generator) -> NDArray[np.float32]:
    """Floor and wall, or lawn and sky, with some texture."""
    shape = (camera.height, camera.width)
    x, y = reduced(Window(0, 0, camera.width, camera.height), camera).reshape(2, -1)
    rays = np.column_stack([x, y, np.ones_like(x)]) @ R_CAM_WORLD  # to world
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = CAMERA_HEIGHT / rays[:, 1]
        at = rays[:, [0, 2]] * depth[:, None]
    floor = (rays[:, 1] > 0.0) & (at[:, 1] < _WALL) & np.isfinite(at).all(axis=1)
    at = np.where(floor[:, None], at, 0.0)
    on_floor = _texture_at(0.35 if outdoors else 0.10, at, shape, rng)
    on_wall = _texture_at(0.05, (rays * (_WALL / rays[:, 2])[:, None])[:, :2] * 0.7, shape, rng)
    base = reflectance((72.0, 118.0, 104.0)) if outdoors else _near((186.0, 200.0, 210.0), 12.0, rng)
    wall = reflectance((236.0, 214.0, 190.0)) if outdoors else _near((160.0, 170.0, 176.0), 14.0, rng)
    shade = on_floor * np.clip(1.15 - 0.06 * at[:, 1], 0.6, 1.2)
    picture = np.where(floor[:, None], shade[:, None] * np.array(base), on_wall[:, None] * np.array(wall))
    lines = _ruled(at.reshape(*shape, 2)).reshape(-1, 1)
    picture += lines * (0.94 * np.array(reflectance((70.0, 70.0, 70.0))) - picture)
    return picture.reshape(*shape, 3).astype(np.float32)


def _ruled(at: Array) -> Array:
    """Return the share of the field's lines in pixels, (h, w), that show places of the floor, (h, w, 2) m."""
    size = np.maximum(np.abs(np.gradient(at, axis=0)) + np.abs(np.gradient(at, axis=1)), 1e-9)  # m, of a pixel
    off = np.abs((at - _FIELD[0] - 0.5 * _LINE + np.divide(_GAPS, 2.0)) % _GAPS - np.divide(_GAPS, 2.0))
    share = np.clip((0.5 * (_LINE + size) - off) / size, 0.0, np.minimum(1.0, _LINE / size))
    return share.max(axis=2) * np.all((at > _FIELD[0]) & (at < _FIELD[1]), axis=2)


def _texture_at(depth: float, metres: Array, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return factors on the colour, (h*w,), at places (h*w, 2) m that pixels of a picture (h, w) show.

    They have mean 1 and standard deviation `depth`, and details of three sizes. The texture repeats.
    """
    fine = np.zeros((_TILE, _TILE))
    for blur in (1.5, 6.0, 40.0):
        noise = gaussian_filter(rng.standard_normal((_TILE, _TILE)), blur, mode="wrap")
        fine += noise / noise.std()
    tile = np.maximum(1.0 + depth * fine / fine.std(), 0.1).astype(np.float32)
    x, y = (np.nan_to_num(metres.T * _PER_METRE) % (_TILE - 1)).astype(np.float32).reshape(2, *shape)
    return np.asarray(cv2.remap(tile, x, y, cv2.INTER_LINEAR), dtype=np.float32).ravel()


def _indoors(rng: np.random.Generator) -> list[Face]:
    """Shelves with books, a cabinet, a chair's back, boxes along the wall."""
    y = CAMERA_HEIGHT
    things = box((-9.0, y - 0.09, _WALL - 0.02), (9.0, y, _WALL), reflectance((60.0, 80.0, 100.0)))
    left = -2.3
    while left < 2.3:
        kind = rng.choice(["cabinet", "shelf", "gap", "carton"])
        width = float(rng.uniform(0.5, 1.0))
        if kind == "cabinet":
            things += box((left, y - 1.3, 5.6), (left + width, y, 6.1), _near((110.0, 112.0, 112.0), 25.0, rng))
        elif kind == "shelf":
            wood = _near((62.0, 88.0, 120.0), 12.0, rng)
            for board in (0.04, 0.42, 0.80):
                things += box((left, y - board - 0.03, 5.7), (left + width, y - board, 6.1), wood)
                at = left + 0.03
                while board < 0.7 and at < left + width - 0.08:
                    thick, tall = float(rng.uniform(0.025, 0.07)), float(rng.uniform(0.2, 0.3))
                    low, high = (at, y - board - tall - 0.03, 5.75), (at + thick, y - board - 0.03, 6.0)
                    hsv = np.array([[[rng.uniform(0, 180), rng.uniform(20, 220), rng.uniform(30, 210)]]], np.uint8)
                    things += box(low, high, reflectance(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0]))
                    at += thick + 0.004
        elif kind == "carton":
            high = float(rng.uniform(0.25, 0.5))
            colour = _near((95.0, 130.0, 165.0), 12.0, rng)
            things += box((left, y - high, 5.3), (left + width, y, 5.7), colour, float(rng.uniform(-0.4, 0.4)))
        left += width + float(rng.uniform(0.02, 0.25))
    return things


def _outdoors(rng: np.random.Generator) -> list[Face]:
    """A hedge and a wall before the sky."""
    y, things = CAMERA_HEIGHT, list[Face]()
    for x in np.arange(-3.0, 3.0, 0.25).tolist():
        high = float(rng.uniform(0.7, 1.1))
        things += box((x, y - high, 5.8), (x + 0.3, y, 6.1), _near((40.0, 78.0, 52.0), 14.0, rng))
    return things


def _mug_and_book(rng: np.random.Generator) -> list[Face]:
    """Red and blue, apart from one another, beside the field."""
    side, y = float(rng.choice([-1.0, 1.0])), CAMERA_HEIGHT
    x, z = side * float(rng.uniform(0.85, 1.1)), float(rng.uniform(4.3, 5.0))
    carton = box((x - 0.18, y - 0.22, z - 0.12), (x + 0.18, y, z + 0.12), reflectance((92.0, 128.0, 160.0)))
    red, blue = _near((26.0, 24.0, 190.0), 14.0, rng), _near((170.0, 60.0, 30.0), 14.0, rng)
    mug = post((x, y - 0.22, z), (x, y - 0.31, z), 0.042, red, sides=20)
    bx, bz = -side * float(rng.uniform(0.85, 1.1)), float(rng.uniform(3.9, 4.8))
    book = box((bx - 0.11, y - 0.05, bz - 0.08), (bx + 0.11, y, bz + 0.08), blue, float(rng.uniform(-0.8, 0.8)))
    return [*carton, *mug, *book]


def _near(colour: Colour, spread: float, rng: np.random.Generator) -> Colour:
    """Return the reflectance of a paint near a screen colour."""
    varied = np.array(colour) + rng.uniform(-spread, spread) + rng.uniform(-0.4 * spread, 0.4 * spread, 3)
    return reflectance(np.clip(varied, 0.0, 255.0))


# ---- objects that move ----

# m, in the ball's frame: a robot as long as that of the shared recording; its top touches the ball
_BODY = ((-0.095, -0.065, -0.128), (0.095, 0.065, -0.049))
_PANEL = ((0.020, -0.045), (0.088, 0.045))  # a bright lid on top, so that its front shows
_WHEELS, _WHEEL = ((-0.055, 0.055), (-0.068, 0.068)), (0.031, -0.121)  # x, y; radius, z of their hubs
_STICK = (0.27, 0.009, 0.011)  # m: length, radius at the ball and in the hand
_BLACK, _GREY, _WOOD = (reflectance(c) for c in ((30.0, 30.0, 30.0), (120.0, 122.0, 124.0), (96.0, 146.0, 190.0)))
_CARD = 0.045  # m, half of a side
_SHADOW_Z = -0.152  # m, of the floor


@dataclass(frozen=True, slots=True)
class Passing:
    """Something that passes by a place of the ball at a time."""

    middle: float  # s, when it is nearest
    velocity: Array  # (3,) m/s, cam
    nearest: Array  # (3,) m, cam, its position then
    around: float  # s before and after, as long as it is there

    def at(self, t: float) -> Array | None:
        """Its position, (3,) m in cam; None while it is away."""
        since = t - self.middle
        return None if abs(since) > self.around else self.nearest + since * self.velocity


def _rectangle(low: Sequence[float], high: Sequence[float], z: float) -> Array:
    (x0, y0), (x1, y1) = low[:2], high[:2]
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])


def robot(centre: Array, rotation: Array, camera: InteriorOrientation, light: float) -> list[Layer | None]:
    """The robot under a ball at `centre` (3,) m in cam with R_cam_ball (3, 3), over its shadow on the floor."""
    pose = Pose(rotation.T, -rotation.T @ centre)  # of the camera in the ball's frame
    foot = Face(_rectangle(*_BODY, _SHADOW_Z) * (1.15, 1.25, 1.0), (0.0, 0.0, 0.0))
    shadow = paint_shapes([foot], 0.0, pose, camera, margin=12)
    if shadow is not None:
        soft = np.asarray(cv2.GaussianBlur(shadow.paint, (0, 0), 4.0), dtype=np.float32)
        shadow = Layer(shadow.window, np.float32(0.7) * soft)
    parts = _robot_parts()
    lights = [light * (0.7 + 0.3 * abs(float(part.normal()[2]))) for part in parts]  # brighter if it lies level
    return [shadow, paint_shapes(parts, np.array(lights), pose, camera)]


@cache
def _robot_parts() -> list[Face | Ring]:
    """Body, lid, tyres and hubs, in the ball's frame."""
    parts: list[Face | Ring] = [*box(*_BODY, _BLACK), Face(_rectangle(*_PANEL, _BODY[1][2] + 0.001), _GREY)]
    across, (radius, hub) = np.array([0.0, 1.0, 0.0]), _WHEEL
    for x, y in product(*_WHEELS):
        for r, colour, out in ((radius, _BLACK, 0.0), (0.4 * radius, _GREY, 0.001)):
            parts.append(Ring(np.array([x, y + np.sign(y) * out, hub]), across, 0.0, r, colour))
    return parts


def held(
    centre: Array, rotation: Array, radius: float, camera: InteriorOrientation, light: float
) -> list[Layer | None]:
    """The stick from the lower pole of a ball, at (3,) m in cam with R_cam_ball (3, 3), to a hand, and that hand."""
    length, thin, thick = _STICK
    down = -rotation[:, 2]
    top, end = centre + 0.9 * radius * down, centre + (radius + length) * down
    across = unit(np.cross(down, 0.5 * (top + end)))
    outline = np.array([top + thin * across, end + thick * across, end - thick * across, top - thin * across])
    palm = centre - (radius + length - 0.05) * rotation[:, 2]
    stick = paint_shapes([Face(outline, _WOOD)], light, AT_ORIGIN, camera)
    return [stick, hand_at(palm, rotation[:, 2], camera, 1.0)]


def hand_at(palm: Array, fingers: Array, camera: InteriorOrientation, light: float) -> Layer | None:
    """A hand with its palm at (3,) m in cam, and its fingers in a direction (3,) of cam; None as by `hand_layer`."""
    up = unit(fingers) * (1.0, 1.0, 0.0)
    up = unit(up) if np.linalg.norm(up) > 0.1 else np.array([0.0, -1.0, 0.0])
    layer = hand_layer(_linear_hand(), palm, np.array([[-up[1], up[0], 0.0], up]), camera)
    if layer is not None:
        layer.paint[..., :3] *= light
    return layer


@cache
def _linear_hand() -> NDArray[np.float32]:
    """Return `drawn_hand` in linear light, its blue sleeve in grey: a hand has one colour of the ball only."""
    drawing = drawn_hand()
    cover = drawing[..., 3:]
    grey = np.divide(drawing[..., :3], cover, out=np.zeros_like(drawing[..., :3]), where=cover > 1e-3) / 255.0
    grey[grey[..., 0] > grey[..., 2]] = 0.2
    return np.concatenate([to_linear(grey) * cover, cover], axis=2).astype(np.float32)


def card(centre: Array, colours: tuple[str, ...], camera: InteriorOrientation, light: float) -> Layer | None:
    """A distractor: a white card at (3,) m in cam that faces it, with discs in the colours and layout of a ball."""
    shapes: list[Face | Ring] = [Face(_CARD * _rectangle((-1.0, -1.0), (1.0, 1.0), 0.0) + centre, paint_of("white"))]
    places = ((-0.2, -0.62, 0.21), (-0.15, 0.12, 0.36), (0.62, -0.40, 0.16), (0.68, 0.22, 0.22), (-0.78, 0.1, 0.2))
    for k, (x, y, size) in enumerate(places):
        at = centre + np.array([_CARD * x, _CARD * y, -1e-4])
        shapes.append(Ring(at, np.array([0.0, 0.0, 1.0]), 0.0, _CARD * size, paint_of(colours[k % len(colours)])))
    return paint_shapes(shapes, light, AT_ORIGIN, camera)
