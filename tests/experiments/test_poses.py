"""Poses: errors in the thesis' angles, honest draws, sections of good, failed and missing results."""

import json

import numpy as np
import pytest
from scipy.stats import chi2

from spheremouse.ball.pose import Sighting, predict_targets
from spheremouse.experiments import poses
from spheremouse.experiments.kit import thesis
from spheremouse.experiments.kit.job import Request, Table
from spheremouse.experiments.report import poses as poses_module
from spheremouse.experiments.report.page import write_report
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import from_euler, to_euler
from spheremouse.simulate.ball.scene import default_scene

QUICK, WHOLE = Request(True, None), Request(False, None)


def sightings(rig, centre):
    return [Sighting(k, c, 0.05**2 * np.eye(2), 30) for k, c in zip(rig.targets.codes, centre, strict=True)]


@pytest.fixture(scope="module")
def results():
    """One camera of each view, few draws."""
    films = {f"{view}-0": poses.filmed(view, 1, [1, 2]) for view in ("far", "near")}
    return json.loads(json.dumps({**films, "drawn-far": poses.drawn("far", 3)}))


@pytest.mark.parametrize("view", ["far", "near"])
def test_an_error_is_told_in_the_thesis_angles(view):
    scene = default_scene(1, view)
    rig, true = scene.rig(), scene.pose
    step = np.array([1e-3, -2e-3, 0.5e-3, *np.radians([0.03, -0.02, 0.04])])
    moved = Pose(from_euler(to_euler(true.rotation) + step[3:]), true.position + step[:3])
    found = poses._found(sightings(rig, predict_targets(moved, rig)), rig, true)
    assert found["error"] == pytest.approx([1.0, -2.0, 0.5, 0.03, -0.02, 0.04], abs=2e-4)


def test_sigma_is_the_scatter_of_the_error():
    scene, rng = default_scene(1, "far"), np.random.default_rng(0)
    rig = scene.rig()
    centre = predict_targets(scene.pose, rig)
    found = [
        poses._found(sightings(rig, centre + 0.05 * rng.standard_normal(centre.shape)), rig, scene.pose)
        for _ in range(150)
    ]
    error = np.array([f["error"] for f in found])
    # residuals may enlarge a covariance, hence the upper side is wide
    ratio = error.std(axis=0) / np.mean([f["sigma"] for f in found], axis=0)
    assert np.all((ratio > 0.65) & (ratio < 1.2))
    correlation = np.corrcoef(error.T)
    assert np.abs(correlation - np.array(found[0]["correlation"])).max() < 0.25


def test_the_far_camera_has_the_correlations_of_table_21():
    scene = default_scene(1, "far")
    rig = scene.rig()
    found = poses._found(sightings(rig, predict_targets(scene.pose, rig)), rig, scene.pose)
    for i, row in enumerate(thesis.THESIS_TABLES["21"]["correlation"], start=1):
        assert found["correlation"][i][:i] == pytest.approx(row, abs=0.12)


def test_draws_are_honest_with_calibrated_targets():
    entries = poses.drawn("near", 14)["entries"]
    low, high = chi2.ppf([0.001, 0.999], 6 * 14) / (6 * 14)
    assert low < np.mean([e["chi_square"] for e in entries]) / 6.0 < high


def test_the_band_is_that_of_chi_square():
    assert poses_module._band(84) == pytest.approx(chi2.ppf([0.025, 0.975], 84) / 84)


def test_cameras_of_seeds_differ_and_see_all_targets():
    scene = default_scene(1, "near")
    found = [poses._strayed(scene, np.random.default_rng(seed)) for seed in range(20)]
    for pose in found:
        centre = predict_targets(pose, scene.rig())
        assert np.all((centre > 0.0) & (centre < (640.0, 480.0)))
    assert len({tuple(p.position) for p in found}) == 20


