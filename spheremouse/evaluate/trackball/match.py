"""How well a trackball and the tracked ball agree: rotation between frames and a mouse's log in, a regression out.

Counts between two frames are the integral of A w over the time between them, A (2, 3) counts/rad: scale and axes at
once, of a trackball that touches the ball wherever it likes. Lag and drift of the log's clock are estimated with A.
Wittich 2017, section 4.1.1 and eq. 175, where lag, one scale and an offset are sought for each axis; an offset has no
meaning here: a ball at rest sends nothing.

What differs is of two kinds, in shares that the differences themselves tell (maximum likelihood): places that are
wrong by their own noise (pixels, whole counts), which the next difference takes back, and motion that is lost for good
(slip). Intervals of 0.1 s keep the noise of the rotation so small beside the rotation that it does not draw A towards
zero: 0.5 mrad in 50 mrad are 0.02 %. Intervals that differ far more than the others have lost reports and are cut out.
The covariance is that of least squares with noise of unknown and changing size (White's, over blocks of intervals).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded

from spheremouse.evaluate.metrics import Run, pearson
from spheremouse.evaluate.trackball.lag import Peak, Travel, Turning, search, travel
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma

INTERVAL = 0.1  # s
_LONGEST = 0.5  # s between two frames; beyond that nobody knows what a hand did
_FIRST = 60.0  # s, of the part in which the lag is sought: a drift of 0.1 % shifts its ends by 0.03 s
_DRIFT_SIGMA = 1e-3  # what clocks differ by at most, as a standard deviation
_FREE = 10.0  # prior standard deviation of A's elements, in units of what A seems to be
_FAR = 5.0  # standard deviations of the others from which on an interval is cut
_FAR_COUNTS = 3.0  # and counts
_BLOCK = 5  # intervals: within half a second differences may depend on each other
_ROUNDS = 30
_STAMPS = 1e-4  # s, that stamps of mice and cameras are good to at best
_SHARES = np.geomspace(1e-3, 1e3, 13)  # of the two kinds of noise that are tried
_AS_GOOD = 4.0  # of the logarithm of a likelihood: within what may well be so

STIRRED = 0.1  # rad/s; the noise of a tracker is about 0.01 rad/s over 0.1 s, and draws a column to zero by 1 %
UNKNOWN = 0.1  # standard deviation, in units of the scale, beyond which a column of A is not known


@dataclass(frozen=True, slots=True)
class Match:
    """The regression of a trackball's counts on the ball's rotation, with its lag and its residuals."""

    lag: float  # s, stamp of the log less stamp of the frame of the same moment, in the middle of what both have
    drift: float  # -, by which the log's clock is faster
    matrix: Array  # (2, 3) counts/rad: x and y by rotation about the axes of obj
    covariance: Array  # (8, 8) of matrix by rows, lag, drift
    r: tuple[float | None, float | None]  # Pearson's r of x and y, of counts per second between frames (eq. 175)
    r_interval: float  # the same of 0.1 s intervals, x and y as one series
    rmse: Array  # (2,) counts/s between frames
    sums: Array  # (2,) counts that went to and fro, x and y
    rate: Array  # (3,) rad/s, RMS rate about the axes of obj over 0.1 s
    apart: Array  # (3,) rad/s, of it what does not go with rotation about the other axes
    seconds: float  # s, what both have in common and was compared
    middle: float  # s, of the frames' clock: the moment that `lag` is of
    cut: int  # intervals left out because reports seem to be lost, or because it slipped
    intervals: int  # all of them
    peak: Peak

    @property
    def sigma(self) -> Array:
        """Standard deviations of `matrix`, (2, 3) counts/rad."""
        return np.sqrt(np.diag(self.covariance)[:6]).reshape(2, 3)

    @property
    def lag_sigma(self) -> float:
        """s."""
        return float(np.sqrt(self.covariance[6, 6]))

    @property
    def drift_sigma(self) -> float:
        """Of the drift."""
        return float(np.sqrt(self.covariance[7, 7]))

    @property
    def scale(self) -> float:
        """Counts per radian: the RMS of both axes."""
        return float(np.sqrt(0.5 * np.sum(self.matrix**2)))

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the ball was moved enough about each axis of obj to say what it does, (3,).

        An axis about which there is nothing but the tracker's noise would seem to be known, as one without effect.
        """
        return np.all(self.sigma < UNKNOWN * self.scale, axis=0) & (self.apart > STIRRED)

    @property
    def condition(self) -> float:
        """Condition of A's columns: how many times better the best known combination is known than the worst."""
        values = np.linalg.eigvalsh(self.covariance[:6, :6])
        return float(np.sqrt(values[-1] / max(values[0], 1e-300)))


