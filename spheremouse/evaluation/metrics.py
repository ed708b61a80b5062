"""Compute the metrics of `evaluate --json` from a run and the truth of its recording (docs/datasets).

Errors are over the tracked frames, in the axes of `obj`; the report has the number of these frames. A value that
tracker or recording cannot give is None, never 0 and never nan. Definitions: Wittich 2017, section 4.1.2, with rotation
vectors in place of differences of Euler angles.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import Truth
from spheremouse.evaluation.bound import Bound, measured, posterior_bound, semi_minor_axes
from spheremouse.evaluation.detection import detection_quality, mean_discs
from spheremouse.evaluation.run import Reference, Run, number
from spheremouse.evaluation.scale import scale_and_drift
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, log
from spheremouse.tracker import Status

_RANK_TOLERANCE = 1e-9  # eigenvalues below this part of the largest are none


def report(
    run: Run, reference: Reference, rig: Rig, *, dataset: str, tracker: str, frames: int, found: Pose | None
) -> dict[str, Any]:
    """Return all metrics of one run as `evaluate --json` writes them.

    `dataset` and `tracker` are names for the report, and `frames` is the length of the recording. `found` is the
    camera's pose if it was estimated from the images; None if it was given.
    """
    kept = run.tracked
    motion = reference.motion
    attitude = rate = speed = true_speed = slip = None
    if motion is not None and len(kept):
        true = motion.attitude[run.frame[kept]], motion.rate[run.frame[kept]]
        attitude = attitude_error(run.attitude[kept], true[0])
        rate = run.rate[kept] - true[1]
        speed, true_speed = surface_speeds(run, motion, rig.ball.radius)
        slip = speed - true_speed
    discs, pose = reference.discs, reference.pose
    axes = None if discs is None or pose is None else semi_minor_axes(discs.centre, rig, pose)
    detection = None if discs is None else detection_quality(run, discs, axes)
    bound = run_bound(run, reference, rig)
    attitude_rmse = per_axis(None if attitude is None else np.rad2deg(attitude), "xyz")
    rate_rmse = per_axis(None if rate is None else np.rad2deg(rate), "xyz")
    P = run.covariance[kept]
    return {
        "dataset": dataset,
        "tracker": tracker,
        "frames": frames,
        "tracked": len(kept),
        "lost_episodes": lost_episodes(run.status),
        "attitude_rmse_deg": attitude_rmse,
        "rate_rmse_deg_s": rate_rmse,
        "surface_speed_rmse_mm_s": per_axis(slip, "xy"),
        "surface_speed_r": correlation(speed, true_speed),
        **path_statistics(run, motion),
        "mean_discs": mean_discs(run),
        "identified_from_frame": identified_from(run),
        "detection": detection,
        "pose_error": None if found is None or reference.pose is None else pose_error(found, reference.pose),
        "nees": {
            # the first tracked frame is the reference: there the error is zero by definition
            "attitude": None if attitude is None else mean_nees(attitude[1:], P[1:, :3, :3]),
            "rate": None if rate is None else mean_nees(rate, P[:, 3:, 3:]),
        },
        "nis": mean_nis(run),
        "rate_roughness_deg_s": rate_roughness(run),
        "bound_ratio": bound_ratio(attitude, rate, bound),
        "frame_us": frame_times(run.seconds),
        "stages_us": {stage: number(1e6 * np.median(s)) if len(s) else None for stage, s in run.seconds.items()},
    }


# ---- errors of the motion ----


def attitude_error(estimate: Array, truth: Array) -> Array:
    """Return the error rotation vectors in `obj`, (n, 3) rad, relative to the first frame; both (n, 3, 3) R_obj_ball.

    The frames `ball` of estimate and truth differ by a constant rotation M, R_est = R_true M, which is no error. The
    first frame gives it, M = R_true0^T R_est0, so the error is log(R_est R_est0^T R_true0 R_true^T).
    """
    M = truth[0].T @ estimate[0]
    return log(estimate @ (truth @ M).transpose(0, 2, 1))


def _steps(run: Run, truth: Truth) -> tuple[Array, Array, Array]:
    """Return time (k,) s, sent and true rotation (k, 3) rad in `obj`, of each of the `steps` of a run."""
    k, R = run.steps, truth.attitude
    true = log(R[run.frame[k]] @ R[run.frame[k - 1]].transpose(0, 2, 1))
    return run.stamp[k] - run.stamp[k - 1], run.rotation[k], true


def surface_speeds(run: Run, truth: Truth, radius: float) -> tuple[Array, Array]:
    """Return the speed as sent and the true one, (k, 2) mm/s each, by `Run.steps`; `radius` m (Wittich 2017, 4.1.1).

    A second picture of the same time, by another camera, shows no speed.
    """
    dt, sent, true = (each[run.stamp[run.steps] > run.stamp[run.steps - 1]] for each in _steps(run, truth))
    return surface_travel(sent, radius) / dt[:, None], surface_travel(true, radius) / dt[:, None]


def path_statistics(run: Run, truth: Truth | None) -> dict[str, dict[str, float | None]]:
    """Return scale and drift (°/min) of the sent rotation about the axes of `obj`, with half widths of 95 % intervals.

    See `scale`. All are None without truth, or if the ball was tracked for less than ten seconds.
    """
    found = None if truth is None else scale_and_drift(*_steps(run, truth))
    values = [np.full(3, np.nan)] * 4
    if found is not None:
        per_minute = 60.0 * np.rad2deg([found.drift, found.drift_width])
        values = [found.scale, found.scale_width, *per_minute]
    names = ("rotation_scale", "rotation_scale_ci95", "drift_deg_min", "drift_deg_min_ci95")
    return {name: dict(zip("xyz", _numbers(v), strict=True)) for name, v in zip(names, values, strict=True)}


def surface_travel(rotation: Array, radius: float) -> Array:
    """Return the travel (d_x, -d_z) of the lowest point in mm, (n, 2), for rotation vectors, (n, 3) rad in obj.

    `radius` is R in m. The point C = (0, -R, 0) travels d = rho x C = (R rho_z, 0, -R rho_x), along the arc (Wittich
    2017, eq. 172-174).
    """
    return 1000.0 * radius * rotation[:, [2, 0]]


def per_axis(error: Array | None, axes: str) -> dict[str, float | None]:
    """Return the RMS of errors, (n, len(axes)), for each letter of `axes`, and combined: sqrt(mean(x² + y² + z²)).

    All are None without errors. Wittich 2017, eq. 176-177.
    """
    if error is None or len(error) == 0:
        return dict.fromkeys([*axes, "combined"])
    square = np.mean(error**2, axis=0)
    named = {axis: number(np.sqrt(s)) for axis, s in zip(axes, square, strict=True)}
    return {**named, "combined": number(np.sqrt(square.sum()))}


def correlation(estimate: Array | None, truth: Array | None) -> dict[str, float | None]:
    """Return Pearson's r of (n, 2) speeds for x, y, and combined: x and y as one series of 2n values.

    All are None without speeds. The thesis gives one figure for both axes and no definition of it (section 4.1).
    """
    if estimate is None or truth is None:
        return {"x": None, "y": None, "combined": None}
    return {
        "x": pearson(estimate[:, 0], truth[:, 0]),
        "y": pearson(estimate[:, 1], truth[:, 1]),
        "combined": pearson(estimate.ravel(), truth.ravel()),
    }


def pearson(a: Array, b: Array) -> float | None:
    """Return the correlation coefficient of two series (n,); None if one of them does not vary."""
    a, b = a - np.mean(a), b - np.mean(b)
    norm = np.sqrt((a @ a) * (b @ b))
    return number(a @ b / norm) if norm > 0.0 else None


def nees(error: Array, covariance: Array) -> Array:
    """Return e^T P^-1 e, (n,), of finite errors e (n, k) with covariances P (n, k, k).

    Singular covariances (Euler angles at phi = +-90 deg) have the pseudoinverse.
    """
    inverse = np.linalg.pinv(covariance, rcond=_RANK_TOLERANCE, hermitian=True)
    return np.einsum("ni,nij,nj->n", error, inverse, error)


def mean_nees(error: Array, covariance: Array) -> float | None:
    """Return the mean `nees`, k if the covariances are right; None without errors, or if a value is not finite."""
    if len(error) == 0 or not (np.all(np.isfinite(error)) and np.all(np.isfinite(covariance))):
        return None
    return number(np.mean(nees(error, covariance)))


def mean_nis(run: Run) -> float | None:
    """Return the mean normalised innovation squared per degree of freedom; 1 if the filter's noise is right.

    It needs no truth. It is over the tracked frames with an innovation, and each disc used has two degrees of freedom.
    None if the filter reports none.
    """
    if run.nis is None:
        return None
    k = run.tracked
    k = k[run.nis[k] > 0.0]
    freedom = 2 * sum(len(run.used[i]) for i in k)
    return number(np.sum(run.nis[k]) / freedom) if freedom else None


def squared_bend(run: Run) -> Array:
    """Return the squared second difference of the rate, (n,) rad²/s², of each frame and the two before; first 0, 0."""
    bend = np.zeros(len(run.rate))
    bend[2:] = np.sum(np.diff(run.rate, 2, axis=0) ** 2, axis=1)
    return bend


def rate_roughness(run: Run) -> float | None:
    """Return the RMS second difference of the rate, °/s, over three tracked frames in a row; None without such frames.

    It needs no truth. It is the noise of the rate, if the ball turns smoothly.
    """
    steps = run.steps
    last = steps[np.isin(steps - 1, steps)]
    return number(np.rad2deg(np.sqrt(np.mean(squared_bend(run)[last])))) if len(last) else None


def lost_episodes(status: Sequence[Status]) -> int:
    """Return the number of changes from another status to LOST."""
    return sum(
        now is Status.LOST and before is not Status.LOST for before, now in zip([None, *status], status, strict=False)
    )


def identified_from(run: Run) -> int | None:
    """Return the index into the recording of the first frame with its attitude in a saved map's frame; None if none."""
    absolute = np.flatnonzero(run.absolute)
    return int(run.frame[absolute[0]]) if len(absolute) else None


