"""FicTrac's columns: a parser from FicTrac's own documentation reads them, and finds the motion that was made."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reporting import refused
from scipy.spatial.transform import Rotation

from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.geometry.camera import Pose
from spheremouse.output import Report
from spheremouse.output.fictrac import FicTrac
from spheremouse.output.sample import Sample
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.settings import Configuration
from spheremouse.tracker import Status, unknown

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"
SEEDS = st.integers(0, 2**32 - 1)

# FicTrac's doc/data_header.txt: first column of each value, and how many it has.
COLUMNS = {
    "frame": (1, 1),
    "delta_cam": (2, 3),
    "error": (5, 1),
    "delta_lab": (6, 3),
    "absolute_cam": (9, 3),
    "absolute_lab": (12, 3),
    "position": (15, 2),
    "heading": (17, 1),
    "direction": (18, 1),
    "speed": (19, 1),
    "integrated": (20, 2),
    "timestamp": (22, 1),
    "sequence": (23, 1),
    "delta_timestamp": (24, 1),
    "alt_timestamp": (25, 1),
}


def parse(line):
    """Return a line's values by name. FicTrac's socket client splits at ", " and expects the word FT first."""
    word, *fields = line.decode().split(", ")
    assert word == "FT"
    assert len(fields) == 25
    assert all(fields[column - 1].isdigit() for column in (1, 23))  # its client reads them with int()
    read = {name: np.array(fields[first - 1 : first - 1 + n], dtype=float) for name, (first, n) in COLUMNS.items()}
    return {name: values if len(values) > 1 else float(values[0]) for name, values in read.items()}


def estimate(k, increment=(0, 0, 0), rotation=None, status=Status.TRACKING, confirmed=True):
    made = unknown(0.1 * k, k, status)
    turned = np.array([*increment, 0, 0, 0], dtype=float)
    return made._replace(
        increment=turned, confirmed=confirmed, rotation=made.rotation if rotation is None else rotation
    )


def lines_of(form, made, **more):
    return form.lines(Report((0, 0, 0), None, 0.0, (Sample(made, **more),)))


def walk(increments, camera=None, **options):
    """Return the values of each line of a ball that makes some increments in obj, (n, 3) rad."""
    form, camera = FicTrac(**options), camera or Pose(np.eye(3), np.array([0.0, 0.0, 3.0]))
    rotation, read = Rotation.identity(), []
    for k, increment in enumerate(increments):
        rotation = Rotation.from_rotvec(increment) * rotation
        (line,) = lines_of(form, estimate(k, increment, rotation.as_matrix()), camera=camera)
        read.append(parse(line))
    return read


# An animal on top of the ball looks along -Z of obj. A step moves the ball's top to the other side.
FORWARD, RIGHT, TURN_RIGHT = np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0])


def test_a_walk_round_a_square_ends_where_it_began():
    """North is +x, east is +y."""
    side = [0.1 * FORWARD, 0.1 * FORWARD, np.pi / 2 * TURN_RIGHT]
    read = walk(side * 4)
    corners = [read[k]["position"] for k in (2, 5, 8, 11)]
    assert np.allclose(corners, [[0.2, 0], [0.2, 0.2], [0, 0.2], [0, 0]], atol=1e-12)
    assert np.allclose([read[k]["heading"] for k in (2, 5, 8)], [np.pi / 2, np.pi, 3 * np.pi / 2], atol=1e-12)
    assert np.allclose(read[-1]["integrated"], [0.8, 0])  # neglects the heading
    assert [read[0]["speed"], read[2]["speed"]] == pytest.approx([0.1, 0.0])


def test_an_even_turn_while_walking_is_a_circle():
    """n steps of a forward and b to the right make a regular arc of radius a / b, whatever the step is."""
    radius, steps = 2.0, 50
    read = walk([radius * 0.1 * FORWARD + 0.1 * TURN_RIGHT] * steps)
    angle = 0.1 * (1 + np.arange(steps))
    circle = radius * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
    assert np.allclose([r["position"] for r in read], circle, atol=1e-12)
    assert np.allclose([r["heading"] for r in read], angle % (2 * np.pi), atol=1e-12)


def test_the_direction_is_relative_to_the_heading():
    directions = [walk([step])[0]["direction"] for step in (FORWARD, RIGHT, -FORWARD, -RIGHT)]
    assert directions == pytest.approx([0, np.pi / 2, np.pi, 3 * np.pi / 2])


@pytest.mark.parametrize(("forward", "step"), [(0, FORWARD), (90, RIGHT), (180, -FORWARD), (270, -RIGHT)])
def test_the_forward_direction_can_be_another(forward, step):
    (read,) = walk([0.1 * step], forward=forward)
    assert np.allclose(read["position"], [0.1, 0], atol=1e-12)


@given(SEEDS)
def test_all_frames_tell_one_rotation(seed):
    """The axes of columns 6-8 are fixed in obj, those of columns 2-4 in the camera, or in the window."""
    rng = np.random.default_rng(seed)
    pose = Pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3) * 2)
    increments = 0.2 * rng.normal(size=(5, 3))
    camera, window = walk(increments, pose), walk(increments, pose, frame="window")
    R_obj_cam = Rotation.from_matrix(pose.rotation)
    absolute = Rotation.identity()
    for made, read, other in zip(increments, camera, window, strict=True):
        absolute = Rotation.from_rotvec(made) * absolute
        assert np.allclose(R_obj_cam.apply(read["delta_cam"]), made, atol=1e-12)
        assert np.allclose(R_obj_cam.apply(read["absolute_cam"]), absolute.as_rotvec(), atol=1e-9)
        assert np.allclose(read["delta_lab"], [-made[2], made[0], -made[1]], atol=1e-12)
        assert np.array_equal(read["delta_lab"], other["delta_lab"])
        sight = -pose.position / np.linalg.norm(pose.position)  # from the camera to the ball, obj
        assert other["delta_cam"][2] == pytest.approx(made @ sight, abs=1e-10)
        assert np.linalg.norm(other["delta_cam"]) == pytest.approx(np.linalg.norm(made))


def test_the_window_of_a_ball_in_the_middle_is_the_camera():
    pose = Pose(Rotation.from_rotvec([np.pi, 0, 0]).as_matrix(), np.array([0.0, 0.0, 3.0]))
    for read in (walk([[0.1, 0.2, 0.3]], pose, frame=name)[0] for name in ("camera", "window")):
        assert np.allclose(read["delta_cam"], [0.1, -0.2, -0.3], atol=1e-12)


def test_a_hand_held_ball_is_in_the_cameras_axes():
    made = estimate(0, (0.1, 0.2, 0.3))._replace(position=np.array([0.0, 0.0, 1.0]))
    (line,) = lines_of(FicTrac(), made, coordinates="cam")
    assert np.allclose(parse(line)["delta_cam"], [0.1, 0.2, 0.3])
    assert np.allclose(parse(line)["delta_lab"], [0.3, 0.1, 0.2])


def test_frames_without_motion_have_no_line_and_a_ball_found_again_begins_a_sequence():
    form = FicTrac()
    step = 0.1 * FORWARD
    assert lines_of(form, estimate(0, status=Status.SEARCHING)) == []
    (first,) = lines_of(form, estimate(1))
    assert lines_of(form, estimate(2, confirmed=False)) == []
    (second,) = lines_of(form, estimate(3, step))
    assert lines_of(form, estimate(4, status=Status.LOST, confirmed=False)) == []
    (third,) = lines_of(form, estimate(5))
    read = [parse(line) for line in (first, second, third)]
    assert [r["frame"] for r in read] == [2, 4, 6]
    assert [r["sequence"] for r in read] == [1, 3, 1]
    assert np.allclose([r["position"] for r in read], [[0, 0], [0.1, 0], [0, 0]])
    assert np.allclose([r["integrated"] for r in read], [[0, 0], [0.1, 0], [0.1, 0]])
    assert [r["delta_timestamp"] for r in read] == pytest.approx([0, 200, 0])


def test_the_times_are_those_of_the_exposure(monkeypatch):
    (recorded,) = lines_of(FicTrac(), estimate(3))
    assert parse(recorded)["timestamp"] == pytest.approx(300)
    noon = 1_700_000_000 - 1_700_000_000 % 86_400 + 43_200.25  # UTC
    monkeypatch.setenv("TZ", "UTC")
    import time

    time.tzset()
    (live,) = lines_of(FicTrac(), estimate(3), wall=noon)
    assert parse(live)["timestamp"] == pytest.approx(1e3 * noon, abs=0.01)
    assert parse(live)["alt_timestamp"] == pytest.approx(43_200_250, abs=0.01)


def test_only_the_ball_that_points_has_lines():
    samples = tuple(Sample(estimate(0, k * FORWARD), k + 1, coordinates="cam") for k in (1, 2))
    (line,) = FicTrac().lines(Report((0, 0, 0), None, 0.0, samples, pointing=1))
    assert parse(line)["speed"] == pytest.approx(2.0)
    assert FicTrac().lines(Report((1, 2, 3), None, 0.0)) == []


def test_options_belong_to_the_format():
    assert refused("text:x,format=fictrac,frame=windw").endswith("unknown frame 'windw'; did you mean window?")
    assert refused("text:x,frame=window").endswith("frame is an option of format=fictrac")


def test_the_clips_lines_are_its_true_rotation_before_its_camera():
    """The recording has the true attitudes and the true pose of the camera; they were rendered by other code."""
    recording = open_dataset(CLIP)
    truth = Rotation.from_matrix(recording.truth.attitude)
    adapter, form, lines = BallAdapter((recording.rig,), Configuration(), None, lambda _: None), FicTrac(), []
    for frame in adapter.begin(read_frames(recording)):
        made = adapter.follow(frame)
        assert made is not None
        lines.extend(form.lines(Report((0, 0, 0), None, frame.stamp, made.samples)))
    read = [parse(line) for line in lines]
    assert len(read) >= 45
    R_cam_obj = recording.pose.rotation.T
    for before, now in pairwise(read):
        k, j = int(now["frame"]) - 1, int(before["frame"]) - 1
        true = R_cam_obj @ (truth[k] * truth[j].inv()).as_rotvec()
        assert np.degrees(np.linalg.norm(now["delta_cam"] - true)) < 0.06
    last = (truth[int(read[-1]["frame"]) - 1] * truth[int(read[0]["frame"]) - 1].inv()).as_rotvec()
    assert np.degrees(np.linalg.norm(read[-1]["absolute_cam"] - R_cam_obj @ last)) < 0.1
