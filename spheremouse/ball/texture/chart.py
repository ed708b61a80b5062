"""Chart of the side of the ball that faces the camera: equal steps from its middle are equal angles of the ball.

The projection is azimuthal equidistant (Snyder 1987, "Map projections: a working manual", section 25). A detail of
the ball has about the same size and shape anywhere on the chart, so its contrast changes little while it turns.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels

IN_PLACE = np.zeros(2)  # px, shift of a ball in a good bearing
_MIN_FACING = 0.15  # a pixel there shows seven times as much of the ball as in the middle


class Chart(NamedTuple):
    """The places of a chart on the ball."""

    axes: Array  # (3, 3) rows: right and down on the chart, and towards the camera; obj
    spacing: float  # rad, of two pixels of the chart
    size: int  # px along an edge
    distance: float  # of the camera from the ball's centre, radii

    def reduced(self, coarse: int) -> "Chart":
        """Return the chart of which a pixel is the mean of `coarse` times `coarse` pixels of this one."""
        return self._replace(spacing=coarse * self.spacing, size=self.size // coarse)

    def directions(self) -> Array:
        """Return the unit vectors, (size, size, 3), of the pixels; nan beyond the horizon of the ball."""
        v, u = (np.mgrid[: self.size, : self.size] - 0.5 * (self.size - 1)) * self.spacing
        angle = np.hypot(u, v)
        along = np.stack([u, v], axis=-1) * np.sinc(angle / np.pi)[..., None]
        found = np.concatenate([along, np.cos(angle)[..., None]], axis=-1) @ self.axes
        found[angle > np.arccos(1.0 / self.distance)] = np.nan
        return found

    @property
    def inside(self) -> NDArray[np.bool_]:
        """True for each pixel, (size, size), that shows the ball and not too obliquely."""
        return self.facing(self.directions()) > _MIN_FACING

    def facing(self, directions: Array) -> Array:
        """Return the cosine, (...), between the ray to the camera and the normal of the ball at directions (..., 3)."""
        height = directions @ self.axes[2]
        return (self.distance * height - 1.0) / np.sqrt(1.0 + self.distance**2 - 2.0 * self.distance * height)

    def height(self, facing: float) -> float:
        """Return the height, radii, over the plane across the view, of places with a cosine `facing`."""
        ray = np.sqrt(facing**2 + self.distance**2 - 1.0) - facing
        return float((1.0 + self.distance**2 - ray**2) / (2.0 * self.distance))


class Resampling(NamedTuple):
    """The way from an image to a chart."""

    window: tuple[slice, slice]  # rows and columns of the ball in the image
    width: int  # px, of the mean that stands for a pixel of the chart
    # Of each pixel of the chart: its place in the window, as `resample_chart` takes it
    at: tuple[NDArray[np.int32], NDArray[np.uint16]]
    inside: Image  # (size, size) of the chart, 255 on the ball and in the image, 0 elsewhere

    def __call__(self, image: Image, shift: Array = IN_PLACE) -> Image:
        """Return the grey values of an image, (h, w) or (h, w, 3), on the chart, (size, size); 0 beside the ball.

        The ball's image is off its place by `shift`, (2,) px.
        """
        rows, columns = self.window
        part = image[self.window]
        if shift.any():
            to_image = np.array([[1.0, 0.0, columns.start + shift[0]], [0.0, 1.0, rows.start + shift[1]]])
            size = part.shape[1], part.shape[0]
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            moved = cv2.warpAffine(image, to_image, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
            part = np.asarray(moved, np.uint8)
        grey = part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY)
        mean = np.asarray(cv2.blur(grey, (self.width, self.width)), np.uint8)
        return kernels.resample_chart(mean, *self.at, self.inside)


def chart_of(rig: Rig, pose: Pose, spacing: float, coarse: int) -> Chart:
    """Return the chart of a rig's ball as the camera sees it from `pose`, with pixels `spacing` rad apart.

    Its size is a multiple of `coarse`.
    """
    towards = pose.position - rig.ball.centre
    distance = float(np.linalg.norm(towards))
    towards = towards / distance
    down = pose.rotation[:, 1] - towards * (pose.rotation[:, 1] @ towards)
    down /= np.linalg.norm(down)
    horizon = float(np.arccos(rig.ball.radius / distance))
    axes = np.stack([np.cross(down, -towards), down, towards])
    size = coarse * max(int(2.0 * horizon / (spacing * coarse)), 1)
    return Chart(axes, spacing, size, distance / rig.ball.radius)


def resampling(chart: Chart, rig: Rig, pose: Pose, width: int) -> Resampling:
    """Return the way from an image to the chart. A pixel of the chart is the mean of `width` px of the image."""
    directions = chart.directions()
    directions[~chart.inside] = np.nan
    uv = _seen_by_a_mean(directions.reshape(-1, 3), rig, pose, width).reshape(chart.size, chart.size, 2)
    size = np.array([rig.camera.width, rig.camera.height])
    first = np.clip(np.floor(np.nanmin(uv, axis=(0, 1))).astype(int) - width, 0, size - 1)
    last = np.clip(np.ceil(np.nanmax(uv, axis=(0, 1))).astype(int) + width, first, size - 1)
    window = slice(first[1], last[1] + 1), slice(first[0], last[0] + 1)
    place = np.rint(kernels.PARTS * np.clip(np.nan_to_num(uv - first), 0, last - first)).astype(int)
    (column, row), (right, down) = (place // kernels.PARTS).T, (place % kernels.PARTS).T
    at, part = row * (last[0] + 1 - first[0]) + column, down * kernels.PARTS + right
    kept = np.ascontiguousarray(at.T, np.int32), np.ascontiguousarray(part.T, np.uint16)
    reach = width // 2
    in_image = ((uv >= reach) & (uv <= size - 1 - reach)).all(axis=2)  # the others would show the edge again and again
    return Resampling(window, width, kept, 255 * (chart.inside & in_image).astype(np.uint8))


def _seen_by_a_mean(directions: Array, rig: Rig, pose: Pose, width: int) -> Array:
    """Return the pixels, (n, 2), in the middle of a mean of `width` px that shows directions (n, 3) in the mean.

    Towards the horizon, pixels of one step see more and more of the ball. So a mean about a pixel shows a place farther
    out than the pixel does.
    """
    uv = seen_at(np.nan_to_num(directions), rig, pose)
    uv[np.isnan(directions[:, 0])] = np.nan
    variance = (width**2 + 2.0) / 12.0  # px², of the mean, a pixel's own and that of interpolation
    shown = directions.copy()
    for step in ([0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]):
        found, index = directions_at(uv + step, rig, pose)
        shown[index] += 2.0 * variance * (found - directions[index])
    shown /= np.linalg.norm(shown, axis=1, keepdims=True)
    return 2.0 * uv - seen_at(np.nan_to_num(shown), rig, pose)
