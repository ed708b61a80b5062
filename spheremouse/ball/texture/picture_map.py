"""The picture of a ball's pattern as a map: what a file keeps for the next run.

The frame of the picture is `ball`. Two pictures are compared like a frame and a picture: the places of one are the
samples, and the search of all attitudes finds how the other lies.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.disc_map import DiscMap, variances
from spheremouse.ball.filters import so3_map
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import SURE, Recognising, TrackState
from spheremouse.ball.texture.picture import (
    LEAST_WEIGHT,
    Alignment,
    AlignmentScale,
    Picture,
    Samples,
    align_samples,
    contrast_noise,
    contrast_of_samples,
    first_seen,
    grain_of,
    without_past,
)
from spheremouse.ball.texture.search import (
    FRAMES_PER_SEARCH,
    MIN_CORRELATION,
    Level,
    TextureDetector,
    TextureState,
    attitudes_of_part,
    best_attitudes,
    fits,
)
from spheremouse.ball.texture.view import HALF, TILE, Floats, anchor_directions, cell_directions
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.tracker import Frame

_MAX_SAMPLES = 16000, 4000  # of the fine and of the coarse picture
_MIN_GAIN_OF_VIEWS = 1.1  # times as many views are worth saving
_CONTOUR_SIGMA = 1e-3  # rad, standard deviation of a contour


@dataclass(frozen=True, slots=True)
class PictureComparison:
    """Comparison of the pictures `a` and `b`."""

    rotation: Array  # (3, 3), directions of b ~ those of a @ rotation.T
    correlation: float
    same_ball: bool

    @property
    def text(self) -> str:
        """The correlation in words."""
        return f"the patterns' correlation is {self.correlation:.2f}"


@dataclass(frozen=True, slots=True)
class PictureMap:
    """The contrast of a ball's surface at two scales, with the usual figures of frames that fit it.

    The standard deviation of a cell is `noise` over the root of its weight.
    """

    fine: Picture
    coarse: Picture
    parts: DiscMap  # directions of the anchors as the filter has them, with their joint covariance
    noise: float  # standard deviation of a contrast in one view
    correlation: float  # usual one of frame and picture
    details: float  # usual share of the coarse samples that show a detail

    kind: ClassVar[str] = "a pattern"
    alteration: ClassVar[str] = "it was painted"

    @property
    def amount(self) -> float:
        """Known part of the ball, %."""
        x, own = cell_directions(self.coarse.value.shape[1]), _own_cells(self.coarse)
        area = np.where(own, np.max(np.abs(x), axis=-1) ** 3, 0.0)  # of a cell, by the distance of its plane place
        return float(100.0 * np.sum(area[self.coarse.weight >= LEAST_WEIGHT]) / np.sum(area))

    @property
    def text(self) -> str:
        """The contents in words."""
        return f"{self.amount:.0f} % of the pattern"

    @property
    def is_finite(self) -> bool:
        """Return whether all cells and covariances are finite."""
        return self.parts.is_finite and all(np.isfinite(p).all() for level in (self.fine, self.coarse) for p in level)

    def improves(self, saved: "PictureMap") -> bool:
        """Return whether the cells have been seen more often than those of a saved map."""
        return float(self.fine.known.sum()) > _MIN_GAIN_OF_VIEWS * float(saved.fine.known.sum())

    def compare(self, other: "PictureMap") -> PictureComparison | None:
        """Compare with another picture in any frame. Return None if they show no sign of the same ball."""
        correlation = partial(kernels.correlate_texture, _samples(self.coarse, _MAX_SAMPLES[1]), other.coarse[:2])
        for part in range(FRAMES_PER_SEARCH):
            for attitude in best_attitudes(correlation, attitudes_of_part(part, FRAMES_PER_SEARCH)):
                found = self.compare_at(other, attitude.T)
                if found.same_ball:
                    return found
        return None

    def compare_at(self, other: "PictureMap", rotation: Array) -> PictureComparison:
        """Compare with another picture, whose directions are about those of this one @ rotation.T, (3, 3)."""
        rough = _align(_samples(self.coarse, _MAX_SAMPLES[1]), other.coarse, rotation.T, self.noise)
        if not rough.correlation > MIN_CORRELATION:
            return PictureComparison(rotation, rough.correlation, same_ball=False)
        found = _align(_samples(self.fine, _MAX_SAMPLES[0]), other.fine, rough.attitude, self.noise)
        return PictureComparison(found.attitude.T, found.correlation, fits(found))

    def turned(self, rotation: Array) -> "PictureMap":
        """Return the map in a frame rotated by (3, 3): the new directions are the old ones @ rotation.T.

        The anchors are the same directions in any frame. So they get the mean variance of those before.
        """
        fine, coarse = (_rotate(picture, rotation) for picture in (self.fine, self.coarse))
        anchors, variance = anchor_directions(), float(variances(self.parts).mean())
        sightings = np.full(len(anchors), np.median(self.parts.sightings), dtype=np.intp)
        parts = DiscMap(anchors, variance * np.eye(2 * len(anchors)), sightings)
        return replace(self, fine=fine, coarse=coarse, parts=parts)


def to_map(state: TrackState[So3State]) -> PictureMap | None:
    """Return the picture to save; None if it identifies no attitude.

    That is before the ball has turned, while its attitude on a saved picture is unknown, and if it repeats itself.
    """
    now = state.search
    if isinstance(state.phase, Recognising) or not isinstance(now, TextureState) or not now.turned:
        return None
    parts = so3_map.to_map(state.filter, SURE)
    if parts is None or now.usual == 0.0 or now.repeats:
        return None
    details = now.details / max(len(now.coarse.seen.least), 1)
    return PictureMap(now.fine.picture, now.coarse.picture, parts, now.noise, now.usual, details)


def recall(state: TrackState[So3State], known: BallMap) -> TrackState[So3State]:
    """Return the state in which the ball is recognised by a saved picture first."""
    if not isinstance(known, PictureMap):
        return state
    return state._replace(phase=Recognising(), filter=so3_map.with_map(state.filter, known.parts), search=known)


def state_from_map(detector: TextureDetector, frame: Frame, saved: PictureMap) -> TextureState:
    """Return the state of a detector that has a saved picture, before its first frame."""
    shown, light = detector.light(frame.image)
    grain = grain_of(detector.resampling, frame.image)
    levels = []
    for view, one, picture in zip(detector.views, shown, (saved.fine, saved.coarse), strict=True):
        seen = without_past(first_seen(view, contrast_of_samples(view, one)))
        levels.append(Level(seen, resize(picture, view.cells)))
    fine, coarse = levels
    details = saved.details * len(detector.coarse.at)
    anywhere = np.eye(3)
    return TextureState(
        detector.fine,
        fine,
        coarse,
        grain,
        contrast_noise(grain, light),
        anywhere,
        anywhere,
        proven=True,
        turned=True,
        usual=saved.correlation,
        details=details,
    )


def resize(picture: Picture, cells: int) -> Picture:
    """Return a picture with another number of cells along a face, a multiple of `TILE`."""
    if picture.value.shape[1] == cells:
        return picture
    by = cv2.INTER_AREA if cells < picture.value.shape[1] else cv2.INTER_LINEAR
    value, weight = (np.stack([cv2.resize(face, (cells, cells), interpolation=by) for face in p]) for p in picture[:2])
    unseen = np.stack([cv2.resize((face < LEAST_WEIGHT).astype(np.float32), (cells, cells)) for face in picture.weight])
    return with_known(value, np.where(unseen > 0.0, 0.0, weight))


def with_known(value: Array | Floats, weight: Array | Floats) -> Picture:
    """Return the picture with values and weights, (6, n, n), of its cells."""
    tiles = weight.shape[1] // TILE
    known = weight.reshape(6, tiles, TILE, tiles, TILE).mean(axis=(2, 4))
    return Picture(*(np.ascontiguousarray(part, dtype=np.float32) for part in (value, weight, known)))


def look(picture: Picture, directions: Array) -> tuple[Array, Array]:
    """Return value and weight, (...), that a picture shows at directions (..., 3), between four cells."""
    x = directions.reshape(-1, 3)
    axis, n = np.argmax(np.abs(x), axis=1), picture.value.shape[1]
    k = np.arange(len(x))
    face = 2 * axis + (x[k, axis] < 0.0)
    at = np.stack([x[k, (axis + 1) % 3], x[k, (axis + 2) % 3]]) / np.abs(x[k, axis])
    place = (at + HALF) * n / (2.0 * HALF) - 0.5
    row, column = np.floor(place).astype(int)
    down, right = place - (row, column)
    value, weight = np.zeros(len(x)), np.full(len(x), np.inf)
    for i, j, share in (
        (0, 0, (1.0 - down) * (1.0 - right)),
        (1, 0, down * (1.0 - right)),
        (0, 1, (1.0 - down) * right),
        (1, 1, down * right),
    ):
        value += share * picture.value[face, row + i, column + j]
        weight = np.minimum(weight, picture.weight[face, row + i, column + j])
    return value.reshape(directions.shape[:-1]), weight.reshape(directions.shape[:-1])


def unfold(picture: Picture, width: int) -> Image:
    """Return a picture by longitude and latitude in `ball`, (width / 2, width, 3) BGR; unknown cells are blue.

    The pole is Y, and Z is in the middle: longitude grows to the right, towards X.
    """
    longitude = np.pi * (2.0 * (np.arange(width) + 0.5) / width - 1.0)
    latitude = np.pi * (0.5 - 2.0 * (np.arange(width // 2) + 0.5) / width)
    x = np.cos(latitude)[:, None] * np.sin(longitude)
    z = np.cos(latitude)[:, None] * np.cos(longitude)
    value, weight = look(picture, np.stack([x, np.broadcast_to(np.sin(latitude)[:, None], x.shape), z], axis=-1))
    known = weight >= LEAST_WEIGHT
    largest = max(float(np.percentile(np.abs(value[known]), 99.0)), 1e-6) if known.any() else 1.0
    grey = np.clip(128.0 * (1.0 + value / largest), 0.0, 255.0).astype(np.uint8)
    return np.where(known[..., None], grey[..., None], np.array([120, 60, 30], np.uint8))


def _rotate(picture: Picture, rotation: Array) -> Picture:
    return with_known(*look(picture, cell_directions(picture.value.shape[1]) @ rotation))


def _own_cells(picture: Picture) -> NDArray[np.bool_]:
    """True for the cells, (6, n, n), that no other face shows as well."""
    n = picture.value.shape[1]
    at = np.abs((2.0 * (np.arange(n) + 0.5) / n - 1.0) * HALF) <= 1.0
    return np.broadcast_to(at[:, None] & at, picture.value.shape)


def _samples(picture: Picture, most: int) -> Samples:
    """Return up to `most` known cells of a picture as samples of a frame in which the ball is seen from all sides."""
    index = np.flatnonzero(_own_cells(picture) & (picture.weight >= LEAST_WEIGHT))
    index = index[:: max(len(index) // most, 1)]
    direction = cell_directions(picture.value.shape[1]).reshape(-1, 3)[index].astype(np.float32)
    zero = np.zeros(len(index), np.float32)
    return picture.value.ravel()[index], np.ascontiguousarray(direction.T), zero, zero


def _align(samples: Samples, picture: Picture, attitude: Array, noise: float) -> Alignment:
    pixel, one_anchor = 2.0 * HALF / picture.value.shape[1], np.zeros(picture.known.shape, np.int64)
    return align_samples(
        samples,
        picture,
        attitude,
        noise,
        AlignmentScale(_CONTOUR_SIGMA, pixel, one_anchor, np.eye(3)[None] * (2.0 / 3.0)),
    )
