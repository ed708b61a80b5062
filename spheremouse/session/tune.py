"""Search settings of the tracker for which a recording is tracked better, by the losses of `evaluation.tuning`.

The first half of the recording serves the search. The second half, which the search never sees, decides whether the
result is better than the present settings. One candidate is tested once, so no correction for many tests is needed.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from spheremouse.ball.build import build, detector_of
from spheremouse.errors import ConfigurationError, PoseError
from spheremouse.evaluation import tuning
from spheremouse.evaluation.run import History, Run
from spheremouse.files import config
from spheremouse.files.dataset.ball import Recording
from spheremouse.geometry import Array
from spheremouse.session.evaluate import numbered_frames
from spheremouse.session.offline import initialise, track
from spheremouse.session.settings import Configuration
from spheremouse.tracker import Status

Values = dict[str, Any]  # settings by dotted key

_GROUPS = ("so3", "discs", "loss")
_KINDS = ("number", "integer", "choice")
_MIN_SECONDS = 4.0  # of a recording: each half needs three blocks and the start of the tracker
_MIN_SAVED_FRACTION = 0.01  # part of the loss; a setting that saves less goes back to its present value
_MAX_LOSS_RATIO = 3.0  # times the least loss: a trial that must exceed it ends early
_TEST_RUNS = 2  # of the second half: with the present settings and with the best ones
_MIN_RUNS = 20  # for which a search is advised
_RANDOM_TRIALS = 8  # random trials before the sampler models the loss


@dataclass(frozen=True, slots=True)
class Tuning:
    """Result of a search."""

    values: Values  # settings that differ from the present ones; empty if nothing better was found
    gains: dict[str, float]  # part of the loss in the searched half that each of them saves
    held_out: tuning.Comparison
    trials: int

    @property
    def better(self) -> bool:
        """True if the settings are better on the half of the recording that the search did not see."""
        return bool(self.values) and self.held_out.significant


class Objective:
    """Losses of settings on the frames from `first` to before `end` of a recording."""

    def __init__(self, recording: Recording, present: Configuration, first: int, end: int) -> None:
        """Track with the `present` settings. Their run gives the scales of the terms, and the camera's pose.

        If they track no frame, a run with the defaults gives the scales. Else each run that tracks would count alike.
        """
        self._recording, self._present, self._span, self._rig = recording, present, (first, end), recording.rig
        self._usual, self._scale = 1.0, np.ones(3)
        self.run_s = 0.0  # s, of the slowest run so far
        run = own = self._run({})
        if run is None or not len(run.tracked):
            run = self._run(_defaults(present))
        if run is None:
            self._scale = np.full(2 if recording.truth is not None else 3, np.inf)
        else:
            self._usual = tuning.usual_discs(run)
            self._scale = tuning.scales(self._terms(run))
            if recording.truth is None:
                self._scale[:2][np.isfinite(self._scale[:2])] = 1.0  # these terms have a scale of their own
        self.present = self._losses(own)  # losses of the present settings, (n,)

    @property
    def seconds(self) -> float:
        """Duration of the frames, s. A setting in s has no effect above it."""
        return (self._span[1] - self._span[0]) / self._recording.fps

    def losses(self, values: Values, most: float = math.inf) -> Array:
        """Return the loss of each frame, (n,), with some settings changed; LIMIT for all if its mean exceeds `most`."""
        first, end = self._span
        return self._losses(self._run(values, most * (end - first) / tuning.LIMIT))

    def _losses(self, run: Run | None) -> Array:
        first, end = self._span
        if run is None:
            return np.full(end - first, tuning.LIMIT)
        return tuning.losses(self._terms(run), self._scale, missing=end - first - len(run.frame))

    def _terms(self, run: Run) -> Array:
        truth = self._recording.truth
        return tuning.innovation_terms(run, self._usual) if truth is None else tuning.error_terms(run, truth)

    def _run(self, values: Values, most_untracked: float = math.inf) -> Run | None:
        """Return the run; None if the camera's pose is not found, or if more frames are not tracked."""
        settings, history, begun = changed(self._present, values), History(), time.monotonic()
        try:
            start = initialise(islice(numbered_frames(self._recording), *self._span), self._rig, settings)
            self._rig = replace(self._rig, pose=start.pose)  # no searched setting changes it
            untracked = 0
            for epoch in track(start.frames, build(self._rig, start.pose, settings)):
                history.add(epoch)
                untracked += epoch.state.status is not Status.TRACKING
                if untracked > most_untracked:
                    return None
        except PoseError:
            return None
        finally:
            self.run_s = max(self.run_s, time.monotonic() - begun)
        return history.run() if history.epochs else None


def changed(settings: Configuration, values: Values) -> Configuration:
    """Return the settings with other values by dotted key. Raises ConfigurationError for an invalid value."""
    for assignment in config.assignments(values):
        settings = config.override(settings, assignment, label="")
    return settings


def _defaults(settings: Configuration) -> Values:
    """Return the defaults of the searched settings that differ from them."""
    return {d["key"]: d["default"] for d in tunable(settings) if d["value"] != d["default"]}


def tunable(settings: Configuration) -> list[dict[str, Any]]:
    """Return the described settings that are searched: numbers and choices of filter, discs and loss."""
    return [d for d in config.describe(settings) if d["group"] in _GROUPS and d["type"] in _KINDS]


