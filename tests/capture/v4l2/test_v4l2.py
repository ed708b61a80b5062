"""Source v4l2 without a device: how it is named and set, and who holds a buffer when, on a device of the test.

On real kernel devices: tests/system/camera.py.
"""

import os
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from spheremouse.capture import open_source, v4l2
from spheremouse.capture.settings import CameraSettings
from spheremouse.capture.v4l2.pixels import Layout
from spheremouse.capture.v4l2.stamps import Moment
from spheremouse.errors import ConfigurationError, DamagedFrameError, SourceError
from spheremouse.files.config import override

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="V4L2 is of Linux")

W, H = 32, 16
MONOTONIC = 0x2000
LOST = 0x40


class Device:
    """A driver: frames are pushed into queued buffers, dropped where there is none, and taken in order."""

    path, card, driver = "/dev/video7", "Test", "test"

    def __init__(self, buffers=3):
        self.fd, self._writer = os.pipe()
        os.set_blocking(self.fd, False)
        self.buffers = [np.zeros(W * H, np.uint8) for _ in range(buffers)]
        self.queued = list(range(buffers))
        self.filled = []
        self.sequence = -1
        self.gone = False
        self.closed = 0

    def push(self, value, flags=MONOTONIC, stamp=None, size=W * H):
        self.sequence += 1
        if not self.queued:
            return
        index = self.queued.pop(0)
        self.buffers[index][:] = value
        at = time.monotonic() if stamp is None else stamp
        when = SimpleNamespace(secs=int(at), usecs=int(at % 1 * 1e6))
        self.filled.append(
            SimpleNamespace(index=index, sequence=self.sequence, flags=flags, timestamp=when, bytesused=size)
        )
        os.write(self._writer, b"x")

    def unplug(self):
        self.gone = True
        os.write(self._writer, b"x")

    def dequeue(self):
        if self.gone:
            raise SourceError(f"{self.path}: the camera is gone; plug it in again")
        os.read(self.fd, 1)
        return self.filled.pop(0)

    def queue(self, index):
        if self.gone:
            raise OSError(19, "No such device")
        assert index not in self.queued
        self.queued.append(index)

    def close(self):
        self.closed += 1
        os.close(self.fd)
        os.close(self._writer)


class Controls:
    restored = 0

    def exposure(self):
        return 0.01

    def restore(self):
        self.restored += 1


def camera(device, layout=None, controls=None):
    mode = SimpleNamespace(layout=layout or Layout("GREY", W, H, W), fps=30.0)
    return v4l2.V4L2Camera(device, controls or Controls(), mode, CameraSettings(), "/dev/video7 (Test)")


def test_a_shot_is_a_view_of_the_driver_s_buffer_until_it_is_released():
    device = Device()
    with camera(device) as cam:
        device.push(41)
        raw = cam.next(5.0)
        frame = raw.frame(colour=False)
        assert np.shares_memory(frame.image, device.buffers[0])
        assert (frame.image.shape, frame.image.dtype, int(frame.image.max())) == ((H, W), np.uint8, 41)
        assert (frame.stamp, frame.sequence) == (raw.stamp, raw.sequence) == (raw.stamp, 0)
        assert raw.frame(colour=True).image.shape == (H, W, 3)
        assert 0 not in device.queued
        raw.release()
        assert device.queued == [1, 2, 0]
        with pytest.raises(ValueError, match="released"):
            raw.frame(colour=False)


def test_release_is_idempotent_even_when_the_buffer_is_out_again():
    device = Device(buffers=1)
    with camera(device) as cam:
        device.push(1)
        first = cam.next(5.0)
        first.release()
        device.push(2)
        second = cam.next(5.0)
        first.release()  # must not queue what the second raw frame holds
        assert device.queued == []
        assert int(second.frame(False).image[0, 0]) == 2
        second.release()
        second.release()
        assert device.queued == [0]


