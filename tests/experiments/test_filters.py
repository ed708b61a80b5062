"""The comparison of the filters: a tiny film, and pages made from given results, missing and failed ones too."""

from pathlib import Path

import numpy as np
import pytest
from experiments.filters import jobs, play, simulated
from experiments.kit.job import Request
from experiments.report.filters import _gapped, acceleration, page
from experiments.report.page import said
from experiments.report.plot import save

from spheremouse.simulate.ball.profile import thesis

HERE = Request(False, Path("sets"))
AWAY = Request(False, None)


def row(rate, lost=0):
    return {
        "frames": 300,
        "tracked": 300 - lost,
        "lost_episodes": lost,
        "attitude_rmse_deg": {"combined": 0.01 * rate},
        "rate_rmse_deg_s": {"combined": rate},
        "surface_speed_rmse_mm_s": {"combined": 2.0 * rate, "x": rate, "y": rate},
        "surface_speed_r": {"combined": 0.9999},
        "mean_discs": 5.5,
        "detection": {"centre_rms_px": 0.071},
        "largest_mm_s": 12.0,
        "few_share": 0.4,
        "trackball": {"r": 0.985 - 0.01 * lost, "lag_s": 0.09},
    }


def rows():
    return {"ekf1": row(0.8, 3), "ekf2": row(0.6, 2), "ekf1-blobs": row(2.0), "ekf2-blobs": row(1.0), "so3": row(0.3)}


def series(key, empty=()):
    t = [0.0, 0.1, 0.2, 0.5, 0.6]
    full = {"t": t, key: [[10.0 * x, -x] for x in t], "true": [[x, x] for x in t]}
    nothing = {"t": [], key: [], "true": []}
    return {name: nothing if name in empty else full for name in ("ekf1", "ekf2", "so3")}


def on_s1():
    return {"rows": rows(), "series": series("error")}


def on_r1():
    return {
        "rows": rows(),
        "series": series("speed", empty=("ekf1",)),
        "log": {"t": [0.0, 0.1], "speed": [[1.0, 2.0], [3.0, 4.0]]},
        "truth": {"r": 0.9855, "lag_s": 0.09},
        "match": {"lag_ms": 91.2, "lag_sigma_ms": 0.4, "scale": 239.7, "scale_sigma": 1.5},
        "from": 12.0,
        "to": 22.0,
    }


def table(text, head):
    """The cells of the table whose head has these words."""
    lines = text[text.rindex("\n", 0, text.index(head)) :].strip().partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_a_short_film_is_tracked_by_all_and_the_series_are_its_frames():
    result = simulated(45)
    assert set(result["rows"]) == {"ekf1", "ekf2", "ekf1-blobs", "ekf2-blobs", "so3"}
    assert result["rows"]["so3"]["tracked"] == 45
    s = result["series"]["so3"]
    assert len(s["t"]) == len(s["error"]) == len(s["true"]) == 44  # a speed takes two frames
    rms = np.sqrt(np.mean(np.sum(np.array(s["error"]) ** 2, axis=1)))
    assert rms == pytest.approx(result["rows"]["so3"]["surface_speed_rmse_mm_s"]["combined"], rel=0.01)


def test_the_film_like_r1_gives_a_log_that_so3_agrees_with_as_the_truth_does():
    result = play(3.2, 1.0, False)
    assert set(result["rows"]) == {"ekf1", "ekf2", "so3"}
    assert result["rows"]["so3"]["trackball"]["r"] == pytest.approx(result["truth"]["r"], abs=0.01)
    log, mine = np.array(result["log"]["speed"]), np.array(result["series"]["so3"]["speed"])
    assert len(log) == len(mine) == 95
    assert np.corrcoef(log.ravel(), mine.ravel())[0, 1] == pytest.approx(result["truth"]["r"], abs=0.02)


def test_the_table_has_the_thesis_above_ours():
    found = said("filters", page, {"r1": on_r1(), "s1": on_s1(), "far26": {"error": "no file"}})
    lines = table(found.text, "| correlation")
    assert [line[:3] for line in lines[:3]] == [
        ["R1", "EKF1, thesis", "0.962"],
        ["", "EKF2, thesis", "0.963"],
        ["R1-like", "`ekf1`", "0.95500"],
    ]
    assert ["", "EKF2, thesis", "0.999", "1.09", "0.11", *["–"] * 5] in lines
    assert lines[-1] == ["", "`so3`", "0.99990", "0.30", "0.6", "12", "0.0030", "300", "300", "0"]
    assert "- far26: no file" in found.text
    assert "On far26" not in found.text


