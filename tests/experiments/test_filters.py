"""The comparison of the filters: a tiny film, and pages made from given results, missing and failed ones too."""

from pathlib import Path

import numpy as np
import pytest

from spheremouse.experiments.filters import jobs, play, simulated
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.report.filters import _gapped, acceleration, section
from spheremouse.experiments.report.plot import save
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


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


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
    found = section(HERE, {"r1": on_r1(), "s1": on_s1(), "far26": {"error": "no file"}})
    table = next(part for part in found.parts if isinstance(part, Table))
    assert [row[:3] for row in table.rows[:3]] == [
        ("R1", "EKF1, thesis", "0.962"),
        ("R1", "EKF2, thesis", "0.963"),
        ("R1-like", "`ekf1`", "0.95500"),
    ]
    assert ("S1", "EKF2, thesis", "0.999", "1.09", "0.11 px/s", "–", "–", "–") in table.rows
    assert ("S1, ours", "`so3`", "0.99990", "0.30", "0.6 mm/s", "12", "0.0030", "300 of 300, 0") in table.rows
    assert table.rows[-1] == ("far26", "failed", *("–",) * 6)
    assert {len(row) for row in table.rows} == {len(table.head)}
    text = words(found)
    assert (
        "In the thesis `ekf2` has 0.69 times the rate error of `ekf1`; on our S1 0.75 times with our detector." in text
    )
    assert "With the published detector it is 0.50 times." in text
    assert "What the state of the discs brings is the attitude: `ekf2` 0.006°, `ekf1` 0.008°" in text
    assert "lost by `ekf1` 3 times (largest error of the speed 12 mm/s), `ekf2` 2 times" in text
    assert "in 40 % of the frames it uses fewer than 2" in text
    assert "239.7 ± 1.5 counts/rad" in text
    assert "far26: no file" in text


def test_runs_that_went_wrong_are_not_compared():
    given = on_s1()
    given["rows"]["ekf2-blobs"] = {**row(1.0, 1), "attitude_rmse_deg": {"combined": 5.7}}
    text = words(section(AWAY, {"s1": given}))
    assert "goes wrong by 0.0° (`ekf1`) and 5.7° (`ekf2`), and the ball is lost never and once" in text
    assert "it is 0.50 times" not in text
    given["rows"]["ekf2-blobs"]["few_share"] = 0.0
    assert "it is not for want of discs" in words(section(AWAY, {"s1": given}))
    given["rows"]["ekf1-blobs"]["rate_rmse_deg_s"] = {"combined": None}
    assert "With the published detector nothing is tracked." in words(section(AWAY, {"s1": given}))


def test_what_the_numbers_do_not_say_is_not_said():
    worse = {**row(0.6), "attitude_rmse_deg": {"combined": 9.5}}
    lost = {"lost_episodes": 1}
    on = {**on_r1(), "rows": {**rows(), "ekf2": worse}, "match": {**on_r1()["match"], "scale_sigma": 30.0}}
    text = words(section(AWAY, {"r1": on, "s1": {**on_s1(), "rows": {**rows(), "ekf2": worse}}}))
    assert "Nor does the state of the discs bring a better attitude here" in text
    assert "`ekf2` has the worse attitude of the published filters (9.5° against 0.0°)." in text
    assert "too short to tell the scale" in text
    assert "counts/rad" not in text
    assert "is chance" not in text  # it was never lost
    assert "both lose the ball" in words(section(AWAY, {"r1": {**on, "rows": {**rows(), "ekf2": {**worse, **lost}}}}))


def test_a_stiff_filter_that_sends_the_better_speed_is_said():
    swapped = {**rows(), "so3": {**row(0.3), "surface_speed_rmse_mm_s": {"combined": 1.8, "x": 1.0, "y": 1.5}}}
    text = words(section(HERE, {"far26": {**on_s1(), "rows": swapped}}))
    assert "`so3` is off by 1.8 mm/s, that of `ekf2` by 1.2 mm/s, and its rate by 0.30 against 0.60 °/s" in text
    assert "that of `ekf2` by" not in words(section(HERE, {"far26": on_s1()}))


def test_the_motion_of_the_thesis_has_the_acceleration_it_states():
    assert np.rad2deg(acceleration(thesis())) == pytest.approx(16.4, rel=0.05)


def test_livelier_players_stand_in_a_table_with_what_was_not_run():
    found = section(AWAY, {"r1": on_r1(), "s1": on_s1(), "pace-1": on_r1()})
    paces = [part for part in found.parts if isinstance(part, Table)][1]
    assert [row[0] for row in paces.rows] == ["0.5", "0.75", "1"]
    assert paces.rows[1][1] == "not run"
    assert paces.rows[2][2] == "0.955, 0.80 °/s, lost 3×"
    assert "far26 was not at hand" in words(found)
    assert "series" not in found.figures["s1"]  # the pictures have them


def test_figures_draw_where_a_filter_tracked_nothing(tmp_path):
    found = section(AWAY, {"r1": on_r1(), "s1": {**on_s1(), "series": series("error", empty=("ekf2",))}})
    figures = [part for part in found.parts if isinstance(part, Figure)]
    assert [f.name for f in figures] == ["filters-r1", "filters-s1"]
    for figure in figures:
        assert all(path.stat().st_size > 5000 for path in save(figure, tmp_path))


def test_a_curve_breaks_where_frames_are_missing():
    t = _gapped(series("speed")["so3"], "t")
    assert len(t) == 6
    assert np.isnan(t[3])
    assert not np.isnan(np.delete(t, 3)).any()


def test_jobs_need_the_datasets_for_far26_alone():
    assert [job.key for job in jobs(AWAY)] == ["r1", "s1", "pace-0.75", "pace-1"]
    assert [job.key for job in jobs(Request(True, Path("sets")))] == ["r1", "s1", "far26"]
