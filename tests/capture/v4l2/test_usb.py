"""The USB reset of a camera, on a tree like sysfs. tests/system/board.py resets a device of a real kernel."""

import pytest

from spheremouse.capture.v4l2 import usb
from spheremouse.capture.v4l2.device import Device
from spheremouse.errors import SourceError, TransferError


@pytest.fixture
def listed(tmp_path):
    device = tmp_path / "devices/pci0/usb1/1-4"
    interface = device / "1-4:1.0"
    for folder in (interface / "video4linux/video3", tmp_path / "class", tmp_path / "devices/virtual/video4"):
        folder.mkdir(parents=True)
    for name, text in (("busnum", "1\n"), ("devnum", "12\n"), ("product", "HD Camera\n")):
        (device / name).write_text(text)
    (tmp_path / "class/video3").symlink_to(interface / "video4linux/video3")
    (tmp_path / "class/video4").symlink_to(tmp_path / "devices/virtual/video4")
    return tmp_path / "class"


def test_the_device_behind_a_camera_is_named_with_the_reason_why_it_stays(listed, tmp_path):
    said = usb.reset_camera("/dev/video3", listed, tmp_path)
    assert f"{tmp_path}/001/012 (HD Camera) cannot be reset (No such file or directory)" in said
    (tmp_path / "001").mkdir()
    (tmp_path / "001/012").touch()
    said = usb.reset_camera("/dev/video3", listed, tmp_path)
    assert "cannot be reset (Inappropriate ioctl for device); plug it in again" in said
    assert "no USB camera" in usb.reset_camera("/dev/video4", listed, tmp_path)


def test_the_kernel_is_asked_to_reset_that_device(listed, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(usb.fcntl, "ioctl", lambda fd, request, _: asked.append(request))
    (tmp_path / "001").mkdir()
    (tmp_path / "001/012").touch()
    assert "001/012 (HD Camera) was reset" in usb.reset_camera("/dev/video3", listed, tmp_path)
    assert asked == [ord("U") << 8 | 20]  # USBDEVFS_RESET


@pytest.mark.parametrize(("number", "kind"), [(71, TransferError), (110, TransferError), (19, SourceError)])
def test_only_errors_of_the_bus_ask_for_a_reset(number, kind, monkeypatch):
    def fail(*_):
        raise OSError(number, "error")

    monkeypatch.setattr("spheremouse.capture.v4l2.device.os.open", fail)
    with pytest.raises(SourceError) as e:
        Device("/dev/video3")
    assert type(e.value) is kind
