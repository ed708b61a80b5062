"""When two records of one motion belong together: rotation of the ball and counts of a trackball in, their lag out.

Wittich 2017, section 4.1.1 shifts the one along the other and takes the lag of the highest correlation. Here for all
lags at once (Fourier), for axes that are not known yet (regression of both counts on all three axes of rotation at
each lag), over clocks that may have nothing in common. `match` refines it below the resolution of the grid.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import Array

GRID = 0.02  # s, resolution of the search
_BAND = 5  # steps of the grid: means over 0.1 s, which hands hardly go beyond
_MEMORY = 0.6  # s, within which what a hand does is much the same: that much counts as one observation
_LEAST = 3.0  # s, that both have to have in common
_APART = 1.0  # s; a second best lag is one so far from the best
_STILL = 1e-9  # share of the strongest below which an axis is not moved at all
_USUAL = 0.05  # s, the longest time between two reports of a mouse that moves


@dataclass(frozen=True, slots=True)
class Turning:
    """Rotation of the ball from one frame to the next, where it was tracked in both."""

    begin: Array  # (n,) s, stamp of the one
    end: Array  # (n,) s, stamp of the other
    rotation: Array  # (n, 3) rad, rotation vector in obj

    def __len__(self) -> int:
        return len(self.begin)

    def within(self, begin: float, end: float) -> "Turning":
        """The part of a time."""
        keep = (self.begin >= begin) & (self.end <= end)
        return Turning(self.begin[keep], self.end[keep], self.rotation[keep])


@dataclass(frozen=True, slots=True)
class Travel:
    """Counts since the log began as a function of its time: straight lines, level where no report came."""

    knots: Array  # (m,) s
    sums: Array  # (m, 2) counts
    lost: Array  # (k, 2) s, from and to: known to lack reports

    @property
    def begin(self) -> float:
        """s, from when on the log says something."""
        return float(self.knots[0])

    @property
    def end(self) -> float:
        """s, until when."""
        return float(self.knots[-1])

    def at(self, t: Array) -> Array:
        """Counts at times (n,), (n, 2)."""
        return np.stack([np.interp(t, self.knots, self.sums[:, k]) for k in range(2)], axis=1)

    def covers(self, begin: Array, end: Array) -> NDArray[np.bool_]:
        """Whether the log knows all of the times from `begin` to `end`, both (n,) s."""
        known = (begin >= self.begin) & (end <= self.end)
        if len(self.lost) == 0:
            return known
        k = np.searchsorted(self.lost[:, 1], begin, side="right")  # the first that ends later
        starts = np.append(self.lost[:, 0], np.inf)
        return known & (starts[k] >= end)


def travel(log: MouseLog) -> Travel:
    """What is counted in a report was travelled since the one before, or within the usual time between two."""
    t, sums = log.stamp, np.cumsum(log.counts, axis=0)
    steps = np.diff(t)
    usual = steps[(steps > 0.0) & (steps < _USUAL)]
    interval = float(np.median(usual)) if len(usual) else _USUAL
    waited = np.flatnonzero(steps > 1.5 * interval)  # the pointer stood before it moved on
    knots = np.insert(t, waited + 1, t[waited + 1] - interval)
    values = np.insert(sums, waited + 1, sums[waited], axis=0)
    k = np.flatnonzero(log.lost)
    k = k[k > 0]
    return Travel(knots, values, np.stack([t[k - 1], t[k]], axis=1))


@dataclass(frozen=True, slots=True)
class Peak:
    """The best lag."""

    lag: float  # s, stamp of the log less stamp of the frames, of the same moment
    correlation: float  # 0..1, multiple correlation coefficient over 0.1 s, both axes together
    likelihood: float  # logarithm of the likelihood ratio against chance
    second: float  # that of the second best lag, one that is far from the best


def search(turning: Turning, counts: Travel) -> Peak | None:
    """The lag at which the counts are explained best by the rotation; None where they have too little in common.

    Every lag at which both have 3 s in common is tried. The more they have in common, the more a correlation says.
    """
    start = float(turning.begin[0])
    x, mx = _on_grid_turning(turning, start)
    y, my = _on_grid_counts(counts)
    seen = correlate(my, mx, mode="full", method="fft")

    def over(a: Array, b: Array) -> Array:
        """Sum over what both have in common of a(t) b(t + lag), for every lag."""
        return correlate(b, a, mode="full", method="fft")

    XX = np.array([[over(x[:, i] * x[:, j] * mx, my) for j in range(3)] for i in range(3)]).transpose(2, 0, 1)
    XY = np.array([[over(x[:, i] * mx, y[:, k] * my) for k in range(2)] for i in range(3)]).transpose(2, 0, 1)
    YY = np.array([over(mx, y[:, k] ** 2 * my) for k in range(2)]).T
    enough = seen > _LEAST / GRID
    enough &= np.trace(XX, axis1=1, axis2=2) > 1e-6 * np.sum(x**2)
    enough &= np.sum(YY, axis=1) > 1e-6 * np.sum(y**2)
    if not np.any(enough):
        return None
    ridge = _STILL * np.trace(XX[enough], axis1=1, axis2=2)
    fitted = np.linalg.solve(XX[enough] + ridge[:, None, None] * np.eye(3), XY[enough])
    explained = np.einsum("nij,nij->nj", XY[enough], fitted)
    whole = YY[enough]
    share = np.clip(explained / np.maximum(whole, 1e-9 * whole.max()), 0.0, 1.0 - 1e-6)
    observations = np.maximum(
        seen[enough] * (GRID / _MEMORY) - 4.0, 0.0
    )  # three coefficients can explain three at once
    likelihood = -0.5 * observations * np.sum(np.log1p(-share), axis=1)
    lags = GRID * (np.flatnonzero(enough) - (len(mx) - 1)) + counts.begin - start
    best = int(np.argmax(likelihood))
    far = np.abs(lags - lags[best]) > _APART
    both = np.clip(explained[best].sum() / whole[best].sum(), 0.0, 1.0)
    return Peak(
        lag=float(lags[best]),
        correlation=float(np.sqrt(both)),
        likelihood=float(likelihood[best]),
        second=float(np.max(likelihood[far], initial=0.0)),
    )


def _on_grid_turning(turning: Turning, start: float) -> tuple[Array, Array]:
    """Rates (n, 3) rad/s, 0.1 s means, on a grid from `start` on, and where they are known, (n,)."""
    n = int((turning.end[-1] - start) / GRID) + 1
    t = start + GRID * (np.arange(n) + 0.5)
    k = np.minimum(np.searchsorted(turning.end, t), len(turning) - 1)
    known = (turning.begin[k] <= t) & (t <= turning.end[k])
    rate = turning.rotation[k] / (turning.end[k] - turning.begin[k])[:, None]
    return _means(np.where(known[:, None], rate, 0.0), known)


def _on_grid_counts(counts: Travel) -> tuple[Array, Array]:
    n = max(1, int((counts.end - counts.begin) / GRID))
    edges: Array = counts.begin + GRID * np.arange(n + 1, dtype=float)
    rate = np.diff(counts.at(edges), axis=0) / GRID
    return _means(rate, counts.covers(edges[:-1], edges[1:] - 1e-9))


def _means(values: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Sliding means, where all that goes into them is known."""
    box = np.ones(_BAND) / _BAND
    whole = np.convolve(known, box, mode="same") > 1.0 - 0.5 / _BAND
    smooth = np.stack([np.convolve(values[:, k], box, mode="same") for k in range(values.shape[1])], axis=1)
    return np.where(whole[:, None], smooth, 0.0), whole.astype(float)
