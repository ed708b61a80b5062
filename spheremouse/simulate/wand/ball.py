"""Ray casting of a hand-held ball. Its discs are true spherical caps, anti-aliased, in any light.

A pixel gets one ray on a plain part of ball or disc, and many rays on an edge. The result is averaged over the
exposure. The code is independent of the particle filter's projection: it casts rays, and the filter projects points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, ellipse_to_pixel, project_sphere, undistorted
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.light import reflectance
from spheremouse.wand.ball import WandBall

FINE = 6  # rays across a pixel with an edge, in each direction; fewer where many moments are averaged

# Paints as on a screen, blue, green, red: paper or foam as such balls are made of
PAINTS = {
    "white": (225.0, 228.0, 230.0),
    "black": (26.0, 26.0, 26.0),
    "red": (32.0, 28.0, 196.0),
    "blue": (178.0, 64.0, 28.0),
    "green": (60.0, 150.0, 40.0),
    "dark": (30.0, 28.0, 28.0),
    "light": (235.0, 245.0, 255.0),
}
LIT = ("light",)  # discs that shine by themselves
_LIT = 1.1  # of their own light: as bright as the sensor takes


class Layer(NamedTuple):
    """Something painted into a part of the picture."""

    place: tuple[int, int]  # px, column and row of its first pixel
    paint: NDArray[np.float32]  # (h, w, 4) light in blue, green, red, times its cover; cover 0..1


@dataclass(frozen=True, slots=True)
class WandLight:
    """Lights on the ball; powers are linear, 1 is the white of the picture."""

    towards: Array  # (k, 3) unit vectors to lamps or sun, cam
    power: Array  # (k, 3) blue, green, red
    above: Array  # (3,) from the sky or the ceiling
    below: Array  # (3,) from the floor
    up: Array  # (3,) unit vector, cam
    gloss: float  # of the ball: brightness of the highlights
    polish: float  # the higher the smaller the highlights are


def paint_of(colour: str) -> Array:
    """Return the reflectance, (3,) blue, green, red, of a disc or a body by its colour's name; grey if unknown."""
    return np.array(reflectance(PAINTS.get(colour, (128.0, 128.0, 128.0))))


def disc_paints(ball: WandBall) -> Array:
    """(n + 1, 3): of the ball's body, then of its discs."""
    return np.array([paint_of(ball.body), *(paint_of(d.colour) for d in ball.discs)])


def window(centre: Array, radius: float, camera: InteriorOrientation, margin: float = 2.0) -> tuple[int, ...]:
    """Return first and last+1 column, first and last+1 row that may show a sphere, cut to the picture.

    The sphere has its centre at (3,) m in cam and `radius` m. `margin` px are added on each side.
    """
    middle, outline = project_sphere(centre, radius)
    uv, shape = ellipse_to_pixel(middle[None], outline[None], camera)
    half = np.sqrt(np.diag(shape[0])) + margin
    if not np.all(np.isfinite(half)):
        return 0, 0, 0, 0
    low = np.clip(np.floor(uv[0] - half), 0, (camera.width, camera.height)).astype(int)
    high = np.clip(np.ceil(uv[0] + half) + 1, 0, (camera.width, camera.height)).astype(int)
    return int(low[0]), int(high[0]), int(low[1]), int(high[1])


def paint_ball(
    ball: WandBall, paints: Array, moments: Sequence[tuple[Array, Array]], camera: InteriorOrientation, light: WandLight
) -> Layer | None:
    """The ball, averaged over poses (centre (3,) m, R_cam_ball (3, 3)) in the exposure; None where it is not in view.

    `paints` as of `disc_paints`.
    """
    windows = np.array([window(c, ball.radius, camera) for c, _ in moments if c[2] > 2.0 * ball.radius])
    if len(windows) == 0:
        return None
    left, top = windows[:, 0].min(), windows[:, 2].min()
    out = np.zeros((max(windows[:, 3].max() - top, 0), max(windows[:, 1].max() - left, 0), 4), dtype=np.float32)
    if out.size == 0:
        return None
    directions = np.array([d.direction for d in ball.discs]).reshape(-1, 3)
    cosines = np.cos([d.angle for d in ball.discs]).reshape(-1)
    lit = np.array([0.0, *(_LIT * (d.colour in LIT) for d in ball.discs)])
    fine = max(2, int(np.ceil(FINE / np.sqrt(len(moments)))))
    lamps = light.towards, light.power, light.above, light.below, light.up, light.gloss, light.polish
    for centre, rotation in moments:
        if centre[2] <= 2.0 * ball.radius:
            continue
        pose = (np.asarray(centre, dtype=float), np.ascontiguousarray(rotation, dtype=float), float(ball.radius))
        lens = (*camera.intrinsic, camera.distortion, camera.fold_r2)
        _paint(pose, directions, cosines, paints, lit, lamps, lens, left, top, fine, 1.0 / len(moments), out)
    return Layer((int(left), int(top)), out)


