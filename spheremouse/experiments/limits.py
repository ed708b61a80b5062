"""Where tracking ends: how fast, how suddenly, behind how large a cover, and how long until it goes on afterwards.

Most of it without pictures: `World` says which discs a camera would see, and where. What a detector adds, smeared discs
and discs that a cover cuts, is filmed. A trial goes on from the state of the tracker at its start, so that each begins
alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spheremouse.ball.state import Tracker, TrackState
from spheremouse.experiments.covers import (
    _AFTER,
    _ATTITUDE,
    _FPS,
    _GROWS,
    _RATE,
    _STAYS,
    _TURNING,
    COUNTS,
    COVERED,
    COVERS,
    FILMED,
    _Eye,
    _shown,
    _View,
    covered,
    found_again,
)
from spheremouse.experiments.kit.film import TRACKERS
from spheremouse.experiments.kit.job import Figure, Job, Request, Result, Results, Table
from spheremouse.experiments.kit.plot import BOUND
from spheremouse.experiments.kit.world import (
    DISCS,
    HOLD,
    RATES,
    WHO,
    Course,
    SpedUp,
    World,
    _axis,
    _begun,
    _started,
    _tracker,
    world,
)
from spheremouse.experiments.report.cells import (
    _BESIDE,
    _LOOK,
    Grouped,
    _legend,
    _span,
    _with_broken,
    label_lines,
    plain,
    rate_axis,
)
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.profile import Profile

TITLE = "Limits: rate, acceleration, covers, and finding the ball again"

ACCELERATIONS = (4.0, 16.0, 64.0, 256.0)  # rad/s²
PUSH = 3.0  # rad/s, to which the ball is sped up where the acceleration is sought
FASTEST = 25.0  # rad/s, the highest that is tried
SLOWEST, FINE = 0.1, 1.07  # rad/s, the lowest; where bisection ends
HARDEST = 2000.0  # rad/s², the highest acceleration that is tried

EXPOSURE = 0.004  # s: as long as a camera of 240 Hz can
EXPOSURES = (0.0, 0.002, EXPOSURE, 0.008, 0.016)  # s
_WHOLE = 8.0  # rad/s, up to which all of the way is filmed
LADDER = tuple(float(2.0 ** (0.5 * k)) for k in range(10))  # rad/s, that are filmed
_FILMED, _BLIND = 0.1, 0.05  # s of a filmed trial; at its end discs must have held the attitude as late as that


# ---- what is seen ----


# ---- a tracker before it ----


@dataclass(frozen=True, slots=True)
class Trial:
    """A tracker before a ball that lies still at first, and is looked at `fps` times per second."""

    tracker: Tracker
    world: World
    start: TrackState
    axis: Array  # (3,) unit vector, obj
    fps: float
    seed: int

    def course(self, before: Course, motion: Profile, t: Array) -> list[Course]:
        """What comes of `before` at times t (n,) s after the start; ends early where the ball is lost."""
        rng, attitudes = np.random.default_rng([self.seed, len(t)]), motion.attitude(t)
        made: list[Course] = []
        for s, R in zip(t, attitudes, strict=True):
            state = _shown(before.state, self.start.filter.stamp + float(s), self.world.see(R, rng), self.tracker)
            after = before.then(state, R)
            if after is None:
                break
            made.append(after)
            before = after
        return made

    def times(self, end: float) -> Array:
        """Frames up to `end`, s after the ball begins to move, which is not when a frame is taken."""
        phase = 0.1 + 0.8 * np.random.default_rng(self.seed).random()
        count = int(np.floor(end * self.fps - phase)) + 1
        return (np.arange(count, dtype=float) + phase) / self.fps

    def sped_up(self, acceleration: float, most: float) -> list[Course]:
        """The start and all frames in which a ball that is sped up evenly to `most` rad/s is followed."""
        begun = _begun(self.start)
        return [begun, *self.course(begun, SpedUp(self.axis, acceleration, most), self.times(most / acceleration))]

    def fastest(self, acceleration: float) -> float:
        """The highest rate, rad/s, at which a ball sped up evenly to it is followed for HOLD; 0: none."""
        courses = self.sped_up(acceleration, FASTEST)

        def holds(rate: float) -> bool:
            end = rate / acceleration
            done = len(self.times(end))
            t = self.times(end + HOLD)[done:]
            motion = SpedUp(self.axis, acceleration, rate)
            return done < len(courses) and len(self.course(courses[done], motion, t)) == len(t)

        ramp = self.times(FASTEST / acceleration)
        high = FASTEST if len(courses) > len(ramp) else acceleration * float(ramp[len(courses) - 1])
        return _bisected(holds, SLOWEST, high)

    def hardest(self, rate: float) -> float:
        """The highest even acceleration, rad/s², to `rate` rad/s at which it is followed until HOLD later; 0: none."""

        def holds(acceleration: float) -> bool:
            t = self.times(rate / acceleration + HOLD)
            return len(self.course(_begun(self.start), SpedUp(self.axis, acceleration, rate), t)) == len(t)

        return _bisected(holds, 1.0, HARDEST)


def _bisected(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Where what holds below ends; `high` where it holds everywhere, 0 where nowhere."""
    if holds(high):
        return high
    if high <= low or not holds(low):
        return 0.0
    while high > FINE * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def jobs(request: Request) -> list[Job]:
    """A camera's rate, an exposure, a ball, at a time."""
    quick = request.quick
    kinds = list(FILMED if quick else COVERS)
    rates, seeds, films = ((15.0, 30.0), 1, 1) if quick else (RATES, 3, 2)
    found = [
        Job(f"speed-{fps:g}-{seed}", speeds, {"fps": fps, "seed": seed}, cost=2.0 + 0.07 * fps)
        for fps in rates
        for seed in range(seeds)
    ]
    filmed_at = [(30.0, EXPOSURE)] if quick else [(60.0, e) for e in EXPOSURES] + [(30.0, EXPOSURE), (120.0, EXPOSURE)]
    found += [
        Job(
            f"film-{fps:g}-{1e3 * e:g}-{seed}",
            filmed,
            {"fps": fps, "exposure": e, "seed": seed},
            cost=4.0 + fps * (0.05 + 15.0 * e),
        )
        for fps, e in filmed_at
        for seed in range(films if fps == 60.0 and e < EXPOSURES[-1] else 1)
    ]
    found += [
        Job(f"cover-{n}-{k}", covered, {"discs": n, "layout": k, "pictures": False, "kinds": kinds}, cost=4.0)
        for n in ((DISCS,) if quick else COUNTS)
        for k in range(films)
    ]
    found += [
        Job(f"again-{fps:g}-{seed}", found_again, {"fps": fps, "seed": seed, "pictures": False}, cost=1.0 + 0.024 * fps)
        for fps in rates
        for seed in range(seeds)
    ]
    if not quick:
        found.append(
            Job(
                f"cover-{DISCS}-0-filmed",
                covered,
                {"discs": DISCS, "layout": 0, "pictures": True, "kinds": list(FILMED)},
                cost=20.0,
            )
        )
        found.append(Job("again-30-0-filmed", found_again, {"fps": 30.0, "seed": 0, "pictures": True}, cost=12.0))
    return found


