"""The search comes back from a wrong setting, and leaves good ones alone."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from invoking import fail, succeed

from spheremouse.commands.tune import tune as command
from spheremouse.errors import ConfigurationError
from spheremouse.evaluation.tuning import Comparison
from spheremouse.files import config
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.session.settings import Configuration
from spheremouse.session.tune import Objective, Tuning, changed, tunable, tune
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.options import SimulationOptions
from spheremouse.simulate.to_dataset import write_simulation

pytest.importorskip("optuna")
app = typer.Typer()
app.command()(command)

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"  # 50 frames
LONG = replace(open_dataset(CLIP), frames=120)  # for objectives that read no frame
WRONG = {"discs.contrast": 0.9}  # print has 0.8


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tune") / "film"
    list(write_simulation(folder, prepare(SimulationOptions(motion="play", seconds=4.0, noise=2.0, seed=4))))
    return folder


@pytest.fixture(params=["with truth", "without truth"])
def recording(request, film):
    made = open_dataset(film)
    return made if request.param == "with truth" else replace(made, truth=None)


@pytest.mark.slow
def test_a_wrong_setting_comes_back_to_one_that_tracks(recording):
    found = tune(recording, changed(Configuration(), WRONG), 300.0, trials=3, seed=2)
    assert found.better
    assert found.values["discs.contrast"] < 0.8
    assert found.gains["discs.contrast"] > 0.1
    assert found.held_out.other < 0.5 * found.held_out.present


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [{"discs.polarity": "light"}, {"so3.acceleration_sigma": 50.0}])
def test_the_defaults_are_tried_first(recording, wrong):
    found = tune(recording, changed(Configuration(), wrong), 300.0, trials=1)
    assert found.values == {d["key"]: d["default"] for d in tunable(Configuration()) if d["key"] in wrong}
    assert found.held_out.gain > 0.2


@pytest.mark.slow
def test_a_setting_that_loses_the_ball_is_no_gain_over_none_that_tracks(recording):
    """With bright discs and little contrast the tracker follows glare: 100 degrees of error, and few discs."""
    objective = Objective(recording, changed(Configuration(), {"discs.polarity": "light"}), 0, 60)
    glare = objective.losses({"discs.contrast": 0.018}).mean()
    assert objective.losses({"discs.polarity": "auto"}).mean() < 0.1 * glare


@pytest.mark.slow
def test_good_settings_stay(recording):
    assert not tune(recording, Configuration(), 300.0, trials=3, seed=2).better


@pytest.mark.slow
def test_an_interrupt_ends_the_search_with_what_it_has_and_a_seed_repeats_it(film):
    def interrupt(count, part):
        if count == 2:
            raise KeyboardInterrupt

    settings = changed(Configuration(), WRONG)
    first = tune(open_dataset(film), settings, 300.0, seed=2, progress=interrupt)
    second = tune(open_dataset(film), settings, 300.0, trials=2, seed=2)
    assert (first.trials, first.better) == (2, True)
    assert first == second


class _Timed:
    """An objective on a clock of its own. Each run takes 10 s; `better` is the part of trials that are better."""

    now, better = 0.0, 0.0

    def __init__(self, recording, present, first, end):
        self.run_s, self.seconds, self._n, self._trials = 10.0, 2.0, end - first, 0
        type(self).now += self.run_s
        self.present = np.ones(self._n)

    def losses(self, values, most=math.inf):
        type(self).now += self.run_s
        self._trials += 1
        return np.full(self._n, 1.0 - 0.3 * self.better - 1e-3 * self._trials * self.better)


@pytest.mark.parametrize("better", [0.0, 1.0])
@pytest.mark.parametrize("seconds", [60.0, 180.0, 600.0])
def test_the_budget_holds_within_one_trial(monkeypatch, seconds, better):
    monkeypatch.setattr(_Timed, "now", 0.0)
    monkeypatch.setattr(_Timed, "better", better)
    monkeypatch.setattr("spheremouse.session.tune.Objective", _Timed)
    monkeypatch.setattr("spheremouse.session.tune.time.monotonic", lambda: _Timed.now)
    found = tune(LONG, Configuration(), seconds)
    assert found.better == (better > 0)
    assert seconds - 20.0 <= _Timed.now <= seconds + 10.0  # without a better trial, the test is a run shorter


def test_a_budget_in_which_no_trial_can_be_tested_is_refused(monkeypatch):
    monkeypatch.setattr("spheremouse.session.tune.Objective", _Timed)
    monkeypatch.setattr("spheremouse.session.tune.time.monotonic", lambda: _Timed.now)
    with pytest.raises(ConfigurationError, match="takes 10 s; give at least 200s"):
        tune(LONG, Configuration(), 30.0)


def test_filter_discs_and_loss_are_searched_within_their_bounds():
    settings = Configuration()
    for setting in tunable(settings):
        assert setting["choices"] or setting["minimum"] > 0.0  # the scale is logarithmic
    assert {"so3.acceleration_sigma", "discs.contrast", "loss.lost_after"} <= {d["key"] for d in tunable(settings)}


@pytest.fixture
def searched(tmp_path, monkeypatch):
    """The file of the result of a search that finds `discs.contrast`, or nothing; another one may write it before."""
    out = tmp_path / "tuned.yaml"

    def after(*, better=True, other=""):
        def search(*_):
            if other:
                out.write_text(other)
            values, gains = ({"discs.contrast": 0.3}, {"discs.contrast": 0.4}) if better else ({}, {})
            return Tuning(values, gains, Comparison(1.0, 0.5, significant=True), 1)

        monkeypatch.setattr("spheremouse.session.tune.tune", search)
        return out

    return after


@pytest.mark.parametrize("options", [(), ("--force",)])
def test_the_file_is_the_configuration_with_the_new_settings(searched, options):
    out = searched(other="of another search" if options else "")
    text = succeed(app, CLIP, "--set", "motion.scale_x=2", "--output", out, *options)
    written = config.load(out, Configuration)
    assert (written.motion.scale_x, written.discs.contrast) == (2.0, 0.3)
    assert "discs.contrast=0.3  saves 40 % of the cost" in text


def test_a_file_that_appears_during_the_search_is_replaced_by_force_alone(searched):
    out = searched(other="of another search")
    assert "tuned.yaml: there already" in fail(app, CLIP, "--output", out)
    assert out.read_text() == "of another search"


def test_nothing_is_written_if_no_trial_is_better(searched):
    out = searched(better=False)
    assert "nothing changed: no trial was better" in succeed(app, CLIP, "--output", out)
    assert not out.exists()


@pytest.mark.parametrize("words", [("--budget", "soon"), ("--budget", "0"), ("--set", "tracker=ekf1")])
def test_a_wrong_request_is_one_line(words):
    fail(app, CLIP, *words)


def test_a_recording_that_is_too_short_is_refused():
    with pytest.raises(ConfigurationError, match="too short"):
        tune(open_dataset(CLIP), Configuration(), 1.0)
