"""The comparison of the filters: a tiny film."""

import pytest
from experiments.filters import play


def test_the_film_like_r1_gives_a_log_that_so3_agrees_with_as_the_truth_does():
    result = play(3.2, 1.0, False)
    assert set(result["rows"]) == {"ekf1", "ekf2", "so3"}
    assert result["rows"]["so3"]["trackball"]["r"] == pytest.approx(result["truth"]["r"], abs=0.01)
