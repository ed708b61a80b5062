"""Gates and robust sigmas: what samples of normal errors say of them."""

import numpy as np
import pytest

from spheremouse.geometry.statistics import FALSE_ALARM, gate, mad_sigma, ratio_gate


@pytest.mark.parametrize("dof", [1, 2, 6])
@pytest.mark.parametrize("p", [0.5, 0.95, 1.0 - FALSE_ALARM])
def test_so_many_stay_below_the_gate(p, dof):
    total = np.sum(np.random.default_rng(1).normal(size=(200000, dof)) ** 2, axis=1)
    assert np.mean(total < gate(p, dof)) == pytest.approx(p, abs=4.0 * np.sqrt(p * (1.0 - p) / len(total)))


def test_the_sigma_is_that_of_the_errors_however_gross_some_are():
    errors = np.random.default_rng(2).normal(size=(100000, 2)) * [0.5, 3.0]
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.02)
    errors[::50] *= 1e6
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.05)
    assert mad_sigma(errors[:, 0]) == mad_sigma(errors)[0]


def test_single_precision_does_not_come_back():
    assert mad_sigma(np.array([1.0, 2.0, 3.0], np.float32)) == 1.4826 * 2.0


@pytest.mark.parametrize(("dof", "other"), [(3, 8), (20, 80)])
def test_so_many_ratios_of_the_same_variance_stay_below_theirs(dof, other):
    rng = np.random.default_rng(3)
    a, b = (np.mean(rng.normal(size=(40000, n)) ** 2, axis=1) for n in (dof, other))
    assert np.mean(a / b < ratio_gate(0.99, dof, other)) == pytest.approx(0.99, abs=0.002)
