"""The detector's native functions equal their twins in NumPy, and name a wrong argument."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ray_cast import CLEAN, DISCS, POSE, RIG, looking_at, photo

from spheremouse.ball.detect.appearance import appearance, seen_at
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.projection import GREY, normalise
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.windows import AT_REST, FitSettings, Motion
from spheremouse.ball.rig import view_of
from spheremouse.geometry.camera import InteriorOrientation, Pose, ellipse_to_pixel, project, project_circle
from spheremouse.native import kernels
from tests.ball.detect import twins

LENS = InteriorOrientation(640, 480, 610.0, 600.0, 322.0, 237.0, np.array([-0.3, 0.1, 2e-3, -1e-3, -0.02]))
SETTINGS = FitSettings(GREY, 0.8, 0.93, 0.25, size_tolerance=0.25, rim=0.7, sigma=0.02)
DETECTOR = disc_detector(DiscSettings(), RIG, POSE)
NOWHERE = np.zeros((0, 2))


@pytest.mark.parametrize("camera", [RIG.camera, LENS])
def test_a_disc_is_the_projection_of_a_circle(camera):
    rig = replace(RIG, camera=camera)
    station = np.array([0.5, -0.4, 2.0])
    pose = Pose(looking_at(np.array([0.2, 0.1, 0.0]), station), station)
    d = np.random.default_rng(0).normal(size=(60, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    seen = appearance(d, rig, pose)
    w = seen.whole
    assert 10 < w.sum() < 50
    angle, R = rig.disc_radius / rig.ball.radius, rig.ball.radius
    circle = pose.to_cam(R * np.cos(angle) * d[w]), d[w] @ pose.rotation, R * np.sin(angle)
    centroid, shape = ellipse_to_pixel(*project_circle(*circle), camera)
    assert_allclose(seen.centroid[w], centroid, rtol=1e-12)
    assert_allclose(seen.shape[w], shape, rtol=1e-9, atol=1e-9)  # a difference of products a thousand times larger
    assert_allclose(seen.area[w], np.pi * np.sqrt(np.linalg.det(shape)), rtol=1e-9)
    assert_allclose(seen_at(d, rig, pose), project(pose.to_cam(R * d), camera)[0], rtol=1e-12)
    assert_allclose(seen.centre[w], seen_at(d, rig, pose)[w], rtol=1e-12)


def picture(rng, channels, c, shape):
    y, x = np.mgrid[:44, :48]
    offset = np.stack([x, y], axis=-1) - c
    rho = np.sqrt(np.einsum("hwi,ij,hwj->hw", offset, np.linalg.inv(shape), offset))
    ball = rng.uniform(80.0, 200.0) * (1.0 + rng.normal(size=2) @ np.stack([x - 24, y - 22]).reshape(2, -1) * 2e-3)
    share = np.clip(0.5 - (rho - 1.0) * np.sqrt(np.linalg.eigvalsh(shape)[0]), 0.0, 1.0)
    grey = ball.reshape(44, 48) * (1.0 - rng.uniform(0.4, 0.9) * share) + rng.normal(size=(44, 48))
    return np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[:, :, None], channels, axis=2)


def fits(image, mask, place, shape, path, size):
    """Return the fit of a disc, ok, centre, covariance and rim, and its twin's."""
    expected = place[None], shape[None], path[None]
    native = kernels.fit_discs(image, mask, expected, 1.0, SETTINGS, 0.25, size)[:4]
    return [part[0] for part in native], twins.fit_disc(image, mask, place, shape, path, 1.0, SETTINGS, size)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size", [0.0, 1.05])
@pytest.mark.parametrize("way", [0.0, 6.0])
def test_the_fit_is_its_twin_up_to_single_precision(channels, size, way):
    """Grey values of 200 are rounded by 1e-5, and the slope of a rim is many of them for each pixel."""
    rng = np.random.default_rng(1)
    count = 0
    for _ in range(20):
        U = np.linalg.qr(rng.normal(size=(2, 2)))[0]
        shape = U @ np.diag(rng.uniform(1.5, 9.0, 2) ** 2) @ U.T
        c, path = np.array([24.0, 22.0]) + rng.uniform(-1.0, 1.0, 2), rng.normal(size=7) * [way, way, 0.3, 0.3, 0, 0, 0]
        path *= way > 0.0
        image, mask = picture(rng, channels, c, shape), np.full((44, 48), 255, np.uint8)
        mask[:, 33:] = 0
        place = c + rng.uniform(-0.5, 0.5, 2)
        (ok, centroid, covariance, rim), (deep, *twin) = fits(image, mask, place, shape, path, size)
        if ok and rim > 0.5:  # of less, single pixels decide where a cover ends
            assert deep
            assert_allclose(centroid, twin[0], atol=1e-4)
            assert_allclose(covariance, twin[1], rtol=1e-3, atol=1e-6)
            assert_allclose(rim, twin[2], atol=1e-4)
            count += 1
    assert count >= (12 if way == 0.0 else 3)


