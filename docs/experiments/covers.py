"""The ball covered by hands and boards: how much may be hidden, and how soon it is found again.

An opaque cover grows over the ball, under the frame, from nothing to all within 8 s, while the ball turns as in the
thesis at 30 Hz. The value is the hidden share of the visible ball when discs last held the attitude. Then the ball
turns at 115 °/s while a cover hides it for 1 s and goes at once. The table gives the time until the attitude is right
(to 1°, for 0.2 s) and the rate (to 6 °/s); half a frame is added, since a cover can go at any time.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.kit.film import TRACKERS
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Claim, Part, Plot, Table, by, tidy, where
from experiments.kit.world import (
    DISCS,
    NOISE,
    RATES,
    WHO,
    Course,
    SpedUp,
    World,
    after_rest,
    course_begun,
    random_axis,
    rotation_error,
    tracker_for,
    world,
)
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import advance, step
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.film import Renderer, RenderOptions
from spheremouse.simulate.ball.profile import Profile, thesis
from spheremouse.tracker import Frame, Status

Sight = Detections | NDArray[np.uint8]  # what a detector found, or a picture
Cover = NDArray[np.bool_]  # (h, w) pixels in which something is before the ball
View = Callable[[Cover | None], Sight]  # of one moment, with a cover or without
TITLE = "Covers, and finding the ball again"
_SHEET = np.uint8(110)  # grey value of a cover


def jobs(request: Request) -> list[Job]:
    """A ball, and a camera's rate with a ball; in a whole run some of them in pictures as well."""
    quick = request.quick
    kinds = list(FILMED if quick else COVERS)
    rates, seeds, layouts = ((15.0, 30.0), 1, 1) if quick else (RATES, 3, 2)
    found = [
        Job(f"cover-{n}-{k}", covered, {"discs": n, "layout": k, "pictures": False, "kinds": kinds}, cost=4.0)
        for n in ((DISCS,) if quick else COUNTS)
        for k in range(layouts)
    ]
    found += [
        Job(f"again-{fps:g}-{seed}", found_again, {"fps": fps, "seed": seed, "pictures": False}, cost=1.0 + 0.024 * fps)
        for fps in rates
        for seed in range(seeds)
    ]
    if not quick:
        what = {"discs": DISCS, "layout": 0, "pictures": True, "kinds": list(FILMED)}
        found.append(Job(f"cover-{DISCS}-0-filmed", covered, what, cost=20.0))
        found.append(Job("again-30-0-filmed", found_again, {"fps": 30.0, "seed": 0, "pictures": True}, cost=12.0))
    return found


@dataclass(slots=True)
class Eye:
    """Observations of a world, with pictures or without."""

    world: World
    pictures: bool
    seed: int
    _rng: np.random.Generator = field(init=False)
    _renderer: Renderer | None = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 4])
        self._renderer = Renderer(self.world.scene, RenderOptions(noise=NOISE)) if self.pictures else None

    def at(self, motion: Profile, t: float) -> View:
        """At a time of a motion, s."""
        if self._renderer is None:
            R = motion.attitude(np.array([t]))[0]
            return lambda cover: self.world.see(R, self._rng, cover)
        image = self._renderer.frame(motion, t, 0, self._rng).frame.image
        return lambda cover: image if cover is None else np.where(cover[..., None], _SHEET, image)


def shown(state: TrackState, stamp: float, sight: Sight, tracker: Tracker) -> TrackState:
    """The next state."""
    if isinstance(sight, Detections):
        return advance(state, stamp, sight, tracker)[0]
    return step(state, Frame(sight, stamp, 0), tracker)[0]


COVERS = ("from the left", "from the right", "from above", "from below", "closing in", "from the middle")
FILMED = COVERS[::2]  # and in a quick run
COUNTS = (16, 26, DISCS, 74)
FPS, _BEFORE, GROWS = 30.0, 1.0, 8.0  # Hz; s until the cover comes; s from nothing to all


