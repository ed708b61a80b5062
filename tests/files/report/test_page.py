"""The template of all pages: hostile words stay words wherever they stand; what is for paper says which."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from spheremouse.files.report import page

HOSTILE = """<b onclick="x">'&amp;' {{ 7 * 7 }} </script></style>"""


class Elements(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.words, self.values = [], "", []
        self.feed(str(text))

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.values += [value for _, value in attrs]

    def handle_data(self, data):
        self.words += data


@pytest.mark.parametrize(
    ("block", "times"),
    [
        (lambda: page.section(HOSTILE, HOSTILE), 2),
        (lambda: page.paragraph(HOSTILE), 1),
        (lambda: page.numbers([(HOSTILE, HOSTILE, HOSTILE)]), 3),
        (lambda: page.advice([("note", HOSTILE)]), 1),
        (lambda: page.table([HOSTILE], [[HOSTILE]], [True]), 2),
        (lambda: page.correlations([HOSTILE, HOSTILE], np.eye(2)), 2),
        (lambda: page.picture(b"", HOSTILE), 1),
        (lambda: page.beside(HOSTILE, page.sheet([HOSTILE])), 2),
        (lambda: page.page(HOSTILE, HOSTILE, [HOSTILE], HOSTILE), 5),
    ],
)
def test_hostile_words_are_words(block, times):
    found = Elements(block())
    assert found.words.count(HOSTILE) == times
    assert {"b", "script"}.isdisjoint(set(found.tags) - ({"b"} if "ul" in found.tags else set()))
    assert HOSTILE in found.values or "img" not in found.tags


def test_backticks_are_code_and_what_is_in_them_is_escaped_once():
    assert page.paragraph("`a<b` & `c`").strip() == "<p><code>a&lt;b</code> &amp; <code>c</code></p>"


def test_a_handout_names_its_paper_and_a_report_none():
    handout, report = page.page("t", "", [], paper="A4"), page.page("t", "", [])
    assert '<html lang="en" class="handout">' in handout
    assert re.search(r"@page \{ size: A4; \}", handout)
    assert '<html lang="en">' in report
    assert "size: A4" not in report
    assert "Undefined" not in report


def test_a_word_that_a_template_needs_and_does_not_get_is_an_error():
    with pytest.raises(Exception, match="undefined"):
        page.rendered("spheremouse.files.report", "page.html", title="t")


def test_correlations_are_the_lower_half_and_coloured_by_sign():
    text = page.correlations(["a", "b", "c"], np.array([[1.0, 0.5, -0.25], [0.5, 1.0, 0.0], [-0.25, 0.0, 1.0]]))
    assert re.findall(r">([+-]\d\.\d\d)<", text) == ["+0.50", "-0.25", "+0.00"]
    assert re.findall(r"var\(--(\w+)\) (\d+)%", text) == [("blue", "35"), ("red", "18"), ("blue", "0")]
