"""The page of the hand-held ball from a tiny film, and from results that are missing or failed."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import wand
from experiments import wand_films as wand_experiments
from experiments.kit.job import Request
from experiments.report import wand as wand_module
from experiments.report.page import said
from experiments.report.plot import save
from experiments.report.wand_rows import Row
from experiments.wand_films import Film, Variant
from numpy.testing import assert_allclose

from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.settings import WandSettings

FILM = Film(
    "drive",
    "a short one",
    WandOptions(motion="hand", seconds=0.4, size=(320, 240)),
    (1,),
    (
        Variant("350, known start", WandSettings(particles=30), known=True),
        Variant("50, known start", WandSettings(particles=20), known=True),
        Variant("350, all as in the thesis", wand_experiments.thesis_settings(30), known=True),
    ),
)


@pytest.fixture(scope="module")
def results():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wand_experiments, "films", lambda quick: (FILM,))
        return {"drive-01": wand.film("drive-01", True)}


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    monkeypatch.setattr(wand_experiments, "films", lambda quick: (FILM,))


def table(text, title):
    """The cells under a title."""
    lines = text.partition(title)[2].strip().partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_errors_along_the_way_are_those_of_the_run(results):
    kept = results["drive-01"]["variants"]["350, known start"][0]
    frame, errors, sigma = wand_module._along(kept)
    assert_allclose(frame, np.arange(6))
    shift = 100.0 * (np.array(kept["position"]) - np.array(kept["true_position"]))
    assert_allclose(errors[:, :3], shift)
    assert np.all((errors[:, 3] >= 0.0) & (errors[:, 3] < 20.0))
    assert np.all(np.abs(shift) < 6.0 * sigma[:, :3])


def test_figures_are_drawn_where_there_is_something_to_draw(results, tmp_path):
    found = said("wand", wand_module.page, results)
    assert [drawing.name for drawing in found.drawings] == ["wand-particles", "wand-drive"]
    for drawing in found.drawings:
        assert save(drawing, tmp_path).stat().st_size > 3000
    assert said("wand", wand_module.page, {}).drawings == ()
    assert said("wand", wand_module.page, {"speeds": {}}).drawings == ()


def test_a_film_that_failed_is_told_and_the_others_are_rows(results):
    found = said("wand", wand_module.page, {**results, "drive-02": {"error": "no memory"}})
    assert "- drive-02: no memory" in found.text
    rows = table(found.text, "**Films and trackers**")
    assert [row[:3] for row in rows] == [
        ["drive: a short one", "350, known start", "1"],
        ["", "50, known start", "1"],
        ["", "350, all as in the thesis", "1"],
    ]
    numbers = wand_module.numbers({**results, "drive-02": {"error": "no memory"}})
    assert [(row["film"], row["runs"]) for row in numbers["rows"]] == [("drive", 1)] * 3


def test_a_shared_recording_has_rows_of_its_own(tmp_path):
    film = prepare_wand(WandOptions(motion="hand", seconds=0.4, size=(320, 240)), grzonka_ball())
    list(write_wand(tmp_path / "wand_drive", film))
    (job,) = [j for j in wand.jobs(Request(True, tmp_path)) if j.key.startswith("wand_drive")]
    result = job.work(**job.parameters)
    (kept,) = result["variants"]["350, known start"]
    assert kept["frames"] == 6
    assert len(kept["index"]) == 6
    text = said("wand", wand_module.page, {job.key: result}).text
    (row,) = table(text, "**Films and trackers**")
    assert row[:4] == ["wand_drive: the shared recording, 0.8 Hz", "350, known start", "1", "0"]
    asked = table(text, "are not judged.")
    assert any("shared recording" in row[0] and row[3] == "yes" for row in asked)


def row(variant, z, lost=0, runs=20, film="drive", anees=1.0):
    axes = {"x": 1.0, "y": 1.0, "z": z}
    figures = {"position_p95_mm": axes, "position_max_mm": axes, "rotation_p95_deg": 1.0, "rotation_max_deg": 2.0,
               "anees": {"position": anees, "rotation": 1.0}, "within_95": 0.9}  # fmt: skip
    return Row(replace(FILM, name=film), variant, runs, lost, runs, 1.0, figures)


ALONE = "350, drawn by the thesis' motion alone"


@pytest.mark.parametrize(("alone", "thesis", "doubts"), [(19, 20, 0), (0, 20, 1), (0, 0, 2)])
def test_what_makes_the_difference_is_told_from_the_rows(monkeypatch, alone, thesis, doubts):
    made = [row("350, known start", 20.0), row(ALONE, 900.0, alone), row("350, all as in the thesis", 950.0, thesis)]
    monkeypatch.setattr(wand_module, "rows", lambda results: made)
    found = said("wand", wand_module.page, {"speeds": {}})
    assert found.doubts == doubts
    assert table(found.text, "changes the one above**") == [
        ["ours", "0 of 20", "2.0"],
        ["with particles drawn by that motion alone and not towards the peaks", f"{alone} of 20", "90.0"],
        ["with its product of colour fields for a likelihood as well: all as in the thesis", f"{thesis} of 20", "95.0"],
    ]


def test_particles_stand_beside_the_thesis_own(monkeypatch):
    made = [row("50, known start", 21.0), row("50, all as in the thesis", 99.0, lost=20)]
    monkeypatch.setattr(wand_module, "rows", lambda results: made)
    speed = {"fps": 50.0, "mean_fps": 40.0, "p90_ms": 25.0}
    text = said("wand", wand_module.page, {"speeds": {"350 particles, whole frame": speed}}).text
    found = table(text, "of this one**")
    assert found[0] == ["50", "0.6", "–", "2 of 3", "0 of 20", "20 of 20", "–", "2.1"]
    assert found[1] == ["350", "0.71", "0.020", "none", "–", "–", "40 cm", "–"]
    assert table(text, "**Speed, one core**") == [["350 particles, whole frame", "50", "40", "25.0"]]


def test_an_absurd_anees_is_not_spelled_out():
    name = "ANEES position, rotation"
    assert wand_module._cells(row("50, known start", 21.0, anees=1.43e34))[name] == "> 1000  1"
    assert wand_module._cells(row("50, known start", 21.0, anees=832.0))[name] == "832  1"
