"""Sightings of the discs on the map: how likely a disc is detected, and which discs enter and leave the map.

A disc is detected if it faces the camera, nothing hides it, and the detector finds it.
A disc is hidden or not, as a Markov chain of two states with an observation in each frame (Thrun, Burgard and Fox 2005,
section 4.2, the binary Bayes filter). A strut or a hand hides a disc until one of them moves. So a disc that is missed
again and again while the ball rests counts once: repeated views of a still scene are not independent.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS, MAX_MISSES_PER_HIT, MAX_TRIAL_MISSES
from spheremouse.geometry.rotation import Array

HIDDEN_SHARE = 0.2  # of the discs that face the camera: struts and hands before them
_DETECTED = 0.95  # probability that a disc is detected that nothing hides
_LIMB = 0.1  # cosine above the horizon at which half of all discs are detected: foreshortened to a tenth
_LIMB_BLUR = 0.03  # cosine over which that changes
_HANDS_STAY = 1.0  # s, after which a hand has moved


@njit(cache=True, error_model="numpy")
def detection_probability(
    attitude: Array, covariance: Array, discs: Array, hidden: Array, towards: Array, horizon: float
) -> Array:
    """Return the probability, (m,), that each disc is detected, at R_obj_ball (3, 3) with `covariance`, (3, 3) rad².

    `discs` (m, 3) are unit vectors in ball. `hidden` (m,) is the probability that something hides a disc. `towards`
    (3,) points to the camera, obj. The camera sees directions with a cosine to `towards` above `horizon`.
    """
    probability = np.empty(len(discs))
    for k in range(len(discs)):
        probability[k] = _in_sight(attitude, covariance, discs[k], towards, horizon) * (1.0 - hidden[k])
    return probability


@njit(cache=True, error_model="numpy")
def carry_hidden(attitude: Array, rate: Array, discs: Array, hidden: Array, dt: float, disc_angle: float) -> Array:
    """Return the probabilities, (m,), that something hides each disc, `dt` s later.

    The information decays as the disc travels by its own diameter, 2 `disc_angle` rad, or as hands move. `attitude` is
    R_obj_ball (3, 3), `rate` (3,) rad/s is w_obj, `discs` (m, 3) are unit vectors in ball.
    """
    carried = np.empty(len(discs))
    for k in range(len(discs)):
        d = discs[k]
        x = attitude[0, 0] * d[0] + attitude[0, 1] * d[1] + attitude[0, 2] * d[2]
        y = attitude[1, 0] * d[0] + attitude[1, 1] * d[1] + attitude[1, 2] * d[2]
        z = attitude[2, 0] * d[0] + attitude[2, 1] * d[1] + attitude[2, 2] * d[2]
        u, v, w = rate[1] * z - rate[2] * y, rate[2] * x - rate[0] * z, rate[0] * y - rate[1] * x
        speed = math.sqrt(u * u + v * v + w * w)
        kept = math.exp(-dt * (speed / (2.0 * disc_angle) + 1.0 / _HANDS_STAY))
        carried[k] = HIDDEN_SHARE + (hidden[k] - HIDDEN_SHARE) * kept
    return carried


@njit(cache=True, error_model="numpy")
def update_hidden(hidden: Array, probability: Array, seen: NDArray[np.intp]) -> Array:
    """Return the probabilities, (m,), that something hides each disc, after a frame that shows the discs `seen`.

    `probability` (m,) is that of each detection, as `detection_probability` gives it for `hidden` (m,).
    """
    updated = hidden / (1.0 - probability)
    updated[seen] = 0.0
    return updated


@njit(cache=True, error_model="numpy")
def count_sightings(attitude, covariance, discs, hits, missed, hidden, towards, horizon, columns, any_point):
    """Count a frame that shows the discs `columns` in their places, and whether it shows `any_point` at all.

    `hits` are sightings, `missed` misses in a row, and `hidden` probabilities of something before the disc, (m,) each.
    Returns the three after the frame, a mask, (m,), of the discs to keep, the number of established discs seen, and
    the expected number of those missed.
    """
    seen = np.zeros(len(discs), dtype=np.bool_)
    seen[columns] = True
    # a disc near the horizon is often too thin to be detected, and a frame without a point misses no disc in particular
    well = discs @ (towards @ attitude) > horizon + 0.5 * (1.0 - horizon)
    misses = well & ~seen & any_point
    probability = detection_probability(attitude, covariance, discs, hidden, towards, horizon)
    established = hits >= ESTABLISHED_HITS
    known_seen, known_missed = np.count_nonzero(seen & established), np.sum(probability[misses & established])
    hits, missed = hits + seen, np.where(seen, 0, missed + misses)
    limit = np.where(hits < ESTABLISHED_HITS, float(MAX_TRIAL_MISSES), MAX_MISSES_PER_HIT * hits)
    return hits, missed, update_hidden(hidden, probability, columns), missed < limit, known_seen, known_missed


@njit(cache=True, error_model="numpy")
def new_discs(attitude, discs, direction, free, rows, apart):
    """Return the points, (k,), of a mask `free` (n,) that are no disc of the map, by their directions, (n, 3) obj.

    The points `rows` are paired with discs. Two discs do not overlap. If a point's cosine with a known disc exceeds
    `apart`, the point is a poor measurement of that disc. Of two points that close to each other, the first counts.
    """
    place = np.empty((len(discs) + len(direction), 3))
    for k in range(len(discs)):
        for i in range(3):
            place[k, i] = attitude[i, 0] * discs[k, 0] + attitude[i, 1] * discs[k, 1] + attitude[i, 2] * discs[k, 2]
    new, known = np.empty(len(direction), dtype=np.intp), len(discs)
    for i in range(len(direction)):
        b, is_new = direction[i], free[i] and not np.any(rows == i)
        for k in range(known):
            is_new = is_new and place[k, 0] * b[0] + place[k, 1] * b[1] + place[k, 2] * b[2] < apart
        if is_new:
            new[known - len(discs)] = i
            place[known] = b
            known += 1
    return new[: known - len(discs)]


@njit(cache=True, error_model="numpy")
def _in_sight(attitude, covariance, disc, towards, horizon):
    """Return the probability that a disc is detected if nothing hides it, over all attitudes that are possible.

    The mean of a logistic function over a normal distribution is about that of a wider one (MacKay 1992, "The evidence
    framework applied to classification networks").
    """
    place, across = np.empty(3), np.empty(3)
    for i in range(3):
        place[i] = attitude[i, 0] * disc[0] + attitude[i, 1] * disc[1] + attitude[i, 2] * disc[2]
    cosine, variance = place[0] * towards[0] + place[1] * towards[1] + place[2] * towards[2], 0.0
    for i in range(3):  # a turn e moves the cosine by e . (place x towards)
        across[i] = place[i - 2] * towards[i - 1] - place[i - 1] * towards[i - 2]
    for i in range(3):
        for j in range(3):
            variance += across[i] * covariance[i, j] * across[j]
    width = math.sqrt(_LIMB_BLUR**2 + math.pi / 8.0 * max(variance, 0.0))
    return _DETECTED / (1.0 + math.exp(min((horizon + _LIMB - cosine) / width, 30.0)))
