"""Tracker: accuracy on films of the independent renderer, hidden and lost balls, events, distractors."""

from dataclasses import replace
from itertools import islice, pairwise

import cv2
import numpy as np
import pytest
from experiments.kit.balls import contrast_ball, led_ball

from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.simulate.wand.room import Passing
from spheremouse.tracker import Frame, Status
from spheremouse.wand.build import build
from spheremouse.wand.events import BallHidden, BallLost, ColourEverywhere, ColourNowhere, SecondBall
from spheremouse.wand.settings import ColourSettings, WandSettings
from spheremouse.wand.state import EXPOSURES, WandPose
from spheremouse.wand.track import begin, step

HAND = WandOptions(motion="hand", blur=0.008, size=(640, 480), focal=500.0, seconds=1.4, seed=3)


def film(options=HAND, ball=None):
    made = prepare_wand(options, ball)
    return made.scene.camera, tuple(c.ball for c in made.scene.balls), list(simulate_wand(made))


@pytest.fixture(scope="module")
def hand():
    return film()


@pytest.fixture(scope="module")
def steps(hand):
    """The default tracker's steps through the film of the hand."""
    camera, balls, shots = hand
    tracker = build(camera, balls)
    state, found = begin(tracker, 1), []
    for shot in shots:
        found.append(step(state, shot.frame, tracker))
        state = found[-1].state
    return found


def follow(shots, tracker, state=None):
    state = state or begin(tracker, 1)
    poses = []
    for shot in shots:
        state = step(state, shot.frame, tracker).state
        poses.append(state.poses)
    return state, poses


def followed(options, ball=None):
    """A film, and the default tracker's poses in it."""
    camera, balls, shots = film(options, ball)
    return shots, follow(shots, build(camera, balls))[1]


def replace_stamp(shot, k):
    """Return the shot as the k-th frame."""
    return replace(shot, frame=replace(shot.frame, stamp=k / 15.0, sequence=k))


def worst(shots, poses, ball=0, skip=0):
    """Return the largest errors across and along the line of sight, m, and of rotation, rad."""
    errors = []
    for shot, found in list(zip(shots, poses, strict=True))[skip:]:
        assert found[ball].position is not None, found[ball].event
        d = found[ball].position - shot.position[ball]
        errors.append([np.hypot(*d[:2]), abs(d[2]), np.linalg.norm(log(found[ball].rotation @ shot.rotation[ball].T))])
    return np.max(errors, axis=0)


def test_fast_hand_is_tracked_without_an_initial_pose(hand, steps):
    camera, balls, shots = hand
    _, few = follow(shots, build(camera, balls, WandSettings(particles=50)))
    for poses in (few, [found.state.poses for found in steps]):
        assert np.all(worst(shots, poses, skip=4) < [0.006, 0.06, np.deg2rad(8)])


def test_nees_is_of_the_order_of_one(hand, steps):
    nees = []
    for shot, found in zip(hand[2], steps, strict=True):
        (pose,) = found.state.poses
        e = np.concatenate([pose.position - shot.position[0], log(pose.rotation @ shot.rotation[0].T)])
        nees.append(e @ np.linalg.solve(pose.covariance, e) / 6.0)
    assert 0.1 < np.mean(nees) < 3.0


def test_equal_frames_and_seeds_give_equal_poses(hand, steps):
    camera, balls, shots = hand
    _, again = follow(shots[:5], build(camera, balls))
    for (a,), found in zip(again, steps[:5], strict=True):
        (b,) = found.state.poses
        np.testing.assert_array_equal(a.position, b.position)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_increments_add_up_to_the_motion(steps):
    found = [each.estimate for each in steps]
    assert [estimate.sequence for estimate in found] == list(range(len(steps)))
    assert all(estimate.confirmed for estimate in found)
    turn = np.eye(3)
    for estimate in found[1:]:
        turn = exp(estimate.increment[:3]) @ turn
    np.testing.assert_allclose(turn, found[-1].rotation @ found[0].rotation.T, atol=1e-9)
    shift = np.sum([estimate.increment[3:] for estimate in found], axis=0)
    np.testing.assert_allclose(shift, found[-1].position - found[0].position, atol=1e-12)


@pytest.mark.parametrize("ball", [contrast_ball(), led_ball()], ids=lambda b: b.name)
def test_balls_of_one_colour_are_tracked(ball):
    shots, poses = followed(replace(HAND, clutter=False, seconds=0.7, focal=700.0), ball)
    assert np.all(worst(shots, poses, skip=4) < [0.006, 0.06, np.deg2rad(8)])


