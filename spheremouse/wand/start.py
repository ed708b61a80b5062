"""Poses of a ball from one picture alone: coloured spots in, poses that explain them out.

The outlook of Grzonka 2005 (section 5.2) proposes a window that searches for places with both colours, and hypotheses
of yaw there. Three spots give more: assigned to three discs, at a distance that is large against the ball's radius,
they give the whole pose in two solutions, and so do two spots with their areas. The search assigns neighbouring spots
to discs of their colours in all ways and ranks the poses by how many discs have a spot and how many spots have a disc.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, project, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import Fields
from spheremouse.wand.likelihood import FULL_FACING, MIN_FACING
from spheremouse.wand.model import Model
from spheremouse.wand.rims import Image
from spheremouse.wand.settings import WandSettings

_MIN_SPOT_AREA = 6  # px: the centroid of a smaller spot is that of a pixel
_MIN_BOX_FRACTION = 0.3  # of its upright box that a spot fills: pi / 4 for an ellipse, less if it lies diagonally
_MAX_SPOTS = 60  # the largest; a picture with more is of one colour
_MAX_GLARE_SPOTS = 8  # the largest; a ball shows one for each light
_MAX_BARE_SATURATION = 0.37  # of full saturation: print has more, white paper in any light less
_MIN_SCORE = 0.4  # of the visible discs, by area, that a pose must explain: a hand may hide more than half
_MAX_HYPOTHESES = 48
MAX_ASSIGNMENTS = 300_000  # per picture, some ms: a ball of eight discs and fifty spots need fewer
_SAME_ANGLE, _SAME_ACROSS, _SAME_DEPTH = 0.35, 0.7, 8.0  # rad, radii, radii: closer poses are one
_WIDTH, _HEIGHT, _AREA, _CENTRE = 2, 3, 4, slice(5, 7)  # columns of kernels.connected_areas


@dataclass(frozen=True, slots=True)
class Spots:
    """Connected pixels of one colour each."""

    centre: Array  # (n, 2) px
    area: Array  # (n,) px²
    colour: NDArray[np.int64]  # (n,) index of the colour
    glare: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (m, 3) u, v px, area px² of glare


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Poses that explain spots, the best first."""

    position: Array  # (n, 3) m, cam
    rotation: Array  # (n, 3, 3) R_cam_ball
    score: Array  # (n,) number of visible discs with a spot, times their fraction of all visible discs by area
    next_spot: int = 0  # spot with which to begin the next search; 0 after a complete one


def find_spots(fields: Fields) -> Spots:
    """Return the connected areas of the binary pictures that can be discs, the largest first."""
    found = [np.zeros((0, 4))]
    for c, binary in enumerate(fields.binary):
        areas, _, _ = kernels.connected_areas(binary, diagonal=False)
        area, box_area = areas[:, _AREA], areas[:, _WIDTH] * areas[:, _HEIGHT]
        good = (area >= _MIN_SPOT_AREA) & (area <= binary.size / 8) & (area >= _MIN_BOX_FRACTION * box_area)
        found.append(np.column_stack([_in_picture(areas[good], fields), np.full(np.count_nonzero(good), c)]))
    table = _largest(np.concatenate(found), _MAX_SPOTS)
    glare = np.zeros((0, 3))
    if len(fields.glare):
        bright = np.where(fields.glare[0] > 127, np.uint8(255), np.uint8(0))
        areas, _, _ = kernels.connected_areas(bright, diagonal=True)
        glare = _largest(_in_picture(areas, fields), _MAX_GLARE_SPOTS)
    return Spots(table[:, :2], table[:, 2], table[:, 3].astype(np.int64), glare)


def _in_picture(areas: Array, fields: Fields) -> Array:
    """Return connected areas of fields, (n, 3): u, v px, area px², in pixels of the whole picture."""
    place = (areas[:, _CENTRE] + 0.5) * fields.factor - 0.5 + [fields.left, fields.top]
    return np.column_stack([place, areas[:, _AREA] * fields.factor * fields.factor])


def _largest(spots: Array, most: int) -> Array:
    return spots[np.argsort(-spots[:, 2], kind="stable")[:most]]


