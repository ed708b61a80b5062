"""Pixels: luma and colours against values worked out here, and what is no whole picture refused in words."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.capture.v4l2.pixels import Layout, bgr, luma, payload_of
from spheremouse.errors import DamagedFrameError

W, H = 64, 48
RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 256, (H, W), dtype=np.uint8)


def smooth(width=W, height=H):
    """A picture that JPEG keeps well, (h, w, 3) BGR."""
    noise = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.0), None, 0, 255, cv2.NORM_MINMAX)


def jpeg(image, **options):
    flags = {"quality": cv2.IMWRITE_JPEG_QUALITY, "restart": cv2.IMWRITE_JPEG_RST_INTERVAL}
    given = [x for k, v in options.items() for x in (flags[k], v)]
    return cv2.imencode(".jpg", image, given)[1].tobytes()


JPEG = jpeg(smooth(), quality=90)
MJPG = Layout("MJPG", W, H, 0)


def array(data):
    return np.frombuffer(bytes(data), np.uint8)


def yuyv(y, u=128, v=128, padding=0):
    """Bytes of a picture with luma (h, w) and one colour; rows followed by padding."""
    rows = np.empty((H, W * 2 + padding), np.uint8)
    rows[:] = 77
    rows[:, 0 : 2 * W : 2] = y
    rows[:, 1 : 2 * W : 4], rows[:, 3 : 2 * W : 4] = u, v
    return rows.reshape(-1), Layout("YUYV", W, H, rows.shape[1])


def nv12(y, u=128, v=128, padding=0):
    rows = np.full((H + H // 2, W + padding), 77, np.uint8)
    rows[:H, :W] = y
    rows[H:, 0:W:2], rows[H:, 1:W:2] = u, v
    return rows.reshape(-1), Layout("NV12", W, H, rows.shape[1])


def grey(y, padding=0):
    rows = np.full((H, W + padding), 77, np.uint8)
    rows[:, :W] = y
    return rows.reshape(-1), Layout("GREY", W, H, rows.shape[1])


RAW = {"YUYV": yuyv, "NV12": nv12, "GREY": grey}


@pytest.mark.parametrize("name", RAW)
@pytest.mark.parametrize("padding", [0, 32])
def test_luma_of_uncompressed_formats_is_exact_and_a_view(name, padding):
    payload, layout = RAW[name](GREY, padding=padding)
    image = luma(payload, layout)
    np.testing.assert_array_equal(image, GREY)
    assert np.shares_memory(image, payload)


@pytest.mark.parametrize("name", RAW)
def test_the_last_row_need_not_be_padded_and_one_byte_less_is_refused(name):
    payload, layout = RAW[name](GREY, padding=32)
    assert layout.size == len(payload) - 32
    np.testing.assert_array_equal(luma(payload[: layout.size], layout), GREY)
    assert bgr(payload[: layout.size], layout).shape == (H, W, 3)
    for read in (luma, bgr):
        with pytest.raises(DamagedFrameError, match=f"frame of {layout.size - 1} bytes; {layout.size} are a whole one"):
            read(payload[: layout.size - 1], layout)


@pytest.mark.parametrize("name", ["YUYV", "NV12"])
@pytest.mark.parametrize(("y", "u", "v"), [(126, 128, 128), (81, 90, 240), (145, 54, 34), (41, 240, 110)])
def test_colours_are_those_of_bt_601(name, y, u, v):
    payload, layout = RAW[name](np.uint8(y), u, v, padding=16)
    red = 1.164 * (y - 16) + 1.596 * (v - 128)
    green = 1.164 * (y - 16) - 0.392 * (u - 128) - 0.813 * (v - 128)
    blue = 1.164 * (y - 16) + 2.017 * (u - 128)
    image = bgr(payload, layout)
    assert image.shape == (H, W, 3)
    np.testing.assert_allclose(image.reshape(-1, 3).mean(axis=0), np.clip([blue, green, red], 0, 255), rtol=0, atol=2)
    assert not np.shares_memory(image, payload)


def test_grey_has_three_times_the_same():
    payload, layout = grey(GREY)
    np.testing.assert_array_equal(bgr(payload, layout), np.repeat(GREY[:, :, None], 3, axis=2))


def test_a_jpeg_is_what_another_decoder_makes_of_it():
    truth = cv2.imdecode(array(JPEG), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_allclose(luma(array(JPEG), MJPG).astype(int), truth, rtol=0, atol=1)
    colours = cv2.imdecode(array(JPEG), cv2.IMREAD_COLOR)
    np.testing.assert_allclose(bgr(array(JPEG), MJPG).astype(int), colours, rtol=0, atol=4)
    assert np.abs(colours.astype(int) - smooth()).mean() < 8


def segments(data):
    """Marker, begin and end of the segments before the coded data."""
    i = 2
    while data[i + 1] != 0xDA:
        end = i + 2 + int.from_bytes(data[i + 2 : i + 4], "big")
        yield data[i + 1], i, end
        i = end


def test_a_motion_jpeg_without_huffman_tables_is_whole():
    bare = bytearray(JPEG)
    for marker, begin, end in reversed(list(segments(JPEG))):
        if marker == 0xC4:
            del bare[begin:end]
    assert len(bare) < len(JPEG) - 300
    np.testing.assert_array_equal(luma(array(bare), MJPG), luma(array(JPEG), MJPG))


def test_what_lies_behind_the_end_in_the_buffer_does_not_matter():
    for rest in (bytes(5000), JPEG, RNG.bytes(5000)):
        np.testing.assert_array_equal(luma(array(JPEG + rest), MJPG), luma(array(JPEG), MJPG))


def test_stray_bytes_before_a_marker_do_no_harm():
    """Many cameras send them. As many as a lost or doubled packet leaves over are taken for what they are."""
    data = jpeg(smooth(), restart=4)
    for marker in (b"\xff\xd0", b"\xff\xd1", b"\xff\xd9"):
        at = data.rindex(marker)
        for n in (1, 8, 20, 60):
            np.testing.assert_array_equal(luma(array(data[:at] + bytes(n) + data[at:]), MJPG), luma(array(data), MJPG))
        with pytest.raises(DamagedFrameError, match="extraneous bytes before marker"):
            luma(array(data[:at] + bytes(100) + data[at:]), MJPG)


@pytest.mark.parametrize("read", [luma, bgr])
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "frame of 0 bytes that does not begin as a JPEG"),
        (bytes(3000), "does not begin as a JPEG"),
        (JPEG[1:], "does not begin as a JPEG"),
        (b"\xff\xd8\xff\xd9", "no JPEG"),
        (JPEG[:400], "no JPEG: the header of a frame of 400 bytes cannot be read"),
        (JPEG[: len(JPEG) // 2], "damaged JPEG: Premature end"),
        (JPEG[: len(JPEG) // 2] + b"\xff\xd9", "damaged JPEG: premature end"),
        (JPEG[:900] + JPEG[1300:], "damaged JPEG"),
        (jpeg(smooth(W + 16)), "JPEG of 80x48, not 64x48"),
    ],
)
def test_what_is_no_whole_jpeg_is_refused_in_one_line(read, data, words):
    with pytest.raises(DamagedFrameError, match=words) as e:
        read(array(data), MJPG)
    assert "\n" not in str(e.value)


@st.composite
def damaged(draw):
    """A JPEG with a few things done to it, or anything at all."""
    if draw(st.booleans()):
        return b"\xff\xd8\xff" + draw(st.binary(max_size=400))
    data = bytearray(JPEG)
    for _ in range(draw(st.integers(1, 6))):
        i = draw(st.integers(0, len(data) - 1))
        match draw(st.sampled_from(["flip", "delete", "insert", "cut", "copy"])):
            case "flip":
                data[i] ^= draw(st.integers(1, 255))
            case "delete":
                del data[i : i + draw(st.integers(1, 300))]
            case "insert":
                data[i:i] = draw(st.binary(max_size=20))
            case "cut":
                del data[i:]
            case "copy":
                data[i:i] = data[:200]
        if not data:
            break
    return bytes(data)


@given(damaged(), st.booleans())
def test_nothing_but_a_picture_or_a_damaged_frame_comes_of_any_bytes(data, colour):
    try:
        image = (bgr if colour else luma)(array(data), MJPG)
    except DamagedFrameError:
        return
    assert image.shape == ((H, W, 3) if colour else (H, W))
    assert image.dtype == np.uint8


@pytest.mark.parametrize("name", RAW)
@pytest.mark.parametrize("padding", [0, 32])
def test_the_payload_is_what_the_camera_sent_without_padding(name, padding):
    """The last row may lack its padding."""
    payload, layout = RAW[name](GREY, padding=padding)
    bare, _ = RAW[name](GREY)
    for data in (payload, payload[: layout.size]):
        image = payload_of(data, layout)
        assert (image.format, image.width, image.height) == (name.lower(), W, H)
        assert bytes(image.data) == bytes(bare)
        assert np.shares_memory(np.frombuffer(image.data, np.uint8), data) == (padding == 0)
    with pytest.raises(DamagedFrameError):
        payload_of(payload[: layout.size - 1], layout)


def test_the_payload_of_a_jpeg_is_its_bytes():
    image = payload_of(array(JPEG), MJPG)
    assert (image.format, image.width, image.height, bytes(image.data)) == ("jpeg", W, H, JPEG)
    with pytest.raises(DamagedFrameError):
        payload_of(array(b""), MJPG)
