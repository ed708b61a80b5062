"""Correspondences: a ball is found among clutter, and a disc has one number in all photos."""

import numpy as np
import pytest
from conftest import directions
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremouse.calibrate.device.correspond import Spots, directions_on_ball, find_ball, number_discs
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import project
from tests.calibrate.device.test_bundle import CAMERA, stations

CENTRE, RADIUS, DISC = np.array([0.32, 0.6, -0.56]), 0.6, 0.02


def spots(rng, poses, discs, bolts, clutter, sigma=0.3):
    """Discs on a ball, bolts half their size around it, and dark spots anywhere; which disc each is, -1 for none."""
    u = directions(discs, int(rng.integers(1 << 30)))
    ball = CENTRE + RADIUS * u
    fixed = np.concatenate(
        [
            rng.uniform([-0.1, -0.2, -0.05], [0.75, 1.3, 0.05], (bolts, 3)),  # on the frame, which is nearly flat
            rng.uniform([-2, -1, -3], [2, 2, -1], (clutter, 3)),
        ]
    )
    photo, centre, area, number = [], [], [], []
    for k, pose in enumerate(poses):
        points = np.concatenate([ball, fixed])
        way = pose.position - points
        distance = np.linalg.norm(way, axis=1)
        cosine = np.concatenate([np.sum(way[:discs] * u, axis=1) / distance[:discs], np.full(len(fixed), 0.25)])
        cam = pose.to_cam(points)
        uv, J = project(cam, CAMERA)
        seen = (cosine > 0.2) & (cam[:, 2] > 0) & np.all((uv > 0) & (uv < [1920, 1080]), axis=1)
        # area by the Jacobian along two directions across the ray
        across = np.linalg.svd(cam[:, None] / np.linalg.norm(cam, axis=1)[:, None, None])[2][:, 1:]
        magnify = np.abs(np.linalg.det(J @ across.transpose(0, 2, 1)))
        for i in np.flatnonzero(seen):
            photo.append(k)
            centre.append(uv[i] + sigma * rng.standard_normal(2))
            area.append(np.pi * DISC**2 * cosine[i] * magnify[i] * rng.uniform(0.8, 1.2))
            number.append(i if i < discs else -1)
    centres = np.array(centre, dtype=float).reshape(-1, 2)
    return Spots(np.array(photo, dtype=int), centres, np.array(area, dtype=float)), np.array(number, dtype=int)


@pytest.mark.slow
@given(seed=st.integers(0, 10**6))
@settings(max_examples=5)
def test_ball_is_found_among_bolts_and_dark_spots(seed):
    rng = np.random.default_rng(seed)
    poses = stations(rng, np.array([0.3, 0.5, -0.2]))
    seen, number = spots(rng, poses, 40, 14, 25)
    centre, radius = find_ball(seen, poses, CAMERA, DISC, 0.004)
    assert np.linalg.norm(centre - CENTRE) < 0.02
    assert radius == pytest.approx(RADIUS, abs=0.02)
    directions_, index = directions_on_ball(seen, poses, CAMERA, centre, radius)
    found = number_discs(seen.photo[index], directions_, DISC / RADIUS)
    for k in range(found.max() + 1):
        members = number[index[found == k]]
        assert len(np.unique(members[members >= 0])) <= 1  # never two discs under one number
    often = [i for i in range(40) if np.count_nonzero(number == i) >= 2]
    together = [i for i in often if len({int(n) for n in found[number[index] == i]} - {-1}) == 1]
    assert len(together) >= 0.9 * len(often)


def test_bolts_in_a_plane_are_no_ball():
    rng = np.random.default_rng(2)
    poses = stations(rng, np.array([0.3, 0.5, -0.2]))
    seen, number = spots(rng, poses, 1, 20, 10)
    none = Spots(seen.photo[number < 0], seen.centre[number < 0], seen.area[number < 0])
    with pytest.raises(CalibrationError):
        find_ball(none, poses, CAMERA, DISC, 0.004)


def test_of_two_spots_of_a_photo_the_nearer_is_the_disc():
    u = np.array([[0.0, 0, 1], [0.001, 0, 1], [0.0, 0.001, 1], [0.02, 0, 1], [1.0, 0, 0]])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    assert number_discs(np.array([0, 1, 2, 1, 2]), u, 0.03).tolist() == [0, 0, 0, -1, -1]
