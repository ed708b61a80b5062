"""Sentences about hand-held balls, made of events. Each change of a pose is reported once."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from spheremouse.session.tracker_adapter import LogMessages
from spheremouse.tracker import Event, Status
from spheremouse.wand.events import BallHidden, BallLost, ColourEverywhere, ColourNowhere, NotInView, SecondBall
from spheremouse.wand.state import WandPose

MAX_SEARCH_S = 5.0  # s of frames without a ball that was never seen, after which that is logged
# grey values by which the colours of a pixel differ, on average, in a picture without colour
_MAX_GREY_COLOUR_DIFFERENCE = 3.0

_Wand = NotInView | BallLost | BallHidden | SecondBall | ColourNowhere | ColourEverywhere


def sentence(event: Event) -> str:
    """Return an event and its remedy as a sentence."""
    return ": ".join(filter(None, trouble_and_remedy(event)))


def trouble_and_remedy(event: Event) -> tuple[str, str]:
    """Return an event and its remedy, which may be empty."""
    match cast(_Wand, event):
        case NotInView(ball):
            return f"no ball like {ball} in view", "hold it into the picture, or check its colours and size"
        case BallLost(ball):
            return f"{ball} is lost", "hold it into the picture"
        case BallHidden(ball):
            return f"{ball} is hidden: its pose is predicted", ""
        case SecondBall(ball):
            return f"a second ball like {ball} is in view", "declare it too, or take it away"
        case ColourNowhere(colour):
            return f"the bounds of {colour} match nothing in the picture", "pick them with `spheremouse wand colours`"
        case ColourEverywhere(colour, share):
            what = f"the bounds of {colour} match {100 * share:.0f} % of the picture"
            return what, "narrow them with `spheremouse wand colours`"


class WandMessages:
    """Texts about the balls for status and log."""

    def __init__(self, points: int, name: str) -> None:
        """`points` is the index of the ball that moves the pointer, and `name` its name."""
        self._points = points
        self._phases: dict[int, Status] = {}
        self._events: dict[int, Event] = {}
        self._began: float | None = None
        self._complained = False
        self._change, self._more = "", list[str]()
        self.found: set[int] = set()  # balls that have been seen
        self.why = ""  # the ball that points is not seen; empty while it is
        self.reason = f"{name} is looked for"  # its state, for the status
        self._unseen: dict[int, str] = {}  # balls until they are found: the reason, in words

    def interrupted(self) -> None:
        """Report all balls again when frames arrive again."""
        self._phases.clear()
        self._began = None

    def add(self, stamp: float, poses: tuple[WandPose, ...], image: NDArray[np.uint8]) -> None:
        """Update the texts from the poses of a frame at `stamp` (s), with its image (h, w, 3) BGR."""
        self._began = stamp if self._began is None else self._began
        for k, pose in enumerate(poses):
            new = self._phase(k, pose)
            if new and k == self._points:
                self._change = f"{pose.phase}: {new}"
            elif new:
                self._more.append(new)
            if self._is_new_event(k, pose):
                self._more.append(problem(pose))
        pose = poses[self._points]
        self.why = "" if pose.phase is Status.TRACKING else _why(pose, image)
        self.reason = self.why or f"{pose.name} is followed"
        if pose.phase is Status.SEARCHING and not self._complained and stamp - self._began > MAX_SEARCH_S:
            self._complained = True
            self._more.append(f"not found for {MAX_SEARCH_S:g} s: {self.why}")

    def take(self) -> LogMessages:
        """Return the log lines since the previous call, and clear them. Of several changes it keeps the last."""
        log = LogMessages(self._change, tuple(self._more))
        self._change = ""
        self._more.clear()
        return log

    def never_found(self, but: int | None = None) -> tuple[str, ...]:
        """Return a line for each ball that was never seen, without the one of index `but`."""
        return tuple(line for k, line in self._unseen.items() if k != but and k not in self.found)

    def _phase(self, k: int, pose: WandPose) -> str:
        """Return the log line of a ball's new phase."""
        before, self._phases[k] = self._phases.get(k), pose.phase
        if k not in self.found:
            self._unseen[k] = f"{pose.name} was never found: {problem(pose)}"
        match pose.phase:
            case Status.TRACKING:
                self.found.add(k)
                return "" if before is pose.phase else f"{pose.name} is followed"
            case Status.LOST if before is not pose.phase:
                return problem(pose)
            case Status.SEARCHING if before is None:
                return f"{pose.name} is looked for"
            case _:
                return ""

    def _is_new_event(self, k: int, pose: WandPose) -> bool:
        """Return True if the event must be logged. A ball that is hidden for a moment is not logged."""
        if pose.event is None or pose.phase is not Status.TRACKING or not pose.seen:
            return False
        before, self._events[k] = self._events.get(k), pose.event
        return pose.event != before


def _why(pose: WandPose, image: NDArray[np.uint8]) -> str:
    sample = image[::8, ::8].astype(np.int16)
    if sample.ndim == 3 and float(np.ptp(sample, axis=2).mean()) < _MAX_GREY_COLOUR_DIFFERENCE:
        return f"{problem(pose)} (the frames are grey, or dark)"
    return problem(pose)


def problem(pose: WandPose) -> str:
    """Return a problem of a ball; empty if there is none."""
    return "" if pose.event is None else sentence(pose.event)
