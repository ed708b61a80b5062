"""The wand's six axes: angles against SciPy, standard deviations against samples, lines as they are read back."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reporting import report
from scipy.spatial.transform import Rotation

from spheremouse.errors import OutputError
from spheremouse.output.axes import HEADER, NAMES, AxesText
from spheremouse.output.axes import open as open_axes
from spheremouse.tracker import Status, unknown
from spheremouse.wand.axes import UPRIGHT, attitude, axes_of, wrapped
from spheremouse.wand.estimate import estimate
from spheremouse.wand.state import Track, WandPose

ANGLE = st.floats(-3.1, 3.1)
TILT = st.floats(-1.5, 1.5)
NONE = np.zeros((6, 6))
P = np.array([0.1, -0.2, 1.5])


def test_upright_is_all_zero():
    """Pole up, azimuth 0 towards the camera, azimuth 90 to the right in the picture."""
    assert UPRIGHT @ np.eye(3) == pytest.approx(np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0]], dtype=float))
    assert axes_of(P, UPRIGHT, NONE).angles == pytest.approx(np.zeros(3))


@pytest.mark.parametrize(
    ("angles", "point", "goes"),
    [
        ((90, 0, 0), (1, 0, 0), (-1, 0, 0)),  # clockwise from above: what faced the camera goes left in the picture
        ((0, 90, 0), (0, 0, 1), (0, 0, -1)),  # the pole points at the camera
        ((0, 0, 80), (0, 0, 1), (np.sin(np.radians(80)), -np.cos(np.radians(80)), 0)),  # the pole leans to the right
    ],
)
def test_what_each_angle_means(angles, point, goes):
    assert attitude(np.radians(angles)) @ point == pytest.approx(goes, abs=1e-12)


@given(ANGLE, ANGLE, TILT)
def test_angles_are_those_of_scipy(yaw, pitch, roll):
    R = (Rotation.from_euler("XZY", [pitch, roll, yaw]) * Rotation.from_matrix(UPRIGHT)).as_matrix()
    assert attitude(np.array([yaw, pitch, roll])) == pytest.approx(R, abs=1e-12)
    assert wrapped(axes_of(P, R, NONE).angles - (yaw, pitch, roll)) == pytest.approx(np.zeros(3), abs=1e-9)


def test_standard_deviations_are_the_scatter_of_samples():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(6, 6)) * ([0.001] * 3 + [0.004] * 3)
    C = A.T @ A
    R = attitude(np.radians([40, 25, -50]))
    d = rng.multivariate_normal(np.zeros(6), C, 20000)
    sampled = [axes_of(P + x[:3], Rotation.from_rotvec(x[3:]).as_matrix() @ R, NONE) for x in d]
    axes = axes_of(P, R, C)
    assert np.std([s.position for s in sampled], axis=0) == pytest.approx(axes.position_sigma, rel=0.03)
    assert np.std([s.angles for s in sampled], axis=0) == pytest.approx(axes.angles_sigma, rel=0.03)


def test_where_the_angles_are_singular_they_are_unknown():
    axes = axes_of(P, attitude(np.array([0.0, 0.0, 0.5 * np.pi])), np.eye(6) * 1e-6)
    assert axes.angles_sigma == pytest.approx(np.full(3, np.pi))
    assert axes_of(P, attitude(np.radians([0, 0, 89.9])), np.eye(6) * 1e-4).angles_sigma.max() <= np.pi


# ---- text ----

FOUND = WandPose("a", P, attitude(np.radians([30, 20, 10])), np.eye(6) * 1e-4, Status.TRACKING, None, seen=True)
GONE = WandPose("b", None, None, None, Status.LOST, None)
HIDDEN = WandPose("a", P, UPRIGHT, np.eye(6) * 1e-4, Status.TRACKING, None)


def written(*frames, points=0):
    """Return the lines of frames, (stamp, poses, counts), with the ball `points` as the pointing one."""
    file = io.StringIO()
    sink = AxesText(file, "here")
    for stamp, poses, counts in frames:
        balls = tuple(estimate(None, Track(), pose, stamp, 0) for pose in poses)
        sink.send(report(*counts)._replace(estimate=balls[points] if balls else unknown(stamp), balls=balls))
    return file.getvalue().splitlines()


def test_a_line_per_ball_and_frame_with_as_many_columns_as_the_header_names():
    lines = written((0.1, (FOUND, GONE), (1, -2, 3)), (0.2, (HIDDEN, GONE), (0, 0, 0)), points=1)
    assert lines[:2] == HEADER.splitlines()
    rows = [dict(zip(NAMES.split()[1:], line.split(), strict=True)) for line in lines[2:]]
    assert [(r["t"], r["ball"], r["state"]) for r in rows] == [
        ("0.1", "1", "tracking"),
        ("0.1", "2", "lost"),
        ("0.2", "1", "hidden"),
        ("0.2", "2", "lost"),
    ]
    assert [rows[0][n] for n in ("x", "y", "z", "yaw", "pitch", "roll")] == [
        "0.100000", "-0.200000", "1.500000", "30.0000", "20.0000", "10.0000",
    ]  # fmt: skip
    assert float(rows[0]["sx"]) == pytest.approx(0.01)
    assert float(rows[0]["spitch"]) > np.degrees(0.0099)
    assert all(np.isnan(float(rows[1][n])) for n in NAMES.split()[2:14])
    assert [[int(r[n]) for n in ("dx", "dy", "dz")] for r in rows[:2]] == [[0, 0, 0], [1, -2, 3]]


def test_numpy_reads_the_columns_by_their_names():
    lines = written((0.1, (FOUND, GONE), (1, -2, 3)), (0.2, (HIDDEN, GONE), (0, 0, 0)))
    text = "\n".join(lines)
    table = np.genfromtxt(io.StringIO(text), names=True, dtype=None, encoding="utf-8")
    assert list(table.dtype.names) == NAMES.split()[1:]
    assert table["state"].tolist() == ["tracking", "lost", "hidden", "lost"]
    assert table["ball"].tolist() == [1, 2, 1, 2]
    assert table["z"] == pytest.approx([1.5, np.nan, 1.5, np.nan], nan_ok=True)
    assert np.genfromtxt(io.StringIO(text), names=True)["x"] == pytest.approx(table["x"], nan_ok=True)
    assert np.loadtxt(io.StringIO(text), usecols=range(17)).shape == (4, 17)


def test_files_of_another_kind_are_kept(tmp_path):
    path = tmp_path / "axes.txt"
    path.write_text("# stamp dx dy dz rx ry rz wx wy wz\n0 1 2 3 0 0 0 0 0 0\n")
    with pytest.raises(OutputError, match="exists and is no log of motions"):
        open_axes(str(path))
    path.unlink()
    for times in (1, 2):  # one of its own is appended to
        with open_axes(str(path)):
            pass
        assert path.read_text() == times * (HEADER + "\n")
