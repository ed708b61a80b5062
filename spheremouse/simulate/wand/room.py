"""All parts of a wand's picture but the ball: floor, wall and objects, drawn once, and the other moving objects.

Flat faces are drawn finely, farther ones first, and averaged down. A red mug and a blue book are in every room.
Grzonka 2005, section 4.3, found such single-coloured objects harmless. A robot or a stick under the ball, a hand, and a
card in the ball's colours move. Each has a function that takes its pose and returns layers to paint, or None for what
is out of sight. A `light` of 1 is that of a bright room.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from spheremouse.geometry.camera import InteriorOrientation, project, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.layers import Layer, Window, drawn_hand, hand_layer, lay, window
from spheremouse.simulate.light import reflectance, to_linear
from spheremouse.simulate.shapes import Colour, Face, box, circle, post, unit
from spheremouse.simulate.wand.ball import paint_of
from spheremouse.simulate.wand.path import CAMERA_HEIGHT, R_CAM_WORLD

_SUBPIXELS = 4  # subpixels across a pixel where things are drawn
_FRACTIONAL_BITS = 4  # bits of the fixed point numbers that OpenCV draws with
_MIN_DEPTH_M = 0.05  # m, nearer to the camera's plane nothing is drawn
_TILE, _PER_METRE = 1024, 256  # px of the floor's texture, and per m
_WALL = 6.2  # m, world z
_LAMP = np.array([-0.3, -0.85, -0.43])  # towards the light, world
_LINES = (0.15, 0.10, 0.004)  # m: between lines across and along the field (Grzonka 2005, fig. 9), and their width

Painted = tuple[Array, Array]  # corners of a polygon, (k, 3) m, cam, and its light, (3,): blue, green, red; linear


def paint_faces(faces: Iterable[Painted], camera: InteriorOrientation, margin: int = 1) -> Layer | None:
    """Paint polygons, the first ones behind the others.

    A face nearer than 5 cm to the camera's plane is left out. The layer has `margin` px round the faces. None if
    nothing is in the picture.
    """
    seen = [(project(corners, camera)[0], colour) for corners, colour in faces if np.all(corners[:, 2] > _MIN_DEPTH_M)]
    if not seen:
        return None
    place = window(np.concatenate([outline for outline, _ in seen]), margin, camera)
    if place.empty:
        return None
    left, top, right, bottom = place
    w, h = right - left, bottom - top
    drawn = np.zeros((h * _SUBPIXELS, w * _SUBPIXELS), dtype=np.uint8)
    lights = np.zeros((len(seen) + 1, 4), dtype=np.float32)
    for index, (outline, colour) in enumerate(seen, start=1):
        fine = (outline - (left, top) + 0.5) * _SUBPIXELS - 0.5
        cv2.fillPoly(
            drawn, [np.rint(fine * (1 << _FRACTIONAL_BITS)).astype(np.int32)], (index,), shift=_FRACTIONAL_BITS
        )
        lights[index] = (*colour, 1.0)
    first = drawn[::_SUBPIXELS, ::_SUBPIXELS]  # most pixels have one colour
    mixed = cv2.resize(drawn, (w, h), interpolation=cv2.INTER_AREA) != first
    mixed |= drawn[_SUBPIXELS - 1 :: _SUBPIXELS, _SUBPIXELS - 1 :: _SUBPIXELS] != first
    paint = lights[first]
    paint[mixed] = lights[drawn.reshape(h, _SUBPIXELS, w, _SUBPIXELS).transpose(0, 2, 1, 3)[mixed]].mean(axis=(1, 2))
    return Layer(place, paint)


def _farthest_first(faces: Iterable[Painted]) -> list[Painted]:
    return sorted(faces, key=lambda face: -float(np.linalg.norm(face[0].mean(axis=0))))


# ---- objects that do not move ----


def background(
    camera: InteriorOrientation, outdoors: bool, clutter: bool, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw all objects that do not move, (h, w, 3) linear light."""
    picture = _ground(camera, outdoors, rng)
    things = _outdoors(rng) if outdoors else _indoors(rng)
    across, along, wide = _LINES  # the ruled field on the floor
    lines = [(-0.72, 0.72, z, z + wide) for z in np.arange(3.62, 4.45, across).tolist()]
    lines += [(x, x + wide, 3.62, 4.42) for x in np.arange(-0.72, 0.73, along).tolist()]
    grey, y = reflectance((70.0, 70.0, 70.0)), CAMERA_HEIGHT
    things += [[Face(np.array([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]), grey)] for x0, x1, z0, z1 in lines]
    if clutter:
        things += _mug_and_book(rng)
    for thing in things:  # one by one: an object hides those behind it
        faces = []
        for face in thing:
            toward = face.normal() @ _LAMP * (1.0 if face.normal() @ face.corners.mean(axis=0) < 0.0 else -1.0)
            faces.append(
                (face.corners @ R_CAM_WORLD.T, np.multiply(0.60 + 0.40 * max(float(toward), 0.0), face.colour))
            )
        layer = paint_faces(_farthest_first(faces), camera)
        if layer is not None:
            lay(picture, layer)
    return picture


