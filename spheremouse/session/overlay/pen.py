"""Marks on a picture: lines, ellipses and letters that can be seen on any ground."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]  # blue, green, red
WHITE, GREEN, RED, BLUE, OUTLINE = (255, 255, 255), (90, 220, 60), (40, 40, 255), (230, 150, 60), (200, 200, 120)  # BGR
SHADOW = (40, 40, 40)
_FRACTIONAL_BITS = 4  # fractional bits of OpenCV's drawing coordinates: a sixteenth of a pixel
_BLOCKS_ACROSS = 24  # across a picture: six across a head that fills a quarter of it
EPOCHS = 15  # epochs that fade: half a second


def canvas_of(image: Image, scale: int) -> Image:
    """A copy of a frame, grey or BGR, in colour and enlarged."""
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    if scale != 1:
        canvas = cv2.resize(canvas, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(canvas, dtype=np.uint8)


def masked(image: Image, keep: Image) -> Image:
    """Return a copy of an image, (h, w, 3) or (h, w), that is black where `keep`, (h, w), is 0."""
    return np.asarray(cv2.copyTo(image, keep), dtype=np.uint8)


def in_blocks(image: Image, keep: Image) -> Image:
    """Return a copy of a frame in blocks too coarse to recognise a person, except where `keep`, (h, w), is not 0."""
    h, w = image.shape[:2]
    blocks = cv2.resize(image, (_BLOCKS_ACROSS, max(1, round(_BLOCKS_ACROSS * h / w))), interpolation=cv2.INTER_AREA)
    made = cv2.resize(blocks, (w, h), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.copyTo(image, keep, made), dtype=np.uint8)


class Pen:
    """Draws in the frame's pixels on a canvas `scale` times as large. Lines that leave the picture are cut."""

    def __init__(self, canvas: Image, scale: int) -> None:
        self._canvas, self._scale = canvas, scale
        self._written: list[tuple[int, int, int]] = []  # where words are, px: beginning, baseline, length
        self.width = max(1, round(min(canvas.shape[:2]) / 480))  # of a thin line, px

    def outline(self, points: Array) -> None:
        """A ball's outline, (n, 2) px: thin, as it is not detected but known."""
        before = self._canvas.copy()
        self._stroke(points, OUTLINE, self.width, closed=True)
        cv2.addWeighted(self._canvas, 0.55, before, 0.45, 0.0, dst=self._canvas)

    def ellipse(self, centre: Array, shape: Array, colour: Colour, weight: float = 1.0) -> None:
        """An ellipse about a centre, (2,) px, of a shape, (2, 2) px²."""
        angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        values, vectors = np.linalg.eigh(shape)  # a rounded shape may have no Cholesky factor
        rim = centre + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ (vectors * np.sqrt(values.clip(0.0))).T
        for shade, width in ((SHADOW, 3 * self.width), (_dull(colour, weight), self.width)):  # seen on light ground too
            self._stroke(rim, shade, width, closed=True)

    def trace(self, epochs: list[Array]) -> None:
        """Dots at (m, 2) px of each epoch, the newest last: older ones smaller and fainter."""
        alpha = np.zeros(self._canvas.shape[:2], np.uint8)
        for age, points in reversed(list(enumerate(reversed(epochs)))):
            freshness = 1.0 - age / EPOCHS
            radius = (0.9 + 1.9 * freshness) * self.width
            level = round(255 * (1.0 if age == 0 else 0.15 + 0.6 * freshness))
            for p in self._to_fixed_point(points):
                x, y = int(p[0]), int(p[1])
                cv2.circle(alpha, (x, y), round(radius * 2**_FRACTIONAL_BITS), level, -1, cv2.LINE_AA, _FRACTIONAL_BITS)
        rows, columns = np.nonzero(alpha)
        share = alpha[rows, columns, None].astype(np.float32) / 255.0
        mixed = self._canvas[rows, columns] * (1.0 - share) + np.array(RED, np.float32) * share
        self._canvas[rows, columns] = np.rint(mixed).astype(np.uint8)

    def cross(self, centre: Array) -> None:
        """A diagonal cross on a look-alike, (2,) px."""
        r = 5.0 * self.width / self._scale
        for arm in (np.array([r, r]), np.array([r, -r])):
            self._stroke(np.array([centre - arm, centre + arm]), BLUE, 2 * self.width)

    def target(self, code: str, centre: Array, shape: Array) -> None:
        """A ring around a target at (2,) px with an outer ring of a shape, (2, 2) px², a crosshair, and its code."""
        self.ellipse(centre, 1.6 * shape, GREEN)
        across = np.sqrt(np.diag(shape))
        for arm in 1.75 * np.diag(across):
            self._stroke(np.array([centre - arm, centre + arm]), GREEN, self.width)
        self.label(code, centre + (1.5, -1.1) * across, GREEN)

    def label(self, text: str, at: Array, colour: Colour) -> None:
        """Words that begin at a place, (2,) px, or as near to it as they are in the picture and below others."""
        h, w = self._canvas.shape[:2]
        (long, high), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 11 * self.width / _LETTER_HEIGHT_PX, 1)
        x, y = np.rint(np.nan_to_num(at) * self._scale).tolist()
        x, y = int(min(max(x, 0), w - long - 1)), int(min(max(y, high), h - 3 * high))
        while any(abs(x - a) < max(long, n) and abs(y - b) < 1.3 * high for a, b, n in self._written) and y < h:
            y += round(1.3 * high)
        self._written.append((x, y, long))
        _text(self._canvas, text, (x + self.width, y + self.width), 11 * self.width, SHADOW)
        _text(self._canvas, text, (x, y), 11 * self.width, colour)

    def caption(self, cells: Sequence[tuple[str, float]], height: int = 11) -> None:
        """A strip along the lower edge: words, each from a share of the width on, so that numbers do not dance."""
        h, w = self._canvas.shape[:2]
        size = height * self.width
        top = h - 2 * size
        self._canvas[top:] = self._canvas[top:] // 4
        for text, place in cells:
            _text(self._canvas, text, (round(place * w), h - round(0.65 * size)), size, (235, 235, 235))

    def _stroke(self, points: Array, colour: Colour, width: int, *, closed: bool = False) -> None:
        """Draw a line, (n, 2) px."""
        lines = [self._to_fixed_point(points)]
        cv2.polylines(self._canvas, lines, closed, colour, width, cv2.LINE_AA, _FRACTIONAL_BITS)

    def _to_fixed_point(self, points: Array) -> NDArray[np.int32]:
        """Frame pixels to OpenCV's fixed point on the canvas; pixel centres stay pixel centres."""
        at = (np.asarray(points, dtype=float) + 0.5) * self._scale - 0.5
        return np.rint(np.clip(at, -1e5, 1e5) * 2**_FRACTIONAL_BITS).astype(np.int32)


_LETTER_HEIGHT_PX = 22.0  # px high at font scale 1


def _dull(colour: Colour, weight: float) -> Colour:
    b, g, r = (round(weight * c + (1.0 - weight) * 110) for c in colour)
    return b, g, r


def _text(image: Image, text: str, at: tuple[int, int], height: float, colour: Colour) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, height / _LETTER_HEIGHT_PX, colour, 1, cv2.LINE_AA)
