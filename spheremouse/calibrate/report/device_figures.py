"""Figures of the report of `calibrate device`: the scene, error ellipses, and the photos with residuals."""

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.report.scene import (
    SIDES,
    View,
    circle,
    draw_axes,
    draw_ball,
    draw_camera,
    draw_ellipse,
    new_figure,
    scene_axes,
)
from spheremouse.files.report.style import BLUE, GOLD, INK, MUTED, round_number
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_RING_COLOURS = {"C": "#1f9fc4", "M": "#c43a86", "Y": "#e2c21e"}
_PHOTO_WIDTH = 900  # px, of a photo in the page
_ARROW_LENGTH = 0.035  # of the picture's width, of a large residual
_TARGET, _DISC, _FALSE, _LINE = (96, 170, 70), (214, 140, 40), (60, 60, 220), (235, 235, 235)  # BGR


def scene_figure(c: DeviceCalibration) -> "Figure":
    figure = new_figure(9.6, 4.4)
    for axes, (name, view) in zip(scene_axes(figure, len(SIDES)), SIDES, strict=True):
        axes.set_title(name, loc="center", fontsize=9.0, color=MUTED)
        _draw_scene(axes, c, view)
    return figure


def _draw_scene(axes: "Axes", c: DeviceCalibration, view: View) -> None:
    draw_ball(axes, view, c.radius)
    angle = c.device.disc_radius / c.unit / c.radius
    for u in c.directions:
        disc = view(circle(c.radius * np.cos(angle) * u, u, c.radius * np.sin(angle)))
        axes.fill(*disc.T, facecolor=INK, alpha=1.0 if view.faces(u) else 0.18, lw=0.0, zorder=2.0)
    draw_axes(axes, view, 1.45 * c.radius)
    _, _, forward = np.eye(3)
    edge_on = abs(view.towards @ forward) < 0.05
    for id_, code, place in zip(c.device.ids, c.device.codes, c.targets, strict=True):
        for letter, radius in zip(code[::-1], c.device.target_radii[::-1] / c.unit, strict=True):
            ring = view(circle(place, forward, float(radius)))
            axes.fill(*ring.T, color=_RING_COLOURS[letter], lw=1.4 if edge_on else 0.0, zorder=10.0)
        if not edge_on:
            axes.annotate(str(id_), _pair(view(place)), (6.0, 6.0), textcoords="offset points", fontsize=7.5)
    size = 0.09 * float(np.median([np.linalg.norm(pose.position) for pose in c.poses]))
    for k, pose in zip(c.photos, c.poses, strict=True):
        draw_camera(axes, view, c.camera, pose, size)
        at = _pair(view(pose.position))
        axes.annotate(str(k + 1), at, (4.0, 4.0), textcoords="offset points", fontsize=7.5, color=BLUE)


def _pair(point: Array) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def ellipse_figure(c: DeviceCalibration) -> tuple["Figure", float]:
    """Error ellipses of targets and discs, and how many times larger they are drawn."""
    targets, discs = c.block("targets"), c.block("discs")
    sigma = np.sqrt(np.diag(c.covariance))
    magnified = round_number(0.16 * c.radius / float(max(sigma[targets].max(), sigma[discs].max())))
    figure = new_figure(9.6, 4.4)
    for axes, (name, view) in zip(scene_axes(figure, 2), SIDES[:2], strict=True):
        axes.set_title(name, loc="center", fontsize=9.0, color=MUTED)
        draw_ball(axes, view, c.radius)
        P = np.stack([view.right, view.up])
        for block, places, colour in ((targets, c.targets, GOLD), (discs, c.discs, BLUE)):
            for i, place in enumerate(places):
                here = slice(block.start + 3 * i, block.start + 3 * i + 3)
                draw_ellipse(axes, view(place), magnified**2 * P @ c.covariance[here, here] @ P.T, colour)
    return figure, magnified


def arrow_scale(c: DeviceCalibration, width: int) -> float:
    """Return the factor on residual arrows in pictures of photos `width` px wide: 1, 2 or 5 times a power of ten."""
    m = c.measured
    large = float(np.percentile(np.linalg.norm(m.residual[m.used], axis=1), 95))
    return round_number(_ARROW_LENGTH * width / max(large, 1e-3))


def photo_picture(c: DeviceCalibration, photo: int, image: NDArray[np.uint8]) -> bytes:
    """Return a JPEG of the k-th photo used, (h, w, 3) BGR, with image points, residual arrows and the ball's outline.

    An arrow points from the measured place of a point to that by the adjusted device.
    """
    m = c.measured
    height, width = image.shape[:2]
    scale = _PHOTO_WIDTH / width
    small = cv2.resize(image, (_PHOTO_WIDTH, round(height * scale)), interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    canvas = np.asarray(cv2.addWeighted(small, 0.55, grey, 0.25, 0.0), np.uint8)
    _draw_outline(canvas, scale, c, c.poses[photo])
    times = arrow_scale(c, width)
    for i in np.flatnonzero(m.photo == photo):
        at = _pixel(scale * m.centre[i])
        if not m.used[i]:
            cv2.drawMarker(canvas, at, _FALSE, cv2.MARKER_TILTED_CROSS, 16, 2, cv2.LINE_AA)
            continue
        target = m.point[i] < len(c.targets)
        colour, radius = (_TARGET, 13) if target else (_DISC, 9)
        cv2.circle(canvas, at, radius, colour, 2, cv2.LINE_AA)
        tip = _pixel(scale * (m.centre[i] + times * m.residual[i]))
        if np.hypot(tip[0] - at[0], tip[1] - at[1]) > radius // 2:  # a shorter one hides the point
            cv2.arrowedLine(canvas, at, tip, _LINE, 2, cv2.LINE_AA, tipLength=0.25)
        if target:
            name = str(c.device.ids[int(m.point[i])])
            cv2.putText(canvas, name, (at[0] + 17, at[1] - 11), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _LINE, 2, cv2.LINE_AA)
    done, data = cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 82])
    assert done
    return data.tobytes()


def _draw_outline(canvas: NDArray[np.uint8], scale: float, c: DeviceCalibration, pose: Pose) -> None:
    """The circle of the ball that rays touch, as far as the lens model has an image of it."""
    distance = float(np.linalg.norm(pose.position))
    towards, R = pose.position / distance, c.radius
    cam = pose.to_cam(circle(R**2 / distance * towards, towards, R * np.sqrt(1.0 - (R / distance) ** 2)))
    uv = scale * project(cam, c.camera)[0]
    shown = np.sum((cam[:, :2] / cam[:, 2:]) ** 2, axis=1) < c.camera.fold_r2
    for k in np.flatnonzero(shown[1:] & shown[:-1]):
        cv2.line(canvas, _pixel(uv[k]), _pixel(uv[k + 1]), _LINE, 1, cv2.LINE_AA)


def _pixel(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
