"""Errors against the number of discs: a tiny film, and pages made from given results, missing and failed ones too."""

import numpy as np
from experiments import count
from experiments.count import jobs, with_discs
from experiments.kit.job import Request
from experiments.report.count import page
from experiments.report.page import said
from experiments.report.plot import save


def ball(error, lost=0):
    axes = {"x": error, "y": 2.0 * error, "z": 3.0 * error, "combined": np.sqrt(14.0) * error}
    row = {
        "frames": 300,
        "mean_discs": 5.2,
        "lost_episodes": lost,
        "attitude_rmse_deg": axes,
        "rate_rmse_deg_s": {k: 10.0 * v for k, v in axes.items()},
        "detection": {"centre_rms_px": 0.05},
    }
    limit = {"combined": error}
    return {"rows": dict.fromkeys(("ekf1", "ekf2", "so3"), row), "bound": {"attitude_deg": limit, "rate_deg_s": limit}}


def test_more_discs_are_seen_and_the_bound_sinks():
    few, many = with_discs(16, 0, 36), with_discs(60, 0, 36)
    assert many["rows"]["so3"]["mean_discs"] > 2.0 * few["rows"]["so3"]["mean_discs"]
    for quantity in ("attitude_deg", "rate_deg_s"):
        assert many["bound"][quantity]["combined"] < few["bound"][quantity]["combined"]
    assert many["rows"]["so3"]["tracked"] == 36


RESULTS = {"26-0": ball(0.02), "26-1": ball(0.04, 2), "50-0": ball(0.015), "74-0": {"error": "too dark"}}


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(title)[2].strip().partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_table_20_is_that_of_the_first_layout():
    text = said("count", page, RESULTS).text
    table = rows(text, "(table 20)**")
    assert [row[0] for row in table] == ["26", "", "", "", "50", "", "", "", "74"]
    assert table[0][1:4] == ["thesis, EKF2", "4.9", "0.100"]
    assert table[1][1:4] == ["`ekf1`", "5.2", "0.0200"]
    assert (table[4][-1], table[5][-1]) == ("0.624", "0.450")
    assert "- 74-0: too dark" in text


def test_layouts_are_put_together_as_rms():
    table = rows(said("count", page, RESULTS).text, "over the films**")
    together = np.sqrt(14.0 * (0.02**2 + 0.04**2) / 2.0)
    assert table[0] == ["26", "2", "5.2", "`ekf1`", f"{together:.4f}", f"{10 * together:.2f}", "2"]
    assert table[3][3:] == ["bound", f"{np.sqrt((0.02**2 + 0.04**2) / 2.0):.4f}", "0.03", "–"]
    assert [row[0] for row in table] == ["26", "", "", "", "50", "", "", ""]


def test_what_more_discs_bring_and_what_few_do_not_is_known_where_there_are_such_balls():
    table = rows(said("count", page, RESULTS).text, "It is:")
    assert table[0] == ["attitude", "1.70", *["–"] * 4]
    balls = {"10-0": ball(2.0), "16-0": ball(0.1), **RESULTS, "74-0": ball(0.01)}
    whole = said("count", page, balls)
    gain = np.sqrt((0.02**2 + 0.04**2) / 2.0) / 0.01
    assert rows(whole.text, "It is:")[0] == ["attitude", "1.70", *[f"{gain:.2f}"] * 4]
    assert whole.doubts == 0
    assert said("count", page, RESULTS).doubts == 1
    balls["16-0"] = ball(1.0)
    assert said("count", page, balls).doubts == 1


def test_nothing_but_failures_is_a_page_as_well():
    failed = {"26-0": {"error": "too dark"}}
    assert "- 26-0: too dark" in said("count", page, failed).text


def test_the_figure_draws_where_a_filter_has_no_value(tmp_path):
    one = ball(0.05)
    one["rows"]["ekf1"] = {**one["rows"]["ekf1"], "attitude_rmse_deg": {"combined": None}}
    found = said("count", page, {**RESULTS, "6-0": one})
    assert save(found.drawings[0], tmp_path).stat().st_size > 5000
    assert ["6", "1", "5.2", "`ekf1`", "–", "1.87", "0"] in rows(found.text, "over the films**")


def test_jobs_are_all_balls_or_those_of_the_thesis():
    assert len({job.key for job in jobs(Request(False, None))}) == len(count.COUNTS) * len(count.LAYOUTS)
    assert [job.key for job in jobs(Request(True, None))] == ["26-0", "50-0", "74-0"]
