"""Track a recording of balls in a hand from its first frame to its last, and measure times."""

import time
from collections.abc import Iterable, Iterator

from spheremouse.errors import SourceError
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame, check_size
from spheremouse.wand.state import WandEpoch, WandState, WandTracker
from spheremouse.wand.track import begin, step

_NO_HUE = ("dark", "light")  # colours that grey frames show as well

Known = dict[int, tuple[Array, Array]]  # position and rotation of balls, by their index


def track_wand(
    frames: Iterable[Frame], tracker: WandTracker, seed: int = 0, known: Known | None = None
) -> Iterator[WandEpoch]:
    """Track every frame; `known` has the poses of balls at the first one."""
    state: WandState | None = None
    for frame in frames:
        check_wand_frame(frame, tracker)
        state = state or begin(tracker, seed, frame.stamp, known)
        start = time.perf_counter()
        state, estimate, _ = step(state, frame, tracker)
        yield WandEpoch(frame, state, estimate, time.perf_counter() - start)


def check_wand_frame(frame: Frame, tracker: WandTracker) -> None:
    """Raise SourceError if a frame has another size than the camera's, or lacks the colour that the balls need."""
    check_size(frame, tracker.camera)
    if frame.image.ndim == 2 and (paints := [c for c in tracker.names if c not in _NO_HUE]):
        raise SourceError(
            f"the frames are grey, and the ball has {' and '.join(paints)} discs: use a camera in colour, or a ball "
            "in dark and light"
        )
