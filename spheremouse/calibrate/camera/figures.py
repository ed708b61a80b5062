"""Figures of a camera calibration's report."""

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from spheremouse.calibrate.camera.calibrate import Calibrated, thumbnail
from spheremouse.calibrate.photos import image
from spheremouse.files.report import page
from spheremouse.files.report.style import BLUE, GOLD, GREEN, GRID, INK, MUTED, PAPER, RED, round_number
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_THUMB = 300  # px


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


def coverage_figure(done: Calibrated) -> "Figure":
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
                axes.add_patch(Rectangle((x, y), w / columns, h / rows, facecolor=RED, alpha=0.25, linewidth=0))
            axes.annotate(
                str(regions[i, j]),
                (x + 0.5 * w / columns, y + 0.5 * h / rows),
                ha="center",
                va="center",
                fontsize=13,
                fontweight="bold",
                color=RED if regions[i, j] == 0 else INK,
                bbox={"boxstyle": "round,pad=0.25", "facecolor": PAPER, "edgecolor": "none", "alpha": 0.9},
                zorder=3,
            )
    for k in range(1, columns):
        axes.axvline(w * k / columns - 0.5, color=GRID, linewidth=0.6)
    for k in range(1, rows):
        axes.axhline(h * k / rows - 0.5, color=GRID, linewidth=0.6)
    for uv, _ in _used_corners(done):
        axes.plot(uv[:, 0], uv[:, 1], ".", color=BLUE, markersize=1.6, alpha=0.6)
    return figure


def tilt_figure(done: Calibrated) -> "Figure":
    figure = _figure(4.6, 3.1)
    axes = figure.subplots()
    for angle in (15, 30, 45, 60):
        phase, r = np.linspace(0.0, 2.0 * np.pi, 100), np.sin(np.radians(angle))
        axes.plot(r * np.cos(phase), r * np.sin(phase), color=GRID, linewidth=0.8)
        axes.annotate(f"{angle}°", (0.0, -r), fontsize=7, color=MUTED, ha="center", va="center")
    R = done.found.rotations[done.found.used]
    out = -R[:, :2, 2] * np.sign(R[:, 2, 2])[:, None]
    axes.axhline(0.0, color=GRID, linewidth=0.6)
    axes.axvline(0.0, color=GRID, linewidth=0.6)
    axes.plot(out[:, 0], out[:, 1], "o", color=BLUE, markersize=5, alpha=0.85)
    axes.set(xlim=(-1.45, 1.45), ylim=(1.0, -1.0), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    for x, y, word in ((-1.0, 0.0, "left"), (1.0, 0.0, "right"), (0.0, -0.98, "up"), (0.0, 0.98, "down")):
        axes.annotate(word, (x, y), ha="center", va="center", fontsize=8, color=INK)
    return figure


def views_figure(done: Calibrated) -> "Figure":
    found, rms = done.found, done.found.view_rms()
    shown = [k for k in range(len(done.views)) if found.used[k]]
    figure = _figure(9.4, 2.6)
    axes = figure.subplots()
    x = np.arange(len(shown))
    axes.bar(x - 0.19, rms[shown], width=0.36, color=BLUE, label="RMS")
    axes.bar(x + 0.19, np.nan_to_num(done.held_out[shown]), width=0.36, color=GOLD, label="RMS held out")
    axes.axhline(found.rms, color=MUTED, linewidth=0.8, linestyle="--")
    axes.annotate(f"all {found.rms:.3f}", (len(shown) - 0.4, found.rms), fontsize=8, va="bottom", color=MUTED)
    names = [done.photos[done.index[k]].path.stem for k in shown]
    many = len(names) > 10
    axes.set_xticks(x, names, rotation=40 if many else 0, ha="right" if many else "center", fontsize=7.5)
    axes.set_ylabel("px")
    axes.set_xlim(-0.6, len(shown) + 0.3)
    axes.grid(axis="y")
    axes.set_axisbelow(True)
    axes.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    return figure


def magnification(done: Calibrated) -> float:
    """A round number that makes the RMS a fortieth of the picture's width."""
    return round_number(done.found.camera.width / 40.0 / max(done.found.rms, 1e-6))


def arrows_figure(done: Calibrated) -> "Figure":
    figure = _figure(4.6, 3.1)
    axes = _image_axes(figure, done)
    scale = magnification(done)
    for uv, r in _used_corners(done):
        axes.quiver(
            uv[:, 0],
            uv[:, 1],
            scale * r[:, 0],
            scale * r[:, 1],
            angles="xy",
            scale_units="xy",
            scale=1.0,
            color=BLUE,
            width=0.0018,
            headwidth=4.0,
            headlength=4.5,
            alpha=0.85,
        )
    return figure


def scatter_figure(done: Calibrated) -> "Figure":
    figure = _figure(4.6, 3.1)
    axes = figure.subplots()
    every = np.concatenate([r for _, r in _used_corners(done)])
    axes.plot(every[:, 0], every[:, 1], ".", color=BLUE, markersize=2.0, alpha=0.5)
    phase = np.linspace(0.0, 2.0 * np.pi, 100)
    axes.plot(done.found.rms * np.cos(phase), done.found.rms * np.sin(phase), color=RED, linewidth=1.0)
    limit = 1.05 * float(np.abs(every).max())
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="x, px", ylabel="y, px")
    axes.grid()
    return figure


def stands_figure(done: Calibrated) -> "Figure":
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
                axes.fill(*flat(square).T, color=INK, linewidth=0)
    board = np.array([[-1.5, -1.5], [pattern.columns + 0.5, -1.5], [pattern.columns + 0.5, pattern.rows + 0.5]])
    board = np.vstack([board, [[-1.5, pattern.rows + 0.5], [-1.5, -1.5]]]) * side
    axes.plot(*flat(np.column_stack([board, np.zeros(5)])).T, color=MUTED, linewidth=0.7)
    middle = corners.mean(axis=0)
    camera = found.camera
    places = found.camera_positions()
    size = 0.12 * float(np.median(np.linalg.norm(places - middle, axis=1)))
    half = 0.5 * np.array([camera.width / camera.fx, camera.height / camera.fy])
    rim = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    for k in np.flatnonzero(found.used).tolist():
        frame = size * np.column_stack([rim, np.ones(4)]) @ found.rotations[k] + places[k]
        for corner in frame:
            axes.plot(*flat(np.array([places[k], corner])).T, color=BLUE, linewidth=0.9)
        axes.plot(*flat(np.vstack([frame, frame[:1]])).T, color=BLUE, linewidth=0.9)
        axes.fill(*flat(frame).T, color=BLUE, alpha=0.15, linewidth=0)
        axes.plot(*flat(np.array([places[k], middle])).T, color=GRID, linewidth=0.6, zorder=0)
    _draw_axes(axes, flat, side * 3.0)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_axes(axes: "Axes", flat: Any, length: float) -> None:
    for axis, (colour, name) in enumerate(zip((RED, GREEN, GOLD), "XYZ", strict=True)):
        end = length * np.eye(3)[axis]
        line = flat(np.array([np.zeros(3), end]))
        axes.plot(*line.T, color=colour, linewidth=1.8, zorder=5)
        axes.annotate(name, line[1], color=colour, fontsize=9, fontweight="bold", zorder=5)


def small_picture(done: Calibrated, k: int) -> str:
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
