"""The rig of a rolled ball: its axes by targets or gestures, its scale by lengths, targets and camera around it."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.ball.device import Device
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.pose import gather
from spheremouse.ball.rig import NO_TARGETS, UNKNOWN_READOUT, Ball, Rig, Targets
from spheremouse.calibrate.rolling.axes import Axes, axes_from_gestures, axes_from_rings, axes_from_targets
from spheremouse.calibrate.rolling.calibrate import Solution, Views
from spheremouse.calibrate.rolling.problem import RollingAdjustment
from spheremouse.errors import CalibrationError, PoseError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array, hat

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
    axes: Axes
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
        """Return the axes, with the covariance of the direction, and their source: targets, device or gestures."""
        self.check()
        axes, source = self._axes_and_source(rolled, views)
        return with_direction(axes, rolled), source

    def _axes_and_source(self, rolled: RollingAdjustment, views: Views) -> tuple[Axes, str]:
        """Return the axes of `obj` and their source: gestures, or ring targets. CalibrationError for grey pictures."""
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
        ball = place_camera(rolled, axes.find(rolled, views)[0])[1]
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
    scaled = _scaled(rolled, found, source, axes, radius)
    at_first = found.rotation @ rolled.rolling.attitude[0]
    seen = np.bincount(rolled.sightings.disc, minlength=len(rolled.rolling.discs))
    disc_map = DiscMap(rolled.rolling.discs, rolled.disc_covariance, seen).turned(at_first)
    readout, sigma = rolled.rolling.readout, rolled.readout_sigma
    known = sigma < _MAX_READOUT_SIGMA and readout > -2.0 * sigma
    rig = Rig(
        camera=axes.camera,
        ball=scaled.ball,
        targets=scaled.targets,
        disc_radius=solution.disc_angle * scaled.ball.radius,
        readout_s=(readout if readout > 2.0 * sigma else 0.0) if known else 0.0,
        readout_sigma_s=0.0 if known else UNKNOWN_READOUT,
        exposure_s=exposure_s,
        pose=scaled.pose,
        disc_directions=disc_map.directions,
        cross_covariance=scaled.cross,
        scale_free=scaled.free,
    )
    return RollingCalibration(rig, disc_map, found, source)


class _Scaled(NamedTuple):
    pose: Pose
    ball: Ball
    targets: Targets
    cross: Array | None  # (3n, 4) m², of targets with the ball
    free: bool  # without a unit


def _scaled(rolled: RollingAdjustment, found: Axes, source: str, axes: AxesFrom, given: float | None) -> _Scaled:
    """Scale by the length `given`, else by the targets, else in radii of the ball."""
    radius, sigma = (1.0, 0.0) if given is None else (given, TAPE * given)
    if source == "targets":
        assert axes.rig is not None
        targets = axes.rig.targets
        pose, ball = place_camera(rolled, found)
        if given is None:
            return _Scaled(pose, ball, targets, target_ball_covariance(found, ball.radius), axes.rig.scale_free)
        by_targets = ball
        pose, ball = place_camera(rolled, found, radius, sigma)
        if axes.rig.scale_free:
            return _Scaled(pose, ball, *rescale_targets(targets, by_targets, ball), free=False)
        check_radius(given, by_targets)
        return _Scaled(pose, ball, targets, cross=None, free=False)
    pose, ball = place_camera(rolled, found, radius, sigma)
    if source == "device" and given is not None:
        assert axes.device is not None
        return _Scaled(pose, ball, *place_targets(found, axes.device, rolled, radius, sigma), free=False)
    return _Scaled(pose, ball, NO_TARGETS, cross=None, free=given is None)


# ---- places with their joint covariances ----


def with_direction(axes: Axes, rolled: RollingAdjustment) -> Axes:
    """Return the axes with a covariance that includes the error of the direction to the ball's centre."""
    return replace(axes, covariance=_joint(rolled, axes)[:3, :3])


def _joint(rolled: RollingAdjustment, axes: Axes) -> Array:
    """Return the covariance, (8, 8), of axes (3), log distance (1), direction (3) and ratio (1).

    If `axes.parts` is None, it is block-diagonal, and the distance has no variance. Else all share the error of the
    lens.
    """
    C = np.zeros((8, 8))
    if axes.parts is None:
        C[:3, :3], C[4:, 4:] = axes.covariance, rolled.covariance
        return C
    by_place = np.eye(8, 4, -4)  # of direction and ratio
    by_place[:4, :3] = axes.parts.by_direction
    lens = by_place @ rolled.by_lens
    lens[:4] += axes.parts.by_lens
    C[:4, :4] = axes.parts.own
    return C + by_place @ (rolled.covariance - rolled.by_lens @ rolled.by_lens.T) @ by_place.T + lens @ lens.T