# ---- how fast, how suddenly ----


def speeds(fps: float, seed: int) -> Result:
    """Highest rates by acceleration (rad/s) and the highest acceleration to PUSH (rad/s²), of every tracker."""
    there = world(DISCS, seed)
    found: Result = {}
    for who in WHO:
        tracker = _tracker(who, there)
        trial = Trial(tracker, there, _started(who, tracker, there), _axis(seed), fps, seed)
        found[who] = {
            "rate": [trial.fastest(a) for a in ACCELERATIONS],
            "acceleration": trial.hardest(PUSH),
        }
    return found


def filmed(fps: float, exposure: float, seed: int) -> Result:
    """The highest rate of LADDER, rad/s, that is followed in pictures exposed for `exposure` s; 0: none.

    The ball is brought there gently without pictures, about an axis across the view; then all see the same ones. With
    sharp pictures also the rate at which each is lost when all of the way there is filmed, and without pictures.
    """
    there, axis = world(DISCS, seed, exposure), _axis(seed, across=True)
    trials = {}
    for who in TRACKERS:
        tracker = _tracker(who, there)
        trials[who] = Trial(tracker, there, _started(who, tracker, there), axis, fps, seed)
    courses = {who: trial.sped_up(ACCELERATIONS[0], LADDER[-1]) for who, trial in trials.items()}
    found: Result = _climbed(trials, courses, _Eye(there, True, seed))
    if exposure == 0.0:
        both = [_lost_at(trials, _Eye(there, pictures, seed)) for pictures in (True, False)]
        found["sharp"] = {who: [rates[who] for rates in both] for who in trials}
    return found


