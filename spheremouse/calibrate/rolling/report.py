"""What a rolled calibration found, in figures and in words."""

from typing import Any

import numpy as np

from spheremouse.ball.rig import Rig
from spheremouse.calibrate.rolling.advice import sigmas
from spheremouse.calibrate.rolling.axes import Axes
from spheremouse.calibrate.rolling.calibrate import Solution

_SOURCES = {
    "targets": "targets whose positions are known",
    "device": "the sizes of the targets",
    "gestures": "the ball rolled forward and right",
}


def figures(solution: Solution, axes: Axes, source: str, rig: Rig) -> dict[str, Any]:
    """As `--json` writes them; lengths in m, or in radii of the ball where the scale is free."""
    rolled = solution.rolled
    ratio_sigma, direction_sigma = sigmas(rolled)
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
        "ball": {"radius": rig.ball.radius, "sigma": float(np.sqrt(rig.ball.covariance[3, 3]))},
        "disc_radius": rig.disc_radius,
        "discs": [d.tolist() for d in rig.disc_directions] if rig.disc_directions is not None else [],
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
        "axes_sigma_deg": np.rad2deg(np.sqrt(np.diag(axes.covariance))).tolist(),
    }


def text(solution: Solution, axes: Axes, source: str, rig: Rig) -> str:
    """For a reader, after each figure its standard deviation."""
    rolled, f = solution.rolled, figures(solution, axes, source, rig)
    unit, scale = ("R", 1.0) if rig.scale_free else ("m", 1.0)
    assert rig.pose is not None
    position = " ".join(f"{v:.4f}" for v in rig.pose.position)
    spread = " ".join(f"{v:.4f}" for v in f["sigma_position"])
    turn = " ".join(f"{v:.3f}" for v in f["axes_sigma_deg"])
    lines = [
        f"{f['frames']} of {f['frames_given']} frames, {len(rolled.rolling.discs)} discs, {f['sightings']} sightings "
        f"({f['rejected']} set aside); residuals {f['rms_px']:.3f} px",
        f"distance over radius  {f['ratio']:.5f} ± {f['ratio_sigma']:.5f}  "
        f"({100.0 * f['ratio_sigma'] / f['ratio']:.4f} %)",
        f"direction to centre   ± {f['center_direction_sigma_deg']:.4f}°",
        f"axes from {_SOURCES[source]}, ± {turn}° about X Y Z",
        f"camera position       {position} ± {spread} {unit}",
    ]
    if rig.scale_free:
        lines.append("scale free: lengths count in radii of the ball (R), mouse counts per radian; --radius makes it m")
    else:
        lines.append(f"ball radius           {rig.ball.radius * scale:.4f} ± {f['ball']['sigma']:.4f} m")
    if rolled.readout_sigma > 0.0 and rolled.readout_sigma < 1e-3 and rolled.rolling.readout > 2e-3:
        lines.append(f"rolling shutter       {1e3 * f['readout_s']:.1f} ± {1e3 * f['readout_sigma_s']:.1f} ms")
    return "\n".join(lines)
