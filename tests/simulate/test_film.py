"""The simulator against closed forms, OpenCV's projection, its own laws, and an independent renderer."""

import csv
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from spheremouse.ball.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import Pose, project_circle, reduced_to_pixel, sphere_outline
from spheremouse.geometry.rotation import hat, to_euler
from spheremouse.simulate.ball.backdrop import render_backdrop, render_layers
from spheremouse.simulate.ball.events import Dimming, HandVisit, Lift, bump, facing, move_disc
from spheremouse.simulate.ball.film import Flicker, SimulationOptions, prepare, simulate
from spheremouse.simulate.ball.profile import creep, flick, play, rest, roll, still, thesis
from spheremouse.simulate.ball.render import RenderOptions
from spheremouse.simulate.ball.scene import default_scene, spread_directions
from spheremouse.simulate.ball.surface import Surface
from spheremouse.simulate.to_dataset import write_simulation
from tests.simulate.scenes import LENS, altered, fastest_time, image, painted, rms, rng

PROFILES = {
    "thesis": thesis(), "roll": roll(3.0), "part of a turn": roll(0.5), "roll in a given time": roll(4.0, 6.0),
    "play": play(20.0, rng(1)), "more play": play(20.0, rng(2)), "still": still(), "rest": rest(), "creep": creep(),
    "flick": flick()
}  # fmt: skip


@pytest.mark.parametrize("name", PROFILES)
def test_a_motion_starts_at_rest_in_obj_has_no_jumps_and_its_rate_is_the_derivative_of_its_attitude(name):
    profile, h = PROFILES[name], 1e-6
    t = rng().uniform(0.0, profile.seconds, 500)
    R = profile.attitude(t)
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    derivative = (profile.attitude(t + h) - profile.attitude(t - h)) / (2.0 * h)
    assert np.allclose(derivative, hat(profile.rate(t)) @ R, atol=3e-5)
    assert np.allclose(profile.attitude(np.zeros(1))[0], np.eye(3), atol=1e-12)
    assert np.allclose(profile.rate(np.zeros(1)), 0.0, atol=1e-12)
    t = np.linspace(0.0, profile.seconds, 4001)
    # a smoothstep to 400 deg/s within 50 ms is at most 1.5 * 140 rad/s²
    assert np.max(np.abs(np.diff(profile.rate(t), axis=0))) < max(0.25, 210.0 * (name == "flick") * t[1])
    one_by_one = np.array([profile.attitude(t[i : i + 1])[0] for i in range(0, len(t), 400)])
    assert np.allclose(one_by_one, profile.attitude(t)[::400], atol=1e-12)


def test_the_thesis_motion_has_the_published_figures():
    t = np.arange(300) / 30.0
    rate = np.degrees(thesis().rate(t))
    acceleration = np.gradient(rate, t, axis=0)
    assert np.mean(np.linalg.norm(acceleration, axis=1)) == pytest.approx(16.4, abs=0.3)
    assert np.max(np.linalg.norm(rate, axis=1)) == pytest.approx(28.0, abs=0.5)
    assert np.allclose(thesis().attitude(np.array([10.0, 13.7])), thesis().attitude(np.array([0.0, 3.7])), atol=1e-12)


@pytest.mark.parametrize("turns", [1.0, 2.5, 20.0])
def test_rolling_makes_its_turns_through_the_singularity(turns):
    profile = roll(turns)
    t = np.linspace(0.0, profile.seconds, 200_001 if turns > 5 else 20_001)
    speed = np.linalg.norm(profile.rate(t), axis=1)
    assert np.trapezoid(speed, t) == pytest.approx(2.0 * np.pi * turns, rel=1e-6)
    assert speed[-1] == pytest.approx(0.0, abs=1e-9)
    phi = np.degrees(to_euler(profile.attitude(t))[:, 1])
    assert phi.max() > 89.9
    if turns > 2.0:
        assert phi.min() < -89.9
    assert np.max(np.abs(profile.rate(t)[:, 1])) < 1e-9  # about horizontal axes


def projected(points, scene):
    """Return OpenCV's projection of points (n, 3) m, obj, (n, 2) px."""
    T = np.linalg.inv(scene.pose.matrix())
    return cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], scene.camera.matrix, None)[0][:, 0]


