"""The update by a frame in one call, against its parts one after another."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from spheremouse.native import kernels
from tests.ball.filters.twins import GATE, HORIZON, TOWARDS, drawn, process

VARIANCES = np.array([0.1, 2.0, 30.0]) ** 2
WEIGHTS = np.array([0.7, 0.2, 0.1])
ACTIVITY = GATE, 0.2, 1.0, VARIANCES, np.zeros(3), np.full(3, 1.0 / 3.0)
CAMERA = TOWARDS, HORIZON


def flat(value):
    return [leaf for part in value for leaf in flat(part)] if isinstance(value, tuple) else [value]


@pytest.mark.parametrize("foreign", [0, 3])
@pytest.mark.parametrize("sigma", [1e-4, 3e-4, 1e-3])
def test_the_update_is_that_of_its_parts(sigma, foreign):
    certain = 0
    for seed in range(20):
        body, points = drawn(seed, sigma, foreign=foreign)
        pending = 1e-3 * process(sigma), 1.0 / 30.0, WEIGHTS, None
        corrected, pairs, is_certain = kernels.update_by_frame(body, points, CAMERA, pending, ACTIVITY)
        rows, columns, _, _ = kernels.nearest_pairs(body, points, CAMERA, pending, ACTIVITY)
        assert_array_equal(pairs[:2], (rows, columns))
        added = (pairs[3] - 1.0) * pending[0]
        alone, _ = kernels.correct(body, points, (rows, columns, added), pending, ACTIVITY)
        for a, b in zip(flat(corrected), flat(alone), strict=True):
            assert_array_equal(a, b)
        certain += is_certain
        assert not is_certain or len(rows) >= 2
    assert certain > 0


def test_a_frame_without_points_is_not_certain():
    body, points = drawn(1)
    none = tuple(a[:0] for a in points[:5])
    pending = process(1e-3), 1.0 / 30.0, WEIGHTS, None
    _, pairs, is_certain = kernels.update_by_frame(body, (*none, 0.6, np.zeros(4)), CAMERA, pending, ACTIVITY)
    assert len(pairs[0]) == 0
    assert not is_certain
    with pytest.raises(TypeError, match="process"):
        kernels.update_by_frame(body, points, CAMERA, (np.zeros((3, 3)), *pending[1:]), ACTIVITY)
