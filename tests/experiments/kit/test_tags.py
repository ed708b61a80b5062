"""Sheets painted onto a picture: as the renderer has them, tags where OpenCV finds them, nothing else touched."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from experiments.kit.tags import painted, ring_sheet, tag_cells, tag_corners, tag_sheet

from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import exp
from spheremouse.simulate.ball.backdrop import render_backdrop
from spheremouse.simulate.ball.scene import default_scene, frame

FAMILY = cv2.aruco.DICT_4X4_50
HALF = 0.036  # m


@pytest.fixture(scope="module")
def scene():
    """The frame without a room and without targets, seen by a camera that is turned about its axis."""
    scene = default_scene(1, "far", width=480, height=360)
    none = replace(scene.targets, ids=(), codes=(), position=np.zeros((0, 3)))
    pose = replace(scene.pose, rotation=scene.pose.rotation @ exp(np.array([0.0, 0.0, 0.2])))
    return replace(scene, pose=pose, surroundings=tuple(frame(none, 0.0105)))


@pytest.fixture(scope="module")
def bare(scene):
    return render_backdrop(scene).white


def test_rings_look_as_the_renderer_has_them(scene, bare):
    rendered = render_backdrop(replace(scene, surroundings=tuple(frame(scene.targets, 0.0105)))).white
    targets = scene.targets
    sheets = [ring_sheet(p, targets.radii, c) for p, c in zip(targets.position, targets.codes, strict=True)]
    picture = painted(bare, scene, sheets)
    touched = np.abs(rendered - bare).max(axis=2) > 1.0
    assert np.count_nonzero(touched) > 1000
    assert np.abs(picture - rendered)[touched].mean() < 2.0  # grey values; rays are cast otherwise along edges
    assert np.abs(picture - bare).max(axis=2)[~touched].max() < 10.0  # slivers of pixels along the cards


def test_tags_are_where_they_were_put(scene, bare):
    where = scene.targets.position
    picture = painted(bare, scene, [tag_sheet(p, HALF, tag_cells(FAMILY, 10 + i)) for i, p in enumerate(where)])
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(FAMILY))
    corners, ids, _ = detector.detectMarkers(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    assert sorted(ids.ravel()) == [10, 11, 12, 13]
    true = project(scene.pose.to_cam(tag_corners(where, HALF).reshape(-1, 3)), scene.camera)[0].reshape(-1, 4, 2)
    for quad, number in zip(corners, ids.ravel(), strict=True):
        assert np.abs(quad[0] - true[number - 10]).max() < 1.6  # px: without refinement, and in the same order


def test_a_sheet_covers_what_it_covers(scene, bare):
    """A grey level that follows from areas: of a tag, the share of black cells."""
    cells = tag_cells(FAMILY, 3)
    sheet = tag_sheet(scene.targets.position[0], HALF, cells)
    plain = replace(sheet, colour_at=lambda place: np.ones(len(place), dtype=np.intp))
    black = replace(sheet, colour_at=lambda place: np.zeros(len(place), dtype=np.intp))
    tag, white, dark = (painted(bare, scene, [s]).astype(float).sum() for s in (sheet, plain, black))
    share = np.count_nonzero(~cells) / cells.size / 1.22**2  # of the sheet, its margin included
    assert (white - tag) / (white - dark) == pytest.approx(share, abs=0.01)