def test_while_all_buffers_are_held_the_driver_drops_and_the_numbers_show_it():
    device = Device(buffers=2)
    with camera(device) as cam:
        device.push(0)
        device.push(1)
        frames = [cam.next(5.0), cam.next(5.0)]
        device.push(2)
        device.push(3)
        assert cam.next(0.02) is None
        assert [int(s.frame(False).image[0, 0]) for s in frames] == [0, 1]
        frames[0].release()
        device.push(4)
        late = cam.next(5.0)
        assert [s.sequence for s in (*frames, late)] == [0, 1, 4]


def test_a_release_in_another_thread_lets_next_go_on():
    device = Device(buffers=1)
    with camera(device) as cam:
        device.push(0)
        held = cam.next(5.0)
        got = []
        thread = threading.Thread(target=lambda: got.append(cam.next(30.0)))
        thread.start()
        held.release()
        device.push(1)
        thread.join(30.0)
        assert not thread.is_alive()
        assert got[0].sequence == 1


def test_shots_outlive_the_camera():
    device, controls = Device(), Controls()
    cam = camera(device, controls=controls)
    device.push(9)
    raw = cam.next(5.0)
    cam.close()
    cam.close()
    assert (device.closed, controls.restored) == (1, 1)
    assert int(raw.frame(False).image[3, 3]) == 9
    raw.release()
    assert 0 not in device.queued
    with pytest.raises(SourceError, match="closed"):
        cam.next(0.0)


def test_an_unplugged_camera_is_said_once_and_shots_can_still_be_released():
    device = Device()
    with camera(device) as cam:
        device.push(5)
        raw = cam.next(5.0)
        device.unplug()
        with pytest.raises(SourceError, match="gone; plug it in again"):
            cam.next(5.0)
        raw.release()


@pytest.mark.parametrize(
    ("push", "words"),
    [
        ({"flags": MONOTONIC | LOST}, "driver lost a part"),
        ({"size": W * H - 1}, "frame of 511 bytes; 512"),
        ({"size": 0}, "frame of 0"),
    ],
)
def test_a_damaged_frame_is_said_and_the_next_is_whole(push, words):
    device = Device()
    with camera(device) as cam:
        device.push(1, **push)
        device.push(2)
        raw = cam.next(5.0)
        with pytest.raises(DamagedFrameError, match=words):
            raw.frame(colour=False)
        raw.release()
        good = cam.next(5.0)
        assert int(good.frame(colour=False).image[0, 0]) == 2


def test_stamps_are_mid_exposure_and_what_is_wrong_with_them_is_noted_once():
    device = Device()
    with camera(device) as cam:
        at = time.monotonic() - 0.1
        device.push(0, stamp=at)
        assert cam.next(5.0).stamp == pytest.approx(at - 0.005, abs=2e-6)  # end of a frame exposed for 10 ms
        assert cam.notes == ()
        for _ in range(2):
            device.push(0, stamp=0.0)
            raw = cam.next(5.0)
            assert at < raw.stamp < time.monotonic()
            raw.release()
        assert len(cam.notes) == 1
        assert "no stamps" in cam.notes[0]
        assert cam.describe() == (
            "/dev/video7 (Test): 32x16 GREY, 30 frames/s; no colour: ring targets cannot be found; "
            f"stamps at end of frame, monotonic clock, exposure 10 ms; {cam.notes[0]}"
        )


def test_what_a_driver_means_by_start_of_exposure(monkeypatch, tmp_path):
    monkeypatch.setattr(v4l2, "_HWTIMESTAMPS", tmp_path / "none")
    assert v4l2.start_of_exposure_moment("vivid") is Moment.EXPOSURE_BEGINS
    assert v4l2.start_of_exposure_moment("uvcvideo") is Moment.FIRST_PACKET
    monkeypatch.setattr(v4l2, "_HWTIMESTAMPS", tmp_path / "hwtimestamps")
    for text, moment in (
        ("Y\n", Moment.EXPOSURE_BEGINS),
        ("1\n", Moment.EXPOSURE_BEGINS),
        ("N\n", Moment.FIRST_PACKET),
    ):
        (tmp_path / "hwtimestamps").write_text(text)
        assert v4l2.start_of_exposure_moment("uvcvideo") is moment


