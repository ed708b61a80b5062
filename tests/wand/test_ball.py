"""Balls: the measures of the thesis, and no symmetry."""

import itertools

import numpy as np
import pytest
from experiments.kit.balls import contrast_ball, led_ball
from scipy.spatial.transform import Rotation

from spheremouse.wand.ball import grzonka_ball


def test_thesis_ball_has_the_printed_measures():
    ball = grzonka_ball()
    rims = sorted({round(2 * ball.radius * np.sin(d.angle), 6) for d in ball.discs})
    assert rims == [0.021, 0.035]
    assert sorted({round(ball.radius * d.points_angle, 6) for d in ball.discs}) == [0.005, 0.012]
    assert [d.colour for d in ball.discs].count("red") == 4
    azimuths = {round(np.rad2deg(np.arctan2(d.direction[1], d.direction[0]))) % 360 for d in ball.discs}
    assert azimuths == {0, 90, 180, 270}


@pytest.mark.parametrize("ball", [grzonka_ball(), contrast_ball(), led_ball()], ids=lambda b: b.name)
def test_no_rotation_maps_the_pattern_to_itself(ball):
    """Every rotation that maps two discs to two others of their kind maps some disc to a place without one."""
    n = np.array([d.direction for d in ball.discs])
    kind = [(d.colour, round(d.angle, 6)) for d in ball.discs]
    pairs = list(itertools.permutations(range(len(n)), 2))
    a, b = pairs[0]
    for c, d in pairs:
        if (a, b) == (c, d) or kind[a] != kind[c] or kind[b] != kind[d]:
            continue
        if abs(n[a] @ n[b] - n[c] @ n[d]) > 0.01:
            continue
        R, _ = Rotation.align_vectors(n[[c, d]], n[[a, b]])
        moved = R.apply(n)
        on = [any(kind[i] == kind[j] and moved[i] @ n[j] > np.cos(0.1) for j in range(len(n))) for i in range(len(n))]
        assert not all(on)


@pytest.mark.parametrize("ball", [grzonka_ball(), contrast_ball(), led_ball()], ids=lambda b: b.name)
def test_discs_do_not_touch(ball):
    for a, b in itertools.combinations(ball.discs, 2):
        assert np.arccos(a.direction @ b.direction) > a.angle + b.angle + np.deg2rad(5)
