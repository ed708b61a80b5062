"""Drawings put together of elements: what is given is written as it is meant, and nothing gets out of its attribute."""

from xml.etree import ElementTree

import numpy as np

from spheremouse.files.report.svg import drawing, element

HOSTILE = """</text><script>alert("1" & '2')</script>"""


def test_numbers_points_and_names_are_those_of_svg():
    made = element("polyline", class_="grid", points=np.array([[1.0, 2.5], [1 / 3, 0.0]]), stroke_width=0.125)
    assert made == '<polyline class="grid" points="1.00,2.50 0.33,0.00" stroke-width="0.12"></polyline>'
    assert (
        element("circle", cx=-1e-9, cy=180.0, r=np.float64(22.0 / 7.0)) == '<circle cx="0" cy="180" r="3.14"></circle>'
    )


def test_hostile_words_are_words():
    made = drawing(10, 20, HOSTILE, [element("text", HOSTILE, fill=HOSTILE)])
    root = ElementTree.fromstring(made)
    (text,) = root
    assert (root.get("aria-label"), root.get("viewBox")) == (HOSTILE, "0 0 10 20")
    assert (text.text, text.get("fill")) == (HOSTILE, HOSTILE)
