"""Pictures full of what has the targets' colours and shapes, as large as a camera gives: thousands of spots."""

from dataclasses import dataclass

import cv2
import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from spheremouse.ball.detect.rings import MOST, RingSettings, detect_targets
from spheremouse.ball.pose import find_pose
from spheremouse.ball.rig import CODES
from tests.fuzz.scene import small_rig
from tests.fuzz.targets import refused, target

_RADII = np.array([0.012, 0.024, 0.036])
_INKS = np.array([(205, 190, 30), (170, 40, 190), (40, 205, 215), (200, 200, 200)], dtype=np.uint8)


@dataclass(frozen=True)
class Clutter:
    """How such a picture is made: small to print, whatever its size."""

    kind: str
    size: tuple[int, int]
    pitch: int  # px, of one spot or stripe
    seed: int

    def picture(self) -> NDArray[np.uint8]:
        """(h, w, 3) BGR."""
        (w, h), pitch, rng = self.size, self.pitch, np.random.default_rng(self.seed)
        image = np.full((h, w, 3), 200, np.uint8)
        across, down = -(-w // pitch), -(-h // pitch)
        match self.kind:
            case "dots":
                for _ in range(min(across * down, 10_000)):
                    _dot(image, (int(rng.integers(w)), int(rng.integers(h))), int(rng.integers(1, pitch + 1)), rng)
            case "targets":
                for k in range(across * down):
                    centre = (k % across * pitch + pitch // 2, k // across * pitch + pitch // 2)
                    for ink, share in zip(rng.permutation(3), (0.48, 0.32, 0.16), strict=True):
                        cv2.circle(image, centre, round(share * pitch), _INKS[ink].tolist(), -1, cv2.LINE_AA)
            case "within one another":
                for k, radius in enumerate(range(max(w, h), 1, -pitch)):
                    cv2.circle(image, (w // 2, h // 2), radius, _INKS[k % 3].tolist(), -1)
            case "noise":
                image = (
                    rng.integers(0, 256, (down, across, 3), dtype=np.uint8).repeat(pitch, 0).repeat(pitch, 1)[:h, :w]
                )
            case "cells":
                image = _INKS[rng.integers(0, 4, (down, across))].repeat(pitch, 0).repeat(pitch, 1)[:h, :w]
            case "stripes":
                image = np.broadcast_to(_INKS[np.arange(w) // pitch % 3], (h, w, 3))
            case _:
                soft = cv2.GaussianBlur(rng.normal(size=(h, w, 3)), (0, 0), 0.4 * pitch)
                image = np.clip(128.0 + 90.0 * soft / soft.std(), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(image)


_KINDS = ("dots", "targets", "within one another", "noise", "cells", "stripes", "photo")


def _dot(image: NDArray[np.uint8], centre: tuple[int, int], radius: int, rng: np.random.Generator) -> None:
    cv2.circle(image, centre, radius, _INKS[rng.integers(0, 3)].tolist(), -1, cv2.LINE_AA)


@target(
    "clutter pictures",
    lambda: st.builds(
        Clutter,
        st.sampled_from(_KINDS),
        st.sampled_from([(160, 120), (640, 480), (1920, 1080)]),
        st.integers(2, 40),
        st.integers(0, 2**32 - 1),
    ),
)
def check_clutter(clutter: Clutter) -> None:
    image = clutter.picture()
    found = detect_targets(image, _RADII, RingSettings())
    assert len(found) == len(found.radius) == len(found.contours) <= MOST * len(CODES)
    assert np.all(np.isfinite(found.centre))
    assert np.all(found.radius > 0)
    refused(lambda: find_pose([found] * 2, small_rig(), image))
