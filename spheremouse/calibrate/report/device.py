"""Report of `calibrate device`: JSON, tables on the terminal, and the HTML page.

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
from rich.text import Text

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.advice import coverage, distance_redundancy, photo_px
from spheremouse.calibrate.device.plans import Advice
from spheremouse.calibrate.photos import Photo, image
from spheremouse.calibrate.report.scene import (
    SIDES,
    View,
    circle,
    draw_axes,
    draw_ball,
    draw_camera,
    draw_ellipse,
    new_figure,
    scene_axes,
)
from spheremouse.files.report import page
from spheremouse.files.report.style import BLUE, GOLD, INK, MUTED, round_number, styled
from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.camera import Pose, project
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

_MARKS = {"good": ("✓", "green"), "note": ("·", "cyan"), "warning": ("!", "red")}
_RING_COLOURS = {"C": "#1f9fc4", "M": "#c43a86", "Y": "#e2c21e"}
_PHOTO_WIDTH = 900  # px, of a photo in the page
_ARROW_LENGTH = 0.035  # of the picture's width, of a large residual
_TARGET, _DISC, _FALSE, _LINE = (96, 170, 70), (214, 140, 40), (60, 60, 220), (235, 235, 235)  # BGR


# ---- figures as JSON ----


def device_json(c: DeviceCalibration, names: Sequence[str], advice: Sequence[Advice]) -> dict[str, Any]:
    """Return the figures of `--json`, in m, or in radii of the ball if the scale is free; `names` of all photos."""
    ball = np.sqrt(np.diag(c.ball_covariance))
    d = c.device
    return {
        "targets": [
            {"id": id_, "code": code, "position": place.tolist(), "sigma": sigma.tolist()}
            for id_, code, place, sigma in zip(d.ids, d.codes, c.targets, _sigma(c, "targets"), strict=True)
        ],
        "ball": {
            "center": c.centre.tolist(),
            "radius": c.radius,
            "sigma": dict(zip("XYZR", ball.tolist(), strict=True)),
            "correlation": _correlation(c.ball_covariance).tolist(),
        },
        "discs": [
            {"position": place.tolist(), "sigma": sigma.tolist(), "photos": int(seen)}
            for place, sigma, seen in zip(c.discs, _sigma(c, "discs"), c.sightings, strict=True)
        ],
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
        "distances": [
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
        ],
        "scale_free": c.scale_free,
        "ring_scale": c.ring_scale,
        "out_of_round": c.out_of_round,
        "skipped": [{"file": names[k], "why": why} for k, why in c.skipped],
        "doubtful": [{"file": names[k], "why": why} for k, why in c.doubtful],
        "advice": [{"kind": a.kind, "text": a.text, "gain": a.gain, "improves": a.improves} for a in advice],
    }


# ---- the terminal ----


def print_device(c: DeviceCalibration, names: Sequence[str], advice: Sequence[Advice], console: "Console") -> None:
    """Print the figures that matter, and the advice; `names` of all photos."""
    show = _Lengths(c)
    ball = np.sqrt(np.diag(c.ball_covariance))
    lines = Table(box=None, show_header=False, pad_edge=False, padding=(0, 3, 0, 0))
    if not c.scale_free:
        lines.add_row("radius", f"{show(c.radius)} ± {show(ball[3])} {show.unit}")
    where = ", ".join(f"{a} ± {show(s)}" for a, s in zip("XYZ", ball, strict=False))
    lines.add_row("ball's centre", f"{where} {show.unit} against the targets")
    lines.add_row("targets", f"{len(c.targets)}, ± {show(_rms(_sigma(c, 'targets')))} {show.unit}")
    often = int(np.count_nonzero(c.sightings >= 3))
    lines.add_row("discs", f"{len(c.discs)}, ± {show(_rms(_sigma(c, 'discs')))} {show.unit}; {often} in 3 photos +")
    lines.add_row("image points", f"{_points(c)}; {c.rms_px:.3f} px RMS")
    console.print(Padding(lines, (0, 0, 1, 0)))
    rows = []
    for k, pose, (used, rejected, rms) in zip(c.photos, c.poses, _points_of_photos(c), strict=True):
        sigma = np.sqrt(np.diag(pose.covariance))
        certain = show(np.linalg.norm(sigma[:3])), f"{np.degrees(np.linalg.norm(sigma[3:])):.3f}"
        rows.append([names[k], str(used), str(rejected or "-"), _px(rms), *certain])
    _print_table(console, ("photo", "points", "not used", "px RMS", f"place ± {show.unit}", "attitude ± °"), rows)
    if c.device.distances:
        columns = [[row[i] for i in (0, 1, 3, 5, 6)] for row in _distance_rows(c)]
        _print_table(console, ("distance", "tape mm", "adjusted mm", "residual mm", "over sigma"), columns)
    for a in advice:
        mark, colour = _MARKS[a.kind]
        line = Table.grid(padding=(0, 1, 0, 0))
        line.add_row(Text(mark, style=colour), Text(a.text))
        console.print(line)


def _print_table(console: "Console", heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """The first column holds words, the others figures."""
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for i, head in enumerate(heads):
        table.add_column(head, justify="right" if i else "left")
    for row in rows:
        table.add_row(*map(Text, row))
    console.print(Padding(table, (0, 0, 1, 0)))


# ---- rows ----


class _Lengths:
    """Lengths in the unit of the tables."""

    def __init__(self, c: DeviceCalibration) -> None:
        self.unit, self._digits = ("R/1000", 3) if c.scale_free else ("mm", 2)

    def __call__(self, value: float | np.floating) -> str:
        return f"{1e3 * value:.{self._digits}f}"

    def each(self, values: Array) -> list[str]:
        """Words for each of some lengths."""
        return [self(v) for v in values]


def _sigma(c: DeviceCalibration, name: str) -> Array:
    """Standard deviations of the coordinates of `targets` or `discs`, (n, 3)."""
    return np.sqrt(np.diag(c.covariance)[c.block(name)]).reshape(-1, 3)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _correlation(covariance: Array) -> Array:
    """Correlation matrix; 0 beside exact values."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    r = covariance / np.outer(scale, scale)
    np.fill_diagonal(r, 1.0)
    return r