# ---- detection, pose, time ----


def pose_error(found: Pose, true: Pose) -> dict[str, list[float | None]]:
    """Return the error of the camera's pose, `found` less `true`, in the axes of `obj`, and its standard deviations.

    Position in mm, rotation vector of R_est R_true^T in degrees, as in the error model of `camera.Pose`. None replaces
    a number that is not finite.
    """
    sigma = np.sqrt(np.diag(found.covariance))
    return {
        "position_mm": _numbers(1e3 * (found.position - true.position)),
        "angle_deg": _numbers(np.rad2deg(log(found.rotation @ true.rotation.T))),
        "sigma_position_mm": _numbers(1e3 * sigma[:3]),
        "sigma_angle_deg": _numbers(np.rad2deg(sigma[3:])),
    }


def frame_times(seconds: dict[str, Array]) -> dict[str, float | None]:
    """Return median, p99 and maximum of the µs per frame, by `seconds`, (n,) s, of each stage; None without frames."""
    total = 1e6 * np.sum(list(seconds.values()), axis=0) if seconds else np.zeros(0)
    if len(total) == 0:
        return {"median": None, "p99": None, "max": None}
    return {"median": number(np.median(total)), "p99": number(np.percentile(total, 99)), "max": number(total.max())}


# ---- against the bound ----


