"""Painted patterns of a ball: the albedo as a function of the direction, exact, without a map, a seam or a pole.

Smooth fields are sums of plane waves in space, seen on the sphere. Dots and strokes are closed forms.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.simulate.ball.options import PatternName

Single = NDArray[np.float32]
_Bounds = tuple[float, float]
Albedo = Callable[[Single], Single]  # unit vectors in ball, (n, 3) -> 0..1, (n,)

_WAVES = 64  # of a field
_CHUNK = 4096  # directions at a time: their waves stay in the processor's cache
_EDGE = 0.004  # rad, width of a painted edge
_CELLS = 48  # along the side of the cube around the ball, to look up its dots


@dataclass(frozen=True, slots=True)
class Pattern:
    """What is painted on a ball; an albedo of 0 looks like a disc, 1 like the bare ball."""

    name: PatternName
    seed: int
    _albedo: Albedo = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_albedo", _PATTERNS[self.name](np.random.default_rng([self.seed, 3])))

    def albedo(self, directions: NDArray[np.floating]) -> Single:
        """Return the albedo, (n,) in 0..1, in `directions`, (n, 3) unit vectors in `ball`."""
        single = directions.astype(np.float32, copy=False)
        result = np.empty(len(single), dtype=np.float32)
        for start in range(0, len(single), _CHUNK):
            result[start : start + _CHUNK] = self._albedo(single[start : start + _CHUNK])
        return result


class _Waves(NamedTuple):
    """A smooth random field in space, of mean 0 and standard deviation 1."""

    wave: Single  # (3, k) rad per radius of the ball
    phase: Single  # (k,) rad
    amplitude: Single  # (k,)

    @classmethod
    def random(cls, rng: np.random.Generator, low: float, high: float, slope: float) -> Self:
        """Return waves of wave numbers from `low` to `high`; their amplitudes fall with the power `slope`."""
        direction = rng.standard_normal((3, _WAVES))
        number = np.geomspace(low, high, _WAVES)
        amplitude = number**-slope
        return cls(
            (direction / np.linalg.norm(direction, axis=0) * number).astype(np.float32),
            rng.uniform(0.0, 2.0 * np.pi, _WAVES).astype(np.float32),
            (amplitude / np.sqrt(0.5 * np.sum(amplitude**2))).astype(np.float32),
        )

    def __call__(self, d: Single) -> Single:
        waves: Single = d @ self.wave
        waves += self.phase
        return np.cos(waves, out=waves) @ self.amplitude


class _Strokes(NamedTuple):
    """Bent strokes of a soft brush, each within a bounded region."""

    centre: Single  # (3, k) unit vectors
    along: Single  # (3, k) tangents there
    across: Single  # (3, k)
    length: Single  # (k,) half of it, rad
    width: Single  # (k,) half of it, rad
    bend: Single  # (k,) across per square of along
    depth: Single  # (k,) of the albedo

    @classmethod
    def random(cls, rng: np.random.Generator, n: int, *, length: _Bounds, width: _Bounds, depth: _Bounds) -> Self:
        """Return `n` strokes anywhere, with half lengths and half widths in rad and depths within these bounds."""
        centre = _anywhere(rng, n)
        turn = rng.uniform(0.0, 2.0 * np.pi, n)
        x, y = tangent_basis(centre).transpose(2, 1, 0)
        c, s = np.cos(turn), np.sin(turn)
        sizes = (rng.uniform(*bounds, n) for bounds in (length, width, (-0.5, 0.5), depth))
        parts = (centre.T, c * x + s * y, c * y - s * x, *sizes)
        return cls(*(np.ascontiguousarray(part, dtype=np.float32) for part in parts))

    def __call__(self, d: Single) -> Single:
        """Return the albedo, (n,), that the strokes take away in directions (n, 3)."""
        reach2 = self.length**2 + (self.width + np.abs(self.bend) * self.length**2) ** 2  # beyond it they are 0
        near = np.max(d @ self.centre, axis=0) > np.sqrt(1.0 - reach2)
        centre, along, across, length, width, bend, depth = (part[..., near] for part in self)
        x, y = d @ along, d @ across
        y -= bend * x**2
        taper = np.maximum(1.0 - (x / length) ** 2, 0.0) * np.maximum(1.0 - (y / width) ** 2, 0.0)
        taper[d @ centre < 0.0] = 0.0
        return taper**2 @ depth


class _Dots(NamedTuple):
    """Round dots, found by the cell of space that a direction is in."""

    centre: Single  # (m + 1, 3) unit vectors; the last is none
    radius: Single  # (m + 1,) as a chord, in radii of the ball
    table: NDArray[np.int16]  # (_CELLS³, k) dots that reach into a cell; m: no more

    @classmethod
    def random(cls, rng: np.random.Generator, n: int, low: float, high: float) -> Self:
        """Return `n` dots anywhere, of radii from `low` to `high`, in radii of the ball; small ones are frequent."""
        centre, radius = _anywhere(rng, n), low * (high / low) ** rng.uniform(0.0, 1.0, n) ** 1.5
        around = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        cell = _cell_of(centre)[:, None] + around
        distance = np.linalg.norm((cell + 0.5) * (2.0 / _CELLS) - 1.0 - centre[:, None], axis=2)
        near = distance < radius[:, None] + _EDGE + np.sqrt(3.0) / _CELLS
        near &= np.all((cell >= 0) & (cell < _CELLS), axis=2)
        dot, which = np.nonzero(near)
        index = cell[dot, which] @ (_CELLS**2, _CELLS, 1)
        order = np.argsort(index, kind="stable")
        index, dot = index[order], dot[order]
        rank = np.arange(len(index)) - np.searchsorted(index, index)
        table = np.full((_CELLS**3, int(rank.max()) + 1), n, dtype=np.int16)
        table[index, rank] = dot
        centre, radius = np.append(centre, [[9.0, 9.0, 9.0]], axis=0), np.append(radius, 0.0)
        return cls(centre.astype(np.float32), radius.astype(np.float32), table)

    def __call__(self, d: Single) -> Single:
        """Return the share of dots in directions (n, 3): (n,), 0 outside, 1 inside."""
        share, on = np.zeros(len(d), dtype=np.float32), np.arange(len(d))
        cells = self.table[_cell_of(d) @ (_CELLS**2, _CELLS, 1)]
        for dots in cells.T:
            on = on[dots[on] < len(self.radius) - 1]
            dot = dots[on]
            distance = np.linalg.norm(d[on] - self.centre[dot], axis=1)
            share[on] = np.maximum(share[on], _inside(self.radius[dot] - distance))
        return share


def _inside(depth: Single) -> Single:
    """Return 0 outside of an edge, 1 inside, from the distance to it, rad."""
    return np.clip(0.5 + depth / _EDGE, 0.0, 1.0)


def _cell_of(directions: NDArray[np.floating]) -> NDArray[np.intp]:
    return np.clip((directions + 1.0) * (0.5 * _CELLS), 0, _CELLS - 1).astype(np.intp)


def _anywhere(rng: np.random.Generator, n: int) -> Array:
    u = rng.standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


# ---- the patterns ----


def _patches(rng: np.random.Generator) -> Albedo:
    field = _Waves.random(rng, 12.0, 90.0, 1.4)
    steepness = float(np.sqrt(np.sum((field.amplitude * np.linalg.norm(field.wave, axis=0)) ** 2) / 3.0))
    return lambda d: 1.0 - 0.9 * _inside((field(d) - 0.5) / steepness)  # 1/rad, root mean square of the gradient


def _marble(rng: np.random.Generator) -> Albedo:
    broad, fine = _Waves.random(rng, 4.0, 40.0, 1.3), _Waves.random(rng, 12.0, 90.0, 1.2)

    def albedo(d: Single) -> Single:
        veins = 0.38 * np.exp(-((broad(d) / 0.22) ** 2)) + 0.2 * np.exp(-((fine(d) / 0.16) ** 2))
        return (1.0 - veins).astype(np.float32, copy=False)

    return albedo


def _speckle(rng: np.random.Generator) -> Albedo:
    dots = _Dots.random(rng, 2500, 0.006, 0.03)
    return lambda d: 1.0 - 0.9 * dots(d)


def _dirt(rng: np.random.Generator) -> Albedo:
    smears = _Strokes.random(rng, 26, length=(0.1, 0.5), width=(0.05, 0.2), depth=(0.08, 0.2))
    scratches = _Strokes.random(rng, 40, length=(0.08, 0.4), width=(0.006, 0.015), depth=(0.1, 0.22))
    return lambda d: np.maximum(1.0 - smears(d) - scratches(d), 0.0)


def _none(_: np.random.Generator) -> Albedo:
    return lambda d: np.ones(len(d), dtype=np.float32)


_PATTERNS: dict[PatternName, Callable[[np.random.Generator], Albedo]] = {
    "patches": _patches,
    "marble": _marble,
    "speckle": _speckle,
    "dirt": _dirt,
    "none": _none,
}
