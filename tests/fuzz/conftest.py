"""What all fuzz tests share: a folder, and errors for NumPy's warnings."""

import warnings

import cv2
import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Run in a folder of its own; OpenCV prints nothing, and NumPy's warning before a nan is an error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2.utils.logging.setLogLevel(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield
