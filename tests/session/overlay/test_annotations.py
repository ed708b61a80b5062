"""Annotations: each mark where the picture or the geometry has it, as plain data."""

import json
from dataclasses import replace

import cv2
import numpy as np
from overlay_world import epochs

from spheremouse.ball.detect.appearance import ball_outline
from spheremouse.ball.detect.lookalikes import StaticDistractors
from spheremouse.ball.detect.rings import TargetDetections
from spheremouse.ball.state import lost
from spheremouse.geometry.camera import InteriorOrientation, project, sphere_outline
from spheremouse.geometry.rotation import exp, tangent_basis
from spheremouse.session.overlay.annotations import of_balls, of_discs, of_still, of_targets, plain
from spheremouse.tracker import Status
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.state import WandPose

DT = 1 / 30
CAMERA = InteriorOrientation(640, 480, 500.0, 505.0, 322.0, 238.0, np.array([-0.2, 0.05, 0.001, -0.001, 0.0]))
BALL = grzonka_ball()
PLACE, ATTITUDE = np.array([0.2, -0.1, 0.9]), exp(np.array([1.2, 0.4, -0.3]))
POSE = WandPose("grzonka", PLACE, ATTITUDE, 1e-4 * np.eye(6), Status.TRACKING, None, 1.0, 100.0, True)


def shape(values):
    xx, xy, yy = values
    return np.array([[xx, xy], [xy, yy]])


def inside(ellipse, size):
    """A mask, (h, w), of the pixels in an ellipse."""
    w, h = size
    offset = np.stack(np.meshgrid(np.arange(w) - ellipse["x"], np.arange(h) - ellipse["y"]), axis=-1)
    return np.einsum("hwi,ij,hwj->hw", offset, np.linalg.inv(shape(ellipse["shape"])), offset) < 1.0


def test_detected_and_predicted_discs_cover_those_of_the_picture():
    """The film's discs are black on grey, and the ball is at rest."""
    tracker, epoch = list(epochs(1280, 720, frames=3))[-1]
    marks = of_discs(epoch.state, tracker, DT)
    dark = epoch.frame.image[..., 0] < 115
    parts, labels = cv2.connectedComponents(dark.astype(np.uint8))
    assert len(marks["detected"]) == parts - 1 > 5  # the background is one
    assert sum(disc["used"] for disc in marks["detected"]) == len(epoch.state.filter.used)
    assert len(marks["predicted"]) >= 3
    for disc in marks["detected"] + marks["predicted"]:
        disc_pixels, ellipse = labels == labels[round(disc["y"]), round(disc["x"])], inside(disc, (1280, 720))
        assert np.sum(disc_pixels & ellipse) > 0.85 * np.sum(disc_pixels | ellipse)


def test_the_outline_and_the_targets_are_those_of_the_device():
    tracker, _ = next(epochs(640, 480))
    marks = of_still(tracker.rig, tracker.pose)
    outline = ball_outline(tracker.rig, tracker.pose)
    assert np.abs(np.array(marks["outline"]) - outline[::2]).max() < 0.006  # px: rounded
    assert [target["code"] for target in marks["targets"]] == list(tracker.rig.targets.codes)
    places = project(tracker.pose.to_cam(tracker.rig.targets.position), tracker.rig.camera)[0]
    assert np.allclose([[target["x"], target["y"]] for target in marks["targets"]], places, atol=0.3)


def test_a_gate_grows_with_the_interval_and_a_lost_ball_has_no_prediction():
    tracker, epoch = list(epochs(640, 480, frames=3))[-1]
    near, far = (of_discs(epoch.state, tracker, interval)["predicted"] for interval in (DT, 3 * DT))
    for a, b in zip(near, far, strict=True):
        assert np.linalg.det(shape(b["gate"])) > np.linalg.det(shape(a["gate"])) > 0.0
    assert of_discs(lost(epoch.state), tracker, DT)["predicted"] == []


def test_look_alikes_are_marked_where_they_are():
    tracker, epoch = list(epochs(640, 480, frames=2))[-1]
    state = epoch.state
    place = state.detections.centre[state.points.index[0]]
    points = state.points.take(np.arange(1, len(state.points)))
    masked = state._replace(
        points=points, filter=replace(state.filter, used=np.zeros(0, dtype=np.intp)),
        lookalikes=StaticDistractors(place[None], np.zeros(1)),
    )  # fmt: skip
    assert of_discs(masked, tracker, DT)["masked"] == [np.round(place, 2).tolist()]


def test_targets_that_the_rig_does_not_have_are_strangers():
    seen = TargetDetections(("MCY", "CMY"), np.array([[10.0, 20.0], [30.004, 40.0]]), np.array([5.0, 6.0]), ())
    marks = of_targets(seen, ("MCY",))
    assert marks["targets"] == [{"code": "MCY", "x": 10.0, "y": 20.0, "shape": [25.0, 0.0, 25.0]}]
    assert marks["strangers"] == [{"code": "CMY", "x": 30.0, "y": 40.0, "radius": 6.0}]


def test_discs_of_a_ball_in_a_hand_are_the_images_of_their_rims():
    """A rim that faces the camera as a whole lies on its ellipse, but for the lens' distortion."""
    turn, found = np.linspace(0.0, 2.0 * np.pi, 40), 0
    for attitude in map(exp, ([1.2, 0.4, -0.3], [2.0, 0.0, 0.5], [3.0, 0.3, 0.0])):
        ellipses = of_balls([(BALL, replace(POSE, rotation=attitude))], 0, CAMERA)["detected"]
        for disc in BALL.discs:
            around = tangent_basis(disc.direction) @ [np.cos(turn), np.sin(turn)]
            rim = attitude @ (np.cos(disc.angle) * disc.direction[:, None] + np.sin(disc.angle) * around)
            points = PLACE + BALL.radius * rim.T
            if np.all(np.sum(rim.T * points, axis=1) < 0.0):
                ellipse, found = ellipses.pop(0), found + 1
                offset = project(points, CAMERA)[0] - [ellipse["x"], ellipse["y"]]
                squared = np.einsum("ni,ij,nj->n", offset, np.linalg.inv(shape(ellipse["shape"])), offset)
                assert np.allclose(squared, 1.0, atol=0.1)
        assert ellipses == []
    assert found > 5


def test_each_ball_in_a_hand_has_an_outline_and_a_ball_that_is_not_seen_has_predictions():
    balls = [(BALL, POSE), (BALL, replace(POSE, seen=False)), (BALL, replace(POSE, position=None))]
    marks = of_balls(balls, 1, CAMERA)
    assert np.allclose(marks["outline"], sphere_outline(PLACE, BALL.radius, CAMERA, 90), atol=0.006)
    assert marks["others"] == [marks["outline"]]
    assert [disc["shape"] for disc in marks["predicted"]] == [disc["shape"] for disc in marks["detected"]]


def test_annotations_are_plain_data_with_every_key():
    tracker, epoch = list(epochs(640, 480, frames=2))[-1]
    marks = plain(3, Status.TRACKING, **of_still(tracker.rig, tracker.pose), **of_discs(epoch.state, tracker, DT))
    assert json.loads(json.dumps(marks, allow_nan=False)) == marks
    assert set(marks) == set(plain(None, Status.LOST))
    assert len(json.dumps(marks)) < 10_000
