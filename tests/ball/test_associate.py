"""Identification of discs: random attitudes, symmetric maps, other balls and chance."""

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from spheremouse.ball.associate import common_rotation, identify
from spheremouse.geometry.rotation import exp, log

CAMERA = np.array([0.0, 0.0, 1.0])
HORIZON = 0.25
SIGMA = np.deg2rad(0.1)


def anywhere(n, rng):
    """Directions on the near side, where detections can be."""
    z, a = rng.uniform(HORIZON + 0.1, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)


def seen(discs, R, rng, missing=0.0, spurious=0, sigma=SIGMA, most=None):
    """Directions of a map at attitude R with noise, some missing, some spurious, in random order."""
    p = discs @ R.T
    p = rng.permutation(p[p[:, 2] > HORIZON + 0.1])
    p = p[rng.random(len(p)) >= missing][:most]
    p = p + sigma * rng.normal(size=p.shape)
    p = np.concatenate([p, anywhere(spurious, rng)])
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    return p[rng.permutation(len(p))]


def identified(points, discs, sigma=SIGMA, **more):
    return identify(points, discs, sigma=sigma, view_axis=CAMERA, horizon=HORIZON, **more)


def error(result, R):
    return np.linalg.norm(log(result.rotation @ R.T))


@pytest.mark.parametrize(
    ("found", "risk", "points"),
    [
        (0.99, 0.05, {"most": 5, "spurious": 1}),
        (0.97, 0.05, {"missing": 0.2, "spurious": 1}),
        (0.5, 1e-3, {"missing": 0.5, "spurious": 5}),
    ],
)
def test_missing_and_spurious_points_make_it_silent_not_wrong(found, risk, points):
    """500 random attitudes of 25 maps; docs/identification_figures.py does 30,000."""
    rng, answers = np.random.default_rng(1), 0
    for i in range(500):
        discs, R = directions(26, i % 25), Rotation.random(random_state=i).as_matrix()
        result = identified(seen(discs, R, rng, **points), discs, risk=risk)
        answers += result is not None
        assert result is None or error(result, R) < 10 * SIGMA
    assert answers > found * 500


def test_an_identification_says_which_is_which():
    rng = np.random.default_rng(2)
    for i in range(50):
        discs = directions(26, i % 25)
        R = Rotation.random(random_state=i).as_matrix()
        points = seen(discs, R, rng, spurious=1)
        result = identified(points, discs)
        if result is None:
            continue
        assert 0.0 <= result.false_alarm <= 0.05
        a, b = result.pairs.T
        assert len(a) >= 3
        assert len(set(a)) == len(a) == len(set(b))
        assert_allclose(discs[b] @ result.rotation.T, points[a], atol=6 * SIGMA)
        assert_allclose(result.rotation @ result.rotation.T, np.eye(3), atol=1e-12)


def test_another_ball_and_random_directions_are_not_identified():
    rng = np.random.default_rng(3)
    other = chance = 0
    for i in range(300):
        R = Rotation.random(random_state=i).as_matrix()
        other += identified(seen(directions(26, i % 20), R, rng), directions(26, 100 + i % 20)) is not None
        chance += identified(anywhere(8, rng), directions(26, i % 10)) is not None
    assert other <= 3
    assert chance <= 6  # the risk is 5 %


def cube():
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)


def ring():
    a = np.arange(12) * np.pi / 6
    return np.stack([np.cos(a), np.sin(a), np.zeros(12)], axis=1)


def two_fold():
    """Half a turn about z makes no difference."""
    half = directions(26, 9)
    half = half[half[:, 0] > 0.15]
    return np.concatenate([half, half * [-1, -1, 1]])


@pytest.mark.parametrize("layout", [cube, ring, two_fold])
@pytest.mark.parametrize("degrees", [0.1, 3.0])
def test_symmetric_layouts_are_ambiguous(layout, degrees):
    rng = np.random.default_rng(4)
    for i in range(40):
        R = Rotation.random(random_state=i).as_matrix()
        points = seen(layout(), R, rng, missing=0.1, sigma=np.deg2rad(degrees))
        assert identified(points, layout(), np.deg2rad(degrees)) is None


def test_a_disc_that_breaks_the_symmetry_decides_if_it_is_seen():
    rng = np.random.default_rng(4)
    discs = two_fold()
    discs[0] = exp(np.deg2rad(5.0) * np.cross(discs[0], [0.0, 0.0, 1.0])) @ discs[0]
    partner = int(np.argmax(discs @ (discs[0] * [-1, -1, 1])))
    found = 0
    for i in range(150):
        R = Rotation.random(random_state=i).as_matrix()
        shows = max(discs[0] @ R[2], discs[partner] @ R[2]) > HORIZON + 0.1
        result = identified(seen(discs, R, rng), discs)
        if result is not None:
            found += 1
            assert error(result, R) < 10 * SIGMA
            assert shows
    assert found > 20


def test_the_far_side_of_the_ball_does_not_count():
    """A map whose two halves hold the same constellation: only what can be seen may decide."""
    rng = np.random.default_rng(5)
    half = directions(10, 6)
    half = half[half[:, 2] > 0.1]
    turn = exp(np.array([np.pi, 0.0, 0.0]))
    twice = np.concatenate([half, half @ turn.T])
    for R in (np.eye(3), turn.T):
        result = identified(seen(twice, R, rng), twice)
        assert result is None or np.linalg.norm(log(result.rotation @ R.T)) < 5 * SIGMA


