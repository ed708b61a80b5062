"""The grid of sigma_w and sigma_b: a tiny film, and pages made from given results, missing and failed ones too."""

from pathlib import Path

import pytest

from spheremouse.experiments import parameters
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.parameters import jobs, simulated
from spheremouse.experiments.report.parameters import apart, by_acceleration, by_ratio, section, spread
from spheremouse.experiments.report.plot import save

HERE = Request(False, Path("sets"))
AWAY = Request(False, None)
KEYS = [f"{w:g}/{b:g}" for w in parameters.SIGMA_W for b in parameters.SIGMA_B]


def errors(rate):
    return {
        "frames": 300,
        "tracked": 300,
        "lost_episodes": 6,
        "attitude_rmse_deg": {"combined": 0.1 * rate},
        "rate_rmse_deg_s": {"combined": rate},
        "surface_speed_rmse_mm_s": {"combined": 2.0 * rate},
        "surface_speed_r": {"combined": 1.0 - 0.01 * rate},
        "mean_discs": 5.5,
        "detection": {"centre_rms_px": 0.071},
        "trackball": {"r": 1.0 - 0.02 * rate, "lag_s": 0.09},
    }


def grid(factor=1.0):
    """A filter to which the ratio alone matters."""
    sigma_w = (*parameters.SIGMA_W, 10.0)
    cells = {f"{w:g}/{b:g}": errors(factor * (1.0 + (w / b) ** -0.5)) for w in sigma_w for b in parameters.SIGMA_B}
    return {
        "cells": cells,
        "so3": errors(0.234),
        "bound": {"attitude_deg": {"combined": 0.03}, "rate_deg_s": {"combined": 0.6}},
        "centre_rms_px": 0.071,
        "truth": {"trackball": {"r": 0.987, "lag_s": 0.09}},
        "exact": {
            key: errors(factor * x) for key, x in zip(KEYS, (x for row in parameters.RATE for x in row), strict=True)
        },
        "scaled": {f"{0.01 * k:g}/{0.1 * k:g}": errors(2.0 + 0.001 * k) for k in (1, 10, 100)},
        "published": {f"{w:g}": errors(factor * (3.0 + abs(w - 0.1))) for w in sigma_w},
    }


def tables(found):
    return [part for part in found.parts if isinstance(part, Table)]


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


def test_a_filter_that_weighs_right_beats_one_that_hardly_listens():
    result = simulated(60, False)
    assert result["published"] is None
    assert len(result["cells"]) == 15
    rate = {key: cell["rate_rmse_deg_s"]["combined"] for key, cell in result["cells"].items()}
    assert rate["0.001/10"] > 3.0 * rate["1/0.1"]
    assert result["so3"]["rate_rmse_deg_s"]["combined"] < rate["1/0.1"]
    alike = [result["scaled"][key]["rate_rmse_deg_s"]["combined"] for key in ("0.1/0.1", "1/1", "10/10")]
    assert max(alike) < 1.1 * min(alike)  # a filter knows no units: what is scaled as a whole says the same
    assert 0.0 < result["bound"]["attitude_deg"]["combined"] < 0.1


def test_spread_and_apart_look_within_the_groups_alone():
    values = {(0.1, 1.0): 2.0, (1.0, 10.0): 3.0, (1.0, 1.0): 10.0}
    assert spread(values, by_ratio) == pytest.approx(1.5)
    assert apart(values, by_ratio) == pytest.approx(1.0)
    assert spread(values, by_acceleration) == pytest.approx(10.0 / 3.0)
    assert spread({}, by_ratio) == 1.0


