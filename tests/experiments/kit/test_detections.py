"""A film looked at once and filtered again: the same as tracking it, and the same errors."""

import pytest
from experiments.kit import detections
from experiments.kit.film import film_of, options_of, settings_of, tracked
from numpy.testing import assert_array_equal

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