def turning(run: Run) -> Turning:
    """Rotation between frames that follow each other and were both tracked."""
    k = run.tracked
    k = k[np.isin(k - 1, k)]
    step = run.stamp[k] - run.stamp[k - 1]
    k = k[(step > 0.0) & (step < _LONGEST) & (run.stamp[k - 1] >= np.maximum.accumulate(run.stamp)[k - 1])]
    return Turning(run.stamp[k - 1], run.stamp[k], run.rotation[k])


def match(ball: Turning, log: MouseLog) -> Match | None:
    """Compare; None where ball and log have less than three seconds in common, or one of them did not move."""
    if len(ball) == 0 or len(log) < 2 or not np.any(log.counts):
        return None
    counts = travel(log)
    part = _liveliest(ball)
    peak = search(part, counts)
    if peak is None:
        return None
    state = _State(_regression(_intervals(part), counts, peak.lag), peak.lag, 0.0, _middle(part))
    length = part.end[-1] - part.begin[0]
    while True:  # from the part in which the lag was found to all of it: a drift is known better every time
        found = _fitted(part, counts, state)
        if found is None:
            return None
        state = found.state
        if len(part) == len(ball):
            return _described(ball, counts, found, peak)
        length *= 3.0
        part = ball.within(state.origin - 0.5 * length, state.origin + 0.5 * length)
        if length > 2.0 * (ball.end[-1] - ball.begin[0]):
            part = ball


# ---- parts of the recording ----


def _middle(ball: Turning) -> float:
    return 0.5 * float(ball.begin[0] + ball.end[-1])


def _liveliest(ball: Turning) -> Turning:
    """The minute in which the ball turned most."""
    if ball.end[-1] - ball.begin[0] <= _FIRST:
        return ball
    moved = np.concatenate([[0.0], np.cumsum(np.sum(ball.rotation**2, axis=1))])
    last = np.searchsorted(ball.end, ball.begin + _FIRST, side="right")
    k = int(np.argmax(moved[last] - moved[: len(ball)]))
    return ball.within(ball.begin[k], ball.begin[k] + _FIRST)


@dataclass(frozen=True, slots=True)
class _Rows:
    """Intervals of about 0.1 s, made of whole steps between frames."""

    begin: Array  # (m,) s
    end: Array  # (m,) s
    rotation: Array  # (m, 3) rad
    rate_begin: Array  # (m, 3) rad/s
    rate_end: Array  # (m, 3) rad/s
    follows: NDArray[np.bool_]  # (m,) begins where the one before ends

    def kept(self, keep: NDArray[np.bool_]) -> "_Rows":
        follows = self.follows & np.concatenate([[False], keep[:-1]])
        return _Rows(
            self.begin[keep], self.end[keep], self.rotation[keep], self.rate_begin[keep], self.rate_end[keep],
            follows[keep],
        )  # fmt: skip


