"""What is said of hand-held balls while they are tracked: each change once, in words. Poses in, sentences out."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.output.sparing import letters
from spheremouse.session.follower import News
from spheremouse.tracker import Status
from spheremouse.wand.state import WandPose

PATIENCE = 5.0  # s of frames without a ball that was never seen, after which that is worth a word
_GREY = 3.0  # grey values by which the colours of a pixel differ, on average, in a picture without colour


class Told:
    """Remembers what was said last."""

    def __init__(self, points: int, name: str) -> None:
        """`points` is the index of the ball that moves the pointer, `name` what it is called."""
        self._points = points
        self._phases: dict[int, Status] = {}
        self._events: dict[int, str] = {}
        self._began: float | None = None
        self._complained = False
        self.found: set[int] = set()  # balls that have been seen
        self.why = ""  # the ball that points is not seen; empty while it is
        self.reason = f"{name} is looked for"  # what is known of it
        self._unseen: dict[int, str] = {}  # balls until they are found: why not, in words

    def interrupted(self) -> None:
        """No frames come: what is there is said anew when they come again."""
        self._phases.clear()
        self._began = None

    def frame(self, stamp: float, poses: tuple[WandPose, ...], image: NDArray[np.uint8]) -> News:
        """What the poses of a frame have that is new."""
        self._began = stamp if self._began is None else self._began
        change, more = "", list[str]()
        for k, pose in enumerate(poses):
            new = self._phase(k, pose)
            if new and k == self._points:
                change = f"{pose.phase}: {new}"
            elif new:
                more.append(new)
            if self._is_news(k, pose):
                more.append(pose.event)
        pose = poses[self._points]
        self.why = "" if pose.phase is Status.TRACKING else _why(pose, image)
        self.reason = self.why or f"{pose.name} is followed"
        if pose.phase is Status.SEARCHING and not self._complained and stamp - self._began > PATIENCE:
            self._complained = True
            more.append(f"not found for {PATIENCE:g} s: {self.why}")
        return News(change, tuple(more))

    def never_found(self, but: int | None = None) -> tuple[str, ...]:
        """A line for each ball that has never been seen, at the end; `but` the one of that index, told otherwise."""
        return tuple(line for k, line in self._unseen.items() if k != but and k not in self.found)

    def _phase(self, k: int, pose: WandPose) -> str:
        """What is to be said of one ball's phase, where it is another one."""
        before, self._phases[k] = self._phases.get(k), pose.phase
        if k not in self.found:
            self._unseen[k] = f"{pose.name} was never found: {pose.event}"
        match pose.phase:
            case Status.TRACKING:
                self.found.add(k)
                return "" if before is pose.phase else f"{pose.name} is followed"
            case Status.LOST if before is not pose.phase:
                return pose.event
            case Status.SEARCHING if before is None:
                return f"{pose.name} is looked for"
            case _:
                return ""

    def _is_news(self, k: int, pose: WandPose) -> bool:
        """Is it worth a word? A ball that is hidden for a moment is not."""
        if (
            pose.phase is not Status.TRACKING
            or not pose.seen
            or not pose.event
            or letters(pose.event) == letters(self._events.get(k, ""))
        ):
            return False
        self._events[k] = pose.event
        return True


def _why(pose: WandPose, image: NDArray[np.uint8]) -> str:
    sample = image[::8, ::8].astype(np.int16)
    if sample.ndim == 3 and float(np.ptp(sample, axis=2).mean()) < _GREY:
        return f"{pose.event} (the frames are grey, or dark)"
    return pose.event
