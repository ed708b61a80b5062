"""device.yaml and lengths: what a person writes reads back in metres; what cannot be meant is said with its line."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from invoking import refusal
from numpy.testing import assert_allclose

from spheremouse.ball.device import Axes, Distance
from spheremouse.calibrate.board import parse_board, parse_length
from spheremouse.calibrate.prints.sheets import TARGETS
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.device import device_template, is_untouched, load_device

TEXT = """\
targets:
  - {id: 1, code: MCY}
  - {id: 2, code: CYM}
  - {id: 7, code: YMC}
target_radii: [0.012, 0.024, 0.036]
disc_radius: 0.02
axes: {origin: 2, up: 1, plane: 7}
distances:
  - {from: 1, to: 2, metres: 0.750, sigma: 0.001}
  - {from: 2, to: 7, metres: 0.650, sigma: 0.002}
"""


@pytest.fixture
def read(tmp_path):
    """Read the device file with one change."""

    def read_(old="", new=""):
        assert old in TEXT
        path = tmp_path / "device.yaml"
        path.write_text(TEXT.replace(old, new, 1))
        return load_device(path)

    return read_


def test_all_of_it_is_read(read):
    device = read()
    assert device.ids == (1, 2, 7)
    assert device.codes == ("MCY", "CYM", "YMC")
    assert_allclose(device.target_radii, [0.012, 0.024, 0.036])
    assert device.disc_radius == 0.02
    assert device.axes == Axes(origin=2, up=1, plane=7)
    assert device.distances == (Distance(1, 2, 0.75, 0.001), Distance(2, 7, 0.65, 0.002))


def test_a_schema_may_stand_there_and_must_be_ours(read):
    assert read("targets:", "schema: 1\ntargets:").ids == (1, 2, 7)
    with pytest.raises(ConfigurationError, match=":1: schema: is 2"):
        read("targets:", "schema: 2\ntargets:")


def test_distances_may_be_missing_and_a_pair_measured_twice_counts_twice(read):
    given = TEXT[TEXT.index("distances") :]
    assert read(given).distances == read(given, "distances: []\n").distances == ()
    assert len(read("from: 2, to: 7", "from: 2, to: 1").distances) == 2


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("id: 2", "id: 1", 3, ["targets[1].id", "1 names another target"]),
        ("CYM", "MCY", 3, ["targets[1].code", "MCY is on another target", "once"]),
        ("  - {id: 7, code: YMC}\n", "", 1, ["targets", "at least 3"]),
        ("plane: 7", "plane: 3", 7, ["axes.plane", "3 is no target", "1, 2, 7"]),
        ("plane: 7", "plane: 1", 7, ["axes.plane", "1 is named for another axis", "three different"]),
        ("0.012, 0.024", "0.024, 0.012", 5, ["must grow"]),
        ("[0.012, 0.024, 0.036]", "[12, 24, 36]", 5, ["give metres: 0.012, 0.024, 0.036 if that was mm"]),
        ("[0.012, 0.024, 0.036]", "[0.12, 0.24, 0.36]", 10, ["0.65 m", "would overlap", "target_radii"]),
        ("disc_radius: 0.02", "disc_radius: 20", 6, ["0.02 if that was mm"]),
        ("0.750", "750", 9, ["distances[0].metres", "0.75 if that was mm"]),
        ("0.750", "75", 9, ["0.75 if that was cm"]),
        ("from: 1, to: 2", "from: 1, to: 1", 9, ["target 1 to itself"]),
        ("from: 1, to: 2", "from: 9, to: 2", 9, ["distances[0].from", "9 is no target"]),
        ("sigma: 0.001", "sigma: 1", 9, ["sigma", "is 1 m for a length of 0.75 m"]),
    ],
)
def test_what_cannot_be_meant_is_said_with_its_line(read, old, new, line, words):
    with pytest.raises(ConfigurationError) as e:
        read(old, new)
    text = "\n".join(text for text in str(e.value).splitlines() if f"device.yaml:{line}: " in text)
    for word in words:
        assert word in text


def test_the_template_loads_and_its_examples_do_too(tmp_path):
    path = tmp_path / "device.yaml"
    path.write_text(device_template())
    assert load_device(path).distances == ()  # nothing that nobody measured
    assert is_untouched(path)
    filled = "\n".join(device_template().splitlines()[1:]).replace("distances: []\n# ", "")
    path.write_text(filled.replace("\n#   - {", "\n  - {").replace("\n# - {", "\n  - {"))
    device = load_device(path)
    assert not is_untouched(path)
    assert len(device.distances) == 4
    assert dict(zip(device.ids, device.codes, strict=True)) == TARGETS  # the numbers on the printed ones


@pytest.mark.parametrize("text", ["254mm", "254 mm", "25.4cm", "0.254m", ".254 m", "254.0MM", " 2.54e2mm ", "10in"])
def test_a_length_is_the_same_in_any_unit(text):
    assert parse_length(text) == 0.254


@given(st.integers(1, 99_999))
def test_tenths_of_a_millimetre_are_exact(tenths):
    assert parse_length(f"{tenths / 10}mm") == float(f"{tenths}e-4")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("86", "86mm or 86cm"),
        ("0.086", "needs its unit"),
        ("86km", "'km' is not a unit"),
        ("8,6cm", "a point, not a comma"),
        ("mm", "no length"),
        ("", "no length"),
        ("-3mm", "no length"),
        ("0mm", "longer than 0"),
        ("750m", "check the unit"),
        ("1e999mm", "check the unit"),
        ("nanmm", "no length"),
    ],
)
def test_a_length_that_is_none_says_how_to_write_one(text, words):
    assert words in refusal(CalibrationError, parse_length, text)


@pytest.mark.parametrize("text", ["11x8", "11X8", " 11 x 8", "11×8"])
def test_a_board_is_columns_and_rows(text):
    assert parse_board(text) == (11, 8)
    assert parse_board(text).rows == 8


@pytest.mark.parametrize("text", ["11", "11x", "axb", "11x8x2", "-11x8", "2x8", "11x2000", "", "1 1x8"])
def test_a_board_that_is_none_says_how_to_write_one(text):
    with pytest.raises(CalibrationError, match="inner corners"):
        parse_board(text)
