"""Light on a simulated scene: the grey value of a point in the camera, per channel.

The model has two rectangular lamps (form factor of a polygon, Lambert 1760), ambient light, soft shadows of the ball
and the struts, and a glossy coat on the ball (Schlick 1994). It is plausible and smooth; no truth depends on it.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from spheremouse.geometry.rotation import Array
from spheremouse.simulate.shapes import Colour

_SKY = np.array([0.50, 0.47, 0.45])  # blue, green, red: light from above
_FLOOR = np.array([0.20, 0.24, 0.28])  # and light reflected by the floor

# Normal noise by its quantiles: five times as fast as NumPy's, true to 4.3 standard deviations, where it ends.
_CHUNK = 1 << 15  # values at a time: they stay in the processor's cache
_NORMAL = ndtri((np.arange(65536) + 0.5) / 65536.0).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Lamp:
    """A rectangle that shines from its front."""

    centre: Array  # (3,) m, obj
    right: Array  # (3,) m, half its width
    up: Array  # (3,) m, half its height; it shines towards up x right
    power: Array  # (3,) blue, green, red

    def corners(self) -> Array:
        """(4, 3), seen from the lit side going round to the left."""
        c, r, u = self.centre, self.right, self.up
        return np.array([c - r - u, c - r + u, c + r + u, c + r - u])


@dataclass(frozen=True, slots=True)
class Strip:
    """A strut as an occluder: an upright rectangle in a plane z = const."""

    x: tuple[float, float]  # m, obj
    y: tuple[float, float]  # m
    z: float  # m

    def corners(self) -> Array:
        """(4, 3), going round to the left seen from the ball."""
        (x0, x1), (y0, y1) = self.x, self.y
        return np.array([[x0, y0, self.z], [x0, y1, self.z], [x1, y1, self.z], [x1, y0, self.z]])


@dataclass(frozen=True, slots=True)
class Lighting:
    """Lamps, and the objects that block their light."""

    lamps: tuple[Lamp, ...]
    strips: tuple[Strip, ...]
    ball_radius: float  # m

    def on_room(self, points: Array, normals: Array) -> Array:
        """Return the light past ball and struts, (n, 3) blue, green, red, on points of the room, (n, 3) m, obj.

        `normals` (n, 3) are unit vectors.
        """
        towards = -points
        distance = _length(towards)
        facing = _dot(normals, towards) / distance
        hidden = np.clip(facing, 0.0, 1.0) * np.minimum(1.0, (self.ball_radius / distance) ** 2)
        light = _ambient(normals) * (1.0 - 0.8 * hidden)[:, None]
        for lamp in self.lamps:
            to_lamp = lamp.centre - points
            s = np.clip(-_dot(points, to_lamp) / _dot(to_lamp, to_lamp), 0.0, 1.0)
            miss = _length(points + s[:, None] * to_lamp)  # of the ball's centre
            open_share = self._past_strips(points, lamp) * (1.0 - _step(self.ball_radius - miss, 0.05 + 0.35 * s))
            light += (_form_factor(points, normals, lamp.corners()) * open_share)[:, None] * lamp.power
        return light

    def on_ball(self, points: Array) -> Array:
        """Return the light, (n, 3) blue, green, red, that falls on points (n, 3) m, obj, of the ball."""
        normals = points / self.ball_radius
        covered = sum((_form_factor(points, normals, s.corners()) for s in self.strips), np.zeros(len(points)))
        light = _ambient(normals) * (1.0 - np.clip(covered, 0.0, 1.0))[:, None]
        for lamp in self.lamps:
            share = _form_factor(points, normals, lamp.corners()) * self._past_strips(points, lamp)
            light += share[:, None] * lamp.power
        return light

    def gloss(self, points: Array, eye: Array) -> Array:
        """Return the light, (n, 3), that the coat of the ball reflects from points (n, 3) m, obj, to `eye`, (3,) m.

        It consists of blurred lamps, and of the room at the limb.
        """
        normals = points / self.ball_radius
        view = eye - points
        view /= _length(view)[:, None]
        cosine = np.clip(_dot(normals, view), 0.0, 1.0)
        fresnel = 0.04 + 0.96 * (1.0 - cosine) ** 5
        reflected = 2.0 * cosine[:, None] * normals - view
        seen = 0.55 * _ambient(reflected)
        for lamp in self.lamps:
            n = np.cross(lamp.up, lamp.right)
            with np.errstate(divide="ignore", invalid="ignore"):
                s = ((lamp.centre - points) @ n) / (reflected @ n)
            at = points + np.where(np.isfinite(s) & (s > 0.0), s, 0.0)[:, None] * reflected - lamp.centre
            inside = np.ones(len(points))
            for half in (lamp.right, lamp.up):
                size = np.linalg.norm(half)
                inside *= _step((1.0 - np.abs(at @ half) / size**2) * size, 0.35)
            inside *= (s > 0.0) * self._past_strips(points, lamp)
            seen += 0.35 * inside[:, None] * lamp.power
        return fresnel[:, None] * seen

    def _past_strips(self, points: Array, lamp: Lamp) -> Array:
        """Share of the lamp that no strut hides, (n,)."""
        share = np.ones(len(points))
        to_lamp = lamp.centre - points
        for strip in self.strips:
            with np.errstate(divide="ignore", invalid="ignore"):
                s = (strip.z - points[:, 2]) / to_lamp[:, 2]
            in_between = (s > 0.005) & (s < 1.0)
            s = np.where(in_between, s, 0.5)
            at = points[:, :2] + s[:, None] * to_lamp[:, :2]
            x = np.minimum(at[:, 0] - strip.x[0], strip.x[1] - at[:, 0])
            y = np.minimum(at[:, 1] - strip.y[0], strip.y[1] - at[:, 1])
            soft = 0.004 + 0.35 * s / (1.0 - s)
            half = 0.5 * (strip.x[1] - strip.x[0])
            dark = np.minimum(1.0, half / soft)  # a strut narrower than the half shadow never hides the whole lamp
            share *= 1.0 - in_between * dark * _step(x, soft) * _step(y, soft)
        return share


def develop(light: NDArray[np.floating]) -> NDArray[np.float32]:
    """Convert linear light, any shape, to grey values 0 to 255 by the curve of sRGB; above 1 they approach 255."""
    x = np.maximum(light.astype(np.float32, copy=False), np.float32(0.0))
    square = x * x
    x /= np.sqrt(np.sqrt(1.0 + square * square))
    return np.float32(255.0) * np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def expose(
    grey: NDArray[np.float32], noise: float, rng: np.random.Generator, brightness: float = 0.0
) -> NDArray[np.uint8]:
    """Return grey values, any shape, in bytes, with `brightness` and normal noise of the deviation `noise` added."""
    if noise == 0.0:
        return np.asarray(cv2.add(grey, np.full((4, 1), brightness), dtype=cv2.CV_8U), dtype=np.uint8)
    added, out = np.float32(noise) * _NORMAL + np.float32(brightness), np.empty(grey.size, dtype=np.uint8)
    raw = rng.bit_generator.random_raw(-(-grey.size // 4)).view(np.uint16)[: grey.size]
    pieces = (np.array_split(values, grey.size // _CHUNK + 1) for values in (grey.ravel(), raw, out))
    for values, numbers, exposed in zip(*pieces, strict=True):
        cv2.add(values, np.take(added, numbers, mode="clip"), dst=exposed, dtype=cv2.CV_8U)
    return out.reshape(grey.shape)


def to_linear(grey: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the linear light of grey values 0 to 1 of a screen (sRGB)."""
    return np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)


