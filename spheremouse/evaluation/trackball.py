"""Estimate scale, axes and lag of a trackball under the ball from the ball's rotation and the log of the trackball.

Counts between two times are A times the rotation of the ball between them. A (2, 3) in counts/rad holds scale and axes
at once. Wittich 2017, section 4.1.1 and eq. 175, estimates lag, one scale and one offset for each axis. An offset has
no meaning here, since a ball at rest sends no counts.

The cross-correlation of counts and rotation gives the lag to 20 ms. One regression with Cauchy's weights then estimates
A and the lag, so that lost reports and slip have little weight. Its rows are intervals of 0.1 s.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, get_args

import numpy as np
from scipy.signal import correlate

from spheremouse.evaluation.metrics import pearson
from spheremouse.evaluation.run import Run
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma
from spheremouse.output.counts import MotionSettings, Player

MIN_COMMON_S = 8.0  # shorter logs follow another motion at some lag by chance
_INTERVAL_S = 0.1  # rows of the regression; shorter ones have too much noise beside the rotation
_LAG_STEP_S = 0.02  # of the search; the regression converges from several of them
_MAX_STEP_S = 0.5  # between two frames
_MAX_REPORT_GAP_S = 0.05  # between two reports of a mouse that moves
_LAG_DERIVATIVE_S = 0.03  # several reports of a coarse trackball
_REWEIGHTINGS = 15
_CAUCHY_SIGMAS = 2.385  # standard deviations: 95 % efficiency for normal errors (Holland and Welsch 1977)
_MIN_SIGMA = 0.2  # counts of a residual: whole counts
_OUTLIER_SIGMA, _OUTLIER_COUNTS = 5.0, 3.0
_BLOCK_ROWS = 5  # half a second: an error at the end of an interval cancels in the next one
_STAMP_SIGMA_S = 1e-4  # of stamps of mice and cameras at best
_MIN_RATE = 0.1  # rad/s; a tracker's noise is 0.01 rad/s over 0.1 s and biases a column of A by 1 %
_MAX_RELATIVE_SIGMA = 0.1  # of a column of A that counts as known
_MIN_GOOD_R, _MIN_R = 0.95, 0.8
_MAX_LAG_OF_A_MOUSE_S = 0.5
_MAX_OUTLIERS = 0.05  # of the intervals
_MIN_TURN, _MIN_TILT = np.radians([3.0, 10.0])
_ADVICE = ("roll the ball towards you and away", "spin it about the vertical", "roll it left and right")


class RotationSteps(NamedTuple):
    """Rotation of the ball in n intervals, from one frame to the next or joined from several."""

    begin: Array  # (n,) s
    end: Array  # (n,) s
    rotation: Array  # (n, 3) rad, rotation vector in obj

    @classmethod
    def from_run(cls, run: Run) -> "RotationSteps":
        """Return the steps between neighbouring tracked frames, except those with a gap or a stamp that goes back."""
        k = run.steps
        begin, end = run.stamp[k - 1], run.stamp[k]
        kept = (end > begin) & (end < begin + _MAX_STEP_S) & (begin >= np.maximum.accumulate(run.stamp)[k - 1])
        return cls(begin[kept], end[kept], run.rotation[k[kept]])

    def joined(self) -> "RotationSteps":
        """Return intervals of about 0.1 s without a gap in them."""
        length = self.end - self.begin
        m = max(1, round(_INTERVAL_S / float(np.median(length))))
        n = len(length) // m * m
        begin, end = self.begin[:n:m], self.end[m - 1 : n : m]
        whole = np.isclose(end - begin, length[:n].reshape(-1, m).sum(axis=1), rtol=0.0, atol=1e-6)
        return RotationSteps(begin[whole], end[whole], self.rotation[:n].reshape(-1, m, 3).sum(axis=1)[whole])


class CountPath(NamedTuple):
    """Sum of the counts since the log's begin as a piecewise linear function of the log's time."""

    time: Array  # (m,) s
    sums: Array  # (m, 2) counts

    @classmethod
    def from_log(cls, log: MouseLog) -> "CountPath":
        """Spread each report's counts over the time since the last one, or over the median interval if that is less."""
        t, sums, steps = log.stamp, np.cumsum(log.counts, axis=0), np.diff(log.stamp)
        usual = steps[(steps > 0.0) & (steps < _MAX_REPORT_GAP_S)]
        interval = float(np.median(usual)) if len(usual) else _MAX_REPORT_GAP_S
        rest = np.flatnonzero(steps > 1.5 * interval)  # the mouse did not move
        return cls(np.insert(t, rest + 1, t[rest + 1] - interval), np.insert(sums, rest + 1, sums[rest], axis=0))

    def at(self, t: Array) -> Array:
        """Return the sums, (..., 2), at times t (...) s of the log; before and after it, those at its ends."""
        return np.stack([np.interp(t, self.time, self.sums[:, k]) for k in range(2)], axis=-1)


