"""What is seen in a picture that may become a photo, and what a judge of such pictures can be asked.

A picture is taken when it is sharp, what it shows stands still, and it shows what no photo has shown.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.geometry.rotation import Array

STILL = 1.0  # px between two frames: motion in the exposure is then a part of that
_DARK = 40  # grey values: where hardly a pixel is brighter, neither paper nor ball can be seen


@dataclass(frozen=True, slots=True)
class Look:
    """A picture as judged; to be taken where it has a gain."""

    seen: object  # by which its judge counts it
    words: str  # what is seen, and what hinders it
    gain: str = ""  # what it adds


class Judge(Protocol):
    """Judges pictures beside the photos there are."""

    @property
    def count(self) -> int:
        """Photos that count."""
        ...

    @property
    def enough(self) -> bool:
        """Nothing more is wanted."""
        ...

    def look(self, picture: Image) -> Look:
        """Judge the next frame of a camera."""
        ...

    def resume(self, read: Callable[[], Image]) -> bool:
        """Count a photo that is there, whatever it adds; False where it shows nothing of use."""
        ...

    def add(self, look: Look, read: Callable[[], Image]) -> None:
        """Count a picture that was looked at and is a photo now, which `read` gives again."""
        ...

    def pending_work(self) -> Callable[[], None] | None:
        """What is to be calculated about the photos so far and takes long, if anything; for any thread, one at a time.

        Its outcome is in what is asked afterwards.
        """
        ...

    def wanted(self) -> list[str]:
        """What to do, the most important first; empty where nothing in particular is missing."""
        ...

    def status(self) -> list[str]:
        """How far it is, in lines."""
        ...


class Motion:
    """Whether marked points stand still from frame to frame."""

    def __init__(self, fewest: int) -> None:
        self._fewest, self._before = fewest, {}

    def since_last(self, keys: Sequence[int | str], uv: Array) -> float:
        """px that points of these names moved since the frame before, median; inf where too few were seen twice."""
        before, self._before = self._before, dict(zip(keys, uv, strict=True))
        moved = [float(np.linalg.norm(at - before[key])) for key, at in self._before.items() if key in before]
        return float(np.median(moved)) if len(moved) >= self._fewest else float("inf")


def moving(moved: float) -> str:
    """Words for what does not stand still."""
    return f"moves by {moved:.0f} px from frame to frame: hold still" if np.isfinite(moved) else "hold still"


def is_dark(picture: Image) -> bool:
    """Whether nothing can be seen in it: a lens cap, a room without light."""
    return float(np.percentile(picture[::8, ::8], 99.0)) < _DARK
