"""The rig of a rolled ball: its axes by targets or gestures, its scale by lengths, targets and camera around it."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.ball.device import Device
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.pose import gather
from spheremouse.ball.rig import NO_TARGETS, UNKNOWN_READOUT, Ball, Rig, Targets
from spheremouse.calibrate.rolling.axes import (
    Axes,
    axes_from_gestures,
    axes_from_rings,
    axes_from_targets,
    jacobian,
)
from spheremouse.calibrate.rolling.calibrate import Solution, Views
from spheremouse.calibrate.rolling.problem import RollingAdjustment
from spheremouse.errors import CalibrationError, PoseError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array, exp, log

TAPE = 0.002  # relative error of a length that a person measures on a ball; balls are not rounder

_MAX_DEVIATION = 5.0  # standard deviations of a given radius from that by the targets
_FIRST_ERROR = 0.1  # relative error of the radius after the first pass, which estimates the disc size from images
_MAX_READOUT_SIGMA = 1e-3  # s, of a readout that goes into the rig


class Lengths(NamedTuple):
    """Lengths that a person measured, m."""

    radius: float | None  # of the ball
    disc_radius: float | None


class RollingCalibration(NamedTuple):
    """Result of a rolled calibration."""

    rig: Rig
    disc_map: DiscMap
    source: str  # of the axes: targets, device or gestures


# ---- axes ----


@dataclass(frozen=True, slots=True)
class AxesFrom:
    """Sources of the axes; the first one given counts: gestures, device, rig."""

    rig: Rig | None  # its targets, their radii and the discs' radius
    device: Device | None
    gestures: tuple[tuple[float, float], tuple[float, float]] | None  # s from the first frame
    camera: InteriorOrientation

    @property
    def known(self) -> bool:
        """True with any source."""
        return self.rig is not None or self.device is not None or self.gestures is not None

    @property
    def disc_radius(self) -> float | None:
        """Radius of a disc by device or rig, m; None without both, or if they do not give it."""
        if self.device is not None:
            return self.device.disc_radius
        return None if self.rig is None else self.rig.disc_radius

    def check(self) -> None:
        """Raise CalibrationError without any source."""
        if not self.known:
            raise CalibrationError(
                "the direction of up is unknown: give --device device.yaml or --rig rig.yaml if targets are in view, "
                "or roll the ball forward, then right, and give the times with --forward A:B --right A:B"
            )

    def find(self, rolled: RollingAdjustment, views: Views) -> tuple[Axes, str]:
        """Return the axes of `obj` and their source: targets, device or gestures.

        Raises CalibrationError without a source, or for grey pictures of targets.
        """
        self.check()
        if self.gestures is not None:
            assert views.first is not None
            begin = views.first
            forward, right = ((a + begin, b + begin) for a, b in self.gestures)
            return axes_from_gestures(rolled.rolling, forward, right), "gestures"
        if not views.colour:
            raise CalibrationError(
                "the pictures are grey: targets need colour; roll two gestures (--forward, --right) instead"
            )
        if self.device is not None:
            seen = _detect(views, self.device.target_radii)
            return axes_from_rings(_sizes(seen), self.device, self.camera), "device"
        assert self.rig is not None
        seen = _detect(views, self.rig.targets.radii)
        try:
            return axes_from_targets(gather(seen), self.rig, rolled.rolling), "targets"
        except PoseError as e:
            raise CalibrationError(str(e)) from None


def _detect(views: Views, radii: np.ndarray) -> list[TargetDetections]:
    return [detect_targets(image, radii, RingSettings()) for image in views.colour]


def _sizes(views: list[TargetDetections]) -> list[tuple[str, np.ndarray, float]]:
    """Return code, centre and size of each target that does not move; of several copies the largest."""
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


# ---- lengths ----


def disc_angle(lengths: Lengths, axes: AxesFrom, rolled: RollingAdjustment, views: Views) -> float | None:
    """Return a disc's radius over the ball's, by lengths or targets; None if neither gives it."""
    radius = lengths.radius
    if axes.rig is not None and axes.device is None and axes.gestures is None:
        ball = place(rolled, axes.find(rolled, views)[0], None).ball
        if radius is not None and not axes.rig.scale_free:
            check_radius(radius, ball, _FIRST_ERROR)
        if radius is None or (axes.rig.scale_free and lengths.disc_radius is None):
            radius = ball.radius
    disc = lengths.disc_radius or axes.disc_radius
    return None if disc is None or radius is None else disc / radius


def check_radius(radius: float, ball: Ball, error: float = 0.0) -> None:
    """Raise CalibrationError if a given radius contradicts that by the targets by more than a relative `error`."""
    sigma = float(ball.covariance[3, 3]) ** 0.5
    if abs(radius - ball.radius) <= max(error * ball.radius, _MAX_DEVIATION * np.hypot(TAPE * radius, sigma)):
        return
    raise CalibrationError(
        f"the ball's radius is given as {radius:.4g} m, but the targets of the rig put it at {ball.radius:.4g} m: give "
        "the radius and no diameter, or leave the length out"
    )


# ---- the rig ----


def build_rig(solution: Solution, axes: AxesFrom, radius: float | None, exposure_s: float) -> RollingCalibration:
    """Build the rig in the axes found; `radius` of the ball, m, if a person measured it."""
    rolled = solution.rolled
    found, source = axes.find(rolled, solution.views)
    free = source == "targets" and axes.rig is not None and axes.rig.scale_free  # the scale of the targets
    if source == "targets" and radius is not None and not free:
        check_radius(radius, place(rolled, found, None).ball)
    placed = place(rolled, found, radius, rescaled=free)
    has_targets = bool(found.targets.ids) and (source == "targets" or radius is not None)
    at_first = found.rotation @ rolled.rolling.attitude[0]
    disc_map = _map(rolled, placed.ball.radius).turned(at_first)
    readout, sigma = rolled.rolling.readout, rolled.readout_sigma
    known = sigma < _MAX_READOUT_SIGMA and readout > -2.0 * sigma
    rig = Rig(
        camera=axes.camera,
        ball=placed.ball,
        targets=placed.targets if has_targets else NO_TARGETS,
        disc_radius=solution.disc_angle * placed.ball.radius,
        readout_s=(readout if readout > 2.0 * sigma else 0.0) if known else 0.0,
        readout_sigma_s=0.0 if known else UNKNOWN_READOUT,
        exposure_s=exposure_s,
        pose=placed.pose,
        disc_directions=disc_map.directions,
        cross_covariance=placed.cross if has_targets and np.any(placed.cross) else None,
        scale_free=radius is None and (source != "targets" or free),
    )
    return RollingCalibration(rig, disc_map, source)


def _map(rolled: RollingAdjustment, radius: float) -> DiscMap:
    """Return the map of a ball of `radius` m, with its eccentricity if that is significant."""
    seen = np.bincount(rolled.sightings.disc, minlength=len(rolled.rolling.discs))
    found = DiscMap(rolled.rolling.discs, rolled.disc_covariance, seen)
    if not rolled.is_eccentric:
        return found
    return found.with_centre(radius * rolled.rolling.eccentricity, radius**2 * rolled.eccentricity_covariance)


class Placed(NamedTuple):
    """Camera, ball and n targets in `obj`, whose origin is the ball's centre, with their joint covariance."""

    pose: Pose
    ball: Ball
    targets: Targets
    cross: Array  # (3n, 4) m², of the targets with the ball's centre, which is exact, and radius


