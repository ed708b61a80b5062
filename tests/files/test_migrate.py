"""Older files brought to the newest schema: with steps made up here, and those that there are."""

import re
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.errors import ConfigurationError
from spheremouse.files import migrate
from spheremouse.files.config import load
from spheremouse.files.yaml import parse_document, read_document
from spheremouse.output.counts import MotionSettings
from spheremouse.session.settings import Configuration

OLD = """\
# A cabinet in the hall.
schema: 1  # as told
motion:
  # twice as fast
  gain: 2.50  # counts
so3: {sigma: 1.0e-05}
"""


def rename(data):
    """gain is called scale_x."""
    if "motion" in data and "gain" in data["motion"]:
        data["motion"]["scale_x"] = data["motion"].pop("gain")


def doubled(data):
    """The scale counts twice."""
    if "motion" in data:
        data["motion"]["scale_x"] = 2 * data["motion"]["scale_x"]


@pytest.fixture
def steps(monkeypatch):
    """A program that reads configurations of schema 3."""
    monkeypatch.setitem(migrate.STEPS, "configuration", (rename, doubled))
    return migrate.STEPS


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text(OLD)
    return path


def test_a_file_of_the_newest_schema_is_left_alone(file, monkeypatch):
    monkeypatch.setitem(migrate.STEPS, "configuration", ())
    assert not migrate.due(file)
    assert not migrate.migrate_file(file)
    assert file.read_text() == OLD
    assert list(file.parent.iterdir()) == [file]
    document = read_document(file)
    assert migrate.converted(document, "configuration") is document


@pytest.mark.usefixtures("steps")
def test_a_file_is_converted_step_by_step_with_its_comments_and_the_original_stays(file):
    file.chmod(0o640)
    assert "from schema 1 to 3" in migrate.due(file)
    assert migrate.migrate_file(file)
    text = file.read_text()
    assert read_document(file).data == {"schema": 3, "motion": {"scale_x": 5.0}, "so3": {"sigma": 1e-5}}
    for comment in ("# A cabinet in the hall.", "# as told", "# twice as fast"):
        assert comment in text
    assert "{sigma: 1.0e-05}" in text
    assert migrate.backup_path(file, 1).read_text() == OLD
    assert [p.stat().st_mode & 0o777 for p in (file, migrate.backup_path(file, 1))] == [0o640, 0o640]
    assert not migrate.migrate_file(file)


@pytest.mark.usefixtures("steps")
def test_what_is_read_and_what_is_rewritten_say_the_same(file):
    read = migrate.converted(read_document(file), "configuration")
    migrate.migrate_file(file)
    assert read.data == read_document(file).data
    assert read.line(("so3",)) == 6


def test_going_back_to_the_version_before_puts_the_original_back(file, monkeypatch):
    monkeypatch.setitem(migrate.STEPS, "configuration", ())
    with monkeypatch.context() as newer:
        newer.setitem(migrate.STEPS, "configuration", (rename, doubled))
        migrate.migrate_file(file)
        converted = file.read_text()
    assert migrate.due(file)
    assert migrate.migrate_file(file)
    assert file.read_text() == OLD
    assert migrate.backup_path(file, 3).read_text() == converted


def test_a_file_from_a_newer_version_is_refused_in_words_and_left(file):
    file.write_text(OLD.replace("schema: 1", "schema: 7"))
    before = file.read_text()
    for act in (lambda: migrate.migrate_file(file), lambda: migrate.converted(read_document(file), "configuration")):
        with pytest.raises(ConfigurationError, match=r"config.yaml:2: schema: is 7, of a newer spheremouse.*update it"):
            act()
    assert file.read_text() == before
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("text", ["- 1\n", "a: 1\n", "schema: x\n", "schema: true\n", "schema: 0\n", "schema: 1.0\n"])
def test_what_has_no_schema_is_for_the_readers_to_refuse(tmp_path, text):
    path = tmp_path / "x.yaml"
    path.write_text(text)
    assert not migrate.due(path)
    assert not migrate.migrate_file(path)
    assert path.read_text() == text


def test_a_step_that_cannot_be_written_changes_nothing(file, monkeypatch):
    """Two steps that differ between plain data and the commented text: such a fault must not reach the file."""

    def treacherous(data):
        data["n"] = type(data).__name__

    monkeypatch.setitem(migrate.STEPS, "configuration", (treacherous,))
    with pytest.raises(ConfigurationError, match="reads differently"):
        migrate.migrate_file(file)
    assert file.read_text() == OLD
    assert list(file.parent.iterdir()) == [file]


numbers = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**20), 10**20)


