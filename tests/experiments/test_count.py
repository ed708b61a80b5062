"""Errors against the number of discs: a tiny film, and pages made from given results, missing and failed ones too."""

import numpy as np

from spheremouse.experiments import count
from spheremouse.experiments.count import jobs, with_discs
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.report.count import section
from spheremouse.experiments.report.plot import save

WHOLE = Request(False, None)


def ball(error, lost=0):
    axes = {"x": error, "y": 2.0 * error, "z": 3.0 * error, "combined": np.sqrt(14.0) * error}
    row = {
        "mean_discs": 5.2,
        "lost_episodes": lost,
        "attitude_rmse_deg": axes,
        "rate_rmse_deg_s": {k: 10.0 * v for k, v in axes.items()},
        "detection": {"centre_rms_px": 0.05},
    }
    limit = {"combined": error}
    return {"rows": dict.fromkeys(("ekf1", "ekf2", "so3"), row), "bound": {"attitude_deg": limit, "rate_deg_s": limit}}


def results():
    return {"26-0": ball(0.02), "26-1": ball(0.04, 2), "50-0": ball(0.015), "74-0": {"error": "too dark"}}


def tables(found):
    return [part for part in found.parts if isinstance(part, Table)]


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


def test_more_discs_are_seen_and_the_bound_sinks():
    few, many = with_discs(16, 0, 36), with_discs(60, 0, 36)
    assert many["rows"]["so3"]["mean_discs"] > 2.0 * few["rows"]["so3"]["mean_discs"]
    for quantity in ("attitude_deg", "rate_deg_s"):
        assert many["bound"][quantity]["combined"] < few["bound"][quantity]["combined"]
    assert many["rows"]["so3"]["tracked"] == 36


def test_table_20_is_that_of_the_first_layout():
    found = section(WHOLE, results())
    table = tables(found)[0]
    assert [row[0] for row in table.rows] == ["26", "", "", "", "50", "", "", "", "74", "", "", ""]
    assert table.rows[0][1:4] == ("thesis, EKF2", "4.9", "0.100")
    assert table.rows[1][1:4] == ("`ekf1`", "5.2", "0.0200")
    assert (table.rows[4][-1], table.rows[5][-1]) == ("0.624", "0.450")
    assert table.rows[11][2:] == ("failed",) * 7
    assert {len(row) for row in table.rows} == {len(table.head)} == {9}
    assert "74-0: too dark" in words(found)


def test_layouts_are_put_together_as_rms_and_failed_ones_are_counted():
    table = tables(section(WHOLE, {**results(), "50-1": {"error": "no target"}}))[1]
    assert [row[:2] for row in table.rows if row[0]] == [("26", "2"), ("50", "1 of 2 failed"), ("74", "1 of 1 failed")]
    together = np.sqrt(14.0 * (0.02**2 + 0.04**2) / 2.0)
    assert table.rows[0][3:5] == ("`ekf1`", f"{together:.4f}")
    assert table.rows[0][-1] == "2"
    assert table.rows[3][3:] == ("bound", f"{np.sqrt((0.02**2 + 0.04**2) / 2.0):.4f}", "0.03", "")
    assert table.rows[-1][2:] == ("–",) * 5


def test_the_length_of_the_films_is_said_where_it_is_known():
    ball_ = ball(0.02)
    ball_["rows"] = {name: {**row, "frames": 90} for name, row in ball_["rows"].items()}
    assert "films of 90 frames; the thesis' have 300" in words(section(WHOLE, {"26-0": ball_}))
    assert "frames;" not in words(section(WHOLE, results()))


def test_what_more_discs_bring_is_said_where_both_ends_are_there():
    assert "Error with 26 discs" not in words(section(WHOLE, results()))
    text = words(section(WHOLE, {**results(), "74-0": ball(0.01)}))
    gain = np.sqrt((0.02**2 + 0.04**2) / 2.0) / 0.01
    assert f"`so3` {gain:.2f}, the bound {gain:.2f}" in text
    assert "attitude: thesis 1.70" in text  # |0.100, 0.086, 0.122| over |0.040, 0.056, 0.080|


def test_the_figure_draws_where_a_filter_has_no_value(tmp_path):
    one = ball(0.05)
    one["rows"]["ekf1"] = {**one["rows"]["ekf1"], "attitude_rmse_deg": {"combined": None}}
    found = section(WHOLE, {**results(), "6-0": one})
    figure = next(part for part in found.parts if isinstance(part, Figure))
    assert all(path.stat().st_size > 5000 for path in save(figure, tmp_path))
    assert tables(found)[1].rows[0][3:5] == ("`ekf1`", "–")
    assert "Too few discs" not in words(section(WHOLE, results()))
    assert "6 discs (5.2 of them used per frame): `ekf1`." in words(found)
    assert section(WHOLE, {}).parts  # nothing was run: still a page


def test_jobs_are_all_balls_or_those_of_the_thesis():
    assert len({job.key for job in jobs(WHOLE)}) == len(count.COUNTS) * len(count.LAYOUTS)
    assert [job.key for job in jobs(Request(True, None))] == ["26-0", "50-0", "74-0"]
