"""A film looked at once and filtered again: the same as tracking it, and the same errors."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.experiments import sights
from spheremouse.experiments.kit import made, options_of, settings_of, tracked
from spheremouse.simulate import prepare


@pytest.fixture(scope="module")
def film():
    return made(prepare(options_of({"seconds": 1.4})))


@pytest.fixture(scope="module")
def seen(film):
    return sights.look_at(film, settings_of(["tracker=ekf2"]))


def test_filtering_again_gives_the_run_of_tracking(film, seen):
    settings = settings_of(["tracker=ekf2"])
    whole, again = tracked(film, settings), sights.filtered(seen, settings, film)
    assert_array_equal(again.attitude, whole.run.attitude)
    assert_array_equal(again.rotation, whole.run.rotation)
    assert again.phase == whole.run.phase
    errors = sights.errors(again, film.truth, film.rig.ball.radius)
    assert errors == {key: whole.report[key] for key in errors}
    assert errors["tracked"] > 30


def test_so3_is_refused_since_it_looks_where_it_expects_discs(film, seen):
    with pytest.raises(AssertionError, match="so3"):
        sights.filtered(seen, settings_of(), film)


def test_sigma_is_that_of_all_centres_and_changes_no_centre(seen):
    even = sights.with_sigma(seen, 0.5)
    for new, old in zip(even.detections, seen.detections, strict=True):
        assert_allclose(new.covariance, np.tile(0.25 * np.eye(2), (len(old), 1, 1)))
        assert_array_equal(new.centre, old.centre)


def test_the_bound_is_that_of_the_report_and_grows_with_the_noise(film):
    report = tracked(film, settings_of(["tracker=ekf2"])).report
    limit = sights.bound_rms(sights.bound(film, report["detection"]["centre_rms_px"]))
    attitude = report["attitude_rmse_deg"]["combined"] * np.sqrt(len(film.frames) / (len(film.frames) - 1))
    assert report["tracked"] == len(film.frames)
    assert limit["attitude_deg"]["combined"] == pytest.approx(attitude / report["bound_ratio"]["attitude"], rel=1e-6)
    assert limit["rate_deg_s"]["combined"] ** 2 == pytest.approx(sum(limit["rate_deg_s"][a] ** 2 for a in "xyz"))
    worse = sights.bound_rms(sights.bound(film, 1.0))
    assert worse["rate_deg_s"]["combined"] > limit["rate_deg_s"]["combined"]
    assert sights.bound_rms(None) == {"attitude_deg": None, "rate_deg_s": None}