def tune(
    recording: Recording,
    settings: Configuration,
    seconds: float,
    trials: int | None = None,
    seed: int = 1,
    progress: Callable[[int, float], None] = lambda *_: None,
) -> Tuning:
    """Search at most `trials` times, and test the result on the second half of the recording, within `seconds`.

    The search ends when the rest of the time is needed for two runs of the test, and one for each setting of the best
    trial, which shows its gain. Settings for which no time is left stay, and have no gain. `progress` gets the number
    of trials and the least loss over that of the present settings. An interrupt (KeyboardInterrupt) ends the search,
    and the best trial so far is tested. The same seed and number of trials give the same result if the time suffices.
    Raises ConfigurationError without Optuna, for another tracker, for a recording that is too short, and if the time
    does not suffice for one trial.
    """
    end = time.monotonic() + seconds
    detector = detector_of(recording.rig, settings)
    if not detector.sees_discs:
        raise ConfigurationError(
            f"{recording.path}: tune searches settings of discs, and this ball is followed by its "
            f"{detector.words.subject}",
            "give a recording of a ball with discs, or leave the settings at their defaults",
        )
    if settings.tracker != "so3" or settings.detector != "default":
        raise ConfigurationError("tune: searches settings of the default tracker", "use tracker=so3, detector=default")
    if recording.frames < _MIN_SECONDS * recording.fps:
        raise ConfigurationError(f"{recording.path}: is too short", f"give a recording of {_MIN_SECONDS:g} s or more")
    middle = recording.frames // 2
    objective = Objective(recording, settings, 0, middle)

    def fits(runs: int) -> bool:
        return time.monotonic() + runs * objective.run_s <= end

    if not fits(1 + _TEST_RUNS):
        problem = f"--budget: {seconds:.0f} s are too short, since half of this recording takes {objective.run_s:.0f} s"
        raise ConfigurationError(problem, f"give at least {_MIN_RUNS * objective.run_s:.0f}s")
    present = float(objective.present.mean())
    best: Values = {}
    least, count = present, 0
    try:
        for values, loss in _search(objective, settings, trials, seed):
            count += 1
            if loss < least:
                best, least = values, loss
            progress(count, least / present)
            if not fits(1 + len(best) + _TEST_RUNS):
                break
    except KeyboardInterrupt:
        pass
    best, gains = _prune(objective, best, least, fits)
    held_out = Objective(recording, settings, middle, recording.frames)
    other = held_out.losses(best) if best else held_out.present
    return Tuning(best, gains, tuning.compare(held_out.present, other, recording.fps), count)


def _search(
    objective: Objective, settings: Configuration, trials: int | None, seed: int
) -> Iterator[tuple[Values, float]]:
    """Yield the settings and the loss of each trial (tree-structured Parzen estimator; Bergstra et al. 2011).

    The first trial has the defaults, unless the present settings are the defaults.
    """
    try:
        import optuna
    except ImportError:
        raise ConfigurationError("tune: needs the package optuna", "pip install 'spheremouse[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed, n_startup_trials=_RANDOM_TRIALS))
    duration = objective.seconds
    described, least = tunable(settings), float(objective.present.mean())
    count, defaults = 0, _defaults(settings)
    if defaults:
        loss = float(objective.losses(defaults).mean())
        least, count = min(least, loss), 1
        yield defaults, loss
    while trials is None or count < trials:
        trial = study.ask()
        values = {d["key"]: _suggest(trial, d, duration) for d in described}
        values = {d["key"]: values[d["key"]] for d in described if values[d["key"]] != d["value"]}
        loss = float(objective.losses(values, _MAX_LOSS_RATIO * least).mean())
        least = min(least, loss)
        study.tell(trial, loss)
        count += 1
        yield values, loss


def _suggest(trial: Any, setting: dict[str, Any], duration: float) -> Any:
    """Return a value within the bounds of a setting; numbers on a logarithmic scale, rounded to two digits."""
    key, least, most = setting["key"], setting["minimum"], setting["maximum"]
    if setting["type"] == "choice":
        return trial.suggest_categorical(key, setting["choices"])
    if setting["unit"] == "s":
        most = min(most, duration)
    if setting["type"] == "integer":
        return trial.suggest_int(key, least, most, log=True)
    value = float(f"{trial.suggest_float(key, least, most, log=True):.2g}")
    return min(max(value, least), most)


def _prune(
    objective: Objective, best: Values, loss: float, fits: Callable[[int], bool]
) -> tuple[Values, dict[str, float]]:
    """Return the settings that matter, and the part of the loss that each saves. Others go back.

    `loss` is that of the best settings. `fits` returns whether the time suffices for a number of runs. Settings for
    which it does not stay, and have no gain.
    """
    gains: dict[str, float] = {}
    for key in list(best):
        if not fits(1 + _TEST_RUNS):
            break
        remaining = {k: v for k, v in best.items() if k != key}
        lost = float((objective.losses(remaining) if remaining else objective.present).mean())
        gain = 1.0 - loss / lost if lost > 0.0 else 0.0
        if gain < _MIN_SAVED_FRACTION:
            best, loss = remaining, lost
        else:
            gains[key] = gain
    return best, gains
