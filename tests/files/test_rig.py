"""Rig and camera files: what is saved reads back the same, and what a person may get wrong is said with its line."""
# pyright: reportArgumentType=false, reportCallIssue=false

import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from spheremouse.ball.rig import CODES, UNKNOWN_READOUT, Ball, Rig, Targets, found_from_picture
from spheremouse.errors import ConfigurationError
from spheremouse.files.rig import load_camera, load_rig, rig_text, save_camera, save_rig
from spheremouse.files.yaml import read_document
from spheremouse.geometry.camera import InteriorOrientation, Pose

TEXT = """\
schema: 1
camera: {width: 640, height: 480, fx: 900, fy: 901.5, cx: 320, cy: 239, dist: [-0.1, 0.02, 0, 1e-4, 0]}
ball:
  radius: 0.6
  covariance:
    - [4e-6, 0, 0, 0]
    - [0, 4e-6, 0, 1e-6]
    - [0, 0, 4e-6, 0]
    - [0, 1e-6, 0, 1e-6]
disc_radius: 0.02
readout_s: 0.01
target_radii: [0.02, 0.04, 0.06]
targets:
  - {id: 1, code: CMY, position: [-0.7, 0.7, 0.1]}
  - {id: 2, code: MYC, position: [0.7, 0.7, 0.1], covariance: [[1e-6, 0, 0], [0, 1e-6, 0], [0, 0, 1e-6]]}
  - {id: 5, code: YCM, position: [0.7, -0.7, 0.1]}
T_obj_cam:
  - [1, 0, 0, 0]
  - [0, -1, 0, 0]
  - [0, 0, -1, 2.4]
  - [0, 0, 0, 1]
discs: [[0, 0, 1], [0, 0.8, 0.6]]
"""


def random_covariance(rng, n):
    """Symmetric to the last bit, of full rank, with very different scales."""
    A = rng.normal(size=(n, n)) * np.logspace(-6, 0, n)[:, None]
    return A @ A.T / 2 + (A @ A.T).T / 2


def random_rig(seed, targets, known_pose, discs, correlated=True):
    """A rig with something in every field; all that is uncertain but the camera is correlated, or each by itself."""
    rng = np.random.default_rng(seed)
    place = Rotation.random(rng=rng).as_matrix(), np.array([0.1, 0.2, 2.5]) + rng.normal(size=3) / 9
    directions = rng.normal(size=(discs, 3))
    n = 3 * targets
    whole = random_covariance(rng, 10 + n)  # pose, ball, targets
    if not correlated:
        whole = np.asarray(block_diag(whole[:6, :6], whole[6:10, 6:10], *(random_covariance(rng, 3),) * targets))
    centre, pose = rng.normal(size=3) / 100, Pose(*place, whole[:6, :6], whole[:6, 6:10], rng.normal(size=6))
    pose = pose if rng.random() < 0.5 else found_from_picture(pose, centre)
    interior = rng.uniform(100, 900, 4).tolist(), rng.normal(size=5) / 9, random_covariance(rng, 9)
    return Rig(
        camera=InteriorOrientation(640, 480, *interior[0], *interior[1:]),
        ball=Ball(rng.uniform(0.5, 0.7), centre, whole[6:10, 6:10]),
        targets=Targets(
            ids=tuple(range(3, 3 + targets)), codes=CODES[:targets], position=rng.normal(size=(targets, 3)),
            covariance=whole[10:, 10:], radii=np.sort(rng.uniform(0.01, 0.1, 3)),
            normal=Rotation.random(rng=rng).as_matrix()[2] if rng.random() < 0.5 else np.array([0.0, 0.0, 1.0])
        ),
        disc_radius=rng.uniform(0.01, 0.03) if discs or rng.random() < 0.5 else None, **shutter(rng),
        pose=pose if known_pose else None,
        disc_directions=directions / np.linalg.norm(directions, axis=1, keepdims=True) if discs else None,
        cross_covariance=whole[10:, 6:10] if correlated and targets else None, scale_free=bool(rng.random() < 0.5)
    )  # fmt: skip


