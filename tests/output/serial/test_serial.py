"""The serial output on real pseudo-terminals, with the firmware's own protocol at the other end."""

import contextlib
import os
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
import serial as pyserial
from reporting import PATIENCE, refused, report, until
from serial.tools import list_ports

from spheremouse.errors import OutputError
from spheremouse.output import open_output
from spheremouse.output import serial as output_module
from spheremouse.output.serial import Serial
from spheremouse.output.serial import link as link_module
from spheremouse.output.serial import ports as ports_module
from spheremouse.output.serial.messages import STOP, encode
from spheremouse.output.serial.ports import find_board
from spheremouse.output.third_axis import left_out

pty = pytest.importorskip("pty", reason="no pseudo-terminals here")
import termios  # noqa: E402
import tty  # noqa: E402

from simulated_board import Simulator, load_protocol  # noqa: E402  needs them


def opened(argument) -> Any:
    return open_output(f"serial:{argument}")


@pytest.fixture
def board():
    with Simulator() as simulator:
        yield simulator


def test_the_mouse_moves_by_the_counts_that_are_sent(board, capsys):
    with opened(f"{board.port},third=wheel") as output:
        for k in range(200):
            output.send(report(k % 7, -(k % 5), 1))
        until(lambda: output.link.settled)
        assert board.moved == [sum(k % 7 for k in range(200)), -sum(k % 5 for k in range(200)), 200, 0]
        assert output.link.acks > 0
        assert 0.0 < output.link.round_trip(0.5) <= output.link.round_trip(0.99)
        status = output.status(10.0)
        assert (status.reports, status.damaged) == (board.reports, 0)
    said = capsys.readouterr().err.splitlines()
    assert said[0] == f"serial: firmware 1.0.0 (simulator) on simulator at {board.port}"
    assert said[1].startswith("serial: round trip ")
    assert said[1].endswith("; every count arrived")
    assert len(said) == 2


@pytest.mark.parametrize(("third", "moved"), [("none", [1, 2, 0, 0]), ("wheel", [1, 2, 3, 0]), ("pan", [1, 2, 0, 3])])
def test_the_third_axis(board, third, moved):
    assert bool(left_out(f"serial:{board.port},third={third}")) is (moved[2:] == [0, 0])
    with opened(f"{board.port},third={third}") as output:
        output.send(report(1, 2, 3))
        until(lambda: output.link.settled)
    assert board.moved == moved


def test_closing_passes_on_the_last_motion_and_releases_buttons(board, monkeypatch):
    monkeypatch.setattr(output_module, "CLOSE_TIMEOUT", PATIENCE)
    with opened(f"{board.port}") as output:
        output.hold(0b11)
        until(lambda: board.buttons == 0b11)
        output.send(report(50_000, 0, 0))  # many frames: 600 at most in each
    assert board.moved[0] == 50_000
    until(lambda: board.buttons == 0)
    assert board.reports >= 50_000 / 600


def test_sending_never_waits_for_a_line_that_takes_nothing(board, monkeypatch):
    """The counts wait as one number, not as a queue of frames."""
    output = opened(f"{board.port}")
    monkeypatch.setattr(ports_module.Port, "write", lambda port, data: 0)
    frames = output.link.motions
    sender = threading.Thread(target=lambda: [output.send(report(1)) for _ in range(5_000)], daemon=True)
    sender.start()
    sender.join(20.0)
    assert not sender.is_alive()
    assert output.link.motions - frames <= 2
    output.close()


def test_a_computer_that_falls_asleep_is_reported_when_it_does_and_when_it_wakes(board, capsys):
    with opened(f"{board.port}") as output:
        output.send(report(5))
        until(lambda: output.link.settled)
        board.sleeps_next = True  # while the next report waits for it
        said = ""

        def logs(text):
            nonlocal said
            output.send(report())
            said += capsys.readouterr().err
            return text in said

        output.send(report(3))
        until(lambda: logs(output_module.NOT_TAKEN))
        assert board.moved[0] == 5
        board.awake = True
        until(lambda: logs(output_module.TAKEN))
        until(lambda: output.link.settled)
        assert board.moved[0] == 8
        board.awake = False
        until(lambda: logs(output_module.NOT_TAKEN))
        output.send(report(7))
    assert said.count(output_module.NOT_TAKEN) in (1, 2)
    assert capsys.readouterr().err.splitlines()[-1].endswith("; counts that did not arrive: 7 not confirmed at the end")


def returning(first, find_again):
    """An output whose board was just unplugged, and its log; `find_again` returns the port at the n-th call."""
    calls = []

    def find_port():
        calls.append(1)
        return first.port if len(calls) == 1 else find_again(len(calls))

    said = []
    output = Serial(find_port, 115200, "none", said.append)
    output.send(report(1))
    until(lambda: output.link.settled)
    first.unplug()
    return output, said


