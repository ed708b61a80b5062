"""The page: what a reader is told before the sections, and how failures stand in it."""

from spheremouse.experiments.kit.job import Section, Table
from spheremouse.experiments.report.page import write_report

SECTION = {"x": ("Title", Section(("words", Table(("a|b",), (("–",),)))))}


def page(tmp_path, command):
    return write_report(tmp_path, SECTION, command)[0].read_text()


def test_a_quick_run_is_not_to_be_quoted(tmp_path):
    assert "not to be quoted" in page(tmp_path, "spheremouse experiments --quick --out DIR")
    assert "not to be quoted" not in page(tmp_path, "spheremouse experiments --out quick")


def test_films_bound_and_dashes_are_explained_before_the_first_section(tmp_path):
    front = page(tmp_path, "x").partition("(x)=")[0]
    for word in ("R1", "S1", "S4", "far26", "values below it occur", "– stands where there is no value"):
        assert word in front


def test_bars_in_a_cell_do_not_end_it(tmp_path):
    assert "| a\\|b |" in page(tmp_path, "x")
