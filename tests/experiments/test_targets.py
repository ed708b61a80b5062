"""Targets: where they are put, poses from rings and tags on a tiny case, sections of given, failed and no results."""

import json

import numpy as np
import pytest

from spheremouse.ball.detect.rings import TargetDetections
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.rig import CODES
from spheremouse.experiments import targets
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.report import targets as targets_module
from spheremouse.experiments.report.page import write_report
from spheremouse.experiments.report.targets import section
from spheremouse.experiments.targets import KINDS, NUMBERS, REFINEMENTS, jobs, key, places, rig_of
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


def posed(error, sigma, found=1.0):
    vector = [error, 0.0, 0.0]
    claim = [sigma, 0.0, 0.0]
    return {"found": found, "point_px": 0.05, "position_mm": vector, "angle_deg": vector,
            "sigma_position_mm": claim, "sigma_angle_deg": claim}  # fmt: skip


def given():
    numbers = {key(k, n, 36, "plain"): posed(8.0 / n, 10.0 / n) for k in KINDS for n in (4, 6) if k != "april"}
    numbers |= {key("aruco", 8, 36, "plain"): posed(1.0, 1.0)}
    sizes = {}
    for kind in KINDS:
        for size in (14, 24, 36):
            for condition in ("plain", "dark"):
                seen = 0.0 if kind == "rings" and (size == 14 or condition == "dark") else 1.0
                worse = 3.0 if kind == "aruco" else 1.0
                entry = posed(worse * 72.0 / size, 3.0, seen)
                sizes[key(kind, 4, size, condition)] = (
                    entry if seen else {"found": 0.0, "point_px": None, "error": "none"}
                )
    refinements = {name: {"found": 1.0, "errors": [[0.3, 0.0], [0.3, 0.4]]} for name in REFINEMENTS}
    return {"numbers": numbers, "sizes": sizes, "refinements": refinements, "px_per_mm": 0.5}


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


def test_a_section_says_what_is_found_from_which_size_on(tmp_path):
    found = section(WHOLE, {"camera-0": given(), "camera-1": {"error": "no memory"}})
    text = words(found)
    assert "All are found: rings from 12 px across, ArUco 4×4 from 7 px across" in text
    assert "ArUco 4×4 3.0 times" in text
    assert "No size tried is enough for rings under a fifth of the light" in text
    assert "Advice: rings at least 12 px across in the picture. " in text
    assert "camera-1: no memory" in text
    assert "1 camera (1 more failed) near" in text
    assert "rings: 2.50 mm with 4, 1.67 mm with 6. Advice: 6 targets" in text
    tables = [p for p in found.parts if isinstance(p, Table)]
    least = next(t for t in tables if "Least size" in t.title)
    assert least.rows[0][1] == "12 px (24 mm)"
    assert least.rows[1][1:3] == ("none of these", "7 px (14 mm)")
    page = write_report(tmp_path, {"targets": (targets.TITLE, found)}, "x")[0].read_text()
    assert f"| 8 | rings | no: there are {len(CODES)} orders of three colours |" in page
    assert "| subpix | 100 % | 0.292 | +0.300 | +0.200 |" in page
    for name in ("targets-number", "targets-size"):
        assert (tmp_path / "experiments" / f"{name}-light.svg").stat().st_size > 5000


def test_the_bound_is_the_claim_of_centres_as_good_as_they_were():
    good, bad = posed(1.0, 10.0), {**posed(1.0, 10.0), "point_px": 0.3}
    assert targets_module._bound([{**good, "point_px": 0.01}]) == pytest.approx(2.0)  # 0.05 px are allowed for
    assert targets_module._bound([bad]) == pytest.approx(10.0)  # the claim has followed the residuals
    assert targets_module._bound([{"found": 0.0, "point_px": None, "error": "none"}]) is None


def test_one_condition_is_not_all():
    one = given()
    one["sizes"] = {k: v for k, v in one["sizes"].items() if k.endswith("plain")}
    assert "all conditions" not in words(section(WHOLE, {"camera-0": one}))
    for k in [k for k in given()["sizes"] if k.startswith("rings") and k.endswith("dark")]:
        one["sizes"][k] = one["sizes"][k.replace("dark", "plain")]
    assert "px across in the picture, enough under all conditions tried" in words(section(WHOLE, {"camera-0": one}))


def test_sizes_must_be_found_from_the_advised_one_on():
    camera = given()
    camera["sizes"][key("aruco", 4, 24, "plain")]["found"] = 0.5  # a gap: what is smaller does not count
    assert targets_module._least([camera], "aruco", "plain", [14, 24, 36]) == 36
    assert targets_module._least([camera], "rings", "plain", [14, 24, 36]) == 24


def test_a_section_of_nothing_and_of_failures():
    for results in ({}, {job.key: {"error": "too little memory"} for job in jobs(QUICK)}):
        found = section(QUICK, results)
        assert not [p for p in found.parts if isinstance(p, Figure | Table)]
        assert ("too little memory" in words(found)) == bool(results)


def test_jobs_are_cameras():
    assert len(jobs(QUICK)) == 1
    keys = [job.key for job in jobs(WHOLE)]
    assert len(set(keys)) == len(keys) > 4
