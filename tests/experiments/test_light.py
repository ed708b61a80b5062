"""Noise and brightness: a tiny film, and pages made from given results, missing and failed ones too."""

from pathlib import Path

import numpy as np
import pytest

from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.light import _encoded, decoded, jobs, simulated
from spheremouse.experiments.report.light import section
from spheremouse.experiments.report.plot import save

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


def tables(found):
    return [part for part in found.parts if isinstance(part, Table)]


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


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


def test_tables_have_the_thesis_above_ours_and_say_what_failed():
    found = section(HERE, results())
    ours, far26 = tables(found)
    assert ours.rows[0] == ("-50", "thesis, EKF2", "1.20", "1.29", "1.62", "targets not found")
    assert ours.rows[3] == ("-50", "`so3`", "0.20", "0.30", "0.40", "0.45")
    assert far26.rows[3] == ("-50", "`so3`", "0.20", "0.30", "0.40", "failed")
    assert len(ours.rows) == 16
    text = words(found)
    assert "No camera pose was found at l = -50, σ_r = 15 on far26." in text
    assert "the rate error of `so3` is 0.45 °/s" in text
    assert "0.10 px at σ_r = 1 and to 0.30 px at 15" in text
    assert "`ekf2` 0.030, 0.010, 0.040° about x, y, z" in text
    assert "0.000, 0.050, 0.010°) grows to the middle and shrinks again, as there" in text
    thesis = np.sqrt(np.mean(np.square([1.20, 0.98, 1.06, 1.06])))
    assert f"{0.2 / thesis:.2f} at σ_r = 1" in text


def test_an_error_that_stays_is_not_said_to_shrink():
    given = results()
    for name in ("ekf2", "so3"):
        given["s1+50"]["cells"]["15"]["shown"]["series"][name] = {"t": [0.0, 0.1, 0.2], "error": [[0.01, 0, 0]] * 3}
    assert "has no such course" in words(section(HERE, given))
    given["s1+50"]["cells"]["15"]["shown"]["series"]["so3"]["error"] = [[0.01, 0, 0], [0.02, 0, 0], [0, 0.04, 0]]
    assert "grows to the end" in words(section(HERE, given))
    given["s1+50"]["cells"]["15"]["shown"]["series"]["so3"] = {"t": [], "error": []}
    assert "`so3` tracked nothing" in words(section(HERE, given))


def test_missing_and_failed_rows_are_said():
    found = section(AWAY, {"s1-50": {"error": "no memory"}})
    assert len(tables(found)) == 1
    assert tables(found)[0].rows[1][2:] == ("failed",) * 4
    assert tables(found)[0].rows[5][2:] == ("–",) * 4
    assert "s1-50: no memory" in words(found)
    assert "far26 was not at hand" in words(found)


def test_figures_draw_and_the_pictures_stay_out_of_the_numbers(tmp_path):
    found = section(HERE, results())
    figures = [part for part in found.parts if isinstance(part, Figure)]
    assert [f.name for f in figures] == ["light-rates", "light-picture", "light-attitude"]
    for figure in figures:
        assert all(path.stat().st_size > 3000 for path in save(figure, tmp_path))
    assert "shown" not in found.figures["s1+50"]["cells"]["15"]


def test_jobs_are_a_row_each():
    assert len(jobs(HERE)) == 8
    assert [job.key for job in jobs(AWAY)] == ["s1-50", "s1-25", "s1+25", "s1+50"]
    assert [job.key for job in jobs(Request(True, Path("sets")))] == ["s1-50", "s1+50"]