def _px(rms: float | None) -> str:
    return "-" if rms is None else f"{rms:.3f}"


def _points(c: DeviceCalibration) -> str:
    used = c.measured.used
    left = int(np.count_nonzero(~used))
    return f"{int(np.count_nonzero(used))} used" + (f", {left} not" if left else "")


def _points_of_photos(c: DeviceCalibration) -> list[tuple[int, int, float | None]]:
    """For each photo: image points used and not, and px RMS per axis of the used ones, None without any."""
    m, found = c.measured, []
    for i in range(len(c.poses)):
        mine = m.photo == i
        used = mine & m.used
        rms = _rms(m.residual[used]) if np.any(used) else None
        found.append((int(np.count_nonzero(used)), int(np.count_nonzero(mine & ~m.used)), rms))
    return found


def _adjusted_distances(c: DeviceCalibration) -> tuple[Array, Array, Array]:
    """Adjusted tape distances, their residuals and standard deviations, (k,) m each."""
    block = c.block("targets")
    C = c.covariance[block, block]
    length, sigma = [], []
    for a, b in c.device.ends:
        way = c.targets[b] - c.targets[a]
        J = np.zeros(len(C))
        J[3 * b : 3 * b + 3] = way / np.linalg.norm(way)
        J[3 * a : 3 * a + 3] = -J[3 * b : 3 * b + 3]
        length.append(np.linalg.norm(way))
        sigma.append(np.sqrt(J @ C @ J))
    return np.array(length, float), c.distance_residuals, np.array(sigma, float)


def _distance_rows(c: DeviceCalibration) -> list[list[str]]:
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


# ---- the page ----


def write_device_report(
    path: Path, c: DeviceCalibration, photos: Sequence[Photo], provenance: Mapping[str, Any], advice: Sequence[Advice]
) -> None:
    """Write one HTML file that needs no other; `photos` are all that were given, `provenance` is that of rig files."""
    with styled():
        blocks = [
            page.numbers(_headlines(c)),
            page.advice([(a.kind, a.text) for a in advice]),
            _scene_section(c),
            _ball_section(c),
            _target_section(c),
            *([_distance_section(c)] if c.device.distances else []),
            _photo_section(c, photos),
            _disc_section(c),
            _weight_section(c),
            _provenance_section(c, photos, provenance),
        ]
    lead = f"{len(c.photos)} of {len(photos)} photos, {len(c.targets)} targets, {len(c.discs)} discs"
    foot = " · ".join(str(provenance[key]) for key in ("made_by", "date") if key in provenance)
    write_atomically(path, page.page("Calibration of the device", lead, blocks, foot))


