"""Estimate scale, axes and lag of a trackball under the ball, from the ball's rotation and the log of the trackball.

Counts between two times are A times the rotation of the ball between them. A (2, 3) in counts/rad holds scale and axes
at once. Wittich 2017, section 4.1.1 and eq. 175, estimates lag, one scale and one offset for each axis. An offset has
no meaning here, since a ball at rest sends no counts.

`search_lag` regresses the counts on the rotation at every lag. `match` then estimates A, lag and drift of the clock by
one robust regression with Cauchy's loss, so that lost reports and slip do not spoil the scale. The covariance accounts
for the correlation of neighbouring residuals.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from spheremouse.evaluate.metrics import Run, pearson
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma

MIN_COMMON_S = 3.0  # that recording and log must share
_INTERVAL_S = 0.1  # rows of the regression; shorter ones have too much noise beside the rotation
_MAX_COMPARED_S = 120.0  # the part with most motion; longer ones add nothing to the accuracy
_MAX_FRAME_GAP_S = 0.5  # between two frames of one step
_LAG_STEP_S = 0.04  # of the search; the regression converges from half of it
_LAG_CHUNK = 512  # lags of the search at once, bounds the memory
_MEMORY_S = 0.6  # a hand's motion is much the same within it, so it counts as one observation
_RIVAL_DISTANCE_S = 1.0  # of the second best lag from the best
_MAX_REPORT_GAP_S = 0.05  # between two reports of a mouse that moves
_MIN_SIGMA_COUNTS = 0.2  # of a residual: whole counts
_CAUCHY = 2.385  # standard deviations: 95 % efficiency for normal errors (Holland and Welsch 1977)
_ROUNDS = 3  # of the regression and its noise
_OUTLIER_SIGMA = 5.0
_OUTLIER_COUNTS = 3.0
_BLOCK_ROWS = 5  # half a second: an error at the end of an interval cancels in the next one
_LAG_DERIVATIVE_S = 0.03  # several reports of a coarse trackball
_PRIOR_SCALES = 10.0  # prior standard deviation of A in units of its size: for axes without motion
_PRIOR_CLOCK = (1e-3, 1e3)  # square root of the information of lag (1/s) and drift
_STAMP_SIGMA_S = 1e-4  # of stamps of mice and cameras at best
_MIN_RATE = 0.1  # rad/s; a tracker's noise is 0.01 rad/s over 0.1 s and biases a column of A by 1 %
_MAX_RELATIVE_SIGMA = 0.1  # of a column of A that counts as known


@dataclass(frozen=True, slots=True)
class RotationSteps:
    """Rotation of the ball in n intervals, from one frame to the next or joined from several."""

    begin: Array  # (n,) s
    end: Array  # (n,) s
    rotation: Array  # (n, 3) rad, rotation vector in obj

    def __len__(self) -> int:
        return len(self.begin)

    def __getitem__(self, keep: NDArray[np.bool_] | slice) -> "RotationSteps":
        return RotationSteps(self.begin[keep], self.end[keep], self.rotation[keep])

    @classmethod
    def from_run(cls, run: Run) -> "RotationSteps":
        """Return the steps between neighbouring tracked frames, except those with a gap or a stamp that goes back."""
        k = run.tracked
        k = k[np.isin(k - 1, k)]
        step = run.stamp[k] - run.stamp[k - 1]
        k = k[(step > 0.0) & (step < _MAX_FRAME_GAP_S) & (run.stamp[k - 1] >= np.maximum.accumulate(run.stamp)[k - 1])]
        return cls(run.stamp[k - 1], run.stamp[k], run.rotation[k])


@dataclass(frozen=True, slots=True)
class CountPath:
    """Sum of the counts since the log's begin as a piecewise linear function of the log's time."""

    time: Array  # (m,) s
    sums: Array  # (m, 2) counts
    gaps: Array  # (k, 2) s, begin and end of times with lost reports

    @classmethod
    def from_log(cls, log: MouseLog) -> "CountPath":
        """Spread each report's counts over the time since the last one, or over the median interval if that is less."""
        t, sums, steps = log.stamp, np.cumsum(log.counts, axis=0), np.diff(log.stamp)
        usual = steps[(steps > 0.0) & (steps < _MAX_REPORT_GAP_S)]
        interval = float(np.median(usual)) if len(usual) else _MAX_REPORT_GAP_S
        rest = np.flatnonzero(steps > 1.5 * interval)  # the mouse did not move
        time = np.insert(t, rest + 1, t[rest + 1] - interval)
        lost = np.flatnonzero(log.lost[1:])
        return cls(time, np.insert(sums, rest + 1, sums[rest], axis=0), np.stack([t[lost], t[lost + 1]], axis=1))

    def at(self, t: Array) -> Array:
        """Return the sums, (..., 2), at times t (...) of the log."""
        return np.stack([np.interp(t, self.time, self.sums[:, k]) for k in range(2)], axis=-1)

    def between(self, begin: Array, end: Array) -> Array:
        """Return the counts, (..., 2), from `begin` to `end`, (...) s of the log."""
        return self.at(end) - self.at(begin)

    def covers(self, begin: Array, end: Array) -> NDArray[np.bool_]:
        """Return True where the log has all reports from `begin` to `end`, (...) s of the log."""
        known = (begin >= self.time[0]) & (end <= self.time[-1])
        gap = np.searchsorted(self.gaps[:, 1], begin, side="right")  # the first that ends later
        return known & (np.append(self.gaps[:, 0], np.inf)[gap] >= end)


