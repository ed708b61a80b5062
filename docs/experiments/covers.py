"""The ball covered by hands and boards: how much may be hidden, and how soon it is found again.

There are no pictures: `World` says which discs a camera would see, and where. An opaque cover grows over the ball,
under the frame, from nothing to all within 8 s, while the ball turns as in the thesis at 30 Hz. The value is the hidden
share of the visible ball when discs last held the attitude. Then the ball turns at 115 °/s while a cover hides it for
1 s and goes at once. The table gives the time until the attitude is right (to 1°, for 0.2 s) and the rate (to 6 °/s);
half a frame is added, since a cover can go at any time.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from experiments.kit import world as kit
from experiments.kit.film import TRACKERS
from experiments.kit.job import Job, Request, Result, Results
from experiments.kit.render import Part, Plot, Table, by, tidy
from spheremouse.ball.track import advance
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.profile import thesis
from spheremouse.tracker import Status

TITLE = "Covers, and finding the ball again"


def jobs(request: Request) -> list[Job]:
    quick = request.quick
    rates, seeds, layouts = ((15.0, 30.0), 1, 1) if quick else (kit.RATES, 3, 2)
    found = [
        Job(f"cover-{n}-{k}", covered, {"discs": n, "layout": k, "kinds": list(QUICK if quick else COVERS)}, cost=4.0)
        for n in ((kit.DISCS,) if quick else COUNTS)
        for k in range(layouts)
    ]
    return found + [
        Job(f"again-{fps:g}-{seed}", found_again, {"fps": fps, "seed": seed}, cost=1.0 + 0.024 * fps)
        for fps in rates
        for seed in range(seeds)
    ]


COVERS = ("from the left", "from the right", "from above", "from below", "closing in", "from the middle")
QUICK = COVERS[::2]  # those of a quick run
COUNTS = (16, 26, kit.DISCS, 74)
FPS, _BEFORE, GROWS = 30.0, 1.0, 8.0  # Hz; s until the cover comes; s from nothing to all


def growing(there: kit.World, kind: str) -> Array:
    """Return for each pixel of the ball the share of the visible ball that is hidden first, (h, w); 2 elsewhere."""
    v, u = np.nonzero(there.ball)
    middle = project(there.scene.pose.to_cam(np.zeros((1, 3))), there.scene.camera)[0][0]
    away = np.hypot(u - middle[0], v - middle[1])
    # the far camera is rolled by 90 degrees, so above is along obj's y
    up = there.scene.pose.rotation.T @ np.array([0.0, 1.0, 0.0])
    right = there.scene.pose.rotation.T @ np.array([1.0, 0.0, 0.0])
    place = {"from the left": u * right[0] + v * right[1], "from below": u * up[0] + v * up[1], "from the middle": away}
    place |= {"from the right": -place["from the left"], "from above": -place["from below"], "closing in": -away}
    order = np.full(there.ball.shape, 2.0)
    order[v, u] = np.argsort(np.argsort(place[kind], kind="stable"), kind="stable") / len(u)
    return order


def covered(discs: int, layout: int, kinds: Sequence[str]) -> Result:
    """Share of the visible ball that was hidden when discs last held the attitude, by cover and tracker."""
    there, motion = kit.world(discs, layout), thesis()
    rng = np.random.default_rng([layout, 4])
    trackers = {who: kit.tracker_for(who, there) for who in TRACKERS}
    started = {who: kit.after_rest(who, tracker, there) for who, tracker in trackers.items()}
    orders = {kind: growing(there, kind) for kind in kinds}
    going: dict[tuple[str, str], kit.Course] = {
        (kind, who): kit.course_begun(started[who]) for kind in kinds for who in TRACKERS
    }
    found: Result = {kind: dict.fromkeys(TRACKERS, 0.0) for kind in kinds}
    for t in np.arange(1.0, motion.seconds * FPS) / FPS:
        share = float(np.clip((t - _BEFORE) / GROWS, 0.0, 1.0))
        R = motion.attitude(np.array([t]))[0]
        for kind in kinds:
            seen = there.see(R, rng, orders[kind] < share)
            for who in [w for k, w in going if k == kind]:
                course = going.pop((kind, who))
                stamp = started[who].filter.stamp + float(t)
                after = course.then(advance(course.state, stamp, seen, trackers[who]).state, R)
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


def found_again(fps: float, seed: int) -> Result:
    """By tracker: frames and ms from when the cover goes until attitude and rate are right again, None: never."""
    there, motion = kit.world(kit.DISCS, seed), kit.SpedUp(kit.random_axis(seed), _GENTLY, TURNING)
    rng = np.random.default_rng([seed, 4])
    trackers = {who: kit.tracker_for(who, there) for who in kit.WHO}
    started = {who: kit.after_rest(who, tracker, there) for who, tracker in trackers.items()}
    states, end = dict(started), _AT + COVERED
    t = np.arange(1.0, (end + AFTER) * fps + 0.5) / fps
    off: dict[str, list[tuple[Array, float, bool]]] = {who: [] for who in kit.WHO}
    attitudes, rates = motion.attitude(t), motion.rate(t)
    for s, R, w in zip(t, attitudes, rates, strict=True):
        seen = there.see(R, rng, there.ball if _AT <= s < end else None)
        for who in kit.WHO:
            state = advance(states[who], started[who].filter.stamp + float(s), seen, trackers[who]).state
            states[who] = state
            rate = float(np.linalg.norm(state.filter.rate - w))
            off[who].append((kit.rotation_error(state, R), rate, state.status is Status.TRACKING))
    return {who: waited(t, off[who], end) for who in kit.WHO}


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
    hidden = tidy(
        {"discs": int(discs), "cover": cover, "filter": who, "hidden, %": 100.0 * share}
        for discs, result in _trials(results, "cover")
        for cover, shares in result.items()
        for who, share in shares.items()
    )
    waits = tidy(
        {
            "Hz": fps,
            "filter": who,
            **{f"{what}, {unit}": _wait(found, what, unit, fps) for what in _WHAT for unit in ("ms", "frames")},
        }
        for fps, result in _trials(results, "again")
        for who, found in result.items()
    )
    return [*(_hidden(hidden) if len(hidden) else []), *(_again(waits) if len(waits) else [])]


_WHAT = ("attitude", "rate")


def _trials(results: Results, kind: str) -> Iterator[tuple[float, Result]]:
    for key, result in results.items():
        name, number, *_ = key.split("-")
        if name == kind:
            yield float(number), result


def _wait(found: Result, what: str, unit: str, fps: float) -> float:
    """inf where it is never right again, nan where the ball was lost before."""
    if "error" in found:
        return np.nan
    half = {"ms": 500.0 / fps, "frames": 0.0}[unit]
    return np.inf if found[what] is None else float(found[what][unit]) + half


def _hidden(rows: pd.DataFrame) -> list[Part]:
    found = by(rows.assign(balls=0), ["discs", "cover", "filter"], {"balls": "size", "hidden, %": "median"})
    return [
        Table("Share of the visible ball hidden when it is lost (medians; 0: lost before)", found, ["discs", "cover"]),
        Plot(
            "covers", "How much of the visible ball may be hidden, by cover and number of discs.", rows, "cover",
            ["hidden, %"], "filter", "discs"
        )
    ]  # fmt: skip


def _again(rows: pd.DataFrame) -> list[Part]:
    columns = [f"{what}, {unit}" for what in _WHAT for unit in ("ms", "frames")]
    found = by(rows, ["Hz", "filter"], dict.fromkeys(columns, "max"))
    return [Table("Until it is right again after a full cover (the longest of all balls; inf: never)", found, ["Hz"])]
