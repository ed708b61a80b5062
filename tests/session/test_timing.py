"""Times of frames."""

import math

import pytest

from spheremouse.session.timing import Arrivals


def test_the_time_left_is_that_until_the_next_frame_of_a_steady_camera():
    arrivals = Arrivals()
    assert math.isnan(arrivals.time_left(0.0))
    for k in range(60):
        arrivals.add(k / 50.0)
    assert arrivals.time_left(59 / 50.0 + 0.005) == pytest.approx(0.015)
    assert arrivals.time_left(59 / 50.0 + 0.030) == pytest.approx(-0.010)
