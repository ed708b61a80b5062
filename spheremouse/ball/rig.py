"""The rig: all calibrated parameters of a device, with covariances, from calibration or from a dataset."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array

COLOURS = "CMY"
CODES = ("CMY", "CYM", "MCY", "MYC", "YCM", "YMC")  # inside to outside
MAX_DISCS = 250  # on a ball: two fingers apart on the smallest; the filter's time grows with their square
UNKNOWN_READOUT = 0.015  # s: none with a global shutter, up to 30 ms with a slow rolling one


@dataclass(frozen=True, slots=True)
class Ball:
    """The sphere, in `obj`. Its centre is the origin by definition.

    After calibration the targets' coordinates, relative to the centre, contain its uncertainty (Wittich 2017,
    eq. 91-92). Then `covariance` here contains the radius alone.
    """

    radius: float  # m, or 1.0 where the scale is free
    centre: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m
    covariance: Array = field(default_factory=lambda: np.zeros((4, 4)))  # (4, 4) m², centre x, y, z and radius


@dataclass(frozen=True, slots=True)
class Targets:
    """Ring targets on the frame; their circles face one direction."""

    ids: tuple[int, ...]
    codes: tuple[str, ...]  # colours inside to outside, one of CODES each
    position: Array  # (n, 3) m, obj
    covariance: Array  # (3n, 3n) m², obj, of x, y, z of the first, x, y, z of the second, ...
    radii: Array  # (3,) m: inner disc, middle ring, outer ring
    normal: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))  # (3,) unit vector that they face, obj


NO_TARGETS = Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3))


@dataclass(frozen=True, slots=True)
class Rig:
    """A device: camera, ball, frame targets, and parameters of its discs."""

    camera: InteriorOrientation
    ball: Ball
    targets: Targets
    disc_radius: float | None  # m, along the ball's surface; None: a ball without discs
    readout_s: float = 0.0  # s, time a rolling shutter takes over all rows
    readout_sigma_s: float = 0.0  # s, its standard deviation; UNKNOWN_READOUT without a measurement
    exposure_s: float = 0.0  # s, time the shutter is open; 0 where it is short or unknown
    pose: Pose | None = None  # camera pose where it is known beforehand: no targets are needed then
    disc_directions: Array | None = None  # (m, 3) unit vectors in ball, a disc map made earlier
    cross_covariance: Array | None = None  # (3n, 4) m², targets' coordinates with the ball's centre, radius; None: zero
    scale_free: bool = False  # lengths are not in metres but in a unit of their own, such as the ball's radius

    @property
    def disc_angle(self) -> float:
        """rad, from the centre of a disc to its edge, seen from the ball's centre. The ball must have discs."""
        assert self.disc_radius is not None
        return self.disc_radius / self.ball.radius

    @property
    def radius_m(self) -> float | None:
        """m, of the ball; None without a measured length."""
        return None if self.scale_free else self.ball.radius


def in_metres(rig: Rig, unit: float) -> Rig:
    """Return the rig in metres, from a rig with lengths in a unit of `unit` m."""
    to_metres = np.repeat([unit, 1.0], 3)  # of a pose: position, rotation
    pose, targets = rig.pose, rig.targets
    if pose is not None:
        pose = replace(
            pose,
            position=unit * pose.position,
            covariance=pose.covariance * np.outer(to_metres, to_metres),
            ball_covariance=pose.ball_covariance * to_metres[:, None] * unit,
            by_focal=pose.by_focal * to_metres,
        )
    return replace(
        rig,
        ball=Ball(unit * rig.ball.radius, unit * rig.ball.centre, unit**2 * rig.ball.covariance),
        targets=replace(
            targets,
            position=unit * targets.position,
            covariance=unit**2 * targets.covariance,
            radii=unit * targets.radii,
        ),
        disc_radius=None if rig.disc_radius is None else unit * rig.disc_radius,
        pose=pose,
        cross_covariance=None if rig.cross_covariance is None else unit**2 * rig.cross_covariance,
        scale_free=False,
    )


