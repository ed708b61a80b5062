"""The state of the daemon and its reason, derived from conditions by a pure function."""

from dataclasses import dataclass
from enum import StrEnum

from spheremouse.output.rate_limited_logger import strip_digits
from spheremouse.tracker import Status


class State(StrEnum):
    """States of the daemon; motion is sent in `tracking` only."""

    STARTING = "starting"
    NO_CAMERA = "no-camera"
    PAUSED = "paused"
    SEARCHING_TARGETS = "searching-targets"
    LOST = "lost"
    FAILED_OUTPUT = "failed-output"
    TRACKING = "tracking"


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions of the state. A text is a reason, and empty without trouble."""

    starting: str = ""
    camera: str = ""
    paused: str = ""
    targets: str = ""
    ball: str = ""
    output: str = ""
    tracker: Status = Status.SEARCHING


def derive_state(facts: Conditions) -> tuple[State, str]:
    """Return state and reason. The first fault on the way from the camera to the pointer counts."""
    for state, reason in (
        (State.STARTING, facts.starting),
        (State.NO_CAMERA, facts.camera),
        (State.PAUSED, facts.paused),
        (State.SEARCHING_TARGETS, facts.targets),
    ):
        if reason:
            return state, reason
    if facts.tracker is Status.SEARCHING:
        return State.LOST, facts.ball or "no disc on the ball seen yet"
    if facts.tracker is Status.LOST:
        return State.LOST, facts.ball or "the ball is not recognised"
    if facts.output:
        return State.FAILED_OUTPUT, facts.output
    return State.TRACKING, facts.ball or "the ball is followed"


def news(before: tuple[State, str], now: tuple[State, str], event: str) -> str:
    """The line for the log: state and reason after a change, or the tracker's word; empty where nothing is to be said.

    A reason whose numbers alone have changed is the same. While the ball is in view, the tracker says what is new.
    """
    (old, why_before), (state, why) = before, now
    if state is not old:
        return f"{state}: {why}"
    if event:
        return event
    if state in (State.TRACKING, State.LOST) or strip_digits(why) == strip_digits(why_before):
        return ""
    return f"{state}: {why}"
