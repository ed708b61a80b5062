"""The grid of sigma_w and sigma_b: a tiny film, and pages made from given results, missing and failed ones too."""

from pathlib import Path

from experiments import parameters
from experiments.kit.job import Request
from experiments.parameters import jobs, simulated
from experiments.report.page import said
from experiments.report.parameters import page
from experiments.report.plot import save

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
            key: errors(factor * x)
            for key, x in zip(KEYS, (x for row in parameters.THESIS["rate"] for x in row), strict=True)
        },
        "scaled": {f"{0.01 * k:g}/{0.1 * k:g}": errors(2.0 + 0.001 * k) for k in (1, 10, 100)},
        "published": {f"{w:g}": errors(factor * (3.0 + abs(w - 0.1))) for w in sigma_w},
    }


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(f"**{title}")[2].partition("\n\n")[2].partition("\n\n")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


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


def test_tables_have_the_thesis_beside_ours_in_every_cell():
    whole = said("parameters", page, {"r1": grid(), "s1": grid(), "far26": grid(2.0)})
    assert rows(whole.text, "Correlation with the trackball")[4][1:3] == ["0.962", "0.960"]  # 1 - 0.02 (1 + 1)
    head, _, *rates = rows(whole.text, "RMSE of the rates, °/s, S1")
    assert head[:4] == ["σ_w, rad/s²", "σ_b 0.1 px: thesis", "σ_b 0.1 px: S1, ours", "σ_b 0.1 px: far26"]
    assert rates[2][:4] == ["0.1", "1.09", "2.00", "4.00"]
    assert rates[4][:2] == ["10", "–"]  # a row that the thesis does not have
    assert rates[5][:4] == ["`so3`", "–", "0.23", "0.23"]
    assert rows(whole.text, "RMSE of the rates, °/s, with our")[4] == ["0.1", "1.09", "2.00", "3.00", "4.00", "6.00"]
    assert rows(whole.text, "RMSE of the rates, °/s, `ekf2` with an exact")[2][:4] == ["0.001", "5.42", "5.42", "10.84"]


def test_what_is_said_of_the_grid_is_computed_from_its_cells():
    whole = said("parameters", page, {"r1": grid(), "s1": grid(), "far26": grid(2.0)})
    text = whole.text
    assert "that of σ_w = 10 rad/s² and σ_b = 0.1 px, with 0.978 (thesis" in text  # 1 - 0.02 (1 + 0.1)
    assert "with the same σ_w/σ_b they differ by a factor of 1.0 at most" in text  # of this filter
    assert f"with the same σ_w by up to {101.0 / 11.0:.0f}; attitudes" in text  # 0.001 over 10 and over 0.1
    assert "equal ratios agree within 1.05" in text  # 2.1 over 2.001
    assert "In 12 of the 12 cells `ekf2` loses the ball five times or more" in text
    s1, usual, far26 = rows(text, "Factors between")[2:5]
    assert s1[:4] == ["S1, ours", "0.001 mm", "1.00", "1.0"]
    assert far26[:4] == ["far26", "0.001 mm", "2.00", "2.0"]
    assert (usual[1], usual[-2]) == ("0.1 mm", "12")
    best = rows(text, "Where the rates are best")
    assert best[2] == ["thesis", "published detector", "0.1", "–", "4.9"]
    assert best[3:5] == [
        ["S1, ours", "our detector", "10", "0.07", "5.5"],
        ["", "published detector", "0.1", "0.07", "5.5"],
    ]
    assert "run:** Our rates" not in text
    assert "run:** The better the centres" not in text
    assert "run:** A tracker can hardly agree better" in text  # than 0.987: `so3` does here


def test_claims_that_the_cells_contradict_are_marked():
    other = grid()
    for key, cell in other["cells"].items():
        w, b = map(float, key.split("/"))
        cell["rate_rmse_deg_s"] = {"combined": 1.0 + w + 0.001 * b}
    text = said("parameters", page, {"s1": other}).text
    assert "**Not borne out by this run:** Our rates on S1 depend on σ_w/σ_b" in text
    assert "**Not borne out by this run:** The better the centres" in text  # 0.001 is below 0.1


def test_what_is_missing_is_a_dash_and_far26_is_left_out(tmp_path):
    empty = grid()
    for cell in (*empty["cells"].values(), *empty["published"].values()):
        cell["lost_episodes"], cell["trackball"] = 0, {}
        cell["rate_rmse_deg_s"] = cell["attitude_rmse_deg"] = {"combined": None}
    empty |= {"published": None, "bound": None}
    found = said("parameters", page, {"s1": empty, "r1": {"error": "PoseError: no target"}})
    assert "- r1: PoseError: no target" in found.text
    assert rows(found.text, "Correlation with the trackball")[2][1:3] == ["0.645", "–"]
    assert rows(found.text, "RMSE of the rates, °/s, with our")[2] == ["0.001", "5.42", "–", "–"]
    assert rows(found.text, "Where the rates are best")[3] == ["S1, ours", "our detector", "–", "–", "–"]
    assert "far26" not in found.text
    assert [drawing.name for drawing in found.drawings] == ["parameters-s1", "parameters-exact"]


def test_figures_draw_even_where_cells_have_no_value(tmp_path):
    lost = grid()
    lost["cells"]["0.001/10"]["rate_rmse_deg_s"] = {"combined": None}
    lost["cells"]["0.001/10"]["trackball"] = {}
    found = said("parameters", page, {"s1": lost, "r1": {**lost, "bound": None}})
    assert [drawing.name for drawing in found.drawings] == ["parameters-r1", "parameters-s1", "parameters-exact"]
    for drawing in found.drawings:
        assert save(drawing, tmp_path).stat().st_size > 5000


def test_jobs_need_the_datasets_for_far26_alone():
    assert [job.key for job in jobs(AWAY)] == ["r1", "s1"]
    assert [job.key for job in jobs(HERE)] == ["r1", "s1", "far26"]
    quick = jobs(Request(True, None))
    assert sum(job.cost for job in quick) < 0.3 * sum(job.cost for job in jobs(AWAY))
