"""The simulator against closed forms, OpenCV's projection, its own laws, and an independent renderer."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from spheremouse.camera import project_circle, project_sphere, reduced_to_pixel
from spheremouse.errors import ConfigurationError
from spheremouse.recording import open_dataset, read_frames
from spheremouse.rotation import hat, to_euler
from spheremouse.simulate import (
    Dimming,
    HandVisit,
    Renderer,
    RenderOptions,
    SimulationOptions,
    default_scene,
    prepare,
    simulate,
)
from spheremouse.simulate.backdrop import render_backdrop
from spheremouse.simulate.caps import BallView, Caps
from spheremouse.simulate.profile import play, roll, still, thesis
from spheremouse.simulate.scene import spread_directions
from spheremouse.simulate.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE

LENS = np.array([-0.2, 0.06, 0.001, -0.0015, -0.01])


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def renderer():
    return Renderer(default_scene())


@pytest.fixture(scope="module")
def small():
    """A renderer of small pictures."""
    return Renderer(default_scene(width=320, height=240, discs=40))


class Fixed:
    """A ball that stays at one attitude."""

    seconds = 1.0

    def __init__(self, R):
        self.R = R

    def attitude(self, t):
        return np.broadcast_to(self.R, (len(t), 3, 3))

    def rate(self, t):
        return np.zeros((len(t), 3))


def in_image(centre, shape, camera):
    """Corners of the polygon that an ellipse in reduced coordinates makes in the image, (720, 2) px."""
    phase = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    circle = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return reduced_to_pixel(centre + circle @ np.linalg.cholesky(shape).T, camera)[0]


# ---- motion ----

PROFILES = {
    "thesis": thesis(),
    "roll": roll(3.0),
    "part of a turn": roll(0.5),
    "roll in a given time": roll(4.0, 6.0),
    "play": play(20.0, rng(1)),
    "more play": play(20.0, rng(2)),
    "still": still(),
}


@pytest.mark.parametrize("name", PROFILES)
def test_the_rate_is_the_derivative_of_the_attitude(name):
    profile, h = PROFILES[name], 1e-6
    t = np.random.default_rng(0).uniform(0.0, profile.seconds, 500)
    R = profile.attitude(t)
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    derivative = (profile.attitude(t + h) - profile.attitude(t - h)) / (2.0 * h)
    assert np.allclose(derivative, hat(profile.rate(t)) @ R, atol=3e-5)


@pytest.mark.parametrize("name", PROFILES)
def test_motion_starts_at_rest_in_obj_and_has_no_jumps(name):
    profile = PROFILES[name]
    assert np.allclose(profile.attitude(np.zeros(1))[0], np.eye(3), atol=1e-12)
    assert np.allclose(profile.rate(np.zeros(1)), 0.0, atol=1e-12)
    t = np.linspace(0.0, profile.seconds, 4001)
    assert np.max(np.abs(np.diff(profile.rate(t), axis=0))) < 0.25
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


def test_play_is_the_same_for_the_same_seed_only():
    t = np.linspace(0.0, 20.0, 50)
    a, b, c = (play(20.0, rng(seed)).attitude(t) for seed in (5, 5, 6))
    assert np.array_equal(a, b)
    assert not np.allclose(a, c)
    rests = np.linalg.norm(play(60.0, rng(3)).rate(np.linspace(0.0, 60.0, 6000)), axis=1)
    assert np.mean(rests == 0.0) > 0.05
    assert np.degrees(rests.max()) > 120.0


# ---- scene ----


def test_the_far_camera_is_that_of_the_reference_recording():
    expected = [[0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 2.35], [0, 0, 0, 1]]
    assert np.allclose(default_scene().pose.matrix(), expected, atol=1e-12)


@pytest.mark.parametrize("view", ["far", "near"])
@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (1920, 1080)])
def test_ball_and_targets_are_in_the_picture(view, size):
    scene = default_scene(view=view, width=size[0], height=size[1])
    T = np.linalg.inv(scene.pose.matrix())
    around = scene.targets.position[:, None] + scene.targets.radii[2] * np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]
    )
    uv, _ = cv2.projectPoints(around.reshape(-1, 3), cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], scene.camera.matrix, None)
    outline = in_image(*project_sphere(scene.pose.to_cam(np.zeros(3)), scene.ball_radius), scene.camera)
    for points in (uv.reshape(-1, 2), outline):
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


def test_too_many_discs_are_refused():
    with pytest.raises(ValueError, match="do not fit"):
        spread_directions(2000, 0.1, rng())


def test_the_rig_tells_no_truth():
    rig = default_scene().rig()
    assert rig.pose is None
    assert rig.disc_directions is None


# ---- caps ----


def shown(scene):
    alone = np.ones((scene.camera.height, scene.camera.width), dtype=np.float32)
    return BallView(alone, alone)


def test_disc_truth_equals_opencv_and_the_closed_form_of_a_projected_circle():
    scene = default_scene(view="near", discs=50)
    caps, profile, t = Caps(scene), thesis(), 3.3
    truth = caps.truth(profile.attitude, t, 7, caps.coverage(profile.attitude, t), shown(scene))
    directions = scene.disc_directions[truth.disc] @ profile.attitude(np.array([t]))[0].T
    T = np.linalg.inv(scene.pose.matrix())
    uv, _ = cv2.projectPoints(0.6 * directions, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], scene.camera.matrix, None)
    assert np.allclose(truth.centre, uv[:, 0], atol=1e-9)
    assert set(truth.frame) == {7}

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
    ("change", "profile"),
    [
        ({}, thesis()),
        ({"view": "near", "distortion": LENS}, thesis()),
        ({"readout_s": 0.025}, play(20.0, rng(1))),
        ({"width": 1280, "height": 720, "discs": 74}, thesis()),
    ],
    ids=["plain", "distorted", "rolling shutter", "720p"],
)
def test_covered_pixels_have_the_centroid_and_area_of_the_projected_cap(change, profile):
    """Ray casting on one side, the projected outline on the other."""
    scene = default_scene(**change)
    caps, width = Caps(scene), scene.camera.width
    off, ratio = [], []
    for t in np.linspace(1.0, 9.0, 12):
        covered = caps.coverage(profile.attitude, t)
        truth = caps.truth(profile.attitude, t, 0, covered, shown(scene))
        for disc, blob, area in zip(truth.disc, truth.blob_centre, truth.area, strict=True):
            if area >= 60.0:  # false for nan
                share, pixel = covered.share[covered.disc == disc], covered.pixel[covered.disc == disc]
                off.append(np.array([pixel % width, pixel // width]) @ share / share.sum() - blob)
                ratio.append(share.sum() / area)
    assert len(off) > 30
    assert np.sqrt(np.mean(np.square(off))) < 0.003
    assert np.max(np.abs(off)) < 0.02
    assert np.allclose(ratio, 1.0, atol=0.01)


def test_a_thin_disc_near_the_limb_is_covered_as_a_fine_grid_of_rays_says(renderer):
    scene = default_scene(discs=1)
    eye = scene.pose.position / np.linalg.norm(scene.pose.position)
    tilt = np.arccos(0.6 / 2.35) - 0.05
    direction = np.array([np.sin(tilt) * 0.8, np.sin(tilt) * 0.6, np.cos(tilt)])
    assert direction @ eye == pytest.approx(np.cos(tilt))
    scene = replace(scene, disc_directions=direction[None])
    covered = Caps(scene).coverage(still().attitude, 0.0)

    fine = 40
    where = np.arange(fine) / fine + 0.5 / fine - 0.5
    dv, du = np.meshgrid(where, where, indexing="ij")
    total, moment = 0.0, np.zeros(2)
    v0, u0 = (int(x) for x in np.divmod(covered.pixel[0], 640))
    for v in range(v0 - 12, v0 + 30):
        for u in range(u0 - 30, u0 + 30):
            ray = np.stack([(u + du - 320.0) / 640.0, (v + dv - 240.0) / 640.0, np.ones_like(du)], axis=-1)
            ray = ray @ scene.pose.rotation.T
            ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
            b = ray @ scene.pose.position
            root = b * b - (2.35**2 - 0.36)
            point = scene.pose.position + (-b - np.sqrt(np.maximum(root, 0.0)))[..., None] * ray
            inside = (root > 0.0) & (point @ direction > 0.6 * np.cos(1.0 / 30.0))
            total += inside.mean()
            moment += np.array([u * inside.mean() + (inside * du).mean(), v * inside.mean() + (inside * dv).mean()])
    u, v = covered.pixel % 640, covered.pixel // 640
    share = covered.share * renderer.backdrop.outline.ravel()[covered.pixel]
    assert share.sum() == pytest.approx(total, rel=0.03)
    # a pixel's coverage counts at its centre: compare with the mean of the fine points within a tenth of a pixel
    assert np.allclose(np.array([u, v]) @ share / share.sum(), moment / total, atol=0.1)


# ---- pictures ----


def altered(renderer, options=None, **changes):
    """A renderer with another ball or camera, in the same room."""
    return Renderer(replace(renderer.scene, **changes), options, renderer.backdrop)


def test_grey_weighted_centroids_of_rendered_discs_are_the_truth(renderer):
    white = renderer.backdrop.white.astype(float).mean(axis=2)
    off = []
    for t in (0.0, 2.0, 4.0, 6.0):
        filmed = renderer.frame(thesis(), t, 0, rng())
        dark = (white - filmed.frame.image.astype(float).mean(axis=2)) / white
        for k in np.flatnonzero((filmed.discs.state == VISIBLE) & (filmed.discs.area >= 60.0)):
            u, v = (int(x) for x in np.rint(filmed.discs.centre[k]))
            window = dark[v - 12 : v + 13, u - 12 : u + 13]
            window = np.where(window > 0.02, window, 0.0)  # what rounding to whole grey values leaves
            dv, du = np.mgrid[v - 12 : v + 13, u - 12 : u + 13]
            off.append(
                np.array([np.sum(du * window), np.sum(dv * window)]) / window.sum() - filmed.discs.blob_centre[k]
            )
    assert len(off) > 12
    assert np.sqrt(np.mean(np.square(off))) < 0.02


def test_rendered_targets_are_where_projected_circles_are():
    scene = default_scene(view="near", distortion=LENS)
    image = render_backdrop(scene).white.astype(float)
    colourful = image.max(axis=2) - image.min(axis=2)
    targets = scene.targets
    centre, shape = project_circle(
        scene.pose.to_cam(targets.position),
        np.broadcast_to(scene.pose.rotation[2], (4, 3)),  # z of obj, in cam
        targets.radii[2],
    )
    for k in range(4):
        polygon = in_image(centre[k], shape[k], scene.camera)
        moments = cv2.moments(polygon.astype(np.float32).reshape(-1, 1, 2))
        expected = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        u, v = (int(x) for x in np.rint(expected))
        ring = np.median(np.sort(colourful[v - 25 : v + 26, u - 25 : u + 26].ravel())[-300:])
        mask = np.zeros(colourful.shape, dtype=np.uint8)
        cv2.fillPoly(mask, [np.rint(expected + 1.15 * (polygon - expected)).astype(np.int32)], 1)
        weight = np.clip((colourful - 12.0) / (0.45 * ring), 0.0, 1.0) * mask
        dv, du = np.mgrid[0 : weight.shape[0], 0 : weight.shape[1]]
        found = np.array([np.sum(du * weight), np.sum(dv * weight)]) / weight.sum()
        assert np.allclose(found, expected, atol=0.05), targets.codes[k]


def fastest_time(profile):
    t = np.linspace(0.0, profile.seconds, 2001)
    speed = np.linalg.norm(profile.rate(t), axis=1)
    assert speed.max() > 2.0  # rad/s
    return float(t[np.argmax(speed)])


def test_a_blurred_frame_is_the_mean_of_sharp_ones(small):
    profile, exposure = play(20.0, rng(5)), 0.03
    t = fastest_time(profile)
    blurred = altered(small, exposure_s=exposure).frame(profile, t, 0, rng()).frame.image.astype(float)
    sharp = small
    moments = t + exposure * ((np.arange(40) + 0.5) / 40 - 0.5)
    mean = np.mean([sharp.frame(profile, m, 0, rng()).frame.image.astype(float) for m in moments], axis=0)
    assert np.max(np.abs(mean - sharp.frame(profile, t, 0, rng()).frame.image)) > 40.0  # it did move
    assert np.max(np.abs(blurred - mean)) < 8.0
    assert np.mean(np.abs(blurred - mean)) < 0.05


def test_a_rolling_shutter_takes_each_row_at_its_own_time(small):
    profile, readout = play(20.0, rng(5)), 0.03
    t = fastest_time(profile)
    rolled = altered(small, readout_s=readout).frame(profile, t, 0, rng()).frame.image
    sharp = small
    assert np.any(rolled != sharp.frame(profile, t, 0, rng()).frame.image)
    for row in range(20, 220, 9):
        moment = t + readout * ((row + 0.5) / 240.0 - 0.5)
        at_once = sharp.frame(profile, moment, 0, rng()).frame.image
        assert np.max(np.abs(rolled[row].astype(int) - at_once[row])) <= 1


def test_noise_brightness_and_dimming_are_what_they_say(small):
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
    assert np.max(np.abs(film(dimming=dim) - 0.4 * plain)) <= 0.71
    assert np.array_equal(film(t=2.5, dimming=dim), plain)


def test_bolts_and_discs_are_equally_dark(renderer):
    """A look-alike must not be given away by its grey value."""
    centre = renderer.scene.pose.to_cam(np.array([-0.3244, -0.052, 0.5612]))
    u, v = (int(x) for x in np.rint(centre[:2] / centre[2] * 640.0 + (320.0, 240.0)))
    filmed = renderer.frame(thesis(), 2.0, 0, rng())
    greys = [
        filmed.frame.image[int(c[1]), int(c[0])].mean() for c in filmed.discs.centre[filmed.discs.state == VISIBLE]
    ]
    assert min(greys) - 12 < filmed.frame.image[v, u].mean() < max(greys) + 12


def test_struts_hands_and_the_limb_decide_the_state(renderer):
    scene = renderer.scene

    def states(directions, options=None, t=0.0):
        u = np.array(directions, dtype=float)
        r = altered(renderer, options, disc_directions=u / np.linalg.norm(u, axis=1, keepdims=True))
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


def test_two_hands_cover_up_to_a_third_of_the_ball(small):
    simulation = prepare(SimulationOptions(hands=True, size=(320, 240)))
    handled = altered(small, simulation.options)
    outline = small.backdrop.ball > 0.5
    hidden = []
    for t in np.arange(0.0, 10.0, 0.25):
        a, b = (r.frame(still(), t, 0, rng()).frame.image.astype(int) for r in (small, handled))
        hidden.append(np.mean(np.max(np.abs(a - b), axis=2)[outline] > 3))
    assert max(hidden) == pytest.approx(1.0 / 3.0, abs=0.08)
    assert hidden[:8] == [0.0] * 8  # the first seconds are free, for the camera pose
    assert 0.2 < np.mean(np.array(hidden) > 0.0) < 0.7


def test_a_lens_that_folds_back_leaves_the_corners_black():
    scene = default_scene(view="near", width=320, height=240, distortion=np.array([-0.35, 0.0, 0.0, 0.0, 0.0]))
    image = Renderer(scene).frame(still(), 0.0, 0, rng()).frame.image
    assert np.all(image[:4, :4] == 0)
    assert np.all(image[110:130, 150:170] > 60)


# ---- the whole ----


def test_simulate_gives_the_frames_it_promises_and_the_same_again():
    simulation = prepare(SimulationOptions(size=(160, 120), noise=3.0, motion="play", seconds=0.5, fps=20.0, seed=9))
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
        {"discs": 5000},
        {"fps": 0.0},
        {"fps": float("nan")},
        {"seconds": -1.0},
        {"noise": -1.0},
        {"blur": 0.1},
        {"readout": 0.1},
        {"size": (0, 480)},
        {"turns": 0.0},
        {"dim": -0.5},
    ],
    ids=str,
)
def test_options_that_make_no_sense_are_named(wrong):
    with pytest.raises(ConfigurationError, match=f"--{next(iter(wrong))}"):
        prepare(SimulationOptions(**wrong))


# ---- against the reference recording ----


def reference(far26):
    recording = open_dataset(far26)
    scene = replace(
        default_scene(), camera=recording.rig.camera, pose=recording.pose, disc_directions=recording.truth_directions
    )
    return recording, scene


def test_disc_truth_agrees_with_the_reference_recording(far26):
    recording, scene = reference(far26)
    caps = Caps(scene)
    for index in range(0, recording.frames, 10):
        profile = Fixed(recording.truth.attitude[index])
        ours = caps.truth(profile.attitude, 0.0, index, caps.coverage(profile.attitude, 0.0), shown(scene))
        theirs = recording.discs.of_frame(index)
        assert np.array_equal(ours.disc, theirs.disc)
        assert np.allclose(ours.centre, theirs.centre, atol=2e-4)  # the file has four digits
        assert np.allclose(ours.blob_centre, theirs.blob_centre, atol=2e-4, equal_nan=True)
        assert np.allclose(ours.area, theirs.area, rtol=2e-3, equal_nan=True)


def test_discs_are_seen_where_a_path_tracer_shows_them(far26):
    recording, scene = reference(far26)
    renderer = Renderer(scene)
    off = []
    for frame in read_frames(recording):
        if frame.sequence % 20:
            continue
        ours = renderer.frame(Fixed(recording.truth.attitude[frame.sequence]), 0.0, 0, rng())
        theirs = recording.discs.of_frame(frame.sequence)
        for k in np.flatnonzero((theirs.state == VISIBLE) & (theirs.area > 60.0)):
            if ours.discs.state[k] == VISIBLE:
                a, b = (dark_centroid(image, theirs.centre[k]) for image in (ours.frame.image, frame.image))
                if a is not None and b is not None:
                    off.append(a - b)
        if frame.sequence >= 200:
            break
    assert len(off) > 25
    assert np.sqrt(np.mean(np.square(off))) < 0.06
    assert np.max(np.abs(np.mean(off, axis=0))) < 0.02  # no common shift: the same pixel convention


def dark_centroid(image, centre, half=9):
    """Centroid of what is darker than half the surroundings, weighted by how much; None where it is not alone."""
    grey = image.astype(float).mean(axis=2)
    u, v = (int(x) for x in np.rint(centre))
    window = grey[v - half : v + half + 1, u - half : u + half + 1]
    border = np.concatenate([window[0], window[-1], window[:, 0], window[:, -1]])
    if border.min() < 0.85 * border.max():
        return None
    weight = np.clip(np.median(border) * 0.9 - window, 0.0, None)
    dv, du = np.mgrid[v - half : v + half + 1, u - half : u + half + 1]
    return np.array([np.sum(du * weight), np.sum(dv * weight)]) / weight.sum()
