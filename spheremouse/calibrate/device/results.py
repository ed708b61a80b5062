"""Results of a device calibration as plain numbers, for files and tables."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.advice import advise, distance_redundancy
from spheremouse.calibrate.device.plans import Advice
from spheremouse.geometry.rotation import Array


def device_json(
    calibration: DeviceCalibration, names: Sequence[str], advice: Sequence[Advice] | None = None
) -> dict[str, Any]:
    """As `--json` writes it; lengths in m, or in radii of the ball where the scale is free.

    `names` of all photos; `advice` is what `advise` says, worked out here where it is not given.
    """
    c = calibration
    ball = np.sqrt(np.diag(c.ball_covariance))
    return {
        "targets": [
            {"id": id_, "code": code, "position": place.tolist(), "sigma": sigma.tolist()}
            for id_, code, place, sigma in zip(
                c.device.ids, c.device.codes, c.targets, sigma_of(c, "targets"), strict=True
            )
        ],
        "ball": {
            "center": c.centre.tolist(),
            "radius": c.radius,
            "sigma": dict(zip("XYZR", ball.tolist(), strict=True)),
            "correlation": correlation(c.ball_covariance).tolist(),
        },
        "discs": [
            {"position": place.tolist(), "sigma": sigma.tolist(), "photos": int(seen)}
            for place, sigma, seen in zip(c.discs, sigma_of(c, "discs"), c.sightings, strict=True)
        ],
        "photos": _photos_json(c, names),
        "rms_px": c.rms_px,
        "variance_factors": dict(zip(("targets", "discs"), c.variance_factors, strict=True)),
        "distances": _distances_json(c),
        "scale_free": c.scale_free,
        "ring_scale": c.ring_scale,
        "out_of_round": c.out_of_round,
        "skipped": [{"file": names[k], "why": why} for k, why in c.skipped],
        "doubtful": [{"file": names[k], "why": why} for k, why in c.doubtful],
        "advice": [
            {"kind": a.kind, "text": a.text, "gain": a.gain, "improves": a.improves}
            for a in advice_or_made(c, names, advice)
        ],
    }


def _photos_json(c: DeviceCalibration, names: Sequence[str]) -> list[dict[str, Any]]:
    return [
        {
            "file": names[k],
            "T_obj_cam": pose.matrix().tolist(),
            "sigma": np.sqrt(np.diag(pose.covariance)).tolist(),
            "points": used,
            "rejected": rejected,
            "rms_px": rms,
        }
        for k, pose, (used, rejected, rms) in zip(c.photos, c.poses, per_photo(c), strict=True)
    ]


def _distances_json(c: DeviceCalibration) -> list[dict[str, Any]]:
    return [
        {
            "from": d.start,
            "to": d.end,
            "metres": d.metres,
            "adjusted": float(length),
            "residual": float(residual),
            "sigma": d.sigma,
            "adjusted_sigma": float(sigma),
        }
        for d, length, residual, sigma in zip(c.device.distances, *_adjusted_distances(c), strict=True)
    ]


def advice_or_made(c: DeviceCalibration, names: Sequence[str], given: Sequence[Advice] | None) -> Sequence[Advice]:
    return advise(c, names) if given is None else given


def unit_of(c: DeviceCalibration) -> tuple[str, float, int]:
    """Unit that lengths are shown in, factor to it, and decimals."""
    return ("R/1000", 1e3, 3) if c.scale_free else ("mm", 1e3, 2)


def sigma_of(c: DeviceCalibration, name: str) -> Array:
    """Standard deviations of the coordinates of `targets` or `discs`, (n, 3)."""
    here = c.block(name)
    return np.sqrt(np.diag(c.covariance)[here]).reshape(-1, 3)


def rms_of(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def correlation(covariance: Array) -> Array:
    """0 beside what is known exactly."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    r = covariance / np.outer(scale, scale)
    np.fill_diagonal(r, 1.0)
    return r


def px(rms: float | None) -> str:
    return "-" if rms is None else f"{rms:.3f}"


def points(c: DeviceCalibration) -> str:
    used = c.measured.used
    left = int(np.count_nonzero(~used))
    return f"{int(np.count_nonzero(used))} used" + (f", {left} not" if left else "")


def per_photo(c: DeviceCalibration) -> list[tuple[int, int, float | None]]:
    """Of each photo used: image points used and not, and px RMS per axis of the used ones, None where none is."""
    m, found = c.measured, []
    for i in range(len(c.poses)):
        mine = m.photo == i
        used = mine & m.used
        rms = rms_of(m.residual[used]) if np.any(used) else None
        found.append((int(np.count_nonzero(used)), int(np.count_nonzero(mine & ~m.used)), rms))
    return found


def _adjusted_distances(c: DeviceCalibration) -> tuple[Array, Array, Array]:
    """Of the tape distances: adjusted, residual, standard deviation adjusted, (k,) m."""
    row = c.device.row
    block = c.block("targets")
    C = c.covariance[block, block]
    length, sigma = [], []
    for d in c.device.distances:
        a, b = row[d.start], row[d.end]
        way = c.targets[b] - c.targets[a]
        J = np.zeros(len(C))
        J[3 * b : 3 * b + 3] = way / np.linalg.norm(way)
        J[3 * a : 3 * a + 3] = -J[3 * b : 3 * b + 3]
        length.append(float(np.linalg.norm(way)))
        sigma.append(float(np.sqrt(J @ C @ J)))
    return np.array(length), c.distance_residuals, np.array(sigma)


def distance_rows(c: DeviceCalibration) -> list[list[str]]:
    number = distance_redundancy(c)
    return [
        [
            f"{d.start} - {d.end}",
            f"{1e3 * d.metres:.1f}",
            f"{1e3 * d.sigma:g}",
            f"{1e3 * length:.2f}",
            f"{1e3 * sigma:.2f}",
            f"{1e3 * residual:+.2f}",
            f"{residual / d.sigma / np.sqrt(r):+.1f}" if r > 1e-3 else "-",
            f"{100.0 * r:.0f} %",
        ]
        for d, length, residual, sigma, r in zip(c.device.distances, *_adjusted_distances(c), number, strict=True)
    ]
