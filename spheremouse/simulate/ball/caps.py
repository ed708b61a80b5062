"""The discs on the ball as they appear in the image: spherical caps, their coverage of pixels and their exact outlines.

A cap has all points of the sphere within an angle of its centre. Let n(u, v) be the unit vector of the point where a
pixel's ray hits the ball, and d the cap's centre. Then g = n·d - cos(angle) is positive inside. The distance to the
edge in pixels is g over its image gradient. It gives the covered fraction of a pixel that a straight edge crosses.
"""

import copy
from collections.abc import Callable
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE, DiscTruth
from spheremouse.geometry.camera import project, sphere_outline, unproject
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.shapes import pixel_parts

AttitudeAt = Callable[[Array], Array]  # times (n,) s -> R_obj_ball (n, 3, 3)

_PARTS = 2  # of a pixel's side, for a painted pattern
_FINE = 3  # parts of a pixel's side where an edge runs through it
_FINER = 7  # the same near the limb, where a pixel sees far around the ball
_GRAZING = 5.0  # square roots of a pixel's size on the ball, in radii: below that cosine is near the limb
_CORNERS = 180  # of the polygon that approximates a cap's outline
_MARGIN = 2  # px around a disc that are tested


class Coverage(NamedTuple):
    """Shares of an image's pixels that discs cover."""

    pixel: NDArray[np.intp]  # (k,) index into the image's pixels, row by row
    disc: NDArray[np.intp]  # (k,)
    share: Array  # (k,) of the ball's part of the pixel that the disc covers


class BallView(NamedTuple):
    """Fractions of each pixel that the ball fills. Their difference gives the hidden part."""

    shown: NDArray[np.float32]  # (h, w) as it is seen
    alone: NDArray[np.float32]  # (h, w) were nothing in front of it


class Surface(NamedTuple):
    """Points of the ball that pixels show, `_PARTS`² in each."""

    pixel: NDArray[np.intp]  # (k,) index into the image's pixels, row by row
    normal: NDArray[np.float32]  # (k, m, 3) unit vectors, obj
    weight: NDArray[np.float32]  # (k, m) of the points in their pixel's mean; parts that miss the ball have almost none

    def parts(self, *chosen: int) -> "Surface":
        """Return some of the parts of each pixel."""
        weight = self.weight[:, chosen]
        return Surface(self.pixel, self.normal[:, chosen], weight / weight.sum(axis=1, keepdims=True))


class _Hit(NamedTuple):
    """Rays on the ball. One that misses it has the point where it is nearest."""

    normal: Array  # (k, 3) unit vectors, obj
    depth: Array  # (k,) in lengths of the ray
    length: Array  # (k,) m, of the ray
    cosine: Array  # (k,) of the angle between ray and normal, 0 where the ray misses the ball


class _Edge(NamedTuple):
    g: Array  # (k,) of the module's docstring
    slope: Array  # (k, 2) absolute values of its gradient, 1/px
    cosine: Array  # (k,) of the angle between ray and normal, 0 where the ray misses the ball


