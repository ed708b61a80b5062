"""What `calibrate camera` found: figures for programs, text for the terminal, a page with pictures; and advice."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from spheremouse.calibrate.camera.bundle import PARAMETERS
from spheremouse.calibrate.camera.calibrate import Calibrated, false_views, thumbnail
from spheremouse.calibrate.camera.coverage import LEANS, VIEWS, bare, listed, unleant
from spheremouse.calibrate.photos import image
from spheremouse.files.report import page
from spheremouse.files.yaml import write_atomically
from spheremouse.geometry.camera import interior_vector
from spheremouse.geometry.rotation import Array, log

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GOOD_FOCAL = 5e-4  # of the focal length: 1 mm at 2 m, which is what targets are wanted to
_INSIGNIFICANT = 2.0  # standard deviations
_CORRELATED = 0.98  # from which on two unknowns are named
_THUMB = 300  # px
_PIXELS = ("fx", "fy", "cx", "cy")


def advice(done: Calibrated) -> list[tuple[str, str]]:
    """("good" | "note" | "warning", sentence): what is wrong with this calibration and what would make it better."""
    found, covered = done.found, done.coverage
    camera, sigma = found.camera, found.deviations
    said: list[tuple[str, str]] = []
    for i, why in false_views(done).items():
        said.append(("warning", f"{done.photos[i].path.name} {why} It was left out."))
    if done.skipped:
        names = ", ".join(done.photos[i].path.name for i in done.skipped)
        said.append(("note", f"Left out, because the whole board is not found in them: {names}."))
    if covered.views < VIEWS:
        said.append(("warning", f"Only {covered.views} views; {VIEWS} to 20 make a lens reliable."))
    if places := bare(covered):
        said.append(("note", f"No view shows the board {listed(places)}."))
    if ways := unleant(covered):
        said.append(
            ("note", f"Too few views of the board facing {listed(ways)}: tilt it by 20° to 45°, twice to each side.")
        )
    if covered.reach < 0.85:
        said.append(
            (
                "note",
                f"No corner lies beyond {100 * covered.reach:.0f} % of the way from the middle of the picture to its "
                "corners: what the lens does farther out is a guess. Bring the board into the corners.",
            )
        )
    if found.free[:2].all() and sigma[0] / camera.fx > _GOOD_FOCAL:
        tilt = np.degrees(found.tilts()[found.used])
        said.append(
            (
                "warning",
                f"The focal length is uncertain by {100 * sigma[0] / camera.fx:.2f} %; the "
                f"board is tilted by {np.min(tilt):.0f}° to {np.max(tilt):.0f}°. More views at 30° to 45° help most.",
            )
        )
    value = np.concatenate([camera.intrinsic, camera.distortion])
    if found.free[8] and abs(value[8]) < _INSIGNIFICANT * sigma[8]:
        said.append(
            (
                "note",
                f"k3 is {value[8]:.3f} with a standard deviation of {sigma[8]:.3f}: it may as well be 0, and "
                "`--distortion 4` would do.",
            )
        )
    if found.contradiction > 1.0:
        said.append(
            (
                "note",
                "The views contradict each other more than their corners say; all standard deviations were "
                f"made {np.sqrt(found.contradiction):.1f} times larger. Is the board flat, and did it stand still?"
                + ("" if found.free.all() else " Or does the lens need more terms (`--distortion 5`)?"),
            )
        )
    dropped = int(sum((~k).sum() for k, u in zip(found.kept, found.used, strict=True) if u))
    if dropped:
        said.append(("note", f"{dropped} corner{'s were' if dropped > 1 else ' was'} false and left out."))
    if not any(kind == "warning" for kind, _ in said):
        said.append(("good", "The camera is well determined."))
    return sorted(said, key=lambda item: ("warning", "good", "note").index(item[0]))


def camera_json(done: Calibrated) -> dict[str, Any]:
    """Figures, in px, m and degrees; `sigma` is of fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    found, camera = done.found, done.found.camera
    rms, position = found.view_rms(), found.camera_positions()
    tilts = np.degrees(found.tilts())
    views: dict[int, dict[str, Any]] = {
        i: {
            "file": done.photos[i].path.name,
            "rms_px": float(rms[k]),
            "used": bool(found.used[k]),
            "held_out_px": None if np.isnan(done.held_out[k]) else float(done.held_out[k]),
            "corners": len(done.views[k].uv),
            "false_corners": int((~found.kept[k]).sum()) if found.used[k] else None,
            "tilt_deg": float(tilts[k]),
            "distance_m": float(np.linalg.norm(position[k])),
            "why": false_views(done).get(i),
        }
        for k, i in enumerate(done.index)
    }
    for i, why in done.skipped.items():
        views[i] = {"file": done.photos[i].path.name, "rms_px": None, "used": False, "why": why}
    return {
        "camera": {
            "width": camera.width,
            "height": camera.height,
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "dist": camera.distortion.tolist(),
            "sigma": found.deviations.tolist(),
            "correlation": found.correlation()[:9, :9].tolist(),
        },
        "rms_px": found.rms,
        "held_out_px": _held_out(done),
        "contradiction": found.contradiction,
        "coverage": {
            "regions": done.coverage.regions.tolist(),
            "leans": dict(zip(LEANS, done.coverage.leans.tolist(), strict=True)),
            "reach": done.coverage.reach,
        },
        "board_views": [views[i] for i in sorted(views)],
        "advice": [text for _, text in advice(done)],
    }


