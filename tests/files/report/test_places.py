"""Where words may stand: laws of heights that keep apart, and of places around points and along lines."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from spheremouse.files.report.places import along, apart, around

heights = st.lists(st.tuples(st.floats(-100.0, 300.0), st.floats(1.0, 20.0)), min_size=1, max_size=8)


@given(heights)
def test_words_keep_apart_in_their_order_and_within_bounds(ends):
    values, sizes = zip(*sorted(ends), strict=True)
    at = np.array(apart(values, sizes, 0.0, 200.0))  # room for all: 8 words of 20
    half = 0.5 * np.array(sizes)
    assert np.all(np.diff(at) >= half[:-1] + half[1:] - 1e-9)
    assert at[0] - half[0] >= -1e-9
    assert at[-1] + half[-1] <= 200.0 + 1e-9


@given(st.lists(st.floats(50.0, 150.0), min_size=2, max_size=5))
def test_they_are_moved_by_no_more_than_it_takes(values):
    """Against a solver that knows nothing of the order in which words are pooled."""
    values = sorted(values)
    found = apart(values, [10.0] * len(values), -1e3, 1e3)
    limits = [{"type": "ineq", "fun": lambda y, k=k: y[k + 1] - y[k] - 10.0} for k in range(len(values) - 1)]
    start = np.mean(values) + 12.0 * (np.arange(len(values)) - 0.5 * (len(values) - 1))
    best = minimize(lambda y: np.sum((y - values) ** 2), start, constraints=limits, method="SLSQP")
    assert np.sum(np.square(np.subtract(found, values))) <= best.fun + 1e-4


def test_words_that_are_apart_stay_where_they_are():
    assert apart([10.0, 50.0, 90.0], [10.0] * 3, 0.0, 100.0) == [10.0, 50.0, 90.0]


def test_no_place_around_a_point_covers_it():
    for x, y in around(5.0, 7.0, 30.0, 10.0, 4.0):
        beyond = (abs(x - 5.0) - 15.0, abs(y - 7.0) - 5.0)
        assert max(beyond) >= 0.7 * 4.0 - 1e-9


def test_places_along_a_line_begin_at_its_side_and_stay_on_it():
    for left, right in ((0.0, 100.0), (100.0, 0.0)):
        places = list(along(left, right, 50.0, 30.0, 10.0, 2.0))
        assert abs(places[0][0] - left) == 17.0
        assert all(17.0 <= x <= 83.0 and abs(y - 50.0) == 7.0 for x, y in places)
