"""What stands still while the ball turns is masked, what turns along is proven, and doubt masks nothing."""

import numpy as np
import pytest
from ball_world import DT, POSE, RIG, pixels

from spheremouse.ball.detect.lookalikes import (
    MOVED_PX,
    StaticDistractors,
    classify_candidates,
    mask,
    unmasked,
)
from spheremouse.ball.points import directions_at
from spheremouse.geometry.rotation import exp

FORGOTTEN_AFTER_S, MASK_LIFE_S = 1.0, 600.0
AXIS_Z = np.array([0.0, 0.0, 1.0])  # towards the camera


def unit(*rows):
    d = np.array(rows, dtype=float)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


DISCS = unit([0.5, 0.1, 1.0], [-0.4, 0.4, 1.0], [0.1, -0.6, 1.0], [-0.5, -0.3, 1.0])
BOLT = np.array([[400.0, 300.0]])


def look(state, uv, attitude, stamp):
    """One frame: drop what is masked, judge the rest. Verdicts are of all of `uv`."""
    free, state = unmasked(state, uv, stamp)
    d, index = directions_at(uv[free], RIG, POSE)
    assert len(index) == np.count_nonzero(free)
    p, s, _, state = classify_candidates(state, uv[free], d, attitude, stamp, RIG, POSE)
    proven, still = np.zeros(len(uv), dtype=bool), np.zeros(len(uv), dtype=bool)
    proven[free], still[free] = p, s
    return proven, still, free, state


def film(attitudes, *, extra=BOLT, discs=DISCS, noise=0.05, believed=None, state=None):
    """Verdicts frame by frame on discs (first) and `extra` pixels; `believed` is what the filter takes for truth."""
    rng = np.random.default_rng(0)
    state = state or StaticDistractors()
    out = []
    for k, R in enumerate(attitudes):
        uv = np.concatenate([pixels(discs @ R.T), extra])
        uv = uv + noise * rng.normal(size=uv.shape)
        *verdict, state = look(state, uv, R if believed is None else believed[k], k * DT)
        out.append((*verdict, state))
    return out


def turn(axis, rate, n):
    return [exp(np.asarray(axis) * rate * k * DT) for k in range(n)]


def test_a_bolt_is_masked_as_soon_as_the_ball_has_turned_by_two_pixels_there():
    """Not before: the path of the ball's surface under the bolt says when."""
    rate = 0.2
    attitudes = turn([0.0, 1.0, 0.0], rate, 40)
    out = film(attitudes)
    first = next(k for k, (_, still, _, _) in enumerate(out) if still[-1])
    d = directions_at(BOLT, RIG, POSE)[0]
    path = [np.linalg.norm(pixels(d @ R.T) - BOLT) for R in attitudes]
    crossing = next(k for k, p in enumerate(path) if p > MOVED_PX)
    assert crossing <= first <= crossing + 1
    assert not any(still[:-1].any() for _, still, _, _ in out)  # no disc, ever
    proven, _, free, state = out[-1]
    assert np.all(proven[:-1])
    assert not free[-1]
    assert len(state.masks) == 1
    assert np.linalg.norm(state.masks[0] - BOLT) < 0.3


def test_a_disc_at_the_pole_of_the_rotation_is_no_look_alike():
    """It stands still because the ball moves nowhere there; nor is it proven by that."""
    discs = np.vstack([DISCS, AXIS_Z])
    out = film(turn(AXIS_Z, 0.5, 90), discs=discs)
    pole = len(DISCS)
    assert not any(still[pole] or proven[pole] for proven, still, _, _ in out)
    assert any(still[-1] for _, still, _, _ in out)  # the bolt, though


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("rate", [0.05, 0.5, 3.0])
def test_noise_and_pace_change_no_verdict(noise, rate):
    n = 8 if rate > 1 else 50 if rate < 0.1 else 36
    out = film(turn([0.3, 1.0, 0.2], rate, n), noise=noise)
    assert not any(still[:-1].any() for _, still, _, _ in out)
    if rate > 0.1:
        assert not out[-1][2][-1]  # masked


def test_candidates_that_cannot_be_seen_again_are_forgotten():
    state = film(turn([0.0, 1.0, 0.0], 0.1, 3))[-1][3]
    assert len(state.candidates.place) == len(DISCS) + 1
    nothing = np.zeros((0, 2))
    *_, state = look(state, nothing, np.eye(3), 0.1)
    assert len(state.candidates.place) == len(DISCS) + 1
    *_, state = look(state, nothing, np.eye(3), FORGOTTEN_AFTER_S + 0.2)
    assert len(state.candidates.place) == 0


def test_a_mask_lives_as_long_as_it_is_needed():
    place = np.array([[100.0, 100.0]])
    elsewhere = np.array([[300.0, 100.0]])
    life = MASK_LIFE_S
    state = mask(StaticDistractors(), place, 0.0)
    _, state = unmasked(state, place, 0.9 * life)  # renewed
    _, state = unmasked(state, elsewhere, 1.8 * life)
    assert len(state.masks) == 1
    _, state = unmasked(state, elsewhere, 2.0 * life)
    assert len(state.masks) == 0
    free, _ = unmasked(state, place, 2.0 * life)
    assert free.all()
