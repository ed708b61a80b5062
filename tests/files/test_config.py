"""The configuration against a small tree of settings with every kind of parameter that the core may declare."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from invoking import refusal
from typer.testing import CliRunner

from spheremouse.commands import config as cli_config
from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.files import yaml as yaml_file
from spheremouse.session.config_check import Found
from spheremouse.session.settings import Configuration
from spheremouse.settings import param


@dataclass(frozen=True, slots=True)
class Mask:
    """One band of a value."""

    lower: int = param(0, "grey", "lower bound", ge=0, le=255)
    upper: int = param(255, "grey", "upper bound", ge=0, le=255)

    def __post_init__(self) -> None:
        if self.lower > self.upper:
            raise ValueError(f"lower {self.lower} is above upper {self.upper}; exchange them")


@dataclass(frozen=True, slots=True)
class Filter:
    """The filter: attitude and rate.

    What follows the first paragraph is for readers of the code.
    """

    acceleration_sigma: float = param(0.1, "rad/s²", "white noise of the angular acceleration", gt=0)
    window: tuple[int, int] = param((3, 5), "px", "half width and half height", ge=1)
    gains: tuple[float, ...] = param((1.0, 2.0), "-", "gains")
    mode: Literal["fast", "on", "null"] = param("fast", "-", "how")
    gate: float | None = param(None, "-", "none for no gate", gt=0, le=1)
    level: Literal["auto"] | float = param("auto", "grey", "a number, or found in the picture")
    enabled: bool = param(True, "-", "whether at all")
    names: tuple[str, ...] = param(("a",), "-", "names; " + "many words " * 30)
    mask: Mask = field(default_factory=Mask)
    constant: float = 7.0


@dataclass(frozen=True, slots=True)
class Inner:
    count: int = param(3, "-", "how many", ge=0)


@dataclass(frozen=True, slots=True)
class Outer:
    inner: Inner = field(default_factory=lambda: Inner(count=7))
    text: str = param("yes", "-", "a string that YAML 1.1 takes for true")


@dataclass(frozen=True, slots=True)
class Root:
    so3: Filter = field(default_factory=Filter)
    outer: Outer = field(default_factory=Outer)
    tracker: Literal["so3", "ekf1"] = param("so3", "-", "which filter")


@pytest.fixture
def check(tmp_path):
    """Settings of a text, read from a file."""

    def load(text):
        path = tmp_path / "c.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return config.load(path, Root)

    return load


@pytest.fixture
def problems(tmp_path, check):
    """Messages about a text, without the file's name."""

    def of(text):
        with pytest.raises(ConfigurationError) as e:
            check(text)
        return [line.removeprefix(f"{tmp_path / 'c.yaml'}:") for line in str(e.value).split("\n")]

    return of


def test_a_file_that_says_nothing_gives_the_defaults_whatever_its_line_ends(check):
    assert check("schema: 2\n") == Root()
    assert check("schema: 2\nso3:\n  # all commented out\nouter: {inner: }\n") == Root()
    assert check(b"\xef\xbb\xbfschema: 2\r\ntracker: ekf1\r\n") == Root(tracker="ekf1")


def test_what_a_file_says_replaces_only_that(check):
    settings = check(
        "schema: 2\nso3: {acceleration_sigma: 2, gains: [1, 2.5], gate: null, mask: {lower: 9}}\n"
        "outer:\n  inner: {}\n  text: 'no'\n"
    )
    expected = replace(
        Root(),
        so3=replace(Filter(), acceleration_sigma=2.0, gains=(1.0, 2.5), mask=Mask(lower=9)),
        outer=Outer(text="no"),
    )
    assert settings == expected
    assert isinstance(settings.so3.acceleration_sigma, float)
    assert isinstance(settings.so3.gains[0], float)
    assert settings.outer.inner.count == 7  # the tree's default, not the class's


numbers = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
masks = st.tuples(st.integers(0, 255), st.integers(0, 255)).map(lambda b: Mask(min(b), max(b)))
words = st.text(st.characters(codec="utf-8"), max_size=12)
filters = st.builds(
    Filter, acceleration_sigma=positive, window=st.tuples(st.integers(1, 99), st.integers(1)),
    gains=st.lists(numbers).map(tuple), mode=st.sampled_from(["fast", "on", "null"]),
    gate=st.none() | st.floats(0, 1, exclude_min=True), level=st.just("auto") | numbers, enabled=st.booleans(),
    names=st.lists(words, max_size=3).map(tuple), mask=masks
)  # fmt: skip
roots = st.builds(Root, so3=filters, outer=st.builds(Outer, text=words), tracker=st.sampled_from(["so3", "ekf1"]))


