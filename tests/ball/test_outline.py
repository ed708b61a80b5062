"""The ball's outline tells the radius where enough of it is free, and keeps silent elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from ball.test_pose import BLACK, VIEWS, picture_of_ball, seen_from
from scipy.ndimage import map_coordinates

from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.outline import seen_ball, seen_centre, support, support_mask
from spheremouse.native import kernels

NOISE = 4.0  # grey values, standard deviation


def scene(view, free=360.0, shift=(0.0, 0.0, 0.0)):
    """Rig, pose and a noisy picture of a ball that is shifted, m. Of its outline an arc of `free` degrees is seen."""
    rig, pose = seen_from(view)
    picture = picture_of_ball(view, shift).astype(float)
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]]
    ball = picture[..., 0] if picture.ndim == 3 else picture
    inside = ball > 0.5 * ball.max()
    angle = np.degrees(np.arctan2(v - v[inside].mean(), u - u[inside].mean())) % 360.0
    picture[angle > free] = 90.0
    noisy = picture + np.random.default_rng(0).normal(scale=NOISE, size=picture.shape)
    return rig, pose, np.clip(noisy, 0, 255).astype(np.uint8)


def with_radius(rig, factor):
    return replace(rig, ball=replace(rig.ball, radius=factor * rig.ball.radius))


@pytest.mark.parametrize("view", VIEWS)
def test_the_right_radius_is_supported_and_a_wrong_one_is_measured(view):
    rig, pose, picture = scene(view)
    for factor in (0.96, 0.985, 1.0, 1.01, 1.03):
        seen = seen_ball(picture, with_radius(rig, factor), pose)
        assert abs(seen.size_error - (1.0 / factor - 1.0)) < 2.0 * seen.sigma < 0.005
        assert np.abs(seen.centre.across.place).max() < 6e-4
    assert support(picture, rig, pose) > 0.9
    assert support(picture, with_radius(rig, 1.04), pose) < 0.1


def test_a_third_of_the_outline_is_enough_and_a_tenth_is_not():
    rig, pose, picture = scene("far", free=120.0)
    assert seen_ball(picture, with_radius(rig, 1.02), pose).size_error == pytest.approx(1.0 / 1.02 - 1.0, abs=0.003)
    rig, pose, picture = scene("far", free=36.0)
    assert seen_ball(picture, with_radius(rig, 1.02), pose) is None


def test_a_picture_without_a_ball_shows_no_radius_and_no_centre():
    rig, pose, _ = scene("far")
    noise = np.random.default_rng(1).integers(0, 255, BLACK.shape, dtype=np.uint8)
    for picture in (BLACK, BLACK + 255, BLACK[..., 0]):
        assert seen_ball(picture, rig, pose) is None
        assert seen_centre(picture, rig, pose, np.zeros(3)) is None
    seen = seen_ball(noise, rig, pose)
    assert seen is None or seen.sigma == np.inf
    within = replace(pose, position=0.5 * rig.ball.radius * pose.position / np.linalg.norm(pose.position))
    assert seen_ball(BLACK, rig, within) is None


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("free", [360.0, 150.0])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.003, -0.002, 0.0), (-0.008, 0.008, 0.0)])
def test_a_shift_is_measured(view, free, shift):
    rig, pose, picture = scene(view, free, shift)
    seen = seen_centre(picture, rig, pose, np.zeros(3))
    off = seen.place - seen.axes.T @ shift
    assert np.abs(off[:2]).max() < (6e-4 if free == 360.0 else 2e-3)
    assert off @ np.linalg.solve(seen.covariance, off) < 16.3
    assert off[:2] @ np.linalg.solve(seen.across.covariance, off[:2]) < 9.0


def test_the_joint_covariance_holds_what_a_short_arc_shows():
    """Along the line of sight it shows little, and a shift across its middle looks alike. One shift shows the other."""
    rig, pose, picture = scene("near", 100.0, (0.002, 0.003, 0.001))
    seen = seen_centre(picture, rig, pose, np.zeros(3))
    given = np.linalg.inv(np.linalg.inv(seen.covariance)[:2, :2])  # the shift along the line of sight
    assert np.linalg.eigvalsh(given)[-1] < 0.5 * np.linalg.eigvalsh(seen.across.covariance)[-1]


def test_an_edge_that_is_not_the_balls_in_the_first_frame_is_none_later():
    """Struts hide both sides of the outline, with their edges 9 mm inside. The ball moves towards one of these."""
    rig, pose, home = scene("far")
    shift = pose.rotation @ [-0.006, 0.0, 0.0]
    moved = scene("far", shift=tuple(shift))[2]
    inside = home.astype(float).reshape(*home.shape[:2], -1)[..., 0] > 0.5 * home.max()
    v, u = np.argwhere(inside).mean(axis=0)
    y, x = np.indices(inside.shape)
    strut = (np.abs(x - u) > np.abs(y - v)) & (np.hypot(x - u, y - v) > 0.985 * np.sqrt(inside.sum() / np.pi))
    for picture in (home, moved):
        picture[strut] = 90
    trust = seen_ball(home, rig, pose).trust
    error = [
        np.linalg.norm(seen.across.place - seen.across.axes.T @ shift)
        for seen in (seen_centre(moved, rig, pose, rig.ball.centre + 0.5 * shift, t) for t in (None, trust))
    ]
    assert error[0] > 1e-3
    assert error[1] < 5e-4


def patched(picture, arc):
    """The picture with patches of the background's grey at the limb, up to 4 % deep, on an arc of degrees."""
    ball = picture.astype(float).reshape(*picture.shape[:2], -1)[..., 0]
    inside = ball > 0.5 * ball.max()
    radius = np.sqrt(inside.sum() / np.pi)
    v, u = np.argwhere(inside).mean(axis=0)
    y, x = np.indices(inside.shape)
    angle = np.degrees(np.arctan2(y - v, x - u)) % 360.0
    depth = 0.04 * np.sin(np.radians(6.0 * angle)) ** 2
    patch = (angle < arc) & (np.hypot(x - u, y - v) > (1.0 - depth) * radius)
    out = picture.copy()
    out[patch] = 90
    return out