def growing(world: World, kind: str) -> Array:
    """Return for each pixel of the ball the share of the visible ball that is hidden first, (h, w); 2 elsewhere."""
    v, u = np.nonzero(world.ball)
    middle = project(world.scene.pose.to_cam(np.zeros((1, 3))), world.scene.camera)[0][0]
    away = np.hypot(u - middle[0], v - middle[1])
    # the far camera is rolled by 90 degrees, so above is along obj's y
    up = world.scene.pose.rotation.T @ np.array([0.0, 1.0, 0.0])
    right = world.scene.pose.rotation.T @ np.array([1.0, 0.0, 0.0])
    place = {"from the left": u * right[0] + v * right[1], "from below": u * up[0] + v * up[1], "from the middle": away}
    place |= {"from the right": -place["from the left"], "from above": -place["from below"], "closing in": -away}
    order = np.full(world.ball.shape, 2.0)
    order[v, u] = np.argsort(np.argsort(place[kind], kind="stable"), kind="stable") / len(u)
    return order


def covered(discs: int, layout: int, pictures: bool, kinds: Sequence[str]) -> Result:
    """Share of the visible ball that was hidden when discs last held the attitude, by cover and tracker."""
    there, motion = world(discs, layout), thesis()
    eye = Eye(there, pictures, layout)
    trackers = {who: tracker_for(who, there) for who in TRACKERS}
    started = {who: after_rest(who, tracker, there) for who, tracker in trackers.items()}
    orders = {kind: growing(there, kind) for kind in kinds}
    going: dict[tuple[str, str], Course] = {
        (kind, who): course_begun(started[who]) for kind in kinds for who in TRACKERS
    }
    found: Result = {kind: dict.fromkeys(TRACKERS, 0.0) for kind in kinds}
    for t in np.arange(1.0, motion.seconds * FPS) / FPS:
        share = float(np.clip((t - _BEFORE) / GROWS, 0.0, 1.0))
        view, R = eye.at(motion, float(t)), motion.attitude(np.array([t]))[0]
        for kind in kinds:
            sight = view(orders[kind] < share)
            for who in [w for k, w in going if k == kind]:
                course = going.pop((kind, who))
                stamp = started[who].filter.stamp + float(t)
                after = course.then(shown(course.state, stamp, sight, trackers[who]), R)
                if after is not None:
                    going[kind, who] = after
                    if after.state.confirmed_at == stamp:
                        found[kind][who] = share
        if not going:
            break
    return found


COVERED = 1.0  # s, for which nothing is seen
_AT, AFTER = 2.0, 2.5  # s: when the cover comes, and how long is waited afterwards
TURNING, _GENTLY = 2.0, 2.0  # rad/s, and rad/s² up to it
ATTITUDE, RATE, STAYS = 1.0, 0.1, 0.2  # °, rad/s: right again; s, for which it has to stay so


def found_again(fps: float, seed: int, pictures: bool) -> Result:
    """By tracker: frames and ms from when the cover goes until attitude and rate are right again, None: never."""
    there, motion = world(DISCS, seed), SpedUp(random_axis(seed), _GENTLY, TURNING)
    eye = Eye(there, pictures, seed)
    trackers = {who: tracker_for(who, there) for who in WHO}
    started = {who: after_rest(who, tracker, there) for who, tracker in trackers.items()}
    states, end = dict(started), _AT + COVERED
    t = np.arange(1.0, (end + AFTER) * fps + 0.5) / fps
    off: dict[str, list[tuple[Array, float, bool]]] = {who: [] for who in WHO}
    attitudes, rates = motion.attitude(t), motion.rate(t)
    for s, R, w in zip(t, attitudes, rates, strict=True):
        sight = eye.at(motion, float(s))(there.ball if _AT <= s < end else None)
        for who in WHO:
            state = shown(states[who], started[who].filter.stamp + float(s), sight, trackers[who])
            states[who] = state
            rate = float(np.linalg.norm(state.filter.rate - w))
            off[who].append((rotation_error(state, R), rate, state.status is Status.TRACKING))
    return {who: waited(t, off[who], end) for who in WHO}


