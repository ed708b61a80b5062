"""The default disc detector: local contrast finds them, a fit of the expected image measures them.

A disc is where the image is darker than its surroundings (grey closing wider than a disc) by a part of them: a ratio,
so that neither the level of the light nor its slope matters. Around each such place the image is fitted by a sloped
background minus a blurred ellipse whose shape the geometry gives; centre, size and contrast come out of the fit, with a
covariance. Pixels that fit neither (a strut, a highlight) are weighted down (Tukey's biweight); a fit that lost
its rim is none.
"""

from dataclasses import dataclass, replace
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
_SURROUND = 3.0  # px of background around a disc that take part in the fit: enough for its slope, too few for more
_UNEVEN = 0.02  # of the contrast: unevenness of print and ball that a good fit leaves
_CLEAR = 0.02  # part of a disc's darkness below which a pixel lies beside it
_BESIDE = 0.2  # of the contrast: what is beside a disc and differs more from the ball's shade is not the ball
_SLIVER = 2.0  # px, semi-minor axis below which both rims are one blur
_SIZE = 0.02  # discs cut from one sheet differ by this part of their size
_SLOPE = 0.02  # 1/px: slope of the ball's shade, cos falls so fast 60 degrees off the light at 100 px radius
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
        0.7,
        "-",
        "least part of a disc's rim that must fit: with a fifth hidden, a cut still passes for a rim",
        gt=0,
        le=1,
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

    def _fit(self, grey: Image, noise: float, start: Array, background: Array, seen: Appearance) -> Detections:
        """Fit the expected image around each start, (n, 2) px in the window; keep what is a disc.

        First with the size free, which tells discs from other things and the size all discs share; then with that size
        held, so that a disc cut by a strut is seen as cut, not as smaller.
        """
        at = np.rint(start).astype(int)
        contrast = background - grey[at[:, 1], at[:, 0]]
        fit = _Fit.begin(grey, self.mask, start, seen.shape, background, contrast, noise, self._blur, self.diameter)
        if len(start) == 0:
            return no_detections()
        for limit in (np.inf, 0.5):
            fit = fit.step(1.0, 0.4 * self.settings.size_tolerance, limit)
        sliver = np.sqrt(np.linalg.eigvalsh(seen.shape)[:, 0])  # semi-minor axis, px
        off = np.abs(fit.size - 1.0)
        keep = fit.deep(self.settings.contrast) & (off < np.maximum(self.settings.size_tolerance, _RIM_OFF / sliver))
        if not np.any(keep):
            return no_detections()
        fit, seen, sliver = fit.take(keep), seen.take(keep), sliver[keep]
        common = _common_size(fit.size, sliver)
        for limit in (0.5, 0.35, 0.25, 0.25):
            fit = fit.step(common, _SIZE + _RIM_OFF / 3.0 / sliver, limit)
        whole = 2.0 * np.pi * np.sqrt(np.trace(seen.shape, axis1=1, axis2=2) / 2.0)  # px, the rim integrated across
        rim = fit.rim() / whole
        # the far rim of a sliver drowns in the limb; half of it, with the known size, still fixes the centre
        least = np.where(sliver < _SLIVER, min(0.45, self.settings.rim), self.settings.rim)
        ok = fit.deep(self.settings.contrast) & (rim > least) & fit.settled()
        centre = fit.centre + self.origin - (seen.centroid - seen.centre)
        covariance = fit.covariance() + self.settings.sigma**2 * np.eye(2)
        best = np.flatnonzero(ok)[np.argsort(-rim[ok], kind="stable")]
        return Detections(centre, covariance, seen.area).take(best[_first_of_each(centre[best], 0.3 * self.diameter)])

    @property
    def _blur(self) -> float:
        """Standard deviation of a rim's blur, px: pixels, lens, and our own smoothing."""
        return float(np.sqrt(self.settings.smoothing**2 + 1.0 / 12.0 + _LENS_BLUR**2))

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
    x: Image  # (k,) px from the disc's start, float32 as all that is done per pixel
    y: Image  # (k,)
    of: list[slice]  # n slices into them

    def take(self, discs: NDArray[np.bool_], pixels: NDArray[np.bool_]) -> "_Pixels":
        """The pixels of some of the discs, (n,) mask, which are those of `pixels`, (k,)."""
        number = np.cumsum(discs) - 1
        disc = number[self.disc[pixels]]
        return _Pixels(
            disc, self.row[pixels], self.column[pixels], self.x[pixels], self.y[pixels], _runs(disc, int(discs.sum()))
        )

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
        x, y = x[near].astype(np.float32), y[near].astype(np.float32)
        return _Pixels(disc, row[near], column[near], x, y, _runs(disc, len(start)))


