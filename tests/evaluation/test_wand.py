"""The wand's metrics against errors put in by hand, and against covariances that are right by construction."""

from dataclasses import replace

import numpy as np
import pytest
from experiments.kit.balls import contrast_ball
from experiments.wand_films import kept_of
from scipy.stats import chi2

from spheremouse.evaluation.wand import WandRun, alike, assign_truths, errors, found_from, is_lost, off, wand_report
from spheremouse.geometry.rotation import exp
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.wand.ball import WandTruth, grzonka_ball

RADIUS = 0.05
N = 60


@pytest.fixture(scope="module")
def truth():
    return prepare_wand(WandOptions(motion="hand", seconds=4.0)).truth()


def perfect(truth):
    n = len(truth)
    P = np.tile(np.diag([1e-6] * 3 + [1e-4] * 3), (n, 1, 1))
    return WandRun(truth.stamp, truth.position.copy(), truth.rotation.copy(), P, np.full(n, 0.004))


def without(run, frames):
    position = run.position.copy()
    position[frames] = np.nan
    return replace(run, position=position)


def beside(run, frames, by=(0.06, 0.0, 0.0)):
    position = run.position.copy()
    position[frames] += by
    return replace(run, position=position)


def test_a_perfect_run_has_no_error(truth):
    report = wand_report([perfect(truth)], truth, dataset="x", frames=N, radius=RADIUS)
    assert report["tracked"] == len(truth) == N
    assert (report["lost_runs"], report["found_from_frame"], report["runs"]) == (0, 0, 1)
    assert report["position_rmse_mm"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    assert report["rotation_max_deg"] < 1e-6
    assert report["fps"] == pytest.approx(250.0)
    assert report["frame_us"]["median"] == pytest.approx(4000.0)


def test_errors_come_out_in_camera_axes_and_degrees(truth):
    run = beside(perfect(truth), slice(None), (0.001, -0.002, 0.030))
    run = replace(run, rotation=exp(np.radians([0.0, 3.0, 4.0])) @ run.rotation)
    report = wand_report([run], truth, dataset="x", frames=N, radius=RADIUS)
    for key in ("position_rmse_mm", "position_p95_mm", "position_max_mm"):
        assert list(report[key].values()) == pytest.approx([1.0, 2.0, 30.0])
    for key in ("rotation_rmse_deg", "rotation_p95_deg", "rotation_max_deg"):
        assert report[key] == pytest.approx(5.0)


def test_a_percentile_lets_a_twentieth_go(truth):
    run = beside(perfect(truth), [10, 40], (0.0, 0.0, 0.5))  # 2 of 60
    found = errors([run], [truth])
    assert found["position_p95_mm"]["z"] == pytest.approx(0.0, abs=1e-9)
    assert found["position_max_mm"]["z"] == pytest.approx(500.0)
    assert found["position_rmse_mm"]["z"] == pytest.approx(500.0 * np.sqrt(2 / 60))


def test_frames_without_a_pose_count_as_untracked_and_not_as_errors(truth):
    run = without(perfect(truth), slice(0, 3))
    report = wand_report([run], truth, dataset="x", frames=N, radius=RADIUS)
    assert (report["tracked"], report["found_from_frame"], report["lost_runs"]) == (57, 3, 0)
    assert report["position_max_mm"]["x"] == 0.0


def test_anees_is_one_where_errors_are_as_large_as_said_and_four_where_twice_as_large(truth):
    rng = np.random.default_rng(0)
    A = np.diag([1e-3, 2e-3, 2e-2, 0.02, 0.03, 0.01]) @ (np.eye(6) + 0.3 * rng.standard_normal((6, 6)))
    runs = []
    for _ in range(60):
        e = rng.standard_normal((N, 6)) @ A.T
        run = perfect(truth)
        moved = replace(
            run,
            position=run.position + e[:, :3],
            rotation=exp(e[:, 3:]) @ run.rotation,
            covariance=np.tile(A @ A.T, (N, 1, 1)),
        )
        runs.append(moved)
    right = errors(runs, [truth] * 60)["anees"]
    assert list(right.values()) == pytest.approx([1.0, 1.0, 1.0], rel=0.03)
    assert errors(runs, [truth] * 60)["within_95"] == pytest.approx(0.95, abs=0.01)
    half = [replace(run, covariance=run.covariance / 4.0) for run in runs]
    found = errors(half, [truth] * 60)
    assert found["anees"]["pose"] == pytest.approx(4.0, rel=0.03)
    assert found["within_95"] == pytest.approx(chi2.cdf(chi2.ppf(0.95, 6) / 4.0, 6), abs=0.02)


def test_off_is_beside_the_ball_or_on_another_side_of_it_but_not_merely_nearer(truth):
    run = perfect(truth)
    sight = truth.position / np.linalg.norm(truth.position, axis=1, keepdims=True)
    deeper = replace(run, position=run.position + 0.3 * sight)
    assert not off(deeper, truth, RADIUS).any()
    assert off(beside(run, [5]), truth, RADIUS).tolist() == [k == 5 for k in range(N)]
    for angle, wrong in ((44.0, False), (46.0, True), (90.0, True)):
        turned = replace(run, rotation=exp(np.radians([0.0, 0.0, angle])) @ run.rotation)
        assert off(turned, truth, RADIUS).all() == wrong
    assert off(without(run, [7]), truth, RADIUS)[7]


def test_a_run_is_lost_that_is_off_for_longer_than_a_second_or_at_its_end(truth):
    run = perfect(truth)  # 15 Hz
    assert not is_lost(run, truth, RADIUS)
    assert not is_lost(beside(run, slice(20, 34)), truth, RADIUS)  # from frame 19 it was 14/15 s
    assert is_lost(beside(run, slice(20, 37)), truth, RADIUS)
    assert is_lost(without(run, slice(20, 37)), truth, RADIUS)  # no pose is no better
    assert is_lost(beside(run, [N - 1]), truth, RADIUS)
    assert is_lost(without(run, slice(None)), truth, RADIUS)
    assert not is_lost(without(run, slice(0, 30)), truth, RADIUS)  # late, but found
    assert found_from(without(run, slice(0, 30)), truth, RADIUS) == 30
    assert found_from(without(run, slice(None)), truth, RADIUS) is None


def test_at_a_slow_rate_two_frames_are_allowed():
    truth = prepare_wand(WandOptions(seconds=60.0)).truth()  # 0.8 Hz: a second is less than a frame
    run = perfect(truth)
    assert not is_lost(beside(run, [20, 21]), truth, RADIUS)
    assert is_lost(beside(run, [20, 21, 22]), truth, RADIUS)


def test_several_runs_are_counted_and_taken_together(truth):
    good, bad = perfect(truth), beside(perfect(truth), slice(30, None), (0.1, 0.0, 0.0))
    late = without(perfect(truth), slice(0, 4))
    report = wand_report([good, bad, late], truth, dataset="x", frames=N, radius=RADIUS)
    assert (report["runs"], report["lost_runs"], report["found_from_frame"]) == (3, 1, 4)
    assert report["position_max_mm"]["x"] == pytest.approx(100.0)
    assert report["tracked"] == pytest.approx((60 + 60 + 56) / 3)


def test_what_is_not_known_is_null(truth):
    report = wand_report([perfect(truth)], None, dataset="x", frames=N, radius=RADIUS)
    assert report["lost_runs"] is None
    assert report["position_p95_mm"] == {"x": None, "y": None, "z": None}
    assert report["anees"] == {"position": None, "rotation": None, "pose": None}
    nothing = without(perfect(truth), slice(None))
    report = wand_report([nothing], truth, dataset="x", frames=N, radius=RADIUS)
    assert (report["tracked"], report["lost_runs"], report["found_from_frame"]) == (0, 1, None)
    assert report["rotation_rmse_deg"] is None


def test_the_truth_may_go_on_after_the_run(truth):
    run = perfect(WandTruth(truth.stamp[:20], truth.position[:20], truth.rotation[:20]))
    assert not is_lost(run, truth, RADIUS)
    assert errors([run], [truth])["position_max_mm"]["z"] == 0.0


# ---- which ball of the film is it? ----

BALL, OTHER = grzonka_ball(), contrast_ball()


@pytest.fixture(scope="module")
def three():
    film = prepare_wand(WandOptions(motion="hand", seconds=4.0, balls=3))
    return [film.truth(k) for k in range(3)]


def swapped(a, b, frame):
    return replace(
        a,
        position=np.concatenate([a.position[:frame], b.position[frame:]]),
        rotation=np.concatenate([a.rotation[:frame], b.rotation[frame:]]),
    )


def followed_by_number(runs, balls, truths, filmed):
    found = assign_truths(runs, balls, truths, filmed)
    return [None if t is None else next(k for k, true in enumerate(truths) if true is t) for t in found]


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 0, 1), (2, 1, 0)])
def test_alike_balls_are_compared_with_those_they_follow_whatever_their_numbers(three, order):
    runs = [without(perfect(three[k]), slice(0, 10 * k)) for k in order]
    assert followed_by_number(runs, [BALL] * 3, three, [BALL] * 3) == list(order)
    kept = kept_of(runs, [BALL] * 3, three)
    assert [k["lost"] for k in kept] == [False] * 3
    assert all(k["position"] == k["true_position"] for k in kept)