def waited(t: Array, off: "list[tuple[Array, float, bool]]", end: float) -> Result:
    errors, rate, tracking = (np.array([o[k] for o in off]) for k in range(3))
    before, after = int(np.searchsorted(t, _AT)) - 1, int(np.searchsorted(t, end))
    cosine = 0.5 * (np.sum(errors * errors[before], axis=(1, 2)) - 1.0)
    right = {"attitude": cosine > np.cos(np.radians(ATTITUDE)), "rate": rate < RATE}
    if not tracking[before] or not right["rate"][before]:
        return {"error": "lost before the cover came"}
    frames = round(STAYS / (t[1] - t[0])) + 1
    result: Result = {}
    for what, close in right.items():
        good = close & tracking
        k = next((k for k in range(after, len(t) - frames) if good[k : k + frames].all()), None)
        result[what] = None if k is None else {"frames": k - after + 1, "ms": 1e3 * float(t[k] - end)}
    return result


# ---- section ----


def section(results: Results) -> list[Part]:
    """Return the hidden shares at the loss of the ball, and the times until it is found again."""
    hidden = tidy(
        {
            "discs": int(discs),
            "pictures": key.endswith("filmed"),
            "cover": cover,
            "filter": who,
            "hidden, %": 100.0 * share,
        }
        for key, discs, result in _trials(results, "cover")
        for cover, shares in result.items()
        for who, share in shares.items()
    )
    waits = tidy(
        {
            "Hz": fps,
            "pictures": key.endswith("filmed"),
            "filter": who,
            **{f"{what}, {unit}": _wait(found, what, unit, fps) for what in _WHAT for unit in ("ms", "frames")},
        }
        for key, fps, result in _trials(results, "again")
        for who, found in result.items()
    )
    return [*(_hidden(hidden) if len(hidden) else []), *(_again(waits) if len(waits) else [])]


_WHAT = ("attitude", "rate")


def _trials(results: Results, kind: str) -> Iterator[tuple[str, float, Result]]:
    """Keys of trials `kind-number-...`, their numbers, and results."""
    for key, result in results.items():
        name, number, *_ = key.split("-")
        if name == kind:
            yield key, float(number), result


def _wait(found: Result, what: str, unit: str, fps: float) -> float:
    """inf where it is never right again, nan where the ball was lost before."""
    if "error" in found:
        return np.nan
    half = {"ms": 500.0 / fps, "frames": 0.0}[unit]
    return np.inf if found[what] is None else float(found[what][unit]) + half


def _hidden(rows: pd.DataFrame) -> list[Part]:
    found = by(rows.assign(balls=0), ["discs", "pictures", "cover", "filter"], {"balls": "size", "hidden, %": "median"})
    least = where(rows, filter="so3", pictures=False).groupby("discs")["hidden, %"].min()
    return [
        Table(
            "Share of the visible ball hidden when it is lost (medians; 0: lost before)",
            found,
            ["discs", "pictures", "cover"],
        ),
        Claim(
            "With more discs the cover may hide the more before `so3` loses the ball, whatever side it comes from; "
            "16 discs are too few.",
            len(least) == len(COUNTS) and least.iloc[0] == 0.0 and least.is_monotonic_increasing,
        ),
        Plot(
            "covers-hidden",
            "How much of the visible ball may be hidden, by cover and number of discs.",
            where(rows, pictures=False),
            "cover",
            ["hidden, %"],
            "filter",
            "discs",
        ),
    ]


def _again(rows: pd.DataFrame) -> list[Part]:
    columns = [f"{what}, {unit}" for what in _WHAT for unit in ("ms", "frames")]
    found = by(rows, ["Hz", "pictures", "filter"], dict.fromkeys(columns, "max"))
    known, published = where(rows, filter="so3"), where(rows, filter=list(TRACKERS[:2]))
    return [
        Table(
            "Until it is right again after a full cover (the longest of all balls; inf: never)",
            found,
            ["Hz", "pictures"],
        ),
        Claim(
            "A ball that `so3` knows is found again within one frame. So show it all sides of the ball, "
            "or keep the map.",
            known["attitude, frames"].max(skipna=False) == 1.0,
        ),
        Claim("The published filters never find its attitude.", np.isinf(published["attitude, ms"].dropna()).all()),
        Plot(
            "covers-again",
            "How long after a full cover attitude and rate are right again.",
            where(rows, pictures=False).replace(np.inf, np.nan),
            "Hz",
            ["attitude, ms", "rate, ms"],
            "filter",
            log="xy",
        ),
    ]