def test_films_give_poses_from_all_counts(results):
    for view in ("far", "near"):
        film = results[f"{view}-0"]
        assert set(film["figure"]["counts"]) == {"1", "2"}
        assert set(film["table"]["counts"]) == {"30"}
        assert 0.0 < film["table"]["scatter_px"] < film["figure"]["scatter_px"] < 0.1  # 3 and 15 grey values
        exact, calibrated = (film["table"]["counts"]["30"][k] for k in ("exact", "calibrated"))
        assert np.linalg.norm(exact["error"][:3]) < 1.0  # mm
        assert np.all(np.array(exact["sigma"]) < np.array(calibrated["sigma"]))


def test_the_thesis_is_off_by_nearly_seven_of_its_sigmas():
    assert poses_module._worst("22") == pytest.approx(6.9, abs=0.02)


def test_jobs_have_keys_of_their_own_and_need_no_dataset(tmp_path):
    for request in (QUICK, WHOLE, Request(True, tmp_path)):
        work = poses.jobs(request)
        assert len({j.key for j in work}) == len(work)
        assert ("far26" in {j.key for j in work}) == (request.datasets is not None)
        assert all(json.loads(json.dumps(j.parameters)) == j.parameters for j in work)
    assert len(poses.jobs(QUICK)) < len(poses.jobs(WHOLE))


def test_a_section_says_what_was_measured(results, tmp_path):
    section = poses_module.section(QUICK, results)
    page = write_report(tmp_path, {"poses": (poses.TITLE, section)}, "x")[0].read_text()
    found = section.figures["table 21"]
    assert f"{found['sigma'][0]:.3f} (2.81) mm" in page
    assert "its rows are left out" in page
    assert "near, centres drawn, targets calibrated | 0 | failed" in page
    assert "What failed:" not in page
    for kind in ("light", "dark"):
        assert (tmp_path / "experiments" / f"poses-views-{kind}.svg").stat().st_size > 5000


def test_the_thesis_own_camera_is_not_replaced_by_another(results):
    given = {"far-0": {"error": "no target"}, "far-1": results["far-0"], "near-0": results["near-0"]}
    section = poses_module.section(QUICK, given)
    table = [p for p in section.parts if isinstance(p, Table)][1]
    assert table.rows[0] == ("where the thesis' camera stands", *["failed"] * 6)
    assert table.rows[1][0] == "error, 1 cameras, 1 failed"
    assert "sigma" not in section.figures["table 21"]
    assert "those correlations change" not in str(section.parts)


def test_numbers_that_round_to_nothing_have_no_sign(results):
    tables = [p for p in poses_module.section(QUICK, results).parts if isinstance(p, Table)]
    cells = " ".join(c.split(" (")[0] + " " for t in tables[:3] for row in t.rows for c in row[1:])
    assert "-0.000 " not in cells
    assert "-0.00 " not in cells


def test_signs_that_differ_from_the_thesis_are_said():
    ours = {"correlation": [[0.0] * 6 for _ in range(6)]}
    ours["correlation"][5] = [0.26, -0.11, 0.02, 0.1, -0.25, 1.0]
    text = poses_module._other_signs(ours)
    assert "X0 (+0.26 against -0.30; table 21: +0.45) and φ0 (-0.25 against +0.34; table 21: -0.43)" in text
    assert "Y0" not in text
    assert "the thesis' own S2" in text
    ours["correlation"][5] = [-0.26, 0.0, 0.0, 0.0, 0.25, 1.0]
    assert poses_module._other_signs(ours) == ""


def test_drawn_centres_are_said_to_give_less_than_one_where_they_do():
    key = "far, centres drawn, targets calibrated"
    assert "keeps the mean below 1" in poses_module._of_drawn({key: {"chi_square": 0.9}})
    assert "keeps the mean" not in poses_module._of_drawn({key: {"chi_square": 1.1}})
    assert poses_module._of_drawn({}) == ""


def test_a_section_without_results_has_rows_that_say_so():
    failed = {j.key: {"error": "no target was seen"} for j in poses.jobs(Request(True, None))}
    for given in ({}, failed, {**failed, "far26": {"error": "no target was seen"}}):
        section = poses_module.section(QUICK, given)
        tables = [p for p in section.parts if isinstance(p, Table)]
        assert len(tables) >= 4
        assert all("failed" in str(t.rows) for t in tables)
        assert ("no target was seen" in str(section.parts)) == bool(given)
