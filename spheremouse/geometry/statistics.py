"""What tests and robust estimates have in common: quantiles of chi-square and F, a false alarm, a median's sigma."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from spheremouse.geometry.rotation import Array

FALSE_ALARM = 1e-3  # chance that a test speaks where nothing is wrong
_MAD = 1.4826  # standard deviation over median of the absolute values, of normal errors


def gate(p: float, dof: float) -> float:
    """Sum of `dof` squared normalised errors that is exceeded with a chance of 1 - `p` alone: chi-square's quantile."""
    return float(chi2.ppf(p, dof))


def ratio_gate(p: float, dof: float, other: float) -> float:
    """Ratio of two variances, estimated with `dof` and `other` degrees of freedom, that is exceeded with 1 - `p` alone.

    The quantile of F, for two that are the same.
    """
    return float(f.ppf(p, dof, other))


def mad_sigma(error: NDArray[np.floating]) -> Array:
    """Standard deviation of errors about zero, (n, ...), from the median of their absolute values; of the first axis.

    Up to half of them may be gross errors (Rousseeuw, Leroy 1987).
    """
    return _MAD * np.median(np.abs(error), axis=0).astype(float)
