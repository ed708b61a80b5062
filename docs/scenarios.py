"""Run simulated scenarios, most with one disturbance, and print a Markdown table.

    python docs/scenarios.py [NAME ...] [--long] [--pose own] [--set KEY=VALUE] [--json FILE] [--write]

Frames go from the renderer straight to `track.step`. docs/scenarios.md explains the columns; `--write` replaces its
table.
"""

import argparse
import json
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.build import begin, build
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker
from spheremouse.ball.track import step
from spheremouse.ball.truth import VISIBLE
from spheremouse.errors import SpheremouseError
from spheremouse.files import config
from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.rotation import Array, log
from spheremouse.output.counts import Counter, MotionSettings
from spheremouse.session import messages
from spheremouse.session.offline import initialise
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.ball.render import SimulatedFrame
from spheremouse.tracker import Estimate, Frame, Status

Mask = NDArray[np.bool_]

PAGE = Path(__file__).with_name("scenarios.md")
MARKS = ("<!-- made by docs/scenarios.py --write -->", "<!-- end -->")

WRONG = np.radians(3.0)  # rad, an attitude farther off is not the ball's
IN_VIEW = 4  # wholly visible discs of at least AREA px²: enough to say which they are
AREA = 15.0
SETTLED = 0.5  # s after the ball has stopped, rest begins


@dataclass(frozen=True)
class Scenario:
    """One film or several of them, one after the other, as one session."""

    about: str
    films: tuple[SimulationOptions, ...]
    long: bool = False  # minutes to compute
    overrides: tuple[str, ...] = ()  # settings it takes


def film(**options: Any) -> tuple[SimulationOptions, ...]:
    """One film with a little noise."""
    return (SimulationOptions(**{"noise": 3.0, **options}),)


def rolling(**options: Any) -> tuple[SimulationOptions, ...]:
    """Four turns at 120 deg/s."""
    return film(**{"motion": "roll", "turns": 4.0, **options})


DARK, WHITE, RED, BLUE, YELLOW = (35, 30, 30), (235, 235, 235), (40, 40, 200), (200, 60, 30), (20, 200, 220)
LIGHT = ("discs.polarity=light",)
SMALL = (0.3, 0.3, -0.3, 0.03, -0.03, 0.03)  # mm and deg
LARGE = (12.0, -12.0, 10.0, 1.2, -1.2, 1.0)

