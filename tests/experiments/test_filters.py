"""The comparison of the filters: a tiny film."""

import numpy as np
import pytest
from experiments.filters import play, simulated


def test_a_short_film_is_tracked_by_all_and_the_series_are_its_frames():
    result = simulated(45)
    assert set(result["rows"]) == {"ekf1", "ekf2", "ekf1-blobs", "ekf2-blobs", "so3"}
    assert result["rows"]["so3"]["tracked"] == 45
    s = result["series"]["so3"]
    assert len(s["t"]) == len(s["error"]) == len(s["true"]) == 44  # a speed takes two frames
    rms = np.sqrt(np.mean(np.sum(np.array(s["error"]) ** 2, axis=1)))
    assert rms == pytest.approx(result["rows"]["so3"]["surface_speed_rmse_mm_s"]["combined"], rel=0.01)


def test_the_film_like_r1_gives_a_log_that_so3_agrees_with_as_the_truth_does():
    result = play(3.2, 1.0, False)
    assert set(result["rows"]) == {"ekf1", "ekf2", "so3"}
    assert result["rows"]["so3"]["trackball"]["r"] == pytest.approx(result["truth"]["r"], abs=0.01)
    log, mine = np.array(result["log"]["speed"]), np.array(result["series"]["so3"]["speed"])
    assert len(log) == len(mine) == 95
    assert np.corrcoef(log.ravel(), mine.ravel())[0, 1] == pytest.approx(result["truth"]["r"], abs=0.02)