def camera_text(done: Calibrated) -> None:
    """The same on the terminal."""
    console = Console(soft_wrap=True, highlight=False)
    if not console.is_terminal:
        console.width = 1000
    table = Table(box=None, title_justify="left", title_style="")
    held = _held_out(done)
    table.title = (
        f"{int(done.found.used.sum())} views of {len(done.photos)} photos, {done.found.camera.width}x"
        f"{done.found.camera.height}: reprojection {done.found.rms:.3f} px RMS"
        + ("" if held is None else f", {held:.3f} px in views held out")
    )
    for name in ("", "value", "std. dev."):
        table.add_column(name, justify="left" if not name else "right")
    for row in _parameter_rows(done):
        table.add_row(*row[:3])
    console.print(table)
    views = Table(box=None)
    for name in ("view", "rms, px", "held out, px", "tilt, °", "distance, m", ""):
        views.add_column(name, justify="left" if name in ("view", "") else "right")
    for row, used in _view_rows(done):
        views.add_row(*map(escape, row), style=None if used else "red")
    console.print(views)
    for kind, text in advice(done):
        mark = {"good": "[green]✓[/]", "note": "[blue]i[/]", "warning": "[yellow]![/]"}[kind]
        console.print(f"{mark} {escape(text.replace('`', ''))}")


def write_camera_report(path: Path, done: Calibrated, provenance: Mapping[str, Any]) -> None:
    """The page, whole or not at all; ConfigurationError where it cannot be written."""
    with page.drawn():
        write_atomically(path, _page(done, provenance))


def _page(done: Calibrated, provenance: Mapping[str, Any]) -> str:
    found, camera = done.found, done.found.camera
    sigma, held = found.deviations, _held_out(done)
    pattern, used = done.pattern, int(found.used.sum())
    kind = "chessboard" if pattern.marker is None else "ChArUco board"
    distance = np.linalg.norm(found.camera_positions()[found.used], axis=1)
    lead = (
        f"{used} views of a {kind} with {pattern.columns} × {pattern.rows} inner corners, squares of "
        f"{1e3 * pattern.square:g} mm, from {distance.min():.2f} to {distance.max():.2f} m; images of {camera.width} × "
        f"{camera.height} px. It holds for this mode of the camera, this zoom and this focus, and for no other."
    )
    cards = [
        ("focal length", f"{camera.fx:.1f} px", f"± {sigma[0]:.2f} px, {100 * sigma[0] / camera.fx:.3f} %"),
        ("principal point", f"{camera.cx:.1f}, {camera.cy:.1f}", f"± {sigma[2]:.2f}, {sigma[3]:.2f} px"),
        ("reprojection error", f"{found.rms:.3f} px", f"RMS of {sum(int(k.sum()) for k in found.kept)} corners"),
        ("views held out", "–" if held is None else f"{held:.3f} px", "RMS, calibrated without them"),
    ]
    blocks = [
        page.numbers(cards),
        page.advice(advice(done)),
        page.section(
            "What the views cover",
            page.beside(
                page.figure(
                    _coverage_figure(done),
                    "All corners in the picture. The number in a region counts the views that show corners there; "
                    "where there are none, the lens is not known.",
                ),
                page.figure(
                    _tilt_figure(done),
                    "Where the printed face points, seen from the camera: the farther from the middle, the more the "
                    "board was tilted. Views in all four quarters are best.",
                ),
            ),
        ),
        page.section(
            "Reprojection errors",
            page.figure(
                _views_figure(done),
                "Root mean square distance of the corners seen from where the camera found puts them, per view; and "
                "the same where the camera was calibrated without that view. Bars that stand out are bad photos.",
            ),
            page.beside(
                page.figure(
                    _arrows_figure(done),
                    f"Residuals of all views in one picture, {_magnification(done):.0f} times enlarged. They should "
                    "point anywhere; a common direction in one place is what the lens model does not explain.",
                ),
                page.figure(
                    _scatter_figure(done),
                    "All residuals from one origin, with the circle of the RMS. A round cloud is random error.",
                ),
            ),
        ),
        page.section(
            "Where the camera stood",
            page.figure(
                _stands_figure(done),
                "The board and, in its frame, the camera's places and viewing directions, from two sides. "
                "The coloured axes are three squares long.",
            ),
        ),
        page.section(
            "Values and standard deviations",
            page.table(["", "value", "std. dev.", "value / std. dev."], _parameter_rows(done)),
            page.paragraph(
                "From the inverse normal matrix of the adjustment, with the variances of the corners estimated in each "
                "view."
                + (
                    f" Widened by {np.sqrt(found.contradiction):.2f} because views contradict each other."
                    if found.contradiction > 1.0
                    else ""
                )
            ),
            page.correlations(PARAMETERS, found.correlation()[:9, :9]),
            page.paragraph(_correlated(done)),
        ),
        page.section(
            "Views",
            page.table(
                ["view", "RMS, px", "held out, px", "tilt, °", "distance, m", "remark"],
                [row for row, _ in _view_rows(done)],
                [not good for _, good in _view_rows(done)],
            ),
            page.sheet([_picture(done, k) for k in range(len(done.views))]),
        ),
        page.section(
            "Poses",
            page.paragraph(
                "The camera in the board's frame, and the rotation vector from board to camera axes; standard "
                "deviations are means over the axes."
            ),
            page.table(_POSE_HEAD, _pose_rows(done)),
        ),
    ]
    foot = f"{provenance['made_by']}, {provenance['date']}"
    return page.page("Camera calibration", lead, blocks, foot)


# ---- tables ----


_POSE_HEAD = ["view", "x, mm", "y, mm", "z, mm", "± mm", "r x, °", "r y, °", "r z, °", "± °"]


def _held_out(done: Calibrated) -> float | None:
    """RMS over all views held out, px."""
    good = done.held_out[np.isfinite(done.held_out)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def _parameter_rows(done: Calibrated) -> list[list[str]]:
    camera, sigma = done.found.camera, done.found.deviations
    rows = []
    for name, v, s, free in zip(PARAMETERS, interior_vector(camera), sigma, done.found.free, strict=True):
        digits, unit = (3, " px") if name in _PIXELS else (6, "")
        if free:
            rows.append(
                [
                    name,
                    f"{v:.{digits}f}{unit}",
                    f"{s:.{digits}f}{unit}",
                    f"{abs(v) / s:.1f}" if abs(v) < 100.0 * s else "",
                ]
            )
        else:
            rows.append([name, f"{v:g}", "held", ""])
    return rows


def _view_rows(done: Calibrated) -> list[tuple[list[str], bool]]:
    found, rms = done.found, done.found.view_rms()
    tilts, position = np.degrees(found.tilts()), found.camera_positions()
    false, rows = false_views(done), {}
    for k, i in enumerate(done.index):
        gone = int((~found.kept[k]).sum()) if found.used[k] else 0
        remark = false.get(i, f"{gone} false corner{'s' if gone > 1 else ''}" if gone else "")
        held = "" if np.isnan(done.held_out[k]) else f"{done.held_out[k]:.3f}"
        cells = [f"{rms[k]:.3f}", held, f"{tilts[k]:.0f}", f"{np.linalg.norm(position[k]):.2f}"]
        rows[i] = ([done.photos[i].path.name, *cells, remark], bool(found.used[k]))
    for i, why in done.skipped.items():
        rows[i] = ([done.photos[i].path.name, "", "", "", "", f"left out: {why}"], False)
    return [rows[i] for i in sorted(rows)]


def _pose_rows(done: Calibrated) -> list[list[str]]:
    """Position of the camera in the board's frame, and rotation vector R_cam_board; standard deviations per view."""
    found, rows, at = done.found, [], 0
    for k, i in enumerate(done.index):
        if not found.used[k]:
            continue
        C = found.covariance[9 + 6 * at : 15 + 6 * at, 9 + 6 * at : 15 + 6 * at]
        at += 1
        place = 1e3 * found.camera_positions()[k]
        turn = np.degrees(log(found.rotations[k]))
        s_turn, s_place = np.sqrt(np.trace(C[:3, :3]) / 3.0), np.sqrt(np.trace(_position_covariance(done, k, C)) / 3.0)
        rows.append(
            [
                done.photos[i].path.name,
                *(f"{v:.1f}" for v in place),
                f"{1e3 * s_place:.2f}",
                *(f"{v:.2f}" for v in turn),
                f"{np.degrees(s_turn):.3f}",
            ]
        )
    return rows


def _position_covariance(done: Calibrated, k: int, C: Array) -> Array:
    """Of -R't, (3, 3) m², from that of rotation (in cam) and translation."""
    from spheremouse.geometry.rotation import hat

    R, t = done.found.rotations[k], done.found.translations[k]
    J = np.hstack([-R.T @ hat(t), -R.T])
    return J @ C @ J.T


def _correlated(done: Calibrated) -> str:
    C = done.found.correlation()[:9, :9]
    pairs = [(abs(C[i, j]), i, j) for i in range(9) for j in range(i) if abs(C[i, j]) > _CORRELATED]
    if not pairs:
        return f"No two are correlated by more than {_CORRELATED}."
    worst = ", ".join(f"{PARAMETERS[j]} and {PARAMETERS[i]} ({C[i, j]:+.3f})" for _, i, j in sorted(pairs)[::-1])
    return f"Correlated by more than {_CORRELATED}: {worst}. Alone they mean little; together they are sure."


# ---- figures ----


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _image_axes(figure: "Figure", done: Calibrated) -> "Axes":
    """Axes that are the picture, in px."""
    w, h = done.found.camera.width, done.found.camera.height
    axes = figure.subplots()
    axes.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), aspect="equal", xlabel="px")
    axes.spines[["top", "right"]].set_visible(True)
    return axes


def _used_corners(done: Calibrated) -> list[tuple[Array, Array]]:
    """Places and residuals of the corners that took part, (n, 2) px each, of each view."""
    return [
        (v.uv[k], r[k])
        for v, r, k, u in zip(done.views, done.found.residuals, done.found.kept, done.found.used, strict=True)
        if u
    ]


def _coverage_figure(done: Calibrated) -> "Figure":
    from matplotlib.patches import Rectangle

    figure = _figure(4.6, 3.1)
    axes = _image_axes(figure, done)
    w, h = done.found.camera.width, done.found.camera.height
    regions = done.coverage.regions
    rows, columns = regions.shape
    for i in range(rows):
        for j in range(columns):
            x, y = w * j / columns - 0.5, h * i / rows - 0.5
            if regions[i, j] == 0:
                axes.add_patch(Rectangle((x, y), w / columns, h / rows, facecolor=page.RED, alpha=0.25, linewidth=0))
            axes.annotate(
                str(regions[i, j]),
                (x + 0.5 * w / columns, y + 0.5 * h / rows),
                ha="center",
                va="center",
                fontsize=13,
                fontweight="bold",
                color=page.RED if regions[i, j] == 0 else page.INK,
                bbox={"boxstyle": "round,pad=0.25", "facecolor": page.PAPER, "edgecolor": "none", "alpha": 0.9},
                zorder=3,
            )
    for k in range(1, columns):
        axes.axvline(w * k / columns - 0.5, color=page.GRID, linewidth=0.6)
    for k in range(1, rows):
        axes.axhline(h * k / rows - 0.5, color=page.GRID, linewidth=0.6)
    for uv, _ in _used_corners(done):
        axes.plot(uv[:, 0], uv[:, 1], ".", color=page.BLUE, markersize=1.6, alpha=0.6)
    return figure