@dataclass(frozen=True, slots=True)
class Match:
    """Regression of a trackball's counts on the rotation of the ball."""

    matrix: Array  # (2, 3) counts/rad: x and y by rotation about the axes of obj
    lag: float  # s, stamp of the log less stamp of the frame
    covariance: Array  # (7, 7) of matrix by rows, and lag
    r: Array  # (2,) Pearson's r of x and y over intervals of 0.1 s
    rmse: Array  # (2,) counts/s over the same intervals
    rate: Array  # (3,) rad/s, RMS about each axis of obj that rotation about the other axes does not explain
    seconds: float  # s, length of the compared motion
    outliers: int  # intervals with lost reports or slip
    intervals: int

    @property
    def sigma(self) -> Array:
        """Standard deviations of `matrix`, (2, 3) counts/rad."""
        return np.sqrt(np.diag(self.covariance)[:6]).reshape(2, 3)

    @property
    def lag_sigma(self) -> float:
        """Standard deviation of the lag, s."""
        return float(np.sqrt(self.covariance[6, 6]))

    @property
    def known(self) -> Array:
        """Axes of obj, (3,), about which the ball moved enough to estimate their columns of `matrix`."""
        scale = np.sqrt(0.5 * np.sum(self.matrix**2))
        return np.all(self.sigma < _MAX_RELATIVE_SIGMA * scale, axis=0) & (self.rate > _MIN_RATE)


def match(steps: RotationSteps, log: MouseLog) -> Match | None:
    """Return the linear regression of the counts in `log` on the rotations in `steps`, at the best lag.

    None if one of them has no motion, or if steps of less than eight seconds in all lie within the log.
    """
    if not (np.any(log.counts) and np.any(steps.rotation)):
        return None
    if min(np.sum(steps.end - steps.begin), np.ptp(log.stamp)) < MIN_COMMON_S:
        return None
    path, rows = CountPath.from_log(log), steps.joined()
    lag = _search_lag(steps, path)
    shared = (rows.begin + lag >= path.time[0]) & (rows.end + lag <= path.time[-1])
    rows = RotationSteps(*(part[shared] for part in rows))
    if float(np.sum(rows.end - rows.begin)) < MIN_COMMON_S:
        return None
    return _regression(rows, path, lag)


def _search_lag(steps: RotationSteps, path: CountPath) -> float:
    """Return the lag at which a regression on the rotation explains most of the counts, to 20 ms."""
    times = np.column_stack([steps.begin, steps.end]).ravel()
    turned = np.cumsum(np.repeat(steps.rotation, 2, axis=0) * np.tile([0.0, 1.0], len(steps.begin))[:, None], axis=0)
    at = np.arange(times[0], times[-1], _LAG_STEP_S)
    W = np.diff(np.stack([np.interp(at, times, turned[:, k]) for k in range(3)], axis=1), axis=0)
    C = np.diff(path.at(np.arange(path.time[0], path.time[-1] + _LAG_STEP_S, _LAG_STEP_S)), axis=0)
    C = C / np.maximum(np.linalg.norm(C, axis=0), 1e-9)
    cross = np.stack([[correlate(C[:, k], W[:, i], method="fft") for i in range(3)] for k in range(2)])
    inverse = np.linalg.pinv(W.T @ W, rcond=1e-9, hermitian=True)
    explained = np.einsum("kin,ij,kjn->n", cross, inverse, cross)
    shift = int(np.argmax(explained)) - (len(W) - 1)
    return float(path.time[0] - times[0] + shift * _LAG_STEP_S)