SCENARIOS: dict[str, Scenario] = {
    "play": Scenario("ordinary play", film(motion="play")),
    "play near": Scenario("play, near camera", film(motion="play", view="near")),
    "near blur": Scenario("near, 60 Hz, 10 ms exposure", film(motion="play", view="near", fps=60.0, blur=0.01)),
    "still": Scenario("no motion, noise 5", film(motion="still", seconds=60.0, noise=5.0)),
    "rest": Scenario("turned, then a minute of rest, noise 5", film(motion="rest", noise=5.0)),
    "creep": Scenario("turned, then 0.05 °/s for a minute, noise 5", film(motion="creep", noise=5.0)),
    "flick": Scenario("400 °/s, stop in 50 ms, reversal; 30 Hz", film(motion="flick")),
    "flick 60": Scenario("flick at 60 Hz, 5 ms exposure", film(motion="flick", fps=60.0, blur=0.005)),
    "flick rolling": Scenario("flick, 30 ms readout, known", film(motion="flick", readout=0.03)),
    "hands": Scenario("rolling, a third covered for 1 s", rolling(cover=5.0)),
    "hands at rest": Scenario("at rest, a third covered for 1 s", film(motion="rest", seconds=14.0, cover=10.0)),
    "hands on a flick": Scenario("flick, a third covered", film(motion="flick", cover=8.5)),
    "dim": Scenario("rolling, a fifth of the light for 2 s", rolling(dim=0.2, dim_at=5.0, dim_seconds=2.0)),
    "dim start": Scenario("play, a fifth of the light", film(motion="play", dim=0.2, dim_at=0.0, dim_seconds=99.0)),
    "flicker": Scenario("30 % mains flicker, 5 ms exposure", film(motion="play", flicker=0.3, blur=0.005)),
    "flicker bands": Scenario(
        "30 % flicker, 30 ms readout (bands)", film(motion="play", flicker=0.3, blur=0.005, readout=0.03)
    ),
    "limited": Scenario("grey values 16 to 235", film(motion="play", limited=True)),
    "bump small": Scenario("camera pushed 0.5 mm, 0.05°", rolling(bump=5.0, bump_by=SMALL)),
    "bump": Scenario("camera pushed 3 mm, 0.24°", rolling(bump=5.0)),
    "bump large": Scenario("camera pushed 20 mm, 2°", rolling(bump=5.0, bump_by=LARGE)),
    "bump at rest": Scenario("at rest, camera pushed 3 mm, 0.24°", film(motion="rest", seconds=20.0, bump=12.0)),
    "lift": Scenario("rolling, lifted 3 cm for 1 s", rolling(lift=5.0)),
    "lift at rest": Scenario("at rest, lifted 3 cm for 1 s", film(motion="rest", seconds=16.0, lift=10.0)),
    "sway": Scenario("worn bearings, ±5 mm at 2 Hz", film(motion="play", seconds=10.0, sway=5.0)),
    "sunk": Scenario(
        "sinks by 1 cm in 0.2 s", film(motion="play", lift=5.0, lift_by=(0.0, -10.0, 0.0), lift_seconds=99.0)
    ),
    "eccentric": Scenario("centre 5 mm off the pivot", rolling(eccentric=5.0)),
    "disc off": Scenario("a disc falls off", rolling(disc_off=5.0)),
    "disc moved": Scenario("a disc moves by 12 cm", rolling(disc_moved=5.0)),
    "swap": Scenario("another ball after 12 s", (*rolling(), *rolling(layout=77))),
    "dark ball": Scenario(
        "white discs on a dark ball", film(motion="play", ball_colour=DARK, disc_colour=WHITE), overrides=LIGHT
    ),
    "red discs": Scenario("red discs on white", film(motion="play", disc_colour=RED)),
    "blue discs": Scenario("blue discs on white", film(motion="play", disc_colour=BLUE)),
    "yellow on dark": Scenario(
        "yellow discs on dark", film(motion="play", ball_colour=DARK, disc_colour=YELLOW), overrides=LIGHT
    ),
    "15 Hz": Scenario("play at 15 Hz", film(motion="play", fps=15.0)),
    "120 Hz": Scenario("play at 120 Hz", film(motion="play", fps=120.0, seconds=10.0)),
    "240 Hz": Scenario("play at 240 Hz", film(motion="play", fps=240.0, seconds=10.0)),
    "720p": Scenario("1280x720", film(motion="play", size=(1280, 720), seconds=10.0)),
    "1080p": Scenario("1920x1080", film(motion="play", size=(1920, 1080), seconds=10.0)),
    "rest long": Scenario("ten minutes of rest, noise 5", film(motion="rest", noise=5.0, seconds=608.0), long=True),
    "play long": Scenario("ten minutes of play", film(motion="play", seconds=600.0), long=True),
}  # fmt: skip


# ---- a run ----


@dataclass(frozen=True)
class Truth:
    """True state at one frame."""

    stamp: float  # s
    attitude: Array  # (3, 3) R_obj_ball
    rate: Array  # (3,) rad/s
    centre: Array  # (3,) m
    in_view: int  # wholly visible discs of at least AREA px²
    film: int


@dataclass(frozen=True)
class Said:
    """Output of the tracker at one frame."""

    event: str
    estimate: Estimate
    seconds: float  # s, of wall time


def frames_of(scenario: Scenario, truths: list[Truth]) -> Iterator[Frame]:
    """The frames, stamps going on from film to film after a second; their truth is appended as they are given."""
    start = 0.0
    for index, options in enumerate(scenario.films):
        simulation = prepare(options)
        for made in simulate(simulation):
            stamp = start + made.frame.stamp
            truths.append(truth_of(made, stamp, index))
            yield Frame(made.frame.image, stamp, len(truths) - 1)
        start += simulation.seconds + 1.0


def truth_of(made: SimulatedFrame, stamp: float, index: int) -> Truth:
    """Without the picture."""
    discs = made.discs
    in_view = int(np.sum((discs.state == VISIBLE) & (discs.area >= AREA)))
    return Truth(stamp, made.attitude, made.rate, made.centre, in_view, index)


def run(scenario: Scenario, settings: Settings, pose: str) -> tuple[Tracker, list[Truth], list[Said]]:
    """Track a scenario; the truths are those of the tracked frames."""
    for assignment in scenario.overrides:
        settings = config.override(settings, assignment)
    scene = prepare(scenario.films[0]).scene
    rig = scene.rig()
    truths: list[Truth] = []
    frames = frames_of(scenario, truths)
    start = initialise(frames, replace(rig, pose=scene.pose) if pose == "known" else rig, settings)
    tracker = build(rig, start.pose, settings)
    state, kept, said = None, [], []
    for frame in start.frames:
        state = state or begin(tracker, frame.stamp)
        began = time.perf_counter()
        state, estimate, events = step(state, frame, tracker)
        took = time.perf_counter() - began
        kept.append(frame.sequence)
        said.append(Said(messages.line(events, tracker.detector.words), estimate, took))
    return tracker, [truths[k] for k in kept], said