def _ground(camera: InteriorOrientation, outdoors: bool, rng: np.random.Generator) -> NDArray[np.float32]:
    """Floor and wall, or lawn and sky, with some texture."""
    shape = (camera.height, camera.width)
    xy, _ = unproject(Window(0, 0, camera.width, camera.height).pixels(), camera)
    rays = np.column_stack([xy, np.ones(len(xy))]) @ R_CAM_WORLD  # to world
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
    return picture.reshape(*shape, 3).astype(np.float32)


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


def _indoors(rng: np.random.Generator) -> list[list[Face]]:
    """Shelves with books, a cabinet, a chair's back, boxes: along the wall, farther ones first."""
    y = CAMERA_HEIGHT
    things = [box((-9.0, y - 0.09, _WALL - 0.02), (9.0, y, _WALL), reflectance((60.0, 80.0, 100.0)))]
    left = -2.3
    while left < 2.3:
        kind = rng.choice(["cabinet", "shelf", "gap", "carton"])
        width = float(rng.uniform(0.5, 1.0))
        if kind == "cabinet":
            things.append(box((left, y - 1.3, 5.6), (left + width, y, 6.1), _near((110.0, 112.0, 112.0), 25.0, rng)))
        elif kind == "shelf":
            wood = _near((62.0, 88.0, 120.0), 12.0, rng)
            for board in (0.04, 0.42, 0.80):
                things.append(box((left, y - board - 0.03, 5.7), (left + width, y - board, 6.1), wood))
                at = left + 0.03
                while board < 0.7 and at < left + width - 0.08:
                    thick, tall = float(rng.uniform(0.025, 0.07)), float(rng.uniform(0.2, 0.3))
                    low, high = (at, y - board - tall - 0.03, 5.75), (at + thick, y - board - 0.03, 6.0)
                    hsv = np.array([[[rng.uniform(0, 180), rng.uniform(20, 220), rng.uniform(30, 210)]]], np.uint8)
                    blue, green, red = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0].tolist()
                    things.append(box(low, high, reflectance((blue, green, red))))
                    at += thick + 0.004
        elif kind == "carton":
            high = float(rng.uniform(0.25, 0.5))
            colour = _near((95.0, 130.0, 165.0), 12.0, rng)
            things.append(box((left, y - high, 5.3), (left + width, y, 5.7), colour, float(rng.uniform(-0.4, 0.4))))
        left += width + float(rng.uniform(0.02, 0.25))
    return things


def _outdoors(rng: np.random.Generator) -> list[list[Face]]:
    """A hedge and a wall before the sky."""
    y, things = CAMERA_HEIGHT, []
    for x in np.arange(-3.0, 3.0, 0.25).tolist():
        high = float(rng.uniform(0.7, 1.1))
        things.append(box((x, y - high, 5.8), (x + 0.3, y, 6.1), _near((40.0, 78.0, 52.0), 14.0, rng)))
    return things


def _mug_and_book(rng: np.random.Generator) -> list[list[Face]]:
    """Red and blue, apart from one another, beside the field."""
    side, y = float(rng.choice([-1.0, 1.0])), CAMERA_HEIGHT
    x, z = side * float(rng.uniform(0.85, 1.1)), float(rng.uniform(4.3, 5.0))
    carton = box((x - 0.18, y - 0.22, z - 0.12), (x + 0.18, y, z + 0.12), reflectance((92.0, 128.0, 160.0)))
    red, blue = _near((26.0, 24.0, 190.0), 14.0, rng), _near((170.0, 60.0, 30.0), 14.0, rng)
    mug = post((x, y - 0.22, z), (x, y - 0.31, z), 0.042, red, sides=20)
    bx, bz = -side * float(rng.uniform(0.85, 1.1)), float(rng.uniform(3.9, 4.8))
    book = box((bx - 0.11, y - 0.05, bz - 0.08), (bx + 0.11, y, bz + 0.08), blue, float(rng.uniform(-0.8, 0.8)))
    return [carton, mug, book]


