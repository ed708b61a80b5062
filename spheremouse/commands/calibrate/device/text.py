"""What `spheremouse calibrate device` prints of a device that it has calibrated."""

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.plans import Advice
from spheremouse.calibrate.device.report import AXES, MARKS
from spheremouse.calibrate.device.results import (
    advice_or_made,
    distance_rows,
    per_photo,
    points,
    px,
    rms_of,
    sigma_of,
    unit_of,
)


def device_text(
    calibration: DeviceCalibration,
    names: Sequence[str],
    advice: Sequence[Advice] | None = None,
    console: Console | None = None,
) -> None:
    """Print the figures that matter, and the advice; `names` of all photos."""
    c = calibration
    console = console or Console(highlight=False)
    unit, f, digits = unit_of(c)
    ball = np.sqrt(np.diag(c.ball_covariance))
    lines = Table(box=None, show_header=False, pad_edge=False, padding=(0, 3, 0, 0))
    if not c.scale_free:
        lines.add_row("radius", f"{f * c.radius:.{digits}f} ± {f * ball[3]:.{digits}f} {unit}")
    where = ", ".join(f"{a} ± {f * s:.{digits}f}" for a, s in zip(AXES, ball, strict=False))
    lines.add_row("ball's centre", f"{where} {unit} against the targets")
    lines.add_row("targets", f"{len(c.targets)}, ± {f * rms_of(sigma_of(c, 'targets')):.{digits}f} {unit}")
    often = int(np.count_nonzero(c.sightings >= 3))
    lines.add_row(
        "discs", f"{len(c.discs)}, ± {f * rms_of(sigma_of(c, 'discs')):.{digits}f} {unit}; {often} in 3 photos +"
    )
    lines.add_row("image points", f"{points(c)}; {c.rms_px:.3f} px RMS")
    console.print(Padding(lines, (0, 0, 1, 0)))
    photos = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for head in ("photo", "points", "not used", "px RMS", f"place ± {unit}", "attitude ± °"):
        photos.add_column(head, justify="left" if head == "photo" else "right")
    for k, pose, (used, rejected, rms) in zip(c.photos, c.poses, per_photo(c), strict=True):
        sigma = np.sqrt(np.diag(pose.covariance))
        photos.add_row(
            Text(names[k]), str(used), str(rejected or "-"), px(rms),
            f"{f * np.linalg.norm(sigma[:3]):.{digits}f}", f"{np.degrees(np.linalg.norm(sigma[3:])):.3f}",
        )  # fmt: skip
    console.print(Padding(photos, (0, 0, 1, 0)))
    if c.device.distances:
        tape = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
        for head in ("distance", "tape mm", "adjusted mm", "residual mm", "over sigma"):
            tape.add_column(head, justify="left" if head == "distance" else "right")
        for row in distance_rows(c):
            tape.add_row(*(row[i] for i in (0, 1, 3, 5, 6)))
        console.print(Padding(tape, (0, 0, 1, 0)))
    for a in advice_or_made(c, names, advice):
        mark, colour = MARKS[a.kind]
        line = Table.grid(padding=(0, 1, 0, 0))
        line.add_row(Text(mark, style=colour), Text(a.text))
        console.print(line)