def _headlines(c: DeviceCalibration) -> list[tuple[str, str, str]]:
    show = _Lengths(c)
    ball = np.sqrt(np.diag(c.ball_covariance))
    centre = f"X {show(ball[0])}, Y {show(ball[1])}, Z {show(ball[2])} {show.unit}"
    if c.scale_free:
        first = ("Scale", "free", "no tape distance: counts per radian")
    else:
        first = ("Ball's radius", f"{1e3 * c.radius:.1f} {show.unit}", f"± {show(ball[3])} {show.unit}")
    return [
        first,
        ("Ball's centre", f"± {show(ball[:3].max())} {show.unit}", centre),
        ("Discs", str(len(c.discs)), f"on {100.0 * coverage(c.directions):.0f} % of the ball"),
        ("Image points", f"{c.rms_px:.3f} px", f"RMS; {_points(c)}"),
    ]


def _scene_section(c: DeviceCalibration) -> str:
    scene = (
        "Cameras with the number of the photo, targets with their ids, discs, and the ball, at one scale. Discs on the "
        "far side are pale. The axes begin in the ball's centre: X right, Y up, Z towards the camera. The more the "
        "cameras surround the device, the better."
    )
    drawing, times = _certainty_figure(c)
    errors = (
        f"Error ellipses of targets (gold) and discs (blue), one standard deviation, {times:g} times larger. If all "
        "point away from the middle, the scale is uncertain."
    )
    return page.section("Scene", page.figure(_scene_figure(c), scene), page.figure(drawing, errors))


def _ball_section(c: DeviceCalibration) -> str:
    show = _Lengths(c)
    sigma, r = np.sqrt(np.diag(c.ball_covariance)), _correlation(c.ball_covariance)
    names = ("centre X", "centre Y", "centre Z", "radius")
    rows = [
        [names[i], show(v), show(sigma[i]), *(f"{r[i, j]:+.3f}" if j < i else "" for j in range(3))]
        for i, v in enumerate([*c.centre, c.radius])
    ]
    text = (
        f"The ball's centre as seen from target {c.device.axes.origin}, along the axes that the targets define, and "
        "its radius. If a correlation is near 1 or -1, two errors come together: a ball a little farther off and a "
        "little larger looks the same. The tracker uses these correlations. (Wittich 2017, table 11.)"
    )
    if c.scale_free:
        text += " Lengths are in thousandths of the radius; its sigma is relative to the targets' distances."
    elif c.out_of_round:
        text += f" The ball is out of round by {show(c.out_of_round)} {show.unit} (standard deviation)."
    head = ["", show.unit, f"sigma {show.unit}", "correlation X", "Y", "Z"]
    return page.section("The ball", page.paragraph(text), page.table(head, rows))


def _target_section(c: DeviceCalibration) -> str:
    show, point = _Lengths(c), c.measured.point[c.measured.used]
    rows = [
        [str(id_), code, *show.each(place), *show.each(sigma), str(int(np.count_nonzero(point == i)))]
        for i, (id_, code, place, sigma) in enumerate(
            zip(c.device.ids, c.device.codes, c.targets, _sigma(c, "targets"), strict=True)
        )
    ]
    text = "Centres of the targets as seen from the ball's centre. In play they give the camera's pose."
    head = ["id", "code", *(f"{a} {show.unit}" for a in "XYZ"), *(f"sigma {a}" for a in "XYZ"), "photos"]
    return page.section("Targets", page.paragraph(text), page.table(head, rows, text=2))


def _distance_section(c: DeviceCalibration) -> str:
    text = (
        "Tape distances as measured, and adjusted by photos and all distances together. Suspect a distance beyond 3 "
        "sigma. Checked: at 0 % no other observation checks it, at 100 % the others determine it."
    )
    head = ["from - to", "tape mm", "sigma", "adjusted mm", "sigma", "residual mm", "over sigma", "checked"]
    return page.section("Distances", page.paragraph(text), page.table(head, _distance_rows(c)))


