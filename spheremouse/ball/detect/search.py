"""Search for unknown discs during tracking: a lattice of samples over the ball, a part in each frame.

A sample is a candidate if it is darker than the ball on nearly all sides, at a little more than a disc's radius. Along
the limb it must be darker than both sides, because a disc ends there and the blur of the limb does not. Four frames,
each with a shifted lattice, detect every disc that is large enough. The first frame detects a disc of ordinary size.
For a while the search leaves out places that proved not to be discs, so that struts cost no time.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.geometry.rotation import Array

_STRIDE = (2, 8)  # columns and rows of the coarse picture between samples of one frame: few rows are few cache misses
_SHIFTS = ((0, 0), (1, 4), (0, 2), (1, 6))  # of the lattice, frame after frame: together every other row
_MARGIN = 2.5  # px beyond a disc's radius at which the ball is looked at: blur, and a sample off the centre


class Samples(NamedTuple):
    """Samples of the ball in one frame, n pixels."""

    place: NDArray[np.int32]  # (n, 2) column and row, px, on the ball
    sides: NDArray[np.uint8]  # (n,) bits of the neighbours that lie on the ball
    along: NDArray[np.int32]  # (n, 2, 2) px to both sides along the limb; 0 away from it


class Lattice(NamedTuple):
    """Search grid for unknown discs, built once."""

    samples: tuple[Samples, ...]  # of each shift
    offsets: NDArray[np.int32]  # (8, 2) px to the neighbours, opposite ones follow each other
    reduction: int  # a large picture is searched so much more coarsely

    def at(self, where: NDArray[np.bool_]) -> "Lattice":
        """Return the lattice with the samples at pixels `where`, (h, w)."""
        inside = [where[s.place[:, 1], s.place[:, 0]] for s in self.samples]
        part = tuple(Samples(s.place[k], s.sides[k], s.along[k]) for s, k in zip(self.samples, inside, strict=True))
        return self._replace(samples=part)

    def of_turn(self, turn: int) -> tuple[Samples, NDArray[np.int32], int]:
        """Return the samples of one frame, the offsets and the reduction."""
        return self.samples[turn % len(_SHIFTS)], self.offsets, self.reduction


class SearchState(NamedTuple):
    """State of the search between frames."""

    turn: int = 0
    noise: float = 0.0  # grey values, of a pixel of the projection; 0: not measured yet
    size: float = 0.0  # fitted over expected, of all discs; 0: not known
    # (k, 4) places that were no discs, px, the turn before which each is left out, and for how many turns it was
    rejected: Array = np.zeros((0, 4))
    contrast: float = 0.0  # usual one of a disc, over the light of the lighter of disc and ball; 0: not known
    sample_noise: float = 0.0  # grey values, of a pixel as the search reads it


def lattice(mask: Image, thin: NDArray[np.bool_], diameter: float, reduction: int) -> Lattice:
    """Return samples on the ball's `mask`, (h, w), for discs of up to `diameter` px.

    In the mask `thin`, (h, w), the lattice does not widen with `reduction`. Coarse samples would miss a sliver near the
    limb, which is long and only one or two pixels wide.
    """
    h, w = mask.shape
    d = 0.5 * diameter + _MARGIN * reduction
    angles = np.pi / 4 * np.array([0, 4, 2, 6, 1, 5, 3, 7])
    offsets = np.rint(d * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.int32)
    samples = []
    limb = _Limb(mask)
    for dx, dy in _SHIFTS:
        parts = []
        for step, part in ((reduction, ~thin), (1, thin)):
            y, x = np.mgrid[dy * step : h : _STRIDE[1] * step, dx * step : w : _STRIDE[0] * step]
            on = (mask[y, x] > 0) & part[y, x]
            parts.append(np.stack([x[on], y[on]], axis=1).astype(np.int32))
        at = np.concatenate(parts)
        bits = np.zeros(len(at), dtype=np.uint8)
        for k, (ox, oy) in enumerate(offsets):
            u, v = at[:, 0] + ox, at[:, 1] + oy
            inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
            inside[inside] = mask[v[inside], u[inside]] > 0
            bits |= (inside.astype(np.uint8) << k).astype(np.uint8)
        samples.append(Samples(at, bits, limb.along(at, d)))
    return Lattice(tuple(samples), offsets, reduction)


class _Limb:
    """Distance and direction to the edge of a mask, (h, w), from pixels inside it."""

    def __init__(self, mask: Image) -> None:
        depth = cv2.distanceTransform(cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT), cv2.DIST_L2, 5)
        self._depth = depth[1:-1, 1:-1]  # px from the edge
        smooth = cv2.GaussianBlur(self._depth, (0, 0), 3.0)
        self._inward = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)], axis=2)

    def along(self, at: NDArray[np.int32], distance: float) -> NDArray[np.int32]:
        """Offsets, (n, 2, 2) px, from pixels `at`, (n, 2), to two `distance` px along the edge, as deep; 0 far off."""
        depth, inward = self._depth[at[:, 1], at[:, 0]], self._inward[at[:, 1], at[:, 0]]
        inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-6)
        offsets = np.zeros((len(at), 2, 2), dtype=np.int32)
        for k, sign in enumerate((1.0, -1.0)):
            there = at + sign * distance * inward[:, ::-1] * (1.0, -1.0)
            h, w = self._depth.shape
            x, y = (np.clip(np.rint(there[:, j]).astype(int), 0, n - 1) for j, n in ((0, w), (1, h)))
            there += (depth - self._depth[y, x])[:, None] * inward  # an edge is bent
            offsets[:, k] = np.rint(there) - at
        inside = (at[:, None] + offsets >= 0) & (at[:, None] + offsets < (self._depth.shape[1], self._depth.shape[0]))
        offsets[(depth > distance) | ~inside.all(axis=(1, 2))] = 0
        return offsets
