"""Where to put the discs: layouts whose views all differ, and what is wrong with a given one.

Directions in `ball`, angles in rad. Two attitudes are told apart by the discs that one shows and the other does not;
`judge` finds for every view the other attitude with the fewest of them, `search` moves discs until even the worst view
has many. Starts are discs that push each other away; the moves are simulated annealing (Kirkpatrick et al. 1983).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import identify
from spheremouse.calibrate.layout.coincidence import nearest_doubles, turns_of_all, weights
from spheremouse.calibrate.layout.limits import CLEAR, ENOUGH, FEWEST, MOST
from spheremouse.geometry.rotation import Array, exp, hat, log, tangent_basis
from spheremouse.simulate.ball.scene import spread_directions

_SHARPNESS = 2.0  # of the mean over views, per contradiction: the worst views count by far the most
_COOLING = 0.15  # contradictions that a move may lose at the start


@dataclass(frozen=True, slots=True)
class Judgement:
    """The worth of a layout."""

    in_view: int  # fewest discs in view, over all directions to the camera
    apart: float  # rad, between the two discs nearest to each other
    closest: tuple[int, int]  # these two
    alike: float  # rad, places nearer than this pass for the same
    contradictions: Array  # (v,) of views evenly spread: discs that tell it from the attitude most like it
    worst: tuple[NDArray[np.intp], NDArray[np.intp]]  # discs of the worst view, and those they can be mistaken for
    symmetries: Array  # (s, 3, 3) turns that bring nine tenths of all discs onto discs

    @property
    def separability(self) -> float:
        """Contradictions in the worst of all views."""
        return float(np.min(self.contradictions))

    @property
    def unclear(self) -> float:
        """Share of views with fewer contradictions than `CLEAR`."""
        return float(np.mean(self.contradictions < CLEAR))


@dataclass(frozen=True, slots=True)
class Step:
    """Progress of a search."""

    done: int
    steps: int
    directions: Array  # (n, 3) the best so far
    score: float  # contradictions, a mean over views that counts the worst most


@dataclass(frozen=True, slots=True)
class Trials:
    """Shares of random attitudes that `identify` recognised, refused, and mistook."""

    found: float
    refused: float
    wrong: float


# ---- measures ----


def spacing(n: int) -> float:
    """rad, between neighbours among n evenly spread discs: the side of a square that is one disc's share."""
    return float(np.sqrt(4.0 * np.pi / n))


def alike(n: int) -> float:
    """rad, at which two places pass for the same: an eighth of the spacing, at most 5 degrees.

    Wide on purpose: far more than a camera errs, so that discs put up by eye keep what was designed.
    """
    return min(spacing(n) / 8.0, float(np.radians(5.0)))


