"""`spheremouse layout`: what the guide tells a person puts the discs where the directions are; a check reads it all."""

import json
import re

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from spheremouse.calibrate.layout.guide import on_the_tape, places
from spheremouse.calibrate.layout.search import Trials, in_order, judge
from spheremouse.commands import app
from spheremouse.commands.layout import check, compare, make
from spheremouse.commands.layout.check import advice, read_layout
from spheremouse.errors import ConfigurationError

VIEW = np.radians(70.0)


@pytest.fixture
def quick(monkeypatch):
    for module in (make, compare):
        monkeypatch.setattr(module, "default_steps", lambda n: 3)
    for module in (make, compare, check):
        monkeypatch.setattr(module, "TRIALS", 10)


def run(*words):
    result = CliRunner().invoke(app, ["layout", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.mark.parametrize("radius", [0.6, 0.1])
def test_whoever_follows_the_tape_arrives_at_the_directions(radius):
    """The tape from P over the band's reading, as a rotation of P: about the pole, then down the meridian."""
    d = on_the_tape(in_order(directions(26, 1)), radius)
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
    d = in_order(directions(26, 2))
    off = np.arccos(np.clip(np.sum(d * on_the_tape(d, 0.6), axis=1), -1.0, 1.0)) * 600.0
    assert np.max(off) <= np.hypot(2.5, 2.5) + 1e-6
    assert np.max(off) > 1.0


@pytest.mark.usefixtures("quick")
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


@pytest.mark.usefixtures("quick")
def test_another_guide_is_not_replaced_unasked(tmp_path):
    run("--discs", 5, "--out", tmp_path)
    before = (tmp_path / "guide.html").read_text()
    with pytest.raises(ConfigurationError, match="another layout is there"):
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
    assert figures["separability"] == round(judge(found, VIEW).separability, 2)
    assert sum(figures["recognised"][k] for k in ("found", "refused", "wrong")) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"camera": 1}, "no directions in it"),
        ([[1, 0, 0]] * 3, "3 discs; from 4 to 120"),
        ([[1, 0, 0]] * 3 + [[2, 0, 0]], "direction 4 has length 2"),
        ([[1, 0, 0]] * 3 + [[1, 0]], "a list of"),
        ([["a", "b", "c"]] * 4, "a list of"),
        ({"directions": 7}, "0 discs|a list of"),
        ({"discs": [{"at": 1}] * 5}, "a list of"),
    ],
)
def test_a_file_that_is_no_layout_is_refused_in_one_line(tmp_path, content, message):
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


def test_advice_names_what_is_wrong():
    good = Trials(1.0, 0.0, 0.0)
    octahedron = np.concatenate([np.eye(3), -np.eye(3)])
    lines = "\n".join(advice(judge(octahedron, VIEW, 50), good, 0.6, 0.02))
    assert "looks the same" in lines
    assert "add discs" in lines
    d = directions(26, 4)
    close = np.concatenate([d, [d[3] + 0.05 * d[4]]])
    close /= np.linalg.norm(close, axis=1, keepdims=True)
    assert "discs 4 and 27 overlap" in "\n".join(advice(judge(close, VIEW, 50), good, 0.6, 0.02))
    assert "mistaken" in "\n".join(advice(judge(d, VIEW, 50), Trials(0.9, 0.0, 0.1), 0.6, 0.02))


@pytest.mark.usefixtures("quick")
def test_a_comparison_has_a_line_for_each_figure():
    result = run("--discs", 8, "--compare", 2)
    assert result.exit_code == 0
    assert all(name in result.stdout for name, _ in compare.COMPARED)