def _near(colour: Colour, spread: float, rng: np.random.Generator) -> Colour:
    """Return the reflectance of a paint near a screen colour."""
    b, g, r = np.clip(
        np.array(colour) + rng.uniform(-spread, spread) + rng.uniform(-0.4 * spread, 0.4 * spread, 3), 0.0, 255.0
    )
    return reflectance((float(b), float(g), float(r)))


# ---- objects that move ----

# m, in the ball's frame: a robot as long as that of the shared recording; its top touches the ball
_BODY = ((-0.095, -0.065, -0.128), (0.095, 0.065, -0.049))
_PANEL = ((0.020, -0.045), (0.088, 0.045))  # a bright lid on top, so that its front shows
_WHEELS, _WHEEL = ((-0.055, 0.055), (-0.068, 0.068)), (0.031, -0.121)  # x, y; radius, z of their hubs
_STICK = (0.27, 0.009, 0.011)  # m: length, radius at the ball and in the hand
_BLACK, _GREY, _WOOD = (reflectance(c) for c in ((30.0, 30.0, 30.0), (120.0, 122.0, 124.0), (96.0, 146.0, 190.0)))
_CARD = 0.045  # m, half of a side
_SHADOW_Z = -0.152  # m, of the floor
_ROUND = circle(24)


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
    foot = _rectangle(*_BODY, _SHADOW_Z) * (1.15, 1.25, 1.0)
    shadow = paint_faces([(foot @ rotation.T + centre, np.zeros(3))], camera, margin=12)
    if shadow is not None:
        soft = np.asarray(cv2.GaussianBlur(shadow.paint, (0, 0), 4.0), dtype=np.float32)
        shadow = Layer(shadow.window, np.float32(0.7) * soft)

    def lit(faces: list[Face]) -> list[Painted]:
        """Faces in the ball's frame, brighter if they lie level."""
        colours = [np.multiply(light * (0.7 + 0.3 * abs(float(face.normal()[2]))), face.colour) for face in faces]
        return [(f.corners @ rotation.T + centre, colour) for f, colour in zip(faces, colours, strict=True)]

    wheels = _farthest_first(lit(_wheels()))
    outer = len(wheels) // 2  # those on the far side are behind the body
    body = _farthest_first(lit(box(*_BODY, _BLACK)))
    panel = lit([Face(_rectangle(*_PANEL, _BODY[1][2] + 0.001), _GREY)])
    return [shadow, paint_faces([*wheels[:outer], *body, *panel, *wheels[outer:]], camera)]


@cache
def _wheels() -> list[Face]:
    """Tyres and hubs, in the ball's frame."""
    faces, (radius, hub) = [], _WHEEL
    for y in _WHEELS[1]:
        for x in _WHEELS[0]:
            for r, colour, out in ((radius, _BLACK, 0.0), (0.4 * radius, _GREY, 0.001)):
                rim = np.insert((x, hub) + r * _ROUND, 1, y + np.sign(y) * out, axis=1)
                faces.append(Face(rim, colour))
    return faces


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
    stick = paint_faces([(outline, np.multiply(light, _WOOD))], camera)
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
    faces = [(_CARD * _rectangle((-1.0, -1.0), (1.0, 1.0), 0.0) + centre, np.multiply(light, paint_of("white")))]
    places = ((-0.2, -0.62, 0.21), (-0.15, 0.12, 0.36), (0.62, -0.40, 0.16), (0.68, 0.22, 0.22), (-0.78, 0.1, 0.2))
    for k, (x, y, size) in enumerate(places):
        paint = np.multiply(light, paint_of(colours[k % len(colours)]))
        disc = np.insert((x, y) + size * _ROUND, 2, 0.0, axis=1)
        faces.append((centre + _CARD * disc, paint))
    return paint_faces(faces, camera)