class Caps:
    """The caps of a scene's discs in its camera."""

    def __init__(self, scene: Scene, reach: float = 0.0) -> None:
        """`reach`: m, how far the ball's centre may be from its place."""
        self.scene = scene
        camera, pose = scene.camera, scene.pose
        self._there = ~np.isin(np.arange(len(scene.disc_directions)), scene.fallen)  # (n,) on the ball
        self._place(np.zeros(3))
        self._low, high = _ball_bounds(scene, scene.ball_radius + reach)
        v, u = np.mgrid[self._low[1] : high[1], self._low[0] : high[0]]
        xy, dxy_duv = unproject(np.stack([u.ravel(), v.ravel()], axis=1).astype(float), camera)
        turn = pose.rotation[:, :2]
        self._ray = (xy @ turn.T + pose.rotation[:, 2]).reshape(*u.shape, 3)
        self._dray = (turn @ dxy_duv).reshape(*u.shape, 3, 2)
        self._size = u.shape

    def moved(self, centre: Array) -> Self:
        """The same with the ball's centre, (3,) m in obj, elsewhere within reach."""
        other = copy.copy(self)
        other._place(centre)
        return other

    def _place(self, centre: Array) -> None:
        scene = self.scene
        self._centre = centre
        self._origin = scene.pose.position - centre  # (3,) m, the camera from the ball's centre
        distance = np.linalg.norm(self._origin)
        self._eye = self._origin / distance
        self._horizon = float(np.arccos(scene.ball_radius / distance))  # rad, from the eye
        gap = distance - scene.ball_radius
        focal = max(scene.camera.fx, scene.camera.fy)
        self._pixel = float(gap / scene.ball_radius / focal)  # rad on the ball, square to the ray

    def row_offset(self, v: Array) -> Array:
        """Return the time, s, when image rows `v` (px, any shape) are exposed, relative to the middle row."""
        h = self.scene.camera.height
        return (v - 0.5 * (h - 1)) / h * self.scene.readout_s

    def coverage(self, attitude_at: AttitudeAt, t: float) -> Coverage:
        """Share of pixels that discs cover at time `t` (of the middle row)."""
        centres = self._centres_by_row(attitude_at, t)
        disc, v, u = self._windows(centres)
        toward = centres[v if len(centres) > 1 else np.zeros_like(v), disc]
        row, column = v - self._low[1], u - self._low[0]
        ray, dray = self._ray[row, column], self._dray[row, column]
        edge = self._edge(ray, dray, toward)
        share = (edge.g > 0.0).astype(float)
        reach = 1.5 * self._pixel / np.maximum(edge.cosine, np.sqrt(self._pixel))  # rad, from the middle to a corner
        angle = self.scene.disc_angle
        grazing = (edge.cosine < _GRAZING * np.sqrt(self._pixel)) & (edge.g > np.cos(angle + reach) - np.cos(angle))
        cut = np.abs(edge.g) <= 0.75 * edge.slope.sum(axis=1)
        for pixels, fine in ((np.flatnonzero(cut & ~grazing), _FINE), (np.flatnonzero(grazing), _FINER)):
            share[pixels] = self._share(ray[pixels], dray[pixels], toward[pixels], fine)
        keep = share > 0.0
        return Coverage((v * self.scene.camera.width + u)[keep], disc[keep], share[keep])

    def surface(self, shown: NDArray[np.floating]) -> Surface:
        """Return the points of the ball that pixels show, if its share `shown` of the pixel, (h, w), is above 0."""
        row, column = np.nonzero(shown[self._low[1] :, self._low[0] :][: self._size[0], : self._size[1]] > 0.0)
        grid = pixel_parts(_PARTS)
        ray = self._ray[row, column][:, None] + grid @ self._dray[row, column].transpose(0, 2, 1)
        hit = self._hit(ray.reshape(-1, 3))
        weight = np.where(hit.cosine > 0.0, 1.0, 1e-6).reshape(-1, len(grid))
        normal = np.where(np.isnan(hit.normal), self._eye, hit.normal).reshape(-1, len(grid), 3)
        return Surface(
            (row + self._low[1]) * self.scene.camera.width + column + self._low[0],
            normal.astype(np.float32),
            (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32),
        )

    def truth(self, attitude_at: AttitudeAt, t: float, frame: int, covered: Coverage, view: BallView) -> DiscTruth:
        """Return the discs with centres on the near side at time `t`, each at the time of its own rows.

        `covered` is the coverage at that time.
        """
        scene = self.scene
        discs = np.arange(len(scene.disc_directions))
        directions, times = self._directions(attitude_at, t, scene.disc_directions)
        angle = np.arccos(np.clip(directions @ self._eye, -1.0, 1.0))
        near = (angle < self._horizon) & self._there
        discs, directions, angle = discs[near], directions[near], angle[near]
        centre = self._project(directions)
        ring = self._outline(scene.disc_directions[discs])
        edges, _ = self._directions(attitude_at, t, ring.reshape(-1, 3), np.repeat(times[near], _CORNERS))
        blob, area = _polygon(self._project(edges).reshape(len(discs), _CORNERS, 2))
        cut = angle + scene.disc_angle > self._horizon
        state = self._states(discs, np.where(cut, np.nan, area), covered, view)
        return DiscTruth(
            frame=np.full(len(discs), frame, dtype=np.intp),
            disc=discs,
            centre=centre,
            blob_centre=np.where(cut[:, None], np.nan, blob),
            area=np.where(cut, np.nan, area),
            state=state,
        )

    def _states(self, discs: NDArray[np.intp], area: Array, covered: Coverage, view: BallView) -> NDArray[np.intp]:
        pixel, disc, share = covered
        n = len(self.scene.disc_directions)
        whole = np.bincount(disc, share * view.alone.ravel()[pixel], n)[discs]
        seen = np.bincount(disc, share * view.shown.ravel()[pixel], n)[discs]
        whole = np.where(np.isnan(area), whole, np.maximum(whole, 0.99 * area))  # parts outside the image are hidden
        shown = seen / np.maximum(whole, 1e-9)
        state = np.where(shown > 0.99, VISIBLE, np.where(shown > 0.01, PARTLY_HIDDEN, HIDDEN))
        return np.where(np.isnan(area) & (state == VISIBLE), PARTLY_HIDDEN, state).astype(np.intp)

    def attitude_by_row(self, attitude_at: AttitudeAt, t: float) -> Array:
        """R_obj_ball, (1 or h, 3, 3), when each row is exposed in a frame at time `t`; one if that is the same."""
        h = self.scene.camera.height
        return attitude_at(np.array([t]) if self.scene.readout_s == 0.0 else t + self.row_offset(np.arange(float(h))))

    def _centres_by_row(self, attitude_at: AttitudeAt, t: float) -> Array:
        """Disc directions in `obj`, (1 or h, n, 3)."""
        return self.scene.disc_directions @ self.attitude_by_row(attitude_at, t).transpose(0, 2, 1)

    def _windows(self, centres: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Disc, row and column of all pixels that may show a disc."""
        angle = self.scene.disc_angle
        samples = centres if len(centres) == 1 else centres[np.linspace(0, len(centres) - 1, 9).astype(int)]
        possible = np.flatnonzero((samples @ self._eye > np.cos(self._horizon + angle)).any(axis=0) & self._there)
        around = self._outline(samples[:, possible].reshape(-1, 3), 24).reshape(-1, 3)
        uv = self._project(around).reshape(len(samples), len(possible), 24, 2) - self._low
        limit = np.array(self._size[::-1])
        lows = np.clip(np.floor(uv.min(axis=(0, 2))).astype(int) - _MARGIN, 0, limit)
        highs = np.clip(np.ceil(uv.max(axis=(0, 2))).astype(int) + _MARGIN + 1, 0, limit)
        discs, rows, columns = [], [], []
        for k, low, high in zip(possible, lows, highs, strict=True):
            v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
            discs.append(np.full(v.size, k))
            rows.append(v.ravel() + self._low[1])
            columns.append(u.ravel() + self._low[0])
        if not discs:
            none = np.zeros(0, dtype=np.intp)
            return none, none, none
        return np.concatenate(discs), np.concatenate(rows), np.concatenate(columns)

    def _share(self, ray: Array, dray: Array, toward: Array, fine: int) -> Array:
        """Share of the ball's part of pixels that caps around `toward` cover, (k,), from `fine`² parts of each."""
        grid = pixel_parts(fine)
        n = len(grid)
        rays = (ray[:, None] + grid @ dray.transpose(0, 2, 1)).reshape(-1, 3)
        edge = self._edge(rays, np.repeat(dray, n, axis=0), np.repeat(toward, n, axis=0))
        on_ball = (edge.cosine > 0.0).reshape(-1, n)
        # At the limb g is not linear in the pixel, so the middle of a part represents all of it.
        steep = edge.cosine < np.sqrt(self._pixel)
        part = np.where(steep, edge.g > 0.0, half_plane(edge.g, edge.slope / fine)).reshape(-1, n) * on_ball
        return part.sum(axis=1) / np.maximum(on_ball.sum(axis=1), 1)

    def _hit(self, ray: Array) -> _Hit:
        R, origin = self.scene.ball_radius, self._origin
        a = np.einsum("ki,ki->k", ray, ray)
        b = ray @ origin
        root = b * b - a * (origin @ origin - R * R)
        on_ball = root > 0.0  # nan (the lens maps no ray there) compares false
        depth = np.sqrt(np.where(on_ball, root, 0.0))
        s = (-b - depth) / a
        n = origin + s[:, None] * ray
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        return _Hit(n, s, np.sqrt(a), np.where(on_ball, depth / np.sqrt(a) / R, 0.0))

    def _edge(self, ray: Array, dray: Array, toward: Array) -> _Edge:
        n, s, length, cosine = self._hit(ray)
        g = np.einsum("ki,ki->k", n, toward) - np.cos(self.scene.disc_angle)
        along = -np.maximum(cosine, 1e-6) * length
        slide = toward - (np.einsum("ki,ki->k", toward, ray) / along)[:, None] * n
        gradient = np.einsum("ki,kij->kj", slide, dray) * (s / self.scene.ball_radius)[:, None]
        return _Edge(np.nan_to_num(g, nan=-1.0), np.abs(np.nan_to_num(gradient)), cosine)

    def _directions(
        self, attitude_at: AttitudeAt, t: float, directions: Array, start: Array | None = None
    ) -> tuple[Array, Array]:
        """Directions in `ball`, (n, 3), turned to `obj`, each at the time of the row it appears in; and the times."""
        if self.scene.readout_s == 0.0:
            return directions @ attitude_at(np.array([t]))[0].T, np.full(len(directions), t)
        times = np.full(len(directions), t) if start is None else start
        for _ in range(6):  # rows are read much faster than discs move: the fixed point is reached at once
            turned = (attitude_at(times) @ directions[..., None])[..., 0]
            times = t + self.row_offset(self._project(turned)[:, 1])
        return (attitude_at(times) @ directions[..., None])[..., 0], times

    def _outline(self, directions: Array, corners: int = _CORNERS) -> Array:
        """Points around caps, (n, corners, 3) unit vectors, for centres (n, 3)."""
        angle = self.scene.disc_angle
        phase = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
        around = np.stack([np.cos(phase), np.sin(phase)], axis=1) @ np.swapaxes(tangent_basis(directions), 1, 2)
        return np.cos(angle) * directions[:, None] + np.sin(angle) * around

    def _project(self, directions: Array) -> Array:
        pose = self.scene.pose
        return project(pose.to_cam(self._centre + self.scene.ball_radius * directions), self.scene.camera)[0]


def _ball_bounds(scene: Scene, radius: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Columns and rows that show a ball of `radius` m: first, (2,), and one past the last, (2,)."""
    uv = sphere_outline(scene.pose.to_cam(np.zeros(3)), radius, scene.camera, 360)
    limit = np.array([scene.camera.width, scene.camera.height])
    low = np.clip(np.floor(uv.min(axis=0)).astype(int) - _MARGIN, 0, limit)
    high = np.clip(np.ceil(uv.max(axis=0)).astype(int) + _MARGIN + 1, 0, limit)
    return low, high


def half_plane(g: Array, slope: Array) -> Array:
    """Share of a unit square where a linear function is positive: value `g` in the middle (k,), |gradient| (k, 2)."""
    wide = np.maximum(np.maximum(slope[:, 0], slope[:, 1]), 1e-15)
    narrow = np.maximum(np.minimum(slope[:, 0], slope[:, 1]), 1e-15)
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
    twice = cross.sum(axis=1)
    centroid = ((a + b) * cross[..., None]).sum(axis=1) / (3.0 * np.where(twice == 0.0, 1.0, twice)[:, None])
    k = corners.shape[1]
    chords = 2.0 * np.pi / k / np.sin(2.0 * np.pi / k)  # the area between chords and curve
    return origin[:, 0] + centroid, 0.5 * np.abs(twice) * chords
