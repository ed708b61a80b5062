"""Logs of mice: the kernel's events in, lines out and back; which mouse is meant. Without a device."""

import os
import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from invoking import refusal

from spheremouse.capture import mouse as mouse_log
from spheremouse.capture.mouse import Assembler, Listener, Mouse, choose, mice
from spheremouse.errors import DatasetError, SourceError
from spheremouse.files.mouse_log import MouseReport, read_log, write_log

SYN, REL, KEY = 0, 2, 1
X, Y, WHEEL = 0, 1, 8


def fed(*events):
    """Reports of events (stamp, kind, code, value)."""
    assembler = Assembler()
    return [r for event in events if (r := assembler.feed(*event)) is not None]


def test_what_stands_between_two_syn_is_one_report_and_buttons_and_other_axes_are_none():
    events = [(1.0, REL, X, 3), (1.0, REL, Y, -2), (1.0, REL, WHEEL, 1), (1.0, SYN, 0, 0), (1.01, REL, X, 1)]
    assert fed(*events, (1.01, SYN, 0, 0)) == [MouseReport(1.0, 3, -2), MouseReport(1.01, 1, 0)]
    assert fed((1.0, KEY, 0x110, 1), (1.0, SYN, 0, 0), (1.1, REL, 0x0B, 120), (1.1, SYN, 0, 0)) == []
    # after the kernel dropped events, the rest of that report is dropped
    events = [
        (1.0, REL, X, 9), (1.1, SYN, 3, 0), (1.1, REL, X, 7), (1.1, SYN, 0, 0), (1.2, REL, X, 5), (1.2, SYN, 0, 0)
    ]  # fmt: skip
    assert fed(*events) == [MouseReport(1.2, 5, 0)]


reports = st.lists(
    st.builds(
        MouseReport, st.integers(0, 10**7).map(lambda ms: 1e-3 * ms), st.integers(-40000, 40000), st.integers(-9, 9)
    ),
    max_size=30
)  # fmt: skip


