"""The ball in its frame as recordings and snapshots have it: the device, the camera's pose, and nothing of people."""

from dataclasses import dataclass, replace
from typing import Any

from spheremouse.ball.rig import Rig
from spheremouse.ball.state import Epoch, Tracker, current
from spheremouse.files.dataset.write import device_description
from spheremouse.files.rig import rig_text
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.session.ball.privacy import kept, masked
from spheremouse.session.messages import found
from spheremouse.session.overlay.ball import Overlay, target_marks
from spheremouse.session.overlay.pen import Image, in_blocks
from spheremouse.session.overlay.sight import draw_sight, sight_of
from spheremouse.session.settings import Configuration
from spheremouse.session.settings.replay import configuration_text


@dataclass(frozen=True, eq=False)
class BallSubject:
    """A device seen from a pose, tracked by these settings."""

    rig: Rig
    pose: Pose
    settings: Configuration
    parts = "the ball and the targets"

    @property
    def camera(self) -> InteriorOrientation:
        """The rig's camera."""
        return self.rig.camera

    @property
    def view(self) -> Pose:
        """The camera's pose."""
        return self.pose

    def kept(self) -> Image:
        """The ball, the targets, and the reach of what finds them."""
        return kept(self.rig, self.pose, self.settings)

    def scene(self) -> dict[str, Any]:
        """The device and the pose, without covariances."""
        return {**device_description(self.rig), "T_obj_cam": self.pose.matrix().tolist()}

    def files(self) -> dict[str, str]:
        """The rig with its pose, to the last bit, and the configuration."""
        return {
            "rig.yaml": rig_text(replace(self.rig, pose=self.pose)),
            "config.yaml": configuration_text(self.settings),
        }


def picture(
    epoch: Epoch, tracker: Tracker, counts: tuple[int, int, int] = (0, 0, 0), *, everything: bool = False
) -> Image:
    """An epoch's picture with what the tracker makes of it; black but for ball and targets unless `everything`.

    Takes some hundredths of a second; the epoch's image must stay as it is meanwhile. `counts` is their sum so far.
    """
    tracker = current(epoch.state, tracker)
    keep = None if everything else kept(tracker.rig, tracker.pose, tracker.settings)
    shown = replace(epoch, frame=replace(epoch.frame, image=masked(epoch.frame.image, keep)))
    overlay = Overlay(
        tracker, target_marks(tracker.rig, tracker.pose, None), max(1, round(1280 / tracker.rig.camera.width))
    )
    overlay.remember(shown.state)
    return overlay.draw(shown, counts)


def sought(image: Image, rig: Rig, settings: Configuration, *, everything: bool = False) -> Image:
    """A picture in which the rig's targets are looked for, with what is found, and what is not and why.

    In coarse blocks but for that, unless `everything`. Takes some tenths of a second; the image must stay as it is.
    """
    sight = sight_of(image, rig.targets.radii, rig.targets.codes, settings.rings)
    shown = image if everything else in_blocks(image, sight.kept(image.shape[:2]))
    return draw_sight(shown, sight, ((found(sight.targets.codes, rig.targets.codes), 0.012),))
