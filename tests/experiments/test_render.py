"""The renderer of sections: tables, figures, failures."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from experiments.kit.render import Plot, Table, by, markdown, number, rms, tidy, write_section

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
