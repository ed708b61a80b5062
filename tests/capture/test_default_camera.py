"""The camera that commands propose."""

import sys

import pytest

from spheremouse.capture.default_camera import default_camera


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have no names for cameras")
def test_a_camera_is_named_by_what_stays(tmp_path):
    assert default_camera(tmp_path / "none") == "v4l2:/dev/video0"
    assert default_camera(tmp_path) == "v4l2:/dev/video0"
    for name in ("usb-Zed_Cam_1-video-index0", "usb-Acme_Cam_2-video-index0", "usb-Acme_Cam_2-video-index1"):
        (tmp_path / name).touch()
    assert default_camera(tmp_path) == f"v4l2:{tmp_path}/usb-Acme_Cam_2-video-index0"


def test_elsewhere_it_is_the_first_one_of_opencv(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "platform", "darwin")
    assert default_camera(tmp_path) == "opencv:0"