def _tilt_figure(done: Calibrated) -> "Figure":
    figure = _figure(4.6, 3.1)
    axes = figure.subplots()
    for angle in (15, 30, 45, 60):
        phase, r = np.linspace(0.0, 2.0 * np.pi, 100), np.sin(np.radians(angle))
        axes.plot(r * np.cos(phase), r * np.sin(phase), color=page.GRID, linewidth=0.8)
        axes.annotate(f"{angle}°", (0.0, -r), fontsize=7, color=page.MUTED, ha="center", va="center")
    R = done.found.rotations[done.found.used]
    out = -R[:, :2, 2] * np.sign(R[:, 2, 2])[:, None]
    axes.axhline(0.0, color=page.GRID, linewidth=0.6)
    axes.axvline(0.0, color=page.GRID, linewidth=0.6)
    axes.plot(out[:, 0], out[:, 1], "o", color=page.BLUE, markersize=5, alpha=0.85)
    axes.set(xlim=(-1.45, 1.45), ylim=(1.0, -1.0), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    for x, y, word in ((-1.0, 0.0, "left"), (1.0, 0.0, "right"), (0.0, -0.98, "up"), (0.0, 0.98, "down")):
        axes.annotate(word, (x, y), ha="center", va="center", fontsize=8, color=page.INK)
    return figure


def _views_figure(done: Calibrated) -> "Figure":
    found, rms = done.found, done.found.view_rms()
    shown = [k for k in range(len(done.views)) if found.used[k]]
    figure = _figure(9.4, 2.6)
    axes = figure.subplots()
    x = np.arange(len(shown))
    axes.bar(x - 0.19, rms[shown], width=0.36, color=page.BLUE, label="RMS")
    axes.bar(x + 0.19, np.nan_to_num(done.held_out[shown]), width=0.36, color=page.GOLD, label="RMS held out")
    axes.axhline(found.rms, color=page.MUTED, linewidth=0.8, linestyle="--")
    axes.annotate(f"all {found.rms:.3f}", (len(shown) - 0.4, found.rms), fontsize=8, va="bottom", color=page.MUTED)
    names = [done.photos[done.index[k]].path.stem for k in shown]
    many = len(names) > 10
    axes.set_xticks(x, names, rotation=40 if many else 0, ha="right" if many else "center", fontsize=7.5)
    axes.set_ylabel("px")
    axes.set_xlim(-0.6, len(shown) + 0.3)
    axes.grid(axis="y")
    axes.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    return figure


def _magnification(done: Calibrated) -> float:
    """A round number that makes the RMS a fortieth of the picture's width."""
    wanted = done.found.camera.width / 40.0 / max(done.found.rms, 1e-6)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(d for d in (1.0, 2.0, 5.0) if d * power <= wanted))


def _arrows_figure(done: Calibrated) -> "Figure":
    figure = _figure(4.6, 3.1)
    axes = _image_axes(figure, done)
    scale = _magnification(done)
    for uv, r in _used_corners(done):
        axes.quiver(
            uv[:, 0],
            uv[:, 1],
            scale * r[:, 0],
            scale * r[:, 1],
            angles="xy",
            scale_units="xy",
            scale=1.0,
            color=page.BLUE,
            width=0.0018,
            headwidth=4.0,
            headlength=4.5,
            alpha=0.85,
        )
    return figure


def _scatter_figure(done: Calibrated) -> "Figure":
    figure = _figure(4.6, 3.1)
    axes = figure.subplots()
    every = np.concatenate([r for _, r in _used_corners(done)])
    axes.plot(every[:, 0], every[:, 1], ".", color=page.BLUE, markersize=2.0, alpha=0.5)
    phase = np.linspace(0.0, 2.0 * np.pi, 100)
    axes.plot(done.found.rms * np.cos(phase), done.found.rms * np.sin(phase), color=page.RED, linewidth=1.0)
    limit = 1.05 * float(np.abs(every).max())
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="x, px", ylabel="y, px")
    axes.grid()
    return figure