def test_a_hidden_ball_is_predicted_then_lost_and_found_again(hand):
    camera, balls, shots = hand
    tracker = build(camera, balls)
    state, poses = follow(shots[:4], tracker)
    (before,), empty, hidden = poses[-1], np.full_like(shots[0].frame.image, 128), list[WandPose]()
    for k in range(12):
        found = step(state, Frame(empty, shots[3].frame.stamp + 0.066 * (k + 1), 100 + k), tracker)
        state = found.state
        hidden += state.poses
        assert not found.estimate.confirmed
        assert not found.estimate.increment.any()
    first, last = hidden[0], hidden[-1]
    assert (first.phase, first.seen, first.event) == (Status.TRACKING, False, BallHidden("grzonka"))
    assert np.all(np.diag(first.covariance)[:2] > np.diag(before.covariance)[:2])
    assert last.phase == Status.LOST
    assert last.position is None
    assert isinstance(last.event, BallLost | ColourNowhere)
    later = [replace(s, frame=Frame(s.frame.image, s.frame.stamp + 2.0, 200 + i)) for i, s in enumerate(shots[8:14])]
    _, poses = follow(later, tracker, state)
    assert np.all(worst(later, poses, skip=3) < [0.006, 0.06, np.deg2rad(8)])


def test_covariance_of_a_hidden_ball_grows_by_the_random_walk():
    camera, balls, shots = film(replace(HAND, distance=2.0, fps=30.0, seconds=0.4))
    settings = WandSettings(particles=4000)
    tracker = build(camera, balls, settings)
    state, poses = follow(shots, tracker)
    empty = np.full_like(shots[0].frame.image, 128)
    for k in range(1, 11):
        state = step(state, Frame(empty, shots[-1].frame.stamp + 0.04 * k, 100 + k), tracker).state
        (pose,) = state.poses
    assert not pose.seen
    walk = np.array([settings.sigma_x, settings.sigma_y, settings.sigma_z]) ** 2 * (0.4 / 1.25)
    gained = np.diag(pose.covariance - poses[-1][0].covariance)[:3]
    assert gained == pytest.approx(walk, rel=0.15)


def test_velocity_is_that_of_the_hand(hand, steps):
    """The error is less than 40 % after three frames, also along the line of sight."""
    shots, off, speed = hand[2], [], []
    for k in range(4, len(shots) - 1):
        a, b = shots[k - 1], shots[k + 1]
        dt = b.frame.stamp - a.frame.stamp
        true = np.concatenate([b.position[0] - a.position[0], log(b.rotation[0] @ a.rotation[0].T)]) / dt
        off.append(steps[k].state.tracks[0].velocity - true)
        speed.append(true)
    for part in (slice(0, 2), slice(2, 3), slice(3, 6)):
        assert np.linalg.norm(np.array(off)[:, part]) < 0.4 * np.linalg.norm(np.array(speed)[:, part])


def test_the_exposure_of_a_blurred_ball_is_estimated():
    """The ball moves by a tenth of its diameter during an exposure. Without its motion, nine frames do not show it."""
    options = replace(HAND, blur=0.016, fps=20.0, focal=800.0, distance=0.7, speed=0.8, seconds=1.5, seed=5)
    camera, balls, shots = film(options)
    state, poses = follow(shots, build(camera, balls))
    assert all(pose.seen for (pose,) in poses)
    exposure = EXPOSURES[np.argmax(state.tracks[0].exposure_log_likelihood)]
    assert 0.008 <= exposure <= 0.024


@pytest.mark.parametrize("seed", [3, 4])
def test_a_lens_out_of_focus_moves_the_rims_that_bounds_select(seed):
    """Its blur of 1.2 px mixes light, not grey values. With the rims of a sharp lens, most frames show no ball."""
    camera, balls, shots = film(replace(HAND, distance=1.0, focal=550.0, fps=30.0, seconds=1.0, seed=seed))
    blurred = []
    for shot in shots:
        light = cv2.GaussianBlur((shot.frame.image / 255.0) ** 2.2, (0, 0), 1.2)
        image = np.rint(255.0 * light ** (1.0 / 2.2)).astype(np.uint8)
        blurred.append(replace(shot, frame=replace(shot.frame, image=image)))
    _, poses = follow(blurred, build(camera, balls))
    nees = []
    for shot, (pose,) in list(zip(shots, poses, strict=True))[6:]:
        assert pose.seen
        error = np.concatenate([pose.position - shot.position[0], log(pose.rotation @ shot.rotation[0].T)])
        nees.append(error @ np.linalg.solve(pose.covariance, error) / 6.0)
    assert np.mean(nees) < 2.0


