"""The default disc detector: local contrast finds them, a fit of the expected image measures them.

A disc is where the image is darker than its surroundings (grey closing wider than a disc) by a part of them: a ratio,
so that neither the level of the light nor its slope matters. Around each such place the image is fitted by a sloped
background minus a blurred ellipse whose shape the geometry gives; centre, size and contrast come out of the fit, with a
covariance. Pixels that fit neither (a strut, a highlight) are weighted down (Tukey's biweight); a fit that lost
its rim is none.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from spheremouse.camera import Pose
from spheremouse.detect.cap import Appearance, appearance, ball_mask, largest_disc
from spheremouse.detect.detections import Detections, Image, no_detections
from spheremouse.rig import Rig, directions_at
from spheremouse.rotation import Array
from spheremouse.settings import param

_LENS_BLUR = 0.4  # px, standard deviation of an ordinary lens in focus; the fitted size takes up what differs
_SURROUND = 4.0  # px of background around a disc that take part in the fit: enough for its slope, too few for more
_ITERATIONS = 4
_RIM_OFF = 0.35  # px by which lens blur and gloss may shift a rim: to a sliver's size that is a lot


@dataclass(frozen=True, slots=True)
class DiscSettings:
    """What a disc is, beyond its geometry."""

    polarity: Literal["dark", "light"] = param("dark", "-", "discs darker or lighter than the ball")
    contrast: float = param(
        0.25,
        "-",
        "least darkness against the background; print is 0.8, haze and gloss halve it, its edge is at half of that",
        gt=0,
        lt=1,
    )
    smoothing: float = param(0.8, "px", "standard deviation of the Gaussian before all else: about one pixel", ge=0)
    size_tolerance: float = param(
        0.25,
        "-",
        "fitted over expected size may differ from 1 by this part: hand-cut discs, glare on a rim",
        gt=0,
        lt=1,
    )
    rim: float = param(
        0.45, "-", "least part of a disc's rim that must fit: half a rim and the known size fix a centre", gt=0, le=1
    )
    min_area: float = param(10.0, "px²", "smaller discs are not looked for: 3.6 px across, the size of noise", gt=0)
    sigma: float = param(0.05, "px", "floor of a centre's standard deviation: sampling, shading, print", gt=0)


@dataclass(frozen=True, slots=True)
class DiscDetector:
    """Everything that stays the same while the camera stands."""

    settings: DiscSettings
    rig: Rig
    pose: Pose
    window: tuple[slice, slice]  # rows and columns of the ball's bounding box
    mask: Image  # 255 on the ball within the window
    diameter: float  # px, of the largest disc

    def detect(self, image: Image) -> Detections:
        """Disc candidates in an image (h, w, 3) BGR or (h, w), look-alikes included."""
        grey, noise = self._grey(image)
        places, size, background = self._dark_places(grey, noise)
        directions, index = directions_at(places + self.origin, self.rig, self.pose)
        seen = appearance(directions, self.rig, self.pose)
        share = size[index] / seen.area
        # half a disc to one with its shadow; of several regions in one place that which covers a disc best
        plausible = (seen.area >= self.settings.min_area) & (share > 0.3) & (share < 2.5) & self._inside(seen)
        best = np.flatnonzero(plausible)[np.argsort(np.abs(np.log(share[plausible])), kind="stable")]
        best = best[_first_of_each(places[index][best], 0.3 * self.diameter)]
        return self._fit(grey, noise, places[index][best], background[index][best], seen.take(best))

    def _grey(self, image: Image) -> tuple[Image, float]:
        """Smoothed grey of the window, dark discs, and the noise of one pixel before smoothing, grey values."""
        grey = image[self.window]
        if grey.ndim == 3:
            grey = cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY)
        if self.settings.polarity == "light":
            grey = cv2.bitwise_not(grey)
        grey = grey.astype(np.float32)
        noise = _noise(grey)
        if self.settings.smoothing > 0:
            grey = cv2.GaussianBlur(grey, (0, 0), self.settings.smoothing)
        return grey, noise

    def _dark_places(self, grey: Image, noise: float) -> tuple[Array, Array, Array]:
        """Compact regions darker than what surrounds them: centroids (n, 2) px in the window, areas, backgrounds.

        Looked for at three levels: the low one finds slivers at the limb, the high one parts a disc from a shadow.
        """
        flat = grey.astype(np.uint8)
        width = 2 * int(np.ceil(0.75 * self.diameter)) + 1
        background = cv2.morphologyEx(flat, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
        deep = cv2.inRange(cv2.subtract(background, flat), np.array(4.0 * noise + 1.0), np.array(255.0))
        deep = cv2.bitwise_and(deep, self.mask)
        places, sizes = [], []
        for share in (0.6, 1.2, 2.4):
            level = cv2.convertScaleAbs(background, alpha=max(1.0 - share * self.settings.contrast, 0.0))
            dark = cv2.bitwise_and(cv2.compare(flat, level, cv2.CMP_LT), deep)
            contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            for contour in contours:
                if len(contour) < 4:
                    continue
                _, _, w, h = cv2.boundingRect(contour)
                if max(w, h) > 1.2 * self.diameter + 3:
                    continue
                # the outline runs through pixel centres: Pick's theorem gives the pixels it holds
                area = cv2.contourArea(contour) + 0.5 * len(contour) + 1.0
                if area < 0.3 * self.settings.min_area:
                    continue
                places.append(_centroid(contour))
                sizes.append(area)
        where = np.array(places, dtype=float).reshape(-1, 2)
        at = np.rint(where).astype(int)
        return where, np.array(sizes, dtype=float), background[at[:, 1], at[:, 0]].astype(float)

    def _fit(
        self, grey: Image, noise: float, start: Array, background: Array, seen: Appearance
    ) -> Detections:
        """Fit I = b0 + b1 x + b2 y - a e(x - c; s) by Gauss-Newton with Tukey weights.

        e is the blurred ellipse; unknown are the background b (3), the contrast a, the centre c (2) and the size s.
        All pixels of all discs lie in one row, disc after disc: what is done to a pixel is done to all at once.
        """
        n = len(start)
        if n == 0:
            return no_detections()
        pixels = _Pixels.around(start, seen.shape, self.mask, self.diameter)
        disc = pixels.disc
        image = grey[pixels.row, pixels.column].astype(float)
        inverse = np.asarray(np.linalg.inv(seen.shape), dtype=float)
        blur = float(np.sqrt(self.settings.smoothing**2 + 1.0 / 12.0 + _LENS_BLUR**2))
        at = np.rint(start).astype(int)
        contrast = background - grey[at[:, 1], at[:, 0]]
        scale = np.maximum(noise, 0.02 * np.abs(contrast))  # shading and print: two percent of the contrast
        prior = (scale / (0.4 * self.settings.size_tolerance)) ** 2
        # unknowns: b0, b1, b2, a, cx, cy, s; the origin of each disc's coordinates is its start
        x = np.zeros((n, 7))
        x[:, 0], x[:, 3], x[:, 6] = background, contrast, 1.0
        step = np.zeros((n, 7))
        N = np.zeros((n, 7, 7))
        weight = np.ones_like(image)
        residual = image
        e, de = _blurred_ellipse(pixels, x, inverse, blur)
        for iteration in range(_ITERATIONS):
            p = x[disc]
            residual = image - (p[:, 0] + p[:, 1] * pixels.x + p[:, 2] * pixels.y - p[:, 3] * e)
            if iteration:  # the first step brings the model near: no pixel is an outlier before that
                spread = 1.4826 * np.array([_median(np.abs(residual[k])) for k in pixels.of])
                limit = 4.685 * np.maximum(spread, scale)
                weight = np.maximum(0.0, 1.0 - (residual / limit[disc]) ** 2) ** 2
            A = np.stack([np.ones_like(e), pixels.x, pixels.y, -e, *(-p[:, 3] * de)], axis=1)
            Aw = A * weight[:, None]
            N = np.array([Aw[k].T @ A[k] for k in pixels.of]) + 1e-6 * np.eye(7)
            gradient = np.array([residual[k] @ Aw[k] for k in pixels.of])
            N[:, 6, 6] += prior  # a sliver cannot tell size from contrast: there the known size decides
            gradient[:, 6] -= prior * (x[:, 6] - 1.0)
            step = np.linalg.solve(N, gradient[:, :, None])[:, :, 0]
            step[:, 4:6] = np.clip(step[:, 4:6], -1.0, 1.0)
            step[:, 6] = np.clip(step[:, 6], -0.2, 0.2)
            x += step
            x[:, 6] = np.clip(x[:, 6], 0.3, 2.5)
            e, de = _blurred_ellipse(pixels, x, inverse, blur)
        rim = np.hypot(de[0], de[1])
        whole = 2.0 * np.pi * np.sqrt(np.trace(seen.shape, axis1=1, axis2=2) / 2.0)  # px, the rim integrated across
        rim_seen = np.array([rim[k] @ weight[k] for k in pixels.of]) / whole
        freedom = np.array([weight[k].sum() for k in pixels.of]) - 7.0
        misfit = np.array([weight[k] @ residual[k] ** 2 for k in pixels.of]) / np.maximum(freedom, 1.0)
        variance = np.maximum(misfit, noise**2)
        covariance = np.linalg.inv(N)[:, 4:6, 4:6] * variance[:, None, None] + self.settings.sigma**2 * np.eye(2)
        b0, b1, b2, a, cx, cy, size = x.T
        sliver = np.sqrt(np.linalg.eigvalsh(seen.shape)[:, 0])  # semi-minor axis, px
        ok = (
            (a > np.maximum(self.settings.contrast * (b0 + b1 * cx + b2 * cy), 4.0 * noise))
            & (np.abs(size - 1.0) < np.maximum(self.settings.size_tolerance, _RIM_OFF / sliver))
            & (rim_seen > self.settings.rim)
            & (np.abs(step[:, 4:6]).max(axis=1) < 0.1)
        )
        centre = x[:, 4:6] + start + self.origin - (seen.centroid - seen.centre)
        best = np.flatnonzero(ok)[np.argsort(-rim_seen[ok], kind="stable")]
        return Detections(centre, covariance, seen.area).take(best[_first_of_each(centre[best], 0.3 * self.diameter)])

    def _inside(self, seen: Appearance) -> NDArray[np.bool_]:
        """Whose whole ellipse lies in the window."""
        half = np.sqrt(np.stack([seen.shape[:, 0, 0], seen.shape[:, 1, 1]], axis=1))
        p = seen.centroid - self.origin
        with np.errstate(invalid="ignore"):
            return np.all((p - half > -0.5) & (p + half < np.array(self.mask.shape[::-1]) - 0.5), axis=1)

    @property
    def origin(self) -> Array:
        """(2,) px, the window's first column and row."""
        return np.array([self.window[1].start, self.window[0].start], dtype=float)


