"""Source v4l2 on devices of a real kernel: vivid, a camera in software, and v4l2loopback, into which the tests write.

Run by tests/system/run; the modules lie in /run/cameras (run_in_vm.sh). No deadline here is tight: the guest is slow.
"""

import gc
import os
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
from modules import insert, remove
from reporting import error_of_nobody

from spheremouse.capture.settings import CameraSettings
from spheremouse.capture.v4l2 import open_camera
from spheremouse.errors import SourceError

linuxpy = pytest.importorskip("linuxpy.video.device")

W, H = 160, 96
WAIT = 60.0  # s for one frame; thousands of times what it takes
LOOPBACK = 9
RED = 160  # Cr of what is written in colour


def node(name):
    (found,) = [p for p in Path("/sys/class/video4linux").iterdir() if name in (p / "name").read_text()]
    return found.name.removeprefix("video")


@pytest.fixture(scope="module")
def vivid():
    """A function that says which node is the camera; the node may change."""
    insert("vivid", n_devs=1, node_types="0x101", num_inputs=1, input_types=0, num_outputs=1, output_types=0)
    yield lambda: node("vid-cap")
    remove("vivid")  # other tests in this guest load it their way


@pytest.fixture(scope="module")
def loopback():
    insert("v4l2loopback", video_nr=LOOPBACK, max_buffers=8)
    yield str(LOOPBACK)
    remove("v4l2loopback")


def drain(camera):
    while (raw := camera.next(2.0)) is not None:
        raw.release()


def controls(path, *names):
    """Values of controls, asked for by another file descriptor."""
    with linuxpy.Device(f"/dev/video{path}") as device:
        return [int(device.controls[n].value) for n in names]


# ---- v4l2loopback: every format, and what is in the pictures ----


