"""Disturbances of a whole film (docs/scenarios.py): none makes the pointer jump or leaves counts behind."""

import pytest
from scenarios import SCENARIOS, Scenario, film, measure, run

from spheremouse.ball.settings import Settings

CONTINUOUS = ("play", "flick", "flick 60", "hands", "hands on a flick", "dim", "bump small", "disc moved", "sunk")


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTINUOUS)
def test_a_disturbance_makes_no_jump(name):
    """Four counts are 4 mm of the surface: less than a hand feels, and more than rounding leaves."""
    figures = measure(*run(SCENARIOS[name], Settings(), "known"))
    assert figures["lost_episodes"] == 0
    assert figures["attitude_rms_deg"] < 0.05
    assert figures["jump_counts"] < 4.0
    assert figures["missing_counts"] < 4.0


@pytest.mark.slow
@pytest.mark.parametrize(("azimuth", "seed"), [(0.0, 0), (90.0, 24)])
def test_a_ball_that_sways_in_its_bearings_is_followed(azimuth, seed):
    """By 5 mm: a ball in its place would be off by a third of a degree. The outline shows it from the third frame.

    From the side, it sways along the line of sight. Its discs then look like those of a rig with a wrong radius.
    """
    swaying = Scenario("", film(motion="play", seconds=2.0, sway=5.0, noise=4.0, azimuth=azimuth, seed=seed))
    figures = measure(*run(swaying, Settings(), "known"))
    assert figures["lost_episodes"] == 0
    assert figures["attitude_rms_deg"] < 0.1


@pytest.mark.slow
def test_a_ball_that_sinks_is_followed_by_three_discs():
    """By 10 mm within 0.2 s, before a near camera. So few discs show a shift as a turn, of up to 1.5 degrees."""
    sinking = film(motion="play", view="near", seconds=6.0, lift=4.0, lift_by=(0.0, -10.0, 0.0), noise=4.0, seed=316)
    figures = measure(*run(Scenario("", sinking), Settings(), "known"))
    assert figures["lost_episodes"] == 0
    assert figures["attitude_rms_deg"] < 0.1