def _runs(disc: NDArray[np.intp], n: int) -> list[slice]:
    """Where each of n discs has its pixels; `disc` is sorted."""
    return [slice(int(a), int(b)) for a, b in pairwise(np.searchsorted(disc, np.arange(n + 1)))]


@dataclass(frozen=True, slots=True)
class _Fit:
    """I = b0 + b1 x + b2 y - a e(x - c; s) around n places, by Gauss-Newton with Tukey weights.

    e is the blurred ellipse; unknown are the background b (3), the contrast a, the centre c (2) and the size s, each
    counted from the disc's start. All pixels of all discs lie in one row: what is done to one is done to all at once.
    """

    pixels: _Pixels
    image: Image  # (k,) grey values
    start: Array  # (n, 2) px
    inverse: Image  # (k, 3) xx, xy, yy of the expected shape's inverse
    scale: Array  # (n,) grey values, least deviation of a good pixel
    noise: float  # grey values
    blur: float  # px
    x: Array  # (n, 7) b0, b1, b2, a, cx, cy, s
    e: Image  # (k,)
    de: Image  # (3, k)
    weight: Image  # (k,)
    normal: Array  # (n, 7, 7)
    last: Array  # (n, 7) the last step

    @staticmethod
    def begin(  # noqa: PLR0917
        grey: Image,
        mask: Image,
        start: Array,
        shape: Array,
        background: Array,
        contrast: Array,
        noise: float,
        blur: float,
        diameter: float,
    ) -> "_Fit":
        """The model as expected; pixels beside the disc that are not the ball's (a strut) have no weight."""
        n = len(start)
        pixels = _Pixels.around(start, shape, mask, diameter)
        image = grey[pixels.row, pixels.column]
        contrast = np.maximum(contrast, 1.0)
        inverse = np.linalg.inv(shape).reshape(n, 4)[:, [0, 1, 3]].astype(np.float32)[pixels.disc]
        x = np.zeros((n, 7))
        x[:, 0], x[:, 3], x[:, 6] = background, contrast, 1.0
        e, de = _blurred_ellipse(pixels, x, inverse, blur)
        foreign = np.abs(image - background[pixels.disc]) > (_BESIDE * contrast + 4.0 * noise)[pixels.disc]
        weight = np.where(foreign & (e < _CLEAR), 0.0, 1.0).astype(np.float32)
        scale = np.maximum(noise, _UNEVEN * contrast)
        return _Fit(
            pixels, image, start, inverse, scale, noise, blur, x, e, de, weight, np.zeros((n, 7, 7)), np.zeros((n, 7))
        )

    def step(self, size: Array | float, size_sigma: Array | float, limit: float) -> "_Fit":
        """One Gauss-Newton step; s is drawn to `size` with `size_sigma`, and residuals beyond `limit` of the contrast
        lose their pixels' weight (infinite: the weights stay as they are).
        """
        disc, x = self.pixels.disc, self.x.copy()
        p = x.astype(np.float32)[disc]
        A = np.empty((8, len(disc)), np.float32)  # columns b0 b1 b2 a cx cy s of the Jacobian, then the residual
        A[0], A[1], A[2] = 1.0, self.pixels.x, self.pixels.y
        np.negative(self.e, out=A[3])
        np.multiply(self.de, -p[:, 3], out=A[4:7])
        residual = A[7]
        np.subtract(self.image, np.einsum("ik,ki->k", A[:4], p[:, :4]), out=residual)
        weight = self.weight
        if np.isfinite(limit):
            floor = 4.685 * self.scale
            bound = np.maximum(limit * x[:, 3], floor).astype(np.float32)[disc]
            beside = np.maximum(_BESIDE * x[:, 3], floor).astype(np.float32)[
                disc
            ]  # no rim there: what differs is foreign
            bound = np.where(self.e < _CLEAR, np.minimum(bound, beside), bound)
            weight = np.square(np.maximum(0.0, 1.0 - np.square(residual / bound)))
        Aw = A[:7] * weight
        products = np.array([Aw[:, k] @ A[:, k].T for k in self.pixels.of], dtype=float)
        N, gradient = products[:, :, :7] + 1e-6 * np.eye(7), products[:, :, 7]
        level = (self.scale / (_SLOPE * np.maximum(x[:, 0], 1.0))) ** 2
        N[:, [1, 2], [1, 2]] += level[:, None]  # a ball's shade slopes little: what does more is a strut
        gradient[:, 1:3] -= level[:, None] * x[:, 1:3]
        hold = (self.scale / size_sigma) ** 2
        N[:, 6, 6] += hold
        gradient[:, 6] -= hold * (x[:, 6] - size)
        step = np.linalg.solve(N, gradient[:, :, None])[:, :, 0]
        step[:, 4:6] = np.clip(step[:, 4:6], -1.0, 1.0)
        step[:, 6] = np.clip(step[:, 6], -0.2, 0.2)
        x += step
        x[:, 6] = np.clip(x[:, 6], 0.3, 2.5)
        e, de = _blurred_ellipse(self.pixels, x, self.inverse, self.blur)
        return replace(self, x=x, e=e, de=de, weight=weight, normal=N, last=step)

    def take(self, keep: NDArray[np.bool_]) -> "_Fit":
        """The fits of a mask, (n,)."""
        pixels = keep[self.pixels.disc]
        return replace(
            self,
            pixels=self.pixels.take(keep, pixels),
            image=self.image[pixels],
            start=self.start[keep],
            inverse=self.inverse[pixels],
            scale=self.scale[keep],
            x=self.x[keep],
            e=self.e[pixels],
            de=self.de[:, pixels],
            weight=self.weight[pixels],
            normal=self.normal[keep],
            last=self.last[keep],
        )

    @property
    def centre(self) -> Array:
        """(n, 2) px in the window."""
        return self.start + self.x[:, 4:6]

    @property
    def size(self) -> Array:
        """(n,) fitted over expected."""
        return self.x[:, 6]

    def deep(self, contrast: float) -> NDArray[np.bool_]:
        """(n,) whose contrast is more than this part of the background, and than noise."""
        b0, b1, b2, a, cx, cy, _ = self.x.T
        return a > np.maximum(contrast * (b0 + b1 * cx + b2 * cy), 4.0 * self.noise)

    def settled(self) -> NDArray[np.bool_]:
        """(n,) whose centre moved by less than a tenth of a pixel in the last step."""
        return np.abs(self.last[:, 4:6]).max(axis=1) < 0.1

    def rim(self) -> Array:
        """(n,) px, length of the rim that fits."""
        rim = np.hypot(self.de[0], self.de[1])
        return np.array([rim[k] @ self.weight[k] for k in self.pixels.of])

    def covariance(self) -> Array:
        """(n, 2, 2) px² of the centres, from the residuals' own variance, or the noise where that is more."""
        p = self.x[self.pixels.disc]
        model = p[:, 0] + p[:, 1] * self.pixels.x + p[:, 2] * self.pixels.y - p[:, 3] * self.e
        squares = self.weight * (self.image - model) ** 2
        freedom = np.array([self.weight[k].sum() for k in self.pixels.of]) - 7.0
        misfit = np.array([squares[k].sum() for k in self.pixels.of]) / np.maximum(freedom, 1.0)
        variance = np.maximum(misfit, self.noise**2)
        return np.asarray(np.linalg.inv(self.normal)[:, 4:6, 4:6] * variance[:, None, None], dtype=float)


