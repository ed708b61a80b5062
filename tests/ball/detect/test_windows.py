"""Discs followed on ray-cast pictures of a ball: off their prediction, moving, smeared, read late, pale, cut, gone."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ray_cast import BALL, CLEAN, DISCS, INK, POSE, RIG, TRUTH, centre_of, errors, match, nees, photo, ray_cast, spread
from scipy.stats import chi2

from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.windows import Motion
from spheremouse.geometry.rotation import exp

DETECTOR = disc_detector(DiscSettings(), RIG, POSE)
AT_REST = np.zeros(3)


def follow(image, directions, rate=AT_REST, readout=0.0, detector=DETECTOR):
    """The discs at `directions` alone, without a search for others."""
    return detector.follow(image, SearchState(), directions, Motion(rate, readout), least=len(directions) + 1)[0]


def displaced(directions, rng, pixels):
    """Directions whose pictures lie up to so many pixels off, in any direction."""
    angle = pixels * (POSE.position[2] - RIG.ball.radius) / (RIG.camera.fx * RIG.ball.radius)
    axis = np.cross(directions, rng.normal(size=directions.shape))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    size = angle * np.sqrt(rng.random((len(directions), 1)))
    return np.einsum("nij,nj->ni", exp(size * axis), directions)


@pytest.mark.parametrize("noise", [2.0, 10.0])
def test_noise_and_size_are_learnt_and_remembered(noise):
    image = photo(CLEAN, noise)
    _, learnt = DETECTOR.follow(image, SearchState(), DISCS)
    assert abs(learnt.noise / noise - 1.0) < 0.1
    assert abs(learnt.size - 1.0) < 0.05
    seen, same = DETECTOR.follow(image, learnt, DISCS)
    assert same.noise == learnt.noise
    assert abs(same.size - learnt.size) < 1e-3
    off = errors(seen, TRUTH)
    assert len(off) == len(TRUTH)
    assert np.sqrt(np.mean(off**2)) < 0.02 + 0.01 * noise


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_followed_discs_are_where_they_are_not_where_they_are_predicted(noise):
    """Up to 1 px off; the centre does not depend on the prediction."""
    rng = np.random.default_rng(3)
    off, nis = [], []
    for seed in range(6):
        predicted = displaced(DISCS, rng, 1.0)
        assert 0.4 < np.linalg.norm(centre_of(predicted, RIG, POSE) - TRUTH, axis=1).max() <= 1.01
        seen = follow(photo(CLEAN, noise, seed), predicted)
        assert sorted(match(seen, TRUTH)[:, 1]) == list(range(len(DISCS)))  # each of them, once
        off.append(errors(seen, TRUTH))
        nis += list(nees(seen, TRUTH))
    assert np.sqrt(np.mean(np.square(off))) < (0.03 if noise < 2 else 0.06)
    assert np.mean(nis) < chi2.ppf(0.999, 2 * len(nis)) / len(nis)


def test_a_disc_far_from_its_prediction_is_as_exact_as_any():
    """A push takes discs 8 px off, where they have another shape. What the detector finds has its true centre."""
    rng, image, far = np.random.default_rng(3), photo(CLEAN, 1.0), 0
    at_once = follow(image, DISCS)
    for _ in range(6):
        predicted = displaced(DISCS, rng, 8.0)
        seen = follow(image, predicted)
        i, j = match(seen, at_once.centre, 1.0).T
        off = np.linalg.norm(centre_of(predicted, RIG, POSE) - TRUTH, axis=1)
        far += np.count_nonzero(off[match(seen, TRUTH, 1.0)[:, 1]] > 3.0)
        assert len(i) == len(seen) >= len(DISCS) - 4
        assert_allclose(seen.centre[i], at_once.centre[j], atol=0.02)
    assert far > 30


def test_what_is_not_where_it_was_expected_is_left_out():
    """Discs that came off, are hidden, or look away: those that are there are found all the same."""
    rng = np.random.default_rng(4)
    gone = np.array([d for d in spread(40, 5, 0.1) if np.max(DISCS @ d) < np.cos(0.12)])
    assert len(gone) > 5
    order = rng.permutation(len(DISCS) + len(gone) + 3)
    expected = np.concatenate([DISCS, gone, -DISCS[:3]])[order]
    seen = follow(photo(CLEAN, 2.0), expected)
    assert len(match(seen, TRUTH, 0.5)) == len(seen) == len(DISCS)
    assert len(follow(photo(CLEAN, 2.0), gone)) == 0
    assert len(follow(photo(CLEAN, 2.0), np.zeros((0, 3)))) == 0


def test_a_pale_disc_is_followed_though_it_would_not_be_detected():
    """Glare, deep shade: where a disc must be, a part of the contrast is enough."""
    image = photo(ray_cast(DISCS, ink=0.85 * BALL), 1.0)
    assert len(DETECTOR.detect(image)) == 0
    seen = follow(image, DISCS)
    assert len(match(seen, TRUTH, 0.5)) == len(seen) == len(DISCS)


def test_a_pale_spot_is_no_disc_once_dark_ones_have_shown_their_contrast():
    """The edge of a strut is as pale. A disc of the map is measured in spite of it."""
    dark, pale = DISCS[3:], DISCS[:3]
    image = photo(np.minimum(ray_cast(dark), ray_cast(pale, ink=0.65 * BALL)), 1.0)
    assert len(match(DETECTOR.detect(image), TRUTH, 0.5)) == len(DISCS)
    _, learnt = DETECTOR.follow(image, SearchState(), dark)
    assert abs(learnt.contrast - (1.0 - INK / BALL)) < 0.05
    seen = match(DETECTOR.detect(image, learnt), TRUTH, 0.5)
    assert sorted(seen[:, 1]) == list(range(3, len(DISCS)))
    after = DETECTOR.follow(image, learnt, dark)[1]
    for _ in range(4):
        seen, after = DETECTOR.follow(image, after, dark)
        assert len(seen) == len(dark)
    assert len(DETECTOR.follow(image, after, DISCS)[0]) == len(DISCS)


def smeared(directions, rate, exposure, n=10):
    """The mean of what is seen while the shutter is open."""
    times = exposure * ((np.arange(n) + 0.5) / n - 0.5)
    return np.mean([ray_cast(directions @ exp(rate * t).T) for t in times], axis=0)


@pytest.mark.parametrize("rate", [(2.0, -1.5, 1.5), (0.0, 4.0, 3.0)])
def test_a_moving_disc_is_where_it_is_at_mid_exposure(rate):
    """15 ms: ways of 4 to 14 px of a disc of 15 px, which bend by up to 0.6 px, and shorten as it turns aslant."""
    rate, exposure = np.array(rate), 0.015
    discs = spread(8, 3, 0.4, widest=0.8)
    truth = centre_of(discs, RIG, POSE)
    image = photo(smeared(discs, rate, exposure, 20), 1.0)
    told = disc_detector(DiscSettings(), replace(RIG, exposure_s=exposure), POSE)
    seen = follow(image, discs, rate, detector=told)
    i, j = match(seen, truth).T
    assert sorted(j) == list(range(len(discs)))
    e = seen.centre[i] - truth[j]
    ends = [centre_of(discs @ exp(s * 0.5 * exposure * rate).T, RIG, POSE)[j] for s in (1, -1)]
    way = ends[0] - ends[1]
    along = np.sum(e * way, axis=1) / np.linalg.norm(way, axis=1)
    assert abs(np.mean(along)) < 0.02
    assert np.sqrt(np.mean(e**2)) < 0.02
    assert nees(seen, truth).max() < chi2.ppf(0.9999, 2)
    if np.linalg.norm(way, axis=1).max() > 8.0:
        assert len(follow(image, discs, rate)) < len(discs)  # what it is worth to be told


@pytest.mark.parametrize("readout", [0.03, 0.015])
def test_a_disc_is_looked_for_where_it_is_when_its_row_is_read(readout):
    rate = np.array([10.0, 4.0, -4.0]) * 0.015 / readout
    t = np.zeros(len(DISCS))
    for _ in range(8):
        then = np.einsum("nij,nj->ni", exp(t[:, None] * rate), DISCS)
        t = readout * ((centre_of(then, RIG, POSE)[:, 1] + 0.5) / 480 - 0.5)
    truth = centre_of(then, RIG, POSE)
    assert np.linalg.norm(truth - TRUTH, axis=1).max() > 6.0
    image = photo(ray_cast(then), 1.0)
    seen = follow(image, DISCS, rate, readout)
    pairs = match(seen, truth, 0.3)
    assert len(pairs) == len(seen) == len(DISCS)
    assert len(match(follow(image, DISCS, rate), truth, 0.3)) < len(DISCS)


@pytest.mark.parametrize("radius", [0.85, 1.2])
def test_a_spot_of_another_size_in_the_window_of_a_disc_is_none(radius):
    """A bolt on the frame hides a disc, or looks like it."""
    rig = replace(RIG, disc_radius=radius * RIG.disc_radius)
    near = np.hypot(*(np.mgrid[:480, :640] - TRUTH[0, ::-1, None, None])) < 25.0
    image = photo(np.where(near, ray_cast(DISCS, rig=rig), CLEAN), 1.0)
    _, learnt = DETECTOR.follow(photo(CLEAN, 1.0), SearchState(), DISCS)
    first, _ = DETECTOR.follow(image, SearchState(), DISCS[:1], least=2)
    seen, _ = DETECTOR.follow(image, learnt, DISCS, least=len(DISCS) + 1)
    assert len(match(first, TRUTH[:1], 0.3)) == 1  # with no other disc in view it may be one
    assert sorted(match(seen, TRUTH)[:, 1]) == list(range(1, len(DISCS)))


def behind_a_strut(which, level, share, turn):
    """The picture with a straight strut over a share of the width of those discs, from another side each."""
    image = CLEAN.copy()
    half = 6.0
    for k in which:
        x, y = TRUTH[k]
        a = 0.9 * k + turn
        at = np.s_[int(y) - 18 : int(y) + 19, int(x) - 18 : int(x) + 19]
        v, u = np.mgrid[at]
        depth = (u - x) * np.cos(a) + (v - y) * np.sin(a) - half + 2.0 * half * share
        image[at] += np.clip(depth + 0.5, 0.0, 1.0) * (level - image[at])
    return image


@pytest.mark.parametrize(
    "level",
    [5.0, 110.0, BALL, 240.0],
    ids=["black", "mid-grey", "as the ball", "light"],
)
def test_a_followed_disc_behind_a_strut_is_left_out_or_honest(level):
    """NIS of what is kept, for each share from 10 to 90 % of the width: chi-square with 2, not above it."""
    kept = {}
    for share in (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9):
        nis = []
        for turn in range(3):
            cut = np.arange(turn, len(TRUTH), 3)
            seen = follow(photo(behind_a_strut(cut, level, share, turn), 1.0, turn), DISCS)
            assert len(match(seen, np.delete(TRUTH, cut, axis=0), 0.3)) == len(TRUTH) - len(cut)
            nis += list(nees(seen, TRUTH[cut], 8.0))
        kept[share] = len(nis)
        assert len(nis) == 0 or np.mean(nis) < chi2.ppf(0.999, 2 * len(nis)) / len(nis)
    assert kept[0.9] == 0
    assert kept[0.7] > 0 or level < 10.0  # unless the strut is as dark as the disc


@pytest.mark.parametrize("level", [110.0, BALL])
def test_a_disc_behind_a_strut_by_half_is_found_once_the_size_of_discs_is_known(level):
    """The search begins at the middle of the part that shows."""
    cut, found, nis = np.arange(0, len(TRUTH), 3), np.zeros(2, dtype=int), []
    _, learnt = DETECTOR.follow(photo(CLEAN, 1.0), SearchState(), DISCS)
    for turn in range(4):
        image = photo(behind_a_strut(cut, level, 0.5, turn), 2.0, turn)
        for known, state in enumerate((learnt._replace(size=0.0), learnt)):
            squares = nees(DETECTOR.detect(image, state), TRUTH[cut], 1.5)
            found[known] += len(squares)
            nis += list(squares)
    assert found[1] > max(found[0], 0.7 * 4 * len(cut))
    assert np.mean(nis) < chi2.ppf(0.999, 2 * len(nis)) / len(nis)


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_cover_shifts_a_disc_alike_until_it_or_the_disc_moves(speed):
    """The mean of many errors of correlations c^k has 1 + 2 (c + c² + ...) times the variance of independent ones."""
    cut, rate, covariances, repeats = np.arange(0, len(TRUTH), 3), np.array([0.0, 0.0, speed]), [], []
    image = photo(behind_a_strut(cut, 110.0, 0.3, 0), 1.0)
    first = follow(image, DISCS, rate)
    pairs = match(first, TRUTH, 8.0)
    is_cut = np.isin(pairs[:, 1], cut)
    across = np.linalg.norm(np.cross(rate, DISCS[pairs[:, 1]]), axis=1)
    beside = np.linalg.norm(first.centre[pairs[:, 0]] - TRUTH[pairs[:, 1]], axis=1) / DETECTOR.model.diameter
    for interval in (0.01, 0.03):
        motion = Motion(rate, 0.0, interval)
        again = DETECTOR.follow(image, SearchState(), DISCS, motion, least=len(DISCS) + 1)[0]
        assert_array_equal(again.centre, first.centre)
        covariances.append((again.covariance - first.covariance)[pairs[:, 0]])
        c = np.exp(-interval * (across / (2.0 * RIG.disc_angle) + 1.0) - beside)
        repeats.append(2.0 * np.sum(c ** np.arange(1, 3000)[:, None], axis=0))
    assert is_cut.sum() >= 3
    assert np.all(np.trace(covariances[0], axis1=1, axis2=2)[is_cut] > 0.01)
    assert np.all(np.trace(covariances[0], axis1=1, axis2=2)[~is_cut] < 1e-3)
    assert_allclose(covariances[0] / repeats[0][:, None, None], covariances[1] / repeats[1][:, None, None], atol=1e-9)
