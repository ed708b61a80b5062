"""`spheremouse layout`: the guide's lengths lead to its directions; a check reads every file with directions."""

import json
import re

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from spheremouse.calibrate.layout.choose import Assessment, choose_directions, min_in_view
from spheremouse.calibrate.layout.guide import on_the_tape, places
from spheremouse.commands import app
from spheremouse.commands.layout import advice, read_layout
from spheremouse.errors import ConfigurationError

VIEW = np.radians(70.0)


def run(*words):
    result = CliRunner().invoke(app, ["layout", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.mark.parametrize("radius", [0.6, 0.1])
def test_the_tape_leads_to_the_directions(radius):
    """The tape from P over the band's reading, as a rotation of P: about the pole, then down the meridian."""
    d = on_the_tape(choose_directions(26, VIEW, 0.1, 1), radius)
    mm = 1e3 * radius
    for direction, place in zip(d, places(d, radius), strict=True):
        azimuth = 0.0 if place.band is None else place.band / mm
        put = Rotation.from_euler("ZY", [azimuth, place.from_pole / mm]).apply([0.0, 0.0, 1.0])
        assert np.linalg.norm(put - direction) * mm < 2.6  # the band's last reading is next to 0
        assert abs(place.from_pole - place.below_band - 0.5 * np.pi * mm) <= 5.0
        for other, length in place.checks:
            assert other < place.number
            assert abs(np.arccos(d[other - 1] @ direction) * mm - length) <= 2.6


def test_the_tape_moves_no_disc_by_more_than_half_a_step_each_way():
    d = choose_directions(26, VIEW, 0.1, 2)
    off = np.arccos(np.clip(np.sum(d * on_the_tape(d, 0.6), axis=1), -1.0, 1.0)) * 600.0
    assert np.max(off) <= np.hypot(2.5, 2.5) + 1e-6
    assert np.max(off) > 1.0


def test_a_guide_is_whole_and_its_directions_read_back(tmp_path):
    folder = tmp_path / "guide"
    result = run("--discs", 12, "--out", folder, "--json", tmp_path / "copy.json")
    assert result.exit_code == 0, result.output
    page = (folder / "guide.html").read_text()
    assert "Where to put the 12 discs" in page
    assert "http" not in page  # nothing to load: it prints without a network
    assert page.count('<tr><td class="tick">') == 12
    assert page.count('class="disc"') == 12 + 2  # in the drawing, and two in the sketch
    for tag in ("svg", "section", "table", "tr", "td", "ol", "ul", "li", "text", "p", "figure"):
        assert len(re.findall(rf"<{tag}[ >]", page)) == page.count(f"</{tag}>"), tag
    assert (folder / "layout.json").read_text() == (tmp_path / "copy.json").read_text()
    found, radius, disc_radius = read_layout(folder / "layout.json")
    assert (radius, disc_radius) == (0.6, 0.02)
    for place, d in zip(json.loads((folder / "layout.json").read_text())["places_mm"], found, strict=True):
        assert_allclose(np.arccos(d[2]) * 600.0, place["from_pole"], atol=0.01)

    again = run("--discs", 12, "--out", folder)  # the same is no other
    assert again.exit_code == 0
    assert (folder / "guide.html").read_text() == page


def test_another_guide_is_kept_without_force(tmp_path):
    run("--discs", 5, "--out", tmp_path)
    before = (tmp_path / "guide.html").read_text()
    with pytest.raises(ConfigurationError, match="is another layout"):
        run("--discs", 5, "--seed", 1, "--out", tmp_path)
    assert (tmp_path / "guide.html").read_text() == before
    assert run("--discs", 5, "--seed", 1, "--out", tmp_path, "--force").exit_code == 0
    assert (tmp_path / "guide.html").read_text() != before


@pytest.mark.parametrize("form", ["scene", "map", "list"])
def test_a_check_reads_every_file_with_directions(tmp_path, form):
    d = directions(12, 3).tolist()
    content = {
        "scene": {"ball": {"radius": 0.3}, "disc_radius": 0.01, "truth_disc_directions": d},
        "map": {"schema": 1, "ball_radius": 0.3, "disc_radius": 0.01, "discs": [{"direction": v} for v in d]},
        "list": d,
    }[form]
    path = tmp_path / "file.yaml"
    path.write_text(json.dumps(content))
    found, radius, disc_radius = read_layout(path)
    assert_allclose(found, d, atol=1e-12)
    assert (radius, disc_radius) == ((None, None) if form == "list" else (0.3, 0.01))
    result = run("--check", path, "--json", "-")
    figures = json.loads(result.stdout)
    assert figures["discs"] == 12
    assert figures["in_view"] == min_in_view(found, VIEW)
    assert 0.0 <= figures["recognised"] + figures["mistaken"] <= 1.0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"camera": 1}, "no directions in it"),
        ([[1, 0, 0]] * 3, "has 3 discs, must have 4 to 120"),
        ([[1, 0, 0]] * 3 + [[2, 0, 0]], "direction 4 has length 2"),
        ([[1, 0, 0]] * 3 + [[1, 0]], "a list of"),
        ([["a", "b", "c"]] * 4, "a list of"),
        ({"directions": 7}, "has 0 discs|a list of"),
        ({"discs": [{"at": 1}] * 5}, "a list of"),
    ],
)
def test_a_file_without_a_layout_is_rejected_in_one_line(tmp_path, content, message):
    path = tmp_path / "file.json"
    path.write_text(json.dumps(content))
    with pytest.raises(ConfigurationError, match=message) as refused:
        read_layout(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("words", [("--view-angle", 95), ("--radius", 0), ("--disc-radius", "nan")])
def test_impossible_options_are_refused(words):
    with pytest.raises(ConfigurationError, match=words[0]):
        run(*words)


def test_discs_too_large_for_the_ball_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="take fewer or smaller discs"):
        run("--discs", 100, "--disc-radius", 0.2, "--out", tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (Assessment(6, 0.4, (3, 5), 0.99, 0.0), "none; this layout is good"),
        (Assessment(6, 0.05, (3, 26), 0.99, 0.0), "discs 4 and 27 overlap; move one of them 60 mm away"),
        (Assessment(1, 0.4, (3, 5), 0.2, 0.0), "from some sides one disc is in view"),
        (Assessment(3, 0.4, (3, 5), 0.8, 0.0), "from some sides only 3 discs are in view"),
        (Assessment(6, 0.4, (3, 5), 0.1, 0.0), "looks alike from several sides"),
        (Assessment(6, 0.4, (3, 5), 0.9, 0.1), "looks alike from several sides"),
    ],
)
def test_advice_names_the_problem_and_the_remedy(found, text):
    (line,) = advice(found, 0.6, 0.02)
    assert text in line
