"""What jobs are made of: the bound beside a run is that of its report."""

import pytest
from experiments.kit.film import bound, bound_rms, film_of, options_of, settings_of, tracked

from spheremouse.simulate.ball.film import prepare


def test_the_bound_of_a_run_is_that_of_its_report_and_noisier_pictures_have_a_higher_one():
    limits = []
    for noise in (1.0, 12.0):
        film = film_of(prepare(options_of({"discs": 40, "seconds": 1.0, "noise": noise})))
        run = tracked(film, settings_of())
        limit = bound(film, run)
        n = run.report["tracked"]
        assert n > 25
        error = run.report["attitude_rmse_deg"]["combined"] * (n / (n - 1)) ** 0.5  # the first has none
        assert limit["attitude_deg"]["combined"] == pytest.approx(error / run.report["bound_ratio"]["attitude"])
        assert limit["rate_deg_s"]["combined"] ** 2 == pytest.approx(sum(limit["rate_deg_s"][a] ** 2 for a in "xyz"))
        limits.append(limit["rate_deg_s"]["combined"])
    assert limits[1] > 1.3 * limits[0]
    assert bound_rms(None) is None