def _photo_section(c: DeviceCalibration, photos: Sequence[Photo]) -> str:
    show = _Lengths(c)
    rows, certain, pictures = [], [], []
    expected = photo_px(c)[1]
    for i, (k, pose, (used, rejected, rms)) in enumerate(zip(c.photos, c.poses, _points_of_photos(c), strict=True)):
        name, number = photos[k].path.name, str(k + 1)
        place = [f"{1e3 * v:.0f}" for v in pose.position]
        rows.append([number, name, *place, str(used), str(rejected or "-"), _px(rms), _px(expected[i])])
        certain.append([number, *_pose_sigma(show, np.diag(pose.covariance))])
        count = f"{used} points" + (f", {rejected} not used" if rejected else "")
        pictures.append(
            page.picture(photo_picture(c, i, image(photos[k])), f"{number}: {name}; {count}, {_px(rms)} px")
        )
    certain.append(["RMS", *_pose_sigma(show, np.mean([np.diag(pose.covariance) for pose in c.poses], axis=0))])
    head = ["", "photo", *(f"{a} {show.unit}" for a in "XYZ"), "points", "not used", "px RMS", "expected"]
    spread = ["", *(f"sigma {a} {show.unit}" for a in "XYZ"), *(f"about {a} °" for a in "XYZ")]
    table = page.paragraph(
        "The camera's position in each photo, from the ball's centre, and the standard deviations of position and "
        "attitude. (Wittich 2017, tables 10 and 12.) Points of discs near the ball's edge have larger expected "
        "errors, and count for less."
    )
    drawn = page.paragraph(
        f"Green: targets; blue: discs; red crosses: points that contradict the other photos and were not used. Arrows "
        f"are residuals, {magnification(c, photos[c.photos[0]].size[0]):g} times longer. If arrows point the same way "
        "in one part of the picture, the lens differs from the camera file. The white outline is that of the adjusted "
        "ball: it must fit."
    )
    pairs = [page.beside(*pictures[i : i + 2]) for i in range(0, len(pictures), 2)]  # a pair stays on one printed page
    tables = page.table(head, rows, text=2), page.table(spread, certain)
    return page.section("Photos", table, *tables, _left_out(c, photos), drawn, *pairs)


def _pose_sigma(show: _Lengths, variance: Array) -> list[str]:
    sigma = np.sqrt(variance)
    return [*show.each(sigma[:3]), *(f"{np.degrees(s):.3f}" for s in sigma[3:])]


def _left_out(c: DeviceCalibration, photos: Sequence[Photo]) -> str:
    rows = [[photos[k].path.name, "nothing", why] for k, why in c.skipped]
    rows += [[photos[k].path.name, "targets only", why] for k, why in c.doubtful]
    return page.table(["photo", "used", "why"], rows, faulty=[True] * len(rows), text=3) if rows else ""


def _disc_section(c: DeviceCalibration) -> str:
    show, block, rows = _Lengths(c), c.block("discs"), []
    for i, (place, sigma, seen) in enumerate(zip(c.discs, _sigma(c, "discs"), c.sightings, strict=True)):
        here = slice(block.start + 3 * i, block.start + 3 * i + 3)
        r = _correlation(c.covariance[here, here])
        pairs = [f"{r[a, b]:+.3f}" for a, b in ((0, 1), (0, 2), (1, 2))]
        rows.append([str(i + 1), *show.each(place), *pairs, *show.each(sigma), str(int(seen))])
    columns = c.solution.columns.point(np.arange(len(c.targets), len(c.targets) + len(c.discs)))
    alone = np.sqrt(np.diag(c.solution.covariance)[columns]) / c.unit
    mean = [
        [name, *show.each(np.sqrt(np.mean(s**2, axis=0)))]
        for name, s in (("from the photos alone", alone), ("on the ball, from its centre", _sigma(c, "discs")))
    ]
    correlated = ("rho XY", "XZ", "YZ")
    return page.section(
        "Discs",
        page.paragraph("Standard deviations, root mean square over all discs. The sphere makes them smaller."),
        page.table(["", *(f"sigma {a} {show.unit}" for a in "XYZ")], mean),
        page.paragraph(
            "Each disc as seen from the ball's centre, the correlations of its coordinates, and the number of photos "
            "that show it. Play refines this map. (Wittich 2017, table 13.)"
        ),
        page.table(
            ["", *(f"{a} {show.unit}" for a in "XYZ"), *correlated, *(f"sigma {a}" for a in "XYZ"), "photos"], rows
        ),
    )


def _weight_section(c: DeviceCalibration) -> str:
    is_target = (c.measured.point >= 0) & (c.measured.point < len(c.targets))
    rows = []
    for name, factor, kind in zip(("targets", "discs"), c.variance_factors, (is_target, ~is_target), strict=True):
        mine = c.measured.used & kind
        rms = _rms(c.measured.residual[mine])
        rows.append([name, str(int(np.count_nonzero(mine))), f"{rms:.3f}", f"{factor:.2f}"])
    text = (
        "Residuals of the image points, and their variance over the assumed one. Values up to about 1 are good; 4 "
        "means residuals twice as large as usual. All standard deviations on this page include it."
    )
    head = ["", "image points", "px RMS", "variance factor"]
    return page.section("Weights", page.paragraph(text), page.table(head, rows))