def _intervals(ball: Turning) -> _Rows:
    """Steps between frames put together; a run of frames shorter than half an interval is dropped."""
    n = len(ball)
    joined = np.concatenate([[False], ball.begin[1:] == ball.end[:-1]])
    run = np.cumsum(~joined) - 1
    first = np.flatnonzero(~joined)
    last = np.append(first[1:], n) - 1
    length = (ball.end[last] - ball.begin[first])[run]
    parts = np.maximum(1.0, np.rint(length / INTERVAL))
    share = (0.5 * (ball.begin + ball.end) - ball.begin[first][run]) / length
    group = np.minimum(np.floor(share * parts), parts - 1.0)
    new = ~joined | np.concatenate([[True], group[1:] != group[:-1]])
    a = np.flatnonzero(new)
    b = np.append(a[1:], n) - 1
    at_begin, at_end = _rates(ball, joined)
    rows = _Rows(
        ball.begin[a], ball.end[b], np.add.reduceat(ball.rotation, a, axis=0), at_begin[a], at_end[b], joined[a]
    )
    return rows.kept(rows.end - rows.begin > 0.5 * INTERVAL)


def _rates(ball: Turning, joined: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Rates at the beginning and at the end of each step, (n, 3) rad/s: means of the steps on both sides."""
    rate = ball.rotation / (ball.end - ball.begin)[:, None]
    at_begin, at_end = rate.copy(), rate.copy()
    k = np.flatnonzero(joined)
    at_begin[k] = at_end[k - 1] = 0.5 * (rate[k] + rate[k - 1])
    return at_begin, at_end


# ---- least squares ----


@dataclass(frozen=True, slots=True)
class _State:
    matrix: Array  # (2, 3)
    lag: float  # s, at `origin`
    drift: float
    origin: float  # s, of the frames' clock

    def log_time(self, t: Array) -> Array:
        return t + self.lag + self.drift * (t - self.origin)

    def moved_to(self, origin: float) -> "_State":
        return replace(self, lag=self.lag + self.drift * (origin - self.origin), origin=origin)


@dataclass(frozen=True, slots=True)
class _Found:
    state: _State
    covariance: Array  # (8, 8)
    intervals: int  # that the log covers
    cut: int


def _counted(counts: Travel, state: _State, begin: Array, end: Array) -> Array:
    return counts.at(state.log_time(end)) - counts.at(state.log_time(begin))


def _regression(rows: _Rows, counts: Travel, lag: float) -> Array:
    """A (2, 3) by plain least squares, to begin with."""
    state = _State(np.zeros((2, 3)), lag, 0.0, 0.0)
    rows = rows.kept(counts.covers(rows.begin + lag, rows.end + lag))
    y, X = _counted(counts, state, rows.begin, rows.end), rows.rotation
    N = X.T @ X
    return np.linalg.solve(N + (1e-6 * np.trace(N) + 1e-300) * np.eye(3), X.T @ y).T


def _fitted(ball: Turning, counts: Travel, state: _State) -> _Found | None:
    """Gauss-Newton from `state`; None where nothing is left to compare."""
    every = _intervals(ball)
    covered = counts.covers(state.log_time(every.begin), state.log_time(every.end))
    every = every.kept(covered)
    if len(every.begin) < 2 * _BLOCK:
        return None
    state = state.moved_to(0.5 * float(every.begin[0] + every.end[-1]))
    prior = _FREE * _size(every, counts, state)
    if prior == 0.0:
        return None
    step = np.full(8, np.inf)
    covariance = np.eye(8)
    keep = np.ones(len(every.begin), dtype=bool)
    for k in range(_ROUNDS):
        if k < _ROUNDS // 2:  # later what is cut stays so, or it might go to and fro
            keep = _plausible(every, counts, state)
        state, step, covariance = _improved(every.kept(keep), counts, state, prior)
        if k and np.all(np.abs(step) < 1e-3 * np.sqrt(np.diag(covariance))):
            break
    span = float(every.end[-1] - every.begin[0])
    covariance[6, 6] += _STAMPS**2
    covariance[7, 7] += 12.0 * (_STAMPS / span) ** 2  # of a time evenly spread over the span
    return _Found(state, covariance, len(keep), int(np.count_nonzero(~keep)))


def _size(rows: _Rows, counts: Travel, state: _State) -> float:
    """Counts per radian, roughly: how much more of the one there is than of the other."""
    moved = np.sqrt(np.sum(rows.rotation**2))
    return float(np.sqrt(np.sum(_counted(counts, state, rows.begin, rows.end) ** 2)) / moved) if moved > 0.0 else 0.0


def _plausible(rows: _Rows, counts: Travel, state: _State) -> NDArray[np.bool_]:
    """Whether intervals differ no more than the others of those in which something moved, (m,)."""
    expected = rows.rotation @ state.matrix.T
    counted = _counted(counts, state, rows.begin, rows.end)
    moving = np.any((np.abs(expected) > 0.5) | (counted != 0.0), axis=1)
    difference = np.abs(counted - expected)
    if not np.any(moving):
        return np.ones(len(difference), dtype=bool)
    usual = mad_sigma(difference[moving])
    return np.all(difference <= np.maximum(_FAR * usual, _FAR_COUNTS), axis=1)


def _improved(rows: _Rows, counts: Travel, state: _State, prior: float) -> tuple[_State, Array, Array]:
    """One step: the state after it, the step (8,) and the covariance (8, 8)."""
    m, origin = len(rows.begin), state.origin
    e = _counted(counts, state, rows.begin, rows.end) - rows.rotation @ state.matrix.T
    J = np.zeros((2, m, 8))
    for axis in range(2):
        at_end, at_begin = rows.rate_end @ state.matrix[axis], rows.rate_begin @ state.matrix[axis]
        J[axis, :, 3 * axis : 3 * axis + 3] = rows.rotation
        J[axis, :, 6] = at_begin - at_end  # a later log has counted what was moved earlier
        J[axis, :, 7] = at_begin * (rows.begin - origin) - at_end * (rows.end - origin)
        e[:, axis], J[axis] = _white(rows, e[:, axis], J[axis])
    information = np.diag(np.concatenate([np.full(6, prior**-2.0), [1e-6, _DRIFT_SIGMA**-2.0]]))
    H = information + np.einsum("amp,amq->pq", J, J)
    g = np.einsum("amp,ma->p", J, e)
    g[7] -= state.drift / _DRIFT_SIGMA**2
    D = 1.0 / np.sqrt(np.diag(H))
    inverse = D[:, None] * np.linalg.inv(D[:, None] * H * D) * D
    step = inverse @ g
    covariance = _scatter(J, e - np.einsum("amp,p->ma", J, step), information, inverse)
    moved = _State(state.matrix + step[:6].reshape(2, 3), state.lag + step[6], state.drift + step[7], origin)
    return moved, step, covariance


def _scatter(J: Array, e: Array, prior: Array, inverse: Array) -> Array:
    """Covariance (8, 8) from how the residuals e (m, 2) scatter: each block as it would be had it been left out.

    J (2, m, 8) and e are white where the noise model holds; `prior` is the information that is no observation's, and
    `inverse` that of all information. The jackknife of blocks, which is on the safe side (Cameron, Gelbach and Miller
    2008, CR3).
    """
    m = len(e)
    blocks = -(-m // _BLOCK)
    Jb, eb = np.zeros((blocks * _BLOCK, 2, 8)), np.zeros((blocks * _BLOCK, 2))
    Jb[:m], eb[:m] = J.transpose(1, 0, 2), e
    Jb, eb = Jb.reshape(blocks, 2 * _BLOCK, 8), eb.reshape(blocks, 2 * _BLOCK, 1)
    leverage = Jb @ inverse @ Jb.transpose(0, 2, 1)
    score = (Jb.transpose(0, 2, 1) @ np.linalg.solve((1.0 + 1e-9) * np.eye(2 * _BLOCK) - leverage, eb))[..., 0]
    covariance = inverse @ (score.T @ score + prior) @ inverse
    return 0.5 * (covariance + covariance.T)


def _white(rows: _Rows, e: Array, J: Array) -> tuple[Array, Array]:
    """Differences (m,) of one axis and their Jacobian (m, 8) with their noise made white, of variance 1.

    Of the noise V = s² (T + q D): T of places, 2 on its diagonal and -1 beside it where an interval follows another,
    D of what is lost, by the intervals' lengths. The largest q that is about as likely as the likeliest is taken: the
    differences say little of slow drifts, and who believes that there are none believes too much.
    """
    D = (rows.end - rows.begin) / INTERVAL
    tried = []
    for share in _SHARES:
        V = np.stack([2.0 + share * D, np.append(np.where(rows.follows[1:], -1.0, 0.0), 0.0)])
        L = cholesky_banded(V, lower=True)
        white = solve_banded((1, 0), L, e)
        s2 = max(float(white @ white) / len(e), 1e-12)
        tried.append((-0.5 * len(e) * np.log(s2) - np.sum(np.log(L[0])), s2, L))
    best = max(likelihood for likelihood, _, _ in tried)
    _, s2, L = [t for t in tried if t[0] > best - _AS_GOOD][-1]
    return solve_banded((1, 0), L, e) / np.sqrt(s2), solve_banded((1, 0), L, J) / np.sqrt(s2)


# ---- what comes of it ----


def _described(ball: Turning, counts: Travel, found: _Found, peak: Peak) -> Match:
    state = found.state
    covered = counts.covers(state.log_time(ball.begin), state.log_time(ball.end))
    ball = Turning(ball.begin[covered], ball.end[covered], ball.rotation[covered])
    dt = (ball.end - ball.begin)[:, None]
    counted = _counted(counts, state, ball.begin, ball.end) / dt
    expected = ball.rotation @ state.matrix.T / dt
    every = _intervals(ball)
    every = every.kept(counts.covers(state.log_time(every.begin), state.log_time(every.end)))
    rates = every.rotation / (every.end - every.begin)[:, None]
    moved = rates.T @ rates / len(rates)
    along = _counted(counts, state, every.begin, every.end), every.rotation @ state.matrix.T
    return Match(
        lag=state.lag,
        drift=state.drift,
        matrix=state.matrix,
        covariance=found.covariance,
        r=(pearson(counted[:, 0], expected[:, 0]), pearson(counted[:, 1], expected[:, 1])),
        r_interval=_alike(*along),
        rmse=np.sqrt(np.mean((counted - expected) ** 2, axis=0)),
        sums=np.sum(np.abs(counted * dt), axis=0),
        rate=np.sqrt(np.diag(moved)),
        apart=1.0 / np.sqrt(np.diag(np.linalg.inv(moved + 1e-12 * np.eye(3)))),
        seconds=float(dt.sum()),
        middle=state.origin,
        cut=found.cut,
        intervals=found.intervals,
        peak=peak,
    )


def _alike(a: Array, b: Array) -> float:
    """Pearson's r of x and y as one series, each in units of its own size; 0 where nothing moved."""
    size = np.maximum(np.sqrt(np.sum(a**2, axis=0)), 1e-12)
    return pearson((a / size).ravel(), (b / size).ravel()) or 0.0


def reproduced(ball: Turning, log: MouseLog, found: Match, matrix: Array) -> tuple[float, Array]:
    """Fit of another matrix (2, 3) counts/rad to the counts: `r_interval`, and RMSE (2,) counts/s of 0.1 s."""
    counts = travel(log)
    state = _State(matrix, found.lag, found.drift, found.middle)
    every = _intervals(ball)
    every = every.kept(counts.covers(state.log_time(every.begin), state.log_time(every.end)))
    counted, expected = _counted(counts, state, every.begin, every.end), every.rotation @ matrix.T
    difference = (counted - expected) / (every.end - every.begin)[:, None]
    return _alike(counted, expected), np.sqrt(np.mean(difference**2, axis=0))
