"""The pages and figures of reports."""

import re

import pytest
from elements import Elements
from markupsafe import Markup

from spheremouse.files.report.page import page, render
from spheremouse.files.report.style import round_number, styled

HOSTILE = """<i onclick="x">'&amp;' {{ 7 * 7 }} </script></style>"""


def every_block():
    return render("tests.files.report", "every_block.html", words=HOSTILE, data=b"")


def test_hostile_words_are_words_and_backticks_are_code():
    found = Elements(page(HOSTILE, HOSTILE, every_block(), HOSTILE))
    assert found.words.count(HOSTILE) == 3 + 1 + 2 + 1 + 4
    assert {"i", "script"}.isdisjoint(found.tags)
    assert HOSTILE in found.values  # for a screen reader
    assert "<code>a&lt;b</code> &amp; <code>c</code>" in every_block()


def test_a_handout_names_its_paper_and_a_report_none():
    handout, report = page("t", "", Markup(), paper="A4"), page("t", "", Markup())
    assert '<html lang="en" class="handout">' in handout
    assert re.search(r"@page \{ size: A4; \}", handout)
    assert '<html lang="en">' in report
    assert "size: A4" not in report
    assert "Undefined" not in report


def test_a_word_that_a_template_needs_and_does_not_get_is_an_error():
    with pytest.raises(Exception, match="undefined"):
        render("spheremouse.files.report", "page.html", title="t")


mpl = pytest.importorskip("matplotlib")


def test_a_user_s_own_settings_are_out_within_and_back_after():
    with mpl.rc_context({"font.size": 30.0, "axes.spines.top": True}):
        with styled({"axes.grid": True}):
            assert (mpl.rcParams["font.size"], mpl.rcParams["axes.spines.top"]) == (9.0, False)
            assert mpl.rcParams["axes.grid"]
        assert mpl.rcParams["font.size"] == 30.0


@pytest.mark.parametrize(("most", "found"), [(1.0, 1.0), (1.99, 1.0), (2.0, 2.0), (730.0, 500.0), (0.049, 0.02)])
def test_round_numbers(most, found):
    assert round_number(most) == pytest.approx(found)
