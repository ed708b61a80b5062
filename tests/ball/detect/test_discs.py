"""The default detector on ray-cast pictures of a ball: centres, covariance, light, occlusion, limb, nothing."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ray_cast import BALL, CLEAN, DISCS, INK, POSE, RIG, TRUTH, centre_of, errors, match, nees, photo, ray_cast, spread
from scipy.stats import chi2

from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.projection import GREY
from spheremouse.ball.detect.search import SearchState
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import InteriorOrientation, Pose

BENT = InteriorOrientation(640, 480, 600.0, 595.0, 325.0, 238.0, np.array([-0.25, 0.1, 1e-3, -1e-3, 0.0]))
SETTINGS = DiscSettings()
DETECTOR = disc_detector(SETTINGS, RIG, POSE)


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.0])
def test_centres_through_a_lens_that_bends_from_nearer_by(turn):
    """Eccentricity and distortion are in the geometry; a camera that stands askew."""
    c, s = np.cos(turn), np.sin(turn)
    roll = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    position = np.array([0.15, -0.2, 1.75])
    z = -position / np.linalg.norm(position)
    x = np.cross([0.1, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    pose = Pose(np.stack([x, np.cross(z, x), z], axis=1) @ roll, position)
    rig = replace(RIG, camera=BENT)
    discs = spread(10, 2, axis=-z, widest=0.8)
    truth = centre_of(discs, rig, pose)
    inside = np.all((truth > 20) & (truth < [620, 460]), axis=1)
    seen = disc_detector(SETTINGS, rig, pose).detect(photo(ray_cast(discs, rig, pose)))
    pairs = match(seen, truth)
    assert set(np.flatnonzero(inside)) <= set(pairs[:, 1])
    assert len(pairs) == len(seen)
    assert np.sqrt(np.mean(errors(seen, truth) ** 2)) < 0.04


@pytest.mark.parametrize("noise", [2.0, 6.0, 12.0])
def test_covariance_is_honest(noise):
    """NIS of centres, chi-square with 2: not above it, with the floor `sigma` or without, and not far below."""
    bare = disc_detector(replace(SETTINGS, sigma=0.01), RIG, POSE)
    nis, nis_floor = [], []
    for seed in range(5):
        image = photo(CLEAN, noise, seed)
        for detector, out in ((bare, nis), (DETECTOR, nis_floor)):
            squares = nees(detector.detect(image), TRUTH)
            assert len(squares) >= 0.9 * len(DISCS)
            out += list(squares)
    n = len(nis)
    high = chi2.ppf(0.999, 2 * n) / n
    assert np.mean(nis_floor) < high
    assert np.mean(nis) < 1.6 * high  # rounding, sampling and the lens are in neither
    if noise > 5:  # about 0.8: pixels that the smoothing correlates count as independent ones of the unsmoothed noise
        assert np.mean(nis) > 0.25 * 2.0


@pytest.mark.parametrize(("alike", "share"), [(True, 1.0), (False, np.linalg.norm(GREY.weights))])
def test_the_noise_is_that_of_the_grey_values_that_the_fit_reads(alike, share):
    """Channels with noise of their own have less in grey than green has alone, which the search reads."""
    noise = 6.0 * np.random.default_rng(4).normal(size=(*CLEAN.shape, 1 if alike else 3))
    image = np.clip(np.rint(CLEAN[:, :, None] + noise), 0, 255).astype(np.uint8)
    image = np.broadcast_to(image, (*CLEAN.shape, 3)).copy()
    assert DETECTOR.noise(image) == pytest.approx(6.0 * share, rel=0.05)
    _, state = DETECTOR.follow(image, SearchState())
    assert (state.noise, state.sample_noise) == pytest.approx((6.0 * share, 6.0), rel=0.05)


def slope(direction):
    """In light from full to a third across the ball: the darkest ball is little brighter than the brightest disc."""
    v, u = np.mgrid[: CLEAN.shape[0], : CLEAN.shape[1]]
    t = ((u - 320) * np.cos(direction) + (v - 240) * np.sin(direction)) / 170.0
    return CLEAN * np.clip(0.67 - 0.33 * t, 0.2, 1.2)


@pytest.mark.parametrize(
    "image",
    [
        CLEAN,
        CLEAN + 50.0,
        CLEAN - 25.0,
        0.3 * CLEAN,
        0.5 * CLEAN + 60.0,
        1.25 * CLEAN,
        *map(slope, (0.0, 1.0, 2.5)),
    ],
    ids=["plain", "haze", "offset", "dim", "pale", "bright", "slope across", "slope", "slope back"],
)
def test_light_does_not_matter(image):
    seen = DETECTOR.detect(photo(image))
    assert len(match(seen, TRUTH)) == len(seen) == len(DISCS)
    assert np.sqrt(np.mean(errors(seen, TRUTH) ** 2)) < 0.06


def test_discs_at_the_limb():
    """Slivers down to where the rim meets the horizon: found while large enough, never far off."""
    tilt = np.deg2rad([50, 55, 60, 63, 66, 69, 71])
    turn = np.arange(len(tilt)) * 2.2
    discs = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    truth = centre_of(discs, RIG, POSE)
    for noise in (0.0, 3.0):
        seen = DETECTOR.detect(photo(ray_cast(discs), noise))
        pairs = match(seen, truth)
        assert {0, 1, 2} <= set(pairs[:, 1])
        assert len(pairs) == len(seen)
        assert np.linalg.norm(errors(seen, truth), axis=1).max() < 0.5
        assert np.sqrt(nees(seen, truth)).max() < 4.0


@pytest.mark.parametrize("sigma", [1.0, 1.5, 2.0])
def test_a_lens_out_of_focus_costs_no_disc(sigma):
    """The model of a disc has the blur of the picture. With that of a lens in focus, 2.5 px hide a third of them."""
    for seed in range(3):
        image = photo(cv2.GaussianBlur(CLEAN, (0, 0), sigma), 2.0, seed)
        blur = DETECTOR.lens_blur(image)
        assert blur == pytest.approx(sigma, rel=0.15)
        seen = DETECTOR.with_lens_blur(blur).detect(image)
        assert len(match(seen, TRUTH)) == len(seen) == len(DISCS)
        assert np.abs(errors(seen, TRUTH)).max() < 0.15
        assert np.mean(nees(seen, TRUTH)) < chi2.ppf(0.999, 2 * len(DISCS)) / len(DISCS)


def test_a_large_picture_shows_discs_at_the_limb_as_well_as_a_small_one():
    """Three times as many pixels across: a sliver is as thin as there, and all but lost in the coarse picture."""
    camera = InteriorOrientation(1920, 1440, 1920.0, 1920.0, 960.0, 720.0)
    rig = replace(RIG, camera=camera)
    way = np.arange(10) * 2.0 * np.pi / 10
    slant = np.arccos(0.6 / 2.35) - 0.02 / 0.6 - np.linspace(0.042, 0.09, 10)  # from where the limb touches the rim
    discs = np.stack([np.sin(slant) * np.cos(way), np.sin(slant) * np.sin(way), np.cos(slant)], axis=1)
    seen = disc_detector(DiscSettings(), rig, POSE).detect(photo(ray_cast(discs, rig), 2.0))
    axes = np.sqrt(np.linalg.eigvalsh(appearance(discs, rig, POSE).shape)[:, 0])
    assert np.all((axes > 1.25) & (axes < 2.8))
    assert len(match(seen, centre_of(discs, rig, POSE), 1.0)) == len(discs)


def test_other_marks_are_not_discs():
    """Bars, large and small spots, a shadow's edge: dark, but not of a disc's size and shape."""
    image = ray_cast(DISCS[:0])
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    image[200:206, 250:300] = INK
    image[np.hypot(u - 350, v - 300) < 16] = INK
    image[np.hypot(u - 280, v - 300) < 2.5] = INK
    image[:, 390:] = np.where(image[:, 390:] == BALL, 0.5 * BALL, image[:, 390:])
    assert len(DETECTOR.detect(photo(cv2.GaussianBlur(image, (0, 0), 0.4), 2.0))) == 0


@pytest.mark.parametrize("offset", [(250.0, 0.0), (-200.0, 150.0), (0.0, -220.0)])
def test_a_ball_partly_outside_of_the_picture(offset):
    rig = replace(RIG, camera=replace(RIG.camera, cx=320.0 + offset[0], cy=240.0 + offset[1]))
    truth = centre_of(DISCS, rig, POSE)
    seen = disc_detector(SETTINGS, rig, POSE).detect(photo(ray_cast(DISCS, rig)))
    inside = np.all((truth > 15) & (truth < [624, 464]), axis=1)
    pairs = match(seen, truth)
    assert set(np.flatnonzero(inside)) <= set(pairs[:, 1])
    assert len(pairs) == len(seen)
    assert np.abs(errors(seen, truth)).max() < 0.3


@pytest.mark.parametrize("corners", [(-15, -15, 15, 15), (-15, -15, 15, -15, 15, 15, -15, 15), (0, -25, 25, 9, -25, 9)])
def test_what_the_user_masks_is_not_looked_at(corners):
    a, b = TRUTH[0], TRUTH[1]
    place = tuple(float(c + a[k % 2]) for k, c in enumerate(corners))
    detector = disc_detector(replace(SETTINGS, masks=(place,)), RIG, POSE)
    seen = detector.detect(photo(CLEAN, 1.0)).centre
    assert np.linalg.norm(seen - a, axis=1).min() > 10.0
    assert np.linalg.norm(seen - b, axis=1).min() < 1.0
    with pytest.raises(ConfigurationError, match="they leave nothing of the ball"):
        disc_detector(replace(SETTINGS, masks=((0.0, 0.0, 640.0, 480.0),)), RIG, POSE)


def test_a_disc_larger_than_the_picture_is_refused():
    """As by a focal length with a digit too many, or a disc_radius in millimetres. No window is left to search."""
    camera = replace(RIG.camera, fx=1e6)
    with pytest.raises(ConfigurationError, match=r"a disc is \d+ px wide, too large for .*; check disc_radius") as e:
        disc_detector(DiscSettings(), replace(RIG, camera=camera), POSE)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    "changes",
    [{"polarity": "light"}, {"contrast": 0.6, "rim": 0.9, "sigma": 0.1}, {"min_area": 150.0, "smoothing": 1.2},
     {"masks": ((300.0, 200.0, 340.0, 280.0),)}],
)  # fmt: skip
@pytest.mark.parametrize("pose", [POSE, replace(POSE, position=POSE.position + 0.05)])
def test_a_detector_made_from_another_one_detects_the_same_as_a_new_one(changes, pose):
    settings, image = replace(SETTINGS, **changes), photo(CLEAN, 1.0)
    found, expected = (disc_detector(settings, RIG, pose, before).detect(image) for before in (DETECTOR, None))
    assert np.array_equal(found.centre, expected.centre)
    assert np.array_equal(found.covariance, expected.covariance)