def place(rolled: RollingAdjustment, axes: Axes, radius: float | None, *, rescaled: bool = False) -> Placed:
    """Return camera, ball and targets with their joint covariance, by central differences.

    A `radius`, m, that a person measured gives the scale. Without it, the distance of the axes does, else the radius is
    1. The scale of `rescaled` targets is free, and the radius replaces it.
    """
    rolling, targets = rolled.rolling, axes.targets

    def scales(e: Array) -> tuple[float, float]:
        """Return the ball's radius, m, and the factor on the targets, for the errors of `values`."""
        by_distance = 1.0 if axes.distance is None else axes.distance * np.exp(e[3]) / (rolling.ratio + e[-2])
        if radius is None:
            return by_distance, 1.0
        return radius + e[-1], (radius + e[-1]) / by_distance if rescaled and axes.distance is not None else 1.0

    def values(e: Array) -> Array:
        """Camera's position and turn, radius, and targets, (7 + 3n,), for errors of axes, direction, ratio, radius."""
        R, (length, factor) = exp(e[:3]) @ axes.rotation, scales(e)
        centre = length * (rolling.ratio + e[-2]) * (rolling.direction + e[-5:-2])  # in cam
        places = targets.position + e[4:-5].reshape(-1, 3)
        places = (places - centre) @ R.T if axes.distance is None else factor * places
        return np.concatenate([-R @ centre, log(R @ axes.rotation.T), [length], places.ravel()])

    exact = np.zeros(len(axes.own) + 5)
    J, found = jacobian(values, exact), values(exact)
    C = J @ _joint(rolled, axes, 0.0 if radius is None else TAPE * radius) @ J.T
    C = 0.5 * (C + C.T)
    with_ball = np.zeros((len(C), 4))
    with_ball[:, 3] = C[:, 6]
    targets = replace(
        targets,
        position=found[7:].reshape(-1, 3),
        covariance=C[7:, 7:],
        radii=scales(exact)[1] * targets.radii,
    )
    ball = Ball(float(found[6]), covariance=np.diag([0.0, 0.0, 0.0, C[6, 6]]))
    return Placed(Pose(axes.rotation, found[:3], C[:6, :6], with_ball[:6]), ball, targets, with_ball[7:])


def _joint(rolled: RollingAdjustment, axes: Axes, radius_sigma: float) -> Array:
    """Return the covariance, (k + 5, k + 5), of the k errors of the axes, direction (3), ratio and known radius.

    All but the known radius share the error of the lens, and the axes have that of the direction.
    """
    k = len(axes.own)
    by_place = np.eye(k + 5, 4, -k)  # of direction and ratio
    by_place[:k, :3] = axes.by_direction
    lens = by_place @ rolled.by_lens
    lens[:k] += axes.by_lens
    C = by_place @ (rolled.covariance - rolled.by_lens @ rolled.by_lens.T) @ by_place.T + lens @ lens.T
    C[:k, :k] += axes.own
    C[-1, -1] += radius_sigma**2
    return C