def test_the_plain_source_gives_the_newest_frame_in_colour_and_keeps_no_buffer():
    device = Device(buffers=4)
    frames = v4l2.newest_frames(camera(device))
    for value in (1, 2, 3):
        device.push(value)
    first = next(frames)
    assert (int(first.image[0, 0, 0]), first.sequence, first.image.shape) == (3, 2, (H, W, 3))
    device.push(4, flags=LOST)
    assert sorted(device.queued + [f.index for f in device.filled]) == [0, 1, 2, 3]
    pushed = threading.Timer(0.05, device.push, [5])
    pushed.start()
    assert int(next(frames).image[0, 0, 0]) == 5  # the damaged one is passed over
    assert int(first.image[0, 0, 0]) == 3
    pushed.join()


def test_the_plain_source_gives_up_on_a_still_or_broken_camera(monkeypatch):
    monkeypatch.setattr(v4l2, "FRAME_TIMEOUT", 0.02)
    monkeypatch.setattr(v4l2, "MAX_DAMAGED", 3)
    with pytest.raises(SourceError, match=r"no frame for 0\.02 s"):
        next(v4l2.newest_frames(camera(Device())))
    device = Device()
    dequeue = device.dequeue

    def one_more():
        raw = dequeue()
        device.push(0, flags=LOST)
        return raw

    device.dequeue = one_more
    monkeypatch.setattr(
        v4l2.V4L2Camera,
        "next",
        lambda self, timeout, _next=v4l2.V4L2Camera.next: _next(self, timeout) if timeout else None,
    )
    device.push(0, flags=LOST)
    with pytest.raises(SourceError, match="3 damaged frames in a row"):
        next(v4l2.newest_frames(camera(device)))


# ---- names and settings ----


def test_the_argument_is_set_above_the_settings():
    settings = CameraSettings(size=(640, 480), fps=30.0, gain=3)
    assert v4l2.parse("/dev/v4l/by-id/usb-A:b-video-index0", settings) == (
        "/dev/v4l/by-id/usb-A:b-video-index0",
        settings,
    )
    name, given = v4l2.parse("0,width=1280,height=720,fps=60,format=mjpg", settings)
    assert name == "0"
    assert (given.size, given.fps, given.format, given.gain) == ((1280, 720), 60.0, "MJPG", 3)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("", "needs a device; write v4l2:/dev/video0"),
        ("/dev/video987", "/dev/video987: no such device"),
        ("987", "/dev/video987: no such device"),
        ("/dev/null", "is no video device"),
        ("0,width=640", "width and height go together"),
        ("0,width=0,height=5", "must be at least 16, is 0"),
        ("0,fps=0", "fps: must be at least 0.1"),
        ("0,fps=nan", "fps: must be a number"),
        ("0,size=3", "unknown key size"),
        ("0,format=h264", "format: must be 'auto', 'MJPG', 'YUYV', 'NV12' or 'GREY', is 'H264'"),
        ("0,fps=fast", "fps must be a number"),
    ],
)
def test_what_cannot_be_opened_is_refused_in_one_line(spec, words):
    for attempt in (lambda: open_source(f"v4l2:{spec}"), lambda: v4l2.open_camera(spec, CameraSettings())):
        with pytest.raises(SourceError, match=words) as e:
            attempt()
        assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    ("assignment", "words"),
    [("controls=['gain']", 'not "name=value"'), ("exposure_s=0.05", "longer than a frame at 30 per second")],
)
def test_settings_that_cannot_be_are_refused(assignment, words):
    with pytest.raises(ConfigurationError, match=words):
        override(CameraSettings(fps=30.0), assignment)