def test_the_filters_are_compared_in_numbers():
    text = said("filters", page, {"r1": on_r1(), "s1": on_s1()}).text
    assert "on our S1 it has 0.75 times that error with our detector" in text
    assert "`so3` has 0.50 times the rate error of `ekf2`" in text
    assert "The state of the discs improves the attitude: `ekf2` 0.006°, `ekf1` 0.008°" in text
    assert "lose the ball there (3 and 2 times, with errors of the speed of up to 12 and 12 mm/s)" in text
    assert "In 40 % of the frames it uses fewer than 2 (40 %)" in text
    assert "91.2 ± 0.4 ms and 239.7 ± 1.5 counts/rad (simulated: 83 ms" in text
    assert "Mouse speeds from 12 to 22 s" in text


def test_claims_that_the_numbers_contradict_are_marked():
    text = said("filters", page, {"r1": on_r1(), "s1": on_s1()}).text
    assert "run:** Centres that are good from the start" in text  # 0.75 is below 0.9
    assert "run:** With the published detector the two cannot" in text  # 0.01° is not far off
    assert "run:** That `ekf2` has the worse attitude" in text
    given = {"r1": on_r1(), "s1": on_s1()}
    wrong = {**row(1.0), "attitude_rmse_deg": {"combined": 5.7}}
    given["s1"]["rows"] |= {"ekf1-blobs": wrong, "ekf2-blobs": wrong}
    given["s1"]["rows"]["ekf2"] = row(0.79)
    given["r1"]["rows"]["ekf2"]["attitude_rmse_deg"] = {"combined": 9.5}
    marked = said("filters", page, given).text
    assert "run:** Centres" not in marked
    assert "run:** With the published detector" not in marked
    assert "wrong, by 5.7° (`ekf1`) and 5.7° (`ekf2`)" in marked
    assert "run:** That `ekf2` has the worse attitude" not in marked
    given["r1"]["match"]["scale_sigma"] = 30.0
    assert "run:** `match` finds" in said("filters", page, given).text


def test_a_stiff_filter_that_sends_the_better_speed_is_told():
    swapped = {**rows(), "so3": {**row(0.3), "surface_speed_rmse_mm_s": {"combined": 1.8, "x": 1.0, "y": 1.5}}}
    text = said("filters", page, {"s1": on_s1(), "far26": {**on_s1(), "rows": swapped}}).text
    assert "1.8 against 1.2 mm/s, though its rate is better, 0.30 against 0.60 °/s" in text
    assert "run:** On far26" not in text
    assert "run:** On far26" in said("filters", page, {"s1": on_s1(), "far26": on_s1()}).text


def test_the_motion_of_the_thesis_has_the_acceleration_it_states():
    assert np.rad2deg(acceleration(thesis())) == pytest.approx(16.4, rel=0.05)


def test_livelier_players_stand_in_a_table_with_what_was_not_run():
    found = said("filters", page, {"r1": on_r1(), "s1": on_s1(), "pace-1": on_r1()})
    paces = table(found.text, "| pace")
    assert [line[0] for line in paces] == ["0.5", "", "", "0.75", "", "", "1", "", ""]
    assert paces[3] == ["0.75", "–", "`ekf1`", "–", "–", "–"]
    assert paces[6] == ["1", "0.986", "`ekf1`", "0.955", "0.80", "3"]
    assert "run:** They lose the ball at every pace" in found.text


def test_figures_draw_where_a_filter_tracked_nothing(tmp_path):
    still = {**on_r1(), "log": None, "truth": {}, "match": {}}
    found = said("filters", page, {"r1": still, "s1": {**on_s1(), "series": series("error", empty=("ekf2",))}})
    assert "log by –" in found.text
    assert [drawing.name for drawing in found.drawings] == ["filters-r1", "filters-s1"]
    for drawing in found.drawings:
        assert save(drawing, tmp_path).stat().st_size > 5000


def test_a_curve_breaks_where_frames_are_missing():
    t = _gapped(series("speed")["so3"], "t")
    assert len(t) == 6
    assert np.isnan(t[3])
    assert not np.isnan(np.delete(t, 3)).any()


def test_jobs_need_the_datasets_for_far26_alone():
    assert [job.key for job in jobs(AWAY)] == ["r1", "s1", "pace-0.75", "pace-1"]
    assert [job.key for job in jobs(Request(True, Path("sets")))] == ["r1", "s1", "far26"]
