"""Files of hand-held balls: they read back, those we give out are sound, mistakes are told with their line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from invoking import refusal

from spheremouse.errors import ConfigurationError
from spheremouse.files.wand import load_wand, save_wand, symmetry, wand_text
from spheremouse.geometry.rotation import exp
from spheremouse.session.run_config import read_balls
from spheremouse.wand.ball import WandBall, grzonka_ball, wand_disc
from spheremouse.wand.colour import DEFAULT_COLOURS
from spheremouse.wand.settings import ColourSettings

GIVEN = Path(__file__).parents[2] / "calibration" / "wand"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "wand.yaml"
    save_wand(path, grzonka_ball(), {c: DEFAULT_COLOURS[c] for c in ("red", "blue")}, {"made_by": "a: test"})
    return path


def edited(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def test_the_given_ball_of_grzonka_is_that_of_the_code():
    ball, file = grzonka_ball(), load_wand(GIVEN / "grzonka.yaml")
    assert (file.ball.name, file.ball.radius, file.ball.body) == (ball.name, ball.radius, ball.body)
    for a, b in zip(file.ball.discs, ball.discs, strict=True):
        assert np.allclose(a.direction, b.direction, atol=1e-7)
        assert (a.angle, a.points_angle) == (pytest.approx(b.angle, abs=1e-6), pytest.approx(b.points_angle, abs=1e-6))
        assert a.colour == b.colour
    assert file.colours == {c: DEFAULT_COLOURS[c] for c in ball.colours}


def test_a_file_reads_back_with_its_bounds(tmp_path):
    red = ColourSettings(hue_min=350.0, hue_max=12.5, saturation_min=80.0, value_max=300.0)
    path = tmp_path / "own.yaml"
    save_wand(path, grzonka_ball(), {"red": red})
    file = load_wand(path)
    assert file.colours == {"red": red, "blue": DEFAULT_COLOURS["blue"]}
    assert wand_text(file.ball, {"red": red}) == path.read_text()


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("diameter: 0.021", "diameter: 0.21", 10, "is 0.21 m, on a ball 0.1 m across; both are in metres"),
        ("points: 0.005", "points: 0.02", 10, "is 0.02 m from the centre, beyond the rim of a disc 0.021 m across"),
        ("colour: red", "colour: mauve", 10, "is 'mauve', which has no bounds; write them under `colours`"),
        ("latitude: 55", "latitude: 30", 11, "overlaps disc 1: 15.0 degrees apart, 32.6 would touch"),
        ("value_min: 25", "value_min: 10000", 19, "is 10000, not below value_max, 10000: that selects nothing"),
        ("  red: {", "  pink: {", 19, "no disc has this colour; remove it, or give it to a disc"),
    ],
)
def test_a_mistake_is_told_with_its_line(file, old, new, line, words):
    text = refusal(ConfigurationError, load_wand, edited(file, old, new))
    assert f"{file}:{line}: " in text
    assert words in text


def test_a_ball_that_looks_the_same_twice_is_refused(file):
    """Red and blue in turn: half a turn about the pole maps the pattern to itself."""
    code = ("red", "blue", "red", "blue")
    discs = [wand_disc(k * np.pi / 2, np.radians(20), 0.2, c) for k, c in enumerate(code)]
    twice = WandBall("twice", 0.05, tuple(discs))
    turn = symmetry(twice)
    assert np.allclose(turn, exp(np.array([0.0, 0.0, np.pi])), atol=1e-9)
    save_wand(file, twice)
    with pytest.raises(ConfigurationError, match=r"wand.yaml:7: discs: the ball looks the same turned by 180 degrees"):
        load_wand(file)
    unlike = replace(twice, discs=(*discs[:3], wand_disc(1.5 * np.pi, np.radians(20), 0.12, "blue")))
    assert symmetry(unlike) is None


def test_two_discs_are_too_few(tmp_path):
    ball = grzonka_ball()
    path = tmp_path / "two.yaml"
    save_wand(path, replace(ball, discs=ball.discs[:2]))
    with pytest.raises(ConfigurationError, match="discs: must be a list of at least 3, is a list of 2"):
        load_wand(path)
    with pytest.raises(ConfigurationError, match="no such file"):
        load_wand(tmp_path / "none.yaml")


@pytest.mark.parametrize("name", ['"\\e[31mred"', '"two\\nlines"', '"\\x9b2J"', '"\\u2028"'])
def test_a_name_that_could_steer_a_terminal_is_refused(file, name):
    edited(file, "name: grzonka", f"name: {name}")
    with pytest.raises(ConfigurationError, match=r"wand\.yaml:\d+: name: has a control character") as e:
        load_wand(file)
    assert str(e.value).isprintable()


def test_two_balls_of_one_name_are_refused(tmp_path, file):
    second = tmp_path / "second.yaml"
    save_wand(second, grzonka_ball())
    with pytest.raises(ConfigurationError, match=r"second\.yaml: name: grzonka is also the ball of .*wand\.yaml; give"):
        read_balls([file, second])
    edited(second, "name: grzonka", "name: other")
    assert [ball.name for ball in read_balls([file, second]).balls] == ["grzonka", "other"]
    (tmp_path / "link.yaml").symlink_to(file)
    assert [ball.name for ball in read_balls([file, tmp_path / "link.yaml"]).balls] == ["grzonka", "grzonka"]
