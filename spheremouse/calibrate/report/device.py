"""Report of `calibrate device`: JSON, a summary on the terminal, and the HTML page.

Lengths are in mm, or in thousandths of the ball's radius if the scale is free.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.padding import Padding
from rich.table import Table

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.advice import Advice
from spheremouse.calibrate.outputs import print_advice
from spheremouse.calibrate.photos import Photo, image
from spheremouse.calibrate.report.page import Content, write_report
from spheremouse.files.report.style import BLUE, GOLD, INK, MUTED, round_number
from spheremouse.geometry.camera import sphere_outline
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import correlation

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

_PHOTO_WIDTH = 900  # px, of a photo in the page
_ARROW_LENGTH = 0.035  # of the picture's width, of a large residual
_TARGET, _DISC, _FALSE, _LINE = (96, 170, 70), (214, 140, 40), (60, 60, 220), (235, 235, 235)  # BGR

# ---- figures as JSON ----


def device_json(c: DeviceCalibration, names: Sequence[str], advice: Sequence[Advice]) -> dict[str, Any]:
    """Return the figures of `--json`, in m, or in radii of the ball if the scale is free; `names` of all photos."""
    d = c.device
    targets = zip(d.ids, d.codes, c.targets.tolist(), _sigma(c, "targets").tolist(), strict=True)
    discs = zip(c.discs.tolist(), _sigma(c, "discs").tolist(), c.sightings.tolist(), strict=True)
    return {
        "targets": [{"id": i, "code": code, "position": place, "sigma": s} for i, code, place, s in targets],
        "ball": {
            "center": c.centre.tolist(),
            "radius": c.radius,
            "sigma": dict(zip("XYZR", np.sqrt(np.diag(c.ball_covariance)).tolist(), strict=True)),
            "correlation": correlation(c.ball_covariance).tolist(),
        },
        "discs": [{"position": place, "sigma": s, "photos": seen} for place, s, seen in discs],
        "photos": [
            {
                "file": names[k],
                "T_obj_cam": pose.matrix().tolist(),
                "sigma": np.sqrt(np.diag(pose.covariance)).tolist(),
                "points": used,
                "rejected": rejected,
                "rms_px": rms,
            }
            for k, pose, (used, rejected, rms) in zip(c.photos, c.poses, _points_of_photos(c), strict=True)
        ],
        "rms_px": c.rms_px,
        "variance_factors": dict(zip(("targets", "discs"), c.variance_factors, strict=True)),
        "distances": _distances(c),
        "scale_free": c.scale_free,
        "ring_scale": c.ring_scale,
        "out_of_round": c.out_of_round,
        "skipped": [{"file": names[k], "why": why} for k, why in c.skipped],
        "doubtful": [{"file": names[k], "why": why} for k, why in c.doubtful],
        "advice": [a._asdict() for a in advice],
    }


def _distances(c: DeviceCalibration) -> list[dict[str, Any]]:
    """Tape distances, adjusted, with residuals and standard deviations, m."""
    block = c.block("targets")
    C, found = c.covariance[block, block], []
    for d, (a, b), residual in zip(c.device.distances, c.device.ends, c.distance_residuals, strict=True):
        way = c.targets[b] - c.targets[a]
        J = np.zeros(len(C))
        J[3 * b : 3 * b + 3] = way / np.linalg.norm(way)
        J[3 * a : 3 * a + 3] = -J[3 * b : 3 * b + 3]
        found.append(
            {
                "from": d.start,
                "to": d.end,
                "metres": d.metres,
                "adjusted": float(np.linalg.norm(way)),
                "residual": float(residual),
                "sigma": d.sigma,
                "adjusted_sigma": float(np.sqrt(J @ C @ J)),
            }
        )
    return found


def _sigma(c: DeviceCalibration, name: str) -> Array:
    """Standard deviations of the coordinates of `targets` or `discs`, (n, 3)."""
    return np.sqrt(np.diag(c.covariance)[c.block(name)]).reshape(-1, 3)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _points_of_photos(c: DeviceCalibration) -> list[tuple[int, int, float | None]]:
    """For each photo: image points used and not, and px RMS per axis of the used ones, None without any."""
    m, found = c.measured, []
    for i in range(len(c.poses)):
        mine = m.photo == i
        used = mine & m.used
        rms = _rms(m.residual[used]) if np.any(used) else None
        found.append((int(np.count_nonzero(used)), int(np.count_nonzero(mine & ~m.used)), rms))
    return found


# ---- the terminal ----


def print_device(c: DeviceCalibration, advice: Sequence[Advice], console: "Console") -> None:
    """Print the figures that matter, and the advice. The page and the JSON have all figures."""
    lines = Table(box=None, show_header=False, pad_edge=False, padding=(0, 3, 0, 0))
    for line in _headlines(c):
        lines.add_row(*line)
    console.print(Padding(lines, (0, 0, 1, 0), expand=False))
    print_advice(console, advice)


# ---- the page ----


def write_device_report(
    path: Path, c: DeviceCalibration, photos: Sequence[Photo], provenance: Mapping[str, Any], advice: Sequence[Advice]
) -> None:
    """Write one HTML file that needs no other; `photos` are all that were given, `provenance` is that of rig files."""
    data = device_json(c, [p.path.name for p in photos], advice)
    content = Content(
        title="Calibration of the device",
        lead=f"{len(c.photos)} of {len(photos)} photos, {len(c.targets)} targets, {len(c.discs)} discs",
        headlines=_headlines(c),
        advice=advice,
        draw=lambda: _places_figure(c),
        caption="Cameras with the number of the photo and their viewing directions, targets with their ids, discs, and "
        "the ball, at one scale. The more the cameras surround the device, the better.",
        values=f"The ball's centre is seen from target {c.device.axes.origin}, along the axes that the targets define; "
        "targets from the ball's centre. `--json` has the discs, the poses and the correlations.",
        legend="Green: targets; blue: discs; red crosses: points that contradict the other photos and were not used. "
        f"Arrows are residuals, {arrow_scale(c, photos[c.photos[0]].size[0]):g} times longer. If arrows point the same "
        "way in one part of the picture, the lens differs from the camera file. The white outline is that of the "
        "adjusted ball: it must fit.",
        pictures=[
            (photo_picture(c, i, image(photos[k])), f"{k + 1}: {p['file']}; {p['points']} points")
            for i, (k, p) in enumerate(zip(c.photos, data["photos"], strict=True))
        ],
    )
    write_report(path, content, data, provenance)


def _headlines(c: DeviceCalibration) -> list[tuple[str, str, str]]:
    """Return the main figures of the report: name, value, remark."""
    unit, digits = ("R/1000", 3) if c.scale_free else ("mm", 2)

    def show(value: float | np.floating) -> str:
        return f"{1e3 * value:.{digits}f}"

    ball = np.sqrt(np.diag(c.ball_covariance))
    often = int(np.count_nonzero(c.sightings >= 3))
    used, false = (int(np.count_nonzero(which)) for which in (c.measured.used, ~c.measured.used))
    if c.scale_free:
        first = ("Scale", "free", "no tape distance: counts per radian")
    else:
        first = ("Ball's radius", f"{show(c.radius)} {unit}", f"± {show(ball[3])} {unit}")
    centre = f"X {show(ball[0])}, Y {show(ball[1])}, Z {show(ball[2])} {unit}"
    targets, discs = (f"± {show(_rms(_sigma(c, name)))} {unit}" for name in ("targets", "discs"))
    return [
        first,
        ("Ball's centre", f"± {show(ball[:3].max())} {unit}", centre),
        ("Targets", str(len(c.targets)), targets),
        ("Discs", str(len(c.discs)), f"{discs}; {often} in 3 photos or more"),
        ("Image points", f"{c.rms_px:.3f} px", f"RMS; {used} used" + (f", {false} not" if false else "")),
    ]


# ---- figures ----


def _places_figure(c: DeviceCalibration) -> "Figure":
    """Cameras, targets, discs and ball from the front and from above, at one scale."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    views = (("from the front", np.array([[1, 0, 0], [0, 1, 0]])), ("from above", np.array([[1, 0, 0], [0, 0, -1]])))
    for axes, (name, P) in zip(figure.subplots(1, 2), views, strict=True):
        axes.set_title(name, loc="center", fontsize=9.0, color=MUTED)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_axis_off()
        angle = np.linspace(0.0, 2.0 * np.pi, 97)
        axes.fill(c.radius * np.cos(angle), c.radius * np.sin(angle), facecolor=MUTED, alpha=0.15)
        axes.plot(*P @ c.discs.T, ".", color=INK, ms=3.0)
        axes.plot(*P @ c.targets.T, "o", color=GOLD, ms=5.0)
        cameras = np.array([pose.position for pose in c.poses])
        towards = np.array([pose.rotation[:, 2] for pose in c.poses])
        axes.quiver(*P @ cameras.T, *P @ towards.T, color=BLUE, width=0.004, scale=12.0)
        named = [(c.targets, c.device.ids), (cameras, [k + 1 for k in c.photos])]
        for places, numbers in named:
            for place, number in zip(places, numbers, strict=True):
                x, y = P @ place
                axes.annotate(str(number), (x, y), (4.0, 4.0), textcoords="offset points", fontsize=7.5)
    return figure