@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_tell_nothing(n):
    discs = directions(26, 7)
    assert identified(discs[:n], discs) is None
    assert identified(discs, discs[:n]) is None
    assert common_rotation(discs[:n], discs, SIGMA) is None
    assert common_rotation(discs, discs[:n], SIGMA) is None


def test_degenerate_points_are_no_constellation():
    discs = directions(26, 8)
    same = np.tile([0.0, 0.0, 1.0], (6, 1))
    opposite = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    for points in (same, opposite, np.full((4, 3), np.nan)):
        assert identified(points, discs) is None
        assert identified(discs, points) is None


def test_more_directions_than_a_side_can_hold():
    rng = np.random.default_rng(11)
    discs = directions(26, 3)
    R = Rotation.random(random_state=5).as_matrix()
    result = identified(seen(discs, R, rng, spurious=300), discs)
    assert result is None or error(result, R) < 10 * SIGMA
    many = directions(120, 3, least=0.1)
    result = identified(seen(many, R, rng, spurious=30), many)
    assert result is not None
    assert error(result, R) < 10 * SIGMA
    assert len(result.pairs) > 20


def test_a_direction_seen_twice_counts_once():
    rng = np.random.default_rng(12)
    discs = directions(26, 3)
    R = Rotation.random(random_state=5).as_matrix()
    points = seen(discs, R, rng)
    result = identified(np.concatenate([points, points]), discs)
    assert result is not None
    assert len(set(result.pairs[:, 1])) == len(result.pairs) == len(points)
    twice = np.concatenate([points[:2], points[:2], points[:2]])  # six directions, but two places
    assert identified(twice, discs) is None


def test_rows_that_are_no_number_are_left_out_and_keep_their_place():
    rng = np.random.default_rng(13)
    discs = directions(26, 3)
    R = Rotation.random(random_state=5).as_matrix()
    points = seen(discs, R, rng)
    plain = identified(points, discs)
    holes = identified(np.insert(points, 2, np.nan, axis=0), np.insert(discs, 0, np.nan, axis=0))
    assert_allclose(holes.rotation, plain.rotation, atol=1e-12)
    assert set(map(tuple, holes.pairs)) == {(a + (a >= 2), b + 1) for a, b in plain.pairs}


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ({"sigma": 0.0}, "give rad"),
        ({"sigma": np.nan}, "give rad"),
        ({"horizon": 1.0}, "give a number"),
        ({"risk": 0.0}, "give a number"),
        ({"risk": 1.0}, "give a number"),
        ({"directions": 2.0 * np.eye(3)}, "^directions must be of unit length"),
        ({"map_directions": 2.0 * np.eye(3)}, "^map_directions must be of unit length"),
        ({"directions": np.zeros((4, 2))}, r"^directions must be unit vectors in rows, \(n, 3\)"),
        ({"directions": np.zeros((2, 2, 3))}, r"^directions must be unit vectors in rows, \(n, 3\)"),
        ({"view_axis": 2.0 * CAMERA}, "^view_axis must be of unit length"),
        ({"view_axis": np.array([0.0, 1.0])}, "^view_axis must be"),
        ({"min_sigma": 0.0}, "^min_sigma 0.0 is no standard deviation up to 0.01"),
        ({"min_sigma": 0.02}, "^min_sigma 0.02 is no standard deviation up to 0.01"),
    ],
)
def test_arguments_that_mean_nothing_are_refused_by_name(wrong, problem):
    plain = {"directions": np.eye(3), "map_directions": np.eye(3), "sigma": 0.01, "view_axis": CAMERA}
    with pytest.raises(ValueError, match=problem):
        identify(**(plain | wrong))


def test_common_rotation_of_two_sights():
    rng = np.random.default_rng(9)
    done = 0
    for i in range(60):
        discs = directions(26, i)
        before = seen(discs, np.eye(3), rng)
        R = exp(rng.normal(size=3) * 0.05)
        after = seen(discs, R, rng, missing=0.2, spurious=2)
        if np.sum(np.max(after @ R @ before.T, axis=1) > np.cos(5 * SIGMA)) < 3:
            continue
        result = common_rotation(before, after, SIGMA)
        assert result is not None
        done += 1
        rotation, pairs = result
        assert np.linalg.norm(log(rotation @ R.T)) < 6 * SIGMA
        assert_allclose(before[pairs[:, 0]] @ rotation.T, after[pairs[:, 1]], atol=7 * SIGMA)
    assert done > 50


def test_of_equal_agreements_the_smallest_rotation_is_common():
    """A ring of discs, turned by a third of its spacing: it could have come from either side, or farther."""
    angle = np.arange(8) * (2 * np.pi / 8)
    ring = np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(8, 0.8)], axis=1)
    R = exp(np.array([0.0, 0.0, 2 * np.pi / 24]))
    result = common_rotation(ring, ring @ R.T, SIGMA)
    assert result is not None
    assert_allclose(result[0], R, atol=1e-9)


def test_unrelated_sights_share_at_most_chance():
    rng = np.random.default_rng(10)
    for _ in range(30):
        result = common_rotation(anywhere(4, rng), anywhere(4, rng), 1e-5)
        assert result is None
