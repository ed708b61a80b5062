"""Compilation of the wand's functions before the first frame, on small pictures, so that no frame waits for it.

The tracker searches for a ball, finds it, follows it, predicts it hidden, loses it and finds it again. The pictures
and settings cover both filters, all likelihoods, and balls near enough for a reduced picture and far ones.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from spheremouse.compiling import told
from spheremouse.geometry.camera import InteriorOrientation, project
from spheremouse.geometry.rotation import Array, exp
from spheremouse.tracker import Frame
from spheremouse.wand.ball import WandBall, contrast_ball, grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.track import begin, step

_LENS = np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
_CAMERA = InteriorOrientation(640, 480, 500.0, 500.0, 319.5, 239.5, _LENS)
_UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # R_cam_ball
_PAINT = {"red": (30, 30, 190), "blue": (190, 60, 30), "dark": (25, 25, 25), "light": (250, 250, 250)}  # BGR
_BODY = {"white": (225, 225, 225), "black": (12, 12, 12)}
_ROOM = (110, 120, 115)
_DT = 1.0 / 30.0


@cache
def warm_up() -> None:
    """Compile the functions of the tracker, or load them from the cache. Further calls return at once."""
    for ball, depth, settings in (
        (grzonka_ball(), 0.8, WandSettings()),
        (grzonka_ball(), 0.25, WandSettings()),
        (grzonka_ball(), 0.8, WandSettings(method="rims")),
        (grzonka_ball(), 0.8, WandSettings(method="edges")),
        (grzonka_ball(), 0.8, WandSettings(method="product")),
        (contrast_ball(), 0.8, WandSettings(region=False)),
    ):
        _track(ball, depth, settings)


def _track(ball: WandBall, depth: float, settings: WandSettings) -> None:
    tracker = build(_CAMERA, (ball,), settings)
    state = begin(tracker)
    shown = [_picture(ball, depth, 0.1 * k) for k in range(4)]
    empty = _picture(None, depth, 0.0)
    for k, image in enumerate((empty, *shown, shown[-1], empty, empty, shown[0], shown[0])):
        stamp = k * (_DT if k < 7 else 0.3)  # hidden, then lost
        state = step(state, Frame(image, stamp, k), tracker).state


def _picture(ball: WandBall | None, depth: float, turned: float) -> NDArray[np.uint8]:
    """Return a picture of an upright ball straight ahead, `turned` by rad about its pole, without shading."""
    image = np.full((_CAMERA.height, _CAMERA.width, 3), _ROOM, dtype=np.uint8)
    if ball is None:
        return image
    centre = np.array([0.0, 0.0, depth])
    R = exp(np.array([0.0, turned, 0.0])) @ _UPRIGHT
    u, v = project(centre[None], _CAMERA)[0][0]
    reach = int(_CAMERA.fx * ball.radius / depth * 1.1) + 2
    rows, columns = np.mgrid[int(v) - reach : int(v) + reach, int(u) - reach : int(u) + reach]
    ray = np.stack([(columns - _CAMERA.cx) / _CAMERA.fx, (rows - _CAMERA.cy) / _CAMERA.fy, np.ones(rows.shape)], axis=2)
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    along = ray @ centre
    inside = along**2 - depth**2 + ball.radius**2
    hit = inside > 0.0
    surface = ray[hit] * (along[hit] - np.sqrt(inside[hit]))[:, None] - centre
    image[rows[hit], columns[hit]] = _colours(ball, surface @ R / ball.radius)
    image[int(v) - 3 : int(v) + 2, int(u) - 3 : int(u) + 2] = 255  # glare
    return image


def _colours(ball: WandBall, directions: Array) -> NDArray[np.uint8]:
    """Return the colours, (n, 3) BGR, of directions in `ball`, (n, 3) unit vectors."""
    found = np.full((len(directions), 3), _BODY[ball.body], dtype=np.uint8)
    for disc in ball.discs:
        found[directions @ disc.direction > np.cos(disc.angle)] = _PAINT[disc.colour]
    return found


if __name__ == "__main__":
    with told():
        warm_up()