def arrow_scale(c: DeviceCalibration, width: int) -> float:
    """Return the factor on residual arrows in pictures of photos `width` px wide: 1, 2 or 5 times a power of ten."""
    m = c.measured
    large = float(np.percentile(np.linalg.norm(m.residual[m.used], axis=1), 95))
    return round_number(_ARROW_LENGTH * width / max(large, 1e-3))


def photo_picture(c: DeviceCalibration, photo: int, image: NDArray[np.uint8]) -> bytes:
    """Return a JPEG of the k-th photo used, (h, w, 3) BGR, with image points, residual arrows and the ball's outline.

    An arrow points from the measured place of a point to that by the adjusted device.
    """
    m = c.measured
    height, width = image.shape[:2]
    scale = _PHOTO_WIDTH / width
    small = cv2.resize(image, (_PHOTO_WIDTH, round(height * scale)), interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    canvas = np.asarray(cv2.addWeighted(small, 0.55, grey, 0.25, 0.0), np.uint8)
    outline = sphere_outline(c.poses[photo].to_cam(np.zeros(3)), c.radius, c.camera)
    cv2.polylines(canvas, [np.rint(scale * outline).astype(np.int32)], isClosed=True, color=_LINE, lineType=cv2.LINE_AA)
    times = arrow_scale(c, width)
    for i in np.flatnonzero(m.photo == photo):
        at = _pixel(scale * m.centre[i])
        if not m.used[i]:
            cv2.drawMarker(canvas, at, _FALSE, cv2.MARKER_TILTED_CROSS, 16, 2, cv2.LINE_AA)
            continue
        target = m.point[i] < len(c.targets)
        colour, radius = (_TARGET, 13) if target else (_DISC, 9)
        cv2.circle(canvas, at, radius, colour, 2, cv2.LINE_AA)
        tip = _pixel(scale * (m.centre[i] + times * m.residual[i]))
        if np.hypot(tip[0] - at[0], tip[1] - at[1]) > radius // 2:  # a shorter one hides the point
            cv2.arrowedLine(canvas, at, tip, _LINE, 2, cv2.LINE_AA, tipLength=0.25)
        if target:
            name = str(c.device.ids[int(m.point[i])])
            cv2.putText(canvas, name, (at[0] + 17, at[1] - 11), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _LINE, 2, cv2.LINE_AA)
    done, data = cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 82])
    assert done
    return data.tobytes()


def _pixel(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