def disc_detector(settings: DiscSettings, rig: Rig, pose: Pose) -> DiscDetector:
    """Prepare the detector for a camera that stands still."""
    mask = cv2.erode(ball_mask(rig, pose), np.ones((3, 3), np.uint8))  # pixels on the outline mix with the room
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    window = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    return DiscDetector(settings, rig, pose, window, mask[window].copy(), largest_disc(rig, pose))


def _first_of_each(points: Array, radius: float) -> NDArray[np.intp]:
    """Indices of points, (n, 2), that have no earlier one within `radius`."""
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < radius
    return np.flatnonzero(~np.tril(near, -1).any(axis=1))


def _noise(grey: Image) -> float:
    """Standard deviation of a pixel, grey values, from second differences along every eighth row."""
    rows = grey[::8]
    difference = rows[:, 1:-1] - 0.5 * (rows[:, :-2] + rows[:, 2:])
    return max(float(np.median(np.abs(difference))) * 1.4826 / np.sqrt(1.5), 0.29)


def _median(values: Array) -> float:
    """Upper median, without what np.median adds to it: this runs a hundred times a frame."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle]) if len(values) else 0.0


def _centroid(contour: Image) -> tuple[float, float]:
    m = cv2.moments(contour)
    if m["m00"] > 0:
        return m["m10"] / m["m00"], m["m01"] / m["m00"]
    x, y = contour[:, 0].mean(axis=0)
    return float(x), float(y)


@dataclass(frozen=True, slots=True)
class _Pixels:
    """The pixels around n discs, disc after disc."""

    disc: NDArray[np.intp]  # (k,) whose
    row: NDArray[np.intp]  # (k,) in the window
    column: NDArray[np.intp]  # (k,)
    x: Array  # (k,) px from the disc's start
    y: Array  # (k,)
    of: list[slice]  # n slices into them

    @staticmethod
    def around(start: Array, shape: Array, mask: Image, diameter: float) -> "_Pixels":
        """Those within _SURROUND px of the expected rim and on the ball (`mask`)."""
        reach = int(np.ceil(diameter / 2 + _SURROUND))
        span = np.arange(-reach, reach + 1)
        base = np.rint(start).astype(int)
        row = np.broadcast_to(base[:, 1, None, None] + span[:, None], (len(start), len(span), len(span)))
        column = np.broadcast_to(base[:, 0, None, None] + span[None, :], row.shape)
        x, y = column - start[:, 0, None, None], row - start[:, 1, None, None]
        inverse = np.linalg.inv(_grown(shape, _SURROUND))
        q = inverse[:, 0, 0, None, None] * x * x + inverse[:, 1, 1, None, None] * y * y
        q += 2.0 * inverse[:, 0, 1, None, None] * x * y
        height, width = mask.shape
        near = (q < 1.0) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
        near[near] = mask[row[near], column[near]] > 0
        disc = np.nonzero(near)[0]
        edge = np.searchsorted(disc, np.arange(len(start) + 1))
        of = [slice(int(a), int(b)) for a, b in pairwise(edge)]
        return _Pixels(disc, row[near], column[near], x[near], y[near], of)


def _grown(shape: Array, margin: float) -> Array:
    """Ellipses, (n, 2, 2), whose axes are longer by `margin` px."""
    values, vectors = np.linalg.eigh(shape)
    values = (np.sqrt(np.maximum(values, 0.0)) + margin) ** 2
    return (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)


def _blurred_ellipse(pixels: _Pixels, x: Array, inverse: Array, blur: float) -> tuple[Array, Array]:
    """e, (k,), of every pixel and its derivatives by centre x, y and size, (3, k).

    With rho^2 = (x - c)^T S^-1 (x - c) the rim lies (s - rho) / |grad rho| ahead and (s + rho) / |grad rho| behind;
    a strip of that width, blurred, is e = L(ahead) + L(behind) - 1. L is the logistic function of the Gaussian's
    width: within 1 % of it, and its own derivative.
    """
    M = inverse[pixels.disc]
    dx, dy = pixels.x - x[pixels.disc, 4], pixels.y - x[pixels.disc, 5]
    size = x[pixels.disc, 6]
    gx = M[:, 0, 0] * dx + M[:, 0, 1] * dy
    gy = M[:, 0, 1] * dx + M[:, 1, 1] * dy
    rho = np.sqrt(np.maximum(gx * dx + gy * dy, 1e-9))
    slope = np.maximum(np.hypot(gx, gy), 1e-9)  # times rho
    steep = 1.702 / blur * rho / slope
    ahead, behind = expit((size - rho) * steep), expit((size + rho) * steep)
    bell_ahead, bell_behind = steep * ahead * (1.0 - ahead), steep * behind * (1.0 - behind)
    by_rho = (bell_ahead - bell_behind) / rho  # minus de/drho; rho falls by g / rho along dc
    return ahead + behind - 1.0, np.stack([by_rho * gx, by_rho * gy, bell_ahead + bell_behind])
