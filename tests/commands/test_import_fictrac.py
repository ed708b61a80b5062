"""`spheremouse import-fictrac`: a configuration of FicTrac becomes a folder whose rates are in FicTrac's axes."""

import numpy as np
import pytest
from conftest import shared
from invoking import fail, invoke, succeed
from scipy.spatial.transform import Rotation

from spheremouse.ball.detect.appearance import ball_outline
from spheremouse.calibrate.outline.fit import pinhole
from spheremouse.commands import app
from spheremouse.commands.ball import film
from spheremouse.files import config as settings
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.rig import load_rig
from spheremouse.geometry.camera import project
from spheremouse.session.settings import Configuration

VFOV = 2.0 * np.degrees(np.arctan(0.5 * 480 / 640))  # of the simulated camera
R_LAB_CAM = Rotation.from_rotvec([0.9, -1.1, 0.4]).as_matrix()
SQUARE = np.array([(1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0)], float)  # c2a_cnrs_xy, as configGui asks for it


def listed(values, form="g"):
    return "{ " + ", ".join(format(v, form) for v in np.ravel(values)) + " }"


def corners(R_lab_cam):
    """Corners in pixels of a square that lies along the animal's X and Y, in front of the camera."""
    return project(SQUARE @ R_lab_cam + (0.1, -0.2, 6.0), pinhole((320, 240), VFOV))[0]


@pytest.fixture(scope="module", autouse=True)
def _film_read_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spheremouse.commands.ball.film", shared(film, lambda *words: words))
        yield


@pytest.fixture
def lines(recording):
    """Lines of a configuration with every kind of value, by their keys."""
    scene = open_dataset(recording)
    struts = "{ { 110, 53, 320, 53, 320, 72, 110, 72 }, { 110, 168, 320, 168, 320, 188, 110, 188 } }"
    return {
        "c2a_cnrs_xy": listed(corners(R_LAB_CAM), ".0f"),
        "c2a_r": listed(Rotation.from_matrix(R_LAB_CAM).as_rotvec(), ".6f"),
        "c2a_src": "c2a_cnrs_xy",
        "c2a_t": "{ -0.674, 0.389, 2.889 }",
        "do_display": "y",
        "max_bad_frames": "-1",
        "opt_max_err": "-1.000000",
        "q_factor": "6",
        "roi_circ": listed(ball_outline(scene.rig, scene.pose, 6), ".0f"),
        "roi_ignr": struts,
        "sock_port": "1111",
        "src_fn": recording / "video.mkv",
        "vfov": f"{VFOV:.4f}",
    }


@pytest.fixture
def imported(lines, tmp_path):
    """Import a configuration with changed lines, None for none. Return code, text and folder."""

    def run(*words, **changes):
        config, out = tmp_path / "config.txt", tmp_path / "ball"
        both = {**lines, **changes}
        text = "".join(f"{key:<16} : {value}\r\n" for key, value in both.items() if value is not None)
        config.write_text(f"## FicTrac v2.1.2 config file\n\n{text}")
        return *invoke(app, "import-fictrac", config, "--out", out, *words), out

    return run


def read_columns(path):
    return np.array([[float(word) for word in line.split(", ")[1:]] for line in path.read_text().splitlines()])


def test_rates_are_those_of_the_truth_in_fictracs_axes(imported, recording, tmp_path):
    code, text, out = imported()
    assert code == 0, text
    data = tmp_path / "ball.dat"
    text = succeed(app, "run", "--config", out / "config.yaml", "--output", f"text:{data},format=fictrac")
    columns, scene = read_columns(data), open_dataset(recording)
    frame = columns[:, 0].astype(int) - 1
    following = np.flatnonzero(np.diff(frame) == 1) + 1
    assert len(following) > 50
    attitude = Rotation.from_matrix(scene.truth.attitude)
    k = frame[following]
    true = (attitude[k] * attitude[k - 1].inv()).as_rotvec()
    in_cam = true @ scene.pose.rotation
    for measured, expected in ((columns[following, 1:4], in_cam), (columns[following, 5:8], in_cam @ R_LAB_CAM.T)):
        error = np.sqrt(np.mean((measured - expected) ** 2, axis=0))
        assert np.all(error < 0.1 * np.sqrt(np.mean(expected**2, axis=0)) + 1e-3)