@pytest.mark.parametrize("grey", [60, 90, 250])
def test_a_disc_behind_a_cover_is_fitted_as_its_twin(grey):
    rng = np.random.default_rng(5)
    count = 0
    for _ in range(20):
        shape = np.diag(rng.uniform(5.0, 9.0, 2) ** 2)
        c = np.array([24.0, 22.0]) + rng.uniform(-1.0, 1.0, 2)
        image, mask = picture(rng, 1, c, shape), np.full((44, 48), 255, np.uint8)
        y, x = np.mgrid[:44, :48]
        angle = rng.uniform(0.0, 2.0 * np.pi)
        image[(x - c[0]) * np.cos(angle) + (y - c[1]) * np.sin(angle) > rng.uniform(0.0, 5.0)] = grey
        place = c + rng.uniform(-0.5, 0.5, 2)
        (ok, centroid, covariance, rim), (deep, *twin) = fits(image, mask, place, shape, np.zeros(7), 1.0)
        if ok:
            assert deep
            assert_allclose(centroid, twin[0], atol=2e-4)
            assert_allclose(covariance, twin[1], rtol=1e-3, atol=1e-5)
            assert_allclose(rim, twin[2], atol=1e-4)
            count += rim < 0.9
    assert count >= 8


@pytest.mark.parametrize("exposure", [0.0, 0.01])
def test_discs_are_measured_where_and_how_they_are_seen(exposure):
    rig = replace(RIG, exposure_s=exposure)
    model = disc_detector(DiscSettings(), rig, POSE).model
    image, motion = photo(CLEAN, 1.0)[:, :, None], Motion(np.array([1.0, -0.5, 0.7]), 0.004)
    seen, path, which = twins.windows(DISCS, rig, POSE, model, motion)
    expected = seen.centroid[which], seen.shape[which], path[which]
    contrast = 0.3 * model.fit.contrast
    ok, centroid, covariance, rim, size = kernels.fit_discs(image, model.mask, expected, 1.0, model.fit, contrast, 0.0)
    centre = centroid - (seen.centroid - seen.centre)[which]
    kept = twins.best_fits(centre, rim, ok, 0.3 * model.diameter)
    search = DETECTOR.lattice.of_turn(0), SearchState(0, 1.0), motion, NOWHERE, len(DISCS) + 1
    *found, state = kernels.follow_discs(image, DISCS, model, *search)
    assert len(kept) > 10
    expected = centre[kept], covariance[kept], seen.area[which][kept], size
    for native, twin in zip((*found, state[2]), expected, strict=True):
        assert_allclose(native, twin, rtol=1e-6)  # a path differs by rounding