def shutter(rng):
    """A rolling one whose readout is known, or a camera of which nobody knows."""
    if rng.random() < 0.5:
        return {"readout_sigma_s": UNKNOWN_READOUT, "exposure_s": 0.0}
    return {"readout_s": rng.uniform(0, 0.03), "exposure_s": rng.uniform(0, 0.03)}


def same(a, b):
    """Whether two things of the core are equal, arrays to the last digits (a rotation is made orthonormal anew)."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.shape == b.shape and np.allclose(a, b, rtol=0, atol=1e-14)
    if hasattr(a, "__slots__"):
        return type(a) is type(b) and all(same(getattr(a, s), getattr(b, s)) for s in a.__slots__)
    return type(a) is type(b) and a == b


PROVENANCE = {
    "date": "2026-01-31",
    "version": "1.0",
    "photos": [{"file": "a: b.jpg", "sha256": "0" * 64}, {"file": "ä #2.jpg", "sha256": "12e4"}],
    "notes": "two lines\n'quoted', and: \"so\"",
}


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.booleans(), st.integers(0, 5), st.booleans())
def test_a_rig_reads_back_as_it_was_saved(tmp_path_factory, seed, targets, known_pose, discs, correlated):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    rig = random_rig(seed, targets, known_pose, discs, correlated)
    save_rig(path, rig)
    assert same(load_rig(path), rig)
    assert os.listdir(path.parent) == ["rig.yaml"]


def test_numpy_scalars_and_integers_are_saved_as_plain_numbers():
    rig = random_rig(1, 1, False, 0)
    text = rig_text(Rig(rig.camera, Ball(np.float64(1)), rig.targets, np.float64(0.02)))  # type: ignore[arg-type]
    assert "radius: 1.0\n" in text
    assert "np." not in text


def test_a_rig_written_by_hand(tmp_path):
    (tmp_path / "rig.yaml").write_text(TEXT)
    rig = load_rig(tmp_path / "rig.yaml")
    assert rig.camera.fx == 900.0
    assert rig.targets.ids == (1, 2, 5)
    np.testing.assert_array_equal(rig.targets.covariance, np.diag([0, 0, 0, 1e-6, 1e-6, 1e-6, 0, 0, 0]))
    assert rig.cross_covariance is None
    assert not rig.scale_free
    np.testing.assert_array_equal(rig.ball.centre, [0, 0, 0])
    assert rig.pose is not None
    np.testing.assert_allclose(rig.pose.to_cam(np.zeros((1, 3))), [[0, 0, 2.4]], atol=1e-15)
    np.testing.assert_allclose(rig.disc_directions, [[0, 0, 1], [0, 0.8, 0.6]])


@pytest.mark.parametrize(
    ("line", "readout", "sigma", "saved"),
    [
        ("readout_s: 0.01\n", 0.01, 0.0, "readout_s: 0.01 "),
        ("readout_s: 0\n", 0.0, 0.0, "readout_s: 0.0 "),  # somebody knows that it is a global one
        ("readout_s: null\n", 0.0, UNKNOWN_READOUT, "readout_s: null "),
        ("readout_s:\n", 0.0, UNKNOWN_READOUT, "readout_s: null "),
        ("", 0.0, UNKNOWN_READOUT, "readout_s: null "),
    ],
)
def test_a_readout_that_nobody_knows_stays_unknown(tmp_path, line, readout, sigma, saved):
    path = tmp_path / "rig.yaml"
    path.write_text(TEXT.replace("readout_s: 0.01\n", line))
    rig = load_rig(path)
    assert (rig.readout_s, rig.readout_sigma_s, rig.exposure_s) == (readout, sigma, 0.0)
    save_rig(path, rig)
    assert saved in path.read_text()
    assert same(load_rig(path), rig)


def test_a_matrix_copied_with_four_digits_is_made_a_rotation(tmp_path):
    R = Rotation.from_euler("XYZ", [170, 20, 30], degrees=True).as_matrix()
    rows = [[*map(float, np.round(R[i], 4)), t] for i, t in enumerate((0.0, 0.0, 2.4))]
    head, _, rest = TEXT.partition("T_obj_cam:\n")
    text = head + f"T_obj_cam: {[*rows, [0, 0, 0, 1]]}\n" + rest[rest.index("discs") :]
    (tmp_path / "rig.yaml").write_text(text)
    pose = load_rig(tmp_path / "rig.yaml").pose
    assert pose is not None
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(pose.rotation, R, atol=1e-4)


def test_cameras_are_saved_and_replaced(tmp_path):
    camera = InteriorOrientation(1280, 960, 1800.25, 1801.0, 640.5, 480.25, np.array([-0.1, 1e-17, 0, 0, 3]))
    save_camera(tmp_path / "camera.yaml", camera)
    assert same(load_camera(tmp_path / "camera.yaml"), camera)
    camera = replace(camera, covariance=random_covariance(np.random.default_rng(3), 9))
    save_camera(tmp_path / "camera.yaml", camera, PROVENANCE)
    assert same(load_camera(tmp_path / "camera.yaml"), camera)
    assert read_document(tmp_path / "camera.yaml").data["provenance"]["version"] == "1.0"


def test_provenance_is_kept_in_the_file_and_out_of_the_rig(tmp_path):
    path, rig = tmp_path / "rig.yaml", random_rig(4, 4, True, 3)
    twice = [PROVENANCE["photos"][0]] * 2  # one object, written out twice
    for provenance in (PROVENANCE, {**PROVENANCE, "photos": twice}):
        save_rig(path, rig, provenance)
        found = read_document(path).data["provenance"]
        assert {**found, "photos": list(found["photos"])} == provenance
        assert same(load_rig(path), rig)
    assert rig_text(rig, {}) == rig_text(rig)


def test_targets_without_correlation_keep_their_covariances_by_themselves():
    alone, together = (rig_text(random_rig(5, 3, False, 0, correlated)) for correlated in (False, True))
    assert alone.count("    covariance:") == 3
    assert "targets_covariance" not in alone
    assert "    covariance:" not in together
    assert "targets_covariance" in together


BEYOND = "does not go with the covariances of its rows and of the ball: some correlation is beyond 1; copy all digits"
NO_COVARIANCE = (
    "5: ball.covariance: must be symmetric, with variances of at least 0 and correlations of at most 1; copy all digits"
)
NO_MOTION = "17: T_obj_cam: is no [R, t; 0, 0, 0, 1] with a right-handed rotation R; copy all digits"
NINE = " of 9 numbers, is 1 rows of 1"
ROWS = "\n  - [1, 0, 0, 0]\n  - [0, -1, 0, 0]\n  - [0, 0, -1, 2.4]\n  - [0, 0, 0, 1]\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fx: 900,", "fx: -900,", "2: camera.fx: must be at least 1, is -900; focal length in px"),
        ("width: 640, height: 480", "width: 16000, height: 9000",
         "2: camera: 16000x9000 is more than can be worked on: at most 16384 a side, 67108864 pixels in all"),
        ("cx: 320", "cx: 1281",
         "2: camera.cx: is 1281, far outside an image of 640 px; it is given in px, and lies near 320"),
        ("    - [4e-6, 0, 0, 0]\n", "", "5: ball.covariance: must be 4 rows of 4 numbers, is 3 rows of 4"),
        ("[0, 4e-6, 0, 1e-6]", "[0, 4e-6, 0, 1e-7]", NO_COVARIANCE),
        ("    - [4e-6, 0, 0, 0]\n", "    - [-4e-6, 0, 0, 0]\n", NO_COVARIANCE),
        ("    - [4e-6, 0, 0, 0]\n", "    - [1e9, 0, 0, 0]\n",
         "6: ball.covariance[0]: has the variance 1e+09, of a standard deviation above 60: that is not known at all"),
        ("    - [0, 4e-6, 0, 1e-6]\n    - [0, 0, 4e-6, 0]\n    - [0, 1e-6,",
         "    - [0, 4e-6, 0, 3e-6]\n    - [0, 0, 4e-6, 0]\n    - [0, 3e-6,",
         NO_COVARIANCE),
        ("disc_radius: 0.02", "disc_radius: 2",
         "10: disc_radius: is 2 m, not smaller than the ball; both are in metres"),
        ("[0.02, 0.04, 0.06]", "[0.02, 0.06, 0.04]",
         "12: target_radii: are 0.02, 0.06, 0.04; they must grow from inside to outside"),
        ("target_radii: [0.02, 0.04, 0.06]\n", "",
         "1: target_radii: missing; give [inner disc, middle ring, outer ring] in m"),
        ("code: MYC", "code: CMY", "15: targets[1].code: CMY is on another target already; each code appears once"),
        ("id: 5", "id: 1", "16: targets[2].id: 1 names another target already; give each its own"),
        ("[0.7, -0.7, 0.1]", "[0.7, 0.7, 0.1]",
         "16: targets[2].position: another target is in this very place; measure one of them again"),
        ("[1, 0, 0, 0]", "[2, 0, 0, 0]", NO_MOTION),
        ("[1, 0, 0, 0]", "[-1, 0, 0, 0]", NO_MOTION),
        ("[0, 0, 0, 1]\ndiscs", "[0, 0, 2.4, 1]\ndiscs", NO_MOTION),
        ("2.4]", "0.24]", "17: T_obj_cam: puts the camera inside the ball; is it T_cam_obj, or not in metres?"),
        ("T_obj_cam:" + ROWS, "pose_covariance: [[1]]\n",
         "17: pose_covariance: belongs to T_obj_cam, which is missing; give both or none"),
        ("T_obj_cam:" + ROWS, "pose_by_focal: [0, 0, 0, 0, 0, 0]\n",
         "17: pose_by_focal: belongs to T_obj_cam, which is missing; give both or none"),
        ("T_obj_cam:", "targets_covariance: [[0]]\nT_obj_cam:", "17: targets_covariance: must be 9 rows" + NINE),
        ("T_obj_cam:", f"targets_covariance: {np.diag([1e-6] * 9).tolist()}\nT_obj_cam:",
         "15: targets[1].covariance: stands in targets_covariance, too; remove one of them"),
        ("T_obj_cam:", f"targets_ball_covariance: {[[0] * 4] * 5 + [[0, 0, 0, 1.1e-6]] + [[0] * 4] * 3}\nT_obj_cam:",
         "17: targets_ball_covariance: " + BEYOND),
        (
            "T_obj_cam:",
            f"targets_ball_covariance: {[[0, 0, 0, 1e-9]] + [[0] * 4] * 8}\nT_obj_cam:",  # with what is exact
            "17: targets_ball_covariance: " + BEYOND,
        ),
        (
            "T_obj_cam:",
            f"pose_covariance: {np.diag([1e-6] * 6).tolist()}\n"
            f"pose_ball_covariance: {[[0, 0, 0, 1.1e-6]] + [[0] * 4] * 5}\nT_obj_cam:",
            "18: pose_ball_covariance: " + BEYOND,
        ),
        ("[0, 0.8, 0.6]", "[0, 8, 6]", "22: discs[1]: has length 10; give a unit vector"),
        ("\ntargets:", "\ntarget_normal: [2, 0, 0]\ntargets:", "13: target_normal: has length 2; give a unit vector"),
    ],
)  # fmt: skip
def test_a_wrong_rig_is_refused_with_line_and_advice(tmp_path, old, new, message):
    assert TEXT.count(old) == 1 or old in ("0.01",)
    (tmp_path / "rig.yaml").write_text(TEXT.replace(old, new, 1))
    with pytest.raises(ConfigurationError) as e:
        load_rig(tmp_path / "rig.yaml")
    lines = [line.removeprefix(f"{tmp_path / 'rig.yaml'}:") for line in str(e.value).split("\n")]
    assert message in lines


def test_a_camera_file_holds_a_camera_only(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(TEXT)
    with pytest.raises(ConfigurationError, match="ball: unknown key; known here: camera"):
        load_camera(path)
    path.write_text("schema: 1\n")
    with pytest.raises(ConfigurationError, match="1: camera: missing; width, height"):
        load_camera(path)
    path.write_text(TEXT.splitlines()[1] + "\n")
    with pytest.raises(ConfigurationError, match="schema: missing"):
        load_camera(path)
