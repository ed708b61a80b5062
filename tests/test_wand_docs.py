"""What docs/wand.md shows works: its ball is a ball that is found, its configuration can be read."""

import re
from pathlib import Path

import numpy as np
import pytest

from spheremouse.session.run_config import read_balls
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.tracker import Status
from spheremouse.wand.build import build
from spheremouse.wand.track import begin, step

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "wand.md").read_text(encoding="utf-8")


@pytest.fixture
def shown(tmp_path):
    """Its YAML blocks as files: a configuration and a ball."""
    configuration, ball = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    (tmp_path / "config.yaml").write_text(configuration)
    (tmp_path / "mine.yaml").write_text(ball)
    return tmp_path


def test_the_ball_that_is_shown_is_found(shown):
    read = read_balls([shown / "mine.yaml"])
    balls, colours = read.balls, read.colours
    assert (balls[0].name, balls[0].radius, set(colours)) == ("mine", 0.04, {"red", "green"})
    film = prepare_wand(WandOptions("hand", seed=1, seconds=0.2, size=(640, 480)), balls[0])
    tracker = build(film.scene.camera, balls, colours=colours)
    state = begin(tracker, 1)
    for shot in simulate_wand(film):
        state, pose, _ = step(state, shot.frame, tracker)
        assert pose.status is Status.TRACKING
        assert pose.position == pytest.approx(shot.position[0], abs=0.03)
        assert np.trace(pose.rotation.T @ shot.rotation[0]) > 2.99


def test_the_configuration_that_is_shown_is_right(spheremouse, shown):
    code, _, err = spheremouse("config", "show", "--config", shown / "config.yaml")
    assert code == 0, err


def test_the_balls_that_ship_are_named_and_every_field_is_told():
    for path in (ROOT / "calibration" / "wand").glob("*.yaml"):
        assert f"`{path.name}`" in TEXT
    for field in ("name", "radius", "body", "discs", "azimuth", "latitude", "diameter", "colour", "points", "colours",
                  "hue_min", "hue_max", "saturation_min", "saturation_max", "value_min", "value_max"):  # fmt: skip
        assert f"`{field}`" in TEXT
