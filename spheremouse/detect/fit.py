"""A disc's image fitted to pixels: expected ellipses in, centres, sizes and covariances out.

The measuring half of the default detector. Around each place the image is modelled by a sloped background minus a
blurred ellipse of the shape that the geometry gives; pixels that fit neither (a strut, a highlight) are weighted down
(Tukey's biweight). The covariance is that of the adjustment (Wittich 2017, chapter 5, names it as the next step).
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from spheremouse.detect.detections import Image
from spheremouse.rotation import Array

_SURROUND = 3.0  # px of background around a disc that take part in the fit: enough for its slope, too few for more
_UNEVEN = 0.02  # of the contrast: unevenness of print and ball that a good fit leaves
_CLEAR = 0.02  # part of a disc's darkness below which a pixel lies beside it
_BESIDE = 0.2  # of the contrast: what is beside a disc and differs more from the ball's shade is not the ball
_SLOPE = 0.02  # 1/px: slope of the ball's shade, cos falls so fast 60 degrees off the light at 100 px radius
_GLOSS = 0.3  # of the contrast, from a disc's centre to its rim: gloss lightens print on the side of the light
_HELD = np.array([1, 2, 4, 5, 8])  # unknowns about which something is known beforehand


@dataclass(frozen=True, slots=True)
class Pixels:
    """The pixels around n discs, disc after disc."""

    disc: NDArray[np.intp]  # (k,) whose
    row: NDArray[np.intp]  # (k,) in the window
    column: NDArray[np.intp]  # (k,)
    x: Image  # (k,) px from the disc's start, float32 as all that is done per pixel
    y: Image  # (k,)
    of: list[slice]  # n slices into them

    def take(self, discs: NDArray[np.bool_], pixels: NDArray[np.bool_]) -> "Pixels":
        """The pixels of some of the discs, (n,) mask, which are those of `pixels`, (k,)."""
        number = np.cumsum(discs) - 1
        disc = number[self.disc[pixels]]
        return Pixels(
            disc, self.row[pixels], self.column[pixels], self.x[pixels], self.y[pixels], _runs(disc, int(discs.sum()))
        )

    @staticmethod
    def around(start: Array, shape: Array, mask: Image, diameter: float) -> "Pixels":
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
        return Pixels(disc, row[near], column[near], x, y, _runs(disc, len(start)))


def _runs(disc: NDArray[np.intp], n: int) -> list[slice]:
    """Where each of n discs has its pixels; `disc` is sorted."""
    return [slice(int(a), int(b)) for a, b in pairwise(np.searchsorted(disc, np.arange(n + 1)))]


@dataclass(frozen=True, slots=True)
class DiscFit:
    """I = b0 + b1 x + b2 y - (a0 + a1 x + a2 y) e(x - c; s) around n places, by Gauss-Newton with Tukey weights.

    e is the blurred ellipse; unknown are the background b (3), the contrast a (3: gloss lightens print on one side),
    the centre c (2) and the size s, each counted from the disc's start. All pixels of all discs lie in one row: what is
    done to one is done to all at once.
    """

    pixels: Pixels
    image: Image  # (k,) grey values
    start: Array  # (n, 2) px
    inverse: Image  # (k, 3) xx, xy, yy of the expected shape's inverse
    scale: Array  # (n,) grey values, least deviation of a good pixel
    noise: float  # grey values
    blur: float  # px
    gloss: Array  # (n,) 1/px, standard deviation of the contrast's slope over the contrast
    x: Array  # (n, 9) b0, b1, b2, a0, a1, a2, cx, cy, s
    e: Image  # (k,)
    de: Image  # (3, k)
    weight: Image  # (k,)
    normal: Array  # (n, 9, 9)
    last: Array  # (n, 9) the last step

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
    ) -> "DiscFit":
        """The model as expected; pixels beside the disc that are not the ball's (a strut) have no weight."""
        n = len(start)
        pixels = Pixels.around(start, shape, mask, diameter)
        image = grey[pixels.row, pixels.column]
        contrast = np.maximum(contrast, 1.0)
        inverse = np.linalg.inv(shape).reshape(n, 4)[:, [0, 1, 3]].astype(np.float32)[pixels.disc]
        x = np.zeros((n, 9))
        x[:, 0], x[:, 3], x[:, 8] = background, contrast, 1.0
        e, de = _blurred_ellipse(pixels, x, inverse, blur)
        foreign = np.abs(image - background[pixels.disc]) > (_BESIDE * contrast + 4.0 * noise)[pixels.disc]
        weight = np.where(foreign & (e < _CLEAR), 0.0, 1.0).astype(np.float32)
        scale = np.maximum(noise, _UNEVEN * contrast)
        minor, major = np.sqrt(np.maximum(np.linalg.eigvalsh(shape), 0.0)).T
        # across a sliver a slope of the contrast and a shift of the centre look alike: there it is taken for even
        gloss = _GLOSS / major * np.clip((minor - blur) / 1.5, 0.01, 1.0)
        return DiscFit(
            pixels,
            image,
            start,
            inverse,
            scale,
            noise,
            blur,
            gloss,
            x,
            e,
            de,
            weight,
            np.zeros((n, 9, 9)),
            np.zeros((n, 9)),
        )

    def step(self, size: Array | float, size_sigma: Array | float, limit: float) -> "DiscFit":
        """One Gauss-Newton step; s is drawn to `size` with `size_sigma`, and residuals beyond `limit` of the contrast
        lose their pixels' weight (infinite: the weights stay as they are).
        """
        disc, x = self.pixels.disc, self.x.copy()
        p = x.astype(np.float32)[disc]
        # columns b0 b1 b2 a0 a1 a2 cx cy s of the Jacobian, then the residual
        A = np.empty((10, len(disc)), np.float32)
        A[0], A[1], A[2] = 1.0, self.pixels.x, self.pixels.y
        np.multiply(A[:3], -self.e, out=A[3:6])
        contrast = np.einsum("ik,ki->k", A[:3], p[:, 3:6])
        np.multiply(self.de, -contrast, out=A[6:9])
        residual = A[9]
        np.subtract(self.image, np.einsum("ik,ki->k", A[:6], p[:, :6]), out=residual)
        weight = self.weight
        if np.isfinite(limit):
            floor = 4.685 * self.scale
            bound = np.maximum(limit * x[:, 3], floor).astype(np.float32)[disc]
            # beside the disc no rim has to settle: what differs there is foreign
            beside = np.maximum(_BESIDE * x[:, 3], floor).astype(np.float32)[disc]
            bound = np.where(self.e < _CLEAR, np.minimum(bound, beside), bound)
            weight = np.square(np.maximum(0.0, 1.0 - np.square(residual / bound)))
        Aw = A[:9] * weight
        products = np.array([Aw[:, k] @ A[:, k].T for k in self.pixels.of], dtype=float)
        N, gradient = products[:, :, :9] + 1e-6 * np.eye(9), products[:, :, 9]
        # what is expected of the slopes and the size, as observations: a ball's shade slopes little, and what does more
        # is a strut; gloss slopes the contrast; a sliver cannot tell size from contrast, there the known size decides
        held = np.stack([x[:, 1], x[:, 2], x[:, 4], x[:, 5], x[:, 8] - size], axis=1)
        shade = _SLOPE * np.maximum(x[:, 0], 1.0)
        gloss = self.gloss * np.maximum(x[:, 3], 1.0)
        sigma = np.stack(np.broadcast_arrays(shade, shade, gloss, gloss, size_sigma), axis=1)
        hold = (self.scale[:, None] / sigma) ** 2
        N[:, _HELD, _HELD] += hold
        gradient[:, _HELD] -= hold * held
        step = np.linalg.solve(N, gradient[:, :, None])[:, :, 0]
        step[:, 6:8] = np.clip(step[:, 6:8], -1.0, 1.0)
        step[:, 8] = np.clip(step[:, 8], -0.2, 0.2)
        x += step
        x[:, 8] = np.clip(x[:, 8], 0.3, 2.5)
        e, de = _blurred_ellipse(self.pixels, x, self.inverse, self.blur)
        return replace(self, x=x, e=e, de=de, weight=weight, normal=N, last=step)

    def take(self, keep: NDArray[np.bool_]) -> "DiscFit":
        """The fits of a mask, (n,)."""
        pixels = keep[self.pixels.disc]
        return replace(
            self,
            pixels=self.pixels.take(keep, pixels),
            image=self.image[pixels],
            start=self.start[keep],
            inverse=self.inverse[pixels],
            scale=self.scale[keep],
            gloss=self.gloss[keep],
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
        return self.start + self.x[:, 6:8]

    @property
    def size(self) -> Array:
        """(n,) fitted over expected."""
        return self.x[:, 8]

    def deep(self, contrast: float) -> NDArray[np.bool_]:
        """(n,) whose contrast is more than this part of the background, and than noise."""
        b0, b1, b2, a, _, _, cx, cy, _ = self.x.T
        return a > np.maximum(contrast * (b0 + b1 * cx + b2 * cy), 4.0 * self.noise)

    def settled(self) -> NDArray[np.bool_]:
        """(n,) whose centre moved by less than a tenth of a pixel in the last step."""
        return np.abs(self.last[:, 6:8]).max(axis=1) < 0.1

    def rim(self) -> Array:
        """(n,) px, length of the rim that fits."""
        rim = np.hypot(self.de[0], self.de[1])
        return np.array([rim[k] @ self.weight[k] for k in self.pixels.of])

    def covariance(self) -> Array:
        """(n, 2, 2) px² of the centres, from the residuals' own variance, or the noise where that is more."""
        p = self.x[self.pixels.disc]
        base = np.stack([np.ones_like(self.e), self.pixels.x, self.pixels.y])
        model = np.einsum("ik,ki->k", base, p[:, :3]) - self.e * np.einsum("ik,ki->k", base, p[:, 3:6])
        squares = self.weight * (self.image - model) ** 2
        freedom = np.array([self.weight[k].sum() for k in self.pixels.of]) - 9.0
        misfit = np.array([squares[k].sum() for k in self.pixels.of]) / np.maximum(freedom, 1.0)
        variance = np.maximum(misfit, self.noise**2)
        return np.asarray(np.linalg.inv(self.normal)[:, 6:8, 6:8] * variance[:, None, None], dtype=float)


def _grown(shape: Array, margin: float) -> Array:
    """Ellipses, (n, 2, 2), whose axes are longer by `margin` px."""
    values, vectors = np.linalg.eigh(shape)
    values = (np.sqrt(np.maximum(values, 0.0)) + margin) ** 2
    return (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)


def _blurred_ellipse(pixels: Pixels, x: Array, inverse: Image, blur: float) -> tuple[Image, Image]:
    """e, (k,), of every pixel and its derivatives by centre x, y and size, (3, k).

    With rho^2 = (x - c)^T S^-1 (x - c) the rim lies (s - rho) / |grad rho| ahead and (s + rho) / |grad rho| behind;
    a strip of that width, blurred, is e = L(ahead) + L(behind) - 1. L is the logistic function of the Gaussian's
    width: within 1 % of it, and its own derivative.
    """
    c = x[:, 6:9].astype(np.float32)[pixels.disc]
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


def _median(values: Array) -> float:
    """Upper median, without what np.median adds to it: this runs a hundred times a frame."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle]) if len(values) else 0.0
