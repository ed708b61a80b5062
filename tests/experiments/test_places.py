"""Where to put the camera: visibility and bounds by geometry against films, pages of given and missing results."""

import json

import numpy as np
import pytest
from experiments import places
from experiments.kit import film as kit
from experiments.kit.job import Request
from experiments.places import Place, Size, expected, fitted, jobs, scene_from, targets_in_view
from experiments.report import places as places_module
from experiments.report.page import said
from experiments.report.places import page
from experiments.report.plot import save

from spheremouse.ball.truth import VISIBLE
from spheremouse.simulate.ball.profile import thesis
from spheremouse.simulate.ball.render import Renderer

QUICK, WHOLE = Request(True, None), Request(False, None)
FRONT = Place(0, 0, 2.35, 640.0)
NOISE = [Size(11.0, 0.1, 0.5, 50), Size(90.0, 0.02, 1.0, 50)]


def with_noise(sigma):
    return [Size(1e-3, sigma, 1.0, 50), Size(1e4, sigma, 1.0, 50)]


def test_the_discs_in_view_are_those_that_the_renderer_shows_whole():
    scene = scene_from(Place(-30, 20, 2.2, 600.0), 3)
    renderer, times = Renderer(scene), np.linspace(0.0, 9.0, 6)
    seen = places._sights(scene, thesis().attitude(times), with_noise(0.05))
    agree = total = 0
    for k, t in enumerate(times):
        truth = renderer.frame(thesis(), float(t), k, np.random.default_rng(0)).discs
        shown, ours = set(truth.disc[truth.state == VISIBLE].tolist()), set(seen[k].disc.tolist())
        agree, total = agree + len(shown & ours), total + len(shown | ours)
    assert total > 60
    assert agree / total > 0.95  # a strut that covers a hundredth of a disc is seen by one of the two


def test_the_bound_is_proportional_to_the_noise_of_centres_where_motion_is_well_known():
    one, two = (expected(FRONT, (0,), 20, with_noise(s)) for s in (0.02, 0.04))
    assert 1.5 < two["attitude_deg"] / one["attitude_deg"] < 2.05
    assert one["targets"] == 4


def test_discs_that_are_seldom_found_tell_less_and_smaller_ones_nothing():
    sigma = places._sigma(np.array([11.0, 90.0, 300.0, 5.0, np.nan]), NOISE)
    assert sigma[0] == pytest.approx(0.1 / np.sqrt(0.5))
    assert sigma[1:3] == pytest.approx([0.02, 0.02])
    assert np.all(np.isinf(sigma[3:]))


def test_a_fitted_lens_has_the_ball_fill_the_picture():
    for distance in (0.9, 2.35):
        half = np.tan(np.arcsin(0.6 / distance)) * fitted(distance)
        assert half == pytest.approx(0.45 * 480.0)


def test_targets_are_in_view_from_the_front_and_not_from_the_side_or_too_near():
    assert targets_in_view(scene_from(FRONT, 0)) == 4
    assert targets_in_view(scene_from(Place(75, 0, 2.35, 640.0), 0)) == 0
    assert targets_in_view(scene_from(Place(0, 0, 1.0, 640.0), 0)) == 0
    assert targets_in_view(scene_from(Place(0, 0, 2.35, 320.0), 0)) == 0  # the rings are too narrow


def film(place, error, own=None, tracked=10):
    axes = {"combined": error}
    one = {"frames": 10, "tracked": 10, "mean_discs": 7.0, "attitude_rmse_deg": axes, "rate_rmse_deg_s": axes}
    bound = {"attitude_deg": axes, "rate_deg_s": axes}
    return {"place": list(place), "true pose": one, "own pose": own or {**one, "tracked": tracked}, "bound": bound}


def entry(azimuth, elevation, error, targets=4):
    place = [azimuth, elevation, 2.35, 640.0]
    return {"place": place, "attitude_deg": error, "rate_deg_s": 10 * error, "discs": 9.0, "targets": targets}


SIDE = Place(-30, 20, 2.35, 640.0)


