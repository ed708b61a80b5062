"""Poses from the picture alone: coloured spots in, poses of the ball that explain them out.

The outlook of Grzonka 2005 (section 5.2) proposes a window that looks for places with both colours, and yaw hypotheses
there. Spots say more: three of them with three discs of the ball assigned, and the ball's distance large against its
radius, give the whole pose in two solutions, and so do two with their areas. Spots near each other are assigned to
discs of their colours in every possible way; a pose that shows discs where there is no spot, or has spots where there
is no disc, falls back. Hypotheses of any attitude result, not of yaw only: a hand turns the ball as it likes.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from spheremouse.geometry.camera import InteriorOrientation, project, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.wand.assign import search
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import Fields
from spheremouse.wand.likelihood import BEGINS, FULLY
from spheremouse.wand.model import Model
from spheremouse.wand.rims import Image
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.spots import Spots

_PALE = 0.37  # of full saturation: print has more, whatever white has in the light of a lamp or of the sky has less
_LEAST = 0.4  # of the discs in view, by area, that a pose must explain: a hand or a highlight may take more than half
_KEPT = 48  # hypotheses handed on
EFFORT = 300_000  # assignments tried per picture, some ms: a ball with eight discs before fifty spots needs fewer
_SAME_TURN, _SAME_PLACE, _SAME_DEPTH = 0.35, 0.7, 8.0  # rad, radii across and along: hypotheses nearer are one


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Poses, the best explanation first."""

    position: Array  # (n, 3) m, cam
    rotation: Array  # (n, 3, 3) R_cam_ball
    score: Array  # (n,) discs in view that have a spot, times their part of all in view by area
    following: int = 0  # index of the spot to begin with next time: there was no time for all; 0: there was


def hypotheses(
    seen: Spots,
    ball: WandBall,
    camera: InteriorOrientation,
    names: tuple[str, ...],
    settings: WandSettings,
    first: int = 0,
    effort: int = EFFORT,
) -> Hypotheses:
    """Poses of a ball that explain spots, its centre between `nearest` and `farthest` of the settings away.

    `names` are the colours of the fields the spots come from. No more assignments are tried than `effort`, beginning
    with those of spot `first`: where there are more, the next picture's turn is at `following`.
    """
    none = Hypotheses(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0))
    if len(seen.area) < 2:
        return none
    xy, _ = unproject(seen.centre, camera)
    good = np.isfinite(xy[:, 0])
    xy, area, colour = xy[good], seen.area[good], seen.colour[good]
    if len(xy) < 2:
        return none
    direction = np.array([d.direction for d in ball.discs])
    angle = np.array([d.angle for d in ball.discs])
    colours = np.array([names.index(d.colour) for d in ball.discs])
    glare, _ = unproject(seen.glare[:, :2], camera)
    radius = np.sqrt(seen.glare[:, 2] / (np.pi * camera.fx * camera.fy))
    glare = np.column_stack([glare, radius])[np.isfinite(glare[:, 0])]
    found = np.empty((_KEPT, 13))
    limits = np.array([ball.radius / settings.farthest, ball.radius / settings.nearest])
    begin = first % len(xy)
    n, following = search(
        xy, area / (camera.fx * camera.fy), colour, direction, angle, colours, limits, 1.5 / camera.fx, _LEAST, glare,
        begin, effort, found,
    )  # fmt: skip
    found = found[np.argsort(-found[:n, 0], kind="stable")]
    position = found[:, 1:4] * ball.radius
    rotation = found[:, 4:].reshape(-1, 3, 3)
    chosen = distinct(position, rotation, ball.radius)
    return Hypotheses(position[chosen], rotation[chosen], found[chosen, 0], following)


def convincing(
    image: Image, position: Array, rotation: Array, ball: WandBall, model: Model, camera: InteriorOrientation,
    fields: Fields,
) -> tuple[int, float]:  # fmt: skip
    """What speaks for a pose that nothing led to: discs that show, and the part of the bare ball that looks like it.

    Two spots of any place and size are explained by some pose: six numbers, six unknowns. The third tells. Between its
    discs a ball is white, paler than any print and evenly bright but for its shadow, or black; rooms are not.
    """
    u = model.points.table[:, :3] @ rotation.T
    x = position + ball.radius * u
    facing = -np.einsum("ni,ni->n", u, x) / np.linalg.norm(x, axis=1)
    uv, _ = project(x, camera)
    inner = model.points.table[:, 6] > 0.0  # of a disc: its centre, which comes first, and four points
    shows = np.zeros(len(u), dtype=bool)
    place = np.rint((uv - [fields.left, fields.top] + 0.5) / fields.factor - 0.5)
    h, w = fields.binary.shape[1:]
    good = (facing > BEGINS) & np.all((place >= 0) & (place < [w, h]), axis=1)  # nan is not
    column, row = place[good].astype(int).T
    colour = model.points.colour[good]
    shows[good] = (colour >= 0) & (fields.binary[colour, row, column] > 0)
    disc = np.cumsum(model.points.table[:, 9] > 0.0)
    number = len(np.unique(disc[shows & inner]))
    pixel = np.rint(uv)
    good = (facing > FULLY) & np.all((pixel >= 0) & (pixel < [camera.width, camera.height]), axis=1)
    bare, print_ = good & (model.points.colour < 0), good & shows & inner
    if not bare.any():
        return number, 0.0
    bgr = image[pixel[bare, 1].astype(int), pixel[bare, 0].astype(int)].astype(float)
    high = bgr.max(axis=1)
    if ball.body == "white":
        like = (high - bgr.min(axis=1) <= _PALE * high) & (high >= 0.5 * np.quantile(high, 0.8))
    else:
        lit = image[pixel[print_, 1].astype(int), pixel[print_, 0].astype(int)].max(axis=1, initial=0)
        like = high <= 0.5 * (np.median(lit) if len(lit) else 0.0)
    return number, float(np.mean(like))


def distinct(position: Array, rotation: Array, radius: float, most: int = _KEPT) -> list[int]:
    """Of poses in falling order, those that are not near a better one, so many at `most`."""
    chosen: list[int] = []
    for i in range(len(position)):
        if len(chosen) < most and not any(
            same(position[i], rotation[i], position[j], rotation[j], radius) for j in chosen
        ):
            chosen.append(i)
    return chosen


def same(p: Array, R: Array, q: Array, S: Array, radius: float) -> bool:
    """Are two poses so near that they are one? Across the line of sight a fraction of the radius tells."""
    return bool(_same(p, R, q, S, radius))


@njit(cache=True)
def _same(p, R, q, S, radius):
    square, dot, gap = 0.0, 0.0, 0.0
    trace = 0.0
    for i in range(3):
        square += p[i] * p[i]
        dot += (p[i] - q[i]) * p[i]
        gap += (p[i] - q[i]) ** 2
        for j in range(3):
            trace += R[i, j] * S[i, j]
    along = dot * dot / square
    near = gap - along < (_SAME_PLACE * radius) ** 2 and along < (_SAME_DEPTH * radius) ** 2
    return near and 0.5 * (trace - 1.0) > np.cos(_SAME_TURN)