@dataclass(frozen=True, slots=True)
class LagPeak:
    """The lag at which the rotation explains the counts best."""

    lag: float  # s, stamp of the log less stamp of the frame
    likelihood: float  # logarithm of the likelihood ratio against no relation
    rival: float  # that of the best lag at another place


@dataclass(frozen=True, slots=True)
class Match:
    """Regression of a trackball's counts on the rotation of the ball."""

    matrix: Array  # (2, 3) counts/rad: x and y by rotation about the axes of obj
    lag: float  # s, stamp of the log less stamp of the frame, at `middle`
    drift: float  # -, by which the log's clock is faster
    covariance: Array  # (8, 8) of matrix by rows, lag, drift
    middle: float  # s, of the frames' clock
    r: tuple[float, float]  # Pearson's r of x and y over intervals of 0.1 s
    r_pooled: float  # x and y as one series
    rmse: Array  # (2,) counts/s over the same intervals
    travel: Array  # (2,) counts, sum of the absolute values
    rate: Array  # (3,) rad/s, RMS about the axes of obj
    independent_rate: Array  # (3,) rad/s, the part of it that rotation about the other axes does not explain
    seconds: float  # compared
    outliers: int  # intervals with lost reports or slip
    intervals: int
    peak: LagPeak

    @property
    def sigma(self) -> Array:
        """Standard deviations of `matrix`, (2, 3) counts/rad."""
        return np.sqrt(np.diag(self.covariance)[:6]).reshape(2, 3)

    @property
    def lag_sigma(self) -> float:
        """Standard deviation of the lag, s."""
        return float(np.sqrt(self.covariance[6, 6]))

    @property
    def drift_sigma(self) -> float:
        """Standard deviation of the drift."""
        return float(np.sqrt(self.covariance[7, 7]))

    @property
    def known(self) -> NDArray[np.bool_]:
        """Axes of obj, (3,), about which the ball moved enough to estimate their columns of `matrix`."""
        scale = np.sqrt(0.5 * np.sum(self.matrix**2))
        return np.all(self.sigma < _MAX_RELATIVE_SIGMA * scale, axis=0) & (self.independent_rate > _MIN_RATE)


def match(steps: RotationSteps, log: MouseLog) -> Match | None:
    """Return the regression of `log` on `steps`.

    None if the two share less than three seconds, if one has no motion, or if fewer than 1.5 s remain without lost
    reports.
    """
    if len(steps) == 0 or len(log) < 2 or not np.any(log.counts):
        return None
    path, rows = CountPath.from_log(log), _most_motion(_intervals(steps))
    peak = search_lag(rows, path)
    if peak is None:
        return None
    rows = rows[path.covers(rows.begin + peak.lag - _LAG_STEP_S, rows.end + peak.lag + _LAG_STEP_S)]
    if len(rows) * _INTERVAL_S < 0.5 * MIN_COMMON_S:
        return None
    return _Regression(rows, path, peak, 0.5 * float(rows.begin[0] + rows.end[-1])).solve()


def _intervals(steps: RotationSteps) -> RotationSteps:
    """Join steps to intervals of about 0.1 s. Drop rests shorter than half of that, where the tracker was lost."""
    joined = np.concatenate([[False], steps.begin[1:] == steps.end[:-1]])
    first = np.flatnonzero(~joined)[np.cumsum(~joined) - 1]
    last = np.append(np.flatnonzero(~joined)[1:], len(steps))[np.cumsum(~joined) - 1] - 1
    length = steps.end[last] - steps.begin[first]
    parts = np.maximum(1.0, np.rint(length / _INTERVAL_S))
    fraction = (0.5 * (steps.begin + steps.end) - steps.begin[first]) / length
    part = np.minimum(np.floor(fraction * parts), parts - 1.0)
    begin = np.flatnonzero(~joined | (np.diff(part, prepend=-1.0) != 0.0))
    end = np.append(begin[1:], len(steps)) - 1
    rows = RotationSteps(steps.begin[begin], steps.end[end], np.add.reduceat(steps.rotation, begin, axis=0))
    return rows[rows.end - rows.begin > 0.5 * _INTERVAL_S]


