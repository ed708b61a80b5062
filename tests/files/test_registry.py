"""Plug-ins: sources and outputs of other distributions, by their entry points; refused where they are none."""

import sys

import pytest
from reporting import report

from spheremouse.capture import full_spec, open_source
from spheremouse.errors import OutputError, SourceError
from spheremouse.output import open_output

OUTPUT = """
from spheremouse.output import Output
class Lamp(Output):
    def __init__(self, argument): self.argument, self.sent = argument, []
    def __enter__(self): return self
    def __exit__(self, *_): return None
    def send(self, report): self.sent.append(report)
def open(argument): return Lamp(argument)
"""
WITHOUT_METHODS = """
class Lamp:
    def __init__(self, argument):
        vars(self).update(dict.fromkeys("paced blocks period hang_hint begin delivery drop_waiting close".split()))
        self.send = lambda report: {}['red']
    def __enter__(self): return self
    def __exit__(self, *_): return None
def open(argument): return Lamp(argument)
"""
SOURCE = """
from spheremouse.capture import Stream
def open(argument, realtime): return Stream(iter([argument]))
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """(group, text) installs a distribution whose module `lamp_plugin` has this text, as the kind `lamp`."""

    def install(group, text):
        (tmp_path / "lamp_plugin.py").write_text(text, encoding="utf-8")
        info = tmp_path / "lamp-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lamp\nVersion: 1.0\n", encoding="utf-8")
        (info / "entry_points.txt").write_text(f"[{group}]\nlamp = lamp_plugin\n", encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "lamp_plugin", raising=False)

    return install


def test_an_output_of_another_distribution_is_opened_by_its_name(installed):
    installed("spheremouse.output", OUTPUT)
    with open_output("lamp:red") as lamp:
        lamp.send(report(stamp=0.5))
    assert (lamp.argument, len(lamp.sent)) == ("red", 1)
    with pytest.raises(OutputError, match=r"'lmap'; .*; did you mean lamp\?"):
        open_output("lmap")


@pytest.mark.parametrize(
    ("given", "full"),
    [
        ("/dev/video0", "v4l2:/dev/video0"),
        ("/dev/v4l/by-id/usb-x-index0", "v4l2:/dev/v4l/by-id/usb-x-index0"),
        ("{}/play", "dataset:{}/play"),
        ("{}/film.mkv", "video:{}/film.mkv"),
        ("dataset:{}/play", "dataset:{}/play"),
        ("{}", "{}"),
        ("synthetic", "synthetic"),
        ("a\0b", "a\0b"),
        ("a" * 5000, "a" * 5000),
    ],
)
def test_a_path_names_a_source_without_its_kind(tmp_path, given, full):
    (tmp_path / "play").mkdir()
    (tmp_path / "play/scene.json").write_text("{}")
    (tmp_path / "film.mkv").write_text("")
    assert full_spec(given.format(tmp_path)) == full.format(tmp_path)


def test_so_is_a_source(installed):
    installed("spheremouse.source", SOURCE)
    with open_source("lamp:frame") as frames:
        assert list(frames) == ["frame"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (OUTPUT.replace("Lamp(Output)", "Lamp").replace("def send", "def emit"), "contract: has no .*send, "),
        (OUTPUT.replace("def open", "def begin"), r"lamp_plugin breaks the contract: has no function `open`; update"),
        ("import a_module_that_is_missing", r"cannot be loaded \(ModuleNotFoundError: No module named 'a_module"),
        ("def open(:", r"cannot be loaded \(SyntaxError: "),
    ],
)
def test_one_that_breaks_the_contract_is_refused_in_a_line_that_names_it(installed, text, message):
    installed("spheremouse.output", text)
    with pytest.raises(OutputError, match=message) as e:
        open_output("lamp:")
    assert "\n" not in str(e.value)


def test_a_source_without_a_rate_is_refused_before_a_frame(installed):
    installed("spheremouse.source", "def open(argument, realtime): return iter([])")
    with pytest.raises(SourceError, match="source lamp: breaks the contract: has no rig, live, fps, count, __enter__"):
        open_source("lamp:")


@pytest.mark.parametrize(
    "text",
    [
        OUTPUT.replace("def open(argument): return", "def open(argument): {}['red'];"),
        OUTPUT.replace("self.sent.append(report)", "{}['red']"),
        OUTPUT.replace("def __enter__(self): return self", "def __enter__(self): return {}['red']"),
        WITHOUT_METHODS,
    ],
)
def test_an_exception_of_an_output_names_the_plug_in(installed, text):
    installed("spheremouse.output", text)
    message = r"output lamp: the plug-in lamp_plugin fails \(KeyError: 'red'\); update it, or uninstall it"
    with pytest.raises(OutputError, match=message), open_output("lamp:red") as lamp:
        lamp.send(report(stamp=0.5))


def test_an_exception_of_a_source_names_the_plug_in(installed):
    installed("spheremouse.source", SOURCE.replace("iter([argument])", "iter([argument, 1 // 0] for _ in 'a')"))
    message = r"source lamp: the plug-in lamp_plugin fails \(ZeroDivisionError: .*\); update it, or uninstall it"
    with pytest.raises(SourceError, match=message), open_source("lamp:frame") as frames:
        list(frames)