@njit(cache=True, error_model="numpy")
def _meet(u, v, pose, directions, cosines, lens, normal):
    """Label of the surface at a pixel: -1 nothing, 0 the body, k + 1 the k-th disc; its unit normal in `normal`."""
    c, R, r = pose
    fx, fy, cx, cy, k, fold = lens
    x, y, _, _, _ = undistorted((u - cx) / fx, (v - cy) / fy, k, fold)
    if np.isnan(x):
        return -1
    a = x * x + y * y + 1.0
    b = x * c[0] + y * c[1] + c[2]
    root = b * b - a * (c[0] * c[0] + c[1] * c[1] + c[2] * c[2] - r * r)
    if root < 0.0 or b <= 0.0:
        return -1
    s = (b - np.sqrt(root)) / a
    normal[0], normal[1], normal[2] = (s * x - c[0]) / r, (s * y - c[1]) / r, (s - c[2]) / r
    n0 = R[0, 0] * normal[0] + R[1, 0] * normal[1] + R[2, 0] * normal[2]
    n1 = R[0, 1] * normal[0] + R[1, 1] * normal[1] + R[2, 1] * normal[2]
    n2 = R[0, 2] * normal[0] + R[1, 2] * normal[1] + R[2, 2] * normal[2]
    for i in range(len(cosines)):
        if directions[i, 0] * n0 + directions[i, 1] * n1 + directions[i, 2] * n2 > cosines[i]:
            return i + 1
    return 0


@njit(cache=True, error_model="numpy")
def _shade(n, centre, albedo, lit, lamps, weight, pixel):
    """Light of a point with normal n, times weight, added to a pixel (4,)."""
    towards, power, above, below, up, gloss, polish = lamps
    upward = 0.5 + 0.5 * (n[0] * up[0] + n[1] * up[1] + n[2] * up[2])
    far = np.sqrt(centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2)
    for channel in range(3):
        light = upward * above[channel] + (1.0 - upward) * below[channel]
        shine = 0.0
        for j in range(len(towards)):
            facing = n[0] * towards[j, 0] + n[1] * towards[j, 1] + n[2] * towards[j, 2]
            if facing <= 0.0:
                continue
            light += facing * power[j, channel]
            h0 = towards[j, 0] - centre[0] / far  # halfway between lamp and eye (Blinn 1977)
            h1 = towards[j, 1] - centre[1] / far
            h2 = towards[j, 2] - centre[2] / far
            half = (n[0] * h0 + n[1] * h1 + n[2] * h2) / np.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
            if half > 0.8:  # beside that it is none: a power of 45 or more
                shine += gloss * power[j, channel] * half**polish
        pixel[channel] += weight * (albedo[channel] * (light + lit) + shine)
    pixel[3] += weight


@njit(cache=True, error_model="numpy")
def _paint(pose, directions, cosines, paints, lit, lamps, lens, left, top, fine, weight, out):
    """Add the picture of one pose times `weight` to `out` (h, w, 4), with the first pixel at (left, top).

    A pixel gets one ray, or fine² rays if an edge runs through it.
    """
    h, w = out.shape[:2]
    corner = np.empty((h + 1, w + 1), dtype=np.int64)
    normal = np.empty(3)
    for i in range(h + 1):
        for j in range(w + 1):
            corner[i, j] = _meet(left + j - 0.5, top + i - 0.5, pose, directions, cosines, lens, normal)
    for i in range(h):
        for j in range(w):
            middle = _meet(left + j + 0.0, top + i + 0.0, pose, directions, cosines, lens, normal)
            if middle == corner[i, j] == corner[i, j + 1] == corner[i + 1, j] == corner[i + 1, j + 1]:
                if middle >= 0:
                    _shade(normal, pose[0], paints[middle], lit[middle], lamps, weight, out[i, j])
                continue
            for y in range(fine):
                for x in range(fine):
                    u, v = left + j + (x + 0.5) / fine - 0.5, top + i + (y + 0.5) / fine - 0.5
                    here = _meet(u, v, pose, directions, cosines, lens, normal)
                    if here >= 0:
                        _shade(normal, pose[0], paints[here], lit[here], lamps, weight / (fine * fine), out[i, j])
