"""Ring targets: centres against exactly drawn ellipses, all codes, look-alikes of the room, bad light."""

import cv2
import numpy as np
import pytest

from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.ball.rig import CODES

RADII = np.array([0.012, 0.024, 0.036])
SETTINGS = RingSettings()
INK = {  # BGR of prints in ordinary light
    "C": np.array([205.0, 190.0, 30.0]),
    "M": np.array([170.0, 40.0, 190.0]),
    "Y": np.array([40.0, 205.0, 215.0]),
    "K": np.array([30.0, 30.0, 30.0]),
    "W": np.array([235.0, 235.0, 235.0]),
}
FINE = 8  # samples per pixel and axis


def blank(height=120, width=160, level=200.0):
    return np.full((height, width, 3), level)


def disc(image, colour, centre, axes, angle=0.0):
    """Paint an ellipse: each pixel takes the share of it that is covered, by FINE² samples."""
    h, w = image.shape[:2]
    sub = (np.arange(FINE) + 0.5) / FINE - 0.5
    reach = int(np.ceil(max(axes))) + 2
    x0, y0 = (max(int(c) - reach, 0) for c in centre)
    x1, y1 = min(int(centre[0]) + reach + 1, w), min(int(centre[1]) + reach + 1, h)
    x = (np.arange(x0, x1)[:, None] + sub).ravel() - centre[0]
    y = (np.arange(y0, y1)[:, None] + sub).ravel() - centre[1]
    c, s = np.cos(angle), np.sin(angle)
    u = (c * x[None, :] + s * y[:, None]) / axes[0]
    v = (-s * x[None, :] + c * y[:, None]) / axes[1]
    cover = (u * u + v * v < 1.0).reshape(y1 - y0, FINE, x1 - x0, FINE).mean(axis=(1, 3))[..., None]
    image[y0:y1, x0:x1] = (1.0 - cover) * image[y0:y1, x0:x1] + cover * INK[colour]


def target(image, code, centre, outer, *, flat=1.0, angle=0.0, rings=(1.0, 2.0 / 3.0, 1.0 / 3.0)):
    """Concentric ellipses, `code` inside to outside; `outer` px is the larger semi-axis of the outermost."""
    for colour, share in zip(reversed(code), rings, strict=True):
        disc(image, colour, centre, (outer * share, outer * share * flat), angle)


def photo(image, noise=0.0, brightness=0.0, seed=0):
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(image + brightness + noise * rng.normal(size=image.shape)), 0, 255).astype(np.uint8)


def found(image, settings=SETTINGS):
    return detect_targets(image, RADII, settings)


