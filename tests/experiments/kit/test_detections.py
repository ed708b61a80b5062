"""A film looked at once and filtered again: the same as tracking it, and the same errors."""

import numpy as np
import pytest
from experiments.kit import detections
from experiments.kit.film import film_of, options_of, settings_of, tracked
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.simulate.ball.film import prepare


@pytest.fixture(scope="module")
def film():
    return film_of(prepare(options_of({"seconds": 1.4})))


@pytest.fixture(scope="module")
def seen(film):
    return detections.look_at(film, settings_of(["tracker=ekf2"]))


def test_filtering_again_gives_the_run_of_tracking(film, seen):
    settings = settings_of(["tracker=ekf2"])
    whole, again = tracked(film, settings), detections.filtered(seen, settings, film)
    assert_array_equal(again.attitude, whole.run.attitude)
    assert_array_equal(again.rotation, whole.run.rotation)
    assert again.status == whole.run.status
    errors = detections.errors(again, film.truth, film.rig.ball.radius)
    expected = {key: whole.report[key] for key in errors}
    expected["detection"] = {**expected["detection"], "recall_axis": None}  # it takes the camera's true pose
    assert errors == expected
    assert errors["tracked"] > 30


def test_so3_is_refused_since_it_looks_where_it_expects_discs(film, seen):
    with pytest.raises(AssertionError, match="so3"):
        detections.filtered(seen, settings_of(), film)


def test_sigma_is_that_of_all_centres_and_changes_no_centre(seen):
    even = detections.with_sigma(seen, 0.5)
    for new, old in zip(even.detections, seen.detections, strict=True):
        assert_allclose(new.covariance, np.tile(0.25 * np.eye(2), (len(old), 1, 1)))
        assert_array_equal(new.centre, old.centre)