def _most_motion(rows: RotationSteps) -> RotationSteps:
    """Return the rows of the two minutes with the largest sum of squared rotations."""
    sums = np.concatenate([[0.0], np.cumsum(np.sum(rows.rotation**2, axis=1))])
    last = np.searchsorted(rows.end, rows.begin + _MAX_COMPARED_S, side="right")
    k = int(np.argmax(sums[last] - sums[: len(rows)])) if len(rows) else 0
    return rows[k : last[k]] if len(rows) else rows


def search_lag(rows: RotationSteps, path: CountPath) -> LagPeak | None:
    """Return the most likely lag of `path` after `rows`; None if no lag has three seconds of motion in common.

    Each lag is weighed by the time that the two share: a short overlap correlates well by chance.
    """
    if len(rows) == 0:
        return None
    lags = np.arange(path.time[0] - rows.end[-1], path.time[-1] - rows.begin[0], _LAG_STEP_S)
    if len(lags) == 0:
        return None
    likelihood = np.concatenate(
        [_likelihoods(rows, path, lags[k : k + _LAG_CHUNK]) for k in range(0, len(lags), _LAG_CHUNK)]
    )
    best = int(np.argmax(likelihood))
    if not likelihood[best] > 0.0:
        return None
    far = np.abs(lags - lags[best]) > _RIVAL_DISTANCE_S
    return LagPeak(float(lags[best]), float(likelihood[best]), float(np.max(likelihood[far], initial=0.0)))


def _likelihoods(rows: RotationSteps, path: CountPath, lags: Array) -> Array:
    """Return the logarithms, (n,), of the likelihood ratios of a relation and none, at lags (n,) s.

    It is 0 if rows and log have too little in common at a lag.
    """
    W = rows.rotation
    begin, end = rows.begin + lags[:, None], rows.end + lags[:, None]
    known = path.covers(begin, end).astype(float)
    counts = path.between(begin, end) * known[..., None]
    WW = np.tensordot(known, W[:, :, None] * W[:, None, :], axes=1)
    Wc = np.einsum("mi,nmk->nik", W, counts)
    power = np.trace(WW, axis1=1, axis2=2)
    fitted = np.linalg.solve(WW + (1e-9 * power + 1e-12)[:, None, None] * np.eye(3), Wc)
    total = np.sum(counts**2, axis=1)
    explained = np.clip(np.sum(Wc * fitted, axis=1) / np.maximum(total, 1e-9), 0.0, 1.0 - 1e-6)
    seconds = known @ (rows.end - rows.begin)
    observations = np.maximum(seconds / _MEMORY_S - 4.0, 0.0)  # three coefficients explain three at once
    enough = (seconds > MIN_COMMON_S) & (power > 1e-6 * np.sum(W**2)) & (np.sum(total, axis=1) > 1.0)
    return np.where(enough, -0.5 * observations * np.sum(np.log1p(-explained), axis=1), 0.0)


