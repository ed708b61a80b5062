"""Advice on a calibrated device, for the person who took the photos: faults, and the most useful further work.

Residuals and redundancy show the faults. The sides without photos and the tape distances show the further work.
"""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.bundle import checked_residuals, distance_residuals
from spheremouse.geometry.rotation import Array, fibonacci_sphere
from spheremouse.geometry.statistics import FALSE_ALARM, gate, ratio_gate

_MAX_RING_ERROR = 0.03  # relative, of the size of rings by print, blur and colour fringe
_MAX_VARIANCE_FACTOR = 4.0  # twice the usual standard deviation
_MIN_RMS_RATIO = 2.0  # of an outlying photo over the others
_MIN_CHECKED_DISCS = 8  # in three photos or more: four determine a sphere, as many check it
_GROUPS = ("target", "disc")
_MAX_RELATIVE_SIGMA = 2.5e-3  # of the radius: half of the standard deviation in Wittich 2017, table 11
_MIN_SIGMA = 1e-4  # m, the thickness of paper: a disc lies no closer on the ball
_LARGE_VARIANCE_SHARE = 0.5  # of the radius's variance: without it the standard deviation falls by 30 %
# Least angles of a photo from a side, degrees: half of what a frame's targets allow; below, the floor is near.
_MIN_ANGLES = {"from the left": 20.0, "from the right": 20.0, "from above": 20.0, "from below": 5.0}
_COORDINATES = ("the ball's place sideways (X)", "the ball's height (Y)", "the ball's depth (Z)", "the radius")


class Advice(NamedTuple):
    """One or two sentences."""

    kind: Literal["good", "note", "warning"]
    text: str


def advise(calibration: DeviceCalibration, names: Sequence[str]) -> list[Advice]:
    """Return a verdict, faults and further work; `names` of all photos given."""
    found = list(_findings(calibration, names))
    verdict = _verdict(calibration, any(a.kind == "warning" for a in found))
    return [verdict, *found, *_further_work(calibration, poor=verdict.kind == "warning")]


def missing_sides(positions: Array, middle: Array) -> list[str]:
    """Return the sides without a photo; `positions` of cameras, (k, 3), and `middle` of the targets, (3,), in obj."""
    x, y, z = (positions - middle).T
    azimuth, height = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
    reached = (-azimuth.min(), azimuth.max(), height.max(), -height.min())
    sides = zip(_MIN_ANGLES.items(), np.degrees(reached), strict=True)
    return [side for (side, least), angle in sides if angle < least]


def coverage(directions: Array) -> float:
    """Return the share of the ball that discs at unit vectors (m, 3) cover, each up to its neighbours' distance."""
    if len(directions) < 2:
        return 0.0
    cosine = directions @ directions.T - 3.0 * np.eye(len(directions))
    reach = np.median(np.arccos(np.clip(cosine.max(axis=1), -1.0, 1.0)))
    return float(np.mean((fibonacci_sphere(2000) @ directions.T).max(axis=1) > np.cos(min(reach, np.pi))))


def photo_scatter(calibration: DeviceCalibration) -> tuple[Array, Array]:
    """Return the variance factor, (k,), and redundancy, (k,), of each photo used."""
    image = calibration.problem.image
    residual, cofactor = checked_residuals(calibration.solution, slice(2 * len(image)), 2)
    k = len(calibration.poses)
    freedom = np.bincount(image.photo, np.trace(cofactor, axis1=1, axis2=2), minlength=k)
    squares = np.bincount(image.photo, np.sum(residual**2, axis=1), minlength=k)
    return np.asarray(squares / np.maximum(freedom, 1e-9), float), np.asarray(freedom, float)


# ---- how good it is ----


def _verdict(calibration: DeviceCalibration, odd: bool) -> Advice:
    """Return whether the ball is known well enough to play. `odd`: other advice reports a surprise."""
    sigma = np.sqrt(np.diag(calibration.ball_covariance))
    worst = int(np.flatnonzero(sigma > 0.9 * sigma.max())[-1])  # of nearly equal ones the last: the radius
    part = sigma[worst] / calibration.radius
    known = f"{_COORDINATES[worst]} is the least certain, ± {_length(sigma[worst], calibration)}"
    if not calibration.scale_free:
        known += f", {100.0 * part:.2g} % of the radius"
    if part > _MAX_RELATIVE_SIGMA:
        return Advice("warning", f"Not good yet: {known}; tracking wants {100.0 * _MAX_RELATIVE_SIGMA:g} %.")
    return Advice("note" if odd else "good", f"Good enough to play{', but see below' if odd else ''}: {known}.")


def _length(value: float, calibration: DeviceCalibration) -> str:
    """A length of `obj` in mm, or in percent of the radius if the scale is free."""
    if calibration.scale_free:
        return f"{100.0 * value:.2g} % of the radius"
    return f"{1e3 * value:.{2 if value < 0.995e-3 else 1 if value < 99.5e-3 else 0}f} mm"


# ---- further work ----


