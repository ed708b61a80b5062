"""The overlay: each mark where the geometry says, on frames of any size, colour or grey, which stay untouched."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from overlay_world import epochs
from scipy.spatial import cKDTree

from spheremouse.ball.detect.appearance import ball_outline
from spheremouse.ball.pose import predict_targets
from spheremouse.output.sample import Sample
from spheremouse.session.overlay.annotations import of_balls, of_discs, of_still, plain
from spheremouse.session.overlay.drawing import Overlay
from spheremouse.session.overlay.pen import GREEN, RED, WHITE
from spheremouse.tracker import Status, unknown
from spheremouse.wand.ball import grzonka_ball
from tests.session.overlay.test_annotations import CAMERA, DT, POSE

BALL = grzonka_ball()
GREY = np.full((480, 640, 3), 90, np.uint8)


def marks_of(tracker, epoch):
    return plain(0, Status.TRACKING, **of_still(tracker.rig, tracker.pose), **of_discs(epoch.state, tracker, DT))


def drawn(image, marks, sample, scale=1):
    overlay = Overlay(scale)
    overlay.remember(marks)
    return overlay.draw(image, marks, sample, (1, -2, 3))


def is_near(image, colour, tolerance=60):
    return np.abs(image.astype(int) - colour).max(axis=2) <= tolerance


def close_to(mask, points, within):
    """Whether each of the points, (n, 2), has a set pixel within so many pixels."""
    v, u = np.nonzero(mask)
    if len(u) == 0:
        return np.zeros(len(points), dtype=bool)
    return cKDTree(np.stack([u, v], axis=1)).query(points)[0] <= within


@pytest.mark.parametrize("size", [(640, 480), (1280, 720)])
def test_each_mark_is_where_the_geometry_says(size):
    tracker, epoch = list(epochs(*size, frames=2))[-1]
    before = epoch.frame.image.copy()
    image = drawn(epoch.frame.image, marks_of(tracker, epoch), Sample(epoch.estimate))
    np.testing.assert_array_equal(epoch.frame.image, before)
    # the strip with numbers hides what lies in it, and the picture's edge the rest
    inside = lambda p: p[np.all((p > 5) & (p < np.array(size) - [5, 5 + 30 * size[1] / 480]), axis=1)]  # noqa: E731
    seen = inside(epoch.state.detections.centre[epoch.state.points.index[epoch.state.filter.used]])
    assert len(seen) >= 3
    width = max(1, round(size[1] / 480))
    disc_px = 1.5 * 0.02 * tracker.rig.camera.fx / (np.linalg.norm(tracker.pose.position) - tracker.rig.ball.radius)
    assert close_to(is_near(image, RED), seen, width).all()  # a still ball: predicted where detected
    assert close_to(is_near(image, WHITE, 30), seen, disc_px).all()
    targets = predict_targets(tracker.pose, tracker.rig)
    assert close_to(is_near(image, GREEN, 40), inside(targets), 2 * width).all()
    changed = np.any(image != before, axis=2)
    assert close_to(changed, inside(ball_outline(tracker.rig, tracker.pose)), 1.5).mean() > 0.95
    assert np.mean(changed) < 0.2  # and the rest of the picture is left alone


def test_older_predictions_are_smaller_and_fainter_and_gone_in_the_end():
    tracker, epoch = list(epochs(640, 480, frames=2))[-1]
    marks, overlay, red = marks_of(tracker, epoch), Overlay(), []
    for age in range(17):
        overlay.remember(marks if age == 0 else plain(age, Status.LOST))
        image = overlay.draw(epoch.frame.image, marks, Sample(epoch.estimate), (0, 0, 0))
        red.append(int(np.sum(np.maximum(image[..., 2].astype(int) - image[..., 0], 0))))
    assert all(a > b for a, b in pairwise(red[:16]))
    assert red[15] == red[16] == 0


def test_a_grey_frame_without_marks_can_be_drawn():
    _, epoch = next(epochs(640, 480))
    assert drawn(GREY[:, :, 0], plain(None, Status.LOST), Sample(epoch.estimate), 2).shape == (960, 1280, 3)


def held(**changes):
    """The picture of a ball in a hand."""
    pose = replace(POSE, **changes)
    estimate = unknown(1.5)._replace(status=pose.phase, confirmed=pose.seen, covariance=1e-4 * np.eye(12))
    marks = plain(0, pose.phase, **of_balls([(BALL, pose)], 0, CAMERA))
    return drawn(GREY, marks, Sample(estimate, coordinates="cam"))[:440]


def test_discs_of_a_ball_in_a_hand_are_white_those_of_a_hidden_one_red_and_a_lost_one_has_none():
    seen, hidden = held(), held(seen=False)
    assert is_near(seen, WHITE).sum() > 40
    assert is_near(hidden, WHITE).sum() == is_near(seen, RED).sum() == 0
    assert is_near(hidden, RED).sum() > 3
    assert (held(position=None, rotation=None, covariance=None, phase=Status.LOST, seen=False) == 90).all()


@pytest.mark.parametrize(
    "place", [(0.0, 0.0, 0.06), (0.0, 0.0, 0.02), (0.5, 0.0, 0.07), (0.0, 0.0, -1.0), (3.0, 2.0, 1.0)]
)
def test_balls_at_the_camera_or_out_of_view_do_no_harm(place):
    with np.errstate(all="raise"):
        assert held(position=np.array(place)).shape == (440, 640, 3)