def in_axes(rig: Rig, pose: Pose, rotation: Array) -> tuple[Rig, Pose]:
    """Return a rig without a pose, and a camera pose, in axes into which `rotation`, (3, 3), turns those of the rig."""
    ball, targets, n = rig.ball, rig.targets, len(rig.targets.codes)
    of_ball, of_pose, of_targets = np.eye(4), np.kron(np.eye(2), rotation), np.kron(np.eye(n), rotation)
    of_ball[:3, :3] = rotation
    cross = rig.cross_covariance
    turned = replace(
        rig,
        ball=replace(ball, centre=rotation @ ball.centre, covariance=of_ball @ ball.covariance @ of_ball.T),
        targets=replace(
            targets,
            position=targets.position @ rotation.T,
            covariance=of_targets @ targets.covariance @ of_targets.T,
            normal=rotation @ targets.normal,
        ),
        pose=None,
        cross_covariance=None if cross is None else of_targets @ cross @ of_ball.T,
    )
    return turned, Pose(
        rotation @ pose.rotation,
        rotation @ pose.position,
        of_pose @ pose.covariance @ of_pose.T,
        of_pose @ pose.ball_covariance @ of_ball.T,
        of_pose @ pose.by_focal,
    )


def found_from_picture(pose: Pose, centre: Array) -> Pose:
    """Return a pose that pictures of the ball at `centre`, (3,) m, determined: a longer focal length moves it back."""
    return replace(pose, by_focal=np.concatenate([-pose.along_axis(centre), np.zeros(3)]))


def considered_covariance(pose: Pose, ball: Ball) -> Array:
    """Return the covariance, (10, 10), of the errors common to all frames: camera pose, ball centre, radius."""
    return np.block([[pose.covariance, pose.ball_covariance], [pose.ball_covariance.T, ball.covariance]])


class BallView(NamedTuple):
    """A ball as one camera sees it, for the kernels."""

    centre: Array  # (3,) m, of the ball, obj
    radius: float  # m
    disc_angle: float  # rad, angular radius of a disc; 0 for a ball without discs
    rotation: Array  # (3, 3) R_obj_cam
    position: Array  # (3,) m, of the camera, obj
    intrinsic: tuple[float, float, float, float]  # px, fx, fy, cx, cy
    distortion: Array  # (5,)
    fold_r2: float  # squared reduced radius beyond which a pixel has no ray
    height: int  # px
    readout: float  # s, time a rolling shutter takes over all rows
    covariance: Array  # (10, 10) of the errors common to all frames: m, rad
    focal_turn: Array  # (3,) rad, turn of the axes of obj by a relative change of the focal length


_latest_view: tuple[Rig | None, Pose | None, BallView | None] = (None, None, None)  # each frame asks for the same


def view_of(rig: Rig, pose: Pose) -> BallView:
    """Return the view of a rig's ball from a camera at `pose`."""
    global _latest_view  # noqa: PLW0603 - replaced as a whole, so any thread may
    last_rig, last_pose, view = _latest_view
    if view is None or last_rig is not rig or last_pose is not pose:
        view = _view_of(rig, pose)
        _latest_view = rig, pose, view
    return view


def _view_of(rig: Rig, pose: Pose) -> BallView:
    ball, camera = rig.ball, rig.camera
    return BallView(
        np.ascontiguousarray(ball.centre),
        ball.radius,
        0.0 if rig.disc_radius is None else rig.disc_angle,
        np.ascontiguousarray(pose.rotation),
        np.ascontiguousarray(pose.position),
        camera.intrinsic,
        np.ascontiguousarray(camera.distortion),
        camera.fold_r2,
        camera.height,
        rig.readout_s,
        considered_covariance(pose, ball),
        np.ascontiguousarray(pose.by_focal[3:]),
    )