def pose_hypotheses(
    spots: Spots,
    ball: WandBall,
    camera: InteriorOrientation,
    names: tuple[str, ...],
    settings: WandSettings,
    first_spot: int = 0,
    max_assignments: int = MAX_ASSIGNMENTS,
) -> Hypotheses:
    """Return poses of a ball that explain spots, its centre between `nearest` and `farthest` of the settings.

    `names` are the colours of the fields from which the spots come. The search begins with `first_spot` and ends after
    `max_assignments`; the next picture continues at `next_spot`.
    """
    none = Hypotheses(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0))
    if len(spots.area) < 2:
        return none
    xy, _ = unproject(spots.centre, camera)
    good = np.isfinite(xy[:, 0])
    xy, area, colour = xy[good], spots.area[good], spots.colour[good]
    if len(xy) < 2:
        return none
    discs = np.array([[*d.direction, d.angle, names.index(d.colour)] for d in ball.discs])
    glare, _ = unproject(spots.glare[:, :2], camera)
    radius = np.sqrt(spots.glare[:, 2] / (np.pi * camera.fx * camera.fy))
    glare = np.column_stack([glare, radius])[np.isfinite(glare[:, 0])]
    limits = np.array([ball.radius / settings.farthest, ball.radius / settings.nearest, 1.5 / camera.fx])
    table = np.column_stack([xy, area / (camera.fx * camera.fy), colour.astype(float)])
    score, position, rotation, next_spot = kernels.assign_spots(
        table, discs, glare, limits, _MIN_SCORE, first_spot % len(xy), max_assignments, _MAX_HYPOTHESES
    )
    best = np.argsort(-score, kind="stable")
    score, position, rotation = score[best], ball.radius * position[best], rotation[best]
    chosen = distinct_poses(position, rotation, ball.radius)
    return Hypotheses(position[chosen], rotation[chosen], score[chosen], next_spot)


def evidence_without_prior(
    image: Image, position: Array, rotation: Array, ball: WandBall, model: Model, camera: InteriorOrientation,
    fields: Fields,
) -> tuple[int, float]:  # fmt: skip
    """Return the evidence for a pose without a predicted one: discs that show, fraction of bare points that look bare.

    The pose is (3,) m in cam and R_cam_ball (3, 3), the picture (h, w, 3) BGR.

    Some pose explains any two spots, since six numbers have six unknowns. A third disc is evidence, and so is the body.
    A white body is paler than print and evenly bright except for its shadow. A black one is darker than the discs.
    """
    u = model.points.table[:, :3] @ rotation.T
    x = position + ball.radius * u
    facing = -np.einsum("ni,ni->n", u, x) / np.linalg.norm(x, axis=1)
    uv, _ = project(x, camera)
    inner = model.points.table[:, 6] > 0.0  # centre of a disc and four points
    shows = np.zeros(len(u), dtype=bool)
    place = np.rint((uv - [fields.left, fields.top] + 0.5) / fields.factor - 0.5)
    h, w = fields.binary.shape[1:]
    good = (facing > MIN_FACING) & np.all((place >= 0) & (place < [w, h]), axis=1)  # false for nan
    column, row = place[good].astype(int).T
    colour = model.points.colour[good]
    shows[good] = (colour >= 0) & (fields.binary[colour, row, column] > 0)
    disc = np.cumsum(model.points.table[:, 9] > 0.0)
    number = len(np.unique(disc[shows & inner]))
    pixel = np.rint(uv)
    good = (facing > FULL_FACING) & np.all((pixel >= 0) & (pixel < [camera.width, camera.height]), axis=1)
    bare, print_ = good & (model.points.colour < 0), good & shows & inner
    if not bare.any():
        return number, 0.0
    bgr = image[pixel[bare, 1].astype(int), pixel[bare, 0].astype(int)].astype(float)
    high = bgr.max(axis=1)
    if ball.body == "white":
        like = (high - bgr.min(axis=1) <= _MAX_BARE_SATURATION * high) & (high >= 0.5 * np.quantile(high, 0.8))
    else:
        lit = image[pixel[print_, 1].astype(int), pixel[print_, 0].astype(int)].max(axis=1, initial=0)
        like = high <= 0.5 * (np.median(lit) if len(lit) else 0.0)
    return number, float(np.mean(like))


def distinct_poses(
    position: Array, rotation: Array, radius: float, count: int = _MAX_HYPOTHESES, kept: int = 0
) -> list[int]:
    """Return the indices of at most `count` poses, best first, without those close to a better one.

    The poses, (n, 3) m in cam and R_cam_ball (n, 3, 3), are in order, the best first. The ball has `radius` m.

    The first `kept` poses are kept in any case.
    """
    chosen: list[int] = []
    free = np.ones(len(position), dtype=bool)
    for i in range(len(position)):
        if i < kept or (len(chosen) < count and free[i]):
            chosen.append(i)
            free &= ~_coincide(position, rotation, i, radius)
    return chosen


def _coincide(position: Array, rotation: Array, i: int, radius: float) -> NDArray[np.bool_]:
    """Compare each pose with pose i, (n,), less strictly along the line of sight, where a pose is less certain."""
    gap = position - position[i]
    along = np.einsum("nj,nj->n", gap, position) ** 2 / np.einsum("nj,nj->n", position, position)
    near = np.einsum("nj,nj->n", gap, gap) - along < (_SAME_ACROSS * radius) ** 2
    trace = np.einsum("njk,jk->n", rotation, rotation[i])
    return near & (along < (_SAME_DEPTH * radius) ** 2) & (0.5 * (trace - 1.0) > np.cos(_SAME_ANGLE))