def test_each_key_is_listed_and_masks_and_socket_are_settings(imported, lines):
    code, text, out = imported()
    assert code == 0, text
    for number, key in enumerate(lines, 3):
        assert f"config.txt:{number}: {key}: " in text
    assert ": c2a_r: used\n" in text
    assert ": q_factor: not needed: " in text
    assert "by the edge of the ball in the film" in text
    found = settings.load(out / "config.yaml", Configuration)
    assert found.outputs == ("udp:127.0.0.1:1111,format=fictrac",)
    assert found.discs.masks[0] == (110.0, 53.0, 320.0, 53.0, 320.0, 72.0, 110.0, 72.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"c2a_r": None},  # from the corners
        {"c2a_r": listed(Rotation.from_matrix(R_LAB_CAM.T).as_rotvec(), ".6f")},  # of an older version
        {"c2a_src": None, "c2a_cnrs_xy": "{ 10, 10, 20, 20 }"},  # from c2a_r alone
    ],
)
def test_the_axes_come_from_the_rotation_or_from_its_square(imported, changes):
    code, text, out = imported(**changes)
    assert code == 0, text
    R_lab_obj = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    R = R_lab_obj @ load_rig(out / "rig.yaml").pose.rotation
    assert np.degrees(Rotation.from_matrix(R @ R_LAB_CAM.T).magnitude()) < 2.0
    assert ("inverted" in text) == (changes.get("c2a_r") is not None)


def test_centre_and_radius_count_before_the_points_and_the_edge_before_both(imported, recording):
    scene = open_dataset(recording)
    centre = scene.pose.to_cam(np.zeros(3))
    u, angle = centre / np.linalg.norm(centre), np.arcsin(scene.rig.ball.radius / np.linalg.norm(centre))
    words = {"roi_c": listed(u + np.array([0.004, 0.0, 0.0]), ".6f"), "roi_r": f"{angle * 0.98:.6f}", "roi_circ": "{ }"}
    code, text, out = imported(**words)
    assert code == 0, text
    assert ": roi_circ: not needed: roi_c and roi_r count" in text
    found = load_rig(out / "rig.yaml").pose
    assert np.linalg.norm(found.position) == pytest.approx(1.0 / np.sin(angle), rel=0.005)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"roi_cicr": "{ 1, 2 }"}, ":16: roi_cicr: unknown key; did you mean roi_circ"),
        ({"vfov": "wide"}, ":15: vfov: must be a number, is 'wide'; correct the line"),
        ({"vfov": "200"}, ":15: vfov: is 200°; give 0.1 to 150 degrees"),
        ({"vfov": None}, ": vfov: missing; give the vertical field of view"),
        ({"do_display": "maybe"}, ":7: do_display: must be y or n, is 'maybe'"),
        ({"c2a_r": "{ 1, 2 }"}, ":4: c2a_r: must be 3 numbers, has 2 numbers"),
        ({"c2a_r": "1, 2, 3"}, ":4: c2a_r: must be a list { a, b, ... }"),
        ({"c2a_r": None, "c2a_src": None}, ": c2a_r: missing, and no square of c2a_src gives it; run configGui"),
        ({"c2a_r": None, "c2a_cnrs_xy": "{ 5, 5, 5, 5, 5, 5, 5, 5 }"}, ": c2a_r: missing, and no square"),
        ({"roi_circ": "{ 1, 2, 3, 4 }"}, ":11: roi_circ: must be at least 3 points x, y, has 4 numbers"),
        ({"roi_circ": "{ 1, 1, 2, 2, 3, 3 }"}, ":11: roi_circ: the points are on no outline of a ball"),
        ({"passwd": "x"}, ":16: passwd: unknown key; is this FicTrac's config.txt? Correct the key, or begin"),
        ({"roi_circ": None, "roi_r": "0.1"}, ": roi_circ: missing, and roi_c and roi_r are not both given; run"),
        ({"roi_c": "{ 0, 0, 1.2 }", "roi_r": "0.1"}, ":16: roi_c: must be a unit vector, has the length 1.2; delete"),
        ({"roi_c": "{ 0, 0, -1 }", "roi_r": "0.1"}, ":16: roi_c: is, with roi_r, no ball before the camera; delete"),
        ({"roi_c": "{ 0, 0, -1 }", "roi_r": "0.1", "roi_circ": None}, "before the camera; run configGui, or use"),
        ({"roi_ignr": "{ { 1, 2, 3, 4 } }"}, ":12: roi_ignr: a polygon has 4 numbers; give x, y of three or more"),
        ({"roi_ignr": "{ 1, 2, 3, 4 }"}, ":12: roi_ignr: must be lists { { a, b, ... } }"),
        ({"fisheye": "y"}, ":16: fisheye: this camera model is not known here; calibrate the camera"),
        ({"src_fn": "nowhere.mp4"}, ":14: src_fn: nowhere.mp4: no such file; name the film or the camera by --source"),
    ],
)
def test_a_wrong_line_is_one_message_with_its_number_and_a_remedy(imported, changes, message):
    code, text, out = imported(**changes)
    assert code == 2
    assert message in text
    assert len(text.splitlines()) == 1
    assert not out.exists()


def test_no_configuration_is_one_line(tmp_path):
    for path, content in ((tmp_path / "none.txt", None), (tmp_path / "a.txt", b"\xff\xfe\x00"), (tmp_path, None)):
        if content is not None:
            path.write_bytes(content)
        fail(app, "import-fictrac", path, "--out", tmp_path / "ball")
    (tmp_path / "b.txt").write_text("vfov 45\n")
    assert "b.txt:1: is no `key : value`" in invoke(app, "import-fictrac", tmp_path / "b.txt")[1]