def _common_size(size: Array, sliver: Array) -> float:
    """The size all discs share, from those large enough to tell; 1 where fewer than three do."""
    large = size[sliver > 3.0]
    return float(np.median(large)) if len(large) >= 3 else 1.0


def _grown(shape: Array, margin: float) -> Array:
    """Ellipses, (n, 2, 2), whose axes are longer by `margin` px."""
    values, vectors = np.linalg.eigh(shape)
    values = (np.sqrt(np.maximum(values, 0.0)) + margin) ** 2
    return (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)


def _blurred_ellipse(pixels: _Pixels, x: Array, inverse: Image, blur: float) -> tuple[Image, Image]:
    """e, (k,), of every pixel and its derivatives by centre x, y and size, (3, k).

    With rho^2 = (x - c)^T S^-1 (x - c) the rim lies (s - rho) / |grad rho| ahead and (s + rho) / |grad rho| behind;
    a strip of that width, blurred, is e = L(ahead) + L(behind) - 1. L is the logistic function of the Gaussian's
    width: within 1 % of it, and its own derivative.
    """
    c = x[:, 4:7].astype(np.float32)[pixels.disc]
    dx, dy, size = pixels.x - c[:, 0], pixels.y - c[:, 1], c[:, 2]
    gx = inverse[:, 0] * dx + inverse[:, 1] * dy
    gy = inverse[:, 1] * dx + inverse[:, 2] * dy
    rho = np.sqrt(np.maximum(gx * dx + gy * dy, 1e-9))
    slope = np.sqrt(np.maximum(gx * gx + gy * gy, 1e-12))  # times rho
    steep = rho / slope
    steep *= 1.702 / blur
    near, far = size * steep, rho * steep
    ahead, behind = expit(near - far), expit(near + far)
    bell_ahead, bell_behind = steep * ahead * (1.0 - ahead), steep * behind * (1.0 - behind)
    by_rho = (bell_ahead - bell_behind) / rho  # minus de/drho; rho falls by g / rho along dc
    de = np.empty((3, len(rho)), np.float32)
    np.multiply(by_rho, gx, out=de[0])
    np.multiply(by_rho, gy, out=de[1])
    np.add(bell_ahead, bell_behind, out=de[2])
    return ahead + behind - 1.0, de