# ---- what is made of it ----


def measure(tracker: Tracker, truths: list[Truth], said: list[Said]) -> dict[str, Any]:
    """The figures of one run; None where there is nothing to measure."""
    tracking = np.array([s.estimate.status is Status.TRACKING for s in said])
    off = attitude_errors(truths, said, tracking)
    good = tracking & (off < WRONG)
    rate = np.linalg.norm([s.estimate.rate[:3] - t.rate for s, t in zip(said, truths, strict=True)], axis=1)
    true = np.array([np.zeros(3), *(true_counts(tracker, a, b) for a, b in pairwise(truths))])
    counter = Counter(matrix(tracker))
    sent = np.array([counter.counts(s.estimate)[0] for s in said], dtype=float)
    resting = at_rest(truths)
    blind, to_the_end = longest_blind(truths, good)
    kept = np.flatnonzero(tracking & np.isfinite(off))
    lost = sum(a and not b for a, b in pairwise(tracking))
    return {
        "frames": len(said),
        "tracked": int(tracking.sum()),
        "lost_episodes": int(lost),
        "attitude_rms_deg": rounded(float(np.degrees(np.sqrt(np.mean(off[kept] ** 2))))) if len(kept) else None,
        "attitude_end_deg": rounded(np.degrees(float(off[kept[-1]])))
        if len(kept) and kept[-1] == len(said) - 1
        else None,
        "rate_rms_deg_s": rounded(np.degrees(np.sqrt(np.mean(rate[kept] ** 2)))) if len(kept) else None,
        "rest_frames": int(resting.sum()),
        "rest_counts": int(np.abs(sent[resting]).sum()),
        "jump_counts": rounded(largest_jump(true, sent)),
        "missing_counts": rounded(float(np.linalg.norm((true - sent).sum(axis=0)))),
        "blind_frames": blind,
        "blind_to_the_end": to_the_end,
        "step_ms": rounded(1e3 * float(np.median([s.seconds for s in said]))),
        "events": [f"{t.stamp:.2f} s: {s.event}" for s, t in zip(said, truths, strict=True) if s.event],
    }


def attitude_errors(truths: list[Truth], said: list[Said], tracking: Mask) -> Array:
    """Angle, (n,) rad, of R_est R_true^T, each film relative to its first tracked frame; nan before that.

    The first second of a second film is left out, because the tracker still holds the ball of the first.
    """
    off = np.full(len(said), np.nan)
    for film in sorted({t.film for t in truths}):
        mine = np.array([t.film == film for t in truths])
        first = truths[int(np.argmax(mine))].stamp
        late = np.array([t.stamp >= first + (1.0 if film else 0.0) for t in truths])
        known = np.flatnonzero(mine & late & tracking)
        if len(known):
            k = known[0]
            M = truths[k].attitude.T @ said[k].estimate.rotation
            for i in np.flatnonzero(mine & late)[np.flatnonzero(mine & late) >= k]:
                off[i] = np.linalg.norm(log(said[i].estimate.rotation @ (truths[i].attitude @ M).T))
    return off


def true_counts(tracker: Tracker, before: Truth, after: Truth) -> Array:
    """Counts, (3,), that the ball's motion from frame to frame is worth; another ball's place is no motion."""
    if before.film != after.film:
        return np.zeros(3)
    return matrix(tracker) @ log(after.attitude @ before.attitude.T)


def matrix(tracker: Tracker) -> Array:
    """Counts per radian, (3, 3)."""
    return MotionSettings().matrix(tracker.rig.radius_m)


def at_rest(truths: list[Truth]) -> Mask:
    """Frames, (n,) bool, before which the ball has not turned for SETTLED s."""
    stamps = np.array([t.stamp for t in truths])
    turned = [True, *(bool(np.any(a.attitude != b.attitude)) for a, b in pairwise(truths))]
    moved = np.array(turned) | np.array([bool(np.any(t.rate)) for t in truths])
    last = np.maximum.accumulate(np.where(moved, stamps, -np.inf))
    return stamps > last + SETTLED