def _stands_figure(done: Calibrated) -> "Figure":
    """Two oblique parallel projections, drawn by hand: board, pyramids of the cameras, their shadows on the plane."""
    figure = _figure(9.4, 4.2)
    for axes, (turn, rise) in zip(figure.subplots(1, 2), ((35.0, 22.0), (-60.0, 35.0)), strict=True):
        _draw_stands(axes, done, np.radians(turn), np.radians(rise))
    return figure


def _draw_stands(axes: "Axes", done: Calibrated, turn: float, rise: float) -> None:
    c, s, a, b = np.cos(turn), np.sin(turn), np.cos(rise), np.sin(rise)
    # looked at from the cameras' side of the board: X right, Y down, Z into it
    onto = np.array([[c, 0.0, s], [s * b, -a, -c * b]])

    def flat(points: Array) -> Array:
        return points @ onto.T

    pattern, found = done.pattern, done.found
    corners = pattern.corners()
    side = pattern.square
    for i in range(-1, pattern.rows):
        for j in range(-1, pattern.columns):
            if (i + j) % 2 == 0:
                x, y = j * side, i * side
                square = np.array([[x, y, 0], [x + side, y, 0], [x + side, y + side, 0], [x, y + side, 0]])
                axes.fill(*flat(square).T, color=page.INK, linewidth=0)
    board = np.array([[-1.5, -1.5], [pattern.columns + 0.5, -1.5], [pattern.columns + 0.5, pattern.rows + 0.5]])
    board = np.vstack([board, [[-1.5, pattern.rows + 0.5], [-1.5, -1.5]]]) * side
    axes.plot(*flat(np.column_stack([board, np.zeros(5)])).T, color=page.MUTED, linewidth=0.7)
    middle = corners.mean(axis=0)
    camera = found.camera
    places = found.camera_positions()
    size = 0.12 * float(np.median(np.linalg.norm(places - middle, axis=1)))
    half = 0.5 * np.array([camera.width / camera.fx, camera.height / camera.fy])
    rim = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    for k in np.flatnonzero(found.used).tolist():
        frame = size * np.column_stack([rim, np.ones(4)]) @ found.rotations[k] + places[k]
        for corner in frame:
            axes.plot(*flat(np.array([places[k], corner])).T, color=page.BLUE, linewidth=0.9)
        axes.plot(*flat(np.vstack([frame, frame[:1]])).T, color=page.BLUE, linewidth=0.9)
        axes.fill(*flat(frame).T, color=page.BLUE, alpha=0.15, linewidth=0)
        axes.plot(*flat(np.array([places[k], middle])).T, color=page.GRID, linewidth=0.6, zorder=0)
    _draw_axes(axes, flat, side * 3.0)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_axes(axes: "Axes", flat: Any, length: float) -> None:
    for axis, (colour, name) in enumerate(zip((page.RED, page.GREEN, page.GOLD), "XYZ", strict=True)):
        end = length * np.eye(3)[axis]
        line = flat(np.array([np.zeros(3), end]))
        axes.plot(*line.T, color=colour, linewidth=1.8, zorder=5)
        axes.annotate(name, line[1], color=colour, fontsize=9, fontweight="bold", zorder=5)


def _picture(done: Calibrated, k: int) -> str:
    """A small photo with its corners, those left out in red."""
    photo = done.photos[done.index[k]]
    small = np.ascontiguousarray(thumbnail(image(photo), _THUMB))
    scale = _THUMB / photo.size[0]
    kept = done.found.kept[k] if done.found.used[k] else np.zeros(len(done.views[k].uv), bool)
    for (u, v), good in zip(done.views[k].uv, kept, strict=True):
        at = round(16 * ((u + 0.5) * scale - 0.5)), round(16 * ((v + 0.5) * scale - 0.5))
        cv2.circle(small, at, 28, (176, 133, 47) if good else (61, 85, 220), -1, cv2.LINE_AA, 4)
    data = bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1])
    remark = f"{done.found.view_rms()[k]:.3f} px" + ("" if done.found.used[k] else ", left out")
    return page.picture(data, f"{photo.path.name}: {remark}")