def picture(number):
    """Luma (H, W) that holds a number in its first row's brightness and is smooth elsewhere."""
    y, x = np.mgrid[0:H, 0:W]
    image = (60 + x // 2 + y // 4).astype(np.uint8)
    image[:16] = 20 + 8 * (number % 25)
    return image


def number_in(image):
    return round((float(image[4:12].mean()) - 20) / 8)


def encoded(name, number):
    luma = picture(number)
    if name == "YUYV":
        data = np.full((H, W, 2), 128, np.uint8)
        data[:, :, 0], data[:, 1::2, 1] = luma, RED
        return data.tobytes()
    if name == "NV12":
        chroma = np.full((H // 2, W // 2, 2), 128, np.uint8)
        chroma[:, :, 1] = RED
        return luma.tobytes() + chroma.tobytes()
    if name == "MJPG":
        return cv2.imencode(".jpg", luma, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    return luma.tobytes()


@contextmanager
def writing(name, interval=0.05):
    """A loopback device that is written into; yields what ends it. Frames are numbered in their pictures."""
    device = linuxpy.Device.from_id(LOOPBACK)
    device.open()
    device.set_format(linuxpy.BufferType.VIDEO_OUTPUT, W, H, name)
    frames = [encoded(name, n) for n in range(25)]
    stop, first = threading.Event(), threading.Event()

    def write():
        number = 0
        while not stop.is_set():
            os.write(device.fileno(), frames[number % 25])
            number += 1
            if number > 2:
                first.set()
            time.sleep(interval)

    thread = threading.Thread(target=write)
    thread.start()

    def end():
        stop.set()
        thread.join()
        device.close()

    assert first.wait(WAIT)
    try:
        yield end
    finally:
        end()


@pytest.mark.parametrize("name", ["YUYV", "NV12", "GREY", "MJPG"])
def test_frames_of_every_format_arrive_as_they_were_written(loopback, name):
    with writing(name), open_camera(loopback, CameraSettings()) as camera:
        assert f"{W}x{H} {name}" in camera.describe()
        numbers, sequences, stamps = [], [], []
        for _ in range(12):
            raw = camera.next(WAIT)
            frame = raw.frame(colour=False)
            number = number_in(frame.image)
            expected = picture(number)
            if name == "MJPG":
                np.testing.assert_allclose(frame.image.astype(int), expected, rtol=0, atol=12)
                assert np.abs(frame.image.astype(int) - expected).mean() < 1.5
            else:
                np.testing.assert_array_equal(frame.image, expected)
                assert np.shares_memory(frame.image, camera._device.buffers[raw._index])  # the driver's own
            assert raw.stamp < time.monotonic()
            numbers.append(number)
            sequences.append(raw.sequence)
            stamps.append(raw.stamp)
            raw.release()
    print(camera.describe())
    assert np.all(np.diff(stamps) > 0)
    # the first buffer is handed out twice by v4l2loopback 0.12; from then on what it counts is what was written
    np.testing.assert_array_equal(np.diff(numbers)[2:] % 25, np.diff(sequences)[2:] % 25)


def test_a_writer_that_ends_is_a_camera_that_gives_nothing_until_it_comes_back(loopback):
    with writing("GREY") as end, open_camera(loopback, CameraSettings()) as camera:
        camera.next(WAIT).release()
        end()
        drain(camera)
        assert camera.next(0.2) is None
        with writing("GREY"):
            raw = camera.next(WAIT)
            np.testing.assert_array_equal(raw.frame(False).image, picture(number_in(raw.frame(False).image)))
            raw.release()


def test_nobody_has_written_yet(loopback):
    subprocess.run(["/sbin/rmmod", "v4l2loopback"], check=True)
    insert("v4l2loopback", video_nr=LOOPBACK, max_buffers=8)
    with pytest.raises(SourceError, match="this loopback device has no writer"):
        open_camera(loopback, CameraSettings())


# ---- vivid: modes, controls, stamps, plug and unplug ----


PATTERNS = {"100% White": (255, 255, 255), "100% Red": (0, 0, 255), "100% Blue": (255, 0, 0)}


@pytest.mark.parametrize(
    ("name", "pattern"),
    [("YUYV", "100% White"), ("YUYV", "100% Red"), ("NV12", "100% Blue"), ("GREY", "100% Red")],
)
def test_size_rate_format_and_what_is_seen_are_as_asked(vivid, name, pattern):
    settings = CameraSettings(controls=(f"test_pattern={pattern}", "osd_text_mode=none"))
    with open_camera(f"{vivid()},width=320,height=180,fps=15,format={name}", settings) as camera:
        assert f"320x180 {name}, 15 frames/s" in camera.describe()
        raw = camera.next(WAIT)
        luma, colours = raw.frame(False).image, raw.frame(True).image.astype(int)
        b, g, r = PATTERNS[pattern]
        if name == "GREY":  # vivid weighs that as BT.709
            np.testing.assert_allclose(luma.astype(int), 0.213 * r + 0.715 * g + 0.072 * b, rtol=0, atol=3)
        else:
            grey = 0.299 * r + 0.587 * g + 0.114 * b  # BT.601
            np.testing.assert_allclose(luma.astype(int), 16 + grey * 219 / 255, rtol=0, atol=3)
            np.testing.assert_allclose(colours, np.broadcast_to([b, g, r], colours.shape), rtol=0, atol=6)
        raw.release()


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        ("format=MJPG", "has no MJPG; it has YUYV 320x180, 640x360"),
        ("width=321,height=180", "has no 321x180; it has YUYV 320x180"),
        ("width=321,height=180,format=GREY", "has no 321x180 in GREY"),
        ("width=320,height=180,fps=59",
         "gives 60 frames per second in place of 59 at 320x180 YUYV; it has 1, 2, .*50, 60"),
    ],
)  # fmt: skip
def test_what_the_camera_has_not_is_said_with_what_it_has(vivid, ask, words):
    with pytest.raises(SourceError, match=words) as e:
        open_camera(f"{vivid()},{ask}", CameraSettings())
    assert "\n" not in str(e.value)
    with open_camera(vivid(), CameraSettings()) as camera:  # nothing was left open
        camera.next(WAIT).release()


@pytest.mark.parametrize("source", ["end of frame", "start of exposure"])
def test_stamps_ahead_of_the_clock_come_out_behind_it_and_regular(vivid, source):
    moment = 0 if source == "end of frame" else 1
    settings = CameraSettings(size=(320, 180), fps=25.0, controls=(f"timestamp_source={moment}",))
    with open_camera(vivid(), settings) as camera:
        stamps, ages, sequences = [], [], []
        for _ in range(60):
            raw = camera.next(WAIT)
            ages.append(time.monotonic() - raw.stamp)
            stamps.append(raw.stamp)
            sequences.append(raw.sequence)
            raw.release()
    print(camera.describe())
    assert f"stamps at {source}, monotonic clock" in camera.describe()
    assert any("ahead of the clock" in note for note in camera.notes) == (source == "end of frame")
    assert min(ages) > 0
    assert np.all(np.diff(stamps) > 0)
    settled = np.polyfit(sequences[15:], stamps[15:], 1)[0]
    assert settled == pytest.approx(1 / 25, rel=0.08)


def test_controls_are_set_by_name_and_restored(vivid):
    names = ("brightness", "menu", "gain_automatic", "horizontal_flip")
    before = controls(vivid(), *names)
    settings = CameraSettings(gain=33, controls=("brightness=77", "menu=Menu Item 4", "horizontal_flip=on"))
    with open_camera(vivid(), settings) as camera:
        assert controls(vivid(), *names, "gain") == [77, 4, 0, 1, 33]
        assert "set gain 33, brightness 77, menu 4, horizontal_flip 1" in camera.describe()
    assert controls(vivid(), *names) == before
    assert before == [128, 3, 1, 0]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (CameraSettings(controls=("brightness=77", "brightness_=3")),
         "no control brightness_; did you mean brightness"),
        (CameraSettings(controls=("brightness=77", "contrast=256")),
         "contrast: 256 is not possible; the camera takes 0 to 255"),
        (CameraSettings(controls=("brightness=77", "menu=x")),
         r"menu must be 1 \(menu item 1\), .*, is 'x'|menu must be"),
        (CameraSettings(controls=("brightness=77",), exposure_s=0.01), "exposure_s: the camera has no such control"),
        (CameraSettings(controls=("brightness=77",), focus=1), "focus: the camera has no such control"),
    ],
)  # fmt: skip
def test_controls_that_cannot_be_set_leave_the_others_as_they_were(vivid, settings, words):
    before = controls(vivid(), "brightness")
    with pytest.raises(SourceError, match=words) as e:
        open_camera(vivid(), settings)
    assert "\n" not in str(e.value)
    assert controls(vivid(), "brightness") == before != [77]


