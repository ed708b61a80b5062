"""cv2.VideoCapture without the lines that OpenCV and FFmpeg write to the terminal when something is wrong."""

import os

import cv2


def open_capture(what: str | int) -> cv2.VideoCapture | None:
    """A capture that is open, or None."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; read when FFmpeg is first used
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(0)
    try:
        capture = cv2.VideoCapture(what)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if capture.isOpened():
        return capture
    capture.release()
    return None
