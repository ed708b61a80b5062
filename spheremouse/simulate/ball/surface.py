"""The ball's surface in the image: what pixels show of its discs and of its pattern, and the discs' exact outlines.

A disc is a spherical cap: all points of the sphere within an angle of its centre. Let n(u, v) be the unit vector of the
point where a pixel's ray hits the ball, and d the cap's centre. Then g = n·d - cos(angle) is positive inside. The
distance to the edge in pixels is g over its image gradient. It gives the covered fraction of a pixel that a straight
edge crosses. A pattern is an albedo as a function of the direction, averaged over parts of a pixel.
"""

import copy
from collections.abc import Callable
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE, DiscTruth
from spheremouse.geometry.camera import project, row_of, sphere_outline, unproject
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.layers import window
from spheremouse.simulate.shapes import circle, pixel_parts

AttitudeAt = Callable[[Array], Array]  # times (n,) s -> R_obj_ball (n, 3, 3)
Shares = NDArray[np.float32]  # (h, w) of pixels

_SUBPIXELS_OF_PATTERN = 2  # of a pixel's side, for a painted pattern
_SUBPIXELS_AT_EDGE = 3  # parts of a pixel's side where the edge of a disc runs through it
_SUBPIXELS_AT_LIMB = 7  # the same near the limb, where a pixel sees far around the ball
# square roots of a pixel's size on the ball, in radii: below that cosine is near the limb
_LIMB_COSINE_PER_ROOT_PIXEL = 5.0
_POLYGON_CORNERS = 180  # of the polygon that approximates a disc's outline
_TESTED_MARGIN_PX = 2  # px around ball and discs that are tested
_EXTENT_FACTOR = 1.1  # factor on a disc's linear extent in the image: perspective and lens are not linear


class Coverage(NamedTuple):
    """Shares of an image's pixels that discs cover."""

    pixel: NDArray[np.intp]  # (k,) index into the image's pixels, row by row
    disc: NDArray[np.intp]  # (k,)
    share: Array  # (k,) of the ball's part of the pixel that the disc covers


class Points(NamedTuple):
    """Points of the ball that pixels show, `_SUBPIXELS_OF_PATTERN`² in each."""

    pixel: NDArray[np.intp]  # (k,) index into the image's pixels, row by row
    normal: NDArray[np.float32]  # (k, m, 3) unit vectors, obj
    weight: NDArray[np.float32]  # (k, m) of the points in their pixel's mean; parts that miss the ball have almost none


class _Hits(NamedTuple):
    """Rays on the ball. One that misses it has the point where it is nearest."""

    normal: Array  # (3, k) unit vectors, obj
    depth: Array  # (k,) in lengths of the ray
    length: Array  # (k,) m, of the ray
    cosine: Array  # (k,) of the angle between ray and normal, 0 where the ray misses the ball


