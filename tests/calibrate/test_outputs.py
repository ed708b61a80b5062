"""What a calibration may write: never what it reads, and nothing twice."""

import shlex
from pathlib import Path

import pytest

from spheremouse.calibrate.outputs import check_outputs, copyable
from spheremouse.errors import CalibrationError


@pytest.fixture
def cabinet(tmp_path):
    (tmp_path / "device").mkdir()
    for name in ("device/1.jpg", "device.yaml", "camera.yaml", "old.yaml"):
        (tmp_path / name).write_text("mine")
    return tmp_path


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(
    ("outputs", "words"),
    [
        (["device.yaml"], "is read by this very command"),
        (["device/../camera.yaml"], "is read by this very command"),
        (["device/1.jpg"], "is read by this very command"),
        (["rig.yaml", "rig.yaml"], "written twice"),
        (["device"], "is a folder"),
        (["nowhere/rig.yaml"], "there is no folder"),
    ],
)
def test_no_output_destroys_an_input_or_another_output(cabinet, outputs, words, force):
    inputs = [cabinet / "device", cabinet / "device.yaml", cabinet / "camera.yaml", None]
    with pytest.raises(CalibrationError, match=words):
        check_outputs([cabinet / name for name in outputs], inputs, force)


def test_what_is_there_is_replaced_with_force_only(cabinet):
    with pytest.raises(CalibrationError, match=r"old\.yaml: there already.*--force"):
        check_outputs([cabinet / "old.yaml"], [], False)
    check_outputs([cabinet / "old.yaml", cabinet / "new.yaml", Path("-"), None], [cabinet / "device"], True)


def test_folder_that_may_not_be_written_is_refused_beforehand(cabinet, monkeypatch):
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anywhere
    with pytest.raises(CalibrationError, match="may not be written"):
        check_outputs([cabinet / "rig.yaml"], [], False)


def test_commands_survive_a_shell():
    words = ["spheremouse", "run", "--rig", Path("Kamera Ü ñ/it's.yaml")]
    assert shlex.split(copyable(*words)) == [str(w) for w in words]