@pytest.mark.parametrize("outer", [12.0, 16.0, 30.0])
def test_every_code_is_found_and_measured(outer):
    """All six in one picture, at random places within the pixel: centres within 0.03 px."""
    rng = np.random.default_rng(int(outer))
    pitch = int(2 * outer + 20)
    image = blank(2 * pitch, 3 * pitch)
    truth = {}
    for i, code in enumerate(CODES):
        centre = np.array([(i % 3 + 0.5) * pitch, (i // 3 + 0.5) * pitch]) + rng.uniform(-0.5, 0.5, 2)
        target(image, code, centre, outer, flat=rng.uniform(0.75, 1.0), angle=rng.uniform(0, np.pi))
        truth[code] = centre
    seen = found(photo(image))
    assert sorted(seen.codes) == sorted(CODES)
    assert len(seen.contours) == len(seen) == 6
    for code, centre in zip(seen.codes, seen.centre, strict=True):
        assert np.abs(centre - truth[code]).max() < 0.03, code


SLOPE = np.linspace(0.7, 1.1, 160)[None, :, None]


@pytest.mark.parametrize(
    ("noise", "brightness", "light"),
    [(3.0, 0.0, 1.0), (15.0, 0.0, 1.0), (0.0, -50.0, 1.0), (0.0, 50.0, 1.0), (3.0, 0.0, SLOPE)],
    ids=["noise", "much noise", "dark", "bright", "slope"],
)
def test_noise_and_light_move_the_centre_little(noise, brightness, light):
    errors = []
    for seed in range(8):
        centre = np.array([80.0, 60.0]) + np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
        image = blank()
        target(image, "MYC", centre, 16.0, flat=0.9, angle=0.4)
        seen = found(photo(light * image, noise, brightness, seed))
        assert seen.codes == ("MYC",)
        assert abs(seen.radius[0] - 16.0 * np.sqrt(0.9)) < 1.0
        errors.append(seen.centre[0] - centre)
    assert np.sqrt(np.mean(np.square(errors))) < 0.06 + 0.01 * noise


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize(("quality", "within"), [(30, 1.5), (50, 1.1)])
def test_colours_that_a_camera_washes_out_do_not_change_the_radius(code, quality, within):
    """JPEG with half the resolution of colours shrinks the inner circles, so that a ring's hole seems in proportion."""
    for outer in (11.0, 12.5, 14.0, 16.0, 18.0):
        image = blank()
        target(image, code, (80.3, 60.7), outer)
        seen = found(cv2.imdecode(cv2.imencode(".jpg", photo(image), [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1))
        assert seen.codes == (code,)
        assert seen.radius == pytest.approx([outer], abs=within)


@pytest.mark.parametrize("light", [(0.6, 0.9, 1.15), (1.15, 0.95, 0.65), (0.8, 1.05, 0.8), (0.3, 0.3, 0.3)])
@pytest.mark.parametrize("code", CODES)
def test_no_light_changes_the_hues_of_a_print(code, light):
    """Warm, cold, green and dim light: paper is white in each."""
    image = blank()
    target(image, code, (80.3, 60.7), 14.0)
    seen = found(photo(image * light, noise=2.0))
    assert seen.codes == (code,)
    assert np.linalg.norm(seen.centre[0] - (80.3, 60.7)) < 0.1


def test_single_discs_double_rings_and_wrong_nestings_are_ignored():
    image = blank(480, 320)
    for i, colour in enumerate("CMY"):  # side by side
        disc(image, colour, (40.0 + 40 * i, 40.0), (18.0, 18.0))
    for i, pair in enumerate(["CM", "MY", "YC", "MC"]):
        target(image, pair, (40.0 + 70 * i, 100.0), 20.0, rings=(1.0, 0.5))
        target(image, pair, (40.0 + 70 * i, 160.0), 20.0, rings=(2 / 3, 1 / 3))
    for i, code in enumerate(["MCM", "CMC", "YCY", "CCY", "KCM", "CKM", "CMK", "WCM", "YYY"]):
        target(image, code, (40.0 + 60 * (i % 5), 240.0 + 60 * (i // 5)), 24.0)
    assert len(found(photo(image))) == 0


def test_a_fourth_ring_does_not_move_the_centre():
    """C around CMY: the sign within, or the one made of its outer three; in either case the same centre."""
    image = blank()
    target(image, "CMY", (80.0, 60.0), 20.0)
    clean = found(photo(image)).centre[0]
    image = blank()
    disc(image, "C", (80.0, 60.0), (27.0, 27.0))
    target(image, "CMY", (80.0, 60.0), 20.0)
    seen = found(photo(image))
    assert set(seen.codes) <= {"CMY", "MYC"}
    assert all(np.abs(c - clean).max() < 0.05 for c in seen.centre)


@pytest.mark.parametrize("share", [0.15, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("by", ["edge", "finger"])
def test_a_target_cut_by_something_is_measured_right_or_not_at_all(share, by):
    """`share` of its outer radius is gone: at the edge of the picture, or under something dark."""
    outer = 16.0
    image = blank()
    x = outer * (1.0 - share) if by == "edge" else 80.0
    target(image, "CMY", (x, 60.0), outer)
    if by == "finger":
        image[:, : int(80.0 - outer * (1.0 - share))] = 60.0
    seen = found(photo(image))
    assert len(seen) <= 1
    if len(seen):
        assert np.abs(seen.centre[0] - [x, 60.0]).max() < 0.5


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((120, 160, 3), np.uint8),
        np.full((120, 160, 3), 255, np.uint8),
        np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8),
        np.zeros((1, 1, 3), np.uint8),
        np.tile(np.array(INK["C"], dtype=np.uint8), (120, 160, 1)),
    ],
    ids=["black", "white", "noise", "one pixel", "all cyan"],
)
def test_pictures_of_nothing(image):
    seen = found(image)
    assert len(seen) == 0
    assert seen.centre.shape == (0, 2)
    assert seen.radius.shape == (0,)
