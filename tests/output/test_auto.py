"""The output that is chosen by itself, and the axis that some outputs lack."""

import os
from importlib import import_module
from tempfile import TemporaryFile
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from serial.tools import list_ports

from spheremouse import output as outputs
from spheremouse.errors import OutputError
from spheremouse.output import desktop, open_output, serial, uinput
from spheremouse.output.desktop import Desktop
from spheremouse.output.third_axis import VALUES, left_out, sent_as
from spheremouse.output.uinput import UInput
from tests.reporting import refused, report

BOARD = {"device": "/dev/ttyACM7", "vid": 0x239A, "pid": 0x80F4, "product": "spheremouse", "serial_number": "E661"}
ADAPTER = {"device": "/dev/ttyUSB3", "vid": 0x0403, "pid": 0x6001, "product": "FT232R", "serial_number": "A5"}


@pytest.fixture
def world(monkeypatch):
    """Which mice there are; opening one gives its kind and argument."""
    here = SimpleNamespace(uinput=False, desktop=False, ports=[])

    def opener(kind, there):
        def opened(argument):
            if not there():
                raise OutputError(f"{kind}: not here")
            return kind, argument

        return opened

    def port(entries):
        defaults = {"location": "1-1", "interface": None, "hwid": "", "name": "", "description": ""}
        return SimpleNamespace(**{**defaults, **entries})

    monkeypatch.setattr(uinput, "open", opener("uinput", lambda: here.uinput))
    monkeypatch.setattr(desktop, "open", opener("desktop", lambda: here.desktop))
    monkeypatch.setattr(serial, "open", opener("serial", lambda: True))
    monkeypatch.setattr(list_ports, "comports", lambda *_: [port(entries) for entries in here.ports])
    return here


NUMBERLESS = {**BOARD, "serial_number": None}  # and so taken by its port


@pytest.mark.parametrize(
    ("uinput", "ports", "kind", "argument", "said"),
    [
        (True, [ADAPTER, BOARD], "uinput", "", "auto: takes uinput\n"),
        (False, [ADAPTER, BOARD], "serial", "auto,id=E661", "auto: takes serial:auto,id=E661 (uinput: not here)\n"),
        (False, [NUMBERLESS], "serial", "/dev/ttyACM7", "auto: takes serial:/dev/ttyACM7 (uinput: not here)\n"),
        (False, [ADAPTER], "desktop", "", "auto: takes desktop (uinput: not here | serial:auto: no board of ours "),
    ],
)
def test_uinput_comes_first_then_the_board_then_the_desktop(world, capsys, uinput, ports, kind, argument, said):
    world.uinput, world.desktop, world.ports = uinput, True, ports
    assert open_output("auto") == (kind, argument)
    out, err = capsys.readouterr()
    assert (out, err[: len(said)]) == ("", said)
    assert open_output("auto:third=wheel") == (kind, ",".join(filter(None, (argument, "third=wheel"))))


def test_an_adapter_is_never_taken_for_a_board(world):
    """`serial:auto` takes the only adapter there is; here nobody has said that a board is behind it."""
    world.ports = [ADAPTER]
    with pytest.raises(OutputError) as e:
        open_output("auto")
    assert str(e.value).startswith("auto: found no mouse. uinput: not here | serial:auto: no board of ours among ")
    assert str(e.value).endswith(" | desktop: not here")


SPIN = report(z=240)  # two notches


def calls(kind, way):
    """What a report of nothing but spin makes the device do: its calls, or the bytes written to it."""
    with TemporaryFile() as file:
        device = Mock(fd=file.fileno())
        {"uinput": UInput, "desktop": Desktop}[kind](device, way).send(SPIN)
        return device.method_calls or os.pread(file.fileno(), 4096, 0)


@pytest.mark.parametrize("kind", ["uinput", "desktop"])
def test_it_is_left_out_where_the_output_makes_nothing_of_a_spin(kind):
    for way in ("none", *VALUES[kind]):
        spec = f"{kind}:third={way}"
        assert bool(left_out(spec)) is not bool(calls(kind, way)), spec
        assert bool(sent_as(spec)) is not bool(left_out(spec)), spec
    assert str(left_out(kind)) == str(left_out(f"{kind}:third=none"))


def test_the_notice_names_the_output_and_every_way_that_it_has():
    notice, of_serial = left_out("uinput"), left_out("serial:/dev/ttyACM0,baud=115200")
    assert notice
    assert of_serial
    assert notice.problem == "the third axis (the ball's spin) is not sent: output uinput has no `third=`"
    assert notice.hint == "third=wheel or third=rz sends it (docs/outputs.md)"
    assert of_serial.hint.startswith("third=wheel or third=pan sends it")
    assert left_out("serial:auto, third = pan ,id=E661") is None


def test_of_a_text_of_nothing_and_of_others_outputs_nothing_is_said(tmp_path):
    for spec in ("text:-", f"text:{tmp_path}/third=none", "null", "lamp:red", ""):
        assert (left_out(spec), sent_as(spec)) == (None, ""), spec


def test_every_output_with_a_third_axis_is_known_here():
    """Each output that reads `third=` with the functions of this module has its values in the table."""
    readers = {
        kind
        for kind in outputs.KINDS
        if {"parse_third", "validate_third"} & set(vars(import_module(f"spheremouse.output.{kind}")))
    }
    assert set(VALUES) == readers


@pytest.mark.parametrize(
    ("spec", "others"), [("auto:", ""), ("desktop:", ""), ("uinput:", ", rz"), ("serial:x,", ", pan")]
)
def test_a_wrong_argument_is_refused_with_the_right_ones(spec, others):
    kind = spec.partition(":")[0]
    assert refused(f"{spec}third=whel") == f"{kind}: third=whel; write third= with one of none, wheel{others}"
    assert "unknown key thrid; did you mean third?" in refused(f"{spec}thrid=wheel")
    assert "'wheel' is not KEY=VALUE" in refused(f"{spec}wheel")