@given(st.lists(numbers, min_size=1, max_size=30))
def test_no_digit_of_a_number_is_lost(values):
    text = f"schema: 1\nrow: [{', '.join(map(repr, values))}]  # m²\n"
    with pytest.MonkeyPatch.context() as newer:
        newer.setitem(migrate.STEPS, "configuration", (lambda data: None,))
        document = parse_document(text, "x")
        written = migrate._rewritten(text, "configuration", 1, document)
    assert parse_document(written, "x").data["row"] == tuple(values)
    assert written == text.replace("schema: 1", "schema: 2")


def test_rigs_maps_devices_and_configurations_are_told_apart(tmp_path):
    from datetime import UTC, datetime

    from spheremouse.ball.disc_map import DiscMap
    from spheremouse.ball.settings import Settings
    from spheremouse.ball.warm import _RIG
    from spheremouse.files.config import dump_commented
    from spheremouse.files.device import _TEMPLATE
    from spheremouse.files.disc_map import SavedMap, map_text
    from spheremouse.files.rig import rig_text
    from spheremouse.files.wand import wand_text
    from spheremouse.wand.ball import grzonka_ball

    saved = SavedMap(DiscMap(np.eye(3), np.eye(6) * 1e-4, np.ones(3, int)), 0.6, 0.02, datetime.now(UTC), "0")
    texts = {
        "map": map_text(saved),
        "rig": rig_text(_RIG),
        "device": _TEMPLATE,
        "wand": wand_text(grzonka_ball()),
        "configuration": dump_commented(Settings()),
    }
    for kind, text in texts.items():
        assert migrate.kind_of(parse_document(text, kind).data) == kind


# ---- configurations from schema 1 to 2 ----


def before(motion):
    """Counts per radian about X, Y and Z of `obj`, (2, 3), that schema 1 meant: (d_x, -d_z), swapped, then reversed."""
    M = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    if motion.get("swap_xy"):
        M = M[::-1]
    return M * np.where([motion.get("invert_x"), motion.get("invert_y")], -1.0, 1.0)[:, None]


AXES = ("swap_xy", "invert_x", "invert_y")


@pytest.mark.parametrize("values", list(product([None, False, True], repeat=3)))
def test_a_pointer_whose_axes_were_set_goes_as_it_went(tmp_path, values):
    motion = {key: value for key, value in zip(AXES, values, strict=True) if value is not None}
    path = tmp_path / "config.yaml"
    lines = "".join(f"  {key}: {str(value).lower()}  # {key} as tried\n" for key, value in motion.items())
    path.write_text(f"schema: 1\nmotion:\n  counts_per_radian: 1\n{lines}")
    read = load(path, Configuration).motion
    if any(motion.values()):
        np.testing.assert_array_equal(read.matrix(None)[:2], before(motion))
    else:  # none is reversed: a hand on the ball moves the pointer its own way
        np.testing.assert_array_equal(read.matrix(None), MotionSettings(counts_per_radian=1.0).matrix(None))
    assert migrate.migrate_file(path)
    assert load(path, Configuration).motion == read
    assert not migrate.migrate_file(path)


def test_comments_stay_where_a_key_goes(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text(
        "schema: 1\nrig: null\nmotion:\n  # of the seat\n  invert_x: false\n  swap_xy: true  # by 90 degrees\n\n"
        "# ---- the ball ----\nso3: {gate: 9.0}\n"
    )
    assert migrate.migrate_file(path)
    assert path.read_text() == (
        "schema: 2\nrig: null\nmotion:\n  # of the seat\n  invert_x: false\n  player: left   # by 90 degrees\n\n"
        "# ---- the ball ----\nso3: {gate: 9.0}\n"
    )
    path.unlink()
    path.write_text("schema: 1\nmotion:\n  # of the seat\n  invert_x: true\n\n# ---- the ball ----\nso3: {gate: 9.0}\n")
    assert migrate.migrate_file(path)
    assert "\n\n# ---- the ball ----\nso3:" in path.read_text()


def test_what_is_no_setting_is_left_for_the_reader_to_refuse(tmp_path):
    path = tmp_path / "config.yaml"
    for motion, said in (
        ("{swap_xy: maybe}", "3: motion.swap_xy: is no more; a seat turned by 90 degrees is `player: left`"),
        ("{invert_x: 1}", "3: motion.invert_x: must be true or false"),
        ("12", "3: motion: must be a section"),
        ("{player: left, swap_xy: true}", "3: motion.swap_xy: is no more"),
    ):
        path.write_text(f"schema: 1\n# of the hall\nmotion: {motion}\n")
        with pytest.raises(ConfigurationError, match=re.escape(f"config.yaml:{said}")):
            load(path, Configuration)
