"""Gates and robust sigmas: what samples of normal errors say of them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from spheremouse.geometry.statistics import gate, mad_sigma, poisson_tail, ratio_gate


def test_the_sigma_is_that_of_the_errors_however_gross_some_are():
    errors = np.random.default_rng(2).normal(size=(100000, 2)) * [0.5, 3.0]
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.02)
    errors[::50] *= 1e6
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.05)
    assert mad_sigma(errors[:, 0]) == mad_sigma(errors)[0]


@pytest.mark.parametrize("mean", [0.0, 0.3, 2.0, 30.0])
def test_the_tail_of_a_poisson_variable_is_that_of_scipy(mean):
    k = np.arange(-1, 60)
    assert_allclose([poisson_tail(int(i), mean) for i in k], stats.poisson.sf(k, mean), atol=1e-14)


def test_gates_are_quantiles():
    for p, dof in ((0.999, 1.0), (0.999, 2.0), (0.5, 7.0), (1.0 - 1e-9, 40.0)):
        assert_allclose(gate(p, dof), stats.chi2.ppf(p, dof), rtol=1e-7)
        assert_allclose(ratio_gate(p, dof, 12.0), stats.f.ppf(p, dof, 12.0), rtol=1e-6)
