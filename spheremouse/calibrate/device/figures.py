"""Pictures of a calibrated device: where cameras, targets, discs and ball are, and what was measured in each photo.

The places are drawn by matplotlib in straight projections of our own, whose lines stay sharp and whose hidden sides can
be left out (Wittich 2017, figures 32, 33); the photos by OpenCV.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.files.report.labels import label_points
from spheremouse.files.report.style import BLUE, GOLD, GREEN, GRID, INK, MUTED, PAPER, RED, round_number, styled
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.rotation import Array, tangent_basis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_RINGS = {"C": "#1f9fc4", "M": "#c43a86", "Y": "#e2c21e"}
_CIRCLE = 96  # corners of one
_WIDTH = 900  # px, of a photo in the page
_ARROW = 0.035  # of the picture's width: the arrow of a large residual
_USED, _DISC, _FALSE, _LINE = (96, 170, 70), (214, 140, 40), (60, 60, 220), (235, 235, 235)  # BGR


# ---- places ----


@dataclass(frozen=True, slots=True)
class _View:
    """A projection to paper: onto axes right and up, along forward; from an eye, or from afar where there is none."""

    right: Array
    up: Array
    forward: Array
    eye: Array | None = None

    def __call__(self, points: Array) -> Array:
        """(..., 3) to (..., 2)."""
        plane = np.stack([points @ self.right, points @ self.up], axis=-1)
        if self.eye is None:
            return plane
        way = points - self.eye
        distance = float(np.linalg.norm(self.eye))
        return distance * np.stack([way @ self.right, way @ self.up], axis=-1) / (way @ self.forward)[..., None]

    def depth(self, point: Array) -> float:
        """The larger, the farther."""
        return float(point @ self.forward)

    def faces(self, points: Array, normals: Array) -> NDArray[np.bool_]:
        """Whether surfaces at points with outward normals turn to the eye."""
        towards = -self.forward if self.eye is None else self.eye - points
        return np.sum(normals * towards, axis=-1) > 0.0


def _view(azimuth: float, height: float, eye: float | None = None) -> _View:
    """Seen from an azimuth to the right of Z and a height above it (degrees), from `eye` away."""
    a, h = np.radians([azimuth, height])
    back = np.array([np.sin(a) * np.cos(h), np.sin(h), np.cos(a) * np.cos(h)])
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    return _View(right, np.cross(back, right), -back, None if eye is None else eye * back)


def overview(calibration: DeviceCalibration) -> "Figure":
    """All in perspective."""
    reach = max(float(np.linalg.norm(p.position)) for p in calibration.poses)
    with styled():
        from matplotlib.figure import Figure

        figure = Figure()
        box = _scene(figure.add_axes((0.0, 0.0, 1.0, 1.0)), calibration, _view(52.0, 24.0, 3.2 * reach), lines=True)
        width, height = np.ptp(box, axis=0)
        figure.set_size_inches(9.6, min(9.6 * height / width, 7.0))
    return figure


def side_views(calibration: DeviceCalibration) -> "Figure":
    """From the front, from above, from the right, all at one scale."""
    views = (
        ("from the front", _view(0.0, 0.0)),
        ("from above", _view(0.0, 90.0)),
        ("from the right", _view(90.0, 0.0)),
    )
    with styled():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.6, 4.2))
        boxes = [_scene(figure.add_axes((0.0, 0.0, 1.0, 1.0)), calibration, view) for _, view in views]
        sizes = np.array([np.ptp(box, axis=0) for box in boxes])
        left, gap = 0.0, 0.03
        scale = (1.0 - gap * (len(views) - 1)) / sizes[:, 0].sum()
        tallest = float(sizes[:, 1].max())
        figure.set_size_inches(9.6, min(max(9.6 * scale * tallest, 2.2), 7.0) + 0.3)
        for ax, (name, _), box, size in zip(figure.axes, views, boxes, sizes, strict=True):
            middle = box.mean(axis=0)
            ax.set_position((left, 0.0, scale * size[0], 0.93))
            ax.set_xlim(*box[:, 0])
            ax.set_ylim(middle[1] - 0.5 * tallest, middle[1] + 0.5 * tallest)
            ax.set_title(name, loc="center", fontsize=9.0, color=MUTED, y=1.0, pad=3.0)
            left += scale * size[0] + gap
    return figure


def _scene(ax: "Axes", c: DeviceCalibration, view: _View, *, lines: bool = False) -> Array:
    """Draw all; gives the corners of what was drawn, (2, 2)."""
    ax.set_aspect("equal")
    ax.axis("off")
    R = c.radius
    if lines:
        for pose in c.poses:
            path = view(np.stack([pose.position, np.zeros(3)]))
            ax.plot(*path.T, color=GRID, lw=0.7, zorder=0.5)
    drawn_points = [_ball(ax, c, view)]
    for code, place in zip(c.device.codes, c.targets, strict=True):
        drawn_points.append(_target(ax, c, view, code, place))
    for name, colour, axis in zip("XYZ", (RED, GREEN, BLUE), np.eye(3), strict=True):
        if abs(axis @ view.forward) > 0.95:
            continue
        centre, surface, end = view(0.0 * axis), view(R * axis), view(1.45 * R * axis)
        ax.plot(*np.stack([centre, surface]).T, color=colour, lw=0.8, ls=(0, (4, 3)), zorder=25)  # within the ball
        look = {"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 0.0}
        ax.annotate("", _pair(end), _pair(surface), arrowprops=look, zorder=25)
        ax.annotate(name, _pair(view(1.58 * R * axis)), color=colour, ha="center", va="center", fontsize=8.5, zorder=25)
        drawn_points.append(view(1.65 * R * axis)[None])
    size = 0.09 * float(np.median([np.linalg.norm(p.position) for p in c.poses]))
    for pose in c.poses:
        drawn_points.append(_frustum(ax, c, view, pose, size))
    if abs(view.forward[2]) > 0.3:  # else they hang one behind the other
        label_points(ax, _named(c.device.ids, view(c.targets)), fontsize=7.5, color=INK)
    at = view(np.stack([pose.position for pose in c.poses]))
    label_points(ax, _named([k + 1 for k in c.photos], at), radius=1.0, color=BLUE)
    everything = np.concatenate(drawn_points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.04 * float(np.max(high - low))
    box = np.stack([low - margin, high + margin])
    ax.set_xlim(*box[:, 0])
    ax.set_ylim(*box[:, 1])
    return box


def _ball(ax: "Axes", c: DeviceCalibration, view: _View) -> Array:
    """Outline, graticule, and discs; those on the far side are pale."""
    R = c.radius
    towards = -view.forward
    if view.eye is None:
        middle, radius = np.zeros(3), R
    else:
        distance = float(np.linalg.norm(view.eye))
        middle, radius = R**2 / distance * towards, R * np.sqrt(1.0 - (R / distance) ** 2)
    outline = view(_circle(middle, towards, radius))
    ax.fill(*outline.T, facecolor=MUTED, alpha=0.13, lw=0.0, zorder=1.0)
    ax.plot(*outline.T, color=MUTED, lw=1.0, zorder=1.2)
    angle = np.radians(np.linspace(0.0, 360.0, 181))
    ring = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=1)
    for latitude in np.radians([-60.0, -30.0, 0.0, 30.0, 60.0]):
        _front(ax, view, R, np.cos(latitude) * ring + np.sin(latitude) * np.array([0.0, 1.0, 0.0]))
    for turn in np.radians(np.arange(0.0, 180.0, 30.0)):
        flat = np.array([np.cos(turn), 0.0, np.sin(turn)])
        _front(ax, view, R, np.cos(angle)[:, None] * flat + np.sin(angle)[:, None] * np.array([0.0, 1.0, 0.0]))
    half = c.device.disc_radius / c.unit / R
    for u in c.directions:
        disc = view(_circle(R * np.cos(half) * u, u, R * np.sin(half)))
        near = bool(view.faces(R * u, u))
        ax.fill(*disc.T, facecolor=INK, alpha=1.0 if near else 0.18, lw=0.0, zorder=2.0 if near else 0.9)
    return outline


def _front(ax: "Axes", view: _View, radius: float, directions: Array) -> None:
    """The near part of a line on the ball."""
    line = np.where(view.faces(radius * directions, directions)[:, None], view(radius * directions), np.nan)
    ax.plot(*line.T, color=MUTED, lw=0.4, alpha=0.55, zorder=1.1)


def _target(ax: "Axes", c: DeviceCalibration, view: _View, code: str, place: Array) -> Array:
    axis = np.array([0.0, 0.0, 1.0])
    near = bool(view.faces(place, axis))
    edge_on = abs(view.forward[2]) < 0.05
    for k, (letter, radius) in enumerate(zip(code[::-1], c.device.target_radii[::-1] / c.unit, strict=True)):
        circle = view(_circle(place, axis, float(radius)))
        colour = _RINGS[letter] if near or edge_on else MUTED
        ax.fill(*circle.T, facecolor=colour, edgecolor=colour, lw=1.4 if edge_on else 0.0, zorder=10.0 + 0.1 * k)
    return view(_circle(place, axis, 2.5 * float(c.device.target_radii[2]) / c.unit))


def _frustum(ax: "Axes", c: DeviceCalibration, view: _View, pose: Pose, size: float) -> Array:
    """A camera: the pyramid it sees, and its top."""
    camera = c.camera
    half = 0.5 * np.array([camera.width / camera.fx, camera.height / camera.fy])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    cam = size * np.concatenate([corners, np.ones((4, 1))], axis=1)
    roof = np.array([[-0.4, -1.12], [0.4, -1.12], [0.0, -1.5]]) * half
    top = size * np.concatenate([roof, np.ones((3, 1))], axis=1)
    world = cam @ pose.rotation.T + pose.position
    flat, tip = view(world), view(pose.position)
    order = 20.0 - 0.01 * view.depth(pose.position)
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        side = np.array([tip, flat[a], flat[b]])
        ax.fill(*side.T, facecolor=PAPER, alpha=0.6, lw=0.0, zorder=order - 0.005)
        ax.fill(*side.T, facecolor=BLUE, alpha=0.07, lw=0.0, zorder=order)
    for corner in flat:
        ax.plot(*np.array([tip, corner]).T, color=BLUE, lw=0.8, zorder=order, solid_capstyle="round")
    ax.fill(*flat.T, facecolor=BLUE, alpha=0.10, lw=0.0, zorder=order)
    ax.plot(*np.concatenate([flat, flat[:1]]).T, color=BLUE, lw=1.0, zorder=order, solid_joinstyle="round")
    ax.fill(*view(top @ pose.rotation.T + pose.position).T, facecolor=BLUE, lw=0.0, zorder=order)
    return np.concatenate([flat, tip + 0.3 * size * np.array([[-1.0, -1.0], [1.0, 1.0]])])  # with its number


def _named(names: Sequence[int], places: Array) -> list[tuple[str, float, float]]:
    return [(str(name), *_pair(at)) for name, at in zip(names, places, strict=True)]


def _pair(point: Array) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _circle(centre: Array, normal: Array, radius: float) -> Array:
    basis = tangent_basis(normal[None] / np.linalg.norm(normal))[0]  # (3, 2)
    angle = np.linspace(0.0, 2.0 * np.pi, _CIRCLE + 1)
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ basis.T


# ---- how certain it is ----


def certainty(calibration: DeviceCalibration) -> tuple["Figure", float]:
    """Error ellipses of targets and discs, one standard deviation, and how many times larger they are drawn."""
    c = calibration
    lengths = np.sqrt(np.diag(c.covariance))
    targets, discs = c.block("targets"), c.block("discs")
    worst = float(max(lengths[targets].max(), lengths[discs].max()))
    magnified = round_number(0.16 * c.radius / worst)
    with styled():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.6, 4.4))
        for k, (name, view) in enumerate((("from the front", _view(0.0, 0.0)), ("from above", _view(0.0, 90.0)))):
            ax = figure.add_axes((0.5 * k, 0.0, 0.5, 0.93))
            ax.set_aspect("equal")
            ax.axis("off")
            ax.set_title(name, loc="center", fontsize=9.0, color=MUTED, pad=3.0)
            outline = view(_circle(np.zeros(3), view.forward, c.radius))
            ax.plot(*outline.T, color=MUTED, lw=0.8, zorder=1.0)
            for block, places, colour in ((targets, c.targets, GOLD), (discs, c.discs, BLUE)):
                for i, place in enumerate(places):
                    here = slice(block.start + 3 * i, block.start + 3 * i + 3)
                    P = np.stack([view.right, view.up])
                    _ellipse(ax, view(place), magnified**2 * P @ c.covariance[here, here] @ P.T, colour)
    return figure, magnified


def _ellipse(ax: "Axes", centre: Array, covariance: Array, colour: str) -> None:
    value, vector = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, 61)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline = centre + (circle * np.sqrt(np.maximum(value, 0.0))) @ vector.T
    ax.fill(*outline.T, facecolor=colour, alpha=0.25, lw=0.0, zorder=3.0)
    ax.plot(*outline.T, color=colour, lw=0.8, zorder=3.1)
    ax.plot(*centre, ".", color=colour, ms=2.5, zorder=3.2)


# ---- photos ----


def magnification(calibration: DeviceCalibration, width: int) -> float:
    """By how much residual arrows are drawn longer in pictures of photos `width` px wide: 1, 2 or 5 times a power."""
    measured = calibration.measured
    large = float(np.percentile(np.linalg.norm(measured.residual[measured.used], axis=1), 95))
    return round_number(_ARROW * width / max(large, 1e-3))


def photo_picture(calibration: DeviceCalibration, photo: int, image: NDArray[np.uint8]) -> bytes:
    """JPEG of the k-th photo used, (h, w, 3) BGR: what was measured in it, residual arrows, the ball's outline.

    An arrow points from where a point was seen to where the adjusted device puts it.
    """
    c, m = calibration, calibration.measured
    height, width = image.shape[:2]
    scale = _WIDTH / width
    small = cv2.resize(image, (_WIDTH, round(height * scale)), interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    canvas = np.asarray(cv2.addWeighted(small, 0.55, grey, 0.25, 0.0), np.uint8)
    _polyline(canvas, scale * _ball_outline(c, c.poses[photo]), _LINE)
    times = magnification(c, width)
    n = len(c.targets)
    for i in np.flatnonzero(m.photo == photo):
        at = _place(scale * m.centre[i])
        if not m.used[i]:
            cv2.drawMarker(canvas, at, _FALSE, cv2.MARKER_TILTED_CROSS, 16, 2, cv2.LINE_AA)
            continue
        target = m.point[i] < n
        colour, radius = (_USED, 13) if target else (_DISC, 9)
        cv2.circle(canvas, at, radius, colour, 2, cv2.LINE_AA)
        tip = _place(scale * (m.centre[i] + times * m.residual[i]))
        if np.hypot(tip[0] - at[0], tip[1] - at[1]) > radius // 2:  # else it only hides what was measured
            cv2.arrowedLine(canvas, at, tip, _LINE, 2, cv2.LINE_AA, tipLength=0.25)
        if target:
            name = str(c.device.ids[int(m.point[i])])
            cv2.putText(canvas, name, (at[0] + 17, at[1] - 11), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _LINE, 2, cv2.LINE_AA)
    done, data = cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 82])
    assert done
    return data.tobytes()


def _ball_outline(c: DeviceCalibration, pose: Pose) -> Array:
    """px, (n, 2): where rays touch the ball; nan where the lens model has no picture of it."""
    distance = float(np.linalg.norm(pose.position))
    towards, R = pose.position / distance, c.radius
    circle = _circle(R**2 / distance * towards, towards, R * np.sqrt(1.0 - (R / distance) ** 2))
    cam = pose.to_cam(circle)
    uv, _ = project(cam, c.camera)
    r2 = np.sum((cam[:, :2] / cam[:, 2:]) ** 2, axis=1)
    return np.where((r2 < c.camera.fold_r2)[:, None], uv, np.nan)


def _polyline(canvas: NDArray[np.uint8], points: Array, colour: tuple[int, int, int]) -> None:
    for a, b in pairwise(points):
        if np.all(np.isfinite([a, b])):
            cv2.line(canvas, _place(a), _place(b), colour, 1, cv2.LINE_AA)


def _place(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