def _lost_at(trials: dict[str, Trial], eye: "_Eye") -> dict[str, float]:
    """The rate, rad/s, up to which each follows a ball that is sped up gently from rest, to _WHOLE at most."""
    one = next(iter(trials.values()))
    motion = SpedUp(one.axis, ACCELERATIONS[0], _WHOLE)
    going, found = {who: _begun(trial.start) for who, trial in trials.items()}, dict.fromkeys(trials, 0.0)
    for s in one.times(_WHOLE / ACCELERATIONS[0]):
        view, R = eye.at(motion, float(s)), motion.attitude(np.array([s]))[0]
        for who, course in list(going.items()):
            trial = trials[who]
            after = course.then(_shown(course.state, trial.start.filter.stamp + float(s), view(None), trial.tracker), R)
            if after is None:
                del going[who]
            else:
                going[who], found[who] = after, float(ACCELERATIONS[0] * s)
    return found


def _climbed(trials: dict[str, Trial], courses: dict[str, list[Course]], eye: "_Eye") -> Result:
    """The highest rate of LADDER, rad/s, that each follows for a while; `courses` lead there."""
    found, going, gentle, one = dict.fromkeys(trials, 0.0), list(trials), ACCELERATIONS[0], next(iter(trials.values()))
    for rate in LADDER:
        motion, end = SpedUp(one.axis, gentle, rate), rate / gentle
        done = len(one.times(end))
        t = one.times(end + max(_FILMED, 5.0 / one.fps))[done:]
        going = [who for who in going if done < len(courses[who])]
        if not going:
            break
        views, attitudes = [eye.at(motion, float(s)) for s in t], motion.attitude(t)
        going = [who for who in going if _follows(trials[who], courses[who][done], t, attitudes, views)]
        found.update(dict.fromkeys(going, rate))
    return found


def _follows(trial: Trial, course: Course, t: Array, attitudes: Array, pictures: "Sequence[_View]") -> bool:
    """Right to the end, and not because it is blind and the ball goes on as it did."""
    now: Course | None = course
    for s, R, view in zip(t, attitudes, pictures, strict=True):
        assert now is not None, "the loop ends where it is lost"
        now = now.then(_shown(now.state, trial.start.filter.stamp + float(s), view(None), trial.tracker), R)
        if now is None:
            return False
    return now is not None and now.state.filter.stamp - now.state.held <= max(_BLIND, 1.0 / trial.fps)


# ---- pictures or none ----


# ---- covers ----


# ---- found again ----


# ---- for a reader ----


def _degrees(rate: float) -> float:
    return float(np.degrees(rate))


def _cover_about(good: Results) -> str:
    return (
        f"An opaque cover grows over the ball, under the frame, from nothing to all within {_GROWS:g} s, while the "
        "ball turns "
        f"as in the thesis (up to 28 °/s), {_FPS:g} Hz. Shown is the share of the visible ball that was hidden when "
        "discs "
        "last held the attitude, without pictures; in the table pictures beside it, in which covers cut discs."
        + _cover_check(good)
    )


def _cover_check(good: Results) -> str:
    apart = [
        100.0 * (film[kind][who] - good[key.removesuffix("-filmed")][kind][who])
        for key, film in good.items()
        if key.startswith("cover-") and key.endswith("-filmed") and key.removesuffix("-filmed") in good
        for kind in film
        for who in TRACKERS
    ]
    if not apart:
        return ""
    off = np.abs(apart)
    return f" Pictures differ from none by {np.median(off):.1f} % of the ball (median; at most {off.max():.0f} %)."


