"""Where the axes of a rolled calibration come from: known targets, targets of a device file, or two gestures."""

from dataclasses import dataclass

import numpy as np

from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.ball.device import Device
from spheremouse.ball.pose import gather
from spheremouse.ball.rig import Rig
from spheremouse.calibrate.rolling.axes import Axes, axes_from_gestures, axes_from_targets
from spheremouse.calibrate.rolling.axes_from_rings import axes_from_rings
from spheremouse.calibrate.rolling.calibrate import Views
from spheremouse.calibrate.rolling.problem import Rolled
from spheremouse.errors import CalibrationError, PoseError
from spheremouse.geometry.camera import InteriorOrientation


@dataclass(frozen=True, slots=True)
class AxesFrom:
    """Ways to find the axes; the first that is given is taken: gestures, device, rig."""

    rig: Rig | None  # of which targets, their radii and the discs' radius are used
    device: Device | None
    gestures: tuple[tuple[float, float], tuple[float, float]] | None  # s from the first frame
    camera: InteriorOrientation

    @property
    def known(self) -> bool:
        """Is there any way to the axes?"""
        return self.rig is not None or self.device is not None or self.gestures is not None

    @property
    def disc_radius(self) -> float | None:
        """m, where the one or other says it."""
        if self.device is not None:
            return self.device.disc_radius
        return None if self.rig is None else self.rig.disc_radius

    def check(self) -> None:
        """CalibrationError where nothing fixes the axes."""
        if not self.known:
            raise CalibrationError(
                "nothing says which way is up: give --device device.yaml or --rig rig.yaml where targets are in view, "
                "or roll the ball forward, then right, and say when with --forward A:B --right A:B"
            )

    def find(self, rolled: Rolled, views: Views) -> tuple[Axes, str]:
        """Axes, and their source: targets, device or gestures."""
        self.check()
        if self.gestures is not None:
            assert views.first is not None
            begin = views.first
            spans = [(a + begin, b + begin) for a, b in self.gestures]
            return axes_from_gestures(rolled.rolling, spans[0], spans[1]), "gestures"
        if not views.colour:
            raise CalibrationError(
                "the pictures are grey: targets need colour; roll two gestures (--forward, --right) instead"
            )
        if self.device is not None:
            seen = _seen(views, self.device.target_radii)
            return axes_from_rings(_sizes(seen), self.device, self.camera), "device"
        assert self.rig is not None
        seen = _seen(views, self.rig.targets.radii)
        try:
            return axes_from_targets(gather(seen), self.rig, rolled.rolling), "targets"
        except PoseError as e:
            raise CalibrationError(str(e)) from None


def _seen(views: Views, radii: np.ndarray) -> list[TargetDetections]:
    return [detect_targets(image, radii, RingSettings()) for image in views.colour]


def _sizes(views: list[TargetDetections]) -> list[tuple[str, np.ndarray, float]]:
    """Code, place and size of each target that keeps its place; of copies in the room the largest."""
    found: dict[str, tuple[str, np.ndarray, float]] = {}
    for s in gather(views):
        radii = [
            float(r)
            for v in views
            for code, centre, r in zip(v.codes, v.centre, v.radius, strict=True)
            if code == s.code and np.linalg.norm(centre - s.centre) < 2.0
        ]
        size = float(np.median(radii))
        if s.code not in found or size > found[s.code][2]:
            found[s.code] = (s.code, s.centre, size)
    return list(found.values())
