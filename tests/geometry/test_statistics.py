"""Gates and robust sigmas: what samples of normal errors say of them."""

import numpy as np
import pytest

from spheremouse.geometry.statistics import mad_sigma


def test_the_sigma_is_that_of_the_errors_however_gross_some_are():
    errors = np.random.default_rng(2).normal(size=(100000, 2)) * [0.5, 3.0]
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.02)
    errors[::50] *= 1e6
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.05)
    assert mad_sigma(errors[:, 0]) == mad_sigma(errors)[0]
