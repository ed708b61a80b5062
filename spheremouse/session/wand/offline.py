"""One run of the wand's tracker from the first frame to the last, timed: frames in, runs for the metrics out.

The shell's part of the wand's use phase, as `session` is for the ball in its frame. Printing is its callers' matter.
"""

import time
from collections.abc import Callable, Iterable, Iterator

from spheremouse.compiling import told
from spheremouse.errors import SourceError
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame, check_size
from spheremouse.wand.state import WandEpoch, WandState, WandTracker
from spheremouse.wand.track import begin, step
from spheremouse.wand.warm import warm_up

_NO_HUE = ("dark", "light")  # colours that grey frames show as well

Known = dict[int, tuple[Array, Array]]  # position and rotation of balls, by their index


def make_wand_ready(tell: Callable[[str], None] | None = None) -> None:
    """Compile the functions of tracking, or read them from disk, with progress (`compiling.told`)."""
    with told(tell):
        warm_up()


def track_wand(
    frames: Iterable[Frame], tracker: WandTracker, seed: int = 0, known: Known | None = None
) -> Iterator[WandEpoch]:
    """Track every frame; `known` are poses of balls at the first one. The times exclude compilation."""
    make_wand_ready()
    state: WandState | None = None
    for frame in frames:
        check_wand_frame(frame, tracker)
        state = state or begin(tracker, seed, frame.stamp, known)
        start = time.perf_counter()
        state, estimate, _ = step(state, frame, tracker)
        yield WandEpoch(frame, state, estimate, time.perf_counter() - start)


def check_wand_frame(frame: Frame, tracker: WandTracker) -> None:
    """SourceError where a frame is of another size than the camera's, or has no colour, which the balls need."""
    check_size(frame, tracker.camera)
    if frame.image.ndim == 2 and (paints := [c for c in tracker.names if c not in _NO_HUE]):
        raise SourceError(
            f"the frames are grey, and the ball has {' and '.join(paints)} discs: use a camera in colour, or a ball "
            "in dark and light"
        )
