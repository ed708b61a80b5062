"""Several attitudes at once, while the discs in view leave more than one possible.

A hypothesis is a filter state with its probability. Each frame extends every hypothesis by the assignments of points to
discs that remain likely, weighs them by the discs seen and missed, and keeps the best. This is hypothesis-oriented
multiple hypothesis tracking (Reid 1979, "An algorithm for tracking multiple targets"). Assignments grow point by point,
as in the joint compatibility test of Neira and Tardós 2001. In ordinary frames one hypothesis remains.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.filters.so3 import Pairing, So3Filter
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.rotation import Array, rotation_between

_MAX_HYPOTHESES = 6  # a disc in view is one of a few: each of them costs a millisecond in such a frame
_MAX_NODES = 5  # assignments carried on from point to point, of the most probable hypothesis
_MAX_NODES_OF_OTHERS = 2
_MAX_SEARCHED = 6  # points: with more in view the nearest pairs, or the whole constellation, determine the attitude
_MARGIN = 9.0  # nats behind the best at which a hypothesis is dropped: odds of 1 to 8000
_EQUAL_ATTITUDE_RAD = 2e-3  # largest angle between attitudes that count as equal: a tenth of a degree
_EQUAL_RATE_CHI2 = 16.3  # squared Mahalanobis distance of rates that count as equal: chi-square with 3 degrees, 99.9 %
_WIDE_GATE = 3.0  # times the gate: a prior's error may exceed its covariance, and the likelihood decides
_UNKNOWN_DISCS = 4.0  # at least, on the side that has not been seen: a ball has eight discs and more
_FEW_POINTS = 4  # in view: so few discs may not determine the rotation
_MIN_DETECTION = 1e-6  # probability: no model justifies zero
_FALSE_POINTS = 0.5  # expected in view that are no disc, once look-alikes are masked


class Hypothesis(NamedTuple):
    """A possible state, and the logarithm of its probability."""

    state: So3State
    log_probability: float  # nats


class _Node(NamedTuple):
    """An assignment of the points considered so far, with the state after it and its log likelihood."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]
    state: So3State
    log_likelihood: float


def mixture_covariance(best: So3State, others: tuple[Hypothesis, ...]) -> Array:
    """Return the covariance, (6, 6), of attitude and rate about the most probable state, with the other hypotheses.

    It is the second moment of the mixture about that state, which the tracker reports.
    """
    covariance = best.covariance.copy()
    for state, log_probability in others:
        off = np.append(rotation_between(best.attitude, state.attitude), state.rate - best.rate)
        covariance += math.exp(log_probability) * (state.covariance - best.covariance + np.outer(off, off))
    return covariance


def update_hypotheses(
    filter_: So3Filter,
    predicted: tuple[Hypothesis, ...],
    points: SpherePoints,
    proven: NDArray[np.bool_],
    needed: bool = False,
) -> tuple[Hypothesis, ...]:
    """Return the hypotheses after a frame's points, most probable first; their probabilities sum to one.

    `predicted` holds the states predicted for the frame's stamp. A point without a disc starts a landmark if it is
    `proven` (n,) to turn with the ball. If fewer than two discs are paired and landmarks are `needed`, every such point
    starts one: after a turn new discs are in view, and their landmarks measure the rotation.
    """
    extended: list[tuple[So3State, _Node, float]] = []
    for k, (state, log_probability) in enumerate(predicted):
        for node in _assignments(filter_, state, points, _MAX_NODES if k == 0 else _MAX_NODES_OF_OTHERS):
            value = log_probability + node.log_likelihood + _log_missed(filter_, node.state, node.columns)
            extended.append((state, node, value))
    extended.sort(key=lambda item: -item[2])
    kept: list[tuple[So3State, _Node, float]] = []
    for item in extended:
        if item[2] < extended[0][2] - _MARGIN or len(kept) == _MAX_HYPOTHESES:
            break
        if not any(_is_duplicate(item[1].state, other[1].state) for other in kept):
            kept.append(item)
    total = math.log(sum(math.exp(value - kept[0][2]) for _, _, value in kept)) + kept[0][2]
    hypotheses = []
    few = needed and len(points) <= _FEW_POINTS  # many points at once are none of a ball with few discs
    for _, node, value in kept:
        may_start = proven | (few and len(node.rows) < 2)
        hypotheses.append(
            Hypothesis(
                filter_.keep_map(node.state, points, _pairing(node.rows, node.columns), may_start), value - total
            )
        )
    return tuple(hypotheses)


