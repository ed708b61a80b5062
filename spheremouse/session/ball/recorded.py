"""Mask the pictures of recordings and snapshots so that they show the ball and the targets, and no people.

A masked recording keeps the pixels that the tracker reads while it has the camera's pose. Tracking it therefore gives
the same result bit for bit. It keeps the pixels that the detector reads (`ball/detect/support.py`). Around each target
it keeps the patch that monitors the camera, a few pixels for a push, and the margin of the ring detector.

A search of all targets by their colours, after a large bump, reads the whole picture. It does not work on a masked
recording.
"""

from dataclasses import replace

from spheremouse.ball import camera_watch as watch
from spheremouse.ball.build import check_view, detector_of
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.files.dataset.write import device_description
from spheremouse.files.rig import rig_text
from spheremouse.geometry.camera import Pose
from spheremouse.session.messages import list_targets
from spheremouse.session.overlay.pen import Image, in_blocks
from spheremouse.session.overlay.sight import draw_sight, sight_of
from spheremouse.session.settings import Configuration, configuration_text
from spheremouse.session.tracker_adapter import Subject

_SEARCH_REACH_PX = 3  # px of a target's reduced patch: its search window in an ordinary check (watch)
_RING_MARGIN_PX = 6  # px, and a quarter of the patch: around a target whose rings are measured (watch)


def recorded_mask(rig: Rig, pose: Pose, settings: Settings) -> Image:
    """Return the mask of a recording, (h, w) uint8: 255 for pixels that it keeps, 0 for black ones.

    It holds for a camera pose and a tracker with these settings. Raises PoseError if the ball is not in view.
    """
    check_view(rig, pose)
    mask = detector_of(rig, settings).support_mask(rig, pose, settings)
    for left, top, right, bottom in _target_boxes(rig, pose):
        mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = 255
    return mask


def _target_boxes(rig: Rig, pose: Pose) -> list[tuple[int, int, int, int]]:
    """Return the box (left, top, right, bottom) in px of each monitored target; right and bottom are exclusive."""
    watched = watch.begin(rig, pose)
    if watched is None:
        return []
    boxes = []
    for (x, y), size, reduction in zip(watched.corner, watched.size, watched.reduction, strict=True):
        if size:
            margin = int(_SEARCH_REACH_PX * reduction + size // 4 + _RING_MARGIN_PX)
            boxes.append((int(x) - margin, int(y) - margin, int(x + size) + margin, int(y + size) + margin))
    return boxes


def ball_subject(rig: Rig, pose: Pose, settings: Configuration) -> Subject:
    """Return the subject of a recording: the device with the camera's pose to the last bit, but not its covariance."""
    return Subject(
        camera=rig.camera,
        view=pose,
        parts="the ball and the targets",
        kept=lambda: recorded_mask(rig, pose, settings),
        scene=lambda: {**device_description(rig), "T_obj_cam": pose.matrix().tolist()},
        files=lambda: {"rig.yaml": rig_text(replace(rig, pose=pose)), "config.yaml": configuration_text(settings)},
    )


def draw_target_search(image: Image, rig: Rig, settings: Configuration, *, everything: bool = False) -> Image:
    """Draw the targets that are found in a picture, and the rejected candidates with the reason.

    The rest is in coarse blocks, unless `everything`. It takes some tenths of a second, in which the image must not
    change.
    """
    sight = sight_of(image, rig.targets.radii, rig.targets.codes, settings.rings)
    shown = image if everything else in_blocks(image, sight.kept(image.shape[:2]))
    return draw_sight(shown, sight, ((list_targets(sight.targets.codes, rig.targets.codes), 0.012),))