def test_a_few_good_frames_do_not_win_a_truth_from_many_fair_ones(three):
    """A run of three frames exactly on a ball, and one that follows it throughout, a finger's breadth beside it."""
    short = without(perfect(three[0]), slice(3, None))
    whole = beside(perfect(three[0]), slice(None), (0.01, 0.0, 0.0))
    assert followed_by_number([short, whole], [BALL] * 2, three[:2], [BALL] * 2) == [1, 0]
    assert followed_by_number([whole, short], [BALL] * 2, three[:2], [BALL] * 2) == [0, 1]


def test_a_ball_that_was_not_declared_is_nobodys_and_one_too_many_has_no_truth(three):
    assert followed_by_number([perfect(three[2])], [BALL], three, [BALL] * 3) == [2]
    runs = [without(perfect(three[0]), slice(None)), perfect(three[0])]
    assert followed_by_number(runs, [BALL] * 2, three[:1], [BALL]) == [None, 0]
    assert followed_by_number(runs, [BALL] * 2, [], []) == [None, None]
    assert followed_by_number(runs, [BALL] * 2, [], [BALL] * 2) == [None, None]  # no truth.csv


def test_a_run_that_goes_over_to_the_other_ball_half_way_stays_wrong(three):
    """It is lost, or, where it was on the other ball for longer, found late: with large errors either way."""
    for frame, lost, found in ((20, 0, 20), (40, 2, 0)):
        runs = [swapped(perfect(a), perfect(b), frame) for a, b in (three[:2], three[1::-1])]
        truths = assign_truths(runs, [BALL] * 2, three[:2], [BALL] * 2)
        assert [t is three[k] for t, k in zip(truths, (0, 1) if frame == 40 else (1, 0), strict=True)] == [True] * 2
        report = wand_report(runs, [t for t in truths if t is not None], dataset="x", frames=N, radius=RADIUS)
        assert (report["lost_runs"], report["found_from_frame"]) == (lost, found)
        assert report["position_rmse_mm"]["x"] > 100.0


