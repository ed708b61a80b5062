"""Report of `calibrate rolling`: figures as JSON, lines for the terminal, advice."""

from typing import Any

import numpy as np

from spheremouse.ball.rig import Rig
from spheremouse.calibrate.rolling.calibrate import Solution
from spheremouse.calibrate.rolling.problem import Rolling, RollingAdjustment
from spheremouse.files.figures import figure_rows
from spheremouse.geometry.rotation import Array, fibonacci_sphere, log

GOOD_RATIO, GOOD_DIRECTION = 1e-3, float(np.deg2rad(0.02))  # standard deviations; larger ones spoil tracking

_MIN_AXIS_SHARE = 0.05  # of the rotation about each further axis; less is a rotation about one axis only
_MAX_UNSEEN = 0.1  # of the ball's surface
_MAX_STEP = 0.5  # rad between frames; more is a gap
_VISIBLE_OF_LIMB_ANGLE = 0.85  # of the angle to the limb


def rolling_json(solution: Solution, source: str, rig: Rig) -> dict[str, Any]:
    """Return the figures of `--json`; lengths in m, or in radii of the ball if the scale is free."""
    rolled = solution.rolled
    ratio_sigma, direction_sigma = sigmas(rolled)
    radius = rig.ball.radius
    assert rig.pose is not None
    sigma = np.sqrt(np.diag(rig.pose.covariance))
    return {
        "ratio": rolled.rolling.ratio,
        "ratio_sigma": ratio_sigma * rolled.rolling.ratio,
        "center_direction": rolled.rolling.direction.tolist(),
        "center_direction_sigma_deg": float(np.rad2deg(direction_sigma)),
        "T_obj_cam": rig.pose.matrix().tolist(),
        "sigma_position": sigma[:3].tolist(),
        "sigma_angle_deg": np.rad2deg(sigma[3:]).tolist(),
        "scale": "free" if rig.scale_free else "metric",
        "ball": {"radius": radius, "sigma": float(np.sqrt(rig.ball.covariance[3, 3]))},
        "disc_radius": rig.disc_radius,
        "discs": [d.tolist() for d in rig.disc_directions] if rig.disc_directions is not None else [],
        "eccentricity": radius * float(np.linalg.norm(rolled.rolling.eccentricity)),
        "eccentricity_sigma": radius * float(np.trace(rolled.eccentricity_covariance)) ** 0.5,
        "eccentric": rolled.is_eccentric,
        "readout_s": rolled.rolling.readout,
        "readout_sigma_s": rolled.readout_sigma,
        "frames": len(rolled.rolling.stamp),
        "frames_given": solution.tracked.frames,
        "sightings": len(rolled.sightings),
        "rejected": rolled.rejected,
        "rms_px": rolled.rms,
        "variance_factor": rolled.variance_factor,
        "correlation_factor": rolled.correlation,
        "axes": source,
        "axes_sigma_deg": np.rad2deg(sigma[3:]).tolist(),
    }


def rolling_text(figures: dict[str, Any]) -> str:
    """Return the figures of `rolling_json` that matter, each with its standard deviation."""
    lines = [
        f"{name:<24}{' ± '.join(filter(None, (value, sigma))) if value else f'± {sigma}'}"
        for name, value, sigma in figure_rows(figures)
    ]
    if figures["scale"] == "free":
        lines.append("scale free: lengths count in radii of the ball (R), mouse counts per radian; --radius makes it m")
    return "\n".join(lines)


def advise(rolled: RollingAdjustment) -> list[str]:
    """Return sentences, the most useful first; none for a good calibration."""
    found: list[str] = []
    ratio, direction = sigmas(rolled)
    worst = max(ratio / GOOD_RATIO, direction / GOOD_DIRECTION)
    if axis_shares(rolled.rolling)[1] < _MIN_AXIS_SHARE:
        found.append("the ball was rolled about one axis only: roll it across that, too")
    if worst > 1.0:
        span = float(rolled.rolling.stamp[-1] - rolled.rolling.stamp[0])
        per_frame = len(rolled.sightings) / len(rolled.rolling.stamp)
        if per_frame < 4.0:
            found.append(f"only {per_frame:.1f} discs are measured at a time: more discs on the ball would help most")
        found.append(
            f"the result is {worst:.1f} times less certain than good tracking needs: "
            f"roll for {span * worst**2:.0f} s in place of {span:.0f}"
        )
    missed = unseen_share(rolled.rolling)
    if missed > _MAX_UNSEEN:
        found.append(
            f"{100.0 * missed:.0f} % of the ball never faced the camera: roll on until every side was in view, "
            "and the map of its discs is whole"
        )
    return found


def sigmas(rolled: RollingAdjustment) -> tuple[float, float]:
    """Return the standard deviations of the ratio, relative to it, and of the direction, rad along its worse axis."""
    worst = float(np.linalg.eigvalsh(rolled.covariance[:3, :3])[-1])
    return float(np.sqrt(rolled.covariance[3, 3])) / rolled.rolling.ratio, float(np.sqrt(max(worst, 0.0)))


def axis_shares(rolling: Rolling) -> Array:
    """Return the shares of the rotation about three perpendicular axes, (3,), largest first."""
    step = log(rolling.attitude[1:] @ rolling.attitude[:-1].transpose(0, 2, 1))
    near = np.linalg.norm(step, axis=1) < _MAX_STEP
    value = np.asarray(np.linalg.eigvalsh(step[near].T @ step[near])[::-1], dtype=float)
    return value / max(float(value.sum()), 1e-12)


def unseen_share(rolling: Rolling) -> float:
    """Return the share of the ball's surface that never faced the camera."""
    towards = np.einsum("fji,j->fi", rolling.attitude, -rolling.direction)
    limit = np.cos(_VISIBLE_OF_LIMB_ANGLE * np.arccos(1.0 / rolling.ratio))
    return float(np.mean(np.max(towards @ fibonacci_sphere(400).T, axis=0) < limit))