@settings(max_examples=30)
@given(roots)
def test_what_is_written_reads_back_the_same(root):
    """Both texts: the commented file of `config init`, and what `config show` prints."""
    for text in (config.dump_commented(root), config.dump(root, Root())):
        assert config.loads(yaml_file.parse_document(text, "text"), Root) == root


def test_the_commented_file_tells_all_of_every_parameter():
    text = config.dump_commented(Root())
    # YAML's comments wrap: compare without line breaks
    flat = " ".join(line.strip().removeprefix("# ") for line in text.splitlines())
    for cls in (Root, Filter, Outer, Inner, Mask):
        for f in fields(cls):
            if not f.metadata:
                assert (f"{f.name}:" in text) == is_dataclass(f.type)
                continue
            assert f"{f.name}:" in text
            meaning = " ".join(f.metadata["meaning"].split())
            assert meaning[1:] in flat, meaning
    assert "[rad/s²; > 0; default 0.1]" in flat
    assert "[one of so3, ekf1; default so3]" in flat
    assert "The filter: attitude and rate." in flat
    assert "readers of the code" not in flat
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("so3.acceleration_sigma=5e-1", replace(Root(), so3=Filter(acceleration_sigma=0.5))),
        ("so3.gate=null", Root()),
        ("so3.gate=# none", Root()),
        ("so3.gate= 1", replace(Root(), so3=Filter(gate=1.0))),
        ("so3.mask.upper=3", replace(Root(), so3=Filter(mask=Mask(0, 3)))),
        ("outer.inner.count=0", replace(Root(), outer=Outer(inner=Inner(0)))),
        ("outer.text=a=b", replace(Root(), outer=Outer(text="a=b"))),
        ("tracker=ekf1", replace(Root(), tracker="ekf1")),
    ],
)
def test_override_sets_one_value(assignment, expected):
    assert config.override(Root(), assignment) == expected


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("so3.aceleration_sigma=1", "--set so3.aceleration_sigma: unknown key; did you mean so3.acceleration_sigma?"),
        ("acceleration_sigma=1", "--set acceleration_sigma: unknown key; did you mean so3.acceleration_sigma?"),
        ("outer.inner=1", "--set outer.inner: a section; set one of outer.inner.count"),
        (
            "so3.gains=[a, b]",
            "--set so3.gains[0]: must be a number, is 'a'; the default is [1.0, 2.0]\n"
            "--set so3.gains[1]: must be a number, is 'b'; the default is [1.0, 2.0]",
        ),
        ("outer.inner.count=1.5", "--set outer.inner.count: must be a whole number, is 1.5; the default is 3"),
        ("tracker", "--set tracker: not KEY=VALUE; write for example section.name=1.5"),
    ],
)
def test_a_wrong_override_is_one_line_that_helps(assignment, message):
    with pytest.raises(ConfigurationError) as e:
        config.override(Root(), assignment)
    assert str(e.value) == message


def test_a_wrong_override_that_is_no_yaml():
    with pytest.raises(ConfigurationError, match=r"^--set so3.gains: not YAML: .*; mind"):
        config.override(Root(), "so3.gains=[1")
    with pytest.raises(ConfigurationError, match=r"^synthetic: traker: unknown key"):
        config.override(Root(), "traker=3", label="synthetic: ")


