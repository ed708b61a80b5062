"""A ball in its frame at work: what status and log show of it, and what is sent."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.geometry.rotation import Array
from spheremouse.output.counts import MotionSettings
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.film import prepare, simulate
from spheremouse.simulate.ball.options import SimulationOptions

HAND = 2.0  # rad/s, a hand in ordinary play


@dataclass
class Seen:
    reasons: list[str]
    news: list[tuple[float, str]]
    counts: Array  # (n, 3) of each frame
    integral: Array  # (3,) counts, of the motion
    fastest: float  # rad/s
    confirmed: list[bool]
    stamps: list[float]


def watched(options, covered=(0.0, 0.0), level=170, disc=1.0):
    """A film tracked; the ball is painted over from one time to the other, and the rig's discs are so much larger."""
    film = prepare(options)
    rig = replace(film.scene.rig(), pose=film.scene.pose)
    rig = replace(rig, disc_radius=disc * rig.disc_radius)
    settings = Configuration(discs=DiscSettings(polarity="dark"))
    adapter = BallAdapter((rig,), settings, None, lambda _: None)
    matrix = MotionSettings().matrix(rig.radius_m)
    ball = ball_mask(rig, film.scene.pose) > 0
    seen = Seen([], [], np.zeros((0, 3)), np.zeros(3), 0.0, [], [])
    for filmed in simulate(film):
        image, stamp = filmed.frame.image.copy(), filmed.frame.stamp
        if covered[0] <= stamp < covered[1]:
            image[ball] = level
        made = adapter.follow(replace(filmed.frame, image=image))
        assert made is not None
        seen.reasons.append(adapter.reason)
        seen.confirmed.append(made.samples[0].estimate.confirmed)
        seen.stamps.append(stamp)
        counts, _ = adapter.mapping.counts(made.samples[0].estimate)
        seen.counts = np.concatenate([seen.counts, [counts]])
        seen.integral = seen.integral + matrix @ made.samples[0].estimate.increment[:3]
        seen.fastest = max(seen.fastest, float(np.linalg.norm(filmed.rate)))
        if line := adapter.take_messages().change:
            seen.news.append((stamp, line))
    return seen, rig


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"covered": (0.0, 2.45), "level": 3}, "it is nearly black (3 of 255); uncover the lens, light the ball"),
        ({"covered": (0.0, 2.45)}, "nothing on it stands out; uncover the ball"),
        ({"disc": 1.8}, "correct disc_radius in the rig"),
    ],
)
def test_a_ball_without_discs_states_why_within_two_seconds_until_they_are_seen_and_the_log_has_it_once(change, told):
    seen, _ = watched(SimulationOptions(seed=5, motion="rest", noise=2.0, seconds=2.9, fps=10.0), **change)
    for stamp, reason in zip(seen.stamps, seen.reasons, strict=True):
        if stamp - seen.stamps[0] >= 2.0 and stamp < 2.45:
            assert reason.startswith("no disc found on the ball for ")
            assert told in reason
    assert (told in seen.reasons[-1]) is ("covered" not in change)
    lines = [line for _, line in seen.news if "on the ball for" in line]
    assert len(lines) == 1
    assert told in lines[0]


def sent_at_a_hands_pace(seen, rig):
    """Nothing is lost, and no report is more than the ball and a hand together turn in an interval."""
    per_radian = MotionSettings().scale(rig.radius_m)
    most = per_radian * (seen.fastest + HAND) * float(np.diff(seen.stamps).max())
    assert np.linalg.norm(seen.counts, axis=1).max() <= most + np.sqrt(3.0)
    np.testing.assert_allclose(seen.counts.sum(axis=0), seen.integral, atol=1.0)


def test_status_and_log_show_that_motion_is_withheld_and_for_how_long():
    seen, rig = watched(SimulationOptions(discs=26, seed=3, motion="play", seconds=3.0), covered=(1.59, 1.79))
    told = [reason for reason in seen.reasons if reason.startswith("motion withheld")]
    assert 3 <= len(told) <= 4  # of six frames, from a tenth of a second on
    assert {told[0], told[-1]} == {f"motion withheld for 0.{t} s: no disc in view" for t in (1, 2)}
    assert seen.reasons[-1] == seen.reasons[int(30 * 1.5)]  # what was known of the ball before
    lines = [(t, line) for t, line in seen.news if t > 1.5]
    assert [line for _, line in lines] == ["motion withheld: no disc in view", lines[1][1]]
    assert lines[1][1].startswith("motion goes on: the ")
    assert lines[0][0] == pytest.approx(1.567 + 0.1, abs=0.04)
    assert lines[1][0] == pytest.approx(1.8, abs=0.02)
    sent_at_a_hands_pace(seen, rig)


def test_one_disc_in_view_of_a_ball_with_twelve_sends_no_jump():
    """A film in which a push turns all discs but one out of view: 369 counts came in one report, without a word."""
    seen, rig = watched(SimulationOptions(discs=12, seed=114, motion="play", seconds=7.0, noise=2.0))
    sent_at_a_hands_pace(seen, rig)
    since = seen.stamps[0]
    for stamp, confirmed, reason in zip(seen.stamps, seen.confirmed, seen.reasons, strict=True):
        since = stamp if confirmed else since
        assert reason.startswith("motion withheld") == (stamp - since > 0.1), stamp


@pytest.mark.slow
def test_a_ball_that_sinks_states_its_cause_and_by_how_much():
    film = prepare(
        SimulationOptions(motion="play", seconds=3.0, lift=1.5, lift_by=(0.0, -10.0, 0.0), lift_seconds=9.0, seed=1)
    )
    adapter = BallAdapter((replace(film.scene.rig(), pose=film.scene.pose),), Configuration(), None, lambda _: None)
    lines = []
    for filmed in simulate(film):
        adapter.follow(filmed.frame)
        lines.append(adapter.take_messages().change or "")
    assert "its bearings are worn" in " ".join(lines)
    assert adapter.tracker_status(True).centre_shift_mm == pytest.approx(10.0, abs=2.0)