def test_patches_at_the_limb_are_no_outline():
    """Their edges are parts of the ball, which turn with it. Most edges are theirs, and a robust fit follows them."""
    rig, pose, plain = scene("far")
    bold = patched(plain, 260.0)
    assert seen_ball(bold, rig, pose) is None
    first = seen_ball(plain, rig, pose)
    assert seen_centre(bold, rig, pose, np.zeros(3), first.trust) is None
    few = seen_centre(patched(plain, 100.0), rig, pose, np.zeros(3), first.trust)
    off = few.place - first.centre.place
    assert off @ np.linalg.solve(few.covariance + first.centre.scatter, off) < 9.0


def test_a_shift_is_no_error_of_the_radius():
    """A mode of the radii alone would be that of the side to which the ball has moved."""
    rig, pose, picture = scene("far", shift=(0.004, 0.003, 0.0))
    seen = seen_ball(picture, rig, pose)
    assert abs(seen.size_error) < 0.002
    centre = seen.centre.across
    assert np.abs(centre.place - centre.axes.T @ [0.004, 0.003, 0.0]).max() < 6e-4


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("margin", [0.995, 1.01, 1.03])
def test_the_edge_of_a_masked_recording_is_no_outline(view, margin):
    """Pixels beyond the mask are black."""
    rig, pose, picture = scene(view)
    kept = ball_mask(with_radius(rig, margin), pose)
    picture[kept == 0] = 0
    seen = seen_ball(picture, rig, pose)
    assert seen is None or abs(seen.size_error) < 2.0 * seen.sigma


def test_no_other_pixel_is_read():
    rig, pose, picture = scene("near", shift=(0.003, -0.002, 0.0))
    black = np.where(support_mask(rig, pose) > 0, picture, 0)
    one, other = (seen_ball(image, rig, pose) for image in (black, picture))
    np.testing.assert_equal(one._asdict(), other._asdict())
    for near in (np.zeros(3), np.array([0.008, -0.008, 0.0])):
        one, other = (seen_centre(image, rig, pose, near) for image in (black, picture))
        np.testing.assert_equal(one._asdict(), other._asdict())