def test_every_problem_gets_its_line_and_advice(problems):
    text = """\
schema: 2
so3:
  aceleration_sigma: 3
  acceleration_sigma: "1"
  window: [1]
  gains: [1, x, .nan]
  gate: 2
  mask: {lower: 300,
         lowr: 3}
  names: a
  enabled: 1
  level: none
outer: 3
counts: 3
tracker: yes
foo: {a: 1}
"""
    assert problems(text) == [
        "3: so3.aceleration_sigma: unknown key; did you mean acceleration_sigma?",
        "4: so3.acceleration_sigma: must be a number, is '1'; the default is 0.1 rad/s²",
        "5: so3.window[1]: missing; the default is [3, 5] px",
        "6: so3.gains[1]: must be a number, is 'x'; the default is [1.0, 2.0]",
        "6: so3.gains[2]: must be a finite number, is nan; the default is [1.0, 2.0]",
        "7: so3.gate: must be at most 1, is 2; the default is null",
        "8: so3.mask.lower: must be at most 255, is 300; the default is 0 grey",
        "9: so3.mask.lowr: unknown key; did you mean lower?",
        "10: so3.names: must be a list [a, b, ...], is 'a'; the default is [a]",
        "11: so3.enabled: must be true or false, is 1; the default is true",
        "12: so3.level: must be 'auto', or must be a number, is 'none'; the default is auto",
        "13: outer: must be a section of `key: value` lines, is 3",
        "14: counts: unknown key; did you mean outer.inner.count?",
        "15: tracker: must be 'so3' or 'ekf1', is 'yes'; the default is so3",
        "16: foo: unknown key; known here: tracker, so3, outer",
    ]


