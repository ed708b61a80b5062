"""Settings saved into a file: all that a person wrote stays, and what is wrong changes nothing."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.files.edit import save_settings
from spheremouse.session.settings import Configuration

MINE = """\
# The cabinet in the hall.
schema: 2  # as told
source: 'v4l2:/dev/video0' # the left one
motion:
  # twice as fast
  counts_per_mm: 2.50
  player: right  # tried
so3: {acceleration_sigma: 9.0}
"""
SEAT = {("motion", "player"): "left"}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text(MINE)
    path.chmod(0o640)
    return path


def test_one_value_changes_and_nothing_else(file):
    save_settings(file, SEAT, Configuration)
    assert file.read_text() == MINE.replace("player: right", "player: left")
    assert file.stat().st_mode & 0o777 == 0o640
    assert list(file.parent.iterdir()) == [file]


@settings(max_examples=15)
@given(st.sampled_from(["far-side", "camera-side", "left", "right"]), st.booleans(), st.floats(0.1, 10.0))
def test_what_is_saved_is_what_is_read(tmp_path_factory, player, invert, scale):
    path = tmp_path_factory.mktemp("saved") / "config.yaml"
    values = {("motion", "player"): player, ("motion", "invert_y"): invert, ("wand", "pointing", "scale_x"): scale}
    save_settings(path, values, Configuration)
    read = config.load(path, Configuration)
    assert (read.motion.player, read.motion.invert_y, read.wand.pointing.scale_x) == (player, invert, scale)
    save_settings(path, values, Configuration)
    assert config.load(path, Configuration) == read


@pytest.mark.parametrize(
    ("text", "values", "said"),
    [
        (MINE + "motoin: {}\n", SEAT, r"config.yaml:9: motoin: unknown key"),
        (MINE, {("motion", "player"): "above"}, r"config.yaml:7: motion.player: must be 'far-side'"),
        (MINE, {("motion", "scale_x"): -1.0}, r"motion.scale_x: must be at least 0.001, is -1"),
        ("schema: 9\n", SEAT, r"config.yaml:1: schema: is 9; this program reads version 2"),
    ],
)
def test_what_would_be_wrong_is_refused_and_the_file_left(file, text, values, said):
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=said):
        save_settings(file, values, Configuration)
    assert file.read_text() == text


ANNOTATED = """\
---
schema: 2
motion:
    # of the ball
    counts_per_mm: 1.0

# how it exposes
camera:
    exposure_s: null
# vim: et
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_new_key_is_the_first_of_its_section_and_no_heading_moves(tmp_path, end, mark):
    path = tmp_path / "config.yaml"
    path.write_bytes(mark + ANNOTATED.replace("\n", end).encode())
    save_settings(path, {**SEAT, ("camera", "gain"): 4, ("pointer", "rate"): 500.0}, Configuration)
    wanted = ANNOTATED.replace("motion:\n", "motion:\n    player: left\n").replace(
        "camera:\n", "camera:\n    gain: 4\n"
    )
    assert path.read_bytes() == mark + (wanted + "pointer:\n  rate: 500.0\n").replace("\n", end).encode()
    before = path.stat().st_ino
    save_settings(path, SEAT, Configuration)
    assert path.stat().st_ino == before  # nothing new is nothing written


@pytest.mark.parametrize(
    ("text", "saved"),
    [
        ("schema: 2\n", "schema: 2\nmotion:\n  player: left\n"),
        ("schema: 2\nmotion: {}\n", "schema: 2\nmotion: {player: left}\n"),
        ("schema: 2\nmotion:\n  # player: right\n", "schema: 2\nmotion:\n  player: left\n  # player: right\n"),
        ("schema: 2\nmotion: {scale_y: 2}\n", "schema: 2\nmotion: {player: left, scale_y: 2}\n"),
        ("schema: 2\nmotion: null  # none yet\n", "schema: 2\nmotion:   # none yet\n  player: left\n"),
        ("schema: 2\nmotion:", "schema: 2\nmotion:\n  player: left\n"),
        ("{schema: 2}\n", "{motion: {player: left}, schema: 2}\n"),
        ('schema: 2\nmotion:\n  player: "right"\n', "schema: 2\nmotion:\n  player: left\n"),
    ],
)
def test_other_ways_to_write_it(tmp_path, text, saved):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    save_settings(path, SEAT, Configuration)
    assert path.read_text().replace("'", "") == saved


def test_a_link_is_not_replaced_by_a_file(tmp_path, file):
    link = tmp_path / "link.yaml"
    link.symlink_to(file)
    with pytest.raises(ConfigurationError, match=r"link.yaml: is a link; name the file itself, .*config.yaml"):
        save_settings(link, SEAT, Configuration)
    assert link.is_symlink()
    assert file.read_text() == MINE
