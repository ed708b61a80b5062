"""Losses of a run for the search of settings, and the test that other settings are better.

With truth, a frame's loss is its squared error of attitude and of rate, each over the mean of the run with the present
settings. So both count alike, and the present settings have the loss 2.

Without truth it is the sum of three terms:

- Consistency: ((nis - n) / sqrt(2 n))², with n degrees of freedom. It has the mean 1 if the filter's covariances are
  right (Bar-Shalom, Li and Kirubarajan 2001, section 5.4). A filter that lags has too large innovations, one with too
  much noise too small ones.
- Discs: the fraction of discs missing, over a frame's usual number. A detector that rejects discs has small
  innovations, too, so consistency alone would reward it.
- Smoothness: the squared second difference of the rate, over the mean of the run with the present settings. A filter
  that passes on the noise of the detector has a rough rate; a filter that smooths too much loses in consistency.

A frame that was not tracked has the loss LIMIT, and so has any larger loss: one jump must not decide the search
(winsorising; Tukey 1962). Adjacent frames share errors. So the test compares means over BLOCK_S (batch means; Law and
Kelton 2000, section 9.5.3), which are nearly independent, by Student's paired t-test.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from spheremouse.ball.truth import Truth
from spheremouse.evaluation.metrics import attitude_error, squared_bend
from spheremouse.evaluation.run import Run
from spheremouse.geometry import Array

LIMIT = 100.0  # ten standard deviations
BLOCK_S = 0.5  # longer than the memory of the filter, about ten frames
CONFIDENCE = 0.99  # one-sided: of a hundred recordings with good settings, one is changed
MIN_GAIN = 0.05  # part of the loss; 2.5 % of an RMS error, which no player notices
_MIN_SCALE = 1e-12  # of a scale: a ball at rest in a perfect film
_USUAL_DISCS_QUANTILE = 0.9  # quantile of the discs used that counts as all


class Comparison(NamedTuple):
    """Mean losses of present and other settings on the same frames."""

    present: float
    other: float
    significant: bool

    @property
    def gain(self) -> float:
        """Part of the present loss that the other settings save."""
        return 1.0 - self.other / self.present if self.present > 0.0 else 0.0


def error_terms(run: Run, truth: Truth) -> Array:
    """Return squared errors of attitude and rate, (n, 2) rad² and rad²/s², of each frame; nan if it is not tracked."""
    made, kept = np.full((len(run.frame), 2), np.nan), run.tracked
    if len(kept):
        frames = run.frame[kept]
        made[kept, 0] = np.sum(attitude_error(run.attitude[kept], truth.attitude[frames]) ** 2, axis=1)
        made[kept, 1] = np.sum((run.rate[kept] - truth.rate[frames]) ** 2, axis=1)
    return made


def innovation_terms(run: Run, usual: float) -> Array:
    """Return consistency, missing discs and squared second difference of the rate, (n, 3), of each frame.

    A frame that is not tracked has nan. `usual` is the number of discs that a frame should use.
    """
    made, kept = np.full((len(run.frame), 3), np.nan), run.tracked
    used = np.array([len(points) for points in run.used], dtype=float)
    freedom = np.maximum(2.0 * used, 1.0)
    nis = np.zeros(len(run.frame)) if run.nis is None else run.nis
    made[kept, 0] = np.where(used > 0, (nis - freedom) ** 2 / (2.0 * freedom), 1.0)[kept]
    made[kept, 1] = np.maximum(1.0 - used / max(usual, 1.0), 0.0)[kept]
    made[kept, 2] = squared_bend(run)[kept]
    return made


def usual_discs(run: Run) -> float:
    """Return the number of discs that most tracked frames use at most; 1 if there are none."""
    used = [len(run.used[k]) for k in run.tracked]
    return float(np.quantile(used, _USUAL_DISCS_QUANTILE)) if used else 1.0


def scales(terms: Array) -> Array:
    """Return the mean of each term over the tracked frames; infinite if none is tracked, so only tracking counts."""
    tracked = terms[np.isfinite(terms).all(axis=1)]
    return np.maximum(tracked.mean(axis=0), _MIN_SCALE) if len(tracked) else np.full(terms.shape[1], np.inf)


def losses(terms: Array, scale: Array, missing: int = 0) -> Array:
    """Return the loss of each frame, (n + missing,): the `missing` frames before the first have LIMIT."""
    summed = np.minimum(np.sum(terms / scale, axis=1), LIMIT)
    return np.concatenate([np.full(missing, LIMIT), np.where(np.isnan(summed), LIMIT, summed)])


def compare(present: Array, other: Array, fps: float) -> Comparison:
    """Compare losses of the same frames, (n,) each. Significant: a gain of MIN_GAIN that chance does not explain."""
    size = max(1, round(BLOCK_S * fps))
    blocks = len(present) // size
    found = Comparison(float(np.mean(present)), float(np.mean(other)), significant=False)
    if blocks < 3 or found.gain < MIN_GAIN:
        return found
    saved = (present - other)[: blocks * size].reshape(blocks, size).mean(axis=1)
    error = saved.std(ddof=1) / np.sqrt(blocks)
    least = saved.mean() - stats.t.ppf(CONFIDENCE, blocks - 1) * error
    return found._replace(significant=bool(least > 0.0))