def test_a_picture_that_the_camera_gives_again_is_no_measurement(hand):
    """Every fifth picture is the last one. Taken as new, it shows a ball that stands, 10 degrees off."""
    camera, balls, shots = hand
    shown = [replace(s, frame=replace(s.frame, image=shots[k - (k % 5 == 4)].frame.image)) for k, s in enumerate(shots)]
    _, poses = follow(shown, build(camera, balls))
    assert [k for k, (pose,) in enumerate(poses) if not pose.seen] == list(range(4, len(shots), 5))
    across, _, angle = worst(shots, poses)
    assert across < 0.01
    assert angle < np.radians(8.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_nees_of_a_small_ball_at_a_high_frame_rate(seed):
    """25 px across at 30 Hz, where errors of successive frames are correlated, without a bias in distance."""
    shots, poses = followed(replace(HAND, distance=2.0, fps=30.0, seconds=1.5, seed=seed))
    off = np.array([pose.position - shot.position[0] for shot, (pose,) in zip(shots, poses, strict=True)])
    nees = [d @ np.linalg.solve(pose.covariance[:3, :3], d) / 3.0 for d, (pose,) in zip(off, poses, strict=True)]
    assert np.mean(nees) < 2.0
    assert abs(off[:, 2].mean()) < 0.01
    assert np.abs(off[:, 2]).max() < 0.05


def test_events_of_bounds_that_match_nothing_or_everything(hand):
    camera, balls, shots = hand
    nothing = build(camera, balls, colours={"red": ColourSettings(hue_min=100, hue_max=110, saturation_min=200)})
    (pose,) = step(begin(nothing), shots[0].frame, nothing).state.poses
    assert pose.event == ColourNowhere("red")
    one = build(camera, balls, colours={"blue": ColourSettings(hue_min=100, hue_max=110, saturation_min=200)})
    _, poses = follow([replace_stamp(shot, k) for k, shot in enumerate([*shots, *shots[::-1], *shots])], one)
    assert poses[-1][0].phase == Status.TRACKING  # by red alone
    assert ColourNowhere("blue") in [p.event for (p,) in poses if p.phase == Status.TRACKING]
    half = build(camera, balls, colours={"blue": ColourSettings()})
    (pose,) = step(begin(half), shots[0].frame, half).state.poses
    assert pose.event == ColourEverywhere("blue", 1.0)
    assert pose.event.fraction == 1.0


@pytest.mark.parametrize(("first", "turn", "after"), [(0, (-2.32, 1.28, 0.74), 10.0), (10, (0.0, 0.0, 0.0), 1.0)])
def test_a_missing_colour_is_reported_after_one_or_ten_seconds(hand, first, turn, after):
    """Ten seconds if the estimated pose shows no disc of that colour: the turned pose shows a red one alone."""
    camera, balls, shots = hand
    bounds = {"blue": ColourSettings(hue_min=100, hue_max=110, saturation_min=200)}
    tracker = build(camera, balls, WandSettings(region=False), bounds)
    shot = shots[first]
    begun = begin(tracker, poses={0: (shot.position[0], exp(np.array(turn)) @ shot.rotation[0])})
    settled, _ = follow([replace_stamp(shot, k) for k in range(4)], tracker, begun)
    pose = settled.tracks[0].pose
    assert pose is not None
    state, said = begin(tracker, poses={0: pose[:2]}), []
    for k in range(160 if after > 1.0 else 20):
        state = step(state, replace_stamp(shot, k).frame, tracker).state
        (pose,) = state.poses
        assert pose.phase == Status.TRACKING
        said.append(pose.event == ColourNowhere("blue"))
    assert said.index(True) / 15.0 == pytest.approx(after, abs=0.1)
    assert all(said[said.index(True) :])


def test_less_evidence_than_in_the_frame_before_calls_for_another_pose():
    """A ball that turns by 64° between two frames shows a wrong pose near the prediction with 0.87 of a clear view."""
    camera, balls, shots = film(WandOptions(seed=22, speed=0.07, begin=77.5, seconds=1.3))
    shot, tracker = shots[0], build(camera, balls)
    wrong = exp(np.array([-1.215, 0.264, 0.758])) @ shot.rotation[0]
    state = begin(tracker, 1, shot.frame.stamp - 1.25, {0: (shot.position[0], wrong)})
    for support, angle in ((0.0, 83.0), (0.95, 0.0)):
        before = replace(state, tracks=(replace(state.tracks[0], support=support),))
        (pose,) = step(before, shot.frame, tracker).state.poses
        assert np.degrees(np.linalg.norm(log(pose.rotation @ shot.rotation[0].T))) == pytest.approx(angle, abs=2.0)


def test_two_declared_balls_are_tracked():
    shots, poses = followed(replace(HAND, balls=2, distance=0.9, seconds=0.8))
    assert all(p.phase == Status.TRACKING for p in poses[-1])
    apart = np.linalg.norm(poses[-1][0].position - poses[-1][1].position)
    assert apart == pytest.approx(np.linalg.norm(np.subtract(*shots[-1].position)), abs=0.05)


def test_a_hidden_ball_is_not_confused_with_an_equal_one_that_moves():
    """The other ball moves by more than its radius between two frames, so its last place does not show it."""
    camera, balls, shots = film(replace(HAND, balls=2, distance=0.9, fps=10.0, seconds=1.0, speed=1.0))
    tracker = build(camera, balls)
    moved = np.array([np.linalg.norm((b.position - a.position)[:, :2], axis=1) for a, b in pairwise(shots)])
    last = 3 + int(np.argmax(np.max(moved[3:], axis=1)))  # before the longest shift
    other = int(np.argmax(moved[last]))
    assert moved[last, other] > balls[0].radius
    state, poses = follow(shots[: last + 1], tracker)
    place = [pose.position for pose in poses[-1]]
    order = np.argmin([np.linalg.norm(p - shots[last].position[other]) for p in place])
    image = shots[last + 1].frame.image.copy()
    hidden = shots[last + 1].position[1 - other]
    u = int(camera.fx * hidden[0] / hidden[2] + camera.cx)
    image[:, max(u - 45, 0) : u + 45] = 120
    poses = step(state, replace(shots[last + 1].frame, image=image), tracker).state.poses
    assert [pose.seen for pose in poses] == [k == order for k in range(2)]


def test_event_of_an_undeclared_ball_needs_three_frames():
    """A second ball that disappears after two frames raises none."""
    camera, balls, shots = film(replace(HAND, balls=2, distance=0.9, seconds=0.5))
    tracker = build(camera, balls[:1])
    _, poses = follow(shots, tracker)
    assert any(isinstance(p.event, SecondBall) for (p,) in poses)
    state, first = follow(shots[:2], tracker)
    kept = np.argmin([np.linalg.norm(first[-1][0].position - p) for p in shots[1].position])
    gone = []
    for shot in shots[2:]:
        image = shot.frame.image.copy()
        u = int(camera.fx * shot.position[1 - kept][0] / shot.position[1 - kept][2] + camera.cx)
        image[:, max(u - 45, 0) : u + 45] = 120
        gone.append(replace(shot, frame=replace(shot.frame, image=image)))
    _, later = follow(gone, tracker, state)
    assert not any(isinstance(p.event, SecondBall) for (p,) in first + later)


def wrong(shots, poses):
    """Return the longest run of frames without a right pose, and the last run."""
    longest = run = 0
    for shot, (pose,) in zip(shots, poses, strict=True):
        off = (
            pose.position is None
            or np.linalg.norm((pose.position - shot.position[0])[:2]) > 0.05
            or np.linalg.norm(log(pose.rotation @ shot.rotation[0].T)) > np.deg2rad(45)
        )
        run = run + 1 if off else 0
        longest = max(longest, run)
    return longest, run


def number_of_right_poses(shots, poses):
    """The number of measured poses, all of which are right."""
    seen = [(shot, pose) for shot, pose in zip(shots, poses, strict=True) if pose[0].seen]
    assert wrong(*zip(*seen, strict=True)) == (0, 0)
    return len(seen)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_passing_hand_does_not_attract_the_track(seed):
    """Every measured pose is the ball's (Grzonka 2005, section 4.3). The arm hides the ball for a while with seed 2."""
    shots, poses = followed(replace(HAND, seed=seed, seconds=2.6, hand=1.0))
    assert number_of_right_poses(shots, poses) > 25
    assert poses[-1][0].seen


@pytest.mark.parametrize(
    ("seed", "fingers", "palm", "before"),
    [(5, 1.916, (0.0042, -0.0868, 0.617), 6), (7, 0.786, (-0.0668, 0.0096, 0.6225), 12)],
)
def test_no_wrong_pose_of_a_ball_half_behind_a_hand_is_seen(seed, fingers, palm, before):
    """A slow hand covers half of the ball, then more, and the discs that are left fit other poses."""
    made = prepare_wand(replace(HAND, seed=seed, distance=0.7, seconds=3.0, speed=0.1, rate=90.0))
    hand = Passing(1.5, 0.06 * np.array([np.cos(fingers), np.sin(fingers), 0.0]), np.array(palm), 1.2)
    shots = list(islice(simulate_wand(replace(made, scene=replace(made.scene, hands=(hand,)))), 31))
    _, poses = follow(shots, build(made.scene.camera, (made.scene.balls[0].ball,)))
    assert number_of_right_poses(shots, poses) >= before
    assert poses[-1][0].phase == Status.LOST


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_track_recovers_from_a_card_in_both_colours_within_a_second(seed):
    """With seed 2 it hides the ball, and a mug and books in its colours stay in view."""
    shots, poses = followed(replace(HAND, seed=seed, seconds=2.4, card=1.0))
    longest, last = wrong(shots[3:], poses[3:])
    assert longest <= 5
    assert last == 0
    if seed == 2:
        assert number_of_right_poses(shots, poses) < len(shots)
