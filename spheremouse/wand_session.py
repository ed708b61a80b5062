"""One run of the wand's tracker from the first frame to the last, timed: frames in, runs for the metrics out.

The shell's part of the wand's use phase, as `session` is for the ball in its frame. Printing is its callers' matter.
"""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from spheremouse.camera import InteriorOrientation
from spheremouse.errors import SourceError
from spheremouse.evaluate.wand import WandRun
from spheremouse.frame import Frame
from spheremouse.rotation import Array
from spheremouse.wand.track import WandPose, WandState, WandTracker, begin, step

Known = dict[int, tuple[Array, Array]]  # position and rotation of balls, by their index


@dataclass(frozen=True, slots=True)
class WandEpoch:
    """One tracked frame."""

    frame: Frame
    poses: tuple[WandPose, ...]
    seconds: float  # wall time of the step


@dataclass(slots=True)
class WandHistory:
    """What a run said, without the pictures."""

    stamps: list[float] = field(default_factory=list)
    poses: list[tuple[WandPose, ...]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, epoch: WandEpoch) -> None:
        """One more."""
        self.stamps.append(epoch.frame.stamp)
        self.poses.append(epoch.poses)
        self.seconds.append(epoch.seconds)

    def run(self, ball: int = 0) -> WandRun:
        """Of one ball, as the metrics take it."""
        n = len(self.stamps)
        position, rotation = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
        covariance = np.full((n, 6, 6), np.nan)
        for i, poses in enumerate(self.poses):
            pose = poses[ball]
            if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
                position[i], rotation[i], covariance[i] = pose.position, pose.rotation, pose.covariance
        return WandRun(np.array(self.stamps), position, rotation, covariance, np.array(self.seconds))

    def events(self) -> list[tuple[int, str]]:
        """What the tracker told, each once in a row, with the frame it began in."""
        found: list[tuple[int, str]] = []
        for i, poses in enumerate(self.poses):
            before = {p.event for p in self.poses[i - 1]} if i else set()
            found += [(i, p.event) for p in poses if p.event and p.event not in before]
        return found


def track_wand(
    frames: Iterable[Frame], tracker: WandTracker, seed: int = 0, known: Known | None = None
) -> Iterator[WandEpoch]:
    """Track every frame; `known` are poses of balls at the first one. What must be compiled is not in the times."""
    state: WandState | None = None
    for frame in frames:
        check_wand_size(frame, tracker.camera)
        if state is None:
            _warm(tracker, frame, seed, known)
            state = begin(tracker, seed, frame.stamp, known)
        start = time.perf_counter()
        state, poses = step(state, frame, tracker)
        yield WandEpoch(frame, poses, time.perf_counter() - start)


def check_wand_size(frame: Frame, camera: InteriorOrientation) -> None:
    """SourceError where a frame is of another size than the camera's."""
    height, width = frame.image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise SourceError(
            f"frames are {width}x{height}, but the camera is calibrated for {camera.width}x{camera.height}; "
            "set the camera to that size, or give another camera file"
        )


def _warm(tracker: WandTracker, frame: Frame, seed: int, known: Known | None) -> None:
    """Compile what a step calls: a first frame, and one that follows it."""
    state = begin(tracker, seed, frame.stamp, known)
    for k in range(2):
        state, _ = step(state, Frame(frame.image, frame.stamp + 0.03 * k, frame.sequence + k), tracker)
