"""The template of all pages: hostile words stay words wherever they stand; what is for paper says which."""

import re

import pytest
from elements import Elements
from markupsafe import Markup

from spheremouse.files.report.page import page, rendered

HOSTILE = """<i onclick="x">'&amp;' {{ 7 * 7 }} </script></style>"""


def every_block():
    return rendered("tests.files.report", "every_block.html", words=HOSTILE, data=b"")


def test_hostile_words_are_words():
    found = Elements(page(HOSTILE, HOSTILE, every_block(), HOSTILE))
    assert found.words.count(HOSTILE) == 3 + 1 + 2 + 1 + 4
    assert {"i", "script"}.isdisjoint(found.tags)
    assert HOSTILE in found.values  # for a screen reader


def test_backticks_are_code_and_what_is_in_them_is_escaped_once():
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
        rendered("spheremouse.files.report", "page.html", title="t")