def bound_ratio(attitude: Array | None, rate: Array | None, bound: Bound | None) -> dict[str, float | None]:
    """Return the RMS errors of attitude and rate over the posterior Cramer-Rao bound; 1 is the best possible.

    `attitude` (n, 3) rad and `rate` (n, 3) rad/s are the errors in the n tracked frames. The axes are combined. The
    first frame is left out, since its attitude defines the reference and its rate is unknown. None if errors or bound
    are missing.
    """
    if attitude is None or rate is None or bound is None:
        return {"attitude": None, "rate": None}
    return {"attitude": _over_bound(attitude[1:], bound.attitude[1:]), "rate": _over_bound(rate[1:], bound.rate[1:])}


def _over_bound(error: Array, covariance: Array) -> float | None:
    limit = np.trace(covariance, axis1=1, axis2=2)
    if len(error) == 0 or not np.mean(limit) > 0.0:
        return None
    return number(np.sqrt(np.mean(np.sum(error**2, axis=1)) / np.mean(limit)))


def run_bound(run: Run, reference: Reference, rig: Rig) -> Bound | None:
    """Return the bound at the tracked frames, for the discs that this run detected, with the errors of its centres.

    None if the recording lacks truth for it, with fewer than three tracked frames, or if the run used a saved map. Such
    a map has more information than the frames.
    """
    motion, discs, pose, directions = reference.motion, reference.discs, reference.pose, reference.directions
    kept = run.tracked
    if motion is None or discs is None or pose is None or directions is None:
        return None
    if len(kept) < 3 or run.absolute.any() or np.any(discs.disc >= len(directions)):
        return None
    span = slice(int(kept[0]), int(kept[-1]) + 1)
    frames = run.frame[span]
    sights = measured(frames.tolist(), run.detected[span], discs)
    at = Truth(motion.stamp[frames], motion.attitude[frames], motion.rate[frames])
    return posterior_bound(at, sights, directions, rig, pose).take(kept - kept[0])


def _numbers(x: Array) -> list[float | None]:
    return [number(v) for v in x]
