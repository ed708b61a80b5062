"""Parallel projections of a calibration's scene for matplotlib: cameras, axes, circles, error ellipses."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spheremouse.files.report.style import BLUE, GOLD, GREEN, MUTED, RED
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array, tangent_basis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CIRCLE_POINTS = 97


@dataclass(frozen=True, slots=True)
class View:
    """A parallel projection onto two unit vectors, (3,)."""

    right: Array
    up: Array

    def __call__(self, points: Array) -> Array:
        """Project points (..., 3) to (..., 2)."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)

    @property
    def towards(self) -> Array:
        """Unit vector to the viewer, (3,)."""
        return np.cross(self.right, self.up)

    def faces(self, normals: Array) -> NDArray[np.bool_]:
        """Return True for surfaces if their outward normals, (..., 3), point to the viewer."""
        return normals @ self.towards > 0.0


_X, _Y, _Z = np.eye(3)
SIDES = (("from the front", View(_X, _Y)), ("from above", View(_X, -_Z)), ("from the right", View(-_Z, _Y)))


def new_figure(width: float, height: float) -> "Figure":
    """Return an empty figure of a size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def scene_axes(figure: "Figure", columns: int) -> list["Axes"]:
    """Return axes without frame and ticks, in one row, at one scale."""
    row = figure.subplots(1, columns, squeeze=False)[0]
    for axes in row:
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_axis_off()
    return list(row)


def circle(centre: Array, normal: Array, radius: float) -> Array:
    """Return points of a circle in space, (n, 3), about a centre (3,) with a unit normal (3,)."""
    basis = tangent_basis(normal[None])[0]  # (3, 2)
    angle = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS)
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ basis.T


def draw_camera(axes: "Axes", view: View, camera: InteriorOrientation, pose: Pose, size: float) -> None:
    """Draw the pyramid that a camera sees, `size` high."""
    half = 0.5 * np.array([camera.width / camera.fx, camera.height / camera.fy])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    rim = size * np.concatenate([corners, np.ones((5, 1))], axis=1) @ pose.rotation.T + pose.position
    flat, tip = view(rim), view(pose.position)
    for corner in flat[:4]:
        axes.plot(*np.array([tip, corner]).T, color=BLUE, lw=0.8, zorder=20.0)
    axes.plot(*flat.T, color=BLUE, lw=0.9, zorder=20.0)
    axes.fill(*flat.T, color=BLUE, alpha=0.12, lw=0.0, zorder=19.0)


def draw_axes(axes: "Axes", view: View, length: float) -> None:
    """Draw the coordinate axes, of `length` in the unit of the figure, but for one that points to the viewer."""
    for name, colour, axis in zip("XYZ", (RED, GREEN, GOLD), np.eye(3), strict=True):
        if abs(axis @ view.towards) > 0.95:
            continue
        end = view(length * axis)
        axes.plot(*np.stack([0.0 * end, end]).T, color=colour, lw=1.4, zorder=25.0)
        axes.annotate(name, tuple(1.08 * end), color=colour, ha="center", va="center", fontsize=8.5, zorder=25.0)


def draw_ellipse(axes: "Axes", centre: Array, covariance: Array, colour: str) -> None:
    """Draw the ellipse of one standard deviation of a (2, 2) covariance."""
    angle = np.linspace(0.0, 2.0 * np.pi, 61)
    value, vector = np.linalg.eigh(covariance)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline = centre + (unit * np.sqrt(np.maximum(value, 0.0))) @ vector.T
    axes.fill(*outline.T, facecolor=colour, alpha=0.25, lw=0.0, zorder=3.0)
    axes.plot(*outline.T, color=colour, lw=0.8, zorder=3.1)
    axes.plot(*centre, ".", color=colour, ms=2.5, zorder=3.2)


def draw_ball(axes: "Axes", view: View, radius: float) -> None:
    """Draw the outline of a ball at the origin; `radius` in the unit of the figure."""
    outline = view(circle(np.zeros(3), view.towards, radius))
    axes.fill(*outline.T, facecolor=MUTED, alpha=0.13, lw=0.0, zorder=1.0)
    axes.plot(*outline.T, color=MUTED, lw=1.0, zorder=1.2)
