"""The search for unknown discs: lattices against the mask, discs drawn at any place, what is none, what is put off."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import ray_cast
from numpy.testing import assert_allclose, assert_array_equal
from ray_cast import BALL, INK, POSE, RIG

from spheremouse.ball.detect.appearance import appearance, ball_mask
from spheremouse.ball.detect.discs import DiscDetector, DiscSettings, disc_detector
from spheremouse.ball.detect.projection import GREY, NEGATIVE
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.points import directions_at
from spheremouse.geometry.camera import InteriorOrientation

NOWHERE, NO_DISCS = np.zeros((0, 2)), np.zeros((0, 3))
NOISE = 1.0
PLAIN = disc_detector(DiscSettings(), RIG, POSE)  # a ball of 330 px, its largest disc of 15 px
TWICE = replace(RIG, camera=InteriorOrientation(1280, 960, 1280.0, 1280.0, 640.0, 480.0))
FORM = {1: PLAIN, 2: disc_detector(DiscSettings(), TWICE, POSE)}  # the same, that much finer


def random_discs(rng, n, least, scale=1):
    """Directions of n whole discs of at least `least` px², no two nearer than two diameters."""
    found = np.zeros((0, 3))
    while len(found) < n:
        d = rng.normal(size=3)
        d[2] = abs(d[2])
        found = np.vstack([found, d / np.linalg.norm(d)])
        seen = appearance(found, FORM[scale].rig, POSE)
        apart = np.linalg.norm(seen.centroid[:-1] - seen.centroid[-1], axis=1) > 2.0 * FORM[scale].model.diameter
        if not (seen.whole[-1] and seen.area[-1] > least and apart.all()):
            found = found[:-1]
    return found


def centroids(discs, scale=1):
    return appearance(discs, FORM[scale].rig, POSE).centroid


def photo(image, noise=NOISE, seed=0):
    """(h, w, 1) uint8."""
    return ray_cast.photo(image, noise, seed)[:, :, None]


def picture(discs, scale=1, seed=0):
    return photo(ray_cast.ray_cast(discs, FORM[scale].rig, POSE, blur=0.4 * scale), seed=seed)


def look(image, state, known=NOWHERE, detector: DiscDetector = PLAIN, projection=GREY):
    """Places of a turn, the discs first, and the state after it."""
    found, after = detector.with_projection(projection).follow(image, state, known=known)
    since = after.rejected[:, 2] - after.rejected[:, 3]  # turn of the last rejection
    return np.concatenate([found.centre, after.rejected[since == after.turn, :2]]), after


def four_turns(image, first=0, **more):
    return np.concatenate([look(image, SearchState(turn), **more)[0] for turn in range(first, first + 4)])


def distances(places, to):
    """From each of `to` to the nearest of `places`."""
    if len(places) == 0:
        return np.full(len(to), np.inf)
    return np.linalg.norm(to[:, None] - places[None], axis=2).min(axis=1)


@pytest.mark.parametrize("scale", [1, 2])
def test_every_disc_is_met_within_four_turns(scale):
    """Discs of 15 px² and more of the reduced picture, anywhere on the ball, at any subpixel place."""
    rng = np.random.default_rng(1)
    for k in range(20 if scale == 1 else 4):
        discs = random_discs(rng, 4, 15.0 * scale**2, scale)
        places = four_turns(picture(discs, scale, k), 4 * k, detector=FORM[scale])
        assert distances(places, centroids(discs, scale)).max() < 2.0 * scale  # near enough for the fit


def test_a_disc_of_ordinary_size_is_met_in_the_first_turn_wherever_it_is():
    """What is 10 px high."""
    rng = np.random.default_rng(2)
    n = 0
    for k in range(20):
        discs = random_discs(rng, 4, 70.0)
        places, after = look(picture(discs, seed=k), SearchState(k))
        assert len(places) <= 4  # each of them once
        assert len(after.rejected) == 0  # discs are none
        high = np.sqrt(appearance(discs, RIG, POSE).shape[:, 1, 1]) > 5.0
        assert distances(places, centroids(discs))[high].max(initial=0.0) < 1.0
        n += np.count_nonzero(high)
    assert n > 30


def test_known_places_are_left_out():
    discs = random_discs(np.random.default_rng(4), 4, 60.0)
    image, centres = picture(discs), centroids(discs)
    assert distances(four_turns(image), centres).max() < 1.0
    rest = four_turns(image, known=centres[:3] + 0.7)
    assert distances(rest, centres)[3] < 1.0
    assert distances(rest, centres)[:3].min() > PLAIN.model.diameter
    assert len(four_turns(image, known=centres)) == 0


def test_colour_and_grey_agree():
    """Of three channels the green one counts in the search, and all of them in the fit."""
    image = picture(random_discs(np.random.default_rng(6), 4, 30.0))
    grey = four_turns(image)
    assert len(grey) >= 4
    assert_allclose(four_turns(np.repeat(image, 3, axis=2)), grey, atol=1e-4)
    red = np.concatenate([np.full_like(image, 40), image, np.full_like(image, 200)], axis=2)
    assert_allclose(four_turns(red), grey, atol=0.1)


def clutter(kind):
    """A ball with struts across it or with a shadow on it, (h, w, 1)."""
    image = ray_cast.ray_cast(NO_DISCS, blur=0.0)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    on = image == BALL
    if kind == "struts":
        for angle, at, half in ((0.0, -60.0, 6.0), (0.6, 30.0, 10.0), (1.7, 0.0, 4.0), (2.4, 80.0, 15.0)):
            off = (u - 320) * np.cos(angle) + (v - 240) * np.sin(angle) - at
            image[on & (np.abs(off) < half)] = INK
    elif kind == "shadow":
        off = (u - 300) * np.cos(0.4) + (v - 240) * np.sin(0.4)
        image[on & (off > 0)] *= 0.4
    elif kind == "curved shadow":
        image[on & (np.hypot(u - 260, v - 250) < 60)] *= 0.5
    return photo(cv2.GaussianBlur(image, (0, 0), 0.6))


@pytest.mark.parametrize("kind", ["plain", "struts", "shadow", "curved shadow"])
def test_struts_and_shadows_cost_next_to_nothing(kind):
    """Candidates in 256 turns, when none of them is a disc."""
    image, state, counts = clutter(kind), SearchState(), []
    for _ in range(256):
        places, state = look(image, state)
        counts.append(len(places))
    assert max(counts) <= 4
    if kind == "struts":  # what runs a little askew to the neighbours is a candidate, all along, until it is put off
        assert sum(counts) <= 256
        assert sum(counts[-96:]) <= 48
    else:
        assert sum(counts) == 0


@pytest.mark.parametrize("sigma", [3.0, 10.0, 30.0])
def test_noise_shows_no_disc(sigma):
    """Of much noise a pixel is a candidate now and then; none of them is measured as a disc."""
    rng, state, count = np.random.default_rng(9), SearchState(), 0
    empty = ray_cast.ray_cast(NO_DISCS)
    for turn in range(16):
        image = photo(empty, sigma, rng.integers(1000))
        found, state = PLAIN.follow(image[:, :, 0], state)
        assert len(found) == 0
        count = len(state.rejected)
        assert state.turn == turn + 1
    assert count == 0 or sigma > 5.0


SPOT = np.array([[300.3, 250.6]])


def spots(centres, seed=0):
    """The ball with dark spots at `centres`, (n, 2) px, two thirds of a disc wide: none is a disc."""
    small = replace(RIG, disc_radius=0.68 * RIG.disc_radius)
    return photo(ray_cast.ray_cast(directions_at(centres, RIG, POSE)[0], small, POSE, blur=0.4), seed=seed)


def test_a_place_that_is_none_is_put_off_for_twice_as_long_each_time():
    image, state, turns = spots(SPOT), SearchState(), []
    for turn in range(2200):
        assert state.turn == turn
        places, state = look(image, state)
        if len(places):
            assert len(places) == 1
            assert distances(places, SPOT)[0] < 1.0
            turns.append(turn)
    assert_array_equal(np.diff(turns) - 1, [32, 64, 128, 256, 512, 512, 512])  # frames it was left out
    assert len(state.rejected) == 1


def test_a_rejected_place_hides_no_disc_beside_it():
    """What is two radii away from a bolt is another thing."""
    centres = np.array([[300.3, 250.6], [322.0, 251.0]])
    image = picture(directions_at(centres, RIG, POSE)[0])
    rejected = np.array([[*centres[0], 40.0, 32.0]])
    places = np.concatenate([look(image, SearchState(turn, rejected=rejected))[0] for turn in (1, 2)])
    assert distances(places, centres)[1] < 1.0
    assert distances(places, centres)[0] > 10.0


def test_places_remembered_are_bounded():
    """A new one takes the place of the last one."""
    rng = np.random.default_rng(8)
    elsewhere = np.column_stack([rng.uniform(400.0, 450.0, (256, 2)), np.full(256, 30.0), np.full(256, 32.0)])
    places, state = look(spots(SPOT), SearchState(1, rejected=elsewhere))
    assert len(places) == 1
    assert_array_equal(state.rejected, [[*places[0], 34.0, 32.0], *elsewhere[:-1]])


@pytest.mark.parametrize(("room", "projection"), [(150.0, NEGATIVE), (10.0, GREY)])
def test_the_limb_is_no_disc_and_discs_beside_it_are_met(room, projection):
    """Of a ball before a room that is as light, or as dark, as discs are: its blurred pixels are a ring, not a disc."""
    detector = disc_detector(DiscSettings(), ray_cast.RIG, ray_cast.POSE)
    ball, ink = (50.0, 200.0) if projection == NEGATIVE else (150.0, 40.0)
    mask = ball_mask(ray_cast.RIG, ray_cast.POSE) > 0
    angle = np.linspace(0.0, 2.0 * np.pi, 7, endpoint=False)
    discs = np.stack([0.92 * np.cos(angle), 0.92 * np.sin(angle), np.full(7, np.sqrt(1.0 - 0.92**2))], axis=1)
    for shown in (discs[:0], discs):
        image = ray_cast.ray_cast(shown, ball=ball, ink=ink, blur=0.0)
        image[(image == ray_cast.ROOM) & ~mask] = room
        found = photo(cv2.GaussianBlur(image, (0, 0), 0.7))
        places = four_turns(found, detector=detector, projection=projection)
        centres = ray_cast.centre_of(shown, ray_cast.RIG, ray_cast.POSE)
        assert len(places) <= 2 + 2 * len(shown)  # four in each turn otherwise
        assert np.all(distances(places, centres) < 2.0)