def test_tables_have_the_thesis_beside_ours_in_every_cell():
    found = section(HERE, {"r1": grid(), "s1": grid(), "far26": grid(2.0)})
    fourteen, _, _, rates, _, _, exact, published = tables(found)
    assert fourteen.rows[2][1:3] == ("0.962", "0.960")  # 1 - 0.02 (1 + 1)
    assert rates.head[:4] == ("σ_w, rad/s²", "σ_b 0.1 px: thesis", "σ_b 0.1 px: S1, ours", "σ_b 0.1 px: far26")
    assert rates.rows[2][:4] == ("0.1", "1.09", "2.00", "4.00")
    assert rates.rows[4][1] == "–"  # a row that the thesis does not have
    assert rates.rows[5][:4] == ("`so3`", "", "0.23", "0.23")
    assert published.rows[2] == ("0.1", "1.09", "2.00", "3.00", "4.00", "6.00")
    assert exact.rows[0][:4] == ("0.001", "5.42", "5.42", "10.84")
    assert {len(row) for table in tables(found) for row in table.rows} == {7, 10, 6}
    text = words(found)
    assert "differ by a factor of 1.0 at most" in text  # of this filter
    assert "3.4 and 1.5" in text  # of the thesis' rates on S1
    assert "by at most 0.15, cells with the same σ_w by up to 0.38" in text  # and of its correlations on R1
    assert "equal ratios agree within 1.05" in text  # 2.1 over 2.001
    assert "S1, ours: rates 1.00 (1.0 at most; with our radius " in text
    assert "far26: rates 2.00 (2.0 at most; with our radius " in text
    assert "0.987: a tracker can hardly agree better" in text
    assert "best at σ_w = 0.1, with centres good to 0.07 px and 5.5 discs per frame used (ours: at 10," in text
    assert "the more a filter gains by trusting them" in text  # 10 is above 0.1
    assert "Without noise: S1, ours 300 frames, far26 300 frames" in text


def test_nothing_is_said_of_cells_that_are_not_there():
    empty = grid()
    for cell in (*empty["cells"].values(), *empty["published"].values()):
        cell["lost_episodes"], cell["trackball"] = 0, {}
        cell["rate_rmse_deg_s"] = cell["attitude_rmse_deg"] = {"combined": None}
    text = words(section(AWAY, {"r1": empty, "s1": empty}))
    assert "Best of ours" not in text
    assert "of the 12 cells `ekf2` loses" not in text
    assert "Our rates go by" not in text
    assert "tracks nothing" in text
    assert "trusting them" not in text


def test_rates_that_do_not_go_by_the_ratio_are_not_said_to():
    other = grid()
    for key, cell in other["cells"].items():
        w, b = map(float, key.split("/"))
        cell["rate_rmse_deg_s"] = {"combined": 1.0 + w + 0.001 * b}
    assert "Our rates do not go by σ_w/σ_b alone" in words(section(AWAY, {"s1": other}))


def test_what_is_missing_is_left_out_and_what_failed_is_said(tmp_path):
    found = section(AWAY, {"s1": grid(), "r1": {"error": "PoseError: no target"}})
    assert all("far26" not in cell for table in tables(found) for cell in table.head)
    assert "failed" in tables(found)[0].rows[0]
    assert "r1: PoseError: no target" in words(found)
    assert "far26 was not at hand" in words(found)
    empty = section(HERE, {})
    assert tables(empty)[0].rows[0] == ("0.001", "0.645", "–", "0.594", "–", "0.678", "–")


def test_figures_draw_even_where_cells_have_no_value(tmp_path):
    lost = grid()
    lost["cells"]["0.001/10"]["rate_rmse_deg_s"]["combined"] = None
    lost["cells"]["0.001/10"]["trackball"] = {}
    found = section(AWAY, {"s1": lost, "r1": lost})
    figures = [part for part in found.parts if isinstance(part, Figure)]
    assert [f.name for f in figures] == ["parameters-r1", "parameters-s1", "parameters-exact"]
    for figure in figures:
        assert all(path.stat().st_size > 5000 for path in save(figure, tmp_path))


def test_jobs_need_the_datasets_for_far26_alone():
    assert [job.key for job in jobs(AWAY)] == ["r1", "s1"]
    assert [job.key for job in jobs(HERE)] == ["r1", "s1", "far26"]
    quick = jobs(Request(True, None))
    assert sum(job.cost for job in quick) < 0.3 * sum(job.cost for job in jobs(AWAY))