def _regression(rows: RotationSteps, path: CountPath, lag: float) -> Match:
    """Return the robust estimate from `lag` on, by iteratively reweighted Gauss-Newton steps."""
    n, h, W = len(rows.begin), _LAG_DERIVATIVE_S, rows.rotation
    J = np.zeros((n, 2, 7))
    J[:, 0, :3] = J[:, 1, 3:6] = W
    w, sigma, p = np.ones((n, 2)), np.ones(2), np.append(np.zeros(6), lag)
    counts = residual = np.zeros((n, 2))
    for _ in range(_REWEIGHTINGS):
        times = np.stack([rows.begin, rows.end]) + p[6]
        counts, later, earlier = (np.diff(path.at(times + d), axis=0)[0] for d in (0.0, h, -h))
        J[:, :, 6] = (earlier - later) / (2.0 * h)
        root = np.sqrt(w) / sigma
        solution = np.linalg.lstsq((J * root[..., None]).reshape(-1, 7), (counts * root).ravel())[0]
        residual = counts - J @ solution
        p = np.append(solution[:6], p[6] + solution[6])
        moving = np.any((counts != 0.0) | (np.abs(counts - residual) > 0.5), axis=1)
        sigma = np.maximum(mad_sigma(residual[moving]), _MIN_SIGMA)
        w = 1.0 / (1.0 + (residual / (_CAUCHY_SIGMAS * sigma)) ** 2)
    dt, rate = (rows.end - rows.begin)[:, None], W / (rows.end - rows.begin)[:, None]
    expected = counts - residual
    outlier = np.abs(residual) > np.maximum(_OUTLIER_SIGMA * sigma, _OUTLIER_COUNTS)
    return Match(
        matrix=p[:6].reshape(2, 3),
        lag=float(p[6]),
        covariance=_covariance(J / sigma[:, None], residual / sigma, w),
        r=np.array([pearson(counts[:, k], expected[:, k]) or 0.0 for k in range(2)]),
        rmse=np.sqrt(np.mean((residual / dt) ** 2, axis=0)),
        rate=1.0 / np.sqrt(np.diag(np.linalg.inv(rate.T @ rate / n + 1e-12 * np.eye(3)))),
        seconds=float(dt.sum()),
        outliers=int(np.count_nonzero(np.any(outlier, axis=1))),
        intervals=n,
    )


def _covariance(J: Array, u: Array, w: Array) -> Array:
    """Return the covariance (7, 7) by a linearised jackknife of blocks (Cameron, Gelbach, Miller 2008, CR3).

    `J` (n, 2, 7) is the Jacobian, `u` (n, 2) the residuals in standard deviations, and `w` (n, 2) their weights.
    """
    n = len(u) // _BLOCK_ROWS * _BLOCK_ROWS
    J, score = J[:n].reshape(-1, 2 * _BLOCK_ROWS, 7), (w * u)[:n].reshape(-1, 2 * _BLOCK_ROWS)
    curvature = np.mean((2.0 * w - 1.0) * w)  # derivative of Cauchy's influence function w u
    blocks = curvature * np.einsum("bmi,bmj->bij", J, J)
    information = blocks.sum(axis=0)
    information += 1e-9 * np.diag(np.diag(information)) + 1e-12 * np.eye(7)  # axes without motion
    change = np.linalg.solve(information - blocks, np.einsum("bmi,bm->bi", J, score)[..., None])[..., 0]
    covariance = change.T @ change
    covariance[6, 6] += _STAMP_SIGMA_S**2
    return covariance


# ---- verdict and settings ----


class Verdict(NamedTuple):
    """The assessment of a match for a person."""

    usable: bool  # scale and axes
    text: str  # one sentence
    notes: tuple[str, ...] = ()


def judge(match: Match) -> Verdict:
    """Return the verdict on a match: unusable with the reason, or usable with notes."""
    r = f"r = {match.r[0]:.4f} in x and {match.r[1]:.4f} in y over 0.1 s"
    resting_axes = [k for k in (0, 2) if match.rate[k] < _MIN_RATE]
    if match.r.min() < _MIN_R and not resting_axes:
        return Verdict(
            usable=False,
            text=f"the log does not follow the ball ({r}): it is of another time or another mouse, or the trackball is "
            "dirty; record both at once, for half a minute",
        )
    missing = resting_axes or [k for k in (0, 2) if not match.known[k]]
    if missing:
        return Verdict(
            usable=False,
            text=f"too little motion about {' and '.join('XYZ'[k] for k in missing)} to estimate the scale: "
            f"{' and '.join(_ADVICE[k] for k in missing)}, and record again",
        )
    if match.r.min() < _MIN_GOOD_R:
        agreement = f"the two agree roughly ({r}): the trackball slips or loses reports"
    else:
        agreement = f"the two agree ({r})"
    return Verdict(usable=True, text=agreement, notes=_notes(match))