def test_a_second_program_is_told_that_the_camera_is_in_use(vivid):
    with open_camera(vivid(), CameraSettings(size=(320, 180))) as camera:
        camera.next(WAIT).release()
        with pytest.raises(SourceError, match="another program uses it; `fuser -v /dev/video"):
            open_camera(vivid(), CameraSettings())
        camera.next(WAIT).release()


def test_a_picture_that_is_still_looked_at_does_not_keep_the_camera_from_others(vivid):
    with open_camera(vivid(), CameraSettings(size=(320, 180), fps=50.0)) as camera:
        image = camera.next(WAIT).frame(False).image
        before = image.copy()
    for size in ((320, 180), (640, 360)):
        with open_camera(vivid(), CameraSettings(size=size)) as camera:
            camera.next(WAIT).release()
    np.testing.assert_array_equal(image, before)


def test_a_node_that_gives_no_pictures(vivid):
    with pytest.raises(SourceError, match=r"gives no images .*; here: /dev/video"):
        open_camera(node("vid-out"), CameraSettings())


def test_without_permission_the_error_says_what_to_do(vivid):
    path = f"/dev/video{vivid()}"
    said = error_of_nobody(lambda: open_camera(path, CameraSettings()))
    assert "may not be opened; as root: usermod -aG video" in said


def test_a_camera_that_is_pulled_out_is_said_and_comes_back(vivid):
    path, driver = vivid(), Path("/sys/bus/platform/drivers/vivid")
    with open_camera(path, CameraSettings(size=(320, 180), fps=30.0, controls=("brightness=77",))) as camera:
        held = camera.next(WAIT)
        image = held.frame(False).image
        before = image.copy()
        (driver / "unbind").write_text("vivid.0")
        with pytest.raises(SourceError, match="gone"):
            drain(camera)
        np.testing.assert_array_equal(image, before)  # what is held stays readable
        held.release()
    with pytest.raises(SourceError, match="no such device"):
        open_camera(path, CameraSettings())
    (driver / "bind").write_text("vivid.0")
    with open_camera(vivid(), CameraSettings()) as camera:
        camera.next(WAIT).release()


def test_opening_and_closing_leaks_nothing(vivid):
    def open_files():
        return len(os.listdir("/proc/self/fd")), sum(
            "/dev/video" in x for x in Path("/proc/self/maps").read_text().splitlines()
        )

    def once():
        with open_camera(vivid(), CameraSettings(size=(320, 180), fps=50.0)) as camera:
            camera.next(WAIT).release()
        with pytest.raises(SourceError):
            open_camera(f"{vivid()},format=MJPG", CameraSettings())

    gc.collect()  # what tests before this one still hold is not counted, nor missed afterwards
    once()
    before = open_files()
    for _ in range(5):
        once()
    gc.collect()
    assert all(after <= kept for after, kept in zip(open_files(), before, strict=True))
