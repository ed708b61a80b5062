"""What is said of hand-held balls while they are tracked: each change once, in words. Poses in, lines out."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.output.sparing import letters
from spheremouse.wand.state import WandPhase, WandPose

PATIENCE = 5.0  # s of frames without a ball that was never seen, after which that is worth a word
_GREY = 3.0  # grey values by which the colours of a pixel differ, on average, in a picture without colour


class Told:
    """Remembers what was said last."""

    def __init__(self) -> None:
        self._trouble = ""
        self._phases: dict[int, WandPhase] = {}
        self._events: dict[int, str] = {}
        self._began: float | None = None
        self._complained = False
        self.found: set[int] = set()  # balls that have been seen
        self.why = ""  # the first ball is not seen; empty while it is
        self._unseen: dict[int, str] = {}  # balls until they are found: why not, in words

    def camera(self, trouble: str) -> list[str]:
        """Why no frame can be used; empty where they can."""
        news = bool(trouble) and letters(trouble) != letters(self._trouble)
        if trouble:
            self._phases.clear()  # said anew when frames come again
            self._began = None
        self._trouble = trouble
        return [f"no-camera: {trouble}"] if news else []

    def frame(self, stamp: float, poses: tuple[WandPose, ...], image: NDArray[np.uint8], points: int) -> list[str]:
        """The poses of a frame; `points` is the index of the ball that moves the pointer."""
        lines: list[str] = []
        self._began = stamp if self._began is None else self._began
        for k, pose in enumerate(poses):
            before, self._phases[k] = self._phases.get(k), pose.phase
            if k not in self.found:
                self._unseen[k] = f"{pose.name} was never found: {pose.event}"
            if pose.phase is WandPhase.TRACKING:
                self.found.add(k)
                if before is not pose.phase:
                    lines.append(f"tracking: {pose.name} is followed")
                if self._is_news(k, pose):
                    lines.append(pose.event)
            elif pose.phase is WandPhase.LOST and before is not pose.phase:
                lines.append(f"lost: {pose.event}")
            elif before is None and pose.phase is WandPhase.SEARCHING:
                lines.append(f"searching: {pose.name} is looked for")
        pose = poses[points]
        self.why = "" if pose.phase is WandPhase.TRACKING else _why(pose, image)
        if pose.phase is WandPhase.SEARCHING and not self._complained and stamp - self._began > PATIENCE:
            self._complained = True
            lines.append(f"searching: for {PATIENCE:g} s: {self.why}")
        return lines

    def never_found(self, but: int | None = None) -> list[str]:
        """A line for each ball that has never been seen, at the end; `but` the one of that index, told otherwise."""
        return [line for k, line in self._unseen.items() if k != but and k not in self.found]

    def _is_news(self, k: int, pose: WandPose) -> bool:
        """Is it worth a word? A ball that is hidden for a moment is not."""
        if not pose.seen or not pose.event or letters(pose.event) == letters(self._events.get(k, "")):
            return False
        self._events[k] = pose.event
        return True


def _why(pose: WandPose, image: NDArray[np.uint8]) -> str:
    sample = image[::8, ::8].astype(np.int16)
    if sample.ndim == 3 and float(np.ptp(sample, axis=2).mean()) < _GREY:
        return f"{pose.event} (the frames are grey, or dark)"
    return pose.event
