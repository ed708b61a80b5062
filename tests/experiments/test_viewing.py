"""How the camera films: tiny films, thinned ones, and pages made from given results, missing and failed ones too."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.experiments import viewing
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit import sights
from spheremouse.experiments.kit import tour as tour_module
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.kit.tour import thinned, tour
from spheremouse.experiments.report import viewing as viewing_module
from spheremouse.experiments.report.page import write_report
from spheremouse.experiments.report.plot import apart, save
from spheremouse.experiments.report.viewing import points, section
from spheremouse.experiments.viewing import KINDS, jobs
from spheremouse.geometry.rotation import log

QUICK, WHOLE = Request(True, None), Request(False, None)


@pytest.fixture(scope="module")
def film():
    return tour_module.filmed({"fps": 60.0, "size": [320, 240]}, 1, 0.6)


def row(error, lost=0):
    return {"attitude": error, "rate": 20.0 * error, "lost": lost, "tracked": 90, "frames": 90}


def point(error, names=("ekf1", "ekf2", "so3"), lost=0, **more):
    moved = {"rms": 40.0, "peak": 80.0, "acceleration": 3.0}
    least = {"attitude": 0.5 * error, "rate": 10.0 * error}
    return {"rows": {n: row(error, lost) for n in names}, "bound": least, "moved": moved, **more}


def results():
    """The slowest film is lost, the next ones are good."""
    rates = {"15": point(0.2, (*KINDS["rate"].shown,), lost=1), "30": point(0.05, (*KINDS["rate"].shown,))}
    return {
        "rate-1": {"points": rates},
        "rate-2": {"points": {**rates, "60": point(0.01, (*KINDS["rate"].shown,))}},
        "plain-1": point(0.03, pose=None),
        "size-320x240-1": point(0.06, pose="0 of 4 targets found"),
        "size-1920x1080-1": {"error": "too little memory"},
        "blur-33-1": point(0.5, pose=None),
        "readout-30-1": point(0.04, (*KINDS["readout"].shown,), pose=None),
    }


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


def tables(found):
    return {part.title.split(":")[0]: part for part in found.parts if isinstance(part, Table)}


# ---- films ----


def test_the_tour_leaves_no_axis_out_and_its_rate_is_that_of_its_attitude():
    for seed in (1, 2):
        profile = tour(seed, 3.5)
        t = np.linspace(0.0, 3.5, 3501)
        R, w = profile.attitude(t), profile.rate(t)
        middle = 0.5 * (w[1:] + w[:-1])
        assert_allclose(log(R[1:] @ R[:-1].transpose(0, 2, 1)) / 1e-3, middle, atol=1e-3)
        assert np.all(w[t < 0.19] == 0.0)
        spread = np.linalg.svd(w, compute_uv=False)
        assert spread[2] > 0.2 * spread[0]


def test_tours_are_alike_in_liveliness_but_not_in_order():
    t = np.linspace(0.0, 3.5, 200)
    speeds = [np.linalg.norm(tour(seed, 3.5).rate(t), axis=1) for seed in (1, 2, 3)]
    assert max(s.max() for s in speeds) == pytest.approx(min(s.max() for s in speeds), rel=1e-6)
    assert not np.allclose(tour(1, 3.5).rate(t), tour(2, 3.5).rate(t))


def test_a_thinned_film_is_the_film_at_the_slower_rate(film):
    fewer = thinned(film, 2)
    slow = tour_module.filmed({"size": [320, 240]}, 1, 0.6)
    assert [f.sequence for f in fewer.frames] == list(range(18))
    assert_allclose([f.stamp for f in fewer.frames], [f.stamp for f in slow.frames])
    assert_allclose(fewer.truth.motion.attitude, slow.truth.motion.attitude, atol=1e-12)
    for name in ("frame", "disc", "state"):
        assert_array_equal(getattr(fewer.truth.discs, name), getattr(slow.truth.discs, name))
    assert_allclose(fewer.truth.discs.centre, slow.truth.discs.centre, atol=1e-9)
    # the pictures differ by their noise of 3 grey values alone
    difference = fewer.frames[7].image.astype(float) - slow.frames[7].image
    assert np.std(difference) < 5.0


def test_one_film_is_followed_at_every_rate_it_holds(monkeypatch):
    monkeypatch.setattr(viewing, "FASTEST", 60)  # a smaller film
    found = json.loads(json.dumps(viewing.at_rates(1, 0.8, [30, 60])))["points"]
    assert [found[r]["rows"]["so3"]["frames"] for r in ("30", "60")] == [24, 48]
    assert set(found["30"]["rows"]) == set(KINDS["rate"].shown)
    for at in found.values():
        assert at["rows"]["so3"]["tracked"] == at["rows"]["so3"]["frames"]
        assert (
            at["rows"]["ekf2"]["rate"] < at["rows"][tour_module.PUBLISHED]["rate"]
        )  # it is told how lively the ball is
        assert 0.0 < at["bound"]["attitude"] < 1.0
    assert found["60"]["bound"]["rate"] < found["30"]["bound"]["rate"]


def test_a_rate_that_does_not_divide_the_film_is_refused():
    with pytest.raises(AssertionError, match="divide"):
        viewing.at_rates(1, 0.2, [50])


def test_a_readout_that_is_not_considered_costs_attitude():
    found = viewing.with_film(1, 1.2, {"readout": 0.03})
    assert found["pose"] is None  # nothing was amiss
    off = {
        name: found["rows"][name]["attitude"]
        for name in (tour_module.KNOWN, tour_module.ESTIMATED, tour_module.IGNORED)
    }
    assert off[tour_module.IGNORED] > 2.0 * off[tour_module.KNOWN]
    assert off[tour_module.ESTIMATED] < off[tour_module.IGNORED]


def test_where_no_target_is_found_the_true_pose_is_taken_and_said():
    found = viewing.with_film(1, 0.4, {"size": [320, 240]})
    assert "targets found" in found["pose"]
    assert found["rows"]["so3"]["tracked"] > 0


def test_the_classic_filters_are_told_the_true_acceleration(film):
    motion = film.truth.motion
    steady = replace(motion, rate=np.outer(motion.stamp, [3.0, 0.0, 0.0]))
    assert tour_module.acceleration(steady) == pytest.approx(np.sqrt(3.0))
    said = kit.settings_of([tour_module.suited(steady)]).euler.acceleration_sigma
    assert said == pytest.approx(np.sqrt(3.0))


def test_what_is_brief_is_what_was_reported(film):
    posed = replace(film, rig=replace(film.rig, pose=film.truth.pose))  # too small for targets
    seen = sights.look_at(posed, kit.settings_of(["tracker=ekf2"]))
    run = sights.filtered(seen, kit.settings_of(["tracker=ekf2"]), film)
    said = sights.errors(run, film.truth, 0.6)
    found = tour_module.brief(said)
    assert found["attitude"] == said["attitude_rmse_deg"]["combined"]
    assert found["rate"] == said["rate_rmse_deg_s"]["combined"]
    assert tour_module.least(None) is None


# ---- pages ----


def test_films_go_to_their_figures_and_the_plain_one_to_three():
    found = {name: points(results(), kind) for name, kind in KINDS.items()}
    assert {k: len(v) for k, v in found["rate"].items()} == {"15": 2, "30": 2, "60": 1}
    assert list(found["size"]) == ["320x240", "640x480"]
    assert list(found["blur"]) == ["0", "33"]
    assert found["readout"]["0"] == found["size"]["640x480"] == [results()["plain-1"]]


def test_the_advice_is_the_range_in_which_all_is_well():
    text = words(section(WHOLE, results()))
    assert "`so3` reaches that with 30 to 60 frames per second" in text
    assert "`so3` reaches that with all, 320×240 to 640×480" in text
    assert "`so3` reaches that with 0 ms of exposure" in text
    assert "`so3, ignored` reaches that with all, 0 to 30 ms of readout" in text
    bad = {key: point(0.3, pose=None) for key in ("plain-1", "blur-33-1")}
    text = words(section(WHOLE, bad))
    assert "`ekf1`, `ekf2`, `so3` reach that with none." not in text  # half of that is the bound, which does not either
    assert "`ekf1`, `ekf2`, `so3` reach that with none, nor does the bound: this motion asks too much." in text
    slow = {"plain-1": point(0.09), "blur-33-1": point(0.12)}  # rates of 1.8 and 2.4 °/s of 40
    slow["blur-33-1"]["bound"]["rate"] = 1.9
    assert "`ekf1`, `ekf2`, `so3` reaches" not in words(section(WHOLE, slow))
    slow["plain-1"] = point(0.11)
    assert "`ekf1`, `ekf2`, `so3` reach that with none." in words(section(WHOLE, slow))


def test_a_range_ends_where_a_film_is_lost_and_the_longest_counts():
    rates = {r: point(0.01, KINDS["rate"].shown, lost=int(r in ("30", "240"))) for r in KINDS["rate"].whole}
    found = points({"rate-1": {"points": rates}}, KINDS["rate"])
    assert viewing_module.good_range(found, "so3") == ("40", "120")
    assert viewing_module.good_range({"15": [point(0.5)]}, "so3") is None


def test_where_the_rate_is_best_is_said():
    rates = {r: point(e, KINDS["rate"].shown) for r, e in (("15", 0.2), ("60", 0.05), ("240", 0.1))}
    text = words(section(WHOLE, {"rate-1": {"points": rates}}))
    assert "`so3` 1.00 at 60 (4.00 at 15, 2.00 at 240)" in text
    assert "Worse at 240 than at their best: `ekf1` (2.0 times)" in text
    rates["240"] = point(0.04, KINDS["rate"].shown)
    assert "None is worse at 240." in words(section(WHOLE, {"rate-1": {"points": rates}}))


def test_a_readout_that_does_harm_when_told_is_said():
    given = {"plain-1": point(0.01), "readout-30-1": point(0.04, KINDS["readout"].shown)}
    assert "Telling it" not in words(section(WHOLE, given))
    given["readout-30-1"]["rows"]["so3"] = {**row(0.04), "attitude": 0.08}
    text = words(section(WHOLE, given))
    assert "Telling it makes it worse with 30 ms: attitude 0.080° told, 0.040° estimated, 0.040° ignored." in text


def test_films_that_failed_are_counted():
    found = section(WHOLE, {**results(), "blur-33-2": {"error": "no memory"}})
    rows = tables(found)["Motion blur"].rows
    assert next(r for r in rows if r[0] == "33")[1] == "1 of 2 failed"


def test_rows_have_medians_and_say_what_was_lost(tmp_path):
    found = section(WHOLE, results())
    rate = tables(found)["Frame rate"]
    assert rate.rows[0] == ("15", "2", "`ekf1`", "lost", "lost", "2 of 2")
    assert rate.rows[5] == ("30", "2", "`ekf1`", "0.050", "1.00", "0 of 2")
    assert rate.rows[9] == ("", "", "bound", "0.025", "0.50", "")
    assert {len(r) for r in rate.rows} == {len(rate.head)}
    size = tables(found)["Resolution"]
    assert [r[0] for r in size.rows if r[0]] == ["320×240", "640×480", "1920×1080"]
    assert size.rows[-1][:2] == ("1920×1080", "failed")
    page = write_report(tmp_path, {"viewing": (viewing.TITLE, found)}, "x")[0].read_text()
    assert "not found in 1 of 1 films: no target was found; these" in page
    assert "size-1920x1080-1: too little memory" in page
    for name in KINDS:
        assert (tmp_path / "experiments" / f"viewing-{name}-dark.svg").stat().st_size > 5000


def test_a_lost_film_is_one_that_says_so_or_is_far_off_or_has_nothing():
    assert tour_module.is_lost(row(0.1, lost=1))
    assert tour_module.is_lost(row(1.2))
    assert tour_module.is_lost({**row(0.1), "attitude": None})
    assert not tour_module.is_lost(row(0.9))


def test_a_figure_is_drawn_where_a_filter_or_the_bound_has_no_value(tmp_path):
    broken = point(0.1, pose=None)
    broken["rows"]["ekf1"] = {**row(0.1), "attitude": None, "rate": None, "tracked": 0}
    broken["bound"] = None
    found = section(WHOLE, {**results(), "blur-16-1": broken})
    figures = [p for p in found.parts if isinstance(p, Figure)]
    assert len(figures) == 4
    blur = next(figure for figure in figures if figure.name == "viewing-blur")
    assert all(path.stat().st_size > 5000 for path in save(blur, tmp_path))
    rows = tables(found)["Motion blur"].rows
    k = next(k for k, r in enumerate(rows) if r[0] == "16")
    assert rows[k][2:] == ("`ekf1`", "lost", "lost", "1 of 1")
    assert rows[k + 3] == ("", "", "bound", "–", "–", "")


def test_a_page_without_results_says_so():
    assert words(section(WHOLE, {})).count("No result.") == 4
    failed = {job.key: {"error": "no film"} for job in jobs(QUICK)}
    assert words(section(QUICK, failed)).count("no film") == len(failed)


def test_names_beside_lines_keep_apart_and_in_order():
    assert apart([], 0.1) == []
    assert apart([0.2, 0.5], 0.1) == pytest.approx([0.2, 0.5])
    moved = apart([0.2, 0.2, 0.22, 0.8], 0.1)
    assert np.all(np.diff(moved) > 0.0999)
    assert np.mean(moved[:3]) == pytest.approx(np.mean([0.2, 0.2, 0.22]))
    assert moved[3] == pytest.approx(0.8)


def test_jobs_have_keys_of_their_own_and_quick_ones_are_few():
    whole, quick = jobs(WHOLE), jobs(QUICK)
    assert len({j.key for j in whole}) == len(whole)
    assert sum(j.cost for j in quick) < 30.0
    assert sum(j.cost for j in whole) < 360.0
    words_of = {word for kind in KINDS.values() for word in kind.quick}
    assert words_of <= {word for kind in KINDS.values() for word in kind.whole}
