"""Every experiment runs with its tiny size, and any part of its results becomes a section."""

import json
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from experiments import NAMES, wand, wand_films
from experiments.kit.job import Request
from experiments.kit.render import Plot, Table, by, markdown, number, rms, tidy, write_section
from scipy.special import ndtr

from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.settings import WandSettings


def rendered():
    """A result of `renderer`, which needs the shared recording: the edges are error functions."""
    at = np.arange(-2.45, 2.5, 0.1)
    edges = {name: [(2.0 * ndtr(at / s)).tolist(), [2.0] * 50] for name, s in (
        ("ours", 0.3), ("Blender", 0.4), ("Blender, linear light", 0.35))}  # fmt: skip
    rows = [[area, 9.0, 9.0, 9.01, 9.0, 0.03, 9.02, 9.0, 0.04] for area in (80.0, 20.0)]
    return {"frames": 3, "rows": rows, "geometry": [1e-4, 2e-4, 3e-3], "edges": edges}


TINY = {  # by experiment: keys of jobs, their functions and parameters
    "poses": {"far-0": ("filmed", "far", 0)},
    "surface": {"points": ("points_of_table_13",), "area": ("areas", 500)},
    "parameters": {"s1": ("compared", None, 10)},
    "filters": {"s1": ("compared", None, 30), "r1": ("play", 3.2, 1.0, False)},
    "count": {"26-0": ("with_discs", 26, 0, 20)},
    "near_far": {"far-0": ("followed", "far", 0, 0.5)},
    "light": {"s1+50": ("graded", None, 50, [15], 15)},
    "viewing": {"plain-1": ("with_film", 1, 0.4, {}), "readout-30-1": ("with_film", 1, 0.4, {"readout": 0.03})},
    "mistakes": {"lens-0.1-1": ("with_mistakes", 1, 0.6, {"lens": ([0.1], 1)}, 0.1)},
    "discs": {"size-20-0": ("of_size", 20, 0, 20), "hands-two_large-0": ("with_hands", "two large", 0, 36)},
    "targets": {"camera-0": ("filmed", 0, [4], [14, 36])},
    "places": {
        "directions-0": ("mapped", [[0, 0, 2.35, 640.0], [0, 60, 2.35, 640.0]], 1, 8, 12, 1),
    },
    "limits": {"speed-15-0": ("speeds", 15.0, 0)},
    "covers": {"cover-16-0": ("covered", 16, 0, ["closing in"]), "again-15-0": ("found_again", 15.0, 0)},
    "pointer": {"play-15-0": ("played", 15.0, 0, 4.0), "stop-30": ("stopped", 30.0, 1)},
    "wand": {"drive-01": ("film", "drive-01", True)},
}  # fmt: skip
FILM = wand_films.Film(
    "drive", "a short one", WandOptions(motion="hand", seconds=0.4, size=(320, 240)), (1,), (
        wand_films.Variant("350, known start", WandSettings(particles=30), known=True),
        wand_films.Variant("350, all as in the thesis", wand_films.thesis_settings(30), known=True),
    ),
)  # fmt: skip


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    monkeypatch.setattr(wand_films, "films", lambda quick: (FILM,))


@pytest.mark.parametrize("name", NAMES)
def test_every_experiment_runs_and_renders(name, tmp_path):
    module = import_module(f"experiments.{name}")
    work = {key: (getattr(module, function), parameters) for key, (function, *parameters) in TINY.get(name, {}).items()}
    results = {key: function(*parameters) for key, (function, parameters) in work.items()} or {"far26-0": rendered()}
    results = json.loads(json.dumps(results))
    for key in results:  # an interrupted run has a section as well
        write_section(tmp_path, name, module, {key: results[key], "other": {"error": "too dark"}}, "")
    write_section(tmp_path, name, module, results, "")
    text = (tmp_path / f"{name}.md").read_text()
    assert text.startswith(f"## {module.TITLE}\n\n")
    parts = module.section(results)
    captions = [part.caption for part in parts if not part.rows.empty]
    assert captions
    assert all(caption in text for caption in captions)
    files = {path.name for path in tmp_path.iterdir()}
    linked = {link.partition(")")[0] for link in text.split("](experiments/")[1:]}
    assert linked == files - {f"{name}.md"}


ROWS = pd.DataFrame({"discs": [26, 26, 50], "filter": ["so3", "thesis", "so3"], "error, °": [0.01234, 0.1, np.nan]})


@pytest.fixture
def written(tmp_path):

    def write(parts, results):
        module = SimpleNamespace(TITLE="Title", __doc__="One\nline.\n\nMore.", section=lambda good: parts)
        write_section(tmp_path, "it", module, results, "Made by a test.")
        return (tmp_path / "it.md").read_text()

    return write


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0123456, "0.0123"), (5.0, "5"), (12345.6, "12346"), (999.7, "1000"), (-0.5, "-0.5"), (7, "7"), (np.nan, "–"),
     (None, "–"), (np.inf, "inf"), (True, "True"), ("as it is", "as it is")],
)  # fmt: skip
def test_numbers_have_three_digits_and_what_is_not_known_is_a_dash(value, shown):
    assert number(value) == shown


def test_a_table_repeats_no_value_of_a_merged_column_and_keeps_bars_in_their_cells():
    rows = ROWS.rename(columns={"filter": "a|b"})
    assert markdown(Table("x", rows, ["discs"], {"error, °": 4})).splitlines() == [
        "| discs | a\\|b | error, ° |", "| --- | --- | --- |", "| 26 | so3 | 0.0123 |", "|  | thesis | 0.1000 |",
        "| 50 | so3 | – |",
    ]  # fmt: skip


def test_groups_keep_their_order_and_an_unknown_value_makes_the_rms_unknown():
    rows = tidy(
        [{"k": "b", "x": {"y": 3.0}}, {"k": "a", "x": {"y": None}}, {"k": "b", "x": {"y": 4.0}}], {"k": "k", "x.y": "v"}
    )
    found = by(rows, ["k"], {"v": rms})
    assert found["k"].tolist() == ["b", "a"]
    assert found["v"].iloc[0] == pytest.approx(np.sqrt(12.5))
    assert np.isnan(found["v"].iloc[1])


def test_a_section_has_its_parts_their_numbers_and_what_failed(written, tmp_path):
    plot = Plot("lines", "Errors.", ROWS, "discs", ["error, °"], "filter", log="xy", levels={"limit": 0.05})
    parts = [Table("Caption", ROWS), plot]
    text = written(parts, {"a": {"x": 1}, "b": {"error": "too dark"}})
    assert text.startswith("## Title\n\nOne line.\n\nMore.\n\nMade by a test.\n\n**Caption**\n\n| discs |")
    assert "![Errors.](experiments/lines.svg)\n\n[Numbers](experiments/lines.csv)" in text
    assert text.endswith("Failed:\n\n- b: too dark\n")
    for name in ("it-0", "lines"):
        pd.testing.assert_frame_equal(pd.read_csv(tmp_path / f"{name}.csv"), ROWS)
    figure = (tmp_path / "lines.svg").read_bytes()
    written(parts, {"a": {"x": 1}})
    assert (tmp_path / "lines.svg").read_bytes() == figure


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