@pytest.mark.parametrize("view", ["far", "near"])
@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (1920, 1080)])
def test_ball_and_targets_are_in_the_picture(view, size):
    scene = default_scene(view=view, width=size[0], height=size[1])
    around = scene.targets.position[:, None] + scene.targets.radii[2] * np.array([*np.eye(3)[:2], *-np.eye(3)[:2]])
    outline = sphere_outline(scene.pose.to_cam(np.zeros(3)), scene.ball_radius, scene.camera)
    for points in (projected(around.reshape(-1, 3), scene), outline):
        assert np.all(points >= 0.0)
        assert np.all(points <= np.array(size) - 1.0)


@pytest.mark.parametrize("n", [1, 2, 26, 74, 200])
def test_discs_are_spread_and_do_not_overlap(n):
    u = spread_directions(n, 0.1, rng(4))
    assert np.allclose(np.linalg.norm(u, axis=1), 1.0)
    if n > 1:
        assert np.arccos(np.max(u @ u.T - 2.0 * np.eye(n))) >= 0.1
    if n > 20:
        anywhere = rng(1).standard_normal((2000, 3))
        anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
        assert np.max(np.min(np.arccos(np.clip(anywhere @ u.T, -1, 1)), axis=1)) < 5.0 / np.sqrt(n)
    assert np.array_equal(u, spread_directions(n, 0.1, rng(4)))


def whole_view(scene):
    return (np.ones((scene.camera.height, scene.camera.width), dtype=np.float32),) * 2


def test_disc_truth_equals_opencv_and_the_closed_form_of_a_projected_circle():
    scene = default_scene(view="near", discs=50)
    surface, profile, t = Surface(scene), thesis(), 3.3
    truth = surface.truth(profile.attitude, t, surface.coverage(profile.attitude, t), *whole_view(scene))
    directions = scene.disc_directions[truth.disc] @ profile.attitude(np.array([t]))[0].T
    assert np.allclose(truth.centre, projected(0.6 * directions, scene), atol=1e-9)
    angle = scene.disc_radius / scene.ball_radius
    centre, shape = project_circle(
        scene.pose.to_cam(0.6 * np.cos(angle) * directions), directions @ scene.pose.rotation, 0.6 * np.sin(angle)
    )
    whole = ~np.isnan(truth.area)
    assert whole.sum() > 10
    assert np.allclose(truth.blob_centre[whole], reduced_to_pixel(centre, scene.camera)[0][whole], atol=1e-4)
    area = np.pi * np.sqrt(np.linalg.det(shape)) * scene.camera.fx * scene.camera.fy
    assert np.allclose(truth.area[whole], area[whole], rtol=1e-5)
    # on the near side, and not cut by the limb: seen from the camera, by angles
    eye = scene.pose.position
    all_directions = scene.disc_directions @ profile.attitude(np.array([t]))[0].T
    towards = np.arccos(all_directions @ eye / np.linalg.norm(eye))
    horizon = np.arccos(0.6 / np.linalg.norm(eye))
    assert np.array_equal(truth.disc, np.flatnonzero(towards < horizon))
    assert np.array_equal(whole, towards[truth.disc] + angle < horizon)