def _further_work(c: DeviceCalibration, poor: bool) -> Iterator[Advice]:
    """Yield the photos and lengths that would help most; as warnings if the result is `poor`."""
    kind = "warning" if poor else "note"
    sides = missing_sides(np.array([pose.position for pose in c.poses]), c.targets.mean(axis=0))
    if sides:
        text = (
            f"No photo is {' or '.join(sides)}: take two from each such side, as far round as the camera "
            "sees three targets. Photos from all sides help most."
        )
        yield Advice(kind, text)
    sigma = float(np.sqrt(c.ball_covariance[3, 3]))
    # standard deviation of the radius by that of the distances
    tape = 0.0 if c.scale_free else c.radius / np.sqrt(sum((d.metres / d.sigma) ** 2 for d in c.device.distances))
    tape_limits = sigma > _MIN_SIGMA and tape**2 > _LARGE_VARIANCE_SHARE * sigma**2
    if tape_limits:
        n = len(c.device.distances)
        text = (
            f"The scale rests on {n} tape distance{'' if n == 1 else 's'}, which leave{'s' if n == 1 else ''} the "
            f"radius uncertain by {_length(tape, c)}. Measure further ones, the longest first, or measure again with a "
            "steel tape held taut."
        )
        yield Advice(kind, text)
    if poor and not (sides or tape_limits):
        yield Advice(kind, "Take further photos: from places between the present ones, and from nearer.")


# ---- faults ----


def _findings(c: DeviceCalibration, names: Sequence[str]) -> Iterator[Advice]:
    """Yield the faults that the calibration found in photos, scale, scatter and the ball's shape."""
    for k, reason in c.skipped:
        yield Advice("warning", f"{names[k]} was left out: {reason}.")
    for k, reason in c.doubtful:
        yield Advice("warning", f"{names[k]}: only its targets were used, not its discs: {reason}.")
    yield from _scale_findings(c)
    yield from _scatter_findings(c, names)
    if c.out_of_round > 0.0:
        text = (
            f"The ball is out of round, or its discs do not lie flat: they are {_length(c.out_of_round, c)} off a "
            "sphere (standard deviation), more than the measurements explain. The radius is that of the best sphere. "
            "Its uncertainty includes this."
        )
        yield Advice("warning" if c.out_of_round > _MAX_RELATIVE_SIGMA * c.radius else "note", text)
    often = int(np.count_nonzero(c.sightings >= 3))
    if often < min(_MIN_CHECKED_DISCS, len(c.discs)):
        text = (
            f"Only {often} of {len(c.discs)} discs are seen in three photos or more: in two photos "
            "nothing checks a match. Take further photos from places nearer to each other."
        )
        yield Advice("note", text)
    covered = coverage(c.directions)
    text = f"{len(c.discs)} discs are known on {100.0 * covered:.0f} % of the ball."
    yield Advice("note", text + (" The others are learned in play." if covered < 0.9 else ""))


def _scale_findings(c: DeviceCalibration) -> Iterator[Advice]:
    if c.scale_free:
        text = (
            "Without a tape distance the scale is free: everything works, lengths are in radii of the ball and counts "
            "per radian. One distance between two targets in device.yaml gives millimetres."
        )
        yield Advice("note", text)
        return
    error = c.ring_scale - 1.0
    if abs(error) > _MAX_RING_ERROR:
        text = (
            f"The rings look {100.0 * abs(error):.0f} % {'larger' if error > 0 else 'smaller'} in the photos than "
            "in device.yaml: `target_radii` or the distances are wrong (mm for cm? diameter for radius? the "
            "printer's scale?). The result rests on the distances."
        )
        yield Advice("warning", text)
    residual, number = distance_residuals(c.problem, c.solution)
    if len(number) == 1:
        d = c.device.distances[0]
        text = (
            f"The scale rests on one tape distance, {d.start} to {d.end}, which nothing checks: an error of 1 % there "
            "is 1 % everywhere. Measure a second one."
        )
        yield Advice("note", text)
        return
    freedom = float(np.sum(number))
    if freedom > 0.5:
        ratio = float(np.sum(residual**2)) / freedom
        if ratio > gate(1.0 - FALSE_ALARM, freedom) / freedom:
            text = (
                f"The distances contradict each other {np.sqrt(ratio):.1f} times as much as their sigma allows: "
                "measure them again, or give larger sigmas in device.yaml. Until then the radius is worse than stated."
            )
            yield Advice("warning", text)


def _scatter_findings(c: DeviceCalibration, names: Sequence[str]) -> Iterator[Advice]:
    for group, factor in zip(_GROUPS, c.variance_factors, strict=True):
        if factor > _MAX_VARIANCE_FACTOR:
            text = (
                f"The {group}s fit the photos {np.sqrt(factor):.1f} times worse than {group}s usually do: blurred "
                f"photos, {'targets that are not flat or face aside' if group == 'target' else 'hand-cut discs'}, or "
                "a camera file of another mode. The uncertainties have this in them."
            )
            yield Advice("warning", text)
    yield from _photo_findings(c, names)
    count = np.bincount(c.measured.photo, minlength=len(c.poses))
    false = np.bincount(c.measured.photo, ~c.measured.used, minlength=len(c.poses))
    for i in np.flatnonzero((false >= 3) & (false > 0.25 * count)):
        text = (
            f"{names[c.photos[i]]}: {int(false[i])} of {count[i]} image points do not fit the other photos and were "
            "not used: did the ball turn before it was taken?"
        )
        yield Advice("warning", text)


def _photo_findings(c: DeviceCalibration, names: Sequence[str]) -> Iterator[Advice]:
    """Photos with larger normalised residuals than the others (F test)."""
    ratio, freedom = photo_scatter(c)
    for i, f in enumerate(freedom):
        rest = np.delete(freedom, i)
        if f <= 1.0 or rest.sum() <= 1.0:
            continue
        others = float(np.sum(rest * np.delete(ratio, i)) / rest.sum())
        if ratio[i] > max(ratio_gate(1.0 - FALSE_ALARM, f, rest.sum()), _MIN_RMS_RATIO**2) * others:
            text = (
                f"{names[c.photos[i]]} fits {np.sqrt(ratio[i] / max(others, 1e-12)):.1f} times worse than the others: "
                "blurred, or something moved. Take it again, or leave it out."
            )
            yield Advice("warning", text)