@settings(max_examples=12)
@given(reports)
def test_what_is_written_is_read(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    rows.sort(key=lambda report: report.stamp)
    write_log(path, "a\nmouse", rows)
    back = read_log(path)
    np.testing.assert_allclose(back.stamp, [r.stamp for r in rows], rtol=0.0, atol=1e-6)
    np.testing.assert_array_equal(back.counts, np.reshape([(r.dx, r.dy) for r in rows], (-1, 2)))


@pytest.mark.parametrize(
    ("text", "place", "problem"),
    [
        ("", ", line 1: ", "no column t, dx, dy"),
        ("t,dx,dy\n1,2,3\n0.5,1,1\n", ", report 2: ", "t goes back, from 1.0 to 0.5 s"),
        ("t,dx,dy\n1,2,x\n", ", line 2: ", "dy: 'x' is not a number"),
        ("t,dx,dy\n1,2,3\n1e9,2,3\n", ": ", "cut the log"),
    ],
)
def test_an_invalid_log_is_rejected_with_its_place(tmp_path, text, place, problem):
    path = tmp_path / "log.csv"
    path.write_text(text)
    text = refusal(DatasetError, read_log, path)
    assert text.startswith(f"{path}{place}")
    assert problem in text


def test_columns_may_stand_in_any_order_and_others_beside_them(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("dy,device,t,dx\n3,a,1.5,2\n")
    back = read_log(path)
    assert (back.stamp[0], *back.counts[0]) == (1.5, 2.0, 3.0)


@pytest.fixture
def sysfs(tmp_path):
    """Two mice, a keyboard and a joystick, as the kernel lists them."""
    for number, name, bits in ((10, "USB Trackball", "903"), (2, "Logitech Mouse", "1943"), (3, "Keyboard", "0")):
        folder = tmp_path / f"event{number}" / "device"
        (folder / "capabilities").mkdir(parents=True)
        (folder / "name").write_text(name + "\n")
        (folder / "capabilities" / "rel").write_text(bits + "\n")
    (tmp_path / "event4").mkdir()  # gone meanwhile
    (tmp_path / "event5/device/capabilities").mkdir(parents=True)
    (tmp_path / "event5/device/capabilities/rel").touch()  # empty
    return tmp_path


def test_one_of_the_mice_is_chosen_by_path_or_name_or_because_there_is_no_other(sysfs, tmp_path):
    """Mice are what has relative X and Y, in the order of their numbers."""
    found = mice(sysfs, sysfs)
    assert [(m.node.name, m.name) for m in found] == [("event2", "Logitech Mouse"), ("event10", "USB Trackball")]
    assert choose("track", found).name == "USB Trackball"
    assert choose(str(sysfs / "event2"), found).name == "Logitech Mouse"
    (tmp_path / "link").symlink_to(sysfs / "event10")
    assert choose(str(tmp_path / "link"), found).name == "USB Trackball"
    assert choose(None, found[:1]) is found[0]


def test_what_cannot_be_chosen_is_listed(sysfs):
    found = mice(sysfs, sysfs)
    for wanted, what in (
        (None, "2 mice are connected"),
        ("x", "no mice are connected that fit --device x"),
        ("l", "2 mice"),
    ):
        with pytest.raises(SourceError, match=what) as error:
            choose(wanted, found)
        assert all(str(m) in str(error.value) for m in found)
    with pytest.raises(SourceError, match="no mice are connected that fit --device /nowhere/event9; plug one in"):
        choose("/nowhere/event9", [])


def test_what_is_no_device_is_refused(tmp_path):
    pytest.importorskip("evdev")
    (tmp_path / "event1").write_text("")
    with pytest.raises(SourceError, match="is it an event device"):
        Listener(Mouse(tmp_path / "event1", "x"))


class Pipe:
    """Stands for a device of the kernel: what it reads was put into `batches`; None is an unplugged cable."""

    def __init__(self, batches):
        self.fd, self._write = os.pipe()
        os.write(self._write, b"x")  # always something to read
        self.batches, self.closed = list(batches), False

    def read(self):
        if not self.batches:
            raise BlockingIOError
        batch = self.batches.pop(0)
        if batch is None:
            raise OSError(19, "No such device")
        return [Event(*event) for event in batch]

    def close(self):
        self.closed = True
        os.close(self.fd)
        os.close(self._write)


class Event:
    def __init__(self, stamp, kind, code, value):
        self.sec, self.usec = int(stamp), round(1e6 * (stamp - int(stamp)))
        self.type, self.code, self.value = kind, code, value


@pytest.fixture
def plugged(monkeypatch):
    """Plugs a Pipe in place of the kernel's device; the clock stands at 100 s."""

    pytest.importorskip("evdev")

    def plug(*batches):
        pipe = Pipe(batches)
        monkeypatch.setattr("evdev.InputDevice", lambda _: pipe)
        monkeypatch.setattr("fcntl.ioctl", lambda *_: 0)
        monkeypatch.setattr(mouse_log.time, "monotonic", lambda: 100.0)
        return pipe

    return plug


def moved(stamp, dx):
    return [(stamp, REL, X, dx), (stamp, SYN, 0, 0)]


def test_a_log_begins_and_ends_with_the_time_it_was_listened_and_leaves_out_what_lay_in_the_queue(plugged):
    pipe = plugged(moved(99.0, 5), moved(100.5, 2), moved(100.6, 3))
    seen = []
    with Listener(Mouse("/x", "m")) as listener:
        assert listener.listen(seen.append, lambda: not pipe.batches) is None
    assert [(r.stamp, r.dx) for r in seen] == [(100.0, 0), (100.5, 2), (100.6, 3), (100.6, 0)]
    assert pipe.closed


def test_the_command_writes_the_log_and_says_what_is_next(plugged, monkeypatch, spheremouse, tmp_path):
    plugged(*(moved(100.0 + 0.01 * k, 4) for k in range(1, 11)), None)
    monkeypatch.setattr(mouse_log, "mice", lambda: [Mouse("/x", "Ball")])
    monkeypatch.setattr(sys, "platform", "linux")
    out = tmp_path / "log.csv"
    said, complaints = spheremouse.succeed("log-mouse", "--out", out)
    assert said.splitlines() == [
        f"{out}: 10 reports in 0.1 s, 40 counts in x and 0 in y",
        f"next: spheremouse match RECORDING {out}",
    ]
    assert "/x (Ball) is gone (No such device): the log ends there" in complaints
    stamps = read_log(out).stamp
    assert all(b >= a for a, b in pairwise(stamps.tolist()))
