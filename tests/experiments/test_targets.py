"""Targets: where they are put, poses from rings and tags on a tiny case, pages of given, missing and failed results."""

import json

import numpy as np
import pytest
from experiments import targets
from experiments.kit.job import Request
from experiments.report.page import said
from experiments.report.plot import save
from experiments.report.targets import page
from experiments.targets import KINDS, NUMBERS, REFINEMENTS, jobs, key, places, rig_of

from spheremouse.ball.detect.rings import TargetDetections
from spheremouse.ball.pose import predict_targets
from spheremouse.simulate.ball.scene import default_scene

QUICK, WHOLE = Request(True, None), Request(False, None)


@pytest.fixture(scope="module")
def camera():
    """Four targets of the usual size and of one that is too small, from one camera."""
    return json.loads(json.dumps(targets.filmed(1, [4], [6, 36], ["plain"])))


def test_four_targets_are_the_thesis_own_and_none_lie_on_one_another():
    scene = default_scene(1)
    assert places(4) == pytest.approx(scene.targets.position)
    for n in NUMBERS:
        where = places(n)
        assert where.shape == (n, 3)
        apart = np.linalg.norm(where[:, None] - where[None], axis=2) + 10.0 * np.eye(n)
        assert apart.min() > 2.0 * 1.22 * 0.048 * np.sqrt(2.0)  # the largest sheets, corner to corner


def test_a_tags_centre_is_where_its_diagonals_meet_in_any_view():
    scene = targets.camera_of(4)
    corners, middles = rig_of("aruco", scene, 4, 36), rig_of("aruco centres", scene, 4, 36)
    seen = TargetDetections(corners.targets.codes, predict_targets(scene.pose, corners), np.full(16, 12.0), ())
    # OpenCV's order goes round; the rig's does too, the other way
    found = targets._middles(seen)
    assert found.codes == ("0", "1", "2", "3")
    assert found.centre == pytest.approx(predict_targets(scene.pose, middles), abs=1e-6)


def test_rings_and_tags_give_the_pose_and_what_is_too_small_none(camera):
    for kind in KINDS:
        usual = camera["sizes"][key(kind, 4, 36, "plain")]
        assert usual["found"] == 1.0
        assert np.linalg.norm(usual["position_mm"]) < 30.0
        assert np.all(np.array(usual["sigma_position_mm"]) > 0.1)
        small = camera["sizes"][key(kind, 4, 6, "plain")]
        assert small["found"] < 1.0
    rings, tags = (camera["sizes"][key(k, 4, 36, "plain")]["point_px"] for k in ("rings", "aruco"))
    assert rings < 0.05
    assert rings < tags < 1.0
    assert camera["sizes"][key("rings", 4, 6, "plain")]["error"]
    assert camera["px_per_mm"] == pytest.approx(2e-3 * 640.0 / 1.79, rel=0.06)


def test_refinements_are_compared_on_the_same_corners(camera):
    assert set(camera["refinements"]) == set(REFINEMENTS)
    rms = {k: np.sqrt(np.mean(np.square(v["errors"]))) for k, v in camera["refinements"].items() if v["errors"]}
    assert rms["subpix, 2 px"] < rms["none"]


def posed(error, sigma, **more):
    vector = [error, 0.0, 0.0]
    claim = [0.0, 0.6 * sigma, 0.8 * sigma]
    return {"found": 1.0, "point_px": 0.05, "position_mm": vector, "angle_deg": vector,
            "sigma_position_mm": claim, "sigma_angle_deg": claim, **more}  # fmt: skip


NONE = {"found": 0.0, "point_px": None, "error": "none"}


def given():
    """A camera's results that bear out all that is claimed."""
    numbers = {key(k, n, 36, "plain"): posed(8.0 / n, 9.0 if n == 3 else 3.0) for k in KINDS for n in (3, 4, 6, 8)}
    sizes = {}
    for kind in KINDS:
        for size in (14, 24, 36, 48):
            for condition in ("plain", "dark", "blurred"):
                least = {"plain": 24, "dark": 99, "blurred": 36} if kind == "rings" else {"blurred": 48}
                seen = posed((1.0 if kind == "rings" else 3.0) * 72.0 / size, 3.0)
                sizes[key(kind, 4, size, condition)] = seen if size >= least.get(condition, 14) else NONE
    exact = {"AprilTag": 0.1, "subpix, 2 px": 0.2}
    refinements = {k: {"found": 1.0, "errors": [[exact.get(k, 0.3), 0.0], [0.3, 0.4]]} for k in REFINEMENTS}
    return {"numbers": numbers, "sizes": sizes, "refinements": refinements, "px_per_mm": 0.5}


