"""Refinement of a pose to a peak of the likelihood, with its curvature, for proposals.

Gauss-Newton steps on the residuals of fields and outline, with the weights of `likelihood` and `limb` and the common
offsets of rims and outline as further unknowns. The inverse normal matrix is the covariance of the Gaussian at the peak
(Laplace's approximation). Derivatives are differences over half a pixel, which average the effect of single pixels.
The rounds end early at a tenth of a standard deviation from the peak.
"""

from dataclasses import dataclass

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.wand.colour import Fields
from spheremouse.wand.model import Model

_MAX_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class Peak:
    """Maximum of the likelihood, with the Gaussian that approximates it."""

    position: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    covariance: Array  # (6, 6) m, rad: position + d, exp(theta) @ rotation, in cam axes
    edges: Array  # (24, 5) of the outline, `limb.measure_edges`
    slope: float  # twice the gain in log-likelihood that a further round promises: small at the peak


def refine_pose(
    position: Array, rotation: Array, model: Model, fields: Fields, edges: Array, rounds: int = _MAX_ROUNDS
) -> Peak:
    """Return the peak near a pose, (3,) m in cam and R_cam_ball (3, 3), after at most `rounds` steps.

    `edges` (24, 5) are those of the outline, or 0.
    """
    p, R, covariance, slope = kernels.refine(position, rotation, model.kernel, fields.kernel, edges, rounds)
    return Peak(p, R, covariance, edges, slope)
