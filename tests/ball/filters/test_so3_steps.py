"""Steps of the acceleration: without time there is none. `test_so3_update` compares the moments of the mixture."""

import numpy as np
from numpy.testing import assert_allclose

from spheremouse.ball.filters import so3_steps


def test_without_an_interval_there_is_no_step():
    modes = (np.zeros((1, 6)), np.eye(6)[None], np.array([[0.5, 0.3, 0.2]]))
    moved = np.eye(6), np.eye(6, 15), np.zeros((6, 6))
    steps = (0.0, 0.2, np.array([0.1, 2.0, 30.0]) ** 2)
    mean, covariance, _, new, level, *_ = so3_steps.posterior(np.eye(16), moved, np.ones(3), steps, modes)
    assert not np.any(np.abs(mean[so3_steps.STEP]) > 1e-12)
    assert not np.any(np.abs(covariance[so3_steps.STEP]) > 1e-12)
    assert_allclose(new[2].sum(axis=0), [0.5, 0.3, 0.2])
    assert level == 1.0
