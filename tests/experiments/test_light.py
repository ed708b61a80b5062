"""Noise and brightness: a tiny film, and pages made from given results, missing and failed ones too."""

from pathlib import Path

import numpy as np
import pytest
from experiments.kit.job import Request
from experiments.light import _encoded, decoded, jobs, simulated
from experiments.report.light import page
from experiments.report.page import said
from experiments.report.plot import save

HERE = Request(False, Path("sets"))
AWAY = Request(False, None)


def cell(rate, noise=0.1):
    row = {"rate_rmse_deg_s": {"combined": rate}, "detection": {"centre_rms_60_px": noise}}
    return {"rows": dict.fromkeys(("ekf1", "ekf2", "so3"), row), "bound": {"rate_deg_s": {"combined": 0.5 * rate}}}


def grid(level):
    return {"cells": {"1": cell(0.2), "5": cell(0.3), "10": cell(0.4), "15": cell(0.5 + 0.001 * level, 0.3)}}


def shown():
    t = [0.0, 0.1, 0.2]
    errors = {"t": t, "error": [[0.0, 0.0, 0.0], [0.03, 0.0, 0.04], [0.0, 0.01, 0.0]]}
    picture = _encoded(np.full((210, 280, 3), 90, np.uint8))
    return {
        "series": {"ekf2": errors, "so3": errors},
        "truth": {"t": t, "angles": [[x, -x, 2.0 * x] for x in t]},
        "bound": [0.0, 0.01, 0.012],
        "picture": {"frame": 1, "before": picture, "after": picture, "used": [[20.0, 30.0]]},
    }


def results():
    found = {f"{film}{level:+d}": grid(level) for film in ("s1", "far26") for level in (-50, -25, 25, 50)}
    found["s1+50"]["cells"]["15"]["shown"] = shown()
    found["far26-50"]["cells"]["15"] = {"error": "targets not found"}
    return found


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(f"**{title}")[2].partition("\n\n")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_noise_makes_centres_and_rates_worse_and_the_picture_shows_it():
    cells = simulated(50, [1, 15], 40)["cells"]
    quiet, loud = cells["1"]["rows"]["so3"], cells["15"]["rows"]["so3"]
    assert loud["detection"]["centre_rms_px"] > 1.5 * quiet["detection"]["centre_rms_px"]
    assert loud["rate_rmse_deg_s"]["combined"] > quiet["rate_rmse_deg_s"]["combined"]
    assert cells["15"]["bound"]["rate_deg_s"]["combined"] > cells["1"]["bound"]["rate_deg_s"]["combined"]
    assert "shown" not in cells["1"]
    there = cells["15"]["shown"]
    before, after = (decoded(there["picture"][name]).astype(float) for name in ("before", "after"))
    assert before.shape == (210, 280)
    assert np.median(after - before) == pytest.approx(50.0, abs=8.0)
    assert len(there["truth"]["t"]) == len(there["bound"]) == len(there["series"]["so3"]["t"]) == 40
    for u, v in there["picture"]["used"]:
        assert before[round(v), round(u)] < 80.0  # a disc is there


def test_tables_have_the_thesis_above_ours():
    found = said("light", page, results())
    ours, far26 = (rows(found.text, f"Rate RMSE, °/s, {film}") for film in ("S1, ours", "far26"))
    assert ours[0] == ["-50", "thesis, EKF2", "1.20", "1.29", "1.62", "–"]
    assert ours[3] == ["", "`so3`", "0.20", "0.30", "0.40", "0.45"]
    assert far26[3] == ["", "`so3`", "0.20", "0.30", "0.40", "–"]
    assert len(ours) == 16
    thesis = np.sqrt(np.mean(np.square([1.20, 0.98, 1.06, 1.06])))
    assert f"{0.2 / thesis:.2f} of them at σ_r = 1" in found.text
    assert "the rate error of `so3` is 0.45 °/s" in found.text
    grown = np.sqrt(np.mean(np.square([0.45, 0.475, 0.525, 0.55]))) / 0.2
    assert rows(found.text, "RMS over l")[0] == ["S1, ours", "0.10", "0.30", *[f"{grown:.1f}"] * 3]


def test_the_errors_of_the_worst_film_are_told_by_axis_and_by_thirds():
    found = said("light", page, results())
    table = rows(found.text, "Attitude errors")
    assert table[0] == ["`ekf2`", "0.030", "0.010", "0.040", "0.000", "0.050", "0.010"]
    assert "Ours is smaller. **Not borne out by this run:** It has no such course" in found.text
    given = results()
    for name in ("ekf2", "so3"):
        given["s1+50"]["cells"]["15"]["shown"]["series"][name] = {"t": [0.0, 0.1, 0.2], "error": [[0.01, 0, 0]] * 3}
    assert "Ours is smaller. It has no such course" in said("light", page, given).text


def test_a_pose_that_was_not_found_contradicts_the_page():
    given = results()
    assert "**Not borne out by this run:** The camera's pose" in said("light", page, given).text
    del given["far26-50"]
    assert "**Not borne out by this run:** The camera's pose" not in said("light", page, given).text


def test_what_is_missing_is_a_dash_and_far26_is_left_out():
    given = {"s1-25": grid(-25), "s1-50": {"error": "no memory"}, "s1+50": grid(50)}
    empty = {"t": [], "error": []}
    given["s1+50"]["cells"]["15"]["shown"] = {**shown(), "series": {"ekf2": empty, "so3": empty}}
    found = said("light", page, given)
    assert "- s1-50: no memory" in found.text
    table = rows(found.text, "Rate RMSE, °/s, S1, ours")
    assert table[1] == ["", "`ekf1`", "–", "–", "–", "–"]
    assert table[5][2] == "0.20"
    assert rows(found.text, "Attitude errors")[0] == ["`ekf2`", *["–"] * 6]
    assert "far26" not in found.text


def test_figures_draw(tmp_path):
    found = said("light", page, results())
    assert [drawing.name for drawing in found.drawings] == ["light-rates", "light-picture", "light-attitude"]
    for drawing in found.drawings:
        assert save(drawing, tmp_path).stat().st_size > 3000


def test_jobs_are_a_row_each():
    assert len(jobs(HERE)) == 8
    assert [job.key for job in jobs(AWAY)] == ["s1-50", "s1-25", "s1+25", "s1+50"]
    assert [job.key for job in jobs(Request(True, Path("sets")))] == ["s1-50", "s1+50"]
