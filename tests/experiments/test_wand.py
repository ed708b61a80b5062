"""The hand-held ball: a tiny film, and what is asked of it."""

import pytest
from experiments import wand
from experiments import wand_films as wand_experiments
from experiments.kit.job import Request
from experiments.wand_films import Film, Variant

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


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    monkeypatch.setattr(wand_experiments, "films", lambda quick: (FILM,))


def test_a_shared_recording_has_rows_of_its_own(tmp_path):
    film = prepare_wand(WandOptions(motion="hand", seconds=0.4, size=(320, 240)), grzonka_ball())
    list(write_wand(tmp_path / "wand_drive", film))
    (job,) = [j for j in wand.jobs(Request(True, tmp_path)) if j.key.startswith("wand_drive")]
    result = job.work(**job.parameters)
    (kept,) = result["variants"]["350, known start"]
    assert kept["frames"] == 6
    assert len(kept["index"]) == 6
    (row,) = wand.rows({job.key: result})
    assert (row.film.name, row.variant, row.runs, row.lost) == ("wand_drive", "350, known start", 1, 0)
