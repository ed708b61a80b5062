"""The board, and what a calibration writes."""

from pathlib import Path

import pytest

from spheremouse.calibrate import board
from spheremouse.calibrate.board import NAME, Pattern, board_options, known_board, load_board, save_board
from spheremouse.calibrate.outputs import check_outputs
from spheremouse.errors import CalibrationError, ConfigurationError


@pytest.mark.parametrize("board", [Pattern(), Pattern(9, 6, 0.0201), Pattern(9, 6, 0.03, 0.022, "DICT_4X4_50")])
def test_what_is_written_is_read(tmp_path, board):
    save_board(tmp_path / NAME, board)
    assert load_board(tmp_path / NAME) == board
    before = (tmp_path / NAME).stat().st_mtime_ns
    save_board(tmp_path / NAME, board)
    assert (tmp_path / NAME).stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("square: 20", "20: a length needs its unit"),
        ("square: 20mm\nboard: 11\n", "board.yaml:2: board"),
        ("size: 3\n", "size: is not known here"),
        ("- 1\n", "must be lines"),
        ("square: [\n", "board.yaml:"),
        ("marker: wide\n", "marker"),
        ('marker: 20mm\ndictionary: "\\e[31mx"\n', "board.yaml:2: dictionary: has a control character"),
    ],
)
def test_slips_are_told_with_their_line(tmp_path, text, said):
    (tmp_path / NAME).write_text(text)
    with pytest.raises(ConfigurationError, match=NAME) as e:
        load_board(tmp_path / NAME)
    assert said in str(e.value)
    assert board_options(tmp_path) == Pattern().options


def test_the_folder_s_own_board_comes_before_the_printed_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert known_board(tmp_path / "cabinet") is None
    board.PRINTED.mkdir(parents=True)
    save_board(board.PRINTED / NAME, Pattern(square=0.04))
    assert board_options(tmp_path / "cabinet") == ["--board", "11x8", "--square", "40mm"]
    (tmp_path / "cabinet").mkdir()
    save_board(tmp_path / "cabinet" / NAME, Pattern(square=0.0399, marker=0.03))
    assert board_options(tmp_path / "cabinet") == ["--board", "11x8", "--square", "39.9mm", "--marker", "30mm"]


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
        (["device.yaml"], "is read or written by this very command"),
        (["device/../camera.yaml"], "is read or written by this very command"),
        (["device/1.jpg"], "is read or written by this very command"),
        (["rig.yaml", "rig.yaml"], "written twice"),
        (["device"], "is a folder"),
        (["nowhere/rig.yaml"], "there is no folder"),
    ],
)
def test_no_output_destroys_an_input_or_another_output(cabinet, outputs, words, force):
    inputs = [cabinet / "device", cabinet / "device.yaml", cabinet / "camera.yaml", None]
    with pytest.raises(CalibrationError, match=words):
        check_outputs([cabinet / name for name in outputs], inputs, force=force)


def test_an_input_folder_that_may_not_be_read_is_refused(cabinet, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("pathlib.Path.iterdir", refuse)  # root may read every folder
    with pytest.raises(CalibrationError, match="device: cannot be read: Permission denied"):
        check_outputs([cabinet / "rig.yaml"], [cabinet / "device"], force=True)


def test_what_is_there_is_replaced_with_force_only(cabinet):
    with pytest.raises(CalibrationError, match=r"old\.yaml: there already.*--force"):
        check_outputs([cabinet / "old.yaml"], [], force=False)
    check_outputs([cabinet / "old.yaml", cabinet / "new.yaml", Path("-"), None], [cabinet / "device"], force=True)


def test_folder_that_may_not_be_written_is_refused_beforehand(cabinet, monkeypatch):
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anywhere
    with pytest.raises(CalibrationError, match="may not be written"):
        check_outputs([cabinet / "rig.yaml"], [], force=False)