class Surface:
    """The ball of a scene before its camera."""

    def __init__(self, scene: Scene, reach: float = 0.0) -> None:
        """`reach`: m, how far the ball's centre may be from its place."""
        self.scene = scene
        camera, pose = scene.camera, scene.pose
        self._present = ~np.isin(np.arange(len(scene.disc_directions)), scene.fallen)  # (n,) on the ball
        self._set_centre(np.zeros(3))
        outline = sphere_outline(pose.to_cam(np.zeros(3)), scene.ball_radius + reach, camera, 360)
        self._window = window(outline, _TESTED_MARGIN_PX, camera)
        self._pixel_index = np.arange(camera.height * camera.width).reshape(camera.height, -1)[self._window.slices]
        uv = self._window.pixels()
        xy, dxy_duv = unproject(uv, camera)
        turn = pose.rotation[:, :2]
        rays = (xy @ turn.T + pose.rotation[:, 2])[:, :, None]
        self._rays = np.concatenate([rays, turn @ dxy_duv], axis=2).reshape(*uv.shape[:2], 9)

    def moved(self, centre: Array) -> Self:
        """Return the same surface with the ball's centre, (3,) m in obj, elsewhere within reach."""
        other = copy.copy(self)
        other._set_centre(centre)
        return other

    def _set_centre(self, centre: Array) -> None:
        """Set the place of the ball, `centre` (3,) m in obj, and the geometry of its outline."""
        scene = self.scene
        self.centre = centre
        self._origin = scene.pose.position - centre  # (3,) m, the camera from the ball's centre
        distance = np.linalg.norm(self._origin)
        self._eye = self._origin / distance
        self._horizon = float(np.arccos(scene.ball_radius / distance))  # rad, from the eye
        focal = max(scene.camera.fx, scene.camera.fy)
        self._pixel = float((distance - scene.ball_radius) / scene.ball_radius / focal)  # rad, square to the ray

    def row_times(self, t: float) -> Array:
        """Return the times, (1 or h,) s, when the rows of a frame at `t` are exposed; one if all are at once."""
        if self.scene.readout_s == 0.0:
            return np.array([t])
        height = self.scene.camera.height
        return t + row_of(np.arange(height), height) * self.scene.readout_s

    def _rays_at(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the rays of k pixels from the ball's first ones, (3, k) in obj, and their gradients, (3, 2, k)."""
        rays = np.ascontiguousarray(self._rays[row, column].T).reshape(3, 3, -1)
        return rays[:, 0], rays[:, 1:]

    # ---- pattern ----

    def points(self, shown: Shares) -> Points | None:
        """Return the points of a pattern in pixels of which the ball's share `shown`, (h, w), is above 0."""
        if self.scene.pattern is None:
            return None
        row, column = np.nonzero(shown[self._window.slices] > 0.0)
        grid = pixel_parts(_SUBPIXELS_OF_PATTERN)
        hits = self._hits(_spread(*self._rays_at(row, column), grid))
        weight = np.where(hits.cosine > 0.0, 1.0, 1e-6).reshape(len(grid), -1).T
        normal = np.where(np.isnan(hits.normal), self._eye[:, None], hits.normal).reshape(3, len(grid), -1)
        return Points(
            self._pixel_index[row, column],
            np.ascontiguousarray(normal.T, dtype=np.float32),
            (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32),
        )

    def albedo(self, points: Points, attitude_at: AttitudeAt, t: float) -> Array:
        """Return the pattern's mean albedo in each pixel of an image at time `t` (of the middle row), 1 beside them."""
        assert self.scene.pattern is not None
        R = attitude_at(self.row_times(t)).astype(np.float32)
        turned = points.normal @ (R[points.pixel // self.scene.camera.width] if len(R) > 1 else R)
        albedo = self.scene.pattern.albedo(turned.reshape(-1, 3)).reshape(points.weight.shape)
        mean = np.ones(self.scene.camera.width * self.scene.camera.height)
        mean[points.pixel] = np.einsum("km,km->k", albedo, points.weight)
        return mean

    # ---- discs ----

    def coverage(self, attitude_at: AttitudeAt, t: float) -> Coverage:
        """Return the shares of pixels that discs cover at time `t` (of the middle row)."""
        directions = self.scene.disc_directions
        turned = self._directions_by_row(attitude_at, t, directions)
        row, column, disc = self._near_discs(turned)
        disc_directions = turned[disc]
        if self.scene.readout_s > 0.0:
            R = attitude_at(self.row_times(t))[row + self._window.top]
            disc_directions = (R @ directions[disc, :, None])[..., 0]
        disc_directions = np.ascontiguousarray(disc_directions.T)
        ray, dray = self._rays_at(row, column)
        hits = self._hits(ray)
        g, slope = self._edge_function(hits, ray, dray, disc_directions)
        share = (g > 0.0).astype(float)
        angle = self.scene.disc_angle
        reach = 1.5 * self._pixel / np.maximum(hits.cosine, np.sqrt(self._pixel))  # rad, from the middle to a corner
        limb = hits.cosine < _LIMB_COSINE_PER_ROOT_PIXEL * np.sqrt(self._pixel)
        grazing = limb & (g > np.cos(angle + reach) - np.cos(angle))
        cut = np.abs(g) <= 0.75 * slope.sum(axis=0)
        for part, subpixels in ((cut & ~grazing, _SUBPIXELS_AT_EDGE), (grazing, _SUBPIXELS_AT_LIMB)):
            share[part] = self._covered_share(ray[:, part], dray[..., part], disc_directions[:, part], subpixels)
        keep = share > 0.0
        return Coverage(self._pixel_index[row, column][keep], disc[keep], share[keep])

    def _near_discs(self, directions: Array) -> tuple[NDArray[np.intp], ...]:
        """Return row and column in the window, and disc, of pixels that may show a disc at `directions`, (n, 3) obj."""
        scene = self.scene
        near = np.flatnonzero((directions @ self._eye > np.cos(self._horizon + scene.disc_angle)) & self._present)
        uv, duv = self._project(directions[near])
        # of a small sphere around the disc, in both directions of the image
        chord = _EXTENT_FACTOR * 2.0 * scene.ball_radius * np.sin(0.5 * scene.disc_angle)
        reach = (_TESTED_MARGIN_PX + chord * np.linalg.norm(duv, axis=2))[..., None, None]
        wide = int(np.max(reach, initial=0.0)) + 1
        dv, du = np.mgrid[-wide : wide + 1, -wide : wide + 1]
        disc, row, column = np.nonzero((du / reach[:, 0]) ** 2 + (dv / reach[:, 1]) ** 2 < 1.0)
        corner = np.rint(uv - self._window[:2]).astype(int)[disc] - wide
        row, column = row + corner[:, 1], column + corner[:, 0]
        inside = (row >= 0) & (row < self._rays.shape[0]) & (column >= 0) & (column < self._rays.shape[1])
        return row[inside], column[inside], near[disc[inside]]

    def _covered_share(self, ray: Array, dray: Array, disc_directions: Array, subpixels: int) -> Array:
        """Return the share of the ball's part of pixels that discs cover, (k,): the mean over `subpixels`² parts."""
        grid = pixel_parts(subpixels)
        shape, rays = (len(grid), ray.shape[1]), _spread(ray, dray, grid)
        hits = self._hits(rays)
        g, slope = self._edge_function(hits, rays, *(np.tile(x, len(grid)) for x in (dray, disc_directions)))
        on_ball = (hits.cosine > 0.0).reshape(shape)
        # At the limb g is not linear in the pixel, so the middle of a part represents all of it.
        steep = hits.cosine < np.sqrt(self._pixel)
        part = np.where(steep, g > 0.0, _half_plane(g, slope / subpixels)).reshape(shape) * on_ball
        return part.sum(axis=0) / np.maximum(on_ball.sum(axis=0), 1)

    def _hits(self, ray: Array) -> _Hits:
        """Return where rays, (3, k), meet the ball; a nan ray, which the lens does not have, gives nan."""
        R, origin = self.scene.ball_radius, self._origin
        a = np.einsum("ik,ik->k", ray, ray)
        b = origin @ ray
        root = b * b - a * (origin @ origin - R * R)
        on_ball = root > 0.0
        depth, length = np.sqrt(np.where(on_ball, root, 0.0)), np.sqrt(a)
        s = (-b - depth) / a
        n = origin[:, None] + s * ray
        n /= np.sqrt(np.einsum("ik,ik->k", n, n))
        return _Hits(n, s, length, np.where(on_ball, depth / length / R, 0.0))

    def _edge_function(self, hits: _Hits, ray: Array, dray: Array, disc_directions: Array) -> tuple[Array, Array]:
        """Return g of the module's docstring, (k,), and the absolute values of its derivatives by u and v, (2, k) 1/px.

        `disc_directions` (3, k) are unit vectors in obj, and `dray` (3, 2, k) is the gradient of `ray` in the image. A
        ray that misses the ball has the values of its nearest point. A nan ray, which the lens does not have, has g -1
        and slope 0.
        """
        g = np.einsum("ik,ik->k", hits.normal, disc_directions) - np.cos(self.scene.disc_angle)
        normal_component = -np.maximum(hits.cosine, 1e-6) * hits.length  # of the ray, which comes from outside
        along_ray = np.einsum("ik,ik->k", disc_directions, ray)
        tangent_direction = disc_directions - along_ray / normal_component * hits.normal
        slope = np.einsum("ik,ijk->jk", tangent_direction, dray) * (hits.depth / self.scene.ball_radius)
        return np.nan_to_num(g, nan=-1.0), np.abs(np.nan_to_num(slope))

    def _directions_by_row(self, attitude_at: AttitudeAt, t: float, directions: Array) -> Array:
        """Return directions on the ball in `obj`, (n, 3), each at the time when its own row is exposed.

        `directions`, (n, 3), are in `ball`; `attitude_at` returns R_obj_ball at times, s. `t` is the time of the middle
        row, and with a global shutter that of all.
        """
        turned = directions @ attitude_at(np.array([t]))[0].T
        for _ in range(7 if self.scene.readout_s > 0.0 else 0):  # of the error, a round leaves disc / row speed
            v = self._project(turned)[0][:, 1]
            times = t + row_of(v, self.scene.camera.height) * self.scene.readout_s
            turned = (attitude_at(times) @ directions[..., None])[..., 0]
        return turned

    def _project(self, directions: Array) -> tuple[Array, Array]:
        pose = self.scene.pose
        return project(pose.to_cam(self.centre + self.scene.ball_radius * directions), self.scene.camera)

    # ---- truth ----

    def truth(self, attitude_at: AttitudeAt, t: float, covered: Coverage, shown: Shares, alone: Shares) -> DiscTruth:
        """Return the discs with centres on the near side at time `t`, each at the time of its own rows.

        `covered` is the coverage at that time. `shown` and `alone`, (h, w), are the shares of each pixel that the ball
        fills as it is seen, and with nothing in front of it. The result's `frame` is 0.
        """
        scene, n = self.scene, len(self.scene.disc_directions)
        directions = self._directions_by_row(attitude_at, t, scene.disc_directions)
        angle = np.arccos(np.clip(directions @ self._eye, -1.0, 1.0))
        discs = np.flatnonzero((angle < self._horizon) & self._present)
        middle = scene.disc_directions[discs]
        ring = np.cos(scene.disc_angle) * middle[:, None]
        ring = ring + np.sin(scene.disc_angle) * (circle(_POLYGON_CORNERS) @ np.swapaxes(tangent_basis(middle), 1, 2))
        edges = self._directions_by_row(attitude_at, t, ring.reshape(-1, 3))
        blob, area = _polygon(self._project(edges)[0].reshape(len(discs), _POLYGON_CORNERS, 2))
        cut = angle[discs] + scene.disc_angle > self._horizon  # by the limb
        area[cut], blob[cut] = np.nan, np.nan

        whole, seen = (
            np.bincount(covered.disc, covered.share * view.ravel()[covered.pixel], n)[discs] for view in (alone, shown)
        )
        whole = np.where(cut, whole, np.maximum(whole, 0.99 * area))  # parts outside the image are hidden
        visible = seen / np.maximum(whole, 1e-9)
        state = np.where(visible > 0.99, np.where(cut, PARTLY_HIDDEN, VISIBLE), PARTLY_HIDDEN)
        state = np.where(visible > 0.01, state, HIDDEN).astype(np.intp)
        centre = self._project(directions[discs])[0]
        return DiscTruth(np.zeros(len(discs), dtype=np.intp), discs, centre, blob, area, state)


def _spread(ray: Array, dray: Array, grid: Array) -> Array:
    """Return the rays of all places (n, 2) px of a `grid` in pixels with rays (3, k), (3, n * k), place by place."""
    return (ray[:, None] + grid @ dray).reshape(3, -1)


def _half_plane(g: Array, slope: Array) -> Array:
    """Share of a unit square where a linear function is positive: value `g` in the middle (k,), |gradient| (2, k)."""
    wide, narrow = np.maximum(slope.max(axis=0), 1e-15), np.maximum(slope.min(axis=0), 1e-15)
    t = np.abs(g)
    low, high = 0.5 * (wide - narrow), 0.5 * (wide + narrow)
    share = np.where(t <= low, 0.5 + t / wide, 1.0 - 0.5 * np.maximum(high - t, 0.0) ** 2 / (wide * narrow))
    return np.where(g >= 0.0, share, 1.0 - share)


def _polygon(corners: Array) -> tuple[Array, Array]:
    """Centroid, (n, 2), and area, (n,), of polygons (n, k, 2) inscribed in ellipses."""
    origin = corners.mean(axis=1, keepdims=True)
    a = corners - origin
    b = np.roll(a, -1, axis=1)
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    doubled_area = cross.sum(axis=1)
    centroid = ((a + b) * cross[..., None]).sum(axis=1) / (3.0 * doubled_area)[:, None]
    k = corners.shape[1]
    chords = 2.0 * np.pi / k / np.sin(2.0 * np.pi / k)  # the area between chords and curve
    return origin[:, 0] + centroid, 0.5 * np.abs(doubled_area) * chords
