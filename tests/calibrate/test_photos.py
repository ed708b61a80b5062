"""Photos: pixels as the sensor read them, and whatever a camera, a phone or a copy can spoil is said with its file."""

import hashlib
import io
import shutil

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from spheremouse.calibrate.photos import image, read_photos
from spheremouse.errors import CalibrationError

ORIENTATION = 0x0112
W, H = 96, 64


def pixels(seed=0, size=(W, H)):
    """A smooth picture without any symmetry, (h, w, 3) BGR, which JPEG changes little."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (5, 7, 3)).astype(np.uint8)
    return cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)


def save(path, seed=0, size=(W, H), orientation=None, form=None):
    exif = Image.Exif()
    if orientation is not None:
        exif[ORIENTATION] = orientation
    form = form or {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG", ".tif": "TIFF", ".bmp": "BMP"}[path.suffix.lower()]
    more = {"quality": 98, "subsampling": 0} if form == "JPEG" else {}
    more |= {"exif": exif} if orientation is not None else {}
    Image.fromarray(pixels(seed, size)[..., ::-1]).save(path, form, **more)
    return path


def silent(text):
    pytest.fail(f"an unexpected note: {text}")


def refused(paths, *words):
    with pytest.raises(CalibrationError) as e:
        read_photos(paths, note=lambda _: None)
    for word in words:
        assert word in str(e.value)
    return str(e.value)


@pytest.mark.parametrize("suffix", [".jpg", ".JPEG", ".png", ".tif", ".BMP"])
def test_a_photo_is_what_the_file_says(tmp_path, suffix):
    path = save(tmp_path / f"a{suffix}", 3)
    (photo,) = read_photos([path], note=silent)
    assert photo.path == path
    assert photo.size == (W, H)
    assert photo.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert not photo.rotated
    assert image(photo).shape == (H, W, 3)
    assert np.abs(image(photo).astype(int) - pixels(3)).max() <= (8 if suffix in {".jpg", ".JPEG"} else 0)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("orientation", [2, 3, 6, 8])
def test_a_rotation_flag_turns_no_pixel_and_is_reported(tmp_path, suffix, orientation):
    """OpenCV by itself turns them: that is what must not happen."""
    flagged, plain = save(tmp_path / f"a{suffix}", 1, orientation=orientation), save(tmp_path / f"b{suffix}", 1)
    assert not np.array_equal(cv2.imread(str(flagged)), cv2.imread(str(plain)))
    notes = []
    one, other = read_photos([flagged, plain], note=notes.append)
    assert (one.rotated, other.rotated) == (True, False)
    assert one.size == other.size == (W, H)
    assert_array_equal(image(one), image(other))
    assert len(notes) == 1
    assert str(flagged) in notes[0]
    assert "rotation flag" in notes[0]


def test_a_tiff_with_a_rotation_flag_is_refused_since_decoders_turn_it(tmp_path):
    refused([save(tmp_path / "a.tif", orientation=6)], "a.tif", "rotation flag", "JPEG")


def test_a_folder_gives_its_photos_in_natural_order_and_nothing_else(tmp_path):
    for i, name in enumerate(["IMG_10.jpg", "IMG_2.JPG", "img_1.Jpeg", "b3.png"]):
        save(tmp_path / name, i)
    (tmp_path / "notes.txt").write_text("not a photo")
    (tmp_path / ".hidden.jpg").write_text("rubbish of some system")
    (tmp_path / "sub.jpg").mkdir()
    photos = read_photos([tmp_path], note=silent)
    assert [p.path.name for p in photos] == ["b3.png", "img_1.Jpeg", "IMG_2.JPG", "IMG_10.jpg"]


def test_the_same_photo_twice_counts_once_and_is_named(tmp_path):
    path = save(tmp_path / "a.jpg", 1)
    shutil.copy(path, tmp_path / "copy.jpg")
    save(tmp_path / "b.jpg", 2)
    notes = []
    photos = read_photos([tmp_path], note=notes.append)
    assert [p.path.name for p in photos] == ["a.jpg", "b.jpg"]
    assert len(notes) == 1
    assert "copy.jpg: the same photo as" in notes[0]
    assert len(read_photos([path, tmp_path / "a.jpg"], note=silent)) == 1  # the very file: nothing to say


@pytest.mark.parametrize(("size", "orientation"), [((48, 32), None), ((H, W), 6)])
def test_the_minority_of_sizes_is_listed(tmp_path, size, orientation):
    """Photos turned by software, too, beside flagged ones, which are all right."""
    for i in range(4):
        save(tmp_path / f"a{i}.jpg", i, orientation=orientation)
    for i in range(2):
        save(tmp_path / f"b{i}.jpg", i, size)
    other = f"{size[0]}x{size[1]}"
    text = refused([tmp_path], "b0.jpg", f"b1.jpg: {other}, and the others 96x64", "another mode or zoom, or turned by")
    assert "a0.jpg" not in text


def phone_jpeg(path):
    """A photo with a thumbnail, whose end marker is not the photo's, in front of its pixels."""
    thumbnail = io.BytesIO()
    Image.fromarray(pixels(9, (24, 16))[..., ::-1]).save(thumbnail, "JPEG")
    data = save(path, 5, (320, 240)).read_bytes()
    segment = b"\xff\xe3" + (thumbnail.tell() + 2).to_bytes(2) + thumbnail.getvalue()
    path.write_bytes(data[:2] + segment + data[2:])
    return path


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.9, -2, -1])
def test_a_jpeg_cut_short_is_refused_though_opencv_reads_it(tmp_path, keep):
    path = phone_jpeg(tmp_path / "cut.jpg")
    data = path.read_bytes()
    assert read_photos([path], note=silent)
    cut = data[: int(keep * len(data)) if keep > 0 else keep]
    path.write_bytes(cut)
    if keep != 0.3:  # OpenCV is that generous
        assert cv2.imread(str(path)) is not None
    refused([path], "cut.jpg", "copy it from the camera again")
    path.write_bytes(cut + bytes(len(data)))  # a card that was pulled out leaves zeros
    refused([path], "cut.jpg", "copy it from the camera again")


