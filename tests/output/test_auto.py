"""`auto`: the order in which mice are tried, what it says, and that no foreign adapter is taken."""

from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from spheremouse.errors import OutputError
from spheremouse.output import desktop, open_output, serial, uinput
from spheremouse.output.third_axis import VALUES

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


def test_uinput_comes_first_then_the_board_then_the_desktop(world, capsys):
    world.uinput = world.desktop = True
    world.ports = [ADAPTER, BOARD]
    assert open_output("auto") == ("uinput", "")
    world.uinput = False
    assert open_output("auto") == ("serial", "auto,id=E661")
    world.ports = [ADAPTER]
    assert open_output("auto") == ("desktop", "")
    said = capsys.readouterr()
    assert said.out == ""
    first, second, third = said.err.splitlines()
    assert first == "auto: takes uinput"
    assert second == "auto: takes serial:auto,id=E661 (uinput: not here)"
    assert third.startswith("auto: takes desktop (uinput: not here | serial:auto: no board of ours among ")


def test_the_third_axis_is_passed_on(world):
    world.uinput = world.desktop = True
    assert open_output("auto:third=wheel") == ("uinput", "third=wheel")
    world.uinput, world.ports = False, [BOARD]
    assert open_output("auto:third=wheel") == ("serial", "auto,id=E661,third=wheel")
    world.ports = []
    assert open_output("auto:third=wheel") == ("desktop", "third=wheel")


def test_what_it_passes_on_is_what_the_outputs_take():
    assert all(set(VALUES["auto"]) <= set(VALUES[kind]) for kind in ("uinput", "serial", "desktop"))


def test_a_board_without_a_number_is_taken_by_its_port(world):
    world.ports = [{**BOARD, "serial_number": None}]
    assert open_output("auto") == ("serial", "/dev/ttyACM7")


def test_an_adapter_is_never_taken_for_a_board(world):
    """`serial:auto` takes the only adapter there is; here nobody has said that a board is behind it."""
    world.ports = [ADAPTER]
    with pytest.raises(OutputError) as e:
        open_output("auto")
    assert str(e.value).startswith("auto: found no mouse. uinput: not here | serial:auto: no board of ours among ")
    assert str(e.value).endswith(" | desktop: not here")


def test_several_boards_are_told(world):
    world.ports = [BOARD, {**BOARD, "device": "/dev/ttyACM9", "serial_number": "E662", "location": "1-2"}]
    with pytest.raises(OutputError, match=r"several boards.*id=E661.*id=E662"):
        open_output("auto")
