"""Quantiles of chi-square and F, tests and their false-alarm rates, correlations, and a robust standard deviation."""

import math

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

FALSE_ALARM = 1e-3  # probability that a test rejects a true hypothesis
_NONZERO_CHI2 = 21.1  # chi-square with 3 degrees of freedom, 99.99 %
_SIGMA_PER_MAD = 1.4826  # standard deviation over median of the absolute values, of normal errors


def gate(p: float, dof: float) -> float:
    """Return the p-quantile of chi-square with `dof` degrees of freedom."""
    from scipy.special import gammaincinv  # SciPy takes 0.2 s, and tracking needs none

    return float(2.0 * gammaincinv(0.5 * dof, p))


def ratio_gate(p: float, dof: float, other: float) -> float:
    """Return the p-quantile of F: of the ratio of two estimates of one variance with these degrees of freedom."""
    from scipy.special import fdtri

    return float(fdtri(dof, other, p))


def poisson_tail(k: int, mean: float) -> float:
    """Return the probability, within 1e-15, that a Poisson variable exceeds k."""
    return 1.0 - math.exp(-mean) * sum(mean**i / math.factorial(i) for i in range(k + 1))


def is_nonzero(vector: Array, covariance: Array) -> bool:
    """Return whether a vector (3,) with a covariance (3, 3) differs from zero: wrong for one zero vector in 10,000."""
    return bool(vector @ np.linalg.solve(covariance, vector) > _NONZERO_CHI2)


def correlation(covariance: Array) -> Array:
    """Return the correlation matrix of a covariance, (n, n); 0 beside exact values."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    r = covariance / np.outer(scale, scale)
    np.fill_diagonal(r, 1.0)
    return r


def mad_sigma(error: NDArray[np.floating]) -> Array:
    """Return the standard deviation of errors (n, ...) about zero from the median of their absolute values, over n.

    Up to half of them may be gross errors (Rousseeuw, Leroy 1987).
    """
    return _SIGMA_PER_MAD * np.median(np.abs(error), axis=0).astype(float)