def largest_jump(true: Array, sent: Array) -> float:
    """Return the largest distance, in counts, of the counts of a frame from what the tracker could rightly send.

    That lies between the ball's motion in this frame and this motion with all that is still unsent. Frames without
    counts are left out, because the tracker withheld their motion.
    """
    largest, unsent = 0.0, np.zeros(3)
    for earned, counts in zip(true, sent, strict=True):
        over = counts - earned
        share = np.clip(over @ unsent / max(unsent @ unsent, 1e-9), 0.0, 1.0)
        if np.any(counts):
            largest = max(largest, float(np.linalg.norm(over - share * unsent)))
        unsent = unsent - over
    return largest


def longest_blind(truths: list[Truth], good: Mask) -> tuple[int, bool]:
    """Return the longest run of frames without a right attitude after the first with one, and True if it ends the film.

    The run counts the frames with at least IN_VIEW discs in view. Frames with fewer neither count nor end it.
    """
    worst = now = 0
    first = int(np.argmax(good)) if np.any(good) else 0
    for truth, right in zip(truths[first:], good[first:], strict=True):
        now = 0 if right else now + (truth.in_view >= IN_VIEW)
        worst = max(worst, now)
    return worst, now > 0 and now == worst


def rounded(x: float | np.floating) -> float | None:
    """To four digits; None for what is no number."""
    return float(f"{x:.4g}") if np.isfinite(x) else None


# ---- the table ----

HEAD = ("scenario", "what happens", "tracked", "attitude, ° RMS", "largest jump", "counts missing")


def row(name: str, about: str, r: dict[str, Any]) -> list[str]:
    """Return a line of the table."""
    if "error" in r:
        return [f"`{name}`", about, f"{r['error']}", *[""] * (len(HEAD) - 3)]

    def shown(key: str, form: str) -> str:
        return "-" if r[key] is None else format(r[key], form)

    return [
        f"`{name}`",
        about,
        f"{r['tracked']}/{r['frames']}",
        shown("attitude_rms_deg", ".3f"),
        shown("jump_counts", ".1f"),
        shown("missing_counts", ".1f"),
    ]


def table(results: dict[str, dict[str, Any]]) -> str:
    """Return the figures in Markdown."""
    rows = [row(name, SCENARIOS[name].about, r) for name, r in results.items()]
    out = ["| " + " | ".join(line) + " |" for line in (HEAD, ["---"] * len(HEAD), *rows)]
    return "\n".join(out) + "\n"


def main() -> None:
    """Run the scenarios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SCENARIOS)}; default: all short ones")
    parser.add_argument("--long", action="store_true", help="those that take minutes, too")
    parser.add_argument("--pose", choices=("known", "own"), default="known", help="the true camera pose, or its own")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="one parameter of the tracker")
    parser.add_argument("--json", metavar="FILE", help="write all figures; - prints them in place of the table")
    parser.add_argument("--write", action="store_true", help=f"replace the table of {PAGE.name}")
    args = parser.parse_args()
    for name in args.names:
        if name not in SCENARIOS:
            parser.error(f"no scenario {name!r}; there are {', '.join(SCENARIOS)}")
    if args.write and args.names:
        parser.error("--write replaces the whole table: name no scenario")
    if args.write and (args.set or args.pose != "known"):
        parser.error("--write: the table holds for default settings and the true pose; omit --set and --pose own")
    settings = Settings()
    try:
        for assignment in args.set:
            settings = config.override(settings, assignment)
    except SpheremouseError as e:
        parser.error(str(e))
    names = args.names or [n for n, s in SCENARIOS.items() if args.long or not s.long]
    results: dict[str, dict[str, Any]] = {}
    for name in names:
        print(f"{name} ...", end=" ", file=sys.stderr, flush=True)
        began = time.perf_counter()
        try:
            results[name] = measure(*run(SCENARIOS[name], settings, args.pose))
        except SpheremouseError as e:
            results[name] = {"error": str(e)}
        except Exception as e:  # a crash is a result, too; the others are still worth having
            traceback.print_exc()
            results[name] = {"error": f"crashed: {type(e).__name__}: {e}"}
        print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr)
    text = table(results)
    if args.json == "-":
        print(json.dumps(results, indent=1))
    else:
        print(text)
    if args.json not in (None, "-"):
        write_atomically(Path(args.json), json.dumps(results, indent=1) + "\n")
    if args.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
        after = rest.partition(MARKS[1])[2]
        write_atomically(PAGE, f"{before}{MARKS[0]}\n\n{text}\n{MARKS[1]}{after}")


if __name__ == "__main__":
    main()
