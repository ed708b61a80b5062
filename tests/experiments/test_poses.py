"""Poses: errors in the thesis' angles, honest draws, pages of good, failed and missing results."""

import json

import numpy as np
import pytest
from experiments import poses
from experiments.kit import thesis
from experiments.kit.job import Request
from experiments.report.page import said
from experiments.report.plot import save
from experiments.report.poses import page
from scipy.stats import chi2

from spheremouse.ball.pose import Sighting, predict_targets
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import from_euler, to_euler
from spheremouse.simulate.ball.scene import default_scene

QUICK, WHOLE = Request(True, None), Request(False, None)
ERROR_21 = thesis.THESIS_TABLES["21"]["error"]


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


def test_jobs_have_keys_of_their_own_and_need_no_dataset(tmp_path):
    for request in (QUICK, WHOLE, Request(True, tmp_path)):
        work = poses.jobs(request)
        assert len({j.key for j in work}) == len(work)
        assert ("far26" in {j.key for j in work}) == (request.datasets is not None)
        assert all(json.loads(json.dumps(j.parameters)) == j.parameters for j in work)
    assert len(poses.jobs(QUICK)) < len(poses.jobs(WHOLE))


def rows(text, title):
    """The cells of the table under the line with a title."""
    lines = text.partition(title)[2].partition("\n")[2].strip().partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def pose(error, sigma=1.0, correlation=0.5):
    """Errors as long as that in all six; standard deviations as large as that."""
    matrix = np.where(np.eye(6) > 0.0, 1.0, correlation).tolist()
    chi = 6.0 * (error / sigma) ** 2
    return {"error": [error] * 6, "sigma": [sigma] * 6, "correlation": matrix, "chi_square": chi}


def camera(error, **more):
    """With calibrated targets it is twice as far off."""
    both = {"exact": pose(error, **more), "calibrated": pose(2.0 * error, **more)}
    centres = {"common_px": 0.003, "scatter_px": 0.002}
    return {"table": {"counts": {"30": both}, **centres}, "figure": {"counts": {"1": both, "100": both}, **centres}}


def test_the_thesis_camera_gives_correlations_and_all_give_errors():
    given = {"far-0": camera(0.3, correlation=0.25), "far-1": camera(0.4, sigma=3.0), "near-0": {"error": "no target"}}
    text = said("poses", page, given).text
    table = rows(text, "**Table 21.")
    assert table[0] == ["correlation Y0", "0.250 (0.000)", *[""] * 5]
    assert table[2][1:4] == ["0.250 (0.000)", "0.250 (-0.998)", "0.250 (0.770)"]
    assert table[5][:2] == ["standard deviation", "1.000 (2.81)"]
    error, sigma = np.sqrt((0.3**2 + 0.4**2) / 2.0), np.sqrt((1.0 + 9.0) / 2.0)
    assert table[6] == ["error", *(f"{error:.{d}f} ({t:g})" for d, t in zip((3, 3, 3, 4, 4, 4), ERROR_21, strict=True))]
    assert table[7][:2] == ["error / standard deviation", f"{error / sigma:.2f} (0.2)"]
    assert rows(text, "**Table 12.")[6][1] == f"{2.0 * error:.3f}"  # the error of R1 is not known
    assert rows(text, "**Table 22.")[0][1] == "– (0.000)"
    assert "- near-0: no target" in text


def test_the_thesis_own_camera_is_not_replaced_by_another():
    table = rows(said("poses", page, {"far-1": camera(0.3)}).text, "**Table 21.")
    assert table[0][1] == "– (0.000)"
    assert table[5][1] == "– (2.81)"
    assert table[6][1] == "0.300 (0.61)"


def test_numbers_that_round_to_nothing_have_no_sign():
    text = said("poses", page, {"far-0": camera(-1e-6, correlation=-1e-6), "far26": camera(-1e-6)}).text
    assert "-0.000 " not in text
    assert "-0.0000 " not in text


def test_covariances_are_judged_by_the_band_of_chi_square():
    given = {"far-0": camera(0.5), "far-1": camera(1.0), "drawn-near": {"entries": [pose(0.9)] * 14}}
    table = rows(said("poses", page, given).text, "1 is honest**")
    low, high = chi2.ppf([0.025, 0.975], 12) / 12
    mean = (0.25 + 1.0) / 2.0
    assert table[0] == ["far, rendered, targets exact", "2", f"{mean:.3f}", f"{low:.2f}", f"{high:.2f}", "1.0"]
    low, high = chi2.ppf([0.025, 0.975], 84) / 84
    assert table[5] == ["near, centres drawn, targets calibrated", "14", "0.810", f"{low:.2f}", f"{high:.2f}", "0.9"]
    assert table[4][1:] == ["–"] * 5
    assert table[7] == ["near, thesis, table 22", "1", "–", "–", "–", "6.9"]


def test_what_more_views_bring_is_beside_what_noise_alone_would_give(tmp_path):
    far = camera(0.1)
    far["figure"]["counts"]["1"] = {"exact": pose(0.4), "calibrated": pose(0.2)}
    found = said("poses", page, {"far-0": far, "far26": camera(0.3)})
    length, floor, noise = np.sqrt(3.0), 0.05, 0.002
    alone = length * noise / np.hypot(floor, noise / 10.0)
    assert rows(found.text, "RMS over cameras, by:")[:4] == [
        ["far", "targets exact", f"{0.4 * length:.2f}", f"{0.1 * length:.2f}"],
        ["", "targets calibrated", f"{0.2 * length:.2f}", f"{0.2 * length:.2f}"],
        ["", "from noise alone, were views independent", f"{alone:.2f}", f"{alone / 10.0:.2f}"],
        ["near", "targets exact", "–", "–"],
    ]
    assert save(found.drawings[0], tmp_path).stat().st_size > 5000


def doubted(results, sentence):
    text = said("poses", page, results).text
    assert sentence in text
    return f"**Not borne out by this run:** {sentence}" in text


def test_claims_are_marked_where_the_poses_contradict_them():
    whole = {f"{view}-0": camera(0.1) for view in ("far", "near")}
    whole |= {f"drawn-{view}": {"entries": [pose(0.9)] * 14} for view in ("far", "near")}
    for key, other, sentence in (
        ("near-0", camera(1.1), "They are small because"),
        ("near-0", camera(1.1), "No chi-square is above its band"),
        ("drawn-far", {"entries": [pose(1.1)] * 14}, "With four targets the residuals"),
        ("drawn-far", {"error": "no target"}, "With four targets the residuals"),
    ):
        assert not doubted(whole, sentence)
        assert doubted({**whole, key: other}, sentence)
    assert doubted(whole, "The correlation of κ0 has the other sign")


def test_without_the_recording_its_part_is_left_out(results):
    assert "far26" not in said("poses", page, results).text
    film = {"counts": {"30": {"exact": pose(-0.2)}}, "common_px": 0.009, "scatter_px": 0.002}
    with_it = said("poses", page, {**results, "far26": {"table": film, "figure": film}}).text
    assert rows(with_it, "**far26,")[0][1] == "-0.200 (0.61)"


def test_any_part_of_a_run_is_a_page(results, tmp_path):
    for key, result in results.items():
        alone = said("poses", page, {key: result})
        assert len(alone.drawings) == (key != "drawn-far")
        assert all(save(drawing, tmp_path).stat().st_size > 5000 for drawing in alone.drawings)