def test_balls_of_another_kind_never_change_places(three):
    runs = [perfect(three[1]), perfect(three[0])]  # each is on the other's ball: both are wrong
    assert followed_by_number(runs, [BALL, OTHER], three[:2], [BALL, OTHER]) == [0, 1]
    assert followed_by_number(runs, [OTHER, BALL], three[:2], [BALL, OTHER]) == [1, 0]
    mine = replace(OTHER, radius=0.048)  # measured by its owner: like none of the film's
    assert followed_by_number(runs, [mine, BALL], three[:2], [BALL, OTHER]) == [1, 0]
    assert followed_by_number(runs, [mine, mine], three[:2], [BALL, OTHER]) == [1, 0]


def test_each_run_has_its_own_truth(three):
    runs = [perfect(three[0]), perfect(three[1])]
    report = wand_report(runs, three[:2], dataset="x", frames=N, radius=RADIUS)
    assert (report["lost_runs"], report["position_max_mm"]["x"]) == (0, 0.0)
    assert wand_report(runs, three[0], dataset="x", frames=N, radius=RADIUS)["lost_runs"] == 1


def test_names_and_order_of_discs_make_no_other_ball():
    assert alike(BALL, replace(BALL, name="mine", discs=BALL.discs[::-1]))
    assert not alike(BALL, replace(BALL, radius=0.051))
    assert not alike(BALL, replace(BALL, body="black"))
    assert not alike(BALL, replace(BALL, discs=BALL.discs[:-1]))
    assert not alike(BALL, replace(BALL, discs=(replace(BALL.discs[0], colour="blue"), *BALL.discs[1:])))
    assert not alike(BALL, replace(BALL, discs=(replace(BALL.discs[0], angle=0.3), *BALL.discs[1:])))
    assert not alike(BALL, OTHER)
