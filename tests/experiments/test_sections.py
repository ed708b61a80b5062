"""Results become a section: tables, plots with their numbers, and failures."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from experiments import renderer, wand
from experiments.kit.job import Request
from experiments.kit.render import Plot, Table, by, markdown, number, rms, tidy, write_section
from scipy.special import ndtr

from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.wand.ball import grzonka_ball


def rendered():
    """A result of `renderer`, which needs the shared recording: the edges are error functions."""
    at = np.arange(-2.45, 2.5, 0.1)
    edges = {name: [(2.0 * ndtr(at / s)).tolist(), [2.0] * 50] for name, s in (
        ("ours", 0.3), ("Blender", 0.4), ("Blender, linear light", 0.35))}  # fmt: skip
    rows = [[area, 9.0, 9.0, 9.01, 9.0, 0.03, 9.02, 9.0, 0.04] for area in (80.0, 20.0)]
    return {"frames": 3, "rows": rows, "geometry": [1e-4, 2e-4, 3e-3], "edges": edges}


def test_the_comparison_of_renderers_has_a_section_with_its_figures(tmp_path):
    """`make nightly` runs the other experiments quickly, each with its section."""
    write_section(tmp_path, "renderer", renderer, {"far26-0": rendered(), "other": {"error": "too dark"}}, "")
    text = (tmp_path / "renderer.md").read_text()
    captions = [part.caption for part in renderer.section({"far26-0": rendered()}) if not part.rows.empty]
    assert captions
    assert all(caption in text for caption in captions)
    files = {path.name for path in tmp_path.iterdir()}
    linked = {link.partition(")")[0] for link in text.split("](experiments/")[1:]}
    assert linked == files - {"renderer.md"}


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
