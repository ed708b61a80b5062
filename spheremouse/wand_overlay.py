"""What the tracker of hand-held balls sees, drawn on the frame: a picture or a video to judge by eye.

Each ball's outline thin and its discs' rims white where they face the camera, grey where the pose is only predicted;
a green pin in its pole; where its centre was in the last half second in red; a strip with numbers below.
"""

from collections import deque

import numpy as np

from spheremouse.camera import InteriorOrientation, project
from spheremouse.overlay import GREEN, WHITE, Image, Pen, canvas_of
from spheremouse.rotation import Array, tangent_basis
from spheremouse.wand.axes import axes_of
from spheremouse.wand.ball import WandBall
from spheremouse.wand.track import WandPhase, WandPose, WandTracker
from spheremouse.wand_session import WandEpoch

_STEPS = 96  # points along a rim and the outline
_EPOCHS = 15  # epochs that fade, as of the ball in its frame
_PIN = 0.6  # radii that the pin stands out
_PREDICTED = 0.45  # weight of what was not seen


class WandOverlay:
    """Draws epochs, and remembers where balls were for their traces."""

    def __init__(self, tracker: WandTracker, points: int = 0, scale: int = 1) -> None:
        """`points` is the index of the ball that the numbers are about; `scale` enlarges the frame."""
        self._tracker, self._points, self._scale = tracker, points, scale
        self._trace: deque[Array] = deque(maxlen=_EPOCHS)  # (balls, 2) px each, the newest last

    def remember(self, epoch: WandEpoch) -> None:
        """Where the balls are, for the traces; `draw` does not."""
        known = [p.position for p in epoch.poses if p.position is not None]
        at = project(np.array(known).reshape(-1, 3), self._tracker.camera)[0]
        self._trace.append(at[np.isfinite(at).all(axis=1)])

    def draw(self, epoch: WandEpoch, counts: tuple[int, int, int]) -> Image:
        """The epoch that was remembered last, with the sum of counts so far."""
        canvas = canvas_of(epoch.frame.image, self._scale)
        pen = Pen(canvas, self._scale)
        pen.trace(list(self._trace))
        for ball, pose in zip(self._tracker.balls, epoch.poses, strict=True):
            _draw(pen, ball, pose, self._tracker.camera)
        pen.caption(_cells(epoch, epoch.poses[self._points], counts), 9)
        return canvas


def outline(position: Array, radius: float, camera: InteriorOrientation) -> Array:
    """Outline of a ball at a position, (3,) m in cam, (n, 2) px: where lines of sight touch it."""
    away = float(np.linalg.norm(position))
    sight = position / away
    angle = np.linspace(0.0, 2.0 * np.pi, _STEPS, endpoint=False)
    across = tangent_basis(sight) @ np.stack([np.cos(angle), np.sin(angle)])
    rays = np.sqrt(1.0 - (radius / away) ** 2) * sight + radius / away * across.T
    return project(rays, camera)[0]


def rims(ball: WandBall, position: Array, rotation: Array, camera: InteriorOrientation) -> list[Array]:
    """Arcs, (n, 2) px, of the discs' rims that face the camera, of a ball at a position with R_cam_ball."""
    angle = np.linspace(0.0, 2.0 * np.pi, _STEPS + 1)
    round_ = np.stack([np.cos(angle), np.sin(angle)])
    arcs = []
    for disc in ball.discs:
        u = np.cos(disc.angle) * disc.direction[:, None] + np.sin(disc.angle) * tangent_basis(disc.direction) @ round_
        normal = (rotation @ u).T
        place = position + ball.radius * normal
        faces = np.sum(normal * place, axis=1) < 0.0
        uv = project(place, camera)[0]
        begins = np.flatnonzero(np.diff(faces.astype(int), prepend=0) == 1)
        ends = np.flatnonzero(np.diff(faces.astype(int), append=0) == -1) + 1
        arcs += [uv[a:b] for a, b in zip(begins, ends, strict=True) if b - a > 1]
    return arcs


def _draw(pen: Pen, ball: WandBall, pose: WandPose, camera: InteriorOrientation) -> None:
    """One ball, where its pose is known and all of it lies before the camera."""
    p, R = pose.position, pose.rotation
    if p is None or R is None or p[2] <= ball.radius:
        return
    weight = 1.0 if pose.seen else _PREDICTED
    around = outline(p, ball.radius, camera)
    if not np.all(np.isfinite(around)):
        return
    pen.outline(around)
    for arc in rims(ball, p, R, camera):
        pen.line(arc, WHITE, weight)
    pin = p + np.outer([ball.radius, (1.0 + _PIN) * ball.radius], R[:, 2])
    hidden = R[:, 2] @ p > 0.0  # behind the ball, but for its tip
    pen.line(project(pin, camera)[0], GREEN, _PREDICTED if hidden else weight, 2)
    words = ball.name if pose.seen else f"{ball.name}: predicted"
    pen.label(words, np.array([np.max(around[:, 0]) + 4.0, np.min(around[:, 1]) + 8.0]), GREEN)


def _cells(epoch: WandEpoch, pose: WandPose, counts: tuple[int, int, int]) -> tuple[tuple[str, float], ...]:
    """Time, state, position, angles, counts."""
    state = "hidden" if pose.phase is WandPhase.TRACKING and not pose.seen else str(pose.phase)
    cells = [
        (f"{epoch.frame.stamp:.2f} s  {state}", 0.012),
        (f"counts {counts[0]:+d} {counts[1]:+d} {counts[2]:+d}", 0.755),
    ]
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = axes_of(pose.position, pose.rotation, pose.covariance)
        x, y, z = axes.position
        yaw, pitch, roll = np.rad2deg(axes.angles)
        cells.insert(1, (f"x {x:+.3f}  y {y:+.3f}  z {z:.3f} m", 0.17))
        cells.insert(2, (f"yaw {yaw:+.1f}  pitch {pitch:+.1f}  roll {roll:+.1f} deg", 0.42))
    return tuple(cells)