def test_a_board_comes_back_after_any_error_of_the_system(board, monkeypatch):
    """Lists of ports, and ports, raise odd errors while a board is plugged in."""
    real, fails = pyserial.Serial.reset_input_buffer, [termios.error(5, "Input/output error")]

    def reset(port):
        if fails:
            raise fails.pop()
        real(port)

    with Simulator() as second:

        def find_again(n):
            if n == 2:
                raise TypeError("int() can't convert non-string with explicit base")
            if n == 3:
                monkeypatch.setattr(pyserial.Serial, "reset_input_buffer", reset)
            return second.port

        output, said = returning(board, find_again)
        with output:
            until(lambda: any(s.endswith(f"{second.port} is back") for s in said))
            output.send(report(4))
            until(lambda: second.moved[0] == 4)
        assert not fails


def test_a_board_that_falls_silent_is_sought_at_its_port_again(board, monkeypatch):
    """The port of an adapter stays while its board is gone."""
    monkeypatch.setattr(output_module, "_SILENCE_TIMEOUT", 0.2)
    with Simulator() as second:
        ports, said = [second.port, board.port], []
        with Serial(lambda: ports.pop() if ports[1:] else second.port, 115200, "none", said.append) as output:
            output.send(report(1))
            until(lambda: output.link.settled)
            board.stalled = True
            until(lambda: output.send(report()) or any(s.endswith(f"{second.port} is back") for s in said))
            output.send(report(4))
            until(lambda: second.moved[0] == 4)
    assert f"{board.port}: no answer; trying again until it is back" in said


def test_sending_does_not_wait_for_a_port_that_closes_slowly(board, monkeypatch):
    """Systems drain a port that is closed, for up to 30 s."""
    closing, drained, close = threading.Event(), threading.Event(), ports_module.Port.close

    def drain(port):
        closing.set()
        drained.wait(10.0)
        close(port)

    def find_again(n):
        raise OutputError("gone")

    monkeypatch.setattr(ports_module.Port, "close", drain)
    output, _ = returning(board, find_again)
    assert closing.wait(10.0)
    sender = threading.Thread(target=lambda: output.send(report(1)), daemon=True)
    sender.start()
    sender.join(5.0)
    assert not sender.is_alive()
    drained.set()
    output.close()


def test_a_stop_after_half_a_frame_arrives(board, monkeypatch):
    """The line takes half a frame and then nothing until the output closes."""
    monkeypatch.setattr(output_module, "CLOSE_TIMEOUT", PATIENCE)  # not reached: all counts are confirmed
    monkeypatch.setattr(link_module, "SILENCE", PATIENCE)  # this test may be late, and the session would end
    output = opened(f"{board.port}")
    write, main = ports_module.Port.write, threading.main_thread()

    def narrow(port, data):
        return write(port, data[:5]) if threading.current_thread() is main else 0

    monkeypatch.setattr(ports_module.Port, "write", narrow)
    handle, kinds = board.device.handle, []
    board.device.handle = lambda line, now: (kinds.append(line.content[1]), handle(line, now))
    output.hold(1)  # five bytes
    output.close()
    until(lambda: STOP in kinds)
    until(lambda: not board.device.running and board.buttons == 0)


def test_a_board_of_another_version_that_comes_back_is_reported_once(board):
    other: Any = load_protocol()
    other.VERSION = 2
    with Simulator(protocol=other) as second:
        output, said = returning(board, lambda n: second.port)
        with output:
            until(lambda: len(said) == 3 or output.send(report()))
            time.sleep(0.3)
            assert len(said) == 3
            assert "the board speaks version 2 of the protocol, this program 1; update spheremouse" in said[2]


# ---- refusals ----


def test_arguments():
    assert refused("serial").startswith("serial: names no port; write serial:auto")
    assert "names no port" in refused("serial:baud=9600")
    assert "must be from 38400" in refused("serial:x,baud=9600")
    assert "goes with serial:auto" in refused("serial:x,id=3")


def test_ports_that_cannot_be_used(tmp_path, board, monkeypatch):
    assert "does not exist; there is " in refused(f"serial:{tmp_path / 'none'}")
    (tmp_path / "file").write_text("")
    assert "cannot be opened" in refused(f"serial:{tmp_path / 'file'}")
    with opened(f"{board.port}"):
        assert "in use by another program" in refused(f"serial:{board.port}")

    def gone(port, data):
        raise ports_module.PortGoneError("Input/output error")

    def comports():
        raise TypeError("int() can't convert non-string with explicit base")

    monkeypatch.setattr(ports_module.Port, "write", gone)
    assert "the port went away (Input/output error); plug the board in again" in refused(f"serial:{board.port}")
    monkeypatch.setattr(list_ports, "comports", comports)
    assert "ports are changing just now; try again" in refused("serial:auto")


@contextlib.contextmanager
def device_that_answers(data):
    """A port whose other end answers once."""
    master, slave = pty.openpty()
    try:
        tty.setraw(slave)

        def answer():
            os.read(master, 100)
            os.write(master, data)

        thread = threading.Thread(target=answer)
        thread.start()
        yield os.ttyname(slave)
        thread.join()
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (b"", "no board of ours answers; see `spheremouse firmware check`"),
        (b"\x05garb\0", "something answers, but garbled; use shorter wires"),
    ],
)
def test_a_port_without_a_valid_answer(monkeypatch, answer, problem):
    monkeypatch.setattr(output_module, "FIRST_ANSWER_TIMEOUT", 0.5)
    with device_that_answers(answer) as name:
        assert problem in refused(f"serial:{name}")


