"""Points on the ball: covariances along it, areas, pages of good, failed and missing results."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import surface
from experiments.kit.job import Request
from experiments.report.page import said
from experiments.report.plot import save
from experiments.report.surface import page

from spheremouse.simulate.ball.scene import default_scene

QUICK = Request(True, None)


@pytest.fixture(scope="module")
def results():
    work = {"cap-far": surface.cap("far", 3, 2), "area": surface.areas(1500)}
    return json.loads(json.dumps(work))


def exact(view="far"):
    scene = default_scene(1, view)
    return scene, replace(scene.rig(), pose=scene.pose)


def test_in_the_middle_a_pixel_is_as_large_as_the_gap_says():
    scene, rig = exact()
    points = surface._seen(np.array([[0.0, 0.0, 1.0]]), np.array([0.1]), rig, scene)
    variance, _ = surface._along_surface(points)
    assert np.sqrt(variance) == pytest.approx(np.full((1, 2), 0.1 * (2.35 - 0.6) / 640.0))


def test_aslant_the_worst_direction_leads_to_the_limb():
    scene, rig = exact()
    a = np.radians(60.0)
    u = np.array([[np.sin(a) * 0.6, np.sin(a) * 0.8, np.cos(a)]])
    points = surface._seen(u, np.array([0.1]), rig, scene)
    variance, axes = surface._along_surface(points)
    outward = np.array([np.cos(a) * 0.6, np.cos(a) * 0.8, -np.sin(a)])
    assert abs(axes[0, :, 1] @ outward) == pytest.approx(1.0, abs=1e-6)
    assert np.abs(u @ axes[0]).max() < 1e-9
    # foreshortened by the cosine between the normal and the ray
    ray = np.array([0.0, 0.0, 2.35]) - 0.6 * u[0]
    assert np.sqrt(variance[0, 0] / variance[0, 1]) == pytest.approx(u[0] @ ray / np.linalg.norm(ray), rel=0.1)


def test_errors_are_in_units_of_what_is_claimed():
    """Detections that are off by their covariance: chi-square is 1."""
    scene, rig = exact("near")
    rng = np.random.default_rng(0)
    middle = scene.pose.position / np.linalg.norm(scene.pose.position)
    u = rng.standard_normal((4000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    u = u[u @ middle > np.cos(np.radians(50.0))]
    centre = surface.seen_at(u, scene.rig(), scene.pose) + 0.1 * rng.standard_normal((len(u), 2))
    seen = surface.Detections(centre, np.tile(0.01 * np.eye(2), (len(u), 1, 1)), np.zeros(len(u)))
    found = surface._errors(surface._Sights(seen, u), rig, scene.pose)
    assert surface._chi_square([found]) == pytest.approx(1.0, abs=0.1)


def test_covariances_of_the_thesis_have_its_sigmas():
    scene, _ = exact()
    rig = surface._as_the_thesis(scene)
    assert np.sqrt(np.diag(rig.ball.covariance)) == pytest.approx([0.7e-3, 0.9e-3, 3.3e-3, 2.7e-3])
    assert np.sqrt(np.diag(rig.pose.covariance))[:3] == pytest.approx([1.9e-3, 1.3e-3, 1.1e-3])
    assert np.linalg.eigvalsh(rig.ball.covariance).min() > 0.0


@pytest.mark.parametrize(("distance", "area"), [(2.35, 1.685), (1.35, 1.257), (1e9, 2.262), (0.6, 0.0)])
def test_the_visible_cap(distance, area):
    assert surface.visible_cap(distance, 0.6) == pytest.approx(area, abs=1e-3)


def test_counting_agrees_with_the_formula(results):
    area = results["area"]
    formula = [surface.visible_cap(d, 0.6) for d in area["distance"]]
    assert area["alone"] == pytest.approx(formula, abs=0.01)
    for view in area["views"].values():
        assert view["alone"] == pytest.approx(surface.visible_cap(view["distance"], 0.6), abs=0.01)
        shares = [view[k] for k in ("alone", "behind frame", "one hand", "two hands")]
        assert shares == sorted(shares, reverse=True)
        assert shares[-1] > 0.2


def test_claims_grow_towards_the_limb_and_with_more_errors(results):
    cap = results["cap-far"]
    first, last = cap["bins"][0], cap["bins"][-1]
    assert last["total sigma"][0] > 5.0 * first["total sigma"][0]
    for entry in cap["bins"]:
        assert entry["total sigma"][0] > entry["image sigma"][0]
        assert entry["total sigma"][0] >= entry["total sigma"][1]
    worst, best = np.array(cap["map"]["worst"]), np.array(cap["map"]["best"])
    assert np.all(worst >= best)
    assert np.all(worst[:, -1] > 5.0 * worst[:, 0])
    assert 0.0 < cap["chi_square_image"] < 1.0  # careful: no print, no lens


def test_fed_with_the_thesis_covariances_table_13_comes_out(results):
    five = results["cap-far"]["table 13"]["as the thesis"]
    ours = np.array([p["correlation"] for p in five]).ravel()
    theirs = np.array([c for _, c, _ in surface.TABLE_13]).ravel()
    strong = np.abs(theirs) > 0.6
    assert np.array_equal(np.sign(ours[strong]), np.sign(theirs[strong]))
    sigma = np.array([p["sigma"] for p in five]) / np.array([s for _, _, s in surface.TABLE_13])
    assert 0.7 < np.sqrt(np.mean(sigma**2)) < 1.3


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(title)[2].strip().partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def doubted(results, sentence):
    text = said("surface", page, results).text
    assert sentence in text
    return f"**Not borne out by this run:** {sentence}" in text


def test_films_and_areas_make_a_page_and_what_is_missing_is_a_dash(results):
    text = said("surface", page, results).text
    cap = results["cap-far"]
    chi = [f"{cap[name]:.2f}" for name in ("chi_square_image", "chi_square_total")]
    assert rows(text, "1 is honest**") == [["far", str(cap["detections"]), *chi], ["near", "–", "–", "–"]]
    table = rows(text, "**Table 13. Points on the ball**")
    point = cap["table 13"]["as the thesis"][1]
    assert table[3][:4] == ["2", "-322, 316, 371", "thesis", "-0.50"]
    assert table[4][3:] == [*(f"{x:.2f}" for x in point["correlation"]), *(f"{x:.1f}" for x in point["sigma"])]
    without = said("surface", page, {"area": results["area"], "cap-far": {"error": "the ball is gone"}}).text
    assert rows(without, "**Table 13. Points on the ball**")[4][3:] == ["–"] * 6
    assert "- cap-far: the ball is gone" in without


def test_what_the_image_makes_of_the_variance_is_counted(results):
    near = [{"angle": a, "total sigma": [t, 1.0], "image sigma": [i, 1.0]} for a, t, i in ((9, 2.0, 1.0), (69, 10, 9))]
    bins = [{**b, "total error": [1.0, 1.0], "image error": [1.0, 1.0]} for b in near]
    given = {**results, "cap-near": {**results["cap-far"], "bins": bins, "chi_square_image": 0.3}}
    table = rows(said("surface", page, given).text, "the image alone in it**")
    assert table[2:] == [["near", "9", "2.00", "1.00", "25"], ["", "69", "10.00", "9.00", "81"]]
    assert not doubted(given, "The image's claimed share is larger")
    given["cap-near"]["chi_square_image"] = 1.4
    assert doubted(given, "The image's claimed share is larger")


def test_shares_that_frame_and_hands_hide_are_of_what_was_left(results):
    seen = {"distance": 2.35, "alone": 2.0, "behind frame": 1.5, "one hand": 1.2, "two hands": 0.75}
    views = {"far": seen, "near": {**seen, "distance": 1.35, "alone": 1.6, "behind frame": 0.8}}
    given = {"area": {**results["area"], "views": views}}
    table = rows(said("surface", page, given).text, "fig. 39)**")
    discs = f"{50 * 1.5 / (4 * np.pi * 0.36):.1f}"
    assert table[0] == ["far", "2.35", "2.74", "1.68", "2.00", "25", "20", "50", discs]
    assert not doubted(given, "The thesis has 20 % more discs")
    views["near"]["behind frame"] = 1.4
    assert doubted(given, "The thesis has 20 % more discs")


def test_any_part_of_a_run_is_a_page(results, tmp_path):
    for key, figures in (("cap-far", 2), ("area", 1)):
        found = said("surface", page, {key: results[key]})
        assert len(found.drawings) == figures
        assert all(save(drawing, tmp_path).stat().st_size > 5000 for drawing in found.drawings)


def test_jobs_have_keys_of_their_own():
    quick, whole = surface.jobs(QUICK), surface.jobs(Request(False, None))
    assert len({j.key for j in whole}) == len(whole)
    assert quick[0].parameters["frames"] < whole[0].parameters["frames"]
