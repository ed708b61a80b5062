"""Plans for further photos or distances, and the gain of each."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.what_if import (
    Network,
    Sigmas,
    camera_towards,
    network,
    sigmas,
    visible_targets,
    with_distances,
    with_photos,
)
from spheremouse.geometry.camera import Pose

MIN_GAIN = 1.3  # of a plan, times better
ENOUGH = 2.5e-3  # of the radius: half of the standard deviation in Wittich 2017, table 11

_MAX_PLANS = 3
_MIN_SIGMA = 1e-4  # m, the thickness of paper: a disc lies no closer on the ball
_TAPE_SIGMA = 0.001  # m, of a steel tape held taut
_MIN_TAPE_SIGMA = 0.0003  # m, of the best reading

Kind = Literal["good", "note", "warning"]


@dataclass(frozen=True, slots=True)
class Advice:
    """One or two sentences; a plan has its gain, and the quantity that it improves."""

    kind: Kind
    text: str
    gain: float | None = None
    improves: str = ""


@dataclass(frozen=True, slots=True)
class _Plan:
    """Further photos, distances, or both."""

    text: str
    reason: str
    photos: tuple[Pose, ...] = ()
    pairs: tuple[tuple[int, int], ...] = ()
    sigma: float = 0.0  # m, of those

    @property
    def effort(self) -> int:
        return len(self.photos) + len(self.pairs)

    def on(self, net: Network) -> Network:
        net = with_distances(net, self.pairs, self.sigma) if self.pairs else net
        return with_photos(net, self.photos) if self.photos else net


def length(value: float, calibration: DeviceCalibration) -> str:
    """Return a length of `obj` in mm, or in percent of the radius if the scale is free."""
    return f"{100.0 * value:.2g} % of the radius" if calibration.scale_free else f"{_digits(1e3 * value)} mm"


def _digits(value: float) -> str:
    return f"{value:.2f}" if value < 0.995 else f"{value:.1f}" if value < 99.5 else f"{value:.0f}"


NAMES = ("the ball's place sideways (X)", "the ball's height (Y)", "the ball's depth (Z)", "the radius")
_TARGETS, _DISC = "the targets' places", "the least certain disc"


def best_plans(c: DeviceCalibration) -> list[Advice]:
    """Return the best plans, each in addition to those before it."""
    net = network(c)
    known = len(c.discs)
    now = sigmas(net, known)
    plans, enough = [*_photo_plans(net), *_distance_plans(net)], ENOUGH * c.radius
    found: list[Advice] = []
    while len(found) < _MAX_PLANS and max(now.ball.max(), now.targets) * c.unit > _MIN_SIGMA:
        options = []
        for plan in plans:
            then = plan.on(net)
            after = sigmas(then, known)
            options.append(_Option(plan, then, after, *_gain(now, after, enough)))
        options = [o for o in options if o.gain >= MIN_GAIN]
        if not options:
            break
        if any(o.what != _DISC for o in options):
            options = [o for o in options if o.what != _DISC]
        least = 0.8 * np.log(max(o.gain for o in options))  # prefer less work for nearly the same gain
        best = min((o for o in options if np.log(o.gain) > least), key=lambda o: (o.plan.effort, -o.gain))
        found.append(_advice(best, now, c, first=not found))
        plans = [p for p in plans if p is not best.plan]
        net, now = best.then, best.after
    return found


@dataclass(frozen=True, slots=True)
class _Option:
    """A plan with its result."""

    plan: _Plan
    then: Network
    after: Sigmas
    what: str
    gain: float


def _advice(option: _Option, now: Sigmas, c: DeviceCalibration, *, first: bool) -> Advice:
    plan, what = option.plan, option.what
    before, later = _value(now, what), _value(option.after, what)
    times = f"{option.gain:.1f}" if option.gain < 9.5 else f"{option.gain:.0f}"
    better = f"{what} {times} times better, from {length(before, c)} to {length(later, c)}"
    text = f"{plan.reason}: {plan.text} would make {better}." if first else f"Then {plan.text}: {better}."
    return Advice("warning" if before > ENOUGH * c.radius else "note", text, option.gain, what)


def _value(s: Sigmas, what: str) -> float:
    return {**dict(zip(NAMES, s.ball, strict=True)), _TARGETS: s.targets, _DISC: s.disc}[what]


def _gain(now: Sigmas, after: Sigmas, enough: float) -> tuple[str, float]:
    """The quantity with the largest gain among the worst ones, and the gain; the radius first."""
    values = {name: _value(now, name) for name in (*NAMES[::-1], _TARGETS)}
    large = max(values.values())
    gains = [(name, v / _value(after, name)) for name, v in values.items() if v >= 0.5 * large and v > 0.0]
    most = max(gain for _, gain in gains)
    if most < MIN_GAIN and now.disc > enough:  # the tracker refines discs in play: only bad ones are worth a photo
        return _DISC, now.disc / after.disc
    return next(g for g in gains if g[1] > 0.9 * most)


def _photo_plans(net: Network) -> Iterator[_Plan]:
    """Plans for photos from the sides, from the same places, and from nearer."""
    way = np.array([pose.position - net.aim for pose in net.block.poses])
    distance = float(np.median(np.linalg.norm(way, axis=1)))
    azimuth = np.degrees(np.arctan2(way[:, 0], way[:, 2]))
    height = np.degrees(np.arcsin(way[:, 1] / np.linalg.norm(way, axis=1)))
    usual = float(np.median(azimuth)), float(np.median(height))
    for one, other in _SIDES:
        reached = [
            (side, float(np.max(side.right * azimuth + side.up * height)), *_aside(net, side, usual[1], distance))
            for side in (one, other)
        ]
        seen = [(side, reach < 0.5 * angle, angle, stations) for side, reach, angle, stations in reached if stations]
        for side, none, angle, stations in seen:
            text = f"two more photos from {side.words} ({angle}° and {round(_INNER * angle)}° off the front)"
            yield _Plan(text, f"{'No photo is' if none else 'Few photos are'} from {side.words}", stations)
        if len(seen) == 2:
            text = f"two more photos from {one.words} and two from {other.words} (as far as three targets are seen)"
            front = all(none for _, none, _, _ in seen)
            reason = "All photos are from the front" if front else f"Few photos are from {one.words} and {other.words}"
            yield _Plan(text, reason, seen[0][3] + seen[1][3])
    if again := _stations(net, [(usual[0], usual[1] + 5.0), (usual[0], usual[1] - 5.0)], distance):
        yield _Plan("two more photos like those there are", "Each photo adds a little", again)
    for part in (0.5, 0.6, 0.7, 0.8):
        if near := _stations(net, [(usual[0] - 15.0, usual[1]), (usual[0] + 15.0, usual[1])], part * distance):
            how = f"{100.0 * part:.0f} % of the distance" if net.problem.scale_free else f"{part * distance:.1f} m"
            yield _Plan(f"two more photos from nearer, {how}", "The photos are from afar", near)
            break


@dataclass(frozen=True, slots=True)
class _Side:
    words: str
    right: float  # direction of the angle
    up: float
    max_angle: int  # degrees; no ring is seen beyond 75, and ceiling or floor limit others


_SIDES = (
    (_Side("the far left", -1.0, 0.0, 75), _Side("the far right", 1.0, 0.0, 75)),
    (_Side("high above", 0.0, 1.0, 60), _Side("far below", 0.0, -1.0, 45)),
)
_INNER = 0.7  # the second photo's angle over the first's


def _aside(net: Network, side: _Side, height: float, distance: float) -> tuple[int, tuple[Pose, ...]]:
    """The largest angle to a side with three targets in view, degrees, and two stations; none without one."""
    for angle in range(side.max_angle, 14, -5):
        at = [(side.right * part * angle, side.up * part * angle if side.up else height) for part in (1.0, _INNER)]
        if stations := _stations(net, at, distance):
            return angle, stations
    return 0, ()


def _stations(net: Network, angles: Sequence[tuple[float, float]], distance: float) -> tuple[Pose, ...]:
    """Cameras at angles, degrees, to the right of the front and above it; none if one sees too few targets."""
    stations = []
    for azimuth, height in angles:
        a, h = np.radians([azimuth, height])
        stations.append(
            camera_towards(net, np.array([np.sin(a) * np.cos(h), np.sin(h), np.cos(a) * np.cos(h)]), distance)
        )
    return tuple(stations) if all(np.count_nonzero(visible_targets(net, s)) >= 3 for s in stations) else ()


def _distance_plans(net: Network) -> Iterator[_Plan]:
    """Plans for further distances, a better tape, and both."""
    given = net.problem.device.distances
    if not given:
        return
    sigma = float(np.median([d.sigma for d in given]))
    have = {frozenset((d.start, d.end)) for d in given}
    old = tuple(dict.fromkeys((min(d.start, d.end), max(d.start, d.end)) for d in given))
    new = tuple(p for p in combinations(sorted(net.problem.device.ids), 2) if frozenset(p) not in have)
    better = _TAPE_SIGMA if sigma > 1.3 * _TAPE_SIGMA else 0.5 * sigma
    each = " each" if len(given) > 1 else ""
    reason = f"The scale rests on {_count(len(given), 'distance')}, ± {1e3 * sigma:g} mm{each}"
    if new:
        yield _Plan(f"measuring {_pairs(new)}, too", reason, pairs=new, sigma=sigma)
    if better >= _MIN_TAPE_SIGMA:
        with_ = "with a steel tape held taut" if better == _TAPE_SIGMA else "with a better tape or a laser"
        yield _Plan(f"measuring {_pairs(old)} again {with_}, to {1e3 * better:g} mm,", reason, pairs=old, sigma=better)
        if new:
            text = f"measuring all distances {with_}, to {1e3 * better:g} mm, {_pairs(new)} among them"
            yield _Plan(text, reason, pairs=old + new, sigma=better)


def _pairs(pairs: Sequence[tuple[int, int]]) -> str:
    if len(pairs) > 4:
        return f"{len(pairs)} pairs of targets"
    named = [f"{a}-{b}" for a, b in pairs]
    return ("distance " if len(pairs) == 1 else "distances ") + (
        named[0] if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]}"
    )


def _count(n: int, word: str) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"
