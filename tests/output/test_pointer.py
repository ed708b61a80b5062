"""The pointer's course: laws for any frames, and what is told apart from steady, wavering and stopping motion."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.output.pointer import PointerSettings, Resampler, due, take

EXACT = PointerSettings(horizon=0.0)
LATENCY = 0.05  # s, from stamp to arrival
NONE = (0.0, 0.0, 0.0)


@dataclass
class Player:
    """Gives frames as they arrive, makes reports at the steady rate, and writes down what was sent and when."""

    settings: PointerSettings
    latency: float = LATENCY

    def __post_init__(self):
        self.resampler, self.sums, self.stamp = Resampler(), (0, 0, 0), 0.0
        self.times, self.sent, self.frame = [], [], []
        self.frames = 0

    def give(self, counts, rate=NONE, interval=1 / 30, tracking=True, listen=None):
        """One frame `interval` after the last, and the reports until the next one would come."""
        self.stamp += interval
        self.frames += 1
        now = self.stamp + self.latency
        known = rate if tracking else None
        self.resampler = take(self.resampler, self.sums, counts, known, self.stamp, now, self.settings)
        end, k = now + (interval if listen is None else listen), 0
        while (t := now + k / self.settings.rate) < end - 1e-9:
            self.report(t)
            k += 1

    def report(self, t):
        self.sums = due(self.resampler, t)
        self.times.append(t)
        self.sent.append(self.sums)
        self.frame.append(self.frames - 1)

    def finish(self):
        """The reports until nothing is due any more."""
        self.report(max(self.resampler.until, self.times[-1]))

    @property
    def lead(self):
        """(3,) counts sent beyond the truth."""
        return np.subtract(self.sums, self.resampler.truth)


def x(counts):
    return (counts, 0, 0)


# ---- laws, for whatever comes ----

numbers = st.integers(-400, 400) | st.integers(-2, 2)
speeds = st.floats(-1e5, 1e5) | st.sampled_from([0.0, np.inf, -np.inf, np.nan])
frames = st.lists(
    st.tuples(
        st.tuples(numbers, numbers, numbers),
        st.tuples(speeds, speeds, speeds),
        st.sampled_from([1 / 30, 1 / 60, 2 / 30, 0.3]),
        st.sampled_from([True, True, True, False]),
    ),
    max_size=25,
)
knobs = st.builds(
    PointerSettings,
    rate=st.sampled_from([125.0, 250.0, 1000.0]),
    horizon=st.sampled_from([0.0, 0.01, 0.05, 0.1, 0.25]),
    smooth=st.floats(0.0, 1.0),
)


def played(given_frames, settings, latency=LATENCY):
    player = Player(settings, latency)
    for counts, rate, interval, tracking in given_frames:
        player.give(counts, rate, interval, tracking)
    return player


@given(frames, st.floats(0.0, 1.0), st.booleans())
def test_with_horizon_0_or_without_tracking_the_sum_is_exact_at_every_report(given_frames, smooth, tracked):
    given_frames = [(counts, rate, interval, tracked) for counts, rate, interval, _ in given_frames]
    player = played(given_frames, replace(EXACT if tracked else PointerSettings(), smooth=smooth))
    truth = np.cumsum([f[0] for f in given_frames], axis=0)
    assert all(np.array_equal(sums, truth[k]) for sums, k in zip(player.sent, player.frame, strict=True))


@given(frames, knobs, st.sampled_from([LATENCY, 0.0, -0.2]))
def test_it_never_runs_against_the_ball(given_frames, settings, latency):
    """On no axis does a report go against the last counts of it that a frame brought, even with stamps ahead."""
    player = played(given_frames, settings, latency)
    before = np.zeros(3)
    way, at = np.zeros(3), -1
    for sums, k in zip(player.sent, player.frame, strict=True):
        if k != at:
            counts = np.array(given_frames[k][0])
            way, at = np.where(counts != 0, np.sign(counts), way), k
        assert np.all((sums - before) * way >= 0)
        before = np.array(sums)


@given(frames, knobs)
def test_the_lead_is_bounded(given_frames, settings):
    """Whatever a filter says: by what twice a frame's mean speed makes of the horizon; and nothing stays unsent but
    what was sent too much before."""
    player = Player(settings)
    most = np.zeros(3)
    for counts, rate, interval, tracking in given_frames:
        player.give(counts, rate, interval, tracking)
        most = np.maximum(most, 2.0 * np.abs(counts) / interval * settings.horizon)
        assert np.all(np.abs(np.subtract(due(player.resampler, np.inf), player.resampler.truth)) <= most + 1e-6)


@given(frames, knobs, st.sampled_from([-1, 1]))
def test_no_loss_and_nothing_twice(given_frames, settings, way):
    """Wherever it stops: once the ball has moved on both ways by more than was overshot, the sum is the truth."""
    player = played(given_frames, settings)
    for sign in (way, -way):
        player.give((0, 0, 0))
        far = 1 + sum(abs(c) for f in given_frames for c in f[0]) * 50
        player.give((sign * far,) * 3)
        player.finish()
    assert np.array_equal(player.lead, [0, 0, 0])


@given(st.lists(st.tuples(st.integers(0, 300), speeds), min_size=1, max_size=20), knobs)
def test_what_was_overshot_is_withheld_from_motion_of_the_same_direction(rolls, settings):
    """After a stop the ball moves on in small steps: nothing is sent until it has caught up, and then all."""
    player = played([(x(n), (rate, 0.0, 0.0), 1 / 30, True) for n, rate in rolls], settings)
    player.give(x(0))
    player.finish()
    over, stood = int(player.lead[0]), player.sums[0]
    assert over >= 0
    for k in range(over + 3):
        player.give(x(1), listen=1e-6)
        player.finish()
        assert player.sums[0] == stood + max(0, k + 1 - over)
    assert player.lead[0] == 0


@given(st.integers(1, 300), st.integers(1, 300))
def test_a_reversal_starts_where_the_pointer_is(there, back):
    """The ball stops short, the pointer has run on, the ball turns round: the pointer moves back by what the ball does,
    and keeps the overshoot for when the ball comes again."""
    player = Player(PointerSettings())
    for _ in range(3):
        player.give(x(there), (30.0 * there, 0.0, 0.0))
    player.give(x(0))
    over, stood = int(player.lead[0]), player.sums[0]
    assert over >= there  # an interval and the latency
    player.give(x(-back))
    player.finish()
    assert player.sums[0] == stood - back
    player.give(x(over + 7))
    player.finish()
    assert player.sums[0] == stood - back + 7
    assert player.lead[0] == 0


# ---- what it is for ----


@pytest.mark.parametrize("speed", [5.0, 47.0, -300.0, 4000.0])
@pytest.mark.parametrize("smooth", [0.0, 0.5, 1.0])
def test_the_pointer_of_a_steady_ball_is_where_the_ball_is(speed, smooth):
    """Not where it was when the frame was taken; every fifth frame is missing. Counts are carried as `motion` does."""
    player = Player(PointerSettings(smooth=smooth, horizon=0.15))
    before, t = 0, 0.0
    for k in range(1, 120):
        if k % 5 == 3:
            continue
        now = k / 30
        place = round(speed * now)
        player.give(x(place - before), (speed, 0.0, 0.0), now - t, listen=(2 if (k + 1) % 5 == 3 else 1) / 30)
        before, t = place, now
    times, sent = np.array(player.times), np.array(player.sent)[:, 0]
    settled = times > 0.6
    slack = 2.0 + abs(speed) * (1.0 / 250.0) + (abs(speed) * (LATENCY + 2 / 30) if abs(speed) < 60.0 else 0.0)
    assert np.abs(sent - speed * times)[settled].max() <= slack  # a slow ball is not predicted in every interval


def wavering(settings):
    """RMS of the second differences of the pointer's place every 4 ms, and its largest distance from the ball, counts.

    The ball swings by 600 counts once a second before a camera of 30 Hz.
    """
    player = Player(settings)

    def place(t):
        return 600.0 * (1.0 - np.cos(2.0 * np.pi * t))

    before = 0
    for k in range(1, 301):
        t = k / 30
        here = round(place(t))
        player.give(x(here - before), (600.0 * 2.0 * np.pi * np.sin(2.0 * np.pi * t), 0.0, 0.0))
        before = here
    times, sent = np.array(player.times), np.array(player.sent)[:, 0]
    clock = np.arange(1.0, times[-1], 0.004)
    shown = sent[np.searchsorted(times, clock + 1e-9) - 1]
    return np.sqrt(np.mean(np.diff(shown, 2) ** 2)), np.abs(shown - place(clock)).max()


def test_a_camera_of_30_hz_gives_a_smooth_pointer():
    plain, late = wavering(EXACT)
    rough, _ = wavering(PointerSettings(smooth=0.0))
    smooth, near = wavering(PointerSettings())
    assert smooth < 0.15 * plain
    assert smooth < 0.5 * rough
    assert near < 0.35 * late


def test_a_motion_begins_with_the_report_of_its_frame():
    player = Player(PointerSettings())
    player.give(x(0))
    player.give(x(30), (900.0, 0.0, 0.0), listen=1e-6)
    assert player.sums[0] > 0


def test_a_ball_that_slows_down_is_carried_on_to_where_it_will_stand():
    player = Player(PointerSettings(smooth=0.0), latency=0.0)
    player.give(x(40), (1000.0, 0.0, 0.0))
    player.give(x(27), (600.0, 0.0, 0.0), listen=0.2)  # 12000 counts/s² slower: it stands after 50 ms
    here = [sums[0] for sums in player.sent]
    assert here == sorted(here)
    assert here[-1] == 67 + 600**2 // (2 * 12_000)


def test_a_rate_from_before_the_ball_was_lost_tells_no_acceleration():
    player = Player(PointerSettings())
    player.give(x(0))
    player.give(x(0), (-20_000.0, 0.0, 0.0), tracking=False)
    player.give(x(30), (900.0, 0.0, 0.0), listen=0.2)
    assert player.sums == x(30 + 90)


def test_after_a_dropped_frame_the_correction_takes_no_longer():
    player = Player(PointerSettings(smooth=0.5))
    for interval in (1 / 30, 1 / 30, 2 / 30):
        player.give(x(0), interval=interval)
    player.give(x(40), interval=2 / 30, listen=1e-6)
    player.give(x(40), interval=1 / 30, listen=1e-6)
    arrival = player.stamp + player.latency
    assert due(player.resampler, arrival + 0.5 / 30 - 0.001) != player.resampler.truth
    assert due(player.resampler, arrival + 0.5 / 30) == player.resampler.truth


def test_it_says_when_nothing_more_is_due():
    """So that whoever reports may sleep."""
    player = Player(PointerSettings())
    player.give(x(0))
    player.give(x(0), (900.0, 0.0, 0.0))
    assert player.resampler.until < player.stamp + player.latency
    player.give(x(30), (900.0, 0.0, 0.0))
    until = player.resampler.until
    assert until == pytest.approx(player.stamp + 0.1)
    assert due(player.resampler, until) == due(player.resampler, until + 10.0) == x(30 + 90)
    assert due(player.resampler, until - 0.005) != x(30 + 90)


def test_stamps_that_stand_or_run_back_predict_nothing():
    player = Player(PointerSettings())
    for interval in (0.03, 0.0, -0.02):
        player.give(x(10), (1000.0, 0.0, 0.0), interval, listen=0.02)
    assert player.sums == player.resampler.truth == x(30)
