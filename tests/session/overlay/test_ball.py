"""The overlay: each mark where the geometry says, on frames of any size, colour or grey, which stay untouched."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from overlay_world import epochs
from scipy.spatial import cKDTree

from spheremouse.ball.build import begin
from spheremouse.ball.detect.appearance import ball_outline
from spheremouse.ball.state import Epoch, lost
from spheremouse.ball.track import step
from spheremouse.errors import OutputError
from spheremouse.session.overlay.ball import Overlay
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.session.overlay.marks import target_marks
from spheremouse.session.overlay.pen import GREEN, OUTLINE, RED, WHITE
from spheremouse.tracker import Frame

SIZES = ((640, 480), (1280, 720))


def is_near(image, colour, tolerance=60):
    return np.abs(image.astype(int) - colour).max(axis=2) <= tolerance


def close_to(mask, points, within):
    """Whether each of the points, (n, 2), has a set pixel within so many pixels."""
    v, u = np.nonzero(mask)
    if len(u) == 0:
        return np.zeros(len(points), dtype=bool)
    return cKDTree(np.stack([u, v], axis=1)).query(points)[0] <= within


@pytest.mark.parametrize("size", SIZES)
def test_each_mark_is_where_the_geometry_says(size):
    tracker, epoch = list(epochs(*size, frames=2))[-1]
    marks = target_marks(tracker.rig, tracker.pose, None)
    assert [m.code for m in marks] == list(tracker.rig.targets.codes)
    before = epoch.frame.image.copy()
    overlay = Overlay(tracker, marks)
    overlay.remember(epoch.state)
    drawn = overlay.draw(epoch, (1, -2, 3))
    np.testing.assert_array_equal(epoch.frame.image, before)
    assert drawn.shape == before.shape
    assert len(epoch.state.filter.discs) >= 3
    # the strip with numbers hides what lies in it, and the picture's edge the rest
    inside = lambda p: p[np.all((p > 5) & (p < np.array(size) - [5, 5 + 30 * size[1] / 480]), axis=1)]  # noqa: E731
    seen = inside(epoch.state.detections.centre[epoch.state.points.index[epoch.state.filter.used]])
    assert len(seen) >= 3
    width = max(1, round(size[1] / 480))
    assert close_to(is_near(drawn, RED), seen, width).all()  # a still ball: predicted where detected
    assert close_to(is_near(drawn, WHITE, 30), seen, tracker_disc_px(tracker)).all()
    assert close_to(is_near(drawn, GREEN, 40), inside(np.array([m.centre for m in marks])), 2 * width).all()
    changed = np.any(drawn != before, axis=2)
    assert close_to(changed, inside(ball_outline(tracker.rig, tracker.pose)), 1.5).mean() > 0.95
    assert np.mean(changed) < 0.2  # and the rest of the picture is left alone
    assert OUTLINE != WHITE


def tracker_disc_px(tracker):
    """px, more than any disc's radius."""
    return 1.5 * 0.02 * tracker.rig.camera.fx / (np.linalg.norm(tracker.pose.position) - tracker.rig.ball.radius)


def test_contours_are_drawn_as_the_detector_found_them():
    tracker, epoch = list(epochs(640, 480, detector="blobs", frames=2))[-1]
    assert len(epoch.state.detections.contours) == len(epoch.state.detections)
    drawn = Overlay(tracker).draw(epoch, (0, 0, 0))
    white = is_near(drawn, WHITE, 50)
    for index in epoch.state.points.index[epoch.state.filter.used]:
        contour = epoch.state.detections.contours[index].reshape(-1, 2).astype(float)
        if contour[:, 1].max() < 440:
            assert close_to(white, contour, 1.5).all()


def test_older_epochs_are_smaller_and_fainter_and_gone_in_the_end():
    tracker, epoch = list(epochs(640, 480, frames=2))[-1]
    state = epoch.state
    overlay = Overlay(tracker)
    red = []
    for _ in range(17):
        drawn = overlay_after(overlay, state, tracker, epoch)
        red.append(int(np.sum(np.maximum(drawn[..., 2].astype(int) - drawn[..., 0], 0))))
    assert all(a > b for a, b in pairwise(red[:16]))
    assert red[15] == red[16] == 0


def overlay_after(overlay, state, tracker, epoch):
    """The picture with what is remembered so far; then one more epoch passes in which nothing is predicted."""
    if not overlay._trace:
        overlay.remember(state)
    drawn = overlay.draw(epoch, (0, 0, 0))
    overlay.remember(lost(state))
    return drawn


def test_a_grey_frame_and_a_picture_without_anything_can_be_drawn():
    tracker, epoch = next(epochs(640, 480))
    blank = Frame(np.full((480, 640), 128, np.uint8), 1.0, 30)
    state, motion, events = step(begin(tracker, 0.0), blank, tracker)
    overlay = Overlay(tracker, scale=2)
    overlay.remember(state)
    drawn = overlay.draw(Epoch(blank, state, motion, events, {}), (0, 0, 0))
    assert drawn.shape == (960, 1280, 3)
    assert len(state.points) == 0
    assert epoch.frame.image.ndim == 3


def test_a_file_has_its_name_only_when_it_is_complete(tmp_path):
    path = tmp_path / "seen.mp4"
    with OverlayFile(path, 30.0) as file:
        for k, (tracker, epoch) in enumerate(epochs(640, 480, frames=3)):
            if k == 0:
                file.begin(tracker, ())
            file.add(epoch, lambda: (0, 0, 0))
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
