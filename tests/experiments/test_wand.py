"""The page of the hand-held ball from a tiny film, and from results that are missing or failed."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from spheremouse.experiments import wand
from spheremouse.experiments import wand_films as wand_experiments
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.report import wand as wand_module
from spheremouse.experiments.report.plot import save
from spheremouse.experiments.wand_films import Film, Variant
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


def figures(section):
    return [part for part in section.parts if isinstance(part, Figure)]


def test_errors_along_the_way_are_those_of_the_run(results):
    kept = results["drive-01"]["variants"]["350, known start"][0]
    frame, errors, sigma = wand_module._along(kept)
    assert_allclose(frame, np.arange(6))
    shift = 100.0 * (np.array(kept["position"]) - np.array(kept["true_position"]))
    assert_allclose(errors[:, :3], shift)
    assert np.all((errors[:, 3] >= 0.0) & (errors[:, 3] < 20.0))
    assert np.all(np.abs(shift) < 6.0 * sigma[:, :3])


def test_figures_are_drawn_where_there_is_something_to_draw(results, tmp_path):
    section = wand_module.section(Request(True, None), results)
    assert [f.name for f in figures(section)] == ["wand-particles", "wand-drive"]
    for figure in figures(section):
        assert all(path.stat().st_size > 3000 for path in save(figure, tmp_path))
    assert figures(wand_module.section(Request(True, None), {})) == []


def test_a_film_that_failed_is_a_row_that_says_so(results, monkeypatch):
    found = wand_module.section(Request(True, None), {"drive-01": {"error": "no memory"}})
    table = next(part for part in found.parts if isinstance(part, Table) and part.title.startswith("Films"))
    assert table.rows[0][3] == "failed: see below"
    assert "- drive-01: no memory" in found.parts[-1]
    assert figures(found) == []
    lost = replace(FILM, seeds=(1, 2))
    monkeypatch.setattr(wand_experiments, "films", lambda quick: (lost,))
    found = wand_module.section(Request(True, None), {**results, "drive-02": {"error": "no memory"}})
    table = next(part for part in found.parts if isinstance(part, Table) and part.title.startswith("Films"))
    assert "(1 failed)" in table.rows[0][0]
    assert [row[0] for row in table.rows[1:]] == ["", ""]  # the same film


def test_a_shared_recording_has_rows_of_its_own(tmp_path):
    film = prepare_wand(WandOptions(motion="hand", seconds=0.4, size=(320, 240)), grzonka_ball())
    list(write_wand(tmp_path / "wand_drive", film))
    (job,) = [j for j in wand.jobs(Request(True, tmp_path)) if j.key.startswith("wand_drive")]
    result = job.work(**job.parameters)
    (kept,) = result["variants"]["350, known start"]
    assert kept["frames"] == 6
    assert len(kept["index"]) == 6
    section = wand_module.section(Request(True, tmp_path), {job.key: result})
    films = next(part for part in section.parts if isinstance(part, Table) and part.title.startswith("Films"))
    assert films.rows[-1][:4] == ("wand_drive: the shared recording, 0.8 Hz", "350, known start", "1", "0")
    assert any("shared recording" in row[0] and row[3] == "yes" for row in section.parts[1].rows)
    assert all("shared recording" not in row[0] for row in wand_module.section(Request(True, None), {}).parts[1].rows)


def row(variant, z, lost=0, runs=20, film="drive", anees=1.0):
    axes = {"x": 1.0, "y": 1.0, "z": z}
    figures = {"position_p95_mm": axes, "position_max_mm": axes, "rotation_p95_deg": 1.0, "rotation_max_deg": 2.0,
               "anees": {"position": anees, "rotation": 1.0}, "within_95": 0.9}  # fmt: skip
    return wand_experiments.Row(replace(FILM, name=film), variant, runs, lost, runs, 1.0, figures)


def test_what_makes_the_difference_is_told_from_the_rows():
    table = [
        row("350, known start", 20.0),
        row("350, without the outline", 40.0),
        row("5000, all as in the thesis", 900),
    ]
    text = wand_module._differs(table)
    assert "ours 0 of 20 lost, z 2.0 cm" in text
    assert "without the outline of the ball 0 of 20 lose the ball, z 4.0 cm." in text
    assert "0 of 20 are lost, and z is off by 90.0 cm (the thesis, with 350: up to 40 cm)" in text
    assert "62°" not in text
    alone = row("350, drawn by the thesis' motion alone", 900.0, lost=19)
    assert "by up to 62° from one to the next" in wand_module._differs([*table, alone])
    assert wand_module._differs([]) == ""


def test_particles_stand_beside_the_thesis_own():
    table = [row("50, known start", 21.0), row("50, all as in the thesis", 99.0, lost=20)]
    found = wand_module._particles(table, {"350 particles, whole frame": {"fps": 50.0}})
    assert found.rows[0] == ("50", "0.6", "–", "2 of 3", "0 of 20", "20 of 20", "–", "2.1 cm")
    assert found.rows[1] == ("350", "0.71", "0.020", "none", "–", "–", "40 cm", "–")
    assert {len(r) for r in found.rows} == {len(found.head)}


def test_an_absurd_anees_is_not_spelled_out():
    assert wand_module._cells(row("50, known start", 21.0, anees=1.43e34))[9] == "> 1000  1"
    assert wand_module._cells(row("50, known start", 21.0, anees=832.0))[9] == "832  1"


def test_words_of_the_tables_are_explained(results):
    text = wand_module.section(Request(True, None), results).parts[0]
    for word in ("*lost*", "*Tracked*", "*Found in 5*", "ANEES", "*known start*", "*Without the outline*"):
        assert word in text
