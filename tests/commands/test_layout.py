"""`spheremouse layout`: well-spread places, and a guide whose lengths lead to them."""

import json
import re
from functools import partial

import numpy as np
import pytest
from conftest import directions
from elements import Elements
from invoking import fail, succeed
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from spheremouse.calibrate.layout.choose import choose_directions, min_in_view, nearest, on_the_tape, places
from spheremouse.commands import app

VIEW = np.radians(70.0)
run = partial(succeed, app, "layout")


@pytest.mark.parametrize("n", [4, 12, 26])
def test_the_number_in_view_is_that_of_the_barest_direction(n):
    d = directions(n, 1)
    many = np.random.default_rng(1).standard_normal((20_000, 3))
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    assert abs(min_in_view(d, VIEW) - np.sum(many @ d.T > np.cos(VIEW), axis=1).min()) <= 1


def test_chosen_places_are_spread_in_order_and_the_same_for_the_same_seed():
    d = choose_directions(26, VIEW, 0.1, 1)
    assert_allclose(d, choose_directions(26, VIEW, 0.1, 1))
    assert np.abs(d - choose_directions(26, VIEW, 0.1, 2)).max() > 0.1
    assert nearest(d)[0] > 0.5 * np.sqrt(4.0 * np.pi / 26)
    assert min_in_view(d, VIEW) >= 5
    assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    assert_allclose(d[0], [0, 0, 1], atol=1e-12)
    assert np.all(np.diff(d[:, 2]) <= 0.0)


@pytest.mark.parametrize("radius", [0.6, 0.1])
def test_the_tape_leads_to_the_directions(radius):
    """The tape from P over the band's reading, as a rotation of P: about the pole, then down the meridian."""
    chosen = choose_directions(26, VIEW, 0.1, 1)
    d = on_the_tape(chosen, radius)
    mm = 1e3 * radius
    assert 0.1 < np.max(np.arccos(np.clip(np.sum(d * chosen, axis=1), -1.0, 1.0)) * mm) <= np.hypot(2.5, 2.5) + 1e-6
    for direction, place in zip(d, places(d, radius), strict=True):
        azimuth = 0.0 if place.band is None else place.band / mm
        put = Rotation.from_euler("ZY", [azimuth, place.from_pole / mm]).apply([0.0, 0.0, 1.0])
        assert np.linalg.norm(put - direction) * mm < 2.6  # the band's last reading is next to 0
        assert abs(place.from_pole - place.below_band - 0.5 * np.pi * mm) <= 5.0
        for other, length in place.checks:
            assert other < place.number
            assert abs(np.arccos(d[other - 1] @ direction) * mm - length) <= 2.6


def test_a_guide_is_whole_and_no_other_replaces_it_without_force(tmp_path):
    folder = tmp_path / "guide"
    run("--discs", 12, "--out", folder)
    page, file = (folder / "guide.html").read_text(), (folder / "layout.json").read_text()
    assert "Where to put the 12 discs" in page
    assert all(link.startswith("#") for link in Elements(page).links)  # it prints without a network
    assert page.count('<tr><td class="tick">') == 12
    for tag in ("svg", "section", "table", "tr", "td", "ol", "ul", "li", "text", "p", "figure"):
        assert len(re.findall(rf"<{tag}[ >]", page)) == page.count(f"</{tag}>"), tag
    found = json.loads(file)
    polar = np.arccos(np.array(found["directions"])[:, 2])
    assert_allclose(600.0 * polar, [place["from_pole"] for place in found["places_mm"]], atol=0.01)
    said = fail(app, "layout", "--discs", 12, "--seed", 1, "--out", folder)
    assert "there already; name another file, or replace it with --force" in said
    assert (folder / "guide.html").read_text() == page
    run("--discs", 12, "--seed", 1, "--out", folder, "--force")
    assert (folder / "guide.html").read_text() != page


def test_discs_too_large_for_the_ball_are_refused(tmp_path):
    said = fail(app, "layout", "--discs", 100, "--disc-radius", 0.2, "--out", tmp_path)
    assert "take fewer or smaller discs" in said
    assert not list(tmp_path.iterdir())