def test_profiles_are_assignments_that_are_checked_and_not_in_force(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(
        "schema: 2\nprofiles:\n  doom:\n    motion.scale_x: 2\n    output: [uinput, 'text:a b']\n"
        "  menu: {motion.invert_y: true}\nmotion: {scale_x: 3}\n"
    )
    read = config.load(path, Configuration)
    assert (read.motion.scale_x, read.output) == (3.0, None)
    assert read.profiles == {
        "doom": ("motion.scale_x=2", "output=[uinput, 'text:a b']"),
        "menu": ("motion.invert_y=true",),
    }
    changed = config.in_force(path, read.profiles["doom"], Configuration)
    assert (changed.motion.scale_x, changed.outputs) == (2.0, ("uinput", "text:a b"))


@pytest.mark.parametrize(
    ("profiles", "problem"),
    [
        ("[a]", "2: profiles: must be sections, one for each profile"),
        ("\n  a b: {}", "3: profiles.a b: must be a name of letters, digits, '_' and '-'"),
        ("\n  a: 2", "3: profiles.a: must be a section of `motion.scale_x: 2` lines"),
        ("\n  a:\n    motion:\n      scale_x: 2", "4: profiles.a: motion: write `motion.KEY: VALUE` lines in place of"),
        ("\n  a:\n    motion.scale_q: 2", "4: profiles.a: motion.scale_q: unknown key; did you mean motion.scale_"),
        ("\n  a:\n    motion.scale_x: two", "4: profiles.a: motion.scale_x: must be a number, is 'two'; the default"),
        ("\n  a:\n    profiles: 2", "4: profiles.a: profiles: "),
    ],
)
def test_a_wrong_profile_is_refused_with_its_line(tmp_path, profiles, problem):
    path = tmp_path / "c.yaml"
    path.write_text(f"schema: 2\nprofiles: {profiles}\n")
    assert refusal(ConfigurationError, config.load, path, Configuration).startswith(f"{path}:{problem}")


def test_a_dataclass_that_checks_itself_is_heard(problems):
    text = "schema: 2\nso3:\n  mask:\n    lower: 5\n    upper: 3\n"
    assert problems(text) == ["3: so3.mask: lower 5 is above upper 3; exchange them"]


@pytest.mark.parametrize("value", ["true", "'1'", "1e400", ".nan", "[]", "{}", "2020-01-01", "0x1g", "-1", "~"])
@pytest.mark.parametrize("text", ["outer: {inner: {count: %s}}", "so3: {acceleration_sigma: %s}"])
def test_no_value_becomes_a_number_by_surprise(problems, text, value):
    (line,) = problems(f"schema: 2\n{text % value}\n")
    assert re.match(r"2: [a-z0-9.]+\.(count|acceleration_sigma): must be ", line)
    assert len(line) < 200


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("", "1: empty; the first line must have its `schema`"),
        ("# only a comment\n", "1: empty;"),
        ("so3: {}\n", "1: schema: missing;"),
        ("schema: 3\n", "1: schema: is 3; this program reads version 2: update"),
        ("so3: {}\nschema: '1'\n", "2: schema: is '1';"),
        ("schema: true\n", "1: schema: is true;"),
        ("[1]\n", "1: must be `key: value` lines"),
        ("word", "1: must be `key: value` lines"),
        ("schema: 2\nso3:\n  mode: on\n  mode: fast\n", "3: so3.mode: stands here and in line 4; remove one"),
        ("schema: 2\nso3: [1\n", "3: not YAML: column 1: "),
        ("schema: 2\nso3: a: b\n", "2: not YAML: column 7: mapping values are not allowed here;"),
        ("schema: 2\n\tso3: 1\n", "2: not YAML: column 1: "),
        ("schema: 2\nso3: \x00\n", "2: not YAML: a character that YAML does not allow"),
        (b"schema: 2\n\xff\xfe\n", "2: is not UTF-8 text"),
        (b"\xef\xbb\xbfschema: 2\n\xff\xfe\n", "2: is not UTF-8 text"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "1: is not UTF-8 text"),
        ("schema: 2\n--- \nschema: 2\n", "2: a second document begins here"),
        ("schema: 2\na: &a [*a]\n", "2: aliases (*a) are not read; write the value out"),
        ("schema: 2\na: &a {b: 1}\nc: {<<: *a}\n", "3: aliases"),
        ("schema: 2\na: !!python/object/apply:os.system [echo]\n", "2: tags "),
        ("schema: 2\n? [a]\n: 1\n", "2: ?: a key must be a word"),
        ('schema: 2\n"a\\nb": 1\n', "2: 'a\\nb': unknown key"),
        ("schema: 2\n" + "k" * 500 + ": 1\n", f"2: {'k' * 57}...: unknown key"),
        ("schema: 2\na: " + "[" * 5000, "2: nested deeper than 20 levels"),
        ("schema: 2\nball: {}\nso3: {}\ndiscs: 3\ntargets: []\n",
         "2: ball: is this a configuration? It has no keys ball, discs, targets"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_configuration_is_refused_with_its_line(problems, text, start):
    (line,) = problems(text)
    assert line.startswith(start)


def test_what_is_not_a_readable_file_is_refused(tmp_path):
    big = tmp_path / "big.yaml"
    big.write_text("schema: 2\n" + "#" * yaml_file.MAX_BYTES)
    cases = {
        tmp_path: "is a directory",
        tmp_path / "none.yaml": "no such file",
        tmp_path / "x" / "none.yaml": "no such file",
        tmp_path / ("n" * 300): "cannot be read",
        tmp_path / "a\0b": "cannot be read",
        big: "larger than",
    }
    for path, text in cases.items():
        with pytest.raises(ConfigurationError, match=text) as e:
            config.load(path, Root)
        assert "\n" not in str(e.value)
    if os.path.exists("/dev/zero"):
        with pytest.raises(ConfigurationError, match="is not a file"):
            config.load(yaml_file.Path("/dev/zero"), Root)


PIECES = "schema: 2\n|so3:|\n|  |- |{|}|[|]|:| |'|\"|&a|*a|!!int|#|>|? |%YAML 1.1\n|---|...|0x|1_0|1e9|.nan|~|\t|é|<<|@"
pieces = st.sampled_from([*PIECES.split("|"), "|", ",", "\u2028", "gains"])


@given(st.lists(pieces, max_size=25).map("".join) | st.text(max_size=60))
def test_no_text_gets_past_as_anything_but_settings_or_a_configuration_error(text):
    message = ""
    try:
        assert is_dataclass(config.loads(yaml_file.parse_document(text, "text"), Root))
    except ConfigurationError as e:
        message = str(e)
    assert all(line.startswith("text:") for line in message.splitlines())


def test_the_settings_of_daily_use_are_thirty_and_are_written_with_their_defaults():
    text = config.dump_commented(Configuration(), Configuration.COMMON)
    assert config.loads(yaml_file.parse_document(text, "text"), Configuration) == Configuration()
    known = {".".join(map(str, key)) for key, _ in config.parameters(Configuration())}
    assert set(Configuration.COMMON) <= known
    assert len(set(Configuration.COMMON)) == len(Configuration.COMMON) == 30
    written = [line.split(":")[0] for line in text.splitlines() if ": " in line and not line.strip().startswith("# ")]
    assert len(written) == 30  # `schema` and all but `output`, which is a comment


def test_every_parameter_of_the_program_says_what_it_is():
    found = {about["key"]: about for about in config.describe(Configuration())}
    assert found["motion.counts_per_mm"]["unit"] == "counts/mm"
    assert [key for key, about in found.items() if len(about["meaning"]) <= 5] == []


@pytest.fixture
def run(monkeypatch, tmp_path):
    """`spheremouse config ...` with the settings of this file, in an empty folder."""
    monkeypatch.setattr("spheremouse.session.settings.Configuration", Root)
    monkeypatch.setattr(Root, "COMMON", None, raising=False)
    monkeypatch.setattr("spheremouse.session.config_check.validate", lambda *_: Found())  # these settings name nothing
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(cli_config.app, arguments)


def test_init_writes_what_check_accepts_and_show_reads(run, tmp_path, monkeypatch):
    assert run("init", "my.yaml").output == "my.yaml: written\n"
    assert (tmp_path / "my.yaml").read_text() == config.dump_commented(Root())
    monkeypatch.setattr(Root, "COMMON", ("outer.inner.count",))
    assert run("init", "few.yaml").output == "few.yaml: written\n"
    assert yaml_file.read_document(tmp_path / "few.yaml").data == {"schema": 2, "outer": {"inner": {"count": 7}}}
    assert run("init", "--all", "all.yaml").output == "all.yaml: written\n"
    assert (tmp_path / "all.yaml").read_text() == config.dump_commented(Root())
    assert run("check", "my.yaml").output == "my.yaml: ok\n"
    again = run("init", "my.yaml")
    assert str(again.exception) == "my.yaml: there already; name another file, or replace it with --force"
    assert run("init", "my.yaml", "--force").exit_code == 0
    result = run("show", "--config", "my.yaml", "--set", "so3.gate=0.5")
    assert result.exit_code == 0
    assert [line.strip() for line in result.stdout.splitlines() if "default" in line] == ["gate: 0.5  # default: null"]


def test_check_and_show_print_problems_and_fail(run, tmp_path, spheremouse):
    (tmp_path / "my.yaml").write_text("schema: 2\ntraker: so3\nso3: {gate: 7}\n")
    expected = (
        "my.yaml:2: traker: unknown key; did you mean tracker?\n"
        "my.yaml:3: so3.gate: must be at most 1, is 7; the default is null\n"
    )
    result = run("check", "my.yaml")
    assert (result.exit_code, result.stdout, result.stderr) == (2, "", expected)
    shown = run("show", "--config", "my.yaml")
    assert (shown.stdout, f"{shown.exception}\n") == ("", expected)
    assert spheremouse.fail("config", "show", "--set", "x=1").startswith("--set x: unknown key")


def test_a_written_null_output_is_the_output_null_and_none_is_written_as_a_comment(tmp_path):
    path = tmp_path / "c.yaml"
    for text, output in (("output: null", "null"), ("output:", "null"), ('output: "null"', "null"), ("", None)):
        path.write_text(f"schema: 2\n{text}\n")
        settings = config.load(path, Configuration)
        assert settings.output == output
        for written in (config.dump(settings, Configuration()), config.dump_commented(settings)):
            path.write_text(written)
            assert config.load(path, Configuration) == settings
    assert config.override(Configuration(), "output=null").output == "null"


@pytest.mark.parametrize("size", ["640x480", "640 x 480", "[640, 480]"])
def test_a_size_may_be_written_as_people_write_it(size):
    assert config.override(Configuration(), f"camera.size={size}").camera.size == (640, 480)


@pytest.mark.parametrize("size", ["640", "640x", "640*480", "640x480x3", "0x0", "99999999999x480"])
def test_another_size_is_refused(size):
    with pytest.raises(ConfigurationError, match=r"--set camera\.size: must be "):
        config.override(Configuration(), f"camera.size={size}")


def test_a_value_of_ctl_set_is_parsed_without_a_look_at_the_disk():
    code = """if True:
        import sys
        from spheremouse.files.yaml import parse_value
        parse_value("1", "a")  # loads code
        seen = []
        disk = ("open", "os.listdir", "os.scandir")
        sys.addaudithook(lambda event, _: seen.append(event) if event in disk else None)
        print(parse_value("2.5", "a"), seen)"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout == "2.5 []\n"
