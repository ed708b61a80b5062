"""The read-out time of the shutter, told when it is known."""

from dataclasses import replace

from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import (
    Tracker,
    TrackState,
)

_READOUT_SURE = 8e-5  # s, standard deviation from which a readout is told
_READOUT_LEAST = 2e-3  # s: less moves nothing by more than a tenth of a degree


def tell_readout(state: TrackState, tracker: Tracker) -> TrackState:
    """Once play has shown how long a rolling shutter takes, say so, if it is one."""
    if not isinstance(state.filter, So3State) or state.filter.readout_sigma > _READOUT_SURE:
        return state
    readout = tracker.rig.readout_s + state.filter.readout
    if abs(readout) < _READOUT_LEAST:
        return replace(state, readout_told=True)
    event = f"rolling shutter: {1e3 * readout:.1f} ms for all rows (say readout_s: {readout:.4f} in the rig file)"
    return replace(state, readout_told=True, event=f"{state.event}; {event}" if state.event else event)