def slopes(image, starts, steps, samples, half):
    """Twin: slopes by means of `half` samples, (n, samples - 2 half + 1), -1 where black pixels spoil them."""
    x, y = (starts[:, None] + steps[:, None] * np.arange(samples)[:, None]).transpose(2, 0, 1)
    colours = np.array(
        [map_coordinates(c.astype(float), (y, x), order=1, mode="nearest") for c in np.moveaxis(image, 2, 0)]
    )
    found = np.empty((len(starts), samples - 2 * half + 1))
    for k in range(samples - 2 * half + 1):
        step = colours[:, :, k + half : k + 2 * half].mean(axis=2) - colours[:, :, k : k + half].mean(axis=2)
        black = (colours[:, :, max(k - 6, 0) : k + 2 * half + 6] < 0.5).all(axis=0).any(axis=1)
        found[:, k] = np.where(black, -1.0, np.abs(step).max(axis=0))
    return found


@pytest.mark.parametrize("channels", [1, 3])
def test_slopes_agree_with_scipy_also_beyond_the_picture_and_beside_black_pixels(channels):
    rng = np.random.default_rng(channels)
    image = rng.integers(0, 256, (40, 60, channels), dtype=np.uint8)
    image[10:25, 20:45] = 0
    starts, steps = rng.uniform((-5.0, -5.0), (65.0, 45.0), (200, 2)), rng.uniform(-0.4, 0.4, (200, 2))
    truth, fine = (slopes(image, starts, steps, 50, half) for half in (8, 4))
    largest, where, median = kernels.outline_slopes(image, starts, steps, 50)
    beside, fine_beside = (np.lib.stride_tricks.sliding_window_view(s, 3, axis=1)[:, :, ::2] for s in (truth, fine))
    for slack in (-1e-3, 1e-3):  # a plateau is a peak, or none by its rounding
        peak = (beside.min(axis=2) >= 0.0) & (truth[:, 1:-1] >= beside.max(axis=2) - slack)
        most = np.where(peak, truth[:, 1:-1], 0.0).max(axis=1)
        assert np.all((largest - most) * np.sign(slack) < 1e-3)
    assert np.count_nonzero(truth < 0.0) > 200
    assert np.count_nonzero(most == 0.0) > 0
    peaks = np.where((fine_beside.min(axis=2) >= 0.0) & (fine[:, 1:-1] >= fine_beside.max(axis=2)), fine[:, 1:-1], 0.0)
    placed = 0
    for i in np.flatnonzero(largest > 0.0):
        coarse = np.flatnonzero(np.abs(truth[i, 1:-1] - largest[i]) < 1e-3) + 1 + 8
        if len(coarse) != 1:
            continue
        near = np.zeros(len(peaks[i]))
        near[max(coarse[0] - 13, 0) : coarse[0] + 4] = peaks[i, max(coarse[0] - 13, 0) : coarse[0] + 4]
        at = int(near.argmax())
        before, peak, after = fine[i, at : at + 3]
        bend = 2.0 * peak - before - after
        if peak - np.partition(near, -2)[-2] < 1e-3 or bend < 0.1:
            continue
        placed += 1
        assert where[i] == pytest.approx(at + 5 + 0.5 * (after - before) / bend, abs=2e-3)
    assert placed > 20
    known = np.sort(truth[truth >= 0.0])
    assert median == pytest.approx(known[len(known) // 2], abs=1e-3)


def test_a_picture_without_pixels_shows_no_slope():
    starts = np.full((3, 2), 5.0)
    largest, _, median = kernels.outline_slopes(np.zeros((9, 9, 3), np.uint8), starts, 0.1 * starts, 20)
    assert (largest == 0.0).all()
    assert median == 0.0


@pytest.mark.parametrize("gap", [1.5, 2.0, 3.0])
def test_an_edge_beside_another_stays_in_its_place(gap):
    """A strut's edge that is so many pixels from the ball's mixes into means of 2 px."""
    x = np.arange(60.0)
    grey = 40.0 + 160.0 * np.clip(x - 19.5, 0.0, 1.0) - 110.0 * np.clip(x - gap - 19.5, 0.0, 1.0)
    picture = np.tile(np.rint(grey).astype(np.uint8), (9, 1))[..., None]
    _, where, _ = kernels.outline_slopes(picture, np.array([[5.0, 4.0]]), np.array([[0.25, 0.0]]), 140)
    assert 5.0 + 0.25 * (where[0] - 0.5) == pytest.approx(20.0, abs=0.05)