@pytest.mark.parametrize("projection", [GREY, normalise(np.array([-1.0, 2.0, 1.0]))])
def test_a_search_is_that_of_the_twin(projection):
    rng = np.random.default_rng(2)
    model, count = DETECTOR.with_projection(projection).model, 0
    for turn in range(12):
        grey = photo(CLEAN, rng.uniform(0.5, 4.0), turn)
        grey[rng.integers(150, 330, 6)] //= 2  # struts, which are no discs
        rejected = np.concatenate([rng.uniform(150.0, 480.0, (30, 2)), rng.integers(0, 40, (30, 2))], axis=1)
        search, known = SearchState(turn, 1.0, 1.0, rejected, sample_noise=1.0), rng.uniform(150.0, 480.0, (6, 2))
        samples, limits = DETECTOR.lattice.samples[turn % 4], (0.125, 2.5, 0.5 * model.diameter, 1)
        active = rejected[rejected[:, 2] > turn, :2]
        colours, plane = grey[:, :, None], grey
        if projection != GREY:
            colours = np.stack([rng.integers(0, 60, grey.shape, dtype=np.uint8), grey, grey // 2], axis=2)
            plane = np.floor(colours @ np.array(projection.weights) + 0.5).astype(int)
        more = samples, DETECTOR.lattice.offsets, limits, turn, known, active
        places = twins.candidate_pixels(plane, model.mask, *more)
        found = Detections(*kernels.measure_places(colours, places, model, 1.0, 0.0, 0.0))
        missed = np.linalg.norm(places[:, None] - found.centre[None], axis=2).min(axis=1, initial=np.inf) > limits[2]
        after = twins.next_turn(search, places[missed], 1)
        arguments = np.zeros((0, 3)), model, DETECTOR.lattice.of_turn(turn), search, AT_REST, known, 0
        centre, covariance, area, state = kernels.follow_discs(colours, *arguments)
        # The places are sums in single precision, so a pixel at the edge of a window may be in one of them alone.
        assert_allclose(centre, found.centre, rtol=1e-5)
        assert_allclose(covariance, found.covariance, rtol=1e-2, atol=5e-6)
        assert_allclose(area, found.area, rtol=1e-5)
        assert state[:3] == after[:3]
        assert_allclose(state[3], after.rejected, rtol=1e-5)
        count += len(places)
    assert count > 20


def test_a_followed_disc_is_no_new_one():
    """The discs come first, and the search leaves them out; if there are too few, it waits."""
    image, search = photo(CLEAN, 1.0)[:, :, None], SearchState(0, 1.0, 1.0, sample_noise=1.0)
    model = DETECTOR.model, DETECTOR.lattice.of_turn(0), search, AT_REST, NOWHERE
    followed, *_, state = kernels.follow_discs(image, DISCS[:9], *model, 10)
    assert len(followed) == 9
    assert state[0] == 0
    more, _ = DETECTOR.follow(image, search, known=followed)
    assert len(more) > 0
    centre, *_, state = kernels.follow_discs(image, DISCS[:9], *model, 9)
    assert_array_equal(centre[:9], followed)
    assert_allclose(centre[9:], more.centre, atol=0.02)
    assert state[0] == 1


def test_noise_is_the_median_of_second_differences():
    rng = np.random.default_rng(3)
    image, w = rng.integers(0, 200, (64, 90, 3), dtype=np.uint8), np.array([0.2, -0.5, 0.3], dtype=np.float32)
    rows = image[10 + 1 : 50 : 2, 5:80].astype(float) @ w
    second = np.rint(np.abs(2.0 * rows[:, 1:-1] - rows[:, :-2] - rows[:, 2:]))
    assert_allclose(kernels.noise_of(image, w, 10, 50, 5, 80), np.median(second) * 1.4826 / np.sqrt(6.0), rtol=0.02)


def test_a_wrong_argument_is_named():
    model, image, places = DETECTOR.model, np.zeros((480, 640, 3), np.uint8), NOWHERE
    for arguments, name in [
        ((image.astype(float), places, model, 1.0, 0.0, 0.0), "image"),
        ((image[:, ::2], places, model, 1.0, 0.0, 0.0), "image"),
        ((image[:400], places, model, 1.0, 0.0, 0.0), "mask"),
        ((image, DISCS, model, 1.0, 0.0, 0.0), "places"),
    ]:
        with pytest.raises(TypeError, match=name):
            kernels.measure_places(*arguments)
    with pytest.raises(TypeError, match="directions"):
        kernels.appearance(DISCS.T, view_of(RIG, POSE))
    whole = DETECTOR.lattice.of_turn(0)
    outside = whole[0]._replace(place=whole[0].place + 1000), *whole[1:]
    for lattice, search, error, name in [
        (outside, SearchState(), ValueError, "samples"),
        (whole[:2], SearchState(), TypeError, "lattice"),
        (whole, SearchState(-1), ValueError, "turn"),
        (whole, SearchState(noise=np.nan), ValueError, "noise"),
        (whole, SearchState(sample_noise=np.nan), ValueError, "noise"),
        (whole, SearchState(rejected=places), TypeError, "rejected"),
    ]:
        with pytest.raises(error, match=name):
            kernels.follow_discs(image, DISCS, model, lattice, search, AT_REST, places, 0)


def test_numbers_out_of_range_are_no_discs():
    image = cv2.cvtColor(photo(CLEAN, 1.0), cv2.COLOR_GRAY2BGR)
    wild = np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0])
    directions = np.stack([wild, np.roll(wild, 1), np.roll(wild, 2)], axis=1)
    search = DETECTOR.lattice.of_turn(0), SearchState(0, 1.0), Motion(wild[:3], 1.0), NOWHERE, 1
    assert len(kernels.follow_discs(image, directions, DETECTOR.model, *search)[0]) == 0
    assert len(kernels.measure_places(image, directions[:, :2].copy(), DETECTOR.model, 1.0, 0.0, 0.0)[0]) == 0
    expected = np.stack([wild, wild], axis=1), np.repeat(wild, 4).reshape(-1, 2, 2), np.repeat(wild, 7).reshape(-1, 7)
    ok = kernels.fit_discs(image, DETECTOR.model.mask, expected, 1.0, SETTINGS, 0.25, 0.0)[0]
    assert_array_equal(ok, False)
    blurred = SETTINGS._replace(blur=np.nan)
    assert not kernels.fit_discs(image, DETECTOR.model.mask, expected, np.nan, blurred, 0.25, 0.0)[0].any()
    assert kernels.noise_of(image, np.full(3, np.nan, dtype=np.float32), 0, 480, 0, 640) > 100.0  # nothing is known
