"""The update by a frame in one call, against its parts one after another."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from spheremouse.geometry.rotation import log
from spheremouse.native import kernels
from tests.ball.filters.twins import GATE, HORIZON, TOWARDS, drawn, process

VARIANCES = np.array([0.1, 2.0, 30.0]) ** 2
WEIGHTS = np.array([0.7, 0.2, 0.1])
ACTIVITY = GATE, 0.2, 1.0, VARIANCES, np.zeros(3), np.full(3, 1.0 / 3.0)
CAMERA = TOWARDS, HORIZON
SQUARES = VARIANCES / VARIANCES[0]


def ordinary(body, points, pending):
    """Return the pairs of an ordinary frame, and its noise scale, from distances and innovations; else None."""
    added = (pending[2] @ SQUARES - 1.0) * pending[0]
    one_level = pending[0], pending[1], np.array([0.0, 1.0]), None
    activity = *ACTIVITY[:3], np.array([1.0, pending[2] @ SQUARES]), np.zeros(2), np.full(2, 0.5)
    rows, columns, _, noise_scale = kernels.nearest_pairs(body, points, CAMERA, one_level, activity)
    visible = np.flatnonzero(body[3] @ body[0].T @ TOWARDS > HORIZON)
    allowance = min(np.trace(body[5][:3, :3] + added[:3, :3]) / 3.0, 0.01) ** 2
    distance = kernels.distances(body, points, visible, added, allowance, GATE)
    hits, total = distance < GATE, distance[rows, np.searchsorted(visible, columns)].sum()
    plain = hits.sum(axis=0).max() <= 1 and hits.sum(axis=1).max() <= 1
    in_place = noise_scale > 1.0 and total < 4.0 * len(rows) + 10.0
    livelier = (SQUARES.max() - 1.0) * pending[0]
    distance = kernels.distances(body, points, visible, livelier, 0.0, GATE)
    distance[rows] = distance[:, np.isin(visible, columns)] = np.inf
    if not (plain and in_place and len(rows) >= 2 and 2 * len(rows) >= min(distance.shape)) or np.any(distance < GATE):
        return None
    H, _, _, S = kernels.innovation(body, points, rows, columns, added)
    inverse = np.linalg.inv(S + H @ added @ H.T)
    widest = max(np.linalg.det(inverse[i : i + 2, i : i + 2]) ** -0.5 for i in range(0, len(S), 2))
    by_chance = len(points[0]) * GATE * widest > 2e-3 * (1.0 - HORIZON)
    return None if by_chance else (rows, columns, noise_scale)


def are_known_well(body, points, pending, columns):
    """Return whether a point falls into the widest gate of the discs in under a thousandth of the frames."""
    widest = kernels.place_sigma(body, columns, (pending[2] @ SQUARES - 1.0) * pending[0]).max(initial=0.0)
    share = GATE * np.pi * (widest**2 + 0.002**2) / (2.0 * np.pi * (1.0 - HORIZON))
    return 2 * len(columns) >= len(points[0]) and len(points[0]) * share < 1e-3


def flat(value):
    return [leaf for part in value for leaf in flat(part)] if isinstance(value, tuple) else [value]


@pytest.mark.parametrize("foreign", [0, 3])
@pytest.mark.parametrize("sigma", [1e-4, 3e-4, 1e-3])
def test_the_update_is_that_of_its_parts(sigma, foreign):
    frames = 0
    for seed in range(20):
        body, points = drawn(seed, sigma, foreign=foreign)
        pending = 1e-3 * process(sigma), 1.0 / 30.0, WEIGHTS, None
        corrected, pairs, is_certain = kernels.update_by_frame(body, points, CAMERA, pending, ACTIVITY)
        expected = ordinary(body, points, pending)
        small = np.linalg.norm(log(corrected[0][0] @ body[0].T)) < 0.02
        known = are_known_well(body, points, pending, pairs[1])
        assert is_certain == (len(pairs[0]) >= 2 and ((expected is not None and small) or known))
        rows, columns, complete, noise_scale = kernels.nearest_pairs(body, points, CAMERA, pending, ACTIVITY)
        if expected is None:
            assert_array_equal(pairs[:2], (rows, columns))
            assert pairs[2:] == (complete, noise_scale)
        else:
            frames += 1
            rows, columns, noise_scale = expected
            assert_array_equal(pairs[:2], (rows, columns))
        added = (noise_scale - 1.0) * pending[0]
        alone, _ = kernels.correct(body, points, (rows, columns, added), pending, ACTIVITY)
        for a, b in zip(flat(corrected), flat(alone), strict=True):
            assert_array_equal(a, b)
    assert frames > 0


def test_a_frame_without_points_is_not_certain():
    body, points = drawn(1)
    none = tuple(a[:0] for a in points[:5])
    pending = process(1e-3), 1.0 / 30.0, WEIGHTS, None
    _, pairs, is_certain = kernels.update_by_frame(body, (*none, 0.6, np.zeros(4)), CAMERA, pending, ACTIVITY)
    assert len(pairs[0]) == 0
    assert not is_certain
    with pytest.raises(TypeError, match="process"):
        kernels.update_by_frame(body, points, CAMERA, (np.zeros((3, 3)), *pending[1:]), ACTIVITY)
