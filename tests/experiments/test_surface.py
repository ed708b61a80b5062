"""Points on the ball: covariances along it, areas."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import surface

from spheremouse.simulate.ball.scene import default_scene


@pytest.fixture(scope="module")
def results():
    work = {"cap-far": surface.cap("far", 3, 2), "area": surface.areas(1500)}
    return json.loads(json.dumps(work))


def exact(view="far"):
    scene = default_scene(1, view)
    return scene, replace(scene.rig(), pose=scene.pose)


def test_in_the_middle_a_pixel_is_as_large_as_the_gap_says():
    scene, rig = exact()
    points = surface.seen_points(np.array([[0.0, 0.0, 1.0]]), np.array([0.1]), rig, scene)
    variance, _ = surface.along_surface(points)
    assert np.sqrt(variance) == pytest.approx(np.full((1, 2), 0.1 * (2.35 - 0.6) / 640.0))


def test_aslant_the_worst_direction_leads_to_the_limb():
    scene, rig = exact()
    a = np.radians(60.0)
    u = np.array([[np.sin(a) * 0.6, np.sin(a) * 0.8, np.cos(a)]])
    points = surface.seen_points(u, np.array([0.1]), rig, scene)
    variance, axes = surface.along_surface(points)
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
    found = surface.surface_errors(surface.SeenDiscs(seen, u), rig, scene.pose)
    assert surface.chi_square([found]) == pytest.approx(1.0, abs=0.1)


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
    assert 0.0 < cap["chi_square_image"] < 1.0  # careful: no print, no lens


def test_fed_with_the_thesis_covariances_table_13_comes_out(results):
    five = results["cap-far"]["table 13"]["as the thesis"]
    ours = np.array([p["correlation"] for p in five]).ravel()
    theirs = np.array([c for _, c, _ in surface.TABLE_13]).ravel()
    strong = np.abs(theirs) > 0.6
    assert np.array_equal(np.sign(ours[strong]), np.sign(theirs[strong]))
    sigma = np.array([p["sigma"] for p in five]) / np.array([s for _, _, s in surface.TABLE_13])
    assert 0.7 < np.sqrt(np.mean(sigma**2)) < 1.3
