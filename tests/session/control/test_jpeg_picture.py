"""Live pictures as JPEG: whole, and masked."""

import cv2
import numpy as np
import pytest
import simplejpeg

from spheremouse.session.control.jpeg_picture import JpegPicture, mask
from spheremouse.session.control.protocol import LivePicture

WIDTH, HEIGHT = 160, 120


def picture(format_, pixels, annotations={}):  # noqa: B006  it is only read
    return LivePicture(
        stamp=0.0, format=format_, width=WIDTH, height=HEIGHT, annotations=annotations, pixels=bytes(pixels)
    )


def scene():
    """Smooth colours, (h, w, 3) BGR, which JPEG and halved chroma keep."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.stack([x, 2 * y % 240, 255 - x], axis=2).astype(np.uint8)


def raw(image, format_):
    """The bytes of a picture in a camera's format, as OpenCV converts it."""
    if format_ == "grey":
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).tobytes()
    if format_ == "bgr":
        return image.tobytes()
    planes = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)  # full range, as JPEG has it
    y, v, u = (planes[:, :, k] for k in range(3))
    if format_ == "yuyv":
        made = np.empty((HEIGHT, WIDTH, 2), np.uint8)
        made[:, :, 0], made[:, 0::2, 1], made[:, 1::2, 1] = y, u[:, ::2], v[:, ::2]
        return made.tobytes()
    return y.tobytes() + np.stack([u[::2, ::2], v[::2, ::2]], axis=2).tobytes()


@pytest.mark.parametrize("format_", ["bgr", "grey", "yuyv", "nv12"])
def test_a_raw_picture_becomes_a_jpeg_of_the_same_colours(format_):
    image = scene()
    seen = simplejpeg.decode_jpeg(JpegPicture(picture(format_, raw(image, format_))).whole, colorspace="BGR")
    true = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR) if format_ == "grey" else image
    assert np.sqrt(np.mean((seen.astype(float) - true) ** 2)) < 4.0


def test_a_jpeg_is_passed_on_as_it_is_and_made_once():
    jpeg = simplejpeg.encode_jpeg(scene(), colorspace="BGR")
    shown = JpegPicture(picture("jpeg", jpeg))
    assert shown.whole == jpeg
    assert shown.whole is shown.whole


@pytest.mark.parametrize(("x", "y", "radius"), [(80.0, 60.0, 40.0), (10.0, 110.0, 50.0), (80.0, 60.0, 300.0)])
def test_the_mask_of_an_outline_is_its_inside(x, y, radius):
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    outline = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)
    keep = mask(np.ones((HEIGHT, WIDTH, 1), np.uint8), {"outline": outline.tolist()})[:, :, 0] == 1
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    distance = np.hypot(u - x, v - y)
    assert keep[distance < radius - 1.0].all()
    assert not keep[distance > radius + 1.0].any()


@pytest.mark.parametrize("format_", ["bgr", "yuyv"])
def test_a_masked_picture_shows_ball_and_targets_alone(format_):
    marks = {
        "outline": [[40, 40], [80, 40], [80, 80], [40, 80]],
        "targets": [{"code": "CMY", "x": 130.0, "y": 30.0, "shape": [25.0, 0.0, 9.0]}],
    }
    white = np.full((HEIGHT, WIDTH, 3), 250, np.uint8)
    jpeg = JpegPicture(picture(format_, raw(white, format_), marks)).masked
    seen = simplejpeg.decode_jpeg(jpeg, colorspace="GRAY")[:, :, 0]
    assert seen[45:75, 45:75].min() > 200
    assert seen[25:36, 125:136].min() > 200
    seen[32:88, 32:88] = seen[12:48, 112:148] = 0
    assert seen.max() < 60


def test_a_mask_follows_the_ball_and_the_targets():
    """Successive pictures share the mask while neither has moved."""
    target = {"x": 20.0, "y": 90.0, "shape": [25.0, 0.0, 9.0]}
    ball = [[40, 40], [80, 40], [80, 80], [40, 80]]
    moved = [[x + 60, y] for x, y in ball]
    for outline, x in ((ball, 20.0), (ball, 20.0), (moved, 20.0), (moved, 140.0), (ball, 20.0)):
        marks = {"outline": outline, "targets": [{**target, "x": x}]}
        keep = mask(np.ones((HEIGHT, WIDTH, 3), np.uint8), marks).all(axis=2)
        assert [keep[60, 50], keep[60, 130]] == [outline is ball, outline is moved]
        assert [keep[90, 20], keep[90, 140]] == [x == 20.0, x == 140.0]


def test_without_a_known_pose_a_masked_picture_is_black():
    seen = simplejpeg.decode_jpeg(JpegPicture(picture("bgr", scene().tobytes())).masked)
    assert seen.max() < 10


def test_a_damaged_picture_is_not_shown_masked():
    jpeg = simplejpeg.encode_jpeg(scene(), colorspace="BGR")
    assert JpegPicture(picture("jpeg", b"\xff\xd8" + bytes(len(jpeg)), {})).masked == b""
