"""What all fuzz tests share: a folder, compiled kernels, and errors for NumPy's warnings."""

import warnings
from dataclasses import replace
from itertools import product

import cv2
import pytest

from spheremouse.ball import warm as ball
from spheremouse.ball.settings import Settings
from spheremouse.session.offline import make_wand_ready


@pytest.fixture(autouse=True, scope="session")
def compiled():
    """Compile first, since that takes longer than an example may."""
    for tracker, detector in product(("so3", "ekf1", "ekf2"), ("default", "blobs")):
        ball.warm_up(replace(Settings(), tracker=tracker, detector=detector))
    make_wand_ready()


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Run in a folder of its own; OpenCV prints nothing, and NumPy's warning before a nan is an error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2.utils.logging.setLogLevel(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield
