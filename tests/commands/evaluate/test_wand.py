"""`evaluate` of wands as a user meets it: balls that look alike, balls that are not there, recordings without truth."""

import json
from dataclasses import replace

import pytest

from spheremouse.files.wand import save_wand
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.settings import ColourSettings


def film(path, **options):
    for _ in write_wand(path, prepare_wand(WandOptions("hand", seed=2, fps=30.0, size=(640, 480), **options))):
        pass
    return path


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return film(tmp_path_factory.mktemp("wand") / "two", seconds=0.4, balls=2)


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "ball.yaml"
    save_wand(path, grzonka_ball())
    return path


def figures(spheremouse, path, *words):
    code, out, err = spheremouse("evaluate", path, "--json", path.parent / "a.json", *words)
    assert code == 0, err
    result = json.loads((path.parent / "a.json").read_text())
    return [result, *result.get("more_balls", [])], out, err


def test_a_ball_that_is_never_found_is_a_line_with_the_reason(spheremouse, two, ball, tmp_path):
    none = {c: ColourSettings(hue_min=100.0 + k, hue_max=101.0 + k) for k, c in enumerate(("red", "blue"))}
    save_wand(tmp_path / "none.yaml", grzonka_ball(), none)
    found, _, err = figures(spheremouse, two, "--ball", tmp_path / "none.yaml")
    assert (found[0]["tracked"], found[0]["lost_runs"]) == (0, 1)
    said = f"{two}: grzonka was never found: "
    assert err.count(said) == 1
    assert "no ball like grzonka in view: hold it into the picture" in err.split(said)[1]
    one = film(tmp_path / "one", seconds=0.2)
    second = tmp_path / "second.yaml"
    save_wand(second, replace(grzonka_ball(), name="second"))
    found, out, err = figures(spheremouse, one, "--ball", ball, "--ball", second)
    assert [f["tracked"] for f in found] == [6, 0]
    assert [f["lost_runs"] for f in found] == [0, None]  # there is no truth of a second one
    assert f"{one}: second was never found: " in err
    assert "grzonka was never found" not in err
    (one / "truth.csv").unlink()
    found, out, err = figures(spheremouse, one)
    assert "one" in out
    assert found[0]["position_rmse_mm"]["x"] is None
    assert f"{one}: no truth.csv: no errors are known" in err
