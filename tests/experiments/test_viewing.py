"""How the camera films: tiny films, thinned ones, and pages made from given results, missing and failed ones too."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import viewing
from experiments.kit import detections
from experiments.kit import film as kit
from experiments.kit import tour as tour_module
from experiments.kit.job import Request
from experiments.kit.tour import thinned, tour
from experiments.report.page import said
from experiments.report.plot import save
from experiments.report.viewing import page
from experiments.viewing import KINDS, jobs
from numpy.testing import assert_allclose, assert_array_equal

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
    found = viewing.with_film(1, 4.0, {"readout": 0.03})
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
    seen = detections.look_at(posed, kit.settings_of(["tracker=ekf2"]))
    run = detections.filtered(seen, kit.settings_of(["tracker=ekf2"]), film)
    said = detections.errors(run, film.truth, 0.6)
    found = tour_module.brief(said)
    assert found["attitude"] == said["attitude_rmse_deg"]["combined"]
    assert found["rate"] == said["rate_rmse_deg_s"]["combined"]
    assert tour_module.least(None) is None


def test_a_lost_film_is_one_that_says_so_or_is_far_off_or_has_nothing():
    assert tour_module.is_lost(row(0.1, lost=1))
    assert tour_module.is_lost(row(1.2))
    assert tour_module.is_lost({**row(0.1), "attitude": None})
    assert not tour_module.is_lost(row(0.9))


# ---- pages ----


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(title)[2].strip().partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_a_row_is_the_median_of_the_films_and_says_what_was_lost():
    given = results()
    given["rate-2"]["points"]["30"] = point(0.07, KINDS["rate"].shown)
    found = said("viewing", page, given).text
    rate = rows(found, "**Frame rate: median of the combined RMSE**")
    assert rate[0] == ["15", "`ekf1`", "lost", "lost", "2 of 2"]
    assert rate[5] == ["30", "`ekf1`", "0.060", "1.20", "0 of 2"]
    assert rate[9] == ["", "bound", "0.030", "0.60", ""]
    assert [row[0] for row in rate if row[0]] == ["15", "30", "60"]
    size = rows(found, "**Resolution: median of the combined RMSE**")
    assert [row[0] for row in size if row[0]] == ["320×240", "640×480"]
    assert "- size-1920x1080-1: too little memory" in found


def test_the_plain_film_stands_in_three_tables():
    found = said("viewing", page, {"plain-1": point(0.03, pose=None)})
    for title in ("Resolution", "Motion blur", "Rolling shutter"):
        assert "0.030" in [row[2] for row in rows(found.text, f"**{title}: median of the combined RMSE**")]
    assert [drawing.name for drawing in found.drawings] == ["viewing-size", "viewing-blur", "viewing-readout"]


def test_what_changes_over_a_range_is_a_ratio():
    found = said("viewing", page, results()).text
    blur = rows(found, "over the error without blur:")
    assert blur[2] == ["`so3`", f"{0.5 / 0.03:.2f}", f"{0.5 / 0.03:.2f}"]
    assert rows(found, "over that at 320×240:")[0] == ["`ekf1`", "–", "–"]


def test_where_the_rate_is_best_is_found():
    rates = {r: point(e, KINDS["rate"].shown) for r, e in (("15", 0.2), ("60", 0.05), ("240", 0.1))}
    table = rows(said("viewing", page, {"rate-1": {"points": rates}}).text, "The error of the rate, °/s:")
    assert table[0] == ["`ekf1`", "1.00", "60", "4.00", "2.00", "2.00"]
    assert table[-1] == ["bound", "0.50", "60", "2.00", "1.00", "2.00"]
    assert page({"rate-1": {"points": rates}}).values["over_least"]["so3"] == pytest.approx(2.0)


def test_good_is_what_loses_no_film_and_is_near_in_attitude_and_rate():
    """The rates are 20 times the attitudes; 5 % of the ball's own are 2 °/s."""
    off = {"15": 0.11, "20": 0.05, "30": 0.05, "40": 0.01, "60": 0.01, "80": 0.01, "120": 0.01, "240": 0.01}
    rates = {r: point(e, KINDS["rate"].shown, lost=int(r == "30")) for r, e in off.items()}
    rates["240"]["rows"]["so3"]["rate"] = 2.1
    others = {key: result for key, result in results().items() if "rate" not in key and "error" not in result}
    good = page({**others, "rate-1": {"points": rates}}).values["good"]
    assert good["rate"]["ekf1"] == ["20", "40", "60", "80", "120", "240"]
    assert good["rate"]["so3"] == ["20", "40", "60", "80", "120"]
    assert good["size"]["so3"] == ["320x240", "640x480"]
    assert good["blur"]["so3"] == ["0"]
    assert good["readout"][tour_module.IGNORED] == ["0", "30"]


def doubted(results, sentence):
    text = said("viewing", page, results).text
    assert sentence in text
    return f"**Not borne out by this run:** {sentence}" in text


def test_claims_are_marked_where_the_films_contradict_them():
    rates = {r: point(e, KINDS["rate"].shown) for r, e in (("15", 0.05), ("240", 0.06))}
    assert doubted({"rate-1": {"points": rates}}, "For `so3` and for the bound that is so")
    rates["240"] = point(0.04, KINDS["rate"].shown)
    assert not doubted({"rate-1": {"points": rates}}, "For `so3` and for the bound that is so")
    small = {"plain-1": point(0.03, pose=None), "size-320x240-1": point(0.03, pose="0 of 4 targets found")}
    assert not doubted(small, "At 320×240 no target was found")
    assert doubted({**small, "size-320x240-2": point(0.03, pose=None)}, "At 320×240 no target was found")
    slow = {"plain-1": point(0.01), "readout-30-1": point(0.015, KINDS["readout"].shown)}
    assert not doubted(slow, "A known or estimated readout")
    assert doubted(slow, "One that is ignored")
    assert doubted({"plain-1": point(0.01)}, "A known or estimated readout")


def test_any_part_of_a_run_is_a_page(tmp_path):
    for key, result in results().items():
        found = said("viewing", page, {key: result})
        assert all(save(drawing, tmp_path).stat().st_size > 5000 for drawing in found.drawings)
    failed = {job.key: {"error": "no film"} for job in jobs(QUICK)}
    assert said("viewing", page, failed).text.count("no film") == len(failed)


def test_a_figure_is_drawn_where_a_filter_or_the_bound_has_no_value(tmp_path):
    broken = point(0.1, pose=None)
    broken["rows"]["ekf1"] = {**row(0.1), "attitude": None, "rate": None, "tracked": 0}
    broken["bound"] = None
    found = said("viewing", page, {**results(), "blur-16-1": broken})
    blur = next(drawing for drawing in found.drawings if drawing.name == "viewing-blur")
    assert save(blur, tmp_path).stat().st_size > 5000
    table = rows(found.text, "**Motion blur: median of the combined RMSE**")
    assert table[4:8:3] == [["16", "`ekf1`", "lost", "lost", "1 of 1"], ["", "bound", "–", "–", ""]]


def test_jobs_have_keys_of_their_own_and_quick_ones_are_few():
    whole, quick = jobs(WHOLE), jobs(QUICK)
    assert len({j.key for j in whole}) == len(whole)
    assert sum(j.cost for j in quick) < 30.0
    assert sum(j.cost for j in whole) < 360.0
    words_of = {word for kind in KINDS.values() for word in kind.quick}
    assert words_of <= {word for kind in KINDS.values() for word in kind.whole}
