"""The default disc detector: local contrast finds them, a fit of the expected image measures them.

A disc is where the image is darker than its surroundings (grey closing wider than a disc) by a part of them: a ratio,
so that neither the level of the light nor its slope matters. Around each such place the image is fitted by a sloped
background minus a blurred ellipse whose shape the geometry gives; centre, size and contrast come out of the fit, with a
covariance. Pixels that fit neither (a strut, a highlight) are weighted down (Tukey's biweight); a fit that lost
its rim is none.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from spheremouse.camera import Pose
from spheremouse.detect.cap import Appearance, appearance, ball_mask, largest_disc
from spheremouse.detect.detections import Detections, no_detections
from spheremouse.rig import Rig, directions_at
from spheremouse.rotation import Array
from spheremouse.settings import param

_LENS_BLUR = 0.4  # px, standard deviation of an ordinary lens in focus; the fitted size takes up what differs
_SURROUND = 4.0  # px of background around a disc that take part in the fit: enough for its slope, too few for more
_ITERATIONS = 5
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
    mask: NDArray[np.uint8]  # 255 on the ball within the window
    diameter: float  # px, of the largest disc

    def detect(self, image: NDArray[np.uint8]) -> Detections:
        """Disc candidates in an image (h, w, 3) BGR or (h, w), look-alikes included."""
        grey, noise = self._grey(image)
        centre = self._dark_places(grey, noise)
        directions, index = directions_at(centre, self.rig, self.pose)
        seen = appearance(directions, self.rig, self.pose)
        plausible = (seen.area >= self.settings.min_area) & self._inside(seen)
        return self._fit(grey, noise, centre[index][plausible], seen.take(plausible))

    def _grey(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], float]:
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

    def _dark_places(self, grey: NDArray[np.float32], noise: float) -> Array:
        """Centroids, (n, 2) px, of compact regions darker than what surrounds them.

        Looked for at three levels: the low one finds slivers at the limb, the high one parts a disc from a shadow.
        """
        width = 2 * int(np.ceil(0.75 * self.diameter)) + 1
        background = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
        darkness = background - grey
        darkness[self.mask == 0] = 0.0
        found = []
        for share in (0.6, 1.2, 2.4):
            floor = np.maximum(share * self.settings.contrast * background, 4.0 * noise)
            _, _, stats, centroids = cv2.connectedComponentsWithStats(
                (darkness > floor).astype(np.uint8), connectivity=4, ltype=cv2.CV_32S
            )
            size = stats[1:, cv2.CC_STAT_AREA]
            extent = np.maximum(stats[1:, cv2.CC_STAT_WIDTH], stats[1:, cv2.CC_STAT_HEIGHT])
            keep = (size >= 0.3 * self.settings.min_area) & (extent <= 1.2 * self.diameter + 3)
            found.append(centroids[1:][keep])
        places = np.concatenate(found)
        return places[_first_of_each(places, 1.0)] + self.origin

    def _fit(self, grey: NDArray[np.float32], noise: float, start: Array, seen: Appearance) -> Detections:
        """Fit I = b0 + b1 x + b2 y - a e(x - c; s) by Gauss-Newton with Tukey weights, all discs at once.

        e is the blurred ellipse; unknown are the background b (3), the contrast a, the centre c (2) and the size s.
        """
        n = len(start)
        if n == 0:
            return no_detections()
        reach = int(np.ceil(self.diameter / 2 + _SURROUND))
        span = np.arange(-reach, reach + 1)
        corner = np.rint(start - self.origin).astype(int)
        rows = (corner[:, 1, None] + span)[:, :, None]
        columns = (corner[:, 0, None] + span)[:, None, :]
        height, width = grey.shape
        on_ball = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
        on_ball &= self.mask[rows, columns] > 0
        image = grey[rows, columns].reshape(n, -1).astype(float)
        x = np.broadcast_to(span[None, :], (len(span),) * 2).ravel().astype(float)
        y = np.broadcast_to(span[:, None], (len(span),) * 2).ravel().astype(float)
        base = corner + self.origin
        c = start - base
        inverse = np.linalg.inv(seen.shape)
        blur = np.sqrt(self.settings.smoothing**2 + 1.0 / 12.0 + _LENS_BLUR**2)
        s = np.ones(n)
        e, de_dc, de_ds, distance = _blurred_ellipse(x, y, c, s, inverse, blur)
        near = on_ball.reshape(n, -1) & (distance < _SURROUND)
        b, a = _levels(image, distance, near)
        scale = np.maximum(noise, 0.02 * np.abs(a))  # shading and print: two percent of the contrast
        prior = (scale / (0.4 * self.settings.size_tolerance)) ** 2
        weight = near.astype(float)
        step = np.zeros((n, 7))
        N = np.zeros((n, 7, 7))
        residual = image
        for iteration in range(_ITERATIONS):
            model = b[:, :1] + b[:, 1:2] * x + b[:, 2:] * y - a[:, None] * e
            residual = image - model
            if iteration:  # the first step brings the model near: no pixel is an outlier before that
                limit = _tukey_limit(residual, weight > 0, near, scale)
                weight = near * np.maximum(0.0, 1.0 - (residual / limit[:, None]) ** 2) ** 2
            A = np.stack(
                [
                    np.ones_like(e),
                    np.broadcast_to(x, e.shape),
                    np.broadcast_to(y, e.shape),
                    -e,
                    -a[:, None] * de_dc[0],
                    -a[:, None] * de_dc[1],
                    -a[:, None] * de_ds,
                ],
                axis=1,
            )
            Aw = A * weight[:, None]
            N = Aw @ A.transpose(0, 2, 1) + 1e-6 * np.eye(7)
            gradient = (Aw @ residual[:, :, None])[:, :, 0]
            N[:, 6, 6] += prior  # a sliver cannot tell size from contrast: there the known size decides
            gradient[:, 6] -= prior * (s - 1.0)
            step = np.linalg.solve(N, gradient[:, :, None])[:, :, 0]
            b, a = b + step[:, :3], a + step[:, 3]
            c = c + np.clip(step[:, 4:6], -1.0, 1.0)
            s = np.clip(s + np.clip(step[:, 6], -0.2, 0.2), 0.3, 2.5)
            e, de_dc, de_ds, distance = _blurred_ellipse(x, y, c, s, inverse, blur)
        rim = np.hypot(*de_dc) * near
        rim_seen = (rim * weight).sum(axis=1) / np.maximum((np.hypot(*de_dc)).sum(axis=1), 1e-9)
        freedom = np.maximum(weight.sum(axis=1) - 7.0, 1.0)
        misfit = (weight * residual**2).sum(axis=1) / freedom
        variance = np.maximum(misfit, noise**2)
        covariance = np.linalg.inv(N)[:, 4:6, 4:6] * variance[:, None, None] + self.settings.sigma**2 * np.eye(2)
        sliver = np.sqrt(np.linalg.eigvalsh(seen.shape)[:, 0])  # semi-minor axis, px
        level = b[:, 0] + b[:, 1] * c[:, 0] + b[:, 2] * c[:, 1]
        ok = (
            (a > np.maximum(self.settings.contrast * level, 4.0 * noise))
            & (np.abs(s - 1.0) < np.maximum(self.settings.size_tolerance, _RIM_OFF / sliver))
            & (rim_seen > self.settings.rim)
            & (np.abs(step[:, 4:6]).max(axis=1) < 0.1)
        )
        centre = c + base - (seen.centroid - seen.centre)
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


def _noise(grey: NDArray[np.float32]) -> float:
    """Standard deviation of a pixel, grey values, from second differences along every eighth row."""
    rows = grey[::8]
    difference = rows[:, 1:-1] - 0.5 * (rows[:, :-2] + rows[:, 2:])
    return max(float(np.median(np.abs(difference))) * 1.4826 / np.sqrt(1.5), 0.29)


def _blurred_ellipse(  # noqa: PLR0917
    x: Array, y: Array, c: Array, s: Array, inverse: Array, blur: float
) -> tuple[Array, tuple[Array, Array], Array, Array]:
    """e, (n, k), of n ellipses in k pixels, its derivatives by centre and size, and the distance from the rim in px.

    With rho^2 = (x - c)^T S^-1 (x - c) the rim lies (s - rho) / |grad rho| ahead and (s + rho) / |grad rho| behind;
    a strip of that width blurred by a Gaussian is e = Phi(ahead / blur) + Phi(behind / blur) - 1, exact for a sliver.
    """
    dx, dy = x - c[:, :1], y - c[:, 1:]
    gx = inverse[:, 0, 0, None] * dx + inverse[:, 0, 1, None] * dy
    gy = inverse[:, 1, 0, None] * dx + inverse[:, 1, 1, None] * dy
    rho = np.sqrt(np.maximum(gx * dx + gy * dy, 1e-9))
    gx, gy = gx / rho, gy / rho
    slope = np.maximum(np.hypot(gx, gy), 1e-9)
    ahead, behind = (s[:, None] - rho) / slope, (s[:, None] + rho) / slope
    e = ndtr(ahead / blur) + ndtr(behind / blur) - 1.0
    bell_ahead, bell_behind = _bell(ahead, blur), _bell(behind, blur)
    by_rho = (bell_ahead - bell_behind) / slope  # minus de/drho; rho falls by g along dc
    return e, (by_rho * gx, by_rho * gy), (bell_ahead + bell_behind) / slope, -ahead


def _bell(d: Array, blur: float) -> Array:
    return np.exp(-0.5 * (d / blur) ** 2) / (blur * np.sqrt(2.0 * np.pi))


def _levels(image: Array, distance: Array, near: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Start values: background (n, 3), level at the origin with its slopes, and contrast (n,), from medians."""
    outside = np.ma.masked_array(image, ~(near & (distance > 1.0)))
    inside = np.ma.masked_array(image, ~(near & (distance < np.minimum(-0.5, distance.min(axis=1)[:, None] + 1.0))))
    background = np.ma.median(outside, axis=1).filled(0.0)
    contrast = background - np.ma.median(inside, axis=1).filled(0.0)
    return np.stack([background, np.zeros_like(background), np.zeros_like(background)], axis=1), contrast


def _tukey_limit(residual: Array, used: NDArray[np.bool_], near: NDArray[np.bool_], scale: Array) -> Array:
    """Residual at which a pixel loses all weight, (n,): 4.685 robust standard deviations."""
    spread = np.ma.median(np.ma.masked_array(np.abs(residual), ~near), axis=1).filled(0.0) * 1.4826
    return 4.685 * np.maximum(spread, scale)