@pytest.mark.parametrize(
    ("version", "advice"), [(9, "update spheremouse"), (0, "load this program's firmware: `spher")]
)
def test_a_board_of_another_version(version, advice):
    with device_that_answers(encode(0x81, 0, bytes(44), version=version)) as name:
        said = refused(f"serial:{name}")
    assert f"the board speaks version {version} of the protocol, this program 1; {advice}" in said


# ---- which port ----


def port(device, product: Any = "", ids=(0x239A, 0x80F4), serial: Any = "E660", **more):
    place = {"interface": None, "location": None} | more
    return SimpleNamespace(device=device, product=product, vid=ids[0], pid=ids[1], serial_number=serial, **place)


def ours(device, serial="S1", **more):
    return port(device, "spheremouse", serial=serial, **more)


NONE = port("/dev/ttyS0", ids=(None, None))
CONSOLE = ours("/dev/ttyACM0", interface="CircuitPython CDC control", location="1-1:1.0")
DATA = ours("/dev/ttyACM1", interface="CircuitPython CDC2 control", location="1-1:1.2")
OTHER = ours("/dev/ttyACM3", "S3")
ADAPTERS = [
    port("/dev/ttyUSB0", "a make", ids, None, location="1-2")
    for ids in ((0x1A86, 0x7523), (0x067B, 0x23A3), (0x067B, 0x2303))
]
ADAPTER = ADAPTERS[0]
CLONES = [port(f"/dev/ttyUSB{k}", "CP2102", (0x10C4, 0xEA60), "0001", location=f"1-{k}") for k in (1, 4)]
TWINS = [ours(f"/dev/ttyACM{k}", "spheremouse", ids=(0x2341, 0x8036), location=f"1-{k}:1.0") for k in (0, 1)]
WINDOWS = [port("COM5", None, location="1-2:x.0"), port("COM6", None, location="1-2:x.2")]  # tells no names
AVR_WINDOWS = port("COM7", None, (0x2341, 0x8036), "SPHEREMOUSE", location="1-3:x.0")
PICO2_WINDOWS = [port(f"COM{k}", None, (0x2E8A, 0x000B), "E7", location=f"1-4:x.{k}") for k in (0, 2)]
FRESH = port("/dev/ttyACM0", "Pico", interface="CircuitPython CDC control", location="1-1:1.0")


@pytest.mark.parametrize(
    ("ports", "identifier", "found"),
    [
        ([CONSOLE, DATA, ADAPTER], None, "/dev/ttyACM1"),
        ([ours("/dev/ttyACM0", location="1-1:1.0"), ours("/dev/ttyACM1", location="1-1:1.2")], None, "/dev/ttyACM1"),
        ([ours("/dev/ttyACM0"), ours("/dev/ttyACM1")], None, "/dev/ttyACM1"),
        *(([NONE, adapter], None, "/dev/ttyUSB0") for adapter in ADAPTERS),
        ([ours("/dev/ttyACM1"), OTHER], "S3", "/dev/ttyACM3"),
        (WINDOWS, None, "COM6"),
        (WINDOWS, "E660", "COM6"),
        ([AVR_WINDOWS], None, "COM7"),
        (PICO2_WINDOWS, None, "COM2"),
    ],
)
def test_the_board_is_found_by_its_product_and_its_console_is_left_alone(ports, identifier, found):
    assert find_board(identifier, ports) == find_board(identifier, ports[::-1]) == found


@pytest.mark.parametrize(
    ("ports", "identifier", "problem"),
    [
        ([ours("/dev/ttyACM1"), OTHER, ADAPTER], None, r"several boards; write serial:auto,id=S1 \(/dev/ttyACM1\) or "),
        ([ours("/dev/ttyACM1"), OTHER], "S4", "no board with id=S4 among /dev/ttyACM"),
        ([NONE], None, "no board of ours is plugged in"),
        ([port("/dev/ttyACM7", "modem")], None, "among /dev/ttyACM7; name its port"),
        (WINDOWS[:1], None, "no board of ours among COM5"),  # may be a console
        (WINDOWS[:1], "E660", "no board with id=E660 among COM5"),
        ([FRESH], "E660", "no board with id=E660"),
        (CLONES, None, "several boards; write serial:/dev/ttyUSB1 or serial:/dev/ttyUSB4$"),
        (TWINS, None, "write serial:/dev/ttyACM0 or serial:/dev/ttyACM1$"),
        (TWINS, "spheremouse", "write serial:/dev/ttyACM0 or serial:/dev/ttyACM1$"),
    ],
)
def test_no_board_or_several(ports, identifier, problem):
    for order in (ports, ports[::-1]):
        with pytest.raises(OutputError, match=problem) as e:
            find_board(identifier, order)
        assert str(e.value) == f"{e.value.problem}; {e.value.hint}"
