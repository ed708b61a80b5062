"""`spheremouse calibrate device`: what it refuses before it calculates, and what it says comes next."""

import json

import numpy as np
import pytest
from conftest import datasets_dir
from typer.testing import CliRunner

from spheremouse.commands import app
from spheremouse.errors import CalibrationError
from spheremouse.files.device import device_template
from spheremouse.files.rig import save_camera
from spheremouse.geometry.camera import InteriorOrientation


def run(*words):
    return CliRunner().invoke(app, ["calibrate", "device", *map(str, words)], catch_exceptions=False)


@pytest.fixture
def cabinet(tmp_path):
    truth = json.loads((datasets_dir() / "stills" / "truth.json").read_text())
    c = truth["camera"]
    lens = [c[name] for name in ("fx", "fy", "cx", "cy")]
    camera = InteriorOrientation(truth["width"], truth["height"], *lens, np.array(c["dist"]), 1e-6 * np.eye(9))
    save_camera(tmp_path / "camera.yaml", camera)
    return tmp_path


def options(folder, device):
    return ("--device", device, "--camera", folder / "camera.yaml", "--out", folder / "rig.yaml")


def test_a_device_file_nobody_filled_in_is_refused(cabinet):
    """Its targets may well be those of the photos; the distances are not."""
    device = cabinet / "device.yaml"
    device.write_text(device_template(), encoding="utf-8")
    with pytest.raises(CalibrationError, match="delete its first line") as e:
        run(datasets_dir() / "stills" / "device", *options(cabinet, device))
    assert "\n" not in str(e.value)
    assert not (cabinet / "rig.yaml").exists()


def test_what_comes_next_saves_what_is_answered(cabinet):
    stills = datasets_dir() / "stills"
    result = run(stills / "device", *options(cabinet, stills / "device.yaml"))
    assert result.exit_code == 0, result.output
    follows = next(line for line in result.output.splitlines() if line.startswith("next: "))
    config, rig = cabinet / "config.yaml", cabinet / "rig.yaml"
    assert follows.startswith(f"next: spheremouse axes --config {config} --rig {rig} --source ")
    assert "uinput" not in result.output  # `axes` has no such option