def _assignments(filter_: So3Filter, predicted: So3State, points: SpherePoints, most: int) -> list[_Node]:
    """Return the likely assignments of a frame's points to the discs of one predicted state.

    Points join one by one, those with the fewest candidates first. Each pair reduces the choice of the next. To bound
    the time, the search keeps at most `most` assignments, over a few points.
    """
    density = math.log(new_density(filter_, predicted, len(points)))
    gate = _WIDE_GATE * filter_.settings.gate
    distance, which = filter_.distances_to_discs(predicted, points, gate, highest=True)
    choices = np.count_nonzero(distance < gate, axis=1)
    choices[np.argsort(np.where(choices > 0, choices, len(which) + 1), kind="stable")[_MAX_SEARCHED:]] = 0
    nodes = [_Node((), (), filter_.correct(predicted, points, _pairing((), ()))[0], 0.0)]
    for done, row in enumerate(np.argsort(choices, kind="stable"), 1):
        grown: list[_Node] = []
        for node in nodes:
            grown.append(node._replace(log_likelihood=node.log_likelihood + density))
            if choices[row] == 0:
                continue
            near, among = distance[row], which
            if len(node.rows) > 0:
                one, closer = filter_.distances_to_discs(node.state, points.take(np.array([row])), gate)
                if np.any(one < gate):  # else a push may explain what the node's own motion does not
                    near, among = one[0], closer
            nearest = np.argsort(near)[:most]
            for column in among[nearest[near[nearest] < gate]]:
                if column not in node.columns:
                    rows, columns = (*node.rows, int(row)), (*node.columns, int(column))
                    grown.append(_node(filter_, predicted, points, rows, columns, (done - len(rows)) * density))
        nodes = _distinct(grown, most)
    nearest = filter_.nearest_pairs(predicted, points)  # all points at once, if the search misses it
    pairs = dict(zip(nearest.rows.tolist(), nearest.columns.tolist(), strict=True))
    if all(dict(zip(node.rows, node.columns, strict=True)) != pairs for node in nodes):
        unpaired = (len(points) - len(pairs)) * density
        nodes.append(_node(filter_, predicted, points, tuple(pairs), tuple(pairs.values()), unpaired))
    return nodes


def _distinct(nodes: list[_Node], most: int) -> list[_Node]:
    """Return at most `most` nodes near the best, of different attitudes or rates.

    An assignment that leaves out a pair of another one leads to the same motion. Only the likelier one is kept.
    """
    kept: list[_Node] = []
    for node in sorted(nodes, key=lambda node: -node.log_likelihood):
        if len(kept) == most or (kept and node.log_likelihood < kept[0].log_likelihood - 2.0 * _MARGIN):
            break
        if not any(_is_duplicate(node.state, other.state) for other in kept):
            kept.append(node)
    return kept


def _node(
    filter_: So3Filter,
    predicted: So3State,
    points: SpherePoints,
    rows: tuple[int, ...],
    columns: tuple[int, ...],
    log_unpaired: float,
) -> _Node:
    state, evidence = filter_.correct(predicted, points, _pairing(rows, columns))
    detected = np.sum(np.log(np.maximum(filter_.detection_probability(state)[list(columns)], _MIN_DETECTION)))
    return _Node(rows, columns, state, evidence + float(detected) + log_unpaired)


def _pairing(rows: tuple[int, ...], columns: tuple[int, ...]) -> Pairing:
    return Pairing(np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp))


def new_density(filter_: So3Filter, state: So3State, seen: int) -> float:
    """Return the density, 1/sr, of points that are no disc of the map: unknown discs and false points."""
    known = int(np.count_nonzero(state.hits >= ESTABLISHED_HITS))
    in_view = 0.5 * (1.0 - filter_.station.horizon)  # share of the ball
    unknown = max(seen / in_view - known, _UNKNOWN_DISCS)
    return (unknown + _FALSE_POINTS / in_view) / (4.0 * math.pi)


def _log_missed(filter_: So3Filter, state: So3State, columns: tuple[int, ...]) -> float:
    """Return the log probability that the detector misses all discs except `columns`."""
    missed = 1.0 - filter_.detection_probability(state)
    missed[list(columns)] = 1.0
    return float(np.sum(np.log(missed)))


def _is_duplicate(state: So3State, likelier: So3State) -> bool:
    """Return whether a state has the attitude of a likelier one, and a rate within its covariance.

    The rate counts, since a ball that passes through an attitude is not the ball that rests there.
    """
    if np.trace(state.attitude.T @ likelier.attitude) <= 1.0 + 2.0 * math.cos(_EQUAL_ATTITUDE_RAD):
        return False
    difference = state.rate - likelier.rate
    return float(difference @ np.linalg.solve(likelier.joint[3:6, 3:6], difference)) < _EQUAL_RATE_CHI2