def results(targets=1):
    """Of six directions those level with the ball see the targets, the others see so many."""
    around = [
        entry(a, e, 0.01 + 0.0001 * abs(a) + 1e-5 * a + 0.001 * e, targets if e else 4)
        for a in (-30, 0, 30)
        for e in (0, 20)
    ]
    along = [{**entry(0, 0, 0.01 * d), "place": [0, 0, d, f]} for d in (1.0, 2.0) for f in (640.0, fitted(d))]
    noise = [list(size) for size in NOISE]
    return {
        "directions-0": {"noise": noise, "map": around, "checked": [entry(0, 0, 0.01)]},
        "distances": {"noise": noise, "map": along, "checked": []},
        FRONT.key: film(FRONT, 0.02),
        SIDE.key: film(SIDE, 0.03, {"error": "no target"}),
    }


def test_best_places_films_and_noise_are_tables(tmp_path):
    found = said("places", page, results())
    for line in (
        "| best that sees three targets | 0 | 0 | 0.0100 | 0.100 | 9.0 |",
        "| worst | 30 | 20 | 0.0333 | 0.333 | 9.0 |",
        "| ball fills the picture | 1.0 | 0.0100 | 9.0 | 1 | 1, 2 |",
        "| 0°, 0°, 2.35 m, 640 px | 4 | 7.0 | 0.0100 | 0.0200 | 0.0200 | 0.0200 |",
        "| -30°, 20°, 2.35 m, 640 px | – | 7.0 | – | 0.0300 | 0.0300 | – |",
        "| -30°, 20°, 2.35 m, 640 px | 0 | – | – | 0.030 | 0.030 | – |",
        "| 8 to 16 | 50 | 50 | 0.100 |",
    ):
        assert line + "\n" in found.text
    for words in (
        "visible from 3 directions only, all within -30° to 30° of azimuth and within 0° to 0° of elevation",
        "attitude 2.00 (2.00 to 2.00); rate 0.20 (0.20 to 0.20)",
        "none from 1 of 2 places. With the true pose the ball is tracked to the end from 1 of these",
        "the first 10 frames",
    ):
        assert words in found.text
    for drawing in found.drawings:
        assert save(drawing, tmp_path).stat().st_size > 5000


@pytest.mark.parametrize(
    ("given", "claim"),
    [
        (results(targets=4), "The targets limit the choice"),
        ({**results(), FRONT.key: film(FRONT, 0.02, {"error": "no target"})}, "The targets gave a pose if"),
        ({**results(), FRONT.key: film(FRONT, 0.02, tracked=6)}, "No frame is lost for a pose"),
    ],
)
def test_what_a_run_contradicts_is_marked(given, claim):
    marked = "**Not borne out by this run:** " + claim
    assert marked not in said("places", page, results()).text
    assert marked in said("places", page, given).text


def test_what_is_missing_is_a_shorter_table():
    whole = results()
    for key in whole:
        assert said("places", page, {key: whole[key]}).text.startswith("## Where to put the camera")
    text = said("places", page, {SIDE.key: whole[SIDE.key], "distances": {"error": "too dark"}}).text
    assert "- distances: too dark" in text
    assert "attitude – (– to –)" in text


@pytest.mark.parametrize("bounds", [(0.004, 0.0055), (0.134, 0.164), (0.1, 90.0)])
def test_ticks_of_a_scale_are_few_and_within(bounds):
    ticks = places_module._ticks(*bounds)
    assert 2 <= len(ticks) <= 6
    assert bounds[0] <= ticks[0] < ticks[-1] <= bounds[1] * (1.0 + 1e-9)


def test_every_film_has_its_place_in_a_map():
    for request in (QUICK, WHOLE):
        work = jobs(request)
        assert len({job.key for job in work}) == len(work)
        films = {job.key for job in work if job.work is places.filmed}
        checked = [Place(*p).key for job in work if job.work is places.mapped for p in job.parameters["checked"]]
        assert sorted(checked) == sorted(films)


def test_a_film_is_near_its_bound():
    found = json.loads(json.dumps(places.filmed(FRONT, 12)))
    assert found["true pose"]["tracked"] == 12
    for quantity, key in (("attitude_deg", "attitude_rmse_deg"), ("rate_deg_s", "rate_rmse_deg_s")):
        assert 0.2 < found["true pose"][key]["combined"] / found["bound"][quantity]["combined"] < 5.0
    assert kit.TRACKERS[-1] == found["own pose"]["tracker"]