def text(*cameras):
    return said("targets", page, {f"camera-{k}": camera for k, camera in enumerate(cameras)}).text


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(f"**{title}")[2].partition("\n\n")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_poses_are_those_of_cameras_that_had_one_and_the_bound_has_centres_as_good_as_they_were():
    other, none = given(), given()
    other["numbers"][key("rings", 4, 36, "plain")] = posed(1.0, 4.0, point_px=0.01)  # 0.05 px are allowed for
    none["numbers"][key("rings", 4, 36, "plain")] = {**NONE, "found": 0.5}
    table = rows(text(given(), other, none), "Poses by")
    point, error, claim, bound = (np.hypot(*x) / np.sqrt(2.0) for x in ((0.05, 0.01), (2, 1), (3, 4), (3, 0.8)))
    lengths = [f"{point:.3f}", *(f"{x:.2f}" for x in (error, claim, bound)), f"{error:.3f}", f"{claim:.3f}"]
    assert table[4] == ["4", "rings", "83", "2 of 3", *lengths]
    assert [row[0] for row in table[::4]] == ["3", "4", "6", "8"]
    assert [row[1] for row in table[:4]] == list(KINDS.values())


def test_sizes_must_be_found_from_the_advised_one_on():
    camera = given()
    camera["sizes"][key("aruco", 4, 24, "plain")]["found"] = 0.5  # a gap: what is smaller does not count
    camera["refinements"]["none"] = {"found": 0.0, "errors": []}
    found = text(camera)
    least = rows(found, "Least size")
    assert least[0] == ["noise of 3 grey values", "12 px (24 mm)", "18 px (36 mm)", "7 px (14 mm)"]
    assert least[1] == ["noise of 15", "–", "–", "–"]
    assert least[2][1:] == ["–", "7 px (14 mm)", "7 px (14 mm)"]
    assert "rings at least 18 px across" in found  # blurred
    assert "(18 px across) the position error is 2.00 mm; that of ArUco 4×4 is 3.0 times" in found
    assert rows(found, "Poses from")[4][1:] == ["rings", "0", "0 of 1", *["–"] * 6]
    assert rows(found, "Corners of")[0] == ["none", "0", "–", "–", "–"]
    assert rows(found, "Corners of")[2] == ["subpix", "100", "0.292", "0.300", "0.200"]


@pytest.mark.parametrize(
    ("group", "name", "entry"),
    [
        ("numbers", key("april", 8, 36, "plain"), posed(5.0, 3.0)),
        ("numbers", key("rings", 4, 36, "plain"), posed(2.0, 4.0)),
        ("sizes", key("aruco centres", 4, 36, "plain"), posed(1.9, 3.0)),
        ("sizes", key("april", 4, 24, "plain"), NONE),
        ("sizes", key("rings", 4, 36, "blurred"), NONE),
        ("sizes", key("rings", 4, 48, "dark"), posed(1.0, 3.0)),
        ("refinements", "AprilTag", {"found": 1.0, "errors": [[0.3, 0.3]]}),
    ],
)
def test_a_claim_that_is_contradicted_is_marked(group, name, entry):
    camera = given()
    assert said("targets", page, {"camera-0": camera}).doubts == 0
    camera[group][name] = entry
    assert said("targets", page, {"camera-0": camera}).doubts == 1


def test_a_page_of_few_sizes_and_a_camera_that_failed_draws(tmp_path):
    few = given()
    few["numbers"] = {k: v for k, v in few["numbers"].items() if "/4/" in k}
    few["sizes"] = {k: v for k, v in few["sizes"].items() if k.endswith(("/36/plain", "/14/plain"))}
    found = said("targets", page, {"camera-0": few, "camera-1": {"error": "no memory"}})
    assert "- camera-1: no memory" in found.text
    assert [drawing.name for drawing in found.drawings] == ["targets-number", "targets-size"]
    for drawing in found.drawings:
        assert save(drawing, tmp_path).stat().st_size > 5000


def test_jobs_are_cameras():
    assert len(jobs(QUICK)) == 1
    keys = [job.key for job in jobs(WHOLE)]
    assert len(set(keys)) == len(keys) > 4
