"""Marks on pictures: where they are, how they are drawn, and the film with them."""

import json
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from invoking import invoke
from overlay_world import epochs
from scipy.spatial import cKDTree

from spheremouse.ball.detect.appearance import ball_outline
from spheremouse.ball.detect.lookalikes import StaticDistractors
from spheremouse.ball.detect.rings import RingSettings, TargetDetections
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.state import lost
from spheremouse.commands import app
from spheremouse.errors import OutputError
from spheremouse.files.wand import save_wand
from spheremouse.geometry.camera import InteriorOrientation, project, sphere_outline
from spheremouse.geometry.rotation import exp, tangent_basis
from spheremouse.output.sample import Sample
from spheremouse.session.overlay.annotations import of_balls, of_discs, of_still, of_targets, plain
from spheremouse.session.overlay.drawing import Overlay
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.session.overlay.pen import GREEN, RED, WHITE, in_blocks
from spheremouse.session.overlay.sight import draw_sight, sight_of
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.tracker import Status, unknown
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.state import WandPose
from tests.ball.detect.test_rings import RADII, blank, photo, target

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
        points=points, filter=state.filter._replace(used=np.zeros(0, dtype=np.intp)),
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


def test_targets_of_the_rig_strangers_and_a_grey_picture():
    image = blank(240, 320)
    target(image, "CMY", (80.0, 80.0), 20.0)
    target(image, "YCM", (220.0, 80.0), 20.0)
    sight = sight_of(photo(image), RADII, ("CMY", "MCY"), RingSettings())
    assert sight.strangers == ("YCM",)
    assert sight_of(photo(image), RADII, None, RingSettings()).strangers == ()
    assert len(sight_of(photo(image)[:, :, 0], RADII, ("CMY",), RingSettings()).targets) == 0
    kept = sight.kept((240, 320)) > 0
    assert kept[80, 80 + 38]
    assert not kept[80, 80 + 42]
    assert draw_sight(photo(image), sight, (("words", 0.0),)).shape == (960, 1280, 3)


def test_blocks_hide_what_is_not_kept_and_nothing_else():
    rng = np.random.default_rng(0)
    for shape in ((480, 640, 3), (480, 640), (7, 1000, 3)):
        image = rng.integers(0, 256, shape).astype(np.uint8)
        keep = np.zeros(shape[:2], np.uint8)
        keep[:5, :50] = 255
        made = in_blocks(image, keep)
        assert np.array_equal(made[keep > 0], image[keep > 0])
        hidden = made[keep == 0].reshape(int((keep == 0).sum()), -1)
        assert len(np.unique(hidden, axis=0)) <= 24 * max(1, round(24 * shape[0] / shape[1]))


def test_a_file_has_its_name_only_when_it_is_complete(tmp_path):
    path = tmp_path / "seen.mp4"
    with OverlayFile(path, 30.0) as file:
        for k in range(3):
            file.show(lambda level=k: np.full((480, 640, 3), 80 * level, np.uint8))
            assert not path.exists()
            assert len(list(tmp_path.iterdir())) == 1
    assert list(tmp_path.iterdir()) == [path]
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(30.0)
    read = [capture.read()[0] for _ in range(4)]
    capture.release()
    assert read == [True, True, True, False]


def test_no_frame_gives_no_file(tmp_path):
    for name in ("seen.png", "seen.avi"):
        with OverlayFile(tmp_path / name, None):
            pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["seen.gif", "seen", "nowhere/seen.png"])
def test_what_cannot_be_written_is_refused_at_once(tmp_path, name):
    with pytest.raises(OutputError, match=name):
        OverlayFile(tmp_path / name, 30.0)


@pytest.mark.parametrize(
    "name",
    ["film/video.mkv", "film/scene.json", "film/frames/000000.png", "axes.png", "out.mp4", "ball.avi", "folder.mp4"],
)
@pytest.mark.slow
def test_an_overlay_destroys_nothing_that_the_run_needs(tmp_path, name):
    film = prepare_wand(WandOptions(motion="hand", size=(320, 240), seconds=0.2, seed=2))
    list(write_wand(tmp_path / "film", film))
    (tmp_path / "film" / "frames").mkdir()  # as recordings of single frames have it
    (tmp_path / "film" / "frames" / "000000.png").write_bytes(b"a frame")
    save_wand(tmp_path / "ball.avi", grzonka_ball())
    (tmp_path / "folder.mp4").mkdir()
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    words = ("--output", f"text:{tmp_path / 'out.mp4'}", "--output", f"text:{tmp_path / 'axes.png'}")
    code, output = invoke(
        app, "run", "--tracker", "wand", "--source", f"dataset:{tmp_path / 'film'}", *words,
        "--ball", tmp_path / "ball.avi", "--overlay", tmp_path / name,
    )  # fmt: skip
    assert code == 2
    assert str(tmp_path / name) in output
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
