"""Overlay of hand-held balls on the frame, for pictures and videos.

Each ball's outline is thin. The rims of discs that face the camera are white, or grey if the pose is only predicted.
A green pin marks the pole, and the path of the last half second is yellow. A strip below has the numbers of the
pointing ball.
"""

from collections import deque

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation, project, sphere_outline
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.session.overlay.pen import GREEN, SHADOW, WHITE, Colour, Image, Pen, canvas_of
from spheremouse.tracker import Status
from spheremouse.wand.axes import axes_of
from spheremouse.wand.ball import WandBall
from spheremouse.wand.state import WandEpoch, WandPose, WandTracker

_STEPS = 96  # points along a rim
_TRACE = 0.5  # s
_PIN = 0.6  # length of the pin outside the ball, in radii
_PREDICTED = 0.45  # weight of objects that were not detected
_YELLOW: Colour = (30, 210, 255)  # no disc's colour: blue, green, red


class WandOverlay:
    """Draws epochs, and remembers where balls were for their traces."""

    def __init__(self, tracker: WandTracker, points: int = 0, scale: int = 1) -> None:
        """`points` is the index of the ball that the numbers are about; `scale` enlarges the frame."""
        self._tracker, self._points, self._scale = tracker, points, scale
        self._trace: deque[tuple[float, Array]] = deque()  # s; (balls, 2) px; the newest last

    def remember(self, epoch: WandEpoch) -> None:
        """Add the positions of the balls to the traces; `draw` does not."""
        seen = [p.position for p in epoch.poses if p.position is not None and p.seen]
        at = project(np.array(seen).reshape(-1, 3), self._tracker.camera)[0]
        self._trace.append((epoch.frame.stamp, at[np.isfinite(at).all(axis=1)]))
        while epoch.frame.stamp - self._trace[0][0] > _TRACE:
            self._trace.popleft()

    def draw(self, epoch: WandEpoch, counts: tuple[int, int, int]) -> Image:
        """Return the frame with balls, traces and numbers, after `remember`. `counts` is the sum so far."""
        canvas = canvas_of(epoch.frame.image, self._scale)
        pen = Pen(canvas, self._scale)
        pen.trace([at for _, at in self._trace], _YELLOW)
        several = len(epoch.poses) > 1
        for k, (ball, pose) in enumerate(zip(self._tracker.balls, epoch.poses, strict=True)):
            name = f"{ball.name} (points)" if several and k == self._points else ball.name
            _draw(pen, ball, name, pose, self._tracker.camera)
        pen.caption(_cells(epoch, epoch.poses[self._points], counts), 9)
        return canvas


def rims(ball: WandBall, position: Array, rotation: Array, camera: InteriorOrientation) -> list[Array]:
    """Return arcs, (n, 2) px each, of the discs' rims that face the camera.

    The ball has its centre at (3,) m in cam and R_cam_ball (3, 3).
    """
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


def pin(ball: WandBall, position: Array, rotation: Array, camera: InteriorOrientation) -> Array:
    """Return the visible part of a pin in the pole of a ball, (n, 2) px; the pose is as in `rims`."""
    away = float(np.linalg.norm(position))
    place = position + np.linspace(1.0, 1.0 + _PIN, 16)[:, None] * ball.radius * rotation[:, 2]
    far = np.linalg.norm(place, axis=1)
    limb = np.sqrt(away**2 - ball.radius**2)
    shows = (place @ position < far * limb) | (far <= limb)
    uv = project(place, camera)[0]
    return uv[shows & np.isfinite(uv).all(axis=1)]


def _draw(pen: Pen, ball: WandBall, name: str, pose: WandPose, camera: InteriorOrientation) -> None:
    """One ball, where its pose is known and all of it lies before the camera."""
    p, R = pose.position, pose.rotation
    if p is None or R is None or p[2] <= ball.radius:
        return
    weight = 1.0 if pose.seen else _PREDICTED
    around = sphere_outline(p, ball.radius, camera)
    pen.outline(around)
    arcs = rims(ball, p, R, camera)
    for arc in arcs:
        pen.line(arc, SHADOW, width=3)  # an edge: on lit discs white alone does not show
    for arc in arcs:
        pen.line(arc, WHITE, weight)
    pen.line(pin(ball, p, R, camera), GREEN, weight, 2)
    where = np.array([np.max(around[:, 0]) + 4.0, np.min(around[:, 1]) + 8.0])
    pen.label(name if pose.seen else f"{name}: predicted", where, GREEN if pose.seen else (150, 190, 150))


def _cells(epoch: WandEpoch, pose: WandPose, counts: tuple[int, int, int]) -> tuple[tuple[str, float], ...]:
    """Return the text cells: time and state, counts, and position and angles if the pose has them."""
    state = "hidden" if pose.phase is Status.TRACKING and not pose.seen else str(pose.phase)
    cells = [
        (f"{epoch.frame.stamp:.2f} s  {state}", 0.012),
        (f"counts {counts[0]:+d} {counts[1]:+d} {counts[2]:+d}", 0.755),
    ]
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = axes_of(pose.position, pose.rotation, pose.covariance)
        x, y, z = axes.position
        yaw, pitch, roll = np.rad2deg(axes.angles)
        cells.append((f"x {x:+.3f}  y {y:+.3f}  z {z:.3f} m", 0.17))
        cells.append((f"yaw {yaw:+.1f}  pitch {pitch:+.1f}  roll {roll:+.1f} deg", 0.42))
    return tuple(cells)