def _cover_table(covers: Grouped, good: Results, bad: Grouped) -> Table:
    rows = []
    for (discs,), results, made in _with_broken(covers, bad):
        if not results:
            rows.append((f"{discs:g}", made, *["–"] * 7))
            continue
        film = good.get(f"cover-{discs:g}-0-filmed")
        for kind in results[0]:
            cells = [_span([100.0 * r[kind][who] for r in results], nothing="lost before") for who in TRACKERS]
            filmed_ = [f"{100.0 * film[kind][who]:.0f}" if film and kind in film else "" for who in TRACKERS]
            rows.append((f"{discs:g}", made, kind, *cells, *filmed_))
    head = ("discs", "balls", "cover comes", *(f"`{t}`" for t in TRACKERS), *(f"`{t}`, filmed" for t in TRACKERS))
    return Table(head, tuple(rows), "Share of the visible ball hidden when it is lost, % (of several balls: from – to)")


def _cover_figure(covers: dict[tuple[float, ...], list[Result]]) -> Figure:
    counts = [n for (n,) in covers]
    chosen = covers.get((float(DISCS),)) or next(iter(covers.values()))
    discs, kinds = float(DISCS) if (float(DISCS),) in covers else counts[0], list(chosen[0])

    def draw(canvas: Any) -> None:
        several = len(counts) > 1
        left, *rest = canvas.subplots(1, 2, width_ratios=(1.35, 1.0), sharey=True) if several else [canvas.subplots()]
        for k, who in enumerate(TRACKERS):
            colour, mark, _ = _LOOK[who]
            for j, kind in enumerate(kinds):
                values = [100.0 * r[kind][who] for r in chosen]
                x = j + 0.2 * (k - 1)
                left.plot([x, x], [min(values), max(values)], color=colour, linestyle="-", linewidth=3.0, alpha=0.3)
                left.plot([x], [np.median(values)], color=colour, marker=mark, linestyle="")
        left.set_xticks(range(len(kinds)), ["\n".join(kind.rsplit(" ", 1)) for kind in kinds])
        left.tick_params(axis="x", labelsize=7.5)
        left.set(ylabel="hidden when it is lost, %", ylim=(0.0, 102.0), title=f"{discs:g} discs")
        left.grid(visible=False, axis="x")
        if not rest:
            _legend(canvas, TRACKERS)
            return
        (right,), ends = rest, []
        for who in TRACKERS:
            colour, mark, dash = _LOOK[who]
            middle, worst = ([_hidden(results, who, f) for results in covers.values()] for f in (np.median, np.min))
            right.plot(counts, middle, color=colour, marker=mark, linestyle=dash)
            right.plot(counts, worst, color=colour, linestyle=dash, linewidth=0.7)
            ends.append((middle[-1], who, colour))
        right.set(xscale="log", xlabel="discs on the ball", title="median and worst cover", ylim=(0.0, 102.0))
        right.set_xticks(counts, [f"{n:g}" for n in counts])
        right.minorticks_off()
        label_lines(right, counts[-1], ends)

    caption = (
        "How much of the visible ball may be hidden before it is lost, by where the cover comes from (bars: span over "
        "balls), and by the number of discs (thin lines: the worst cover of all)."
    )
    return Figure("limits-cover", caption, draw, (7.2, 3.2))


def _hidden(results: list[Result], who: str, by: Callable[[list[float]], Any]) -> float:
    """% hidden, over covers and balls."""
    return float(by([100.0 * r[kind][who] for r in results for kind in r]))


def _again_about(good: Results) -> str:
    turned = np.degrees(_TURNING * COVERED)
    check = ""
    for key, film in good.items():
        if key.endswith("-filmed") and key.startswith("again-"):
            twin = good.get(key.removesuffix("-filmed"))
            fps = float(key.split("-")[1])
            said, bare = (
                [f"`{who}` {_wait(r[who], 'attitude', fps)} and {_wait(r[who], 'rate', fps)}" for who in WHO]
                if r
                else []
                for r in (film, twin)
            )
            check = f" In pictures, at {key.split('-')[1]} Hz, attitude and rate take: {'; '.join(said)}."
            check += (
                " Without pictures it is the same." if said == bare else f" Without: {'; '.join(bare)}." if bare else ""
            )
    return (
        f"The ball turns on at {_degrees(_TURNING):.0f} °/s while nothing of it is seen for {COVERED:g} s, by "
        f"{turned:.0f}°. "
        f"From when the cover goes, as a whole: how long until the attitude is right again (to {_ATTITUDE:g}°, and "
        "stays so "
        f"for {_STAYS:g} s), and the rate (to {_degrees(_RATE):.0f} °/s). A cover goes when it likes: half a frame is "
        "added everywhere." + _gone_before(good) + check
    )