def reflectance(colour: Colour | NDArray[Any]) -> Colour:
    """Return the reflectance of a surface painted in a screen colour: blue, green, red, 0..255 (sRGB)."""
    b, g, r = to_linear(np.array(colour) / 255.0)
    return float(b), float(g), float(r)


def _dot(a: Array, b: Array) -> Array:
    """Return the dot products of vectors, (n, 3), row by row, (n,); faster than a sum over a short axis."""
    return np.einsum("ni,ni->n", a, b)


def _length(a: Array) -> Array:
    """Return the lengths, (n,), of vectors, (n, 3)."""
    return np.sqrt(_dot(a, a))


def _ambient(normals: Array) -> Array:
    up = 0.5 + 0.5 * normals[:, 1:2]
    return up * _SKY + (1.0 - up) * _FLOOR


def smoothstep(x: Array) -> Array:
    """Return x²(3 - 2x) on [0, 1]: 0 below, 1 above."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _step(x: Array, width: Array | float) -> Array:
    """0 below -width, 1 above width, smooth between."""
    return smoothstep(0.5 + 0.5 * x / width)


def _form_factor(points: Array, normals: Array, corners: Array) -> Array:
    """Return the form factor of a polygon from points (n, 3) with unit normals (n, 3), (n,) from 0 to 1 (Lambert 1760).

    It is the fraction of the hemisphere over the point that the polygon covers, weighted by the cosine from the normal.
    `corners` (m, 3) go to the left, seen from the points: from its other side the polygon gives 0. A part of it below
    the horizon of a point would count as negative.
    """
    total, squared = np.zeros(len(points)), _dot(points, points)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):  # a - p and b - p: both products by p
        cross = (np.cross(a - b, np.eye(3)) @ points.T + np.cross(a, b)[:, None]).T
        length = np.maximum(_length(cross), 1e-12)
        total += np.arctan2(length, squared - points @ (a + b) + a @ b) / length * _dot(cross, normals)
    return np.maximum(0.0, -total / (2.0 * np.pi))
