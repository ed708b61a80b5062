"""The 6-axis mouse, as Debian's libspnav sees it (`apt-get install libspnav0`), and as a raw client does."""

import contextlib
import ctypes
import os
import socket
import stat
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from reporting import refused, rolling, until
from scipy.spatial.transform import Rotation
from seats import LOOKS

from spheremouse.output import Report, line_server, open_output, spacenav
from spheremouse.output.counts import MotionSettings
from spheremouse.output.deflection import RELEASE_TIME
from spheremouse.output.response import Response
from spheremouse.output.wand_mapping import PointingSettings, WandMapping
from spheremouse.tracker import Status

RATES = arrays(float, 3, elements=st.floats(-1.5, 1.5)).filter(lambda w: np.linalg.norm(w) > 0.5)
UP = np.array([0.0, 1.0, 0.0])
try:
    SPNAV = ctypes.CDLL("libspnav.so.0")
except OSError:
    SPNAV = None
needs_libspnav = pytest.mark.skipif(SPNAV is None, reason="libspnav is not installed")


class Event(ctypes.Structure):
    """`spnav_event_motion` of spnav.h."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("type", "x", "y", "z", "rx", "ry", "rz")),
        ("period", ctypes.c_uint),
        ("data", ctypes.POINTER(ctypes.c_int)),
    ]


class Pose(ctypes.Structure):
    """`spnav_posrot` of spnav.h."""

    _fields_ = [("position", ctypes.c_float * 3), ("quaternion", ctypes.c_float * 4)]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "spnav.sock"


@contextlib.contextmanager
def libspnav(path):
    """A connection of libspnav, as a function that returns the next event."""
    assert SPNAV is not None
    os.environ["SPNAV_SOCKET"] = str(path)
    assert SPNAV.spnav_open() == 0
    event = Event()

    def next_event():
        until(lambda: SPNAV.spnav_poll_event(ctypes.byref(event)))
        return event

    try:
        yield next_event
    finally:
        SPNAV.spnav_close()
        del os.environ["SPNAV_SOCKET"]


def rotation(event):
    return [event.rx, event.ry, event.rz]


@needs_libspnav
def test_libspnav_connects_and_gets_the_rotation(path):
    with open_output(f"spacenav:{path},full=90,dead=0") as output, libspnav(path) as next_event:
        assert SPNAV.spnav_protocol() == 0
        output.send(rolling([0, np.radians(45), 0]))
        event = next_event()
        assert (event.type, event.x, event.y, event.z, *rotation(event)) == (1, 0, 0, 0, 0, 175, 0)
        output.send(rolling([0, np.radians(900), 0]))
        assert rotation(next_event()) == [0, 350, 0]


@needs_libspnav
@given(st.sampled_from(sorted(LOOKS)), RATES)
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_object_of_libspnav_turns_as_the_ball_does_for_its_player(player, w):
    look = np.array(LOOKS[player], dtype=float)
    view = np.array([np.cross(look, UP), UP, -look])  # right, up, towards the player: OpenGL's axes
    check_object(rolling(w, MotionSettings(player=player)), view @ w)


@needs_libspnav
@given(st.booleans(), RATES)
@settings(max_examples=50)
def test_the_object_of_libspnav_turns_as_a_hand_held_ball_does(facing, w):
    view = np.diag([-1.0, -1.0, 1.0] if facing else [1.0, -1.0, -1.0])
    (sample,) = rolling(w).samples
    mapping = WandMapping(PointingSettings(facing=facing))
    _, rate = mapping.counts(sample.estimate)
    check_object(Report((0, 0, 0), rate, 0.0, (replace(sample, coordinates="cam"),)), view @ w)


def check_object(report, w):
    """Check the rotation vector of an object that libspnav moves by one event: 0.001 rad a unit."""
    assert SPNAV is not None
    made = spacenav.to_rotation(report, Response(full=180.0, dead=0.0))
    assert made is not None
    pose = Pose()
    SPNAV.spnav_posrot_init(ctypes.byref(pose))
    SPNAV.spnav_posrot_moveobj(ctypes.byref(pose), ctypes.byref(Event(1, 0, 0, 0, *np.rint(made).astype(int))))
    turned = Rotation.from_quat(list(pose.quaternion)).as_rotvec()
    assert np.allclose(turned, 0.001 * 350 * w / np.pi, atol=0.0005 + 1e-6)


@needs_libspnav
def test_one_event_of_zeros_ends_a_motion(path):
    with open_output(f"spacenav:{path}") as output, libspnav(path) as next_event:
        ends = (rolling([0, 0, 0]), rolling([0, 1, 0], status=Status.LOST), Report((0, 0, 0), None, 0.0))
        for wait, end in zip((0.0, 0.0, 1.1 * RELEASE_TIME), ends, strict=True):  # at last no frame comes
            output.send(rolling([0, 1, 0]))
            assert rotation(next_event())[1] > 0
            time.sleep(wait)
            output.send(end)
            output.send(end)
            assert rotation(next_event()) == [0, 0, 0]
        time.sleep(0.05)
        assert SPNAV.spnav_poll_event(ctypes.byref(Event())) == 0


@needs_libspnav
def test_a_client_sets_its_sensitivity(path):
    with open_output(f"spacenav:{path},full=90,dead=0") as output, libspnav(path) as next_event:
        SPNAV.spnav_sensitivity.argtypes = [ctypes.c_double]
        assert SPNAV.spnav_sensitivity(0.5) == 0

        def halved():
            output.send(rolling([0, np.radians(80), 0]))
            return rotation(next_event()) == [0, 156, 0]

        until(halved)


@needs_libspnav
def test_the_end_of_the_output_ends_the_connection_and_removes_the_socket(path):
    with open_output(f"spacenav:{path}"):
        connection = libspnav(path)
        connection.__enter__()
    assert SPNAV.spnav_wait_event(ctypes.byref(Event())) == 0
    connection.__exit__(None, None, None)
    assert not path.exists()


def connect(path):
    client = socket.socket(socket.AF_UNIX)
    client.connect(str(path))
    client.settimeout(10)
    return client


def test_a_client_that_sends_no_request_gets_events_too(path):
    with open_output(f"spacenav:{path},full=90,dead=0") as output, connect(path) as client:
        client.settimeout(0.01)
        event = b""
        for _ in range(1000):
            output.send(rolling([0, np.radians(45), 0]))
            with contextlib.suppress(TimeoutError):
                event = client.recv(32)
                break
        assert struct.unpack("=7i", event[:28]) == (0, 0, 0, 0, 0, 175, 0)


def test_a_client_that_does_not_read_is_disconnected_and_delays_no_other(path):
    with open_output(f"spacenav:{path}") as output, connect(path) as slow, connect(path) as other:
        for client in (slow, other):
            client.sendall(struct.pack("=I", 0x7FAA5501))
            assert client.recv(4) == struct.pack("=I", 0x7FAA5500)
        for _ in range(2000):
            output.send(rolling([0, 1, 0]))
            assert len(other.recv(32)) == 32
        left = sum(iter(lambda: len(slow.recv(65536)), 0))  # to the end of the connection
        assert 0 < left < 2000 * 32


def test_a_client_beyond_the_limit_is_disconnected(path, monkeypatch):
    monkeypatch.setattr(line_server, "_MAX_CLIENTS", 1)
    with open_output(f"spacenav:{path}"), connect(path), connect(path) as second:
        assert second.recv(4) == b""


def test_every_account_may_connect_a_second_driver_is_refused_and_a_socket_that_is_left_over_replaced(path):
    with open_output(f"spacenav:{path}"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o666
        hint = "stop spacenavd, or name another socket"
        assert refused(f"spacenav:{path}") == f"spacenav: {path}: another driver serves it; {hint}"
    with socket.socket(socket.AF_UNIX) as left_over:
        left_over.bind(str(path))
    with open_output(f"spacenav:{path}"), connect(path):
        pass


@pytest.mark.parametrize("name", ["file", "no/spnav.sock", "x" * 200, "a\0b"])
def test_a_path_that_cannot_be_a_socket(tmp_path, name):
    (tmp_path / "file").write_text("kept")
    assert refused(f"spacenav:{tmp_path / name}").endswith("; stop spacenavd, or name another socket")
    assert (tmp_path / "file").read_text() == "kept"


def test_the_socket_is_that_of_spnav_socket_by_default(monkeypatch, path):
    monkeypatch.delenv("SPNAV_SOCKET", raising=False)
    assert str(spacenav.check("")[0]) == "/var/run/spnav.sock"
    monkeypatch.setenv("SPNAV_SOCKET", str(path))
    assert spacenav.check("full=90")[0] == path
    assert spacenav.check("/tmp/other,full=90")[0].name == "other"
    assert "did you mean curve" in refused("spacenav:curv=1")