def evenly_spread(n: int) -> Array:
    """Directions, (n, 3), on a spiral of the golden angle (González 2010)."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(n)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def least_in_view(directions: Array, view_angle: float) -> int:
    """Fewest discs within `view_angle` of any direction, exactly, but for patches that touch in a corner only.

    Circles of that angle around the discs part the sphere into patches of equal number. The number beside a corner is
    that of the corner less the two discs whose circles cross there; a circle that crosses no other has its number
    just outside or across, which evenly spread directions find.
    """
    c = np.cos(view_angle)
    tried = [np.sum(evenly_spread(1000) @ directions.T > c, axis=1)]
    i, j = np.triu_indices(len(directions), 1)
    half = 0.5 * np.linalg.norm(directions[i] + directions[j], axis=1)  # cosine of half the angle between the two
    crosses = (half > np.abs(c)) & (half < 1.0 - 1e-12)
    i, j, half = i[crosses], j[crosses], half[crosses, None]
    middle = (directions[i] + directions[j]) / (2.0 * half)
    across = np.cross(directions[i], directions[j])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for sign in (1.0, -1.0):
        corner = c / half * middle + sign * np.sqrt(1.0 - (c / half) ** 2) * across
        inside = corner @ directions.T > c + 1e-9
        inside[np.arange(len(i)), i] = inside[np.arange(len(j)), j] = False
        tried.append(inside.sum(axis=1))
    return int(np.min(np.concatenate(tried)))


def judge(directions: Array, view_angle: float, views: int | None = None) -> Judgement:
    """Weigh a layout, (n, 3) unit vectors with n from 4, as seen by a camera that sees discs within `view_angle`."""
    n = len(directions)
    near = alike(n)
    angle = _angles(directions)
    first, second = divmod(int(np.argmin(angle + 10.0 * np.eye(n))), n)
    pairs = _pairs(directions, near, view_angle)
    axes = evenly_spread(_views(n) if views is None else views)
    doubles = nearest_doubles(directions, pairs, axes, float(np.cos(view_angle)), near)
    worst = int(np.argmin(doubles.contradictions))
    return Judgement(
        in_view=least_in_view(directions, view_angle),
        apart=float(angle[first, second]),
        closest=(first, second),
        alike=near,
        contradictions=doubles.contradictions,
        worst=_mistaken(directions, axes[worst], doubles.turns[worst], view_angle, near),
        symmetries=_symmetries(directions, pairs, near),
    )


def recognised(
    directions: Array, view_angle: float, sigma: float, missing: float, trials: int, rng: np.random.Generator
) -> Trials:
    """Success of `identify` at random attitudes: noise `sigma` rad per axis, each disc missing with a probability."""
    camera, cosine = np.array([0.0, 0.0, 1.0]), float(np.cos(view_angle))
    found = wrong = 0
    for _ in range(trials):
        R = _random_rotation(rng)
        seen = directions @ R.T
        seen = seen[(seen[:, 2] > cosine) & (rng.random(len(seen)) >= missing)]
        seen = _unit(seen + sigma * rng.standard_normal(seen.shape))
        # a disc just beyond the reliable part may be seen and need not be
        result = identify(seen, directions, sigma=sigma, view_axis=camera, horizon=float(np.cos(view_angle + 0.05)))
        if result is None:
            continue
        right = np.linalg.norm(log(result.rotation @ R.T)) < max(8.0 * sigma, 0.02)
        found, wrong = found + int(right), wrong + int(not right)
    return Trials(found / trials, (trials - found - wrong) / trials, wrong / trials)


def misplaced(directions: Array, sd: float, rng: np.random.Generator) -> Array:
    """The layout put up inaccurately: each disc off by `sd` rad (standard deviation) to either side, (n, 3)."""
    offset = sd * rng.standard_normal((len(directions), 2))
    return _unit(directions + np.einsum("nij,nj->ni", tangent_basis(directions), offset))


def inaccurate(
    directions: Array, view_angle: float, sds: Array, trials: int, rng: np.random.Generator
) -> Iterator[tuple[Array, NDArray[np.intp]]]:
    """Separability and discs in view, (trials,) each, of misplaced layouts, for each of some sds, (k,) rad."""
    views = min(300, _views(len(directions)))
    for sd in sds:
        judged = [judge(misplaced(directions, float(sd), rng), view_angle, views) for _ in range(trials)]
        yield np.array([j.separability for j in judged]), np.array([j.in_view for j in judged], dtype=np.intp)


# ---- search ----


def default_steps(n: int) -> int:
    """Moves that take some 12 s: a move costs about n to the power of 2.5."""
    return int(np.clip(400 * (26 / n) ** 2.5, 10, 1000))


def search(n: int, view_angle: float, apart: float, seed: int, steps: int | None = None) -> Iterator[Step]:
    """Look for a layout of `n` discs, none nearer than `apart` rad to another; the last step holds the best.

    Maximises the contradictions of the worst views (a mean over views of exp(-2 contradictions), as contradictions)
    among layouts that keep as many discs in view as the best of some random starts (more, where that is below
    `ENOUGH`), and neighbours at 0.55 of the even spacing or more. The same arguments give the same layout. ValueError
    where so many discs do not fit.
    """
    assert FEWEST <= n <= MOST
    rng = np.random.default_rng(seed)
    steps = default_steps(n) if steps is None else steps
    axes = evenly_spread(150 if n <= 60 else 60)
    starts = [spread_directions(n, apart, rng) for _ in range(int(np.clip(200 // n, 2, 8)))]
    scores = [_score(d, view_angle, axes) for d in starts]
    views = [least_in_view(d, view_angle) for d in starts]
    chosen = max(range(len(starts)), key=lambda k: (views[k], scores[k]))
    d, score, floor = starts[chosen], scores[chosen], views[chosen]
    best, best_score = d, score
    least = max(apart, min(0.55 * spacing(n), float(np.min(_angles(d) + 10.0 * np.eye(n)))))
    for step in range(steps):
        moved = d.copy()
        k = rng.integers(n)
        moved[k] = misplaced(d[k : k + 1], alike(n) * rng.choice([0.5, 1.0, 2.0]), rng)[0]
        nearest = np.max(np.delete(moved @ moved[k], k))
        if nearest < np.cos(least) and (in_view := least_in_view(moved, view_angle)) >= floor:
            new = _score(moved, view_angle, axes)
            more = min(in_view, ENOUGH) > floor
            if more or new > score + _COOLING * (1.0 - step / steps) * np.log(rng.random()):
                d, score = moved, new
            if more or score > best_score:
                best, best_score = d, score
            floor = max(floor, min(in_view, ENOUGH))
        yield Step(step + 1, steps, best, best_score)


def in_order(directions: Array) -> Array:
    """The layout turned and sorted for a person: disc 1 at the pole (z), disc 2 on the zero meridian (towards x).

    Disc 2 is the nearest to disc 1; the others follow from the pole down. A turn changes no view.
    """
    angle = _angles(directions) + 10.0 * np.eye(len(directions))
    pole = int(np.argmin(np.min(angle, axis=1)))
    z = directions[pole]
    x = directions[int(np.argmin(angle[pole]))]
    x = _unit(x - (x @ z) * z)
    axes: Array = np.stack([x, hat(z) @ x, z], axis=1)
    turned = directions @ axes
    return turned[np.argsort(-turned[:, 2], kind="stable")]


# ---- parts ----


def _score(directions: Array, view_angle: float, axes: Array) -> float:
    near = alike(len(directions))
    found = nearest_doubles(
        directions, _pairs(directions, near, view_angle), axes, float(np.cos(view_angle)), near
    ).contradictions
    return float(-np.log(np.mean(np.exp(-_SHARPNESS * found)) + 1e-300) / _SHARPNESS)


def _views(n: int) -> int:
    return int(np.clip(1000 * (26 / n) ** 1.5, 150, 1000))


def _pairs(directions: Array, near: float, view_angle: float) -> NDArray[np.int32]:
    """Discs (i, j, a, b), (h, 4): each disc with its neighbours, and all ordered pairs that are as far apart.

    Neighbours are enough: what is mistaken for a view shows most of its discs, and so some neighbours.
    """
    n = len(directions)
    angle = _angles(directions)
    order = np.argsort(angle + 10.0 * np.eye(n), axis=1, kind="stable")[:, : int(np.clip(200 // n, 2, min(8, n - 1)))]
    i, j = np.unique(np.sort(np.stack([np.repeat(np.arange(n), order.shape[1]), order.ravel()]), axis=0), axis=1)
    fixes = (angle[i, j] > near) & (angle[i, j] < min(2.0 * view_angle, np.pi - near))
    i, j = i[fixes], j[fixes]
    a, b = np.nonzero((angle > near) & ~np.eye(n, dtype=bool))
    by_angle = np.argsort(angle[a, b], kind="stable")
    a, b = a[by_angle], b[by_angle]
    low = np.searchsorted(angle[a, b], angle[i, j] - near)
    count = np.searchsorted(angle[a, b], angle[i, j] + near) - low
    which = np.repeat(np.arange(len(i)), count)
    partner = np.arange(count.sum()) + np.repeat(low + count - np.cumsum(count), count)
    found = np.stack([i[which], j[which], a[partner], b[partner]], axis=1)
    return found[(found[:, 0] != found[:, 2]) | (found[:, 1] != found[:, 3])].astype(np.int32)


def _mistaken(
    directions: Array, axis: Array, turn: Array, view_angle: float, near: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Discs in a view that meet discs after a turn, and those that they meet."""
    before, _, partner = weights(directions, turn, near)
    met = (directions @ axis > np.cos(view_angle)) & (before < 1.0) & (np.abs(turn - np.eye(3)).max() > 0.0)
    return np.flatnonzero(met), partner[met].astype(np.intp)


def _symmetries(directions: Array, pairs: NDArray[np.int32], near: float) -> Array:
    turns, share = turns_of_all(directions, pairs, near)
    distinct: list[Array] = [np.eye(3)]
    for k in np.argsort(-share, kind="stable"):
        if share[k] < 0.9:
            break
        if all(np.sum(turns[k] * other) < 1.0 + 2.0 * np.cos(2.0 * near) for other in distinct):
            distinct.append(turns[k])
    return np.array(distinct[1:]).reshape(-1, 3, 3)


def _angles(directions: Array) -> Array:
    return np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _random_rotation(rng: np.random.Generator) -> Array:
    """Uniform over all rotations, (3, 3): a random axis for the pole and a random turn about it."""
    columns, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return columns * np.linalg.det(columns) @ exp(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)]))