@pytest.mark.parametrize(
    ("scene", "profile"),
    [
        (default_scene(), thesis()),
        (default_scene(view="near", distortion=LENS), thesis()),
        (replace(default_scene(), readout_s=0.025), play(20.0, rng(1))),
        (default_scene(width=1280, height=720, discs=74), thesis()),
    ],
    ids=["plain", "distorted", "rolling shutter", "720p"],
)
def test_covered_pixels_have_the_centroid_and_area_of_the_projected_cap(scene, profile):
    """Ray casting on one side, the projected outline on the other."""
    surface, width = Surface(scene), scene.camera.width
    off, ratio = [], []
    for t in np.linspace(1.0, 9.0, 12):
        covered = surface.coverage(profile.attitude, t)
        truth = surface.truth(profile.attitude, t, covered, *whole_view(scene))
        for disc, blob, area in zip(truth.disc, truth.blob_centre, truth.area, strict=True):
            if area >= 25.0:  # false for nan
                share, pixel = covered.share[covered.disc == disc], covered.pixel[covered.disc == disc]
                off.append(np.array([pixel % width, pixel // width]) @ share / share.sum() - blob)
                ratio.append(share.sum() / area)
    assert len(off) > 30
    assert np.sqrt(np.mean(np.square(off))) < 0.003
    assert np.max(np.abs(off)) < 0.02
    assert np.allclose(ratio, 1.0, atol=0.01)


@pytest.mark.parametrize("paint", [None, pytest.param("patches", marks=pytest.mark.slow), "dirt"])
def test_a_blurred_frame_is_the_mean_of_sharp_ones(small, paint):
    profile, exposure = play(20.0, rng(5)), 0.03
    t = fastest_time(profile)
    blurred = image(painted(small, paint, exposure_s=exposure), profile, t)
    sharp = painted(small, paint)
    moments = t + exposure * ((np.arange(40) + 0.5) / 40 - 0.5)
    mean = np.mean([image(sharp, profile, m) for m in moments], axis=0)
    assert rms(image(sharp, profile, t) - mean) > (0.1 if paint == "dirt" else 3.0)  # it did move
    assert np.max(np.abs(blurred - mean)) < 8.0
    assert rms(blurred - mean) < 0.4


@pytest.mark.parametrize("paint", [None, "patches"])
def test_a_rolling_shutter_takes_each_row_at_its_own_time(small, paint):
    profile, readout = play(20.0, rng(5)), 0.03
    t = fastest_time(profile)
    rolled, sharp = image(painted(small, paint, readout_s=readout), profile, t), painted(small, paint)
    assert np.any(rolled != image(sharp, profile, t))
    for row in range(20, 220, 9):
        at_once = image(sharp, profile, t + readout * ((row + 0.5) / 240.0 - 0.5))
        assert np.max(np.abs(rolled[row] - at_once[row])) <= 1


def test_noise_brightness_dimming_and_limited_range_are_what_they_say(small):
    def film(t=1.0, **options):
        return altered(small, RenderOptions(**options)).frame(still(), t, 0, rng(3)).frame.image.astype(float)

    plain = film()
    middle = (plain > 60) & (plain < 150)
    noisy = film(noise=5.0)
    assert np.std((noisy - plain)[middle]) == pytest.approx(np.sqrt(25.0 + 1.0 / 12.0), rel=0.02)
    assert np.mean((noisy - plain)[middle]) == pytest.approx(0.0, abs=0.05)
    channels = (noisy - plain)[20:220, 20:300].reshape(-1, 3)
    assert np.all(np.abs(np.corrcoef(channels.T) - np.eye(3)) < 0.05)
    assert np.array_equal(film(brightness=-50.0), np.maximum(plain - 50.0, 0.0))
    assert np.array_equal(film(brightness=50.0), np.minimum(plain + 50.0, 255.0))
    dim = (Dimming(0.5, 2.0, 0.4),)
    assert np.max(np.abs(film(light=dim) - 0.4 * plain)) <= 0.71
    assert np.array_equal(film(t=2.5, light=dim), plain)
    assert np.max(np.abs(film(limited=True) - (16.0 + plain * 219.0 / 255.0))) <= 0.5  # ITU-R BT.601


def test_bolts_and_discs_are_equally_dark(small):
    """A look-alike must not be given away by its grey value."""
    centre = small.scene.pose.to_cam(np.array([-0.3244, -0.052, 0.5612]))
    u, v = (int(x) for x in np.rint(centre[:2] / centre[2] * 320.0 + (160.0, 120.0)))
    filmed = small.frame(thesis(), 2.0, 0, rng())
    greys = [
        filmed.frame.image[int(c[1]), int(c[0])].mean() for c in filmed.discs.centre[filmed.discs.state == VISIBLE]
    ]
    assert min(greys) - 12 < filmed.frame.image[v, u].mean() < max(greys) + 12


def test_struts_hands_and_the_limb_decide_the_state(small):
    scene = small.scene

    def states(directions, options=None, t=0.0):
        u = np.array(directions, dtype=float)
        r = altered(small, options, disc_directions=u / np.linalg.norm(u, axis=1, keepdims=True))
        return r.frame(still(), t, 0, rng()).discs

    def behind(point):
        """Direction to where the sight line through a point meets the ball."""
        eye = scene.pose.position
        ray = (np.array(point) - eye) / np.linalg.norm(np.array(point) - eye)
        b = ray @ eye
        return eye + (-b - np.sqrt(b * b - eye @ eye + 0.36)) * ray

    limb = np.arccos(0.6 / 2.35)
    found = states(
        [
            [0.0, 0.0, 1.0],  # free
            behind([0.3256, 0.0, 0.5489]),  # the right strut
            behind([0.2780, 0.0, 0.5489]),  # its edge
            [0.0, np.sin(limb - 0.02), np.cos(limb - 0.02)],  # cut by the limb
            [0.0, np.sin(limb + 0.01), np.cos(limb + 0.01)],  # its centre is beyond
            [0.0, 0.0, -1.0],  # far side
        ]
    )
    assert found.disc.tolist() == [0, 1, 2, 3]
    assert found.state.tolist() == [VISIBLE, HIDDEN, PARTLY_HIDDEN, PARTLY_HIDDEN]
    assert np.isnan(found.area).tolist() == [False, False, False, True]
    grid = [[x, y, 1.0] for x in (-0.3, -0.15, 0.0, 0.15, 0.3) for y in (-0.5, -0.25, 0.0, 0.25)]
    hand = RenderOptions(hands=(HandVisit(1.0, 5.0, True),))
    assert np.all(states(grid, hand, t=0.5).state == VISIBLE)
    assert np.sum(states(grid, hand, t=3.0).state == HIDDEN) >= 2


def hidden(small, options, times):
    handled, outline = altered(small, options), small.backdrop.ball > 0.5
    plain, *seen = (
        r.frame(still(), t, 0, rng()).frame.image.astype(int) for r, t in [(small, 0.0), *((handled, t) for t in times)]
    )
    return np.array([np.mean(np.max(np.abs(image - plain), axis=2)[outline] > 3) for image in seen])


def test_two_hands_cover_up_to_a_third_of_the_ball_when_asked(small):
    playing = prepare(SimulationOptions(hands=True, size=(320, 240)))
    shares = hidden(small, playing.options, np.arange(0.0, 10.0, 0.25))
    assert shares.max() == pytest.approx(1.0 / 3.0, abs=0.08)
    assert np.all(shares[:8] == 0.0)  # the first seconds are free, for the camera pose
    assert 0.2 < np.mean(shares > 0.0) < 0.7
    covering = prepare(SimulationOptions(size=(320, 240), motion="still", cover=3.0, cover_seconds=1.0))
    assert np.all(hidden(small, covering.options, (2.4, 4.6)) == 0.0)
    assert np.allclose(hidden(small, covering.options, (3.0, 3.25, 3.5, 3.75, 4.0)), 1.0 / 3.0, atol=0.03)


def test_a_ball_out_of_its_place_looks_as_if_camera_and_room_had_moved_instead(small):
    scene, centre = replace(small.scene, surroundings=()), np.array([0.012, 0.035, -0.02])
    pose = scene.pose
    elsewhere = replace(scene, pose=Pose(pose.rotation, pose.position - centre))
    moved, expected = Surface(scene, 0.1).moved(centre), Surface(elsewhere)
    profile, t = thesis(), 3.3
    a, b = moved.coverage(profile.attitude, t), expected.coverage(profile.attitude, t)
    assert np.array_equal(a.pixel, b.pixel)
    assert np.array_equal(a.disc, b.disc)
    assert np.allclose(a.share, b.share, atol=1e-9)
    one, other = (c.truth(profile.attitude, t, cover, *whole_view(scene)) for c, cover in ((moved, a), (expected, b)))
    assert np.array_equal(one.disc, other.disc)
    for name in ("centre", "blob_centre", "area"):
        assert np.allclose(getattr(one, name), getattr(other, name), atol=1e-9, equal_nan=True)
    home = render_layers(small.scene).backdrop(np.zeros(3))
    for name in ("white", "black"):
        off = np.abs(getattr(home, name) - getattr(small.backdrop, name)).max(axis=2)
        assert np.mean(off > 1.5) < 1e-3  # where strut, ball and room meet in a pixel
        assert np.max(off) < 30.0
    assert np.mean(np.abs(home.ball - small.backdrop.ball) > 0.02) < 1e-4


@pytest.mark.parametrize(("view", "centre"), [("far", (0.012, 0.035, -0.02)), ("near", (0.03, 0.0, 0.0))])
def test_the_outline_of_a_ball_out_of_its_place_has_its_exact_shape(view, centre):
    """Off the camera's axis it is an ellipse, which turns as the ball moves aside."""
    scene = replace(default_scene(1, view, width=320, height=240), surroundings=())
    elsewhere = replace(scene, pose=Pose(scene.pose.rotation, scene.pose.position - centre))
    found, true = render_layers(scene).backdrop(np.array(centre)).outline, render_backdrop(elsewhere).outline

    def moments(outline):
        pixels, weights = np.indices(outline.shape).reshape(2, -1), outline.ravel()
        return outline.sum(), np.average(pixels, axis=1, weights=weights), np.cov(pixels, aweights=weights)

    (area, at, second), (true_area, true_at, true_second) = moments(found), moments(true)
    assert np.mean(np.abs(render_backdrop(scene).outline - true)) > 0.01  # it did move
    assert np.mean(np.abs(found - true)) < 0.002
    assert area == pytest.approx(true_area, rel=0.002)
    assert np.allclose(at, true_at, atol=0.05)
    assert view == "far" or abs(true_second[0, 1]) > 7.0
    assert np.allclose(second, true_second, atol=0.5)  # interpolation widens an edge


def test_a_lifted_ball_goes_and_comes_back_and_an_eccentric_one_goes_round(small):
    lift = Lift(1.0, 2.0, (0.0, 0.03, 0.0))
    assert np.allclose([lift.at(t)[1] for t in (0.5, 1.0, 1.4, 1.6, 2.0, 3.0)], [0, 0, 0.03, 0.03, 0, 0], atol=1e-12)
    lifted = altered(small, RenderOptions(lifts=(lift,)))
    before, during, after = (lifted.frame(still(), t, 0, rng()) for t in (0.5, 1.5, 2.5))
    assert np.array_equal(before.frame.image, small.frame(still(), 0.5, 0, rng()).frame.image)
    assert np.array_equal(before.frame.image, after.frame.image)
    assert np.allclose(during.centre, [0.0, 0.03, 0.0])
    common = np.intersect1d(during.discs.disc, before.discs.disc)
    a, b = (f.discs.centre[np.isin(f.discs.disc, common)] for f in (during, before))
    assert np.all((a - b)[:, 0] < -2.0)  # up is towards the left: the camera lies on its side
    eccentric = altered(small, RenderOptions(eccentric=(0.003, 0.004, 0.0)))
    filmed = eccentric.frame(thesis(), 3.0, 0, rng())
    assert np.allclose(filmed.centre, filmed.attitude @ [0.003, 0.004, 0.0])


@pytest.mark.slow
def test_a_ball_of_another_size_makes_the_same_pictures_and_its_device_scales_with_it():
    options = SimulationOptions(
        size=(160, 120), motion="still", seconds=1.0, fps=8.0, bump=0.6, lift=0.2, lift_seconds=0.6, hands=True
    )
    large, little = (prepare(replace(options, radius=radius)) for radius in (0.6, 0.005))
    a, b = (film.scene.rig() for film in (large, little))
    assert (b.ball.radius, b.disc_radius) == pytest.approx((0.005, a.disc_radius / 120.0))
    assert np.allclose(b.targets.position, a.targets.position / 120.0)
    assert np.allclose(b.targets.radii, a.targets.radii / 120.0)
    for first, second in zip(simulate(large), simulate(little), strict=True):
        assert np.max(np.abs(first.frame.image.astype(int) - second.frame.image)) <= 1
        assert np.allclose(second.centre, first.centre / 120.0)
        assert np.allclose(second.pose.position, first.pose.position / 120.0)
        assert np.allclose(second.discs.centre, first.discs.centre)


def test_a_bumped_camera_moves_along_its_own_axes():
    scene, point = default_scene(), np.array([[0.1, 0.2, 0.3]])
    moved = bump(scene, (2.0, -3.0, 4.0, 0.0, 0.0, 0.0)).pose
    assert np.allclose(moved.to_cam(point) - scene.pose.to_cam(point), [[-0.002, 0.003, -0.004]], atol=1e-12)
    turned = bump(scene, (0.0, 0.0, 0.0, 0.0, 0.5, 0.0)).pose
    assert np.allclose(turned.position, scene.pose.position)
    x, _, z = turned.to_cam(scene.pose.position + scene.pose.rotation[:, 2])
    assert np.degrees(np.arctan2(x, z)) == pytest.approx(-0.5)  # a camera turned to the right sees things go left


def test_changes_come_when_they_are_due_and_stay():
    options = SimulationOptions(
        size=(160, 120), motion="still", seconds=1.0, fps=10.0, bump=0.55, disc_off=0.2, disc_moved=0.75
    )
    simulation = prepare(options)
    assert [c.what for c in simulation.changes] == ["disc off", "bump", "disc moved"]
    frames = list(simulate(simulation))
    fallen, moved = simulation.changes[0].disc, simulation.changes[2].disc
    assert fallen == facing(simulation.scene, np.eye(3)) != moved
    for k, filmed in enumerate(frames):
        assert (fallen in filmed.discs.disc) == (k < 2)
        expected = simulation.scene.pose if k < 6 else simulation.changes[1].scene.pose
        assert np.array_equal(filmed.pose.matrix(), expected.matrix())
    u, v = (int(x) for x in np.rint(frames[0].discs.centre[frames[0].discs.disc == fallen][0]))
    assert frames[1].frame.image[v, u].max() < 60
    assert frames[2].frame.image[v, u].min() > 120

    def place(k):
        return frames[k].discs.centre[frames[k].discs.disc == moved][0]

    assert np.array_equal(place(6), place(7))
    assert np.linalg.norm(place(8) - place(7)) > 3.0
    assert np.linalg.norm(place(6) - place(5)) > 0.1


def test_a_disc_is_moved_to_where_there_is_room():
    scene = default_scene()
    other = move_disc(scene, 3)
    assert np.arccos(other.disc_directions[3] @ scene.disc_directions[3]) == pytest.approx(0.2)
    rest_of_them = np.delete(other.disc_directions, 3, axis=0)
    assert np.array_equal(rest_of_them, np.delete(scene.disc_directions, 3, axis=0))
    assert np.max(rest_of_them @ other.disc_directions[3]) < np.cos(3.0 * scene.disc_angle)
    phase = np.linspace(0.0, 2.0 * np.pi, 60)
    around = np.stack([np.sin(0.2) * np.cos(phase), np.sin(0.2) * np.sin(phase), np.full(60, np.cos(0.2))], axis=1)
    with pytest.raises(ValueError, match="no room"):
        move_disc(replace(scene, disc_directions=np.vstack([[0.0, 0.0, 1.0], around])), 0)


def test_another_layout_is_another_ball_in_the_same_play():
    a, b, c = (prepare(SimulationOptions(seed=s, layout=n, motion="play")) for s, n in ((1, None), (1, 7), (2, 7)))
    t = np.linspace(0.0, 20.0, 30)
    assert np.array_equal(b.scene.disc_directions, c.scene.disc_directions)
    assert not np.allclose(a.scene.disc_directions, b.scene.disc_directions)
    assert np.array_equal(a.profile.attitude(t), b.profile.attitude(t))
    assert not np.allclose(b.profile.attitude(t), c.profile.attitude(t))


def test_light_on_the_mains_flickers_from_frame_to_frame_and_in_bands(small):
    def ratio(t, **changes):
        lit = altered(small, RenderOptions(light=(Flicker(0.3),)), **changes).frame(still(), t, 0, rng())
        grey = (small.backdrop.white > 60) & (small.backdrop.white < 150)
        rows = [np.median(lit.frame.image[v][grey[v]] / small.backdrop.white[v][grey[v]]) for v in range(20, 220)]
        return np.array(rows)

    assert np.allclose(ratio(0.0), 1.3, atol=0.01)
    assert np.allclose(ratio(1.0 / 30.0), 1.0 + 0.3 * np.cos(2.0 * np.pi * 10.0 / 3.0), atol=0.01)
    assert np.allclose(ratio(0.0, exposure_s=0.005), 1.0 + 0.3 * 2.0 / np.pi, atol=0.01)
    assert np.allclose(ratio(0.0, exposure_s=0.01), 1.0, atol=0.01)  # a whole period
    rows = np.arange(20, 220)
    times = 0.02 * ((rows + 0.5) / 240.0 - 0.5)
    assert np.allclose(ratio(0.0, readout_s=0.02), 1.0 + 0.3 * np.cos(200.0 * np.pi * times), atol=0.02)


def test_events_are_written_with_the_truth(tmp_path):
    options = SimulationOptions(
        size=(64, 48), motion="still", seconds=0.4, fps=10.0, bump=0.15, disc_moved=0.25, lift=0.05, lift_seconds=0.2
    )
    simulation = prepare(options)
    assert list(write_simulation(tmp_path / "set", simulation)) == [1, 2, 3, 4]
    scene = json.loads((tmp_path / "set" / "scene.json").read_text())
    assert scene["truth_bump"]["t"] == 0.15
    assert np.allclose(scene["truth_bump"]["T_obj_cam"], simulation.changes[0].scene.pose.matrix())
    assert [(c["t"], c["what"]) for c in scene["truth_changes"]] == [(0.15, "bump"), (0.25, "disc moved")]
    disc = scene["truth_changes"][1]["disc"]
    assert np.allclose(scene["truth_changes"][1]["direction"], simulation.changes[1].scene.disc_directions[disc])
    with (tmp_path / "set" / "truth.csv").open() as file:
        height = [float(row["by"]) for row in csv.DictReader(file)]
    assert height == pytest.approx([0.0, 0.0266, 0.0266, 0.0], abs=0.004)


def test_simulate_gives_the_frames_it_promises_and_the_same_again():
    """Also when the only disc has fallen off."""
    simulation = prepare(
        SimulationOptions(
            size=(160, 120), noise=3.0, motion="play", seconds=0.5, fps=20.0, seed=9, discs=1, disc_off=0.1
        )
    )
    first, again = list(simulate(simulation)), list(simulate(simulation))
    assert len(first) == simulation.frames == 10
    assert [f.frame.sequence for f in first] == list(range(10))
    assert np.allclose([f.frame.stamp for f in first], np.arange(10) / 20.0)
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.frame.image, b.frame.image)
        assert a.frame.image.shape == (120, 160, 3)
        assert a.frame.image.dtype == np.uint8
        assert np.array_equal(a.attitude, simulation.profile.attitude(np.array([a.frame.stamp]))[0])
        assert np.array_equal(a.rate, simulation.profile.rate(np.array([a.frame.stamp]))[0])
    assert np.any(first[0].frame.image != first[1].frame.image)


@pytest.mark.parametrize(
    "wrong",
    [
        {"discs": 0},
        {"fps": float("nan")},
        {"seconds": -1.0},
        {"blur": 0.1},
        {"size": (0, 480)},
        {"seed": -1},
        {"turns": 1e308, "motion": "roll"},
        {"fps": 1e9},
        {"size": (20_000, 20_000)},
        {"dim_at": 1.0},
        {"flicker": 1.5},
        {"disc_colour": (0.0, float("nan"), 0.0)},
        {"bump_by": (0.0, 0.0, 0.0, 0.0, 40.0, 0.0)},
        {"lift_by": (0.0, 300.0, 0.0)},
        {"cover": 10.0},
        {"radius": 0.0},
    ],
    ids=str,
)
def test_options_that_make_no_sense_are_named(wrong):
    field = next(iter(wrong))
    with pytest.raises(ConfigurationError, match=f"^--{field.replace('_', '-')}: ") as e:
        prepare(SimulationOptions(**wrong))
    assert "\n" not in str(e.value)
    with pytest.raises(ConfigurationError, match=f"^synthetic: {field}: "):
        prepare(SimulationOptions(**wrong), lambda name: f"synthetic: {name}")


def test_cameras_of_one_seed_film_one_motion():
    """Their truth is the same ball in the axes of each, and their noise differs."""
    common = {"motion": "play", "seconds": 0.1, "size": (80, 60), "noise": 2.0, "sway": 5.0}
    front = prepare(SimulationOptions(**common))
    side = prepare(SimulationOptions(**common, azimuth=90.0, late=0.01))
    times = np.linspace(0.0, 0.2, 5)
    np.testing.assert_allclose(side.turn @ side.profile.attitude(times), front.profile.attitude(times), atol=1e-12)
    np.testing.assert_allclose(side.profile.rate(times) @ side.turn.T, front.profile.rate(times), atol=1e-12)
    np.testing.assert_allclose(side.turn @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], atol=1e-12)  # it stands at the right
    ours, theirs = list(simulate(front)), list(simulate(side))
    assert [f.frame.stamp for f in theirs] == pytest.approx([f.frame.stamp + 0.01 for f in ours])
    np.testing.assert_allclose(side.turn @ side.options.lifts[0].shift, front.options.lifts[0].shift, atol=1e-12)
    assert np.mean(ours[0].frame.image != theirs[0].frame.image) > 0.5
