"""Moving objects in a wand's picture beside the ball: its robot or stick, a hand, a card in its colours.

Each is a function of the pose it belongs to and gives layers to paint.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, project
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.hands import ABOVE, HALF_WIDTH, PER_METRE
from spheremouse.simulate.light import reflectance
from spheremouse.simulate.shapes import Colour, box
from spheremouse.simulate.wand.ball import Layer, paint_of
from spheremouse.simulate.wand.room import paint_faces

# m, in the ball's frame: a robot as long as that of the shared recording; its top touches the ball
_BODY = ((-0.095, -0.065, -0.128), (0.095, 0.065, -0.049))
_PANEL = ((0.020, -0.045), (0.088, 0.045))  # a bright lid on top, so that its front shows
_WHEELS, _WHEEL = ((-0.055, 0.055), (-0.068, 0.068)), (0.031, -0.121)  # x, y; radius, z of their hubs
_STICK = (0.27, 0.009, 0.011)  # m: length, radius at the ball and in the hand
_BLACK, _GREY, _WOOD = (reflectance(c) for c in ((30.0, 30.0, 30.0), (120.0, 122.0, 124.0), (96.0, 146.0, 190.0)))
_CARD = 0.045  # m, half of a side
_ROUND = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)


@dataclass(frozen=True, slots=True)
class Passing:
    """Something that passes by a place of the ball at a time."""

    middle: float  # s, when it is nearest
    velocity: Array  # (3,) m/s, cam
    nearest: Array  # (3,) m, cam, where it is then
    around: float  # s before and after, as long as it is there

    def at(self, t: float) -> Array | None:
        """Its position, (3,) m in cam; None while it is away."""
        since = t - self.middle
        return None if abs(since) > self.around else self.nearest + since * self.velocity


def robot(centre: Array, rotation: Array, camera: InteriorOrientation, light: float) -> Layer | None:
    """The robot under a ball at `centre` (3,) m with R_cam_ball (3, 3); `light` 1 is that of a bright room."""
    flat = [(corners, colour) for corners, colour in _robot_faces() if colour is not None]
    placed = [(corners @ rotation.T + centre, colour) for corners, colour in flat]
    facing = []
    for corners, colour in placed:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
        normal /= np.linalg.norm(normal)
        b, g, r = colour
        share = light * (0.7 + 0.3 * abs(float(normal @ rotation[:, 2])))
        facing.append((corners, (share * b, share * g, share * r)))
    body, panel, wheels = facing[:6], facing[6:7], facing[7:]
    body.sort(key=lambda f: -float(np.linalg.norm(f[0].mean(axis=0))))
    wheels.sort(key=lambda f: -float(np.linalg.norm(f[0].mean(axis=0))))
    outer = len(wheels) // 2  # those on the far side are behind the body
    return paint_faces([*wheels[:outer], *body, *panel, *wheels[outer:]], camera)


def _robot_faces() -> list[tuple[Array, Colour]]:
    faces: list[tuple[Array, Colour]] = [(f.corners, _BLACK) for f in box(_BODY[0], _BODY[1], _BLACK)]
    (x0, y0), (x1, y1) = _PANEL
    z = _BODY[1][2] + 0.001
    faces.append((np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]), _GREY))
    radius, hub = _WHEEL
    for y in _WHEELS[1]:
        for x in _WHEELS[0]:
            for r, colour, out in ((radius, _BLACK, 0.0), (0.4 * radius, _GREY, 0.001)):
                rim = [x + r * np.cos(_ROUND), np.full_like(_ROUND, y + np.sign(y) * out), hub + r * np.sin(_ROUND)]
                faces.append((np.stack(rim, axis=-1), colour))
    return faces


def shadow(centre: Array, rotation: Array, camera: InteriorOrientation) -> Layer | None:
    """The dark place on the floor under a robot."""
    x0, y0, _ = _BODY[0]
    x1, y1, _ = _BODY[1]
    z = -0.152
    foot = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]) * (1.15, 1.25, 1.0)
    layer = paint_faces([(foot @ rotation.T + centre, (0.0, 0.0, 0.0))], camera, margin=12)
    if layer is None:
        return None
    soft = np.asarray(cv2.GaussianBlur(layer.paint, (0, 0), 4.0), dtype=np.float32)
    return Layer(layer.place, np.float32(0.7) * soft)


def stick(centre: Array, rotation: Array, radius: float, camera: InteriorOrientation, light: float) -> Layer | None:
    """The stick from the ball's lower pole down to the hand."""
    length, thin, thick = _STICK
    down = -rotation[:, 2]
    top, end = centre + 0.9 * radius * down, centre + (radius + length) * down
    across = np.cross(down, 0.5 * (top + end))
    across /= np.linalg.norm(across)
    outline = np.array([top + thin * across, end + thick * across, end - thick * across, top - thin * across])
    b, g, r = _WOOD
    return paint_faces([(outline, (light * b, light * g, light * r))], camera)


