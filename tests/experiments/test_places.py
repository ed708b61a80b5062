"""Where to put the camera: visibility and bounds by geometry against films, sections of good, failed and no results."""

import json

import numpy as np
import pytest

from spheremouse.ball.truth import VISIBLE
from spheremouse.experiments import places
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.places import Place, Size, expected, fitted, jobs, scene_from, targets_in_view
from spheremouse.experiments.report import places as places_module
from spheremouse.experiments.report.page import write_report
from spheremouse.experiments.report.places import section
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


def film(place, attitude, own=None, tracked=10):
    axes = {"x": attitude, "y": attitude, "z": attitude, "combined": attitude}
    said = {"frames": 10, "tracked": tracked, "mean_discs": 7.0, "attitude_rmse_deg": axes, "rate_rmse_deg_s": axes,
            "pose_error": {"position_mm": [3.0, 4.0, 0.0], "sigma_position_mm": [6.0, 8.0, 0.0]}}  # fmt: skip
    bound = {"attitude_deg": axes, "rate_deg_s": axes}
    return {"place": list(place), "true pose": said, "own pose": said if own is None else own, "bound": bound}


def entry(azimuth, elevation, error, targets=4):
    place = [azimuth, elevation, 2.35, 640.0]
    return {"place": place, "attitude_deg": error, "rate_deg_s": 10 * error, "discs": 9.0, "targets": targets}


def results():
    around = [
        entry(a, e, 0.01 + 0.0001 * abs(a) + 0.001 * e, 4 if e == 0 else 1) for a in (-30, 0, 30) for e in (0, 20)
    ]
    along = [{**entry(0, 0, 0.01 * d), "place": [0, 0, d, f]} for d in (1.0, 2.0) for f in (640.0, fitted(d))]
    noise = [list(size) for size in NOISE]
    return {
        "directions-0": {"noise": noise, "map": around, "checked": [entry(0, 0, 0.01)]},
        "distances": {"noise": noise, "map": along, "checked": []},
        FRONT.key: film(FRONT, 0.02),
        Place(-30, 20, 2.35, 640.0).key: film(Place(-30, 20, 2.35, 640.0), 0.03, {"error": "no target"}),
    }


def words(found):
    return "\n".join(p for p in found.parts if isinstance(p, str))


def test_the_advice_is_the_best_place_that_sees_the_targets(tmp_path):
    found = section(WHOLE, results())
    text = words(found)
    assert "put the camera at azimuth 0°, elevation 0° (0.0100°, 0.100 °/s)" in text
    assert "three or more are seen from 3 of the 6 directions" in text
    assert "attitude 2.00 (2.00 to 2.00)" in text  # the film with a map's value
    assert "From 1 of 2 places the targets gave no pose; with the true pose the ball is tracked to the end" in text
    assert "all within -30° to 30° of azimuth and at 0° of elevation" in text
    assert "the first 150 frames" in text
    page = write_report(tmp_path, {"places": (places.TITLE, found)}, "x")[0].read_text()
    assert "| -30°, 20°, 2.35 m, 640 px | – | 7.0 | map | – | – |  |" in page
    assert "|  |  |  | `so3`, own pose | no pose | no pose | no pose |" in page
    assert "|  |  |  | `so3`, true pose | 0.0300 | 0.030 | 0 |" in page
    assert (tmp_path / "experiments" / "places-directions-dark.svg").stat().st_size > 5000
    assert (tmp_path / "experiments" / "places-distances-light.svg").stat().st_size > 5000
    assert "lost" not in places_module._lost_by_pose(places_module._films(results()))


def test_what_holds_everywhere_is_no_limit_and_no_missing_pose():
    given = results()
    for e in given["directions-0"]["map"]:
        e["targets"] = 4
    given[Place(-30, 20, 2.35, 640.0).key] = film(Place(-30, 20, 2.35, 640.0), 0.03)
    text = words(section(WHOLE, given))
    assert "Three targets or more are seen from all of them." in text
    assert "limits the choice" not in text
    assert "gave no pose" not in text


def test_a_film_that_failed_is_a_row():
    found = section(WHOLE, {**results(), "film-45-10-2.35-640": {"error": "too dark"}})
    table = next(p for p in found.parts if isinstance(p, Table))
    assert table.rows[-1][0] == "45-10-2.35-640: failed"
    assert {len(r) for r in table.rows} == {len(table.head)}


def test_a_ball_that_is_lost_for_its_pose_is_told():
    one = film(FRONT, 0.02)
    one["own pose"] = {**one["own pose"], "tracked": 6}
    text = places_module._lost_by_pose([(FRONT, one)])
    assert "off by 5 mm (standard deviation 10 mm), 4 frames" in text


def test_a_section_of_nothing_and_of_failures_says_so():
    assert section(QUICK, {}).parts
    failed = section(QUICK, {job.key: {"error": "too little memory"} for job in jobs(QUICK)})
    assert words(failed).count("too little memory") == len(jobs(QUICK))
    assert not [p for p in failed.parts if isinstance(p, Table | Figure)]


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