def _notes(match: Match) -> tuple[str, ...]:
    """Return the unusual findings of a match, and those that no setting can express, in words."""
    notes = []
    if abs(match.lag) > _MAX_LAG_OF_A_MOUSE_S:
        order = "ahead of" if match.lag > 0 else "behind"
        notes.append(f"the clock of the log is {abs(match.lag):.3f} s {order} that of the frames; this does no harm")
    if match.outliers > _MAX_OUTLIERS * match.intervals:
        notes.append(
            f"{match.outliers} of {match.intervals} intervals of 0.1 s do not fit: reports are missing, or the "
            "trackball slips"
        )
    axes = axes_of(match)
    if abs(axes.turn) > max(_MIN_TURN, 3.0 * float(np.max(axes.sigma / axes.scale))):
        notes.append(
            f"the axes are turned by {np.degrees(abs(axes.turn)):.1f}° about Y, which no setting expresses: the "
            "pointer's direction differs by that angle"
        )
    contact = np.cross(*match.matrix)  # rotation about the point of contact moves nothing
    contact *= -np.sign(contact[1]) / np.linalg.norm(contact)
    tilt = float(np.arccos(np.clip(-contact[1], -1.0, 1.0)))
    if match.known.all() and tilt > _MIN_TILT:
        notes.append(
            f"it touches the ball {np.degrees(tilt):.0f}° from the lowest point (towards X {contact[0]:+.2f}, "
            f"Z {contact[2]:+.2f} of obj): a spin of the ball moved it and will not move the pointer"
        )
    return tuple(notes)


class TrackballAxes(NamedTuple):
    """Scales and directions of the trackball's axes. Settings can express all but `turn`."""

    player: Player  # place for which x of the trackball is right
    mirrored: bool  # its y is reversed there
    scale: Array  # (2,) counts/rad
    sigma: Array  # (2,) counts/rad
    turn: float  # rad about Y, beyond that of the player


def axes_of(match: Match) -> TrackballAxes:
    """Split the matrix of a match into the player's place, signs, scales and a turn."""
    A, S = match.matrix, match.sigma
    found = []
    for player in get_args(Player):
        for mirrored in (False, True):
            D = MotionSettings(player=player).directions()[:2] * np.array([[1.0], [-1.0 if mirrored else 1.0]])
            along = A @ D.T
            turn = 0.5 * (np.arctan2(along[0, 1], along[0, 0]) - np.arctan2(along[1, 0], along[1, 1]))
            sigma = np.sqrt(np.sum((S * D) ** 2, axis=1))
            found.append(TrackballAxes(player, mirrored, np.diag(along), sigma, float(turn)))
    return max(found, key=lambda axes: float(np.sum(axes.scale)))


def settings_of(match: Match, radius: float | None, current: MotionSettings) -> MotionSettings:
    """Return settings with which x and y of the pointer move as the trackball did.

    The third axis stays as in the `current` settings. `radius` is the ball's in m. If it is None, because the rig has
    no scale, the result has `counts_per_radian`, which overrides `counts_per_mm`. Both axes get one scale if they
    differ by no more than twice the standard deviation of their difference.
    """
    axes = axes_of(match)
    x, y = axes.scale.tolist()
    if abs(x - y) <= 2.0 * float(np.hypot(*axes.sigma)):
        x = y = float(np.average([x, y], weights=axes.sigma**-2.0))
    unit = 1.0 if radius is None else 1000.0 * radius  # mm/rad
    scale = _round(float(np.sqrt(x * y)) / unit)
    return replace(
        current,
        player=axes.player,
        counts_per_mm=current.counts_per_mm if radius is None else scale,
        counts_per_radian=scale if radius is None else None,
        scale_x=1.0 if x == y else _round(x / (unit * scale)),
        scale_y=1.0 if x == y else _round(y / (unit * scale)),
        scale_z=_round(current.scale_z * current.scale(radius) / (unit * scale)),
        invert_x=False,
        invert_y=axes.mirrored,
    )


def _round(value: float) -> float:
    return float(f"{value:.5g}")