def grip(centre: Array, rotation: Array, radius: float) -> tuple[Array, Array]:
    """Point where a hand holds the stick, (3,) m in cam, and direction of its fingers, (3,) unit vector."""
    return centre - (radius + _STICK[0] - 0.05) * rotation[:, 2], rotation[:, 2]


def hand_at(
    drawing: NDArray[np.float32], palm: Array, fingers: Array, camera: InteriorOrientation, light: float
) -> Layer | None:
    """A hand, as `linear_hand` gives it, whose palm is at (3,) m in cam; `fingers` (3,) is where they point to."""
    up = fingers / np.linalg.norm(fingers) * (1.0, 1.0, 0.0)
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 0.1 else np.array([0.0, -1.0, 0.0])
    right = np.array([-up[1], up[0], 0.0])
    h, w = drawing.shape[:2]
    corner = np.array([[0, 0], [w, 0], [0, h], [w, h]], dtype=np.float32)
    metres = corner / PER_METRE * (1.0, -1.0) + (-HALF_WIDTH, ABOVE)
    points = palm + metres[:, :1] * right + metres[:, 1:] * up
    if np.any(points[:, 2] < 0.1):
        return None
    uv = project(points, camera)[0]
    if not np.all(np.isfinite(uv)):
        return None
    limit = (camera.width, camera.height)
    low = np.clip(np.floor(uv.min(axis=0)).astype(int) - 1, 0, limit)
    high = np.clip(np.ceil(uv.max(axis=0)).astype(int) + 2, 0, limit)
    if np.any(high <= low):
        return None
    M = cv2.getAffineTransform(corner[:3], (uv[:3] - low).astype(np.float32))
    size = (int(high[0] - low[0]), int(high[1] - low[1]))
    paint = np.asarray(cv2.warpAffine(drawing, M, size, flags=cv2.INTER_LINEAR), dtype=np.float32)
    paint[..., :3] *= light
    return Layer((int(low[0]), int(low[1])), paint)


def linear_hand(drawing: NDArray[np.float32]) -> NDArray[np.float32]:
    """`draw_hand` of `hands`, whose colours are grey values of the screen, as light; its blue sleeve made grey.

    A passing object has one colour of the ball only.
    """
    cover = drawing[..., 3:]
    grey = np.divide(drawing[..., :3], cover, out=np.zeros_like(drawing[..., :3]), where=cover > 1e-3) / 255.0
    sleeve = grey[..., 0] > grey[..., 2]
    grey[sleeve] = 0.2
    light = np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)
    return np.concatenate([light * cover, cover], axis=2).astype(np.float32)


def card(centre: Array, colours: tuple[str, ...], camera: InteriorOrientation, light: float) -> Layer | None:
    """A white card that faces the camera with discs in a ball's colours, laid out like a ball's: what takes it in."""
    square = _CARD * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    faces = [(square + centre, _dimmed("white", light))]
    circle = np.stack([np.cos(_ROUND), np.sin(_ROUND), np.zeros_like(_ROUND)], axis=-1)
    places = ((-0.2, -0.62, 0.21), (-0.15, 0.12, 0.36), (0.62, -0.40, 0.16), (0.68, 0.22, 0.22), (-0.78, 0.1, 0.2))
    for k, (x, y, size) in enumerate(places):
        middle = centre + _CARD * np.array([x, y, 0.0])
        faces.append((middle + _CARD * size * circle, _dimmed(colours[k % len(colours)], light)))
    return paint_faces(faces, camera)


def _dimmed(colour: str, light: float) -> Colour:
    b, g, r = light * paint_of(colour)
    return float(b), float(g), float(r)
