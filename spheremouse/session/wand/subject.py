"""Hand-held balls as recordings and snapshots have them: the camera, the balls, and who holds them."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from spheremouse.files.dataset.format import BALL_FILES
from spheremouse.files.dataset.wand import wand_scene
from spheremouse.files.wand import wand_text
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.conics import sphere_outline
from spheremouse.output.pointer import Counts
from spheremouse.session.overlay.pen import Image
from spheremouse.session.overlay.wand import WandOverlay
from spheremouse.session.settings import Configuration
from spheremouse.session.settings.replay import configuration_text
from spheremouse.wand.state import WandEpoch, WandTracker

_AROUND = 1.25  # radii of the ball that a snapshot shows: as far as a pose may be off


@dataclass(frozen=True, eq=False)
class WandSubject:
    """Balls before a camera, tracked by these settings."""

    tracker: WandTracker
    settings: Configuration
    parts = ""  # all of each picture is searched

    @property
    def camera(self) -> InteriorOrientation:
        """The one that the poses are of."""
        return self.tracker.camera

    @property
    def view(self) -> InteriorOrientation:
        """Return the camera, whatever its place."""
        return self.camera

    def kept(self) -> Image:
        """All of it."""
        return np.full((self.camera.height, self.camera.width), 255, dtype=np.uint8)

    def scene(self) -> dict[str, Any]:
        """The camera and the balls."""
        return wand_scene(self.camera, self.tracker.balls)

    def files(self) -> dict[str, str]:
        """A wand file of each ball, and the configuration that names them."""
        balls = {
            name: wand_text(ball, {c: self.tracker.colours[c] for c in ball.colours})
            for name, ball in zip(BALL_FILES, self.tracker.balls, strict=False)
        }
        wand = replace(self.settings.wand, balls=tuple(balls), axes=None)
        return {**balls, "config.yaml": configuration_text(self.settings, wand=wand)}


def picture(
    epoch: WandEpoch, image: Image, tracker: WandTracker, points: int, counts: Counts, *, everything: bool = False
) -> Image:
    """An epoch's `image` with what the tracker makes of it; black but about the balls seen unless `everything`."""
    if not everything:
        keep = np.zeros(image.shape[:2], dtype=np.uint8)
        for ball, pose in zip(tracker.balls, epoch.poses, strict=True):
            if pose.seen and pose.position is not None and pose.position[2] > _AROUND * ball.radius:
                around = sphere_outline(pose.position, _AROUND * ball.radius, tracker.camera)
                cv2.fillPoly(keep, [np.rint(around[np.isfinite(around).all(axis=1)]).astype(np.int32)], 255)
        image = np.asarray(cv2.copyTo(image, keep), dtype=np.uint8)
    shown = replace(epoch, frame=replace(epoch.frame, image=image))
    overlay = WandOverlay(tracker, points, max(1, round(1280 / tracker.camera.width)))
    overlay.remember(shown)
    return overlay.draw(shown, counts)
