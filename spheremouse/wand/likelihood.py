"""Log-likelihood ratio of poses of a ball, given the weight fields and the edges across its outline, and its peaks.

The fields take one pass over particles x points in C++. The points of each disc are its centre, the four points of
Grzonka 2005 (section 3.4.1), points on its rim and just outside; bare points belong to no disc. A point that faces the
camera should have the value e of a blurred rim at its distance. The field m there has the log-likelihood ratio against
a picture without the ball

    l = log((1 - o) N(m - e) / B(e) + o),   B(e) = (1 - p) N(e) + p,

with the fraction p of the picture that has the colour and the fraction o of hidden points. A point that is turned away
has the ratio 0, so a pose gains nothing by hiding points, unlike under the product over visible points (Grzonka 2005,
table 3). A pose gains nothing by showing points either: the weight of a point is the area that it represents in the
picture, in areas of the Gaussian kernel, within which pixels repeat each other. The sum is therefore one over the
picture, even if many points crowd near the limb.
The rim offset, common to a colour (a bound on saturation moves every rim outward), is marginalised.
Glare hides colours: at a point with the fraction v of glare the field is between m and m + v, and its weight 1 - v.

The outline measures the distance. From the discs alone it was wrong by up to 40 cm, so the outlook of Grzonka 2005
(section 5.2) proposes ring outlines; the ball's is the largest ring. At directions around the ball, the search goes
across it for the step from the ball's colour to the background.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.wand.colour import FIELD_SIGMA, Fields
from spheremouse.wand.model import Model
from spheremouse.wand.rims import Image

# Of the field's range. A rim crosses a pixel anywhere: 0.29 px, or 0.14 px over the 4 px along it that the kernel
# combines, at a slope of a third per pixel 0.05; 0.04 more for print, gloss and motion
SIGMA = 0.065
MIN_FACING, FULL_FACING = 0.08, 0.25  # cosine of the viewing angle at which a point has weight, and full weight
DIRECTIONS = 24  # around the outline; every four pixels of a ball 50 px across
_KERNEL_AREA = 2.0 * np.pi * FIELD_SIGMA**2  # px²
_NOT_FIXED = np.zeros((0, 1)), np.zeros(0, dtype=np.int64)


def log_likelihood(
    position: Array,
    rotation: Array,
    model: Model,
    fields: Fields,
    sigma: float = SIGMA,
    fixed_weights: tuple[Array, NDArray[np.int64]] | None = None,
) -> tuple[Array, Array]:
    """Return log-likelihood ratios, (n,), and matches, (n,), of n poses.

    The poses are (n, 3) m and (n, 3, 3) R_cam_ball. `sigma` of the field exceeds `SIGMA` for poses near a peak only.
    `fixed_weights` has `disc_weights` of k poses, (k, d), and the index of one of them for each pose, (n,), or -1 for
    the pose's own weights. Poses about one peak need the same weights: a closer ball is larger and has larger weights,
    so its own weights would draw the distance of a well visible ball towards the camera.

    The match is the fraction of the visible coloured points that show their colour. Points that show it but should not
    reduce it.
    """
    fixed = fixed_weights or _NOT_FIXED
    return kernels.log_likelihood(position, rotation, model.kernel, fields.kernel, sigma, *fixed)


def support(value: Array, position: Array, rotation: Array, model: Model, fields: Fields) -> Array:
    """Return where the log-likelihood ratios `value`, (n,), lie between those of a hidden ball, 0, and a clear view, 1.

    The n poses are (n, 3) m in cam and (n, 3, 3) R_cam_ball. The fields of a hidden ball are 0 at all points of discs,
    those of a clear view have the value e. A colour that the fields lack does not count: its bounds can be wrong.
    """
    hidden, clear = kernels.evidence_bounds(position, rotation, model.kernel, fields.kernel)
    gain = (clear - hidden) @ (fields.binary.any(axis=(1, 2)) | (fields.fraction > 0.0))
    return (value - hidden.sum(axis=1)) / np.maximum(gain, 1.0)


def disc_weights(position: Array, rotation: Array, model: Model, factor: int) -> Array:
    """Return the weight of a point of each disc, and last of a bare point, in a picture reduced by `factor`: (k, d).

    It is the point's area in that picture over the kernel's, at most 1. The k poses are (k, 3) m in cam and R_cam_ball
    (k, 3, 3).
    """
    first = model.points.table[model.points.table[:, 9] > 0.0]
    normal = np.einsum("kij,qj->kqi", rotation, first[:, :3])
    place = position[:, None] + model.radius * normal
    length = np.linalg.norm(place, axis=2)
    facing = -np.sum(normal * place, axis=2) / length
    scale = model.lens[0] * model.radius / (factor * length)
    return np.minimum(np.maximum(facing, MIN_FACING) * scale**2 * first[:, 9] / _KERNEL_AREA, 1.0)


# ---- the outline ----


def measure_edges(image: Image, position: Array, rotation: Array, discs: Array, model: Model, factor: int) -> Array:
    """Return edges across the outline of a ball, (24, 5): u, v px, outward normal in the picture, 1 for a found one.

    The pose is (3,) m in cam and R_cam_ball (3, 3). `discs` (m, 4) are directions in `ball` and angular radii; the
    search stays clear of their rims. One step of the search is `factor` px.
    """
    return kernels.measure_edges(image, position, rotation, discs, model.kernel, factor)


def outline_log_likelihood(position: Array, which: NDArray[np.int64], edges: Array, model: Model, factor: int) -> Array:
    """Return the log-likelihood ratios, (n,), of the edges `edges[which]`, (24, 5), for balls at (n, 3) m."""
    return kernels.outline_log_likelihood(position, which, edges, model.kernel, factor)


# ---- peaks ----


@dataclass(frozen=True, slots=True)
class Peak:
    """Maximum of the likelihood, with the Gaussian that approximates it."""

    position: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    covariance: Array  # (6, 6) m, rad: position + d, exp(theta) @ rotation, in cam axes
    edges: Array  # (24, 5) of the outline, `measure_edges`
    slope: float  # twice the gain in log-likelihood that a further round promises: small at the peak
    rims: Array  # (c,) px of the field by which each colour's rims are selected farther outward than expected


def refine_pose(position: Array, rotation: Array, model: Model, fields: Fields, edges: Array, rounds: int) -> Peak:
    """Return the peak near a pose, (3,) m in cam and R_cam_ball (3, 3); `edges` (24, 5) are those of the outline, or 0.

    At most `rounds` Gauss-Newton steps on the residuals of fields and outline, with the weights of the likelihood and
    the common offsets of rims and outline as further unknowns, end at a tenth of a standard deviation from the peak.
    The inverse normal matrix is the covariance of the Gaussian at the peak (Laplace's approximation). Derivatives are
    differences over half a pixel, which average the effect of single pixels.
    """
    p, R, covariance, slope, rims = kernels.refine(position, rotation, model.kernel, fields.kernel, edges, rounds)
    return Peak(p, R, covariance, edges, slope, rims)