def _gone_before(good: Results) -> str:
    """Trials without a wait, by filter: the ball was lost before the cover came."""
    trials = [r for key, r in good.items() if key.startswith("again-") and not key.endswith("-filmed")]
    gone = {who: sum("error" in r[who] for r in trials) for who in WHO}
    said = ", ".join(f"{n} of `{who}`" for who, n in gone.items() if n)
    return (
        f" Trials in which it was lost before a cover came have no wait: {said} of {len(trials)} each." if said else ""
    )


def _half(fps: float) -> float:
    """ms that pass on average until the first frame after the cover went; in a trial it is taken at once."""
    return 500.0 / fps


def _wait(result: Result, what: str, fps: float) -> str:
    if "error" in result:
        return result["error"]
    waited = result[what]
    return (
        "never"
        if waited is None
        else f"{waited['ms'] + _half(fps):.0f} ms ({waited['frames']} frame{'s' if waited['frames'] > 1 else ''})"
    )


def _waits(results: list[Result], who: str, what: str) -> list[float]:
    """ms, inf: never; those lost before are left out."""
    kept = [r[who] for r in results if "error" not in r[who]]
    return [np.inf if r[what] is None else r[what]["ms"] for r in kept]


def _again_table(again: Grouped, bad: Grouped) -> Table:
    rows = []
    for (fps,), results, made in _with_broken(again, bad):
        if not results:
            rows.append((f"{fps:g}", made, *["–"] * 3))
            continue
        for k, who in enumerate(WHO):
            cells = []
            for what in ("attitude", "rate"):
                waits = [_wait(r[who], what, fps) for r in results]
                order = sorted(waits, key=lambda w: float(w.split()[0]) if w[0].isdigit() else np.inf)
                cells.append(order[0] if len(set(order)) == 1 else f"{order[0]} to {order[-1]}")
            rows.append((*((f"{fps:g}", made) if k == 0 else ("", "")), f"`{who}`", *cells))
    head = ("Hz", "balls", "", "attitude", "rate")
    return Table(
        head, tuple(rows), f"Until it is right again after {COVERED:g} s of full cover (least and most over balls)"
    )


def _again_figure(again: dict[tuple[float, ...], list[Result]]) -> Figure:
    rates = [fps for (fps,) in again]
    never = 1e3 * _AFTER

    def draw(canvas: Any) -> None:
        for ax, what in zip(canvas.subplots(1, 2, sharey=True), ("attitude", "rate"), strict=True):
            ends = []
            for who, (colour, mark, dash) in _LOOK.items():
                known = [(f, _waits(r, who, what)) for (f,), r in again.items()]
                known = [(f, [min(w + _half(f), never) for w in v]) for f, v in known if v]
                if not known:
                    continue
                x, spans = [f * _BESIDE[who] for f, _ in known], [v for _, v in known]
                middle = [float(np.median(v)) for v in spans]
                ax.plot(x, middle, color=colour, marker=mark, linestyle=dash)
                ax.fill_between(x, [min(v) for v in spans], [max(v) for v in spans], color=colour, alpha=0.15, lw=0)
                ends.append((middle[-1], who, colour))
            ax.axhline(never, color="0.5", **BOUND)
            ax.text(rates[0], 1.06 * never, f"never (in {_AFTER:g} s)", color="0.5", fontsize=7.5, va="bottom")
            ax.set(yscale="log", ylim=(1.0, 2.2 * never), title=f"{what} right again")
            plain(ax.yaxis)
            rate_axis(ax, rates)
            label_lines(ax, rates[-1], ends)
            if what == "attitude":
                ax.set_ylabel("ms after the cover went")

    caption = (
        f"How long after {COVERED:g} s of full cover attitude and rate are right again, by frame rate: median and "
        "span over "
        "balls and axes; half a frame is added, since a cover goes when it likes."
    )
    return Figure("limits-again", caption, draw, (7.2, 3.2))


# ---- figures of this kind ----
