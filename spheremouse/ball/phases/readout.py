"""The read-out time of the shutter, told when it is known."""

from dataclasses import replace

from spheremouse.ball.events import ReadoutKnown
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import Events, Tracker, TrackState

_READOUT_SURE = 8e-5  # s, standard deviation from which a readout is known
_READOUT_LEAST = 2e-3  # s: less moves nothing by more than a tenth of a degree


def learn_readout(state: TrackState[So3State], tracker: Tracker) -> tuple[TrackState[So3State], Events]:
    """Once play has shown how long a rolling shutter takes, that is an event, if it is one."""
    if state.filter.readout_sigma > _READOUT_SURE:
        return state, ()
    readout = tracker.rig.readout_s + state.filter.readout
    state = replace(state, readout_known=True)
    return state, () if abs(readout) < _READOUT_LEAST else (ReadoutKnown(readout),)
