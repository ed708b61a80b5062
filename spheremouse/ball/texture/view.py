"""Constant data of a ball with a pattern from one pose of the camera: samples of the chart, tiles and anchors.

A chart (`chart.py`) shows the ball without perspective. Every few pixels of it are a sample. The ball's picture is on
the six faces of a cube, in tiles of cells. Each tile belongs to the nearest of 20 anchors.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import Rig
from spheremouse.ball.texture.chart import Chart
from spheremouse.geometry.camera import Pose, row_of
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels

Floats = NDArray[np.float32]

TILE = kernels.TILE  # cells along the edge of a tile
HALF = 1.1  # half the width of a face, as `picture.h` has it
_CELL_PX = 1.5  # width of a cell, and of a pixel of the chart, where the ball is nearest, px
FINEST, COARSEST = 320, 32  # cells along a face: a ball of 350 px, one of 44 px
SMALL_WIDTH, _LARGE_WIDTH = 0.032, 0.6  # rad, widths of the neighbourhoods; the small one is a mean of means
_MAX_SAMPLES = 16000


@dataclass(frozen=True, slots=True)
class TextureView:
    """Constant data of one camera pose."""

    rig: Rig
    pose: Pose
    chart: Chart
    inside: Image  # (h, w) 255 on the ball, 0 elsewhere, of the chart
    share: Floats  # (h, w) one over the large neighbourhood of a ball of grey value 1
    widths: tuple[int, int]  # px of the chart, of the small and of the large neighbourhood
    step: int  # px from a sample to the next
    number: NDArray[np.int32]  # (rows, columns) the sample at each `step`-th pixel; -1: it has no place on the ball
    place: NDArray[np.intp]  # (n,) of each sample in `number`
    at: NDArray[np.int32]  # (n,) pixel of the chart of each sample
    direction: Floats  # (3, n) obj
    row: Floats  # (n,) of the image, -1/2 at its top to 1/2 at its bottom, that shows each sample
    cells: int  # along a face of the picture
    tiles: Floats  # (m, 3) unit vectors to their middles, ball
    least_height: float  # of a tile's middle over the plane across the view, for one that is learnt; radii
    anchors: Array  # (k, 3) unit vectors, ball
    anchor_of: NDArray[np.int64]  # (6, t, t) the nearest anchor of each tile
    across: Array  # (k, 3, 3) of the tiles of each anchor, mean projection across their directions

    @property
    def pixel(self) -> float:
        """Angle of the ball between two pixels of the chart, rad."""
        return self.chart.spacing


def texture_view(rig: Rig, pose: Pose, chart: Chart, inside: NDArray[np.bool_]) -> TextureView:
    """Return the constant data of a rig's ball as the camera sees it from `pose`.

    `inside`, (size, size), is True where the chart shows the ball.
    """
    small = 2 * max(round(0.5 * SMALL_WIDTH / chart.spacing), 1) + 1
    large = 2 * round(0.5 * _LARGE_WIDTH / chart.spacing) + 1
    shown = inside.astype(np.uint8)
    share = np.float32(1.0) / np.maximum(neighbourhood_mean(shown.astype(np.float32), large), np.float32(1e-3))
    step = max(round(float(np.sqrt(np.count_nonzero(inside) / _MAX_SAMPLES))), 1)
    direction = chart.directions()
    margin = small - 1  # a sample has its whole neighbourhood on the ball
    whole = cv2.erode(shown, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8), borderValue=0)
    samples = (chart.facing(direction) > kernels.FACING) & (whole != 0)
    at = np.zeros_like(samples)
    at[::step, ::step] = samples[::step, ::step]
    number = np.full(at[::step, ::step].shape, -1, np.int32)
    number[samples[::step, ::step]] = np.arange(np.count_nonzero(at))
    cells = int(np.clip(TILE * round(2.0 * HALF / (chart.spacing * TILE)), COARSEST, FINEST))
    anchors, tiles = anchor_directions(), cell_directions(cells // TILE)
    # rad, from the middle of a tile to a corner
    reach = 2.0**0.5 * TILE * HALF / cells
    anchor_of = np.argmax(tiles @ anchors.T, axis=-1)
    return TextureView(
        rig,
        pose,
        chart,
        255 * shown,
        np.asarray(share, np.float32),
        (small, large),
        step,
        number,
        np.flatnonzero(number >= 0),
        np.flatnonzero(at).astype(np.int32),
        np.ascontiguousarray(direction[at].T, dtype=np.float32),
        rows_showing(direction[at], rig, pose).astype(np.float32),
        cells,
        tiles.reshape(-1, 3).astype(np.float32),
        chart.height(kernels.FACING) - reach,
        anchors,
        anchor_of,
        mean_projections(tiles, anchor_of),
    )


def texture_spacing(rig: Rig, pose: Pose) -> float:
    """Return the angle of the ball, rad, between two pixels of a chart that has the details of the picture."""
    return max(_CELL_PX * texture_pixel(rig, pose), 2.0 * HALF / FINEST)


def texture_pixel(rig: Rig, pose: Pose) -> float:
    """Return the angle of the ball, rad, that a pixel shows where the ball is nearest."""
    distance = float(np.linalg.norm(pose.position - rig.ball.centre)) - rig.ball.radius
    return distance / (rig.ball.radius * max(rig.camera.intrinsic[:2]))


def neighbourhood_mean(picture: Image | Floats, width: int) -> Floats:
    """Return the mean of the square of `width` px around each pixel, (h, w)."""
    return np.asarray(cv2.blur(picture, (width, width)), np.float32)


def rows_showing(directions: Array, rig: Rig, pose: Pose) -> Array:
    """Return the rows, (n,) from -1/2 at the image's top to 1/2, that show the ball at `directions`, (n, 3) obj."""
    return row_of(seen_at(directions, rig, pose)[:, 1], rig.camera.height)


def anchor_directions() -> Array:
    """Return the 20 corners of a dodecahedron as unit vectors, (20, 3): anchors 42° apart."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    signs = (-1.0, 1.0)
    cube = [(a, b, c) for a in signs for b in signs for c in signs]
    others = [np.roll([0.0, a / golden, b * golden], k) for k in range(3) for a in signs for b in signs]
    return np.array([*cube, *others]) / 3.0**0.5


def mean_projections(directions: Array, part: NDArray[np.int64]) -> Array:
    """Return the mean projection, (k, 3, 3), across unit vectors, (..., 3), of each part."""
    u, part = directions.reshape(-1, 3), part.ravel()
    number = np.bincount(part)
    along = np.zeros((len(number), 3, 3))
    np.add.at(along, part, u[:, :, None] * u[:, None, :])
    return np.eye(3) - along / number[:, None, None]


def cell_directions(cells: int) -> Array:
    """Return the unit vectors in `ball` of the middles of a picture's cells, or of its tiles, (6, n, n, 3)."""
    at = (2.0 * (np.arange(cells) + 0.5) / cells - 1.0) * HALF
    a, b = np.meshgrid(at, at, indexing="ij")
    found = np.empty((6, cells, cells, 3))
    for face in range(6):
        axis = face // 2
        found[face, ..., axis] = -1.0 if face % 2 else 1.0
        found[face, ..., (axis + 1) % 3], found[face, ..., (axis + 2) % 3] = a, b
    return found / np.linalg.norm(found, axis=-1, keepdims=True)
