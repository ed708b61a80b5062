"""The page: its front, what a template gets, and how claims and failures stand in it."""

import pytest
from experiments.report import page as module
from experiments.report.page import Page, Said, fixed, said, table, without, write_report
from jinja2 import DictLoader, UndefinedError

SECTION = {"x": Said("## Title\n\nwords\n")}


def front(tmp_path, command):
    return write_report(tmp_path, SECTION, {"x": {}}, command)[0].read_text().partition("(x)=")[0]


def test_a_quick_run_is_not_to_be_quoted(tmp_path):
    assert "not to be quoted" in front(tmp_path, "spheremouse experiments --quick --out DIR")
    assert "not to be quoted" not in front(tmp_path, "spheremouse experiments --out quick")


def test_films_bound_and_dashes_are_explained_before_the_first_section(tmp_path):
    text = front(tmp_path, "x")
    for word in ("R1", "S1", "S4", "far26", "values below it occur", "– stands where there is no value"):
        assert word in text


def test_bars_in_a_cell_do_not_end_it():
    assert table(["a|b"], [["c"]]) == "| a\\|b |\n| --- |\n| c |"


@pytest.fixture
def template(monkeypatch):
    """(text) -> the section that a template of this text gives, of results and the values of their page."""

    def call(text, results, page=lambda found: Page({"found": found})):
        monkeypatch.setattr(module._TEMPLATES, "loader", loader := DictLoader({"it.md.jinja": text}))
        monkeypatch.setattr(module, "_LOADER", loader)
        return said("it", page, results)

    return call


def test_a_page_is_of_what_did_not_fail_and_says_what_did(template):
    text = "## Title\n\n{{ found.a.x | fixed(1) }}\n"
    results = {"a": {"x": 0.25}, "b": {"error": "too dark"}}
    assert template(text, results).text == "## Title\n\n0.2\n\nFailed:\n\n- b: too dark\n"
    assert template(text, {"b": {"error": "too dark"}}).text == "## Title\n\nFailed:\n\n- b: too dark\n"


def test_where_nothing_was_measured_the_page_says_what_to_give(template):
    assert template("## Title\n\n{{ found.a.x }}\n", {}).text == (
        "## Title\n\nNothing was measured: the reference recordings were not at hand (`--datasets`).\n"
    )


def test_a_claim_that_the_numbers_do_not_bear_out_is_marked_and_counted(template):
    text = "{{ shown(found.a.x < 1) }}Small. {{ shown(found.a.x > 1) }}Large."
    for x, expected in (
        (0.5, "Small. **Not borne out by this run:** Large."),
        (2.0, "**Not borne out by this run:** Small. Large."),
    ):
        made = template(text, {"a": {"x": x}})
        assert (made.text.strip(), made.doubts) == (expected, 1)
    assert template(text, {"a": {"x": float("nan")}}).doubts == 2  # what is not known bears nothing out


def test_a_name_that_a_page_does_not_give_is_an_error(template):
    with pytest.raises(UndefinedError):
        template("{{ other }}", {"a": {}})


def test_a_number_that_is_not_known_is_a_dash():
    assert [fixed(x, 1) for x in (0.25, float("nan"), None)] == ["0.2", "–", "–"]
    assert fixed(0.25, 0, 100.0) == "25"


def test_what_figures_alone_need_stays_out_of_the_numbers():
    tree = {"a": {"series": [1], "x": 1.0}, "b": [{"series": 2, "y": {"z": 3}}]}
    assert without(tree, ("series",)) == {"a": {"x": 1.0}, "b": [{"y": {"z": 3}}]}
    assert without(tree, ()) == tree
