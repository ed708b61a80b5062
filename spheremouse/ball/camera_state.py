"""Parts of the tracker's state that belong to its cameras (`cameras` begins such a state)."""

from collections.abc import Callable
from typing import Any

from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import CameraState, Lost, Tracker, TrackState, current


def cameras_of(state: TrackState[Any]) -> tuple[int, ...]:
    """Return the numbers of the cameras: of the last frame, then of the others."""
    return state.camera, *(other.camera for other in state.others)


def part_of(state: TrackState[Any], camera: int) -> TrackState[Any] | CameraState | None:
    """Return the state whose fields of `CameraState` are those of a camera; None if the state does not have it."""
    return next((part for part in (state, *state.others) if part.camera == camera), None)


def current_of(state: TrackState[Any], camera: int, tracker: Tracker[Any]) -> Tracker[Any]:
    """Return the tracker in use for a camera: `tracker`, or the one that was rebuilt for a new pose."""
    part = part_of(state, camera)
    return tracker if part is None else current(part, tracker)


def facing(state: TrackState[Any], camera: int) -> TrackState[Any]:
    """Return the state for a frame of a camera."""
    if camera == state.camera:
        return state
    which = [other.camera for other in state.others].index(camera)
    others = list(state.others)
    others[which] = CameraState.of(state)
    state = state._replace(**state.others[which]._asdict(), others=tuple(others))
    return with_filters(state, lambda f: f.facing(which))


def with_filters(state: TrackState[Any], change: Callable[[So3State], So3State]) -> TrackState[Any]:
    """Return the state with a change of each filter state that it has."""
    phase = state.phase
    if isinstance(phase, Lost) and phase.trial is not None:
        phase = phase._replace(trial=phase.trial._replace(filter=change(phase.trial.filter)))
    return state._replace(
        phase=phase,
        filter=change(state.filter),
        alternatives=tuple(h._replace(state=change(h.state)) for h in state.alternatives),
        older=None if state.older is None else change(state.older),
    )
