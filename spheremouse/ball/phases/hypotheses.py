"""The filter updated by a frame under every attitude that the discs in view leave possible."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect import lookalikes as static
from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_mixture import Hypothesis, update_hypotheses
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.phases.candidates import confirms
from spheremouse.ball.state import Tracker, TrackState

_HIDDEN_BY_CHANCE = 1  # discs: a strut hides one, something that covers the ball hides more
_CERTAIN = math.log(0.999)  # log probability from which the most probable attitude is taken for the only one


def updated_hypotheses(
    state: TrackState[So3State],
    stamp: float,
    tracker: Tracker[So3Filter],
    predicted: So3State,
    *,
    proven: NDArray[np.bool_] | None = None,
    extend_map: bool = True,
) -> TrackState[So3State]:
    """Filter the points under every attitude that is possible; `predicted` is the most probable one.

    Points that are `proven` (n,) to turn with the ball may join the map; None: those that earlier frames have proven.
    Nothing joins unless the map may be extended, `extend_map`.
    """
    points, centre, f = state.points, state.detections.centre[state.points.index], tracker.filter
    if proven is None:
        proven = static.known_before_to_turn(
            state.lookalikes, centre, predicted.attitude, tracker.rig, tracker.pose, tracker.settings.static
        )
    rest = tuple(Hypothesis(f.predict(h.state, stamp), h.log_probability) for h in state.alternatives)
    best = math.log1p(-sum(math.exp(h.log_probability) for h in rest))
    hypotheses = update_hypotheses(f, (Hypothesis(predicted, best), *rest), points, proven, extend_map)
    filtered, alternatives = hypotheses[0].state, hypotheses[1:]
    if hypotheses[0].log_probability > _CERTAIN:
        alternatives = ()
    used = len(filtered.used)
    missing = np.count_nonzero(filtered.missed[f.expected(filtered)])
    supported = (used > 0 or filtered.is_roughly_known) and missing <= max(used, _HIDDEN_BY_CHANCE)
    return replace(
        state,
        filter=filtered,
        alternatives=alternatives,
        supported_at=stamp if supported else min(state.supported_at, stamp),
        confirmed=not alternatives and confirms(filtered, len(points), predicted, tracker),
    )