@dataclass(frozen=True, slots=True)
class _Regression:
    """Regression of counts on rotation. Parameters p (8,): A by rows, lag less the lag of the search, drift."""

    rows: RotationSteps
    path: CountPath
    peak: LagPeak
    middle: float  # s

    def counts(self, p: Array, delay: float = 0.0) -> Array:
        """Return the counts (m, 2) of each of m intervals with the lag and drift of p, plus `delay` s."""
        times = np.stack([self.rows.begin, self.rows.end])
        times = times + (self.peak.lag + p[6] + delay) + p[7] * (times - self.middle)
        return self.path.between(times[0], times[1])

    def residuals(self, p: Array) -> Array:
        """Return the counts less those that A predicts, (m, 2)."""
        return self.counts(p) - self.rows.rotation @ p[:6].reshape(2, 3).T

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives (m, 2, 8) of the residuals by p."""
        h, rows = _LAG_DERIVATIVE_S, self.rows
        J = np.zeros((len(rows), 2, 8))
        J[:, 0, :3] = J[:, 1, 3:6] = -rows.rotation
        J[:, :, 6] = (self.counts(p, h) - self.counts(p, -h)) / (2.0 * h)
        J[:, :, 7] = J[:, :, 6] * (0.5 * (rows.begin + rows.end) - self.middle)[:, None]
        return J

    def solve(self) -> Match:
        """Return the robust estimate with its covariance."""
        W = self.rows.rotation
        p = np.zeros(8)
        p[:6] = np.linalg.solve(W.T @ W + 1e-9 * np.eye(3) * np.sum(W**2), W.T @ self.counts(p)).T.ravel()
        prior = np.append(np.full(6, 1.0 / max(_PRIOR_SCALES * float(np.linalg.norm(p)), 1e-9)), _PRIOR_CLOCK)
        sigma = self._sigma(p)
        for _ in range(_ROUNDS):
            p, sigma = self._minimise(p, sigma, prior), self._sigma(p)
        return self._describe(p, self._covariance(p, sigma, prior))

    def _sigma(self, p: Array) -> Array:
        """Return the robust standard deviation (2,) of the residuals, in counts, over intervals with motion."""
        return np.maximum(mad_sigma(self.residuals(p)[self._moving(p)]), _MIN_SIGMA_COUNTS)

    def _moving(self, p: Array) -> NDArray[np.bool_]:
        counts = self.counts(p)
        return np.any((np.abs(counts - self.residuals(p)) > 0.5) | (counts != 0.0), axis=1)

    def _minimise(self, p: Array, sigma: Array, prior: Array) -> Array:
        """Return the parameters of least loss; `prior` (8,) is the square root of the information without data."""

        def residuals(q: Array) -> Array:
            return np.append(self.residuals(q) / sigma, prior * q)

        def jacobian(q: Array) -> Array:
            return np.concatenate([(self.jacobian(q) / sigma[:, None]).reshape(-1, 8), np.diag(prior)])

        jac: Any = jacobian  # SciPy's stubs take the name of a scheme alone
        return np.asarray(least_squares(residuals, p, jac, loss="cauchy", f_scale=_CAUCHY, x_scale="jac").x)

    def _covariance(self, p: Array, sigma: Array, prior: Array) -> Array:
        """Return the covariance (8, 8) by a linearised jackknife of blocks (Cameron, Gelbach, Miller 2008, CR3)."""
        n = len(self.rows) // _BLOCK_ROWS * _BLOCK_ROWS
        u = (self.residuals(p) / sigma)[:n].reshape(-1, 2 * _BLOCK_ROWS)
        J = (self.jacobian(p) / sigma[:, None])[:n].reshape(-1, 2 * _BLOCK_ROWS, 8)
        w = 1.0 / (1.0 + (u / _CAUCHY) ** 2)
        curvature = np.mean((2.0 * w - 1.0) * w)  # derivative of Cauchy's influence function w u
        blocks = curvature * np.einsum("bmi,bmj->bij", J, J)
        information = blocks.sum(axis=0) + np.diag(prior**2)
        score = np.einsum("bmi,bm->bi", J, w * u)
        change = np.linalg.solve(information - blocks, score[..., None])[..., 0]  # if the block is left out
        inverse = np.linalg.inv(information)
        covariance = change.T @ change + inverse @ np.diag(prior**2) @ inverse
        covariance[6, 6] += _STAMP_SIGMA_S**2
        return 0.5 * (covariance + covariance.T)

    def _describe(self, p: Array, covariance: Array) -> Match:
        rows, counts, residuals = self.rows, self.counts(p), self.residuals(p)
        limit = np.maximum(_OUTLIER_SIGMA * self._sigma(p), _OUTLIER_COUNTS)
        dt = (rows.end - rows.begin)[:, None]
        rates = rows.rotation / dt
        moment = rates.T @ rates / len(rows)
        expected = counts - residuals
        return Match(
            matrix=p[:6].reshape(2, 3),
            lag=self.peak.lag + float(p[6]),
            drift=float(p[7]),
            covariance=covariance,
            middle=self.middle,
            r=(pearson(counts[:, 0], expected[:, 0]) or 0.0, pearson(counts[:, 1], expected[:, 1]) or 0.0),
            r_pooled=pearson(counts.ravel(), expected.ravel()) or 0.0,
            rmse=np.sqrt(np.mean((residuals / dt) ** 2, axis=0)),
            travel=np.sum(np.abs(counts), axis=0),
            rate=np.sqrt(np.diag(moment)),
            independent_rate=1.0 / np.sqrt(np.diag(np.linalg.inv(moment + 1e-12 * np.eye(3)))),
            seconds=float(dt.sum()),
            outliers=int(np.count_nonzero(np.any(np.abs(residuals) > limit, axis=1))),
            intervals=len(rows),
            peak=self.peak,
        )
