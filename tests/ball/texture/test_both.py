"""A ball with few discs and a pattern between them: both measure it in one update."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from spheremouse.ball.build import build
from spheremouse.ball.settings import Settings
from spheremouse.geometry.rotation import log
from spheremouse.session.offline import track
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Status

OPTIONS = SimulationOptions(pattern="marble", discs=10, motion="thesis", noise=3.0, size=(320, 240), seed=3)


@cache
def film(seconds):
    simulation = prepare(replace(OPTIONS, seconds=seconds))
    pose = simulation.scene.pose
    return replace(simulation.scene.rig(), pose=pose), list(simulate(simulation))


@cache
def tracked(detector, seconds):
    rig, made = film(seconds)
    tracker = build(rig, rig.pose, Settings(detector=detector))
    return tracker, list(track(iter([m.frame for m in made]), tracker))


def figures(detector):
    """RMS of the attitude's error after the first 2 s, rad, with its offset on the ball removed, and the mean NEES."""
    _, made = film(4.0)
    epochs = tracked(detector, 4.0)[1]
    which = [k for k, e in enumerate(epochs) if e.estimate.status is Status.TRACKING]
    assert which == list(range(which[0], len(epochs)))
    R = np.array([e.estimate.rotation for e in epochs])
    offset = R[60].T @ made[60].attitude
    late = [log(R[k] @ offset @ made[k].attitude.T) for k in range(60, len(epochs))]
    first = R[which[0]] @ made[which[0]].attitude.T
    nees = []
    for k in which[1:]:
        error = log(R[k] @ made[k].attitude.T @ first.T)
        nees.append(error @ np.linalg.solve(epochs[k].estimate.covariance[:3, :3], error))
    return np.sqrt(np.mean(np.sum(np.square(late), axis=1))), np.mean(nees)


@pytest.mark.slow
def test_the_pattern_halves_the_error_of_few_discs_and_tells_it():
    (alone, _), (both, nees) = figures("default"), figures("both")
    assert both < 0.5 * alone
    assert nees < 6.0


def test_a_saved_map_is_that_of_the_discs_alone():
    """No anchor of the pattern is on it. A spot of the marble that passes for a disc may be on one map alone."""
    maps, frames = [], []
    for detector in ("default", "both"):
        tracker, epochs = tracked(detector, 3.0)
        maps.append(tracker.method.to_map(epochs[-1].state))
        frames.append(epochs[-1].estimate.rotation)
    alone, both = maps
    assert len(both) < len(epochs[-1].state.filter.discs)
    nearest = np.max(both.directions @ (frames[1].T @ frames[0]) @ alone.directions.T, axis=1)
    assert np.count_nonzero(nearest < np.cos(0.02)) <= 1
    assert 2 * len(both) > len(alone)
    assert both.covariance.shape == (2 * len(both), 2 * len(both))


def test_the_published_filters_take_discs_alone():
    with pytest.raises(ValueError, match="both needs the tracker so3"):
        Settings(detector="both", tracker="ekf2")
