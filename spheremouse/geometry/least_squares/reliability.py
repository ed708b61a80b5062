"""Redundancy, outliers and variance factors of an adjustment."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.least_squares.adjust import PRIOR, Jacobian
from spheremouse.geometry.rotation import Array


def redundancy(jacobian: Jacobian, Q: Array, size: int = 1) -> Array:
    """Cofactors of the residuals, (n / size, size, size): blocks on the diagonal of I - J Q J'.

    Of a single observation (size 1) it is the redundancy number: 0 nobody checks it, 1 it is fully checked.
    """
    blocks = (jacobian @ Q).reshape(-1, size, Q.shape[0])
    J = jacobian.toarray().reshape(-1, size, Q.shape[0])
    return np.eye(size) - blocks @ J.transpose(0, 2, 1)


def outlier_statistic(residual: Array, cofactor: Array) -> Array:
    """Square of the normalised residual of each of n groups, (n,): chi-square with its size of degrees of freedom.

    Data snooping (Baarda 1968) for points: `residual` (n, size), `cofactor` (n, size, size) of `redundancy`. What
    nothing checks gives 0.
    """
    value, vector = np.linalg.eigh(cofactor)
    along = np.einsum("nji,nj->ni", vector, residual)
    checked = value > 1e-6
    return np.sum(np.where(checked, along**2 / np.where(checked, value, 1.0), 0.0), axis=1)


def variance_factors(
    residual: Array, number: Array, groups: Sequence[NDArray[np.bool_]], factors: Array | None = None
) -> Array:
    """By how much the variance of each group of observations, (k,), differs from what was assumed at first.

    `residual` and redundancy `number` are of an adjustment in which the variances had these `factors` already (None:
    1). Sum of squares over sum of redundancy numbers (Förstner 1979), held near 1 where little redundancy tells it: the
    mean of the inverse gamma distribution that `PRIOR` earlier observations of variance 1 and these leave, so that
    errors over the covariances that follow are 1 in the mean though the variance was estimated.
    """
    before = np.ones(len(groups)) if factors is None else factors
    squares = np.array([np.sum(residual[g] ** 2) for g in groups])
    freedom = np.array([np.sum(number[g]) for g in groups])
    return (before * squares + PRIOR) / (freedom + PRIOR - 2.0)
