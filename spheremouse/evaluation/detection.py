"""Compare the discs that a run detected with the true ones."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.truth import HIDDEN, VISIBLE, DiscTruth
from spheremouse.evaluation.bound import MATCH
from spheremouse.evaluation.run import Run, number
from spheremouse.geometry.matching import assign, distances
from spheremouse.geometry.rotation import Array

MIN_AREA = 12.0  # px², smaller discs are not asked for: 3.9 px across
MIN_AXIS = 1.25  # px, semi-minor axis: below that both rims of a disc are one blur, however large the picture


def mean_discs(run: Run) -> float | None:
    """Return the number of discs in the filter's update, the mean over the tracked frames; None without such frames.

    It is comparable with the mean number of stored markers of Wittich 2017, tables 20 and 23. That filter forgets discs
    that it does not see, so it stores those used and those new (5.2 and 0.1 on `far26`). The size of a lasting map
    would not be comparable.
    """
    kept = run.tracked
    return float(np.mean([len(run.used[i]) for i in kept])) if len(kept) else None


def detection_quality(run: Run, truth: DiscTruth, semi_minor: Array | None = None) -> dict[str, float | None]:
    """Compare detections with the true discs, over all frames that the tracker was given.

    - recall: fraction of the wholly visible discs of at least MIN_AREA px² with a detection within MATCH px of the true
      centre. Each detection counts for one disc.
    - false_share: fraction of the points used by the filter that are farther than MATCH px from every disc in view.
    - centre_rms_px: RMS error of the centre per axis, over the discs found.
    - recall_15 and centre_rms_60_px: the same for discs of at least 15 and 60 px².
    - recall_axis: recall of discs with a `semi_minor` axis, (k,) px for the rows of `truth`, of at least MIN_AXIS.
      These are the same discs at any size of the picture. None without `semi_minor`.

    A value without discs or points is None.
    """
    whole = truth.state == VISIBLE
    relevant = whole & (truth.area >= MIN_AREA)
    given = np.isin(truth.frame, run.frame)
    found, offset = _detected_rows(run, truth, relevant)
    large = offset[truth.area[found] >= 60.0]
    points = false = 0
    for frame, used in zip(run.frame, run.used, strict=True):
        centre = truth.centre[(truth.frame == frame) & (truth.state != HIDDEN)]
        points += len(used)
        false += int(np.count_nonzero(~(distances(used, centre).min(axis=1, initial=np.inf) <= MATCH)))
    long = np.zeros_like(whole) if semi_minor is None else whole & (semi_minor >= MIN_AXIS)
    return {
        "recall": _ratio(len(found), np.count_nonzero(relevant & given)),
        "false_share": _ratio(false, points),
        "centre_rms_px": number(np.sqrt(np.mean(offset**2))) if len(offset) else None,
        "recall_15": _ratio(
            np.count_nonzero(truth.area[found] >= 15.0), np.count_nonzero(relevant & given & (truth.area >= 15.0))
        ),
        "recall_axis": _ratio(len(_detected_rows(run, truth, long)[0]), np.count_nonzero(long & given)),
        "centre_rms_60_px": number(np.sqrt(np.mean(large**2))) if len(large) else None,
    }


def _detected_rows(run: Run, truth: DiscTruth, relevant: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Array]:
    """Return the rows of `truth` among the `relevant` ones, (k,), with a detection, (n,), and its offset, (n, 2) px."""
    rows, offsets = [np.zeros(0, dtype=np.intp)], [np.zeros((0, 2))]
    for frame, detected in zip(run.frame, run.detected, strict=True):
        k = np.flatnonzero(relevant & (truth.frame == frame))
        i, j = assign(distances(truth.centre[k], detected), MATCH)
        rows.append(k[i])
        offsets.append(detected[j] - truth.centre[k[i]])
    return np.concatenate(rows), np.concatenate(offsets)


def _ratio(part: int | np.intp, whole: int | np.intp) -> float | None:
    return float(part / whole) if whole else None
