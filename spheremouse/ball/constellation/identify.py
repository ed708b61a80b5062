"""The attitude of a map of directions from directions seen, with the probability that it is another one.

A star tracker on a ball: pairs make hypotheses (Mortari et al. 2004), all that is and is not seen weighs them, the best
are adjusted, and Bayes' rule shares the probability among them, and among them and something that is not this map.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.constellation import evidence
from spheremouse.ball.constellation import hypotheses as kernel
from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class IdentificationPrior:
    """What is expected of detections, wide enough for any of them, and how far the search goes.

    What would be said of a ball before it is seen, and bounds on time; `foreshortened` and `kept` were settled on
    simulated balls (docs/identification.md), nothing on recordings.
    """

    hidden: tuple[float, ...] = (0.05, 0.2, 0.5)  # probability that a disc in plain sight is missed: faint, strut, hand
    scales: tuple[float, ...] = (2.0 / 3.0, 1.0, 1.5)  # true standard deviation over the one given
    false_mean: float = 2.0  # directions that are no disc; geometric, so that ten are unlikely and not impossible
    limb: float = 0.1  # cosine above the horizon at which half of all discs are seen: foreshortened to a tenth there
    blur: float = 0.06  # cosine over which that changes: a view axis, or a horizon, that is off by 3.5 degrees
    foreshortened: float = 0.5  # share of directions' noise that is noise of pixels, and so grows with 1 / cosine
    other: float = 0.1  # probability of something else in sight: another ball, a wall of false detections
    reach: float = 3.0  # standard deviations that the angle of a pair may be off: one true pair in 370 is missed
    margin: float = 25.0  # nats a first score may be behind: odds of 1e6, and as much again for it being rough
    first: float = 2.5  # variance of the first pairs over that of the last: two directions made the attitude
    group: int = 6  # an attitude is found for certain where more than one in six of the directions meet
    kept: int = 64  # attitudes followed up: an icosahedron looks alike in 60
    most: int = 5000  # hypotheses: a millisecond
    sample: int = 16  # of them, for the evidence that two directions meet and no more
    directions: int = 60  # taken, those nearest to the camera: more are not on one side of 120
    same: float = 25.0  # squared standard deviations within which two attitudes are one


@dataclass(frozen=True, slots=True)
class Attitude:
    """The most probable attitude of a map."""

    rotation: Array  # (3, 3), directions seen ~ known @ rotation.T
    pairs: NDArray[np.intp]  # (k, 2) of (index into seen, index into known)
    wrong: float  # probability that it is another attitude, or another map


def attitude(
    seen: Array,
    known: Array,
    sigma: float,
    towards: Array,
    horizon: float,
    model: IdentificationPrior = IdentificationPrior(),
) -> Attitude | None:
    """Most probable rotation of `known`, (m, 3) unit vectors, to `seen`, (n, 3); None where no three of them agree.

    `sigma` rad per axis; `towards` (3,) the camera, in the frame of `seen`; `horizon` the least cosine with it that can
    be seen. The probability in the result is exact as far as the model holds.
    """
    central = np.sort(np.argsort(-(seen @ towards), kind="stable")[: model.directions])
    points = np.ascontiguousarray(seen[central])
    n = len(points)
    area = 2.0 * math.pi * (1.0 - horizon)
    law = kernel.Law(
        towards,
        horizon + model.limb,
        model.blur,
        1.0 - float(np.median(model.hidden)),
        np.array(model.hidden),
        np.array(model.scales),
        model.false_mean,
        area,
    )
    gain = evidence.max_log_likelihood_ratio(sigma * sigma, law)
    if gain <= 0.0:  # so coarse that a false direction explains as much as any disc
        return None
    pairs = kernel.pairs_of(points, max(1, n // model.group))
    H, inflation, origin = kernel.hypotheses(points, known, pairs, model.reach * math.sqrt(2.0) * sigma, model.most)
    starts = kernel.best_of(H, inflation, points, known, sigma, gain, model.margin, model.kept)
    if len(starts) == 0:
        return None
    cosine = np.clip(
        points @ towards, 0.3, 1.0
    )  # nearer the limb a disc is a line, and its noise is not that of pixels
    variance = sigma * sigma * (1.0 + 0.5 * model.foreshortened * (1.0 / cosine**2 - 1.0))
    R, columns, information, value = evidence.attitudes(starts, points, known, variance, law, model.first)
    discs_in_sight = 0.5 * len(known) * (1.0 - horizon)  # another ball is as dotted as this
    other = evidence.false_count(n, discs_in_sight, area) + math.log(model.other / (1.0 - model.other))
    two = evidence.only_two(H, origin, points, known, variance, law, model.sample) + math.log(
        n * (n - 1) / 2 / len(pairs)
    )
    best, wrong = evidence.share(R, information, value, np.logaddexp(other, two), model.same)
    rows = np.flatnonzero(columns[best] >= 0)
    if len(rows) < 3 or not math.isfinite(value[best]):
        return None
    return Attitude(R[best].copy(), np.stack([central[rows], columns[best][rows]], axis=1), wrong)


def shared_rotation(before: Array, after: Array, sigma: float) -> tuple[Array, int]:
    """Rotation, (3, 3), by which most of `after`, (n, 3), come from `before`, (m, 3), and how many do.

    Of equal numbers the smallest rotation. `sigma` rad per axis; directions agree within 5.25 of it, which allows for
    the error of the two that made the rotation.
    """
    pairs = kernel.pairs_of(after, max(1, len(after) // 6))
    R, _, _ = kernel.hypotheses(after, before, pairs, 3.5 * math.sqrt(2.0) * sigma, 20_000)
    return kernel.most_agreed(R, after, before, math.cos(5.25 * sigma))