def place_camera(
    rolled: RollingAdjustment, axes: Axes, radius: float | None = None, radius_sigma: float = 0.0
) -> tuple[Pose, Ball]:
    """Return the camera's pose in `obj`, with the centre of the ball as origin, and the ball, with joint covariance.

    A known `radius` and its standard deviation, m, give the scale. Without them the scale is that of `axes.distance`,
    from the camera to the centre, which must be known. The ratio of distance and radius then gives the radius, and the
    camera's position does not depend on it.
    """
    rolling = rolled.rolling
    R, direction = axes.rotation, rolling.direction
    by_distance = radius is None
    if radius is None:
        assert axes.distance is not None
        radius = axes.distance / rolling.ratio
    P = -radius * rolling.ratio * (R @ direction)
    # of position (3), rotation (3) and radius, by axes (3), log distance, direction (3), ratio and known radius
    J = np.zeros((7, 9))
    J[:3, :3], J[3:6, :3] = -hat(P), np.eye(3)
    J[:3, 4:7] = -radius * rolling.ratio * R
    if by_distance:
        J[:3, 3] = P
        J[6, 3], J[6, 7] = radius, -radius / rolling.ratio
    else:
        J[:3, 7] = P / rolling.ratio
        J[:3, 8], J[6, 8] = P / radius, 1.0
    C = np.zeros((9, 9))
    C[:8, :8], C[8, 8] = _joint(rolled, axes), radius_sigma**2
    C = J @ C @ J.T
    C = 0.5 * (C + C.T)
    cross = np.zeros((6, 4))  # of the pose with the ball's centre (3), which is exact, and radius
    cross[:, 3] = C[:6, 6]
    return Pose(R, P, C[:6, :6], cross), Ball(radius, covariance=np.diag([0.0, 0.0, 0.0, C[6, 6]]))


def target_ball_covariance(axes: Axes, radius: float) -> Array:
    """Return the covariance of known targets with the ball's centre and radius, (3n, 4) m²."""
    assert axes.parts is not None
    cross = np.zeros((len(axes.parts.with_targets), 4))
    cross[:, 3] = radius * axes.parts.with_targets[:, 3]
    return cross


def rescale_targets(targets: Targets, free: Ball, ball: Ball) -> tuple[Targets, Array]:
    """Convert n targets of a free scale, in which the ball is `free`, to metres.

    The array is their covariance with the ball, (3n, 4) m², in the order of their own covariances.
    The correlation of ratio and targets is neglected, so the covariance is a little too large.
    """
    unit = ball.radius / free.radius
    by_length, by_free = ball.covariance[3, 3] / ball.radius**2, free.covariance[3, 3] / free.radius**2
    X = unit * targets.position
    x = X.ravel()
    C = unit**2 * targets.covariance + (by_length + by_free) * np.outer(x, x)
    cross = np.zeros((len(x), 4))
    cross[:, 3] = by_length * ball.radius * x
    return replace(targets, position=X, covariance=C, radii=unit * targets.radii), cross


def place_targets(
    axes: Axes, device: Device, rolled: RollingAdjustment, radius: float, radius_sigma: float
) -> tuple[Targets, Array]:
    """Convert the n measured targets of `axes` from `cam` to `obj`, whose origin is the ball's centre.

    Return them, and their covariance with the ball's centre (3), which is exact, and radius (1), (3n, 4) m². `radius`
    and `radius_sigma` are in m. Errors that targets and rolling share through the lens are correlated.
    """
    measured = axes.targets
    assert measured is not None
    c, ratio, R = rolled.rolling.direction, rolled.rolling.ratio, axes.rotation
    X = (measured.position - radius * ratio * c) @ R.T
    n = len(X)
    # Jacobian of the targets in obj, by the targets in cam (3n), axes (3), direction (3), ratio and radius
    by_centre = np.column_stack([-radius * ratio * R, -radius * (R @ c), -ratio * (R @ c)])
    J = np.hstack([np.kron(np.eye(n), R), -hat(X).reshape(-1, 3), np.tile(by_centre, (n, 1))])
    C = np.zeros((3 * n + 8, 3 * n + 8))
    C[: 3 * n + 3, : 3 * n + 3] = measured.covariance
    C[3 * n + 3 : 3 * n + 7, 3 * n + 3 : 3 * n + 7] = rolled.covariance
    shared = measured.by_lens @ rolled.by_lens.T
    C[: 3 * n + 3, 3 * n + 3 : 3 * n + 7], C[3 * n + 3 : 3 * n + 7, : 3 * n + 3] = shared, shared.T
    C[-1, -1] = radius_sigma**2
    cross = np.zeros((3 * n, 4))
    cross[:, 3] = J[:, -1] * radius_sigma**2
    number: dict[str, int] = dict(zip(device.codes, device.ids, strict=True))
    ids = tuple(number[code] for code in measured.codes)
    return Targets(ids, measured.codes, X, J @ C @ J.T, np.asarray(device.target_radii, dtype=float)), cross