def _provenance_section(c: DeviceCalibration, photos: Sequence[Photo], provenance: Mapping[str, Any]) -> str:
    known = [[str(key).replace("_", " "), str(value)] for key, value in provenance.items() if isinstance(value, str)]
    files = [
        [photo.path.name, "used" if k in c.photos else "left out", f"{photo.size[0]}x{photo.size[1]}", photo.sha256]
        for k, photo in enumerate(photos)
    ]
    return page.section(
        "Sources", page.table(["", ""], known, text=2), page.table(["photo", "", "px", "SHA-256"], files, text=4)
    )


# ---- figures ----


def _scene_figure(c: DeviceCalibration) -> "Figure":
    figure = new_figure(9.6, 4.4)
    for axes, (name, view) in zip(scene_axes(figure, len(SIDES)), SIDES, strict=True):
        axes.set_title(name, loc="center", fontsize=9.0, color=MUTED)
        _draw_scene(axes, c, view)
    return figure


def _draw_scene(axes: "Axes", c: DeviceCalibration, view: View) -> None:
    draw_ball(axes, view, c.radius)
    angle = c.device.disc_radius / c.unit / c.radius
    for u in c.directions:
        disc = view(circle(c.radius * np.cos(angle) * u, u, c.radius * np.sin(angle)))
        axes.fill(*disc.T, facecolor=INK, alpha=1.0 if view.faces(u) else 0.18, lw=0.0, zorder=2.0)
    draw_axes(axes, view, 1.45 * c.radius)
    _, _, forward = np.eye(3)
    edge_on = abs(view.towards @ forward) < 0.05
    for id_, code, place in zip(c.device.ids, c.device.codes, c.targets, strict=True):
        for letter, radius in zip(code[::-1], c.device.target_radii[::-1] / c.unit, strict=True):
            ring = view(circle(place, forward, float(radius)))
            axes.fill(*ring.T, color=_RING_COLOURS[letter], lw=1.4 if edge_on else 0.0, zorder=10.0)
        if not edge_on:
            axes.annotate(str(id_), _pair(view(place)), (6.0, 6.0), textcoords="offset points", fontsize=7.5)
    size = 0.09 * float(np.median([np.linalg.norm(pose.position) for pose in c.poses]))
    for k, pose in zip(c.photos, c.poses, strict=True):
        draw_camera(axes, view, c.camera, pose, size)
        at = _pair(view(pose.position))
        axes.annotate(str(k + 1), at, (4.0, 4.0), textcoords="offset points", fontsize=7.5, color=BLUE)


def _pair(point: Array) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _certainty_figure(c: DeviceCalibration) -> tuple["Figure", float]:
    """Error ellipses of targets and discs, and how many times larger they are drawn."""
    targets, discs = c.block("targets"), c.block("discs")
    sigma = np.sqrt(np.diag(c.covariance))
    magnified = round_number(0.16 * c.radius / float(max(sigma[targets].max(), sigma[discs].max())))
    figure = new_figure(9.6, 4.4)
    for axes, (name, view) in zip(scene_axes(figure, 2), SIDES[:2], strict=True):
        axes.set_title(name, loc="center", fontsize=9.0, color=MUTED)
        draw_ball(axes, view, c.radius)
        P = np.stack([view.right, view.up])
        for block, places, colour in ((targets, c.targets, GOLD), (discs, c.discs, BLUE)):
            for i, place in enumerate(places):
                here = slice(block.start + 3 * i, block.start + 3 * i + 3)
                draw_ellipse(axes, view(place), magnified**2 * P @ c.covariance[here, here] @ P.T, colour)
    return figure, magnified


def magnification(c: DeviceCalibration, width: int) -> float:
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
    _draw_outline(canvas, scale, c, c.poses[photo])
    times = magnification(c, width)
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


def _draw_outline(canvas: NDArray[np.uint8], scale: float, c: DeviceCalibration, pose: Pose) -> None:
    """The circle of the ball that rays touch, as far as the lens model has an image of it."""
    distance = float(np.linalg.norm(pose.position))
    towards, R = pose.position / distance, c.radius
    cam = pose.to_cam(circle(R**2 / distance * towards, towards, R * np.sqrt(1.0 - (R / distance) ** 2)))
    uv = scale * project(cam, c.camera)[0]
    shown = np.sum((cam[:, :2] / cam[:, 2:]) ** 2, axis=1) < c.camera.fold_r2
    for k in np.flatnonzero(shown[1:] & shown[:-1]):
        cv2.line(canvas, _pixel(uv[k]), _pixel(uv[k + 1]), _LINE, 1, cv2.LINE_AA)


def _pixel(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
