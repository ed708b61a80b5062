"""Report of `calibrate device`: JSON, a summary on the terminal, and the HTML page.

The tables are those of Wittich 2017 (9-13) for this device. Lengths are in mm, or in thousandths of the ball's radius
if the scale is free.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.padding import Padding
from rich.table import Table

from spheremouse.calibrate.device.adjust import DeviceCalibration, distance_redundancy
from spheremouse.calibrate.device.advice import Advice
from spheremouse.calibrate.outputs import print_advice
from spheremouse.calibrate.photos import Photo, image
from spheremouse.files.report.page import page, rendered
from spheremouse.files.report.style import BLUE, GOLD, INK, MUTED, round_number, styled
from spheremouse.files.safe_files import write_atomically
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
        "advice": [{"kind": a.kind, "text": a.text} for a in advice],
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
    for line in _headlines(c, _Lengths(c)):
        lines.add_row(*line)
    console.print(Padding(lines, (0, 0, 1, 0), expand=False))
    print_advice(console, [(a.kind, a.text) for a in advice])


class _Lengths:
    """Lengths in the unit of the tables."""

    def __init__(self, c: DeviceCalibration) -> None:
        self.unit, self._digits = ("R/1000", 3) if c.scale_free else ("mm", 2)

    def __call__(self, value: float | np.floating) -> str:
        return f"{1e3 * value:.{self._digits}f}"

    def each(self, values: Array) -> list[str]:
        """Words for each of some lengths."""
        return [self(v) for v in values]


def _px(rms: float | None) -> str:
    return "-" if rms is None else f"{rms:.3f}"


def _points(c: DeviceCalibration) -> str:
    left = int(np.count_nonzero(~c.measured.used))
    return f"{int(np.count_nonzero(c.measured.used))} used" + (f", {left} not" if left else "")


def _distance_rows(c: DeviceCalibration) -> list[list[str]]:
    return [
        [
            f"{d['from']} - {d['to']}",
            f"{1e3 * d['metres']:.1f}",
            f"{1e3 * d['sigma']:g}",
            f"{1e3 * d['adjusted']:.2f}",
            f"{1e3 * d['adjusted_sigma']:.2f}",
            f"{1e3 * d['residual']:+.2f}",
            f"{d['residual'] / d['sigma'] / np.sqrt(r):+.1f}" if r > 1e-3 else "-",
            f"{100.0 * r:.0f} %",
        ]
        for d, r in zip(_distances(c), distance_redundancy(c.problem, c.solution), strict=True)
    ]


# ---- the page: device.html with these values ----


def write_device_report(
    path: Path, c: DeviceCalibration, photos: Sequence[Photo], provenance: Mapping[str, Any], advice: Sequence[Advice]
) -> None:
    """Write one HTML file that needs no other; `photos` are all that were given, `provenance` is that of rig files."""
    show = _Lengths(c)
    with styled():
        body = rendered(
            "spheremouse.calibrate.report",
            "device.html",
            unit=show.unit,
            headlines=_headlines(c, show),
            advice=[(a.kind, a.text) for a in advice],
            places=_places_figure(c),
            origin=c.device.axes.origin,
            scale_free=c.scale_free,
            out_of_round=f"{show(c.out_of_round)} {show.unit}" if c.out_of_round else "",
            ball=_ball_rows(c, show),
            targets=_target_rows(c, show),
            distances=_distance_rows(c),
            photo_head=_photo_head(show),
            photos=(rows := _photo_rows(c, [p.path.name for p in photos], show)),
            pictures=[
                (photo_picture(c, i, image(photos[k])), f"{row[0]}; {row[1]} points, {row[3]} px")
                for i, (k, row) in enumerate(zip(c.photos, rows, strict=True))
            ],
            left_out=[
                [photos[k].path.name, what, why]
                for what, some in (("nothing", c.skipped), ("targets only", c.doubtful))
                for k, why in some
            ],
            arrow_scale=arrow_scale(c, photos[c.photos[0]].size[0]),
            discs=_disc_rows(c, show),
            provenance=[(key.replace("_", " "), value) for key, value in provenance.items() if isinstance(value, str)],
            files=[
                (photo.path.name, "used" if k in c.photos else "left out", "{}x{}".format(*photo.size), photo.sha256)
                for k, photo in enumerate(photos)
            ],
        )
    lead = f"{len(c.photos)} of {len(photos)} photos, {len(c.targets)} targets, {len(c.discs)} discs"
    foot = " · ".join(str(provenance[key]) for key in ("made_by", "date") if key in provenance)
    write_atomically(path, page("Calibration of the device", lead, body, foot))


def _headlines(c: DeviceCalibration, show: _Lengths) -> list[tuple[str, str, str]]:
    ball = np.sqrt(np.diag(c.ball_covariance))
    often = int(np.count_nonzero(c.sightings >= 3))
    centre = f"X {show(ball[0])}, Y {show(ball[1])}, Z {show(ball[2])} {show.unit}"
    if c.scale_free:
        first = ("Scale", "free", "no tape distance: counts per radian")
    else:
        first = ("Ball's radius", f"{show(c.radius)} {show.unit}", f"± {show(ball[3])} {show.unit}")
    return [
        first,
        ("Ball's centre", f"± {show(ball[:3].max())} {show.unit}", centre),
        ("Targets", str(len(c.targets)), f"± {show(_rms(_sigma(c, 'targets')))} {show.unit}"),
        ("Discs", str(len(c.discs)), f"± {show(_rms(_sigma(c, 'discs')))} {show.unit}; {often} in 3 photos or more"),
        ("Image points", f"{c.rms_px:.3f} px", f"RMS; {_points(c)}"),
    ]


def _ball_rows(c: DeviceCalibration, show: _Lengths) -> list[list[str]]:
    sigma, r = np.sqrt(np.diag(c.ball_covariance)), correlation(c.ball_covariance)
    names = ("centre X", "centre Y", "centre Z", "radius")
    return [
        [names[i], show(v), show(sigma[i]), *(f"{r[i, j]:+.3f}" if j < i else "" for j in range(3))]
        for i, v in enumerate([*c.centre, c.radius])
    ]


def _target_rows(c: DeviceCalibration, show: _Lengths) -> list[list[str]]:
    photos = np.bincount(c.measured.point[c.measured.used], minlength=len(c.targets))
    return [
        [str(id_), code, *show.each(place), *show.each(sigma), str(n)]
        for id_, code, place, sigma, n in zip(
            c.device.ids, c.device.codes, c.targets, _sigma(c, "targets"), photos[: len(c.targets)], strict=True
        )
    ]


def _photo_head(show: _Lengths) -> tuple[str, ...]:
    return ("photo", "points", "not used", "px RMS", f"place ± {show.unit}", "attitude ± °")


def _photo_rows(c: DeviceCalibration, names: Sequence[str], show: _Lengths) -> list[list[str]]:
    rows = []
    for k, pose, (used, rejected, rms) in zip(c.photos, c.poses, _points_of_photos(c), strict=True):
        sigma = np.sqrt(np.diag(pose.covariance))
        certain = show(np.linalg.norm(sigma[:3])), f"{np.degrees(np.linalg.norm(sigma[3:])):.3f}"
        rows.append([f"{k + 1}: {names[k]}", str(used), str(rejected or "-"), _px(rms), *certain])
    return rows


def _disc_rows(c: DeviceCalibration, show: _Lengths) -> list[list[str]]:
    block, rows = c.block("discs"), []
    for i, (place, sigma, seen) in enumerate(zip(c.discs, _sigma(c, "discs"), c.sightings, strict=True)):
        here = slice(block.start + 3 * i, block.start + 3 * i + 3)
        r = correlation(c.covariance[here, here])
        pairs = [f"{r[a, b]:+.3f}" for a, b in ((0, 1), (0, 2), (1, 2))]
        rows.append([str(i + 1), *show.each(place), *pairs, *show.each(sigma), str(int(seen))])
    return rows


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
    cv2.polylines(canvas, [np.rint(scale * outline).astype(np.int32)], True, _LINE, 1, cv2.LINE_AA)
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