def test_what_phones_put_behind_a_photo_does_no_harm(tmp_path):
    """A film, a second picture, padding: whatever bytes."""
    path = phone_jpeg(tmp_path / "a.jpg")
    path.write_bytes(path.read_bytes() + b"\xff\xda" + np.random.default_rng(0).bytes(50_000) + bytes(100))
    (photo,) = read_photos([path], note=silent)
    assert np.abs(image(photo).astype(int) - pixels(5, (320, 240))).max() <= 8


@pytest.mark.parametrize("form", ["JPEG progressive", "PNG"])
def test_other_ways_to_write_a_photo_are_whole_or_refused(tmp_path, form):
    path = tmp_path / ("a.png" if form == "PNG" else "a.jpg")
    Image.fromarray(pixels(2)[..., ::-1]).save(path, form.split()[0], progressive=True)
    data = path.read_bytes()
    assert read_photos([path], note=silent)
    path.write_bytes(data[: len(data) * 2 // 3])
    refused([path], path.name, "copy it from the camera again")


def test_what_is_no_photo_is_told_with_what_to_do(tmp_path):
    text, empty = tmp_path / "t.jpg", tmp_path / "e.jpg"
    text.write_text("a recipe for jam\n")
    empty.write_bytes(b"")
    refused([text], "t.jpg", "not a picture", "JPEG, PNG, TIFF or BMP")
    refused([empty], "e.jpg", "empty")
    refused([tmp_path / "nowhere.jpg"], "nowhere.jpg", "no such photo")
    refused([], "no photos")
    good = save(tmp_path / "good.png")
    lines = refused([good, text, empty], "t.jpg", "e.jpg").splitlines()
    assert len(lines) == 2  # a line each, all at once
    (tmp_path / "phone").mkdir()
    (tmp_path / "phone/IMG_0.HEIC").write_bytes(b"x")
    refused([tmp_path / "phone"], f"{tmp_path}/phone: no photos in it", "convert others (HEIC) to JPEG")


def test_a_file_that_changed_since_is_refused(tmp_path):
    (photo,) = read_photos([save(tmp_path / "a.png")], note=silent)
    save(photo.path, size=(48, 32))
    with pytest.raises(CalibrationError, match=r"a\.png"):
        image(photo)
    photo.path.unlink()
    with pytest.raises(CalibrationError, match="no such photo"):
        image(photo)
