"""The firmwares: byte by byte against the board of serial_world, their report descriptor, the way onto a drive."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from functools import partial, partialmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, call

import avr_board
import numpy as np
import pytest
from invoking import fail, invoke, succeed
from reporting import PATIENCE
from serial_world import Board, conversation

from spheremouse.commands.firmware import app
from spheremouse.files.access import service_files
from spheremouse.output import serial as output_module
from spheremouse.output.serial import firmware, messages
from spheremouse.output.serial import link as host

HERE = Path(__file__).parents[2]
PICO = service_files(firmware.PICO)
MICROPYTHON = "@micropython/micropython-webassembly-pyscript@1.27.0"


# ---- the same bytes ----


@pytest.fixture(scope="module")
def micropython():
    """Calls functions of firmware_on_a_desk.py; the interpreter comes from the npm registry, once."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("MicroPython's WebAssembly build needs node and npm")
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "spheremouse-tests" / "micropython-1.27.0"
    if not (cache / "package" / "micropython.mjs").exists():
        cache.mkdir(parents=True, exist_ok=True)
        command = ["npm", "pack", MICROPYTHON, "--pack-destination", str(cache)]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=60, cwd=cache)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
            pytest.skip("MicroPython's WebAssembly build cannot be fetched from the npm registry")
        (archive,) = cache.glob("*.tgz")
        shutil.unpack_archive(archive, cache)
    files = [
        *(PICO / f"{name}.py" for name in ("frames", "protocol", "mouse")),
        HERE / "data" / "firmware_on_a_desk.py",
    ]
    command = ["node", HERE / "data" / "firmware_driver.mjs", cache / "package", *files]
    process: Any = subprocess.Popen(
        [str(c) for c in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )

    def call(name, argument=""):
        text = argument if isinstance(argument, str) else json.dumps(argument)
        process.stdin.write(f"{name} {text}\n")
        process.stdin.flush()
        answer = json.loads(process.stdout.readline())
        assert "error" not in answer, answer["error"]
        return answer

    yield call
    process.stdin.close()
    process.wait(10)


class MicroPythonBoard:
    """As serial_world.Board, in the other interpreter."""

    def __init__(self, call):
        self._call, self.asked = call, {"reset": True, "feature": 0b101, "usb": True}
        self.buttons, self.tries = 0, 0
        self._began = call("moved")
        self.moved = [0, 0, 0, 0]

    def turn(self, data, now):
        answer = self._call("turn", {"now": now, "bytes": data.hex(), **self.asked})
        self.asked = {}
        self.moved = [m - b for m, b in zip(answer["moved"], self._began, strict=True)]
        self.buttons, self.tries = answer["buttons"], answer["tries"]
        return bytes.fromhex(answer["bytes"])


@pytest.mark.slow
def test_micropython_and_cpython_answer_the_same_to_anything(micropython):
    assert micropython("version")[0] == "micropython"
    here, there = Board(identity=(1, b"desk")), MicroPythonBoard(micropython)
    for ms, line, data in conversation(np.random.default_rng(1)):
        if line == 0 and len(data) <= 128:  # one turn of the loop reads no more, and answers once
            now = ms + 2**29 - 3000 & 0x1FFFFFFF
            assert there.turn(data, now) + there.turn(b"", now) + there.turn(b"", now) == here.turn(data, now)
            assert (there.moved, there.buttons) == (here.moved, here.buttons)


@pytest.mark.parametrize("seed", range(3))
def test_avr_and_pico_answer_the_same_to_anything(seed):
    """The AVR's protocol code, compiled here, gives the same answers and reports, also while the clocks wrap."""
    begin = 2**32 - 700
    avr, pico = avr_board.Board(avr_board.build(), begin), Board(identity=(2, b"test"))
    avr.multipliers(0b101)
    rng, kinds = np.random.default_rng(seed), set()
    for ms, line, data in conversation(rng):
        now = begin + ms & 0xFFFFFFFF
        if rng.random() < 0.02:
            pico.awake = bool(rng.random() < 0.7)
            avr.usb(pico.awake)
        if rng.random() < 0.02:
            feature = int(rng.integers(16))
            avr.multipliers(feature)
            pico.device.set_multipliers(feature)
        for part in [b"", *re.findall(rb"[^\0]*\0|[^\0]+", data)]:  # both obey one frame at a time
            found = avr.turn(part, now, line)
            assert found == pico.turn(part, now & 0x1FFFFFFF, line)
            kinds |= {type(messages.parse(frame)) for frame in messages.Splitter().take(found)}
            assert (list(avr.moved), avr.reports, avr.buttons) == (pico.moved, pico.reports, pico.buttons)
    assert kinds == {messages.Identity, messages.Ack, messages.Status}
    assert avr.reports > 100


def test_the_loop_allocates_nothing(micropython):
    """With the collector off, thousands of turns leave the heap as it was."""
    frames = b"\0" + messages.hello(0, 77)
    frames += b"".join(messages.motion(k, (k, 3 * k, 2 * k, -k), k & 31) for k in range(1, 3000))
    frames += b"".join(messages.encode(messages.ASK_STATUS, k) for k in range(100)) + b"\x55" * 1000 + b"\0\3\0"
    MicroPythonBoard(micropython).turn(b"", 99)
    micropython("allocated", {"bytes": frames[:2000].hex(), "step": 19, "now": 0})  # the first turns make their names
    found = micropython("allocated", {"bytes": frames.hex(), "step": 19, "now": 100})
    assert found["bytes"] == 0
    assert micropython("allocated", {"bytes": frames.hex(), "step": 190, "now": 100_000})["bytes"] == 0


def acked(board, frame, now, **asked):
    """The last ACK to a frame; `asked` of the desk."""
    board.asked |= asked
    ack = [messages.parse(f) for f in messages.Splitter().take(board.turn(frame, now))][-1]
    assert isinstance(ack, messages.Ack)
    return ack


def test_a_computer_that_fetches_no_reports(micropython):
    """Trying costs 2 s in which nothing is answered: seldom, and the flag says so meanwhile."""
    board = MicroPythonBoard(micropython)
    board.turn(messages.hello(0, 9), 0)
    acked(board, messages.motion(1, (5, 0, 0, 0), 1), 1)
    ack, tries = acked(board, messages.motion(2, (6, 0, 0, 0), 0), 2, refuses=True), board.tries
    assert (ack.counters[0], bool(ack.flags & messages.Flags.USB_READY)) == (5, False)
    for n in range(3, 4900, 7):  # the frames go on
        ack = acked(board, messages.motion(n, (6, 0, 0, 0), 0), n, refuses=False)
    assert (ack.counters[0], bool(ack.flags & messages.Flags.USB_READY)) == (5, False)
    assert board.tries == tries
    ack = acked(board, messages.motion(5002, (7, 0, 0, 0), 0) + messages.motion(5003, (7, 0, 0, 0), 0), 5002)
    assert (ack.counters[0], board.moved[0], board.buttons) == (7, 7, 0)
    assert ack.flags & messages.Flags.USB_READY
    acked(board, messages.motion(5004, (8, 0, 0, 0), 0), 5004, refuses=True)
    board.turn(b"", 5005)
    board.asked = {"usb": False}  # another computer, or that one started again
    board.turn(b"", 5006)
    ack = acked(board, messages.motion(5005, (9, 0, 0, 0), 0), 5007, usb=True, refuses=False)
    assert ack.counters[0] == board.moved[0] == 9


def test_a_computer_that_falls_asleep_while_a_report_waits(micropython):
    """CircuitPython gives no sign of it: what was not fetched stays due, and buttons are told anew on waking."""
    board = MicroPythonBoard(micropython)
    board.turn(messages.hello(0, 9), 0)
    assert acked(board, messages.motion(1, (5, 0, 0, 0), 1), 1).counters[0] == 5
    ack = acked(board, messages.motion(2, (405, 0, 0, 0), 0), 2, nods_off=True)
    assert (ack.counters[0], board.buttons) == (5, 1)
    ack = acked(board, messages.motion(3, (405, 0, 0, 0), 0), 3)
    assert (ack.counters[0], bool(ack.flags & messages.Flags.USB_READY)) == (5, False)
    ack = acked(board, messages.motion(4, (405, 0, 0, 0), 0), 4, usb=True)
    assert (ack.counters[0], board.moved[0], board.buttons) == (405, 405, 0)
    tries = board.tries
    for usb in (False, True):  # asleep with nothing due
        acked(board, messages.motion(5 + usb, (405, 0, 0, 0), 0), 5 + usb, usb=usb)
    assert board.tries == tries + 1


# ---- how often the computer asks ----


def read_from(waiting, buffer, port):
    """Move the bytes that wait at a port into a buffer, as CircuitPython's `readinto` does; their number."""
    n = min(len(buffer), len(waiting))
    buffer[:n] = waiting[:n]
    del waiting[:n]
    port.in_waiting = len(waiting)
    return n


def test_a_computer_that_asks_every_8_ms(mouse):
    """CircuitPython's mouse: `send_report` waits for the report before; 30 us a byte in Python. The page's figures."""
    clock = SimpleNamespace(ms=0.0)
    arrived, given, free = [], [], 0.0

    def send_report(report, report_id):
        nonlocal free
        clock.ms = max(clock.ms, free)
        arrived.append((clock.ms, int.from_bytes(report[1:3], "little", signed=True)))
        free = 8.0 * (clock.ms // 8 + 1)

    port = SimpleNamespace(in_waiting=0, out_waiting=0, connected=True)
    came, went = bytearray(), bytearray()

    def readinto(buffer):
        n = read_from(came, buffer, port)
        clock.ms += 0.03 * n
        return n

    def write(frame):
        went.extend(frame)
        clock.ms += 0.03 * len(frame)

    port.readinto, port.write = readinto, write
    hid = SimpleNamespace(get_last_received_report=lambda report_id: None, send_report=send_report)
    board = mouse.Mouse(1, b"", hid, port, None, None, SimpleNamespace(usb_connected=True))
    link = host.Link(iter(range(1, 100)).__next__)
    came.extend(link.port_opened(0.0))
    for ms in range(8000):
        if ms % 4 == 0 and ms < 7900:
            link.add((1, 0, 0, 0), ms / 1000)
            given.append(ms)
        while (frame := link.next_frame(ms / 1000)) is not None:
            came.extend(frame)
        port.in_waiting = len(came)
        if clock.ms <= ms:  # its turn before is over
            clock.ms = float(ms)
            board.turn(ms)
            clock.ms += 0.3
            link.receive(bytes(went), ms / 1000)
            went.clear()
    when, counts = zip(*arrived, strict=True)
    assert sum(counts) == len(given)
    assert link.sessions == 1
    assert len(arrived) == pytest.approx(125 * 8, rel=0.02)
    latency = np.array(when)[np.searchsorted(np.cumsum(counts), np.arange(1, len(given) + 1))] - given
    median, slow = np.quantile(latency, (0.5, 0.99))
    assert f"adds {median:.0f} ms in the median and {slow:.0f} ms in the 99th percentile" in " ".join(
        (HERE.parent / "docs" / "microcontroller.md").read_text(encoding="utf-8").split()
    )


# ---- the report descriptor and the version ----


def test_descriptor_and_version_of_both_boards_are_equal(mouse):
    page = (HERE.parent / "docs" / "protocol.md").read_text(encoding="utf-8")
    size = len(mouse.DESCRIPTOR)
    assert f"({size} bytes): `DESCRIPTOR` in `service/firmware/pico/mouse.py`" in page
    descriptor = (avr_board.ctypes.c_uint8 * size).in_dll(avr_board.build(), "sm_descriptor")
    assert bytes(descriptor) == mouse.DESCRIPTOR
    version = ", ".join(map(str, firmware.own_version()))
    assert f"FIRMWARE[3] = {{{version}}}" in (avr_board.SOURCES / "protocol.c").read_text()


@pytest.fixture
def mouse(monkeypatch):
    monkeypatch.syspath_prepend(str(PICO))
    for name in ("mouse", "protocol", "frames"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    import mouse as module

    yield module
    for name in ("mouse", "protocol", "frames"):
        sys.modules.pop(name, None)


# ---- boot.py and code.py, on stand-ins for CircuitPython's modules ----

MODULES = "board busio digitalio microcontroller storage supervisor usb_cdc usb_hid usb_midi watchdog"


@pytest.fixture
def circuitpython(mouse, monkeypatch):
    modules: dict[str, Any] = {name: MagicMock(name=name) for name in MODULES.split()}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return SimpleNamespace(**modules)


@pytest.mark.parametrize("jumper", [False, True, None])
def test_boot_enables_the_mouse_and_the_data_port(mouse, circuitpython, jumper):
    """A jumper on GP22 hides console and drive; there are boards without that pin."""
    c, pin = circuitpython, circuitpython.digitalio.DigitalInOut.return_value
    pin.value = not jumper
    if jumper is None:
        del c.board.GP22
    runpy.run_path(str(PICO / "boot.py"))
    c.usb_hid.enable.assert_called_once_with((c.usb_hid.Device.return_value,))
    c.usb_cdc.enable.assert_called_once_with(console=not jumper, data=True)
    assert c.storage.disable_usb_drive.called == bool(jumper)
    assert pin.switch_to_input.call_args_list == ([] if jumper is None else [call(c.digitalio.Pull.UP)])
    assert c.supervisor.set_usb_identification.call_args.args[1] == "spheremouse"
    c.usb_hid.Device.assert_called_once_with(
        report_descriptor=mouse.DESCRIPTOR,
        usage_page=1,
        usage=2,
        report_ids=(1, 2),
        in_report_lengths=(9, 0),
        out_report_lengths=(0, 1),
    )


class EndOfTestError(Exception):
    """The watchdog has been fed often enough, or the board is reset."""


def run_code(c, frames=b"", reason="STARTUP"):
    """Run code.py for five turns of its loop; return its reports and the bytes of its answers."""
    waiting, reports, out, port, hid = bytearray(frames), [], bytearray(), c.usb_cdc.data, MagicMock()
    if port is not None:
        port.configure_mock(in_waiting=len(frames), out_waiting=0, connected=True)
        port.readinto.side_effect = lambda buffer: read_from(waiting, buffer, port)
        port.write.side_effect = out.extend
    hid.get_last_received_report.return_value = None
    hid.send_report.side_effect = lambda report, report_id: reports.append((report_id, bytes(report)))
    c.usb_hid.devices, c.busio.UART.return_value.in_waiting = [hid], 0
    c.board.board_id = "raspberry_pi_pico"
    c.supervisor.RunReason.STARTUP, c.supervisor.runtime.run_reason = "STARTUP", reason
    c.supervisor.ticks_ms.return_value = 1000
    c.microcontroller.watchdog.feed.side_effect = [None] * 4 + [EndOfTestError]
    c.microcontroller.reset.side_effect = EndOfTestError
    with pytest.raises(EndOfTestError):
        runpy.run_path(str(PICO / "code.py"))
    return reports, bytes(out)


@pytest.mark.parametrize("led", [True, False])
def test_code_moves_and_answers(circuitpython, led):
    if not led:
        del circuitpython.board.LED
    frames = b"\0" + messages.hello(0, 5) + messages.motion(1, (3, -4, 0, 0), 1)
    reports, out = run_code(circuitpython, frames)
    assert reports == [(1, bytes([1, 3, 0, 0xFC, 0xFF, 0, 0, 0, 0]))]
    identity, ack = map(messages.parse, messages.Splitter().take(out))
    assert isinstance(identity, messages.Identity)
    assert isinstance(ack, messages.Ack)
    assert (identity.board, identity.kind, identity.firmware) == ("pico", 1, firmware.version_of(PICO))
    assert ack.counters == (3, 2**16 - 4, 0, 0)
    assert not circuitpython.microcontroller.reset.called
    dog = circuitpython.microcontroller.watchdog
    assert (dog.timeout, dog.mode) == (5, circuitpython.watchdog.WatchDogMode.RESET)


def test_code_restarts_the_whole_board_where_only_the_program_would(circuitpython):
    run_code(circuitpython, reason="AUTO_RELOAD")
    circuitpython.microcontroller.reset.assert_called_once_with()
    assert not circuitpython.microcontroller.watchdog.feed.called


def test_code_says_what_to_do_before_boot_has_run(circuitpython):
    circuitpython.usb_cdc.data = None
    with pytest.raises(RuntimeError, match="unplug the board and plug it in again"):
        run_code(circuitpython)


# ---- the drive ----

BOOT_OUT = """Adafruit CircuitPython 9.2.4 on 2025-01-29; Raspberry Pi Pico with rp2040
Board ID:raspberry_pi_pico
UID:E6616408432B8A2A
boot.py output:
"""


@pytest.fixture
def drive(tmp_path):
    (tmp_path / "boot_out.txt").write_text(BOOT_OUT)
    (tmp_path / "code.py").write_text('print("Hello World!")\n')
    return tmp_path


run, done, refusal = (partial(each, app) for each in (invoke, succeed, fail))


def test_an_installation_and_another_one(drive):
    output = done("install", "--drive", drive)
    assert "firmware 1.0.0 in place of none: boot.py, mouse.py, frames.py, protocol.py, code.py" in output
    assert "pull the board and plug it in again; then: spheremouse firmware check" in output
    assert sorted(firmware.FILES) == sorted(p.name for p in PICO.glob("*.py"))
    assert sorted(p.name for p in drive.iterdir()) == sorted([*firmware.FILES, "boot_out.txt"])
    for name in firmware.FILES:
        assert (drive / name).read_bytes() == (PICO / name).read_bytes()
    assert "has firmware 1.0.0 already" in done("install", "--drive", drive)
    (drive / "protocol.py").write_text((PICO / "protocol.py").read_text().replace("(1, 0, 0)", "(0, 9, 1)"))
    assert "1.0.0 in place of 0.9.1: protocol.py" in done("install", "--drive", drive)


@pytest.mark.parametrize("left", [0, 5, 300, "zeros"])
def test_a_copy_that_was_cut_short_is_replaced(drive, left):
    done("install", "--drive", drive)
    for name in firmware.FILES:
        data = (PICO / name).read_bytes()
        (drive / name).write_bytes(bytes(len(data)) if left == "zeros" else data[:left] + bytes(64))
    done("install", "--drive", drive)
    for name in firmware.FILES:
        assert (drive / name).read_bytes() == (PICO / name).read_bytes()


def test_files_of_another_program_stay(drive):
    (drive / "code.py").write_text("import my_keyboard\n")
    assert "code.py of another program there; save them and use --force" in refusal("install", "--drive", drive)
    assert (drive / "code.py").read_text() == "import my_keyboard\n"
    assert not (drive / "boot.py").exists()
    done("install", "--drive", drive, "--force")
    (drive / "code.txt").write_text("print(1)")
    assert "code.txt of another program there" in refusal("install", "--drive", drive)
    done("install", "--drive", drive, "--force")
    assert not (drive / "code.txt").exists()


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        ({}, "no boot_out.txt in it"),
        ({"boot_out.txt": "something else\n"}, "no boot_out.txt in it that names CircuitPython"),
        ({"boot_out.txt": BOOT_OUT.replace("9.2.4", "7.3.3")}, "has CircuitPython 7; install CircuitPython 9 or newer"),
    ],
)
def test_folders_that_are_no_drive_of_a_board(tmp_path, files, problem):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert problem in refusal("install", "--drive", tmp_path)


def test_the_drive_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(firmware, "DRIVES", (f"{tmp_path}/*/CIRCUITPY",))
    assert "no drive CIRCUITPY is mounted; mount the board's and" in refusal("install")
    (tmp_path / "me" / "CIRCUITPY").mkdir(parents=True)
    assert firmware.find_drive() == tmp_path / "me" / "CIRCUITPY"
    (tmp_path / "you" / "CIRCUITPY").mkdir(parents=True)
    assert "several boards" in refusal("install")


def test_a_full_drive_keeps_the_old_file(drive, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert "cannot be written: No space left on device" in refusal("install", "--drive", drive)
    assert sorted(p.name for p in drive.iterdir()) == ["boot_out.txt", "code.py"]
    assert (drive / "code.py").read_text() == 'print("Hello World!")\n'


# ---- the port ----


@pytest.fixture
def simulated():
    """Return the class of simulated boards."""
    pytest.importorskip("pty")
    from simulated_board import Simulator

    return Simulator


def test_a_check(simulated, tmp_path):
    with simulated() as board:
        found = json.loads(done("check", "--port", board.port, "--json", "-"))
        assert found["port"]["firmware"] == found["here"] == "1.0.0"
        assert (found["port"]["board"], found["wrong"]) == ("simulator", [])
        checked = done("check", "--port", board.port, "--baud", "230400")
        assert f"all is well; next: spheremouse run --source ... --output serial:{board.port},baud=230400" in checked
        board.awake = False
        code, output = run("check", "--port", board.port, "--json", tmp_path / "found.json")
    assert code == 1
    assert "plug the board into the game's computer, or wake that up" in output
    assert json.loads((tmp_path / "found.json").read_text())["wrong"]
    assert "there already" in refusal("check", "--json", tmp_path / "found.json")


def test_a_check_over_a_bad_line(simulated, monkeypatch):
    """It repeats a question whose answer is lost, and reports many damaged frames."""
    monkeypatch.setattr(output_module, "FIRST_ANSWER_TIMEOUT", PATIENCE)  # a busy machine repeats it less often
    monkeypatch.setattr(output_module.Serial, "status", partialmethod(output_module.Serial.status, PATIENCE))
    with simulated(damage=0.02, seed=2) as board:
        results = [run("check", "--port", board.port) for _ in range(5)]
    assert all("frames," in output for _, output in results)
    code, output = results[-1]
    assert code == 1
    assert "use shorter wires, see that GND is connected" in output


@pytest.mark.parametrize(
    ("runs", "kind", "advice"),
    [
        ((0, 9, 0), 1, "run `spheremouse firmware install`, pull the board and plug it in again"),
        ((0, 9, 0), 2, "load the new one (make upload; docs/microcontroller.md, ATmega32U4)"),
        ((1, 1, 0), 1, "newer than this program; update spheremouse"),
    ],
)
def test_another_version_runs(simulated, runs, kind, advice):
    from simulated_board import load_protocol

    protocol: Any = load_protocol()
    protocol.FIRMWARE, protocol.SIMULATOR = runs, kind
    with simulated(protocol=protocol) as board:
        code, output = run("check", "--port", board.port)
    assert code == 1
    assert advice in output


def test_options_are_checked_first():
    assert refusal("check", "--port", "x", "--baud", "1200") == "--baud=1200: must be from 38400 to 4000000"
    assert "write a port's name, or auto" in refusal("check", "--port", "")
