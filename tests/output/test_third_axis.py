"""The third axis: what is said of an output is what it does with a report of nothing but spin."""

import os
from importlib import import_module
from tempfile import TemporaryFile
from unittest.mock import Mock

import pytest

from spheremouse import output as outputs
from spheremouse.output.desktop import Desktop
from spheremouse.output.third_axis import VALUES, left_out, sent_as
from spheremouse.output.uinput import UInput
from tests.reporting import refused, report

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
