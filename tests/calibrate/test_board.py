"""board.yaml: written by one command, read by another, and by a person in between."""

import pytest

from spheremouse.calibrate import board
from spheremouse.calibrate.board import NAME, Pattern, board_options, known_board, load_board, save_board
from spheremouse.errors import ConfigurationError


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
