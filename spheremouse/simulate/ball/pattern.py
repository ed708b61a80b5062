"""Painted patterns of a ball: the albedo as a function of the direction, exact, without a map, a seam or a pole.

Smooth fields are sums of plane waves in space, seen on the sphere. Dots and strokes are closed forms.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.simulate.ball.options import PatternName

Single = NDArray[np.float32]
_Bounds = tuple[float, float]
Albedo = Callable[[Single], Single]  # unit vectors in ball, (n, 3) -> 0..1, (n,)

_WAVES_PER_FIELD = 64  # of a field
_CHUNK_DIRECTIONS = 4096  # directions at a time: their waves stay in the processor's cache
_EDGE_WIDTH_RAD = 0.004  # rad, width of a painted edge
_STRIPES = np.float32(18.0)  # between the poles there are half as many
_DOTS_AT_A_POINT = 6  # at most, of 0.6 on average


class Pattern(NamedTuple):
    """Paint of a ball; an albedo of 0 looks like a disc, 1 like the bare ball."""

    name: PatternName
    seed: int

    def albedo(self, directions: NDArray[np.floating]) -> Single:
        """Return the albedo, (n,) in 0..1, in `directions`, (n, 3) unit vectors in `ball`."""
        single, albedo = directions.astype(np.float32, copy=False), _albedo_of(*self)
        result = np.empty(len(single), dtype=np.float32)
        for start in range(0, len(single), _CHUNK_DIRECTIONS):
            part = slice(start, start + _CHUNK_DIRECTIONS)
            result[part] = albedo(single[part])
        return result


def _waves(rng: np.random.Generator, low: float, high: float, slope: float) -> tuple[Albedo, float]:
    """Return a smooth random field in space, of mean 0 and standard deviation 1, and its steepness.

    The wave numbers, rad per radius of the ball, are from `low` to `high`; amplitudes fall with the power `slope`. The
    steepness is the root mean square of the gradient along the sphere, 1/rad.
    """
    direction = rng.standard_normal((3, _WAVES_PER_FIELD))
    number = np.geomspace(low, high, _WAVES_PER_FIELD)
    wave = _single(direction / np.linalg.norm(direction, axis=0) * number)
    phase = _single(rng.uniform(0.0, 2.0 * np.pi, _WAVES_PER_FIELD))
    amplitude = _single(number**-slope / np.sqrt(0.5 * np.sum((number**-slope) ** 2)))

    def field(d: Single) -> Single:
        waves: Single = d @ wave
        waves += phase
        return np.cos(waves, out=waves) @ amplitude

    return field, float(np.sqrt(np.sum((amplitude * np.linalg.norm(wave, axis=0)) ** 2) / 3.0))


def _strokes(rng: np.random.Generator, n: int, *, length: _Bounds, width: _Bounds, depth: _Bounds) -> Albedo:
    """Return the albedo that bent strokes of a soft brush take away; half lengths and half widths are in rad."""
    centre = _anywhere(rng, n)
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    x, y = tangent_basis(centre).transpose(2, 1, 0)
    axes = centre.T, np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    sizes = (rng.uniform(*bounds, n) for bounds in (length, width, (-0.5, 0.5), depth))
    strokes = [np.ascontiguousarray(part, dtype=np.float32) for part in (*axes, *sizes)]
    _, _, _, long, wide, bent, _ = strokes
    least = np.sqrt(1.0 - (long**2 + (wide + np.abs(bent) * long**2) ** 2))  # cosine; beyond it a stroke is 0

    def taken(d: Single) -> Single:
        near = np.max(d @ strokes[0], axis=0) > least
        centre, along, across, length, width, bend, depth = (part[..., near] for part in strokes)
        x, y = d @ along, d @ across
        y -= bend * x**2
        taper = np.maximum(1.0 - (x / length) ** 2, 0.0) * np.maximum(1.0 - (y / width) ** 2, 0.0)
        taper[d @ centre < 0.0] = 0.0
        return taper**2 @ depth

    return taken


def _dots(rng: np.random.Generator, n: int, low: float, high: float) -> Albedo:
    """Return the share of round dots, 0 outside, 1 inside; radii from `low` to `high`, small ones are frequent."""
    centres, radii = KDTree(_anywhere(rng, n)), low * (high / low) ** rng.uniform(0.0, 1.0, n) ** 1.5
    radii = np.append(radii, -1.0)  # the tree's number for none

    def share(d: Single) -> Single:
        distance, dot = centres.query(d, k=_DOTS_AT_A_POINT, distance_upper_bound=high + _EDGE_WIDTH_RAD)
        return _inside(_single(np.max(radii[dot] - np.minimum(distance, 2.0), axis=1)))

    return share


def _single(values: Array) -> Single:
    return values.astype(np.float32)


def _inside(depth: Single) -> Single:
    """Return 0 outside of an edge, 1 inside, from the distance to it, rad."""
    return np.clip(0.5 + depth / _EDGE_WIDTH_RAD, 0.0, 1.0)


def _anywhere(rng: np.random.Generator, n: int) -> Array:
    u = rng.standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


@cache
def _albedo_of(name: PatternName, seed: int) -> Albedo:
    """Return the albedo of a pattern as a function of directions, (n, 3)."""
    rng = np.random.default_rng([seed, 3])
    if name == "patches":
        field, steepness = _waves(rng, 12.0, 90.0, 1.4)
        return lambda d: 1.0 - 0.9 * _inside((field(d) - 0.5) / steepness)
    if name == "marble":
        (broad, _), (fine, _) = _waves(rng, 4.0, 40.0, 1.3), _waves(rng, 12.0, 90.0, 1.2)
        return lambda d: _single(
            1.0 - (0.38 * np.exp(-((broad(d) / 0.22) ** 2)) + 0.2 * np.exp(-((fine(d) / 0.16) ** 2)))
        )
    if name == "speckle":
        dots = _dots(rng, 2500, 0.006, 0.03)
        return lambda d: 1.0 - 0.9 * dots(d)
    if name == "stripes":  # about an axis: a turn about it shows nothing
        axis = _single(_anywhere(rng, 1)[0])
        return lambda d: 1.0 - 0.6 * _inside(_single(np.sin(_STRIPES * np.arcsin(np.clip(d @ axis, -1, 1))) / _STRIPES))
    if name == "dirt":
        smears = _strokes(rng, 26, length=(0.1, 0.5), width=(0.05, 0.2), depth=(0.08, 0.2))
        scratches = _strokes(rng, 40, length=(0.08, 0.4), width=(0.006, 0.015), depth=(0.1, 0.22))
        return lambda d: np.maximum(1.0 - smears(d) - scratches(d), 0.0)
    return lambda d: np.ones(len(d), dtype=np.float32)
