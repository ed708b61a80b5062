"""What views of a board cover, and what is missing in words."""

import numpy as np
import pytest

from spheremouse.calibrate.camera.coverage import (
    LEANS,
    VIEWS,
    coverage,
    enough,
    gain,
    leans_of,
    missing,
    missing_regions,
)
from spheremouse.geometry.rotation import exp

SIZE = 600, 400


def block(x, y, side=20.0):
    """Sixteen corners in a square whose middle is x, y."""
    a = np.linspace(-0.5, 0.5, 4) * side
    return np.array([[x + dx, y + dy] for dx in a for dy in a])


def tilted(degrees, axis):
    return exp(np.radians(degrees) * np.asarray(axis, float))


@pytest.mark.parametrize(
    ("axis", "way"),
    [((0.0, 1.0, 0.0), "left"), ((0.0, -1.0, 0.0), "right"), ((-1.0, 0.0, 0.0), "up"), ((1.0, 0.0, 0.0), "down")],
)
def test_a_board_leans_where_its_face_points(axis, way):
    """R_cam_board turns the board's axes; its face looks along -Z. Turned about y (down) by the right hand, the face
    that looked at the camera (-z) looks to -x: to the left."""
    R = tilted(30.0, axis)
    face = -R[:, 2]
    assert {"left": -face[0], "right": face[0], "up": -face[1], "down": face[1]}[way] == pytest.approx(0.5)
    assert dict(zip(LEANS, leans_of(R), strict=True)) == {w: w == way for w in LEANS}
    assert not leans_of(tilted(10.0, axis)).any()
    turned = R @ tilted(90.0, (0.0, 0.0, 1.0))  # a board on its side leans the same way
    assert np.array_equal(leans_of(turned), leans_of(R))


def test_what_is_missing_is_named():
    grid = [block(50.0 + 100.0 * i, 50.0 + 100.0 * j) for i in range(6) for j in range(4)]
    all_but_one = [uv for uv in grid if not (uv[0, 0] > 500.0 and uv[0, 1] < 100.0)]
    flat = np.broadcast_to(np.eye(3), (len(all_but_one), 3, 3))
    found = coverage(SIZE, all_but_one, flat)
    assert missing_regions(found) == ["in the upper right corner"]
    assert missing(found)[-1] == "hold the board in the upper right corner of the picture"
    assert [f"faces {way}" in " ".join(missing(found)) for way in LEANS] == [True] * 4
    assert not enough(found)
    middle = coverage(SIZE, [block(250.0, 150.0)], np.eye(3)[None])
    assert "in the middle" in missing_regions(middle)  # the other regions there
    assert {"at the top edge", "at the left edge", "in the lower left corner"} <= set(missing_regions(middle))


def test_enough_is_all_regions_all_ways_and_ten_views():
    rng = np.random.default_rng(0)
    everywhere = np.array([[50.0 + 100.0 * i, 50.0 + 100.0 * j] for i in range(6) for j in range(4)]).repeat(2, axis=0)
    ways = [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]
    R = np.array([tilted(30.0, ways[i % 4]) for i in range(VIEWS)])
    corners = [everywhere + rng.uniform(-3.0, 3.0, 2) for _ in range(VIEWS)]
    assert enough(coverage(SIZE, corners, R))
    assert not enough(coverage(SIZE, corners[:-1], R[:-1]))
    assert missing(coverage(SIZE, corners[:-1], R[:-1])) == []


def test_a_view_gains_what_no_view_showed():
    corners, R = [block(250.0, 150.0)], np.eye(3)[None]
    found = coverage(SIZE, corners, R)
    assert gain(found, SIZE, block(50.0, 50.0), np.eye(3), corners) == "in the upper left corner"
    assert gain(found, SIZE, corners[0] + 1.0, np.eye(3), corners) is None
    assert gain(found, SIZE, corners[0] + 1.0, tilted(30.0, (0.0, 1.0, 0.0)), corners) == "facing left"
    twice = coverage(SIZE, corners * 3, np.array([np.eye(3), *[tilted(30.0, (0.0, 1.0, 0.0))] * 2]))
    assert gain(twice, SIZE, corners[0] + 1.0, tilted(30.0, (0.0, 1.0, 0.0)), corners) is None
