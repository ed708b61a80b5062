"""The page of the hand-held ball from a tiny film, and from results that are missing or failed."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from spheremouse import wand_experiments
from spheremouse.experiments import wand
from spheremouse.experiments.experiment import Figure, Request, Table
from spheremouse.experiments.plot import save
from spheremouse.simulate.wand import WandOptions
from spheremouse.wand.track import WandSettings
from spheremouse.wand_experiments import Film, Variant

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
    frame, errors, sigma = wand._along(kept)
    assert_allclose(frame, np.arange(6))
    shift = 100.0 * (np.array(kept["position"]) - np.array(kept["true_position"]))
    assert_allclose(errors[:, :3], shift)
    assert np.all((errors[:, 3] >= 0.0) & (errors[:, 3] < 20.0))
    assert np.all(np.abs(shift) < 6.0 * sigma[:, :3])


def test_figures_are_drawn_where_there_is_something_to_draw(results, tmp_path):
    section = wand.section(Request(True, None), results)
    assert [f.name for f in figures(section)] == ["wand-particles", "wand-drive"]
    for figure in figures(section):
        assert all(path.stat().st_size > 3000 for path in save(figure, tmp_path))
    assert figures(wand.section(Request(True, None), {})) == []


def test_a_film_that_failed_is_a_row_that_says_so(results, monkeypatch):
    found = wand.section(Request(True, None), {"drive-01": {"error": "no memory"}})
    table = [part for part in found.parts if isinstance(part, Table)][1]
    assert table.rows[0][3] == "failed: see below"
    assert "- drive-01: no memory" in found.parts[-1]
    assert figures(found) == []
    lost = replace(FILM, seeds=(1, 2))
    monkeypatch.setattr(wand_experiments, "films", lambda quick: (lost,))
    found = wand.section(Request(True, None), {**results, "drive-02": {"error": "no memory"}})
    assert "(1 failed)" in [part for part in found.parts if isinstance(part, Table)][1].rows[0][0]
