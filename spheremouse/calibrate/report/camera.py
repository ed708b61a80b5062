"""Report of `calibrate camera`: advice, JSON, a summary on the terminal, and the HTML page."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from spheremouse.calibrate.camera.bundle import PARAMETERS
from spheremouse.calibrate.camera.calibrate import CameraCalibration, inconsistent_views
from spheremouse.calibrate.camera.coverage import LEANS, VIEWS, join_words, missing_leans, missing_regions
from spheremouse.calibrate.outputs import print_advice
from spheremouse.calibrate.photos import image
from spheremouse.calibrate.report.page import Content, write_report
from spheremouse.files.report.style import BLUE, GRID, INK, PAPER, RED, round_number
from spheremouse.geometry.camera import fold_in_picture
from spheremouse.geometry.statistics import correlation

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

_MIN_REACH = 0.85  # of the way to the picture's corners; beyond the last corner seen, the lens is extrapolated
_MAX_FOCAL_ERROR = 5e-4  # of the focal length: 1 mm at 2 m, the accuracy that targets need
_MIN_SIGNIFICANCE = 2.0  # standard deviations
_NAMED_CORRELATION = 0.98
_THUMBNAIL_WIDTH = 300  # px


# ---- advice ----


def advise(calibration: CameraCalibration) -> list[tuple[str, str]]:
    """Return ("good" | "note" | "warning", sentence), warnings first."""
    found = [*_view_advice(calibration), *_value_advice(calibration)]
    if not any(kind == "warning" for kind, _ in found):
        found.append(("good", "The camera is well determined."))
    return sorted(found, key=lambda item: ("warning", "good", "note").index(item[0]))


def _view_advice(calibration: CameraCalibration) -> Iterator[tuple[str, str]]:
    covered = calibration.coverage
    for i, why in inconsistent_views(calibration).items():
        yield "warning", f"{calibration.photos[i].path.name} {why} It was left out."
    if calibration.skipped:
        names = ", ".join(calibration.photos[i].path.name for i in calibration.skipped)
        yield "note", f"Left out, because the whole board is not found in them: {names}."
    if covered.views < VIEWS:
        yield "warning", f"Only {covered.views} views; {VIEWS} to 20 make a lens reliable."
    if places := missing_regions(covered):
        yield "note", f"No view shows the board {join_words(places)}."
    if ways := missing_leans(covered):
        tilt = "tilt it by 20° to 45°, twice to each side"
        yield "note", f"Too few views of the board facing {join_words(ways)}: {tilt}."
    if covered.reach < _MIN_REACH:
        text = (
            f"No corner lies beyond {100 * covered.reach:.0f} % of the way from the middle of the picture to its "
            "corners: farther out the lens is a guess. Bring the board into the corners."
        )
        yield "note", text


def _value_advice(calibration: CameraCalibration) -> Iterator[tuple[str, str]]:
    found, camera, sigma = calibration.found, calibration.found.camera, calibration.found.deviations
    if found.free[:2].all() and sigma[0] / camera.fx > _MAX_FOCAL_ERROR:
        tilt = np.degrees(found.tilts()[found.used])
        text = (
            f"The focal length is uncertain by {100 * sigma[0] / camera.fx:.2f} %; the board is tilted by "
            f"{np.min(tilt):.0f}° to {np.max(tilt):.0f}°. More views at 30° to 45° help most."
        )
        yield "warning", text
    k3 = camera.distortion[4]
    if found.free[8] and abs(k3) < _MIN_SIGNIFICANCE * sigma[8]:
        text = f"k3 is {k3:.3f} with a standard deviation of {sigma[8]:.3f}: it may as well be 0"
        yield "note", f"{text}, and `--distortion 4` would do."
    share, distance = fold_in_picture(camera)
    if share > 0.0:
        text = f"{100 * share:.1f} % of the picture, from {distance:.0f} px off the principal point on, have no ray"
        yield "note", f"{text}: there the lens model folds, and no disc can be used."
    (bow, bow_sigma), (stretch, stretch_sigma) = found.bow, found.stretch
    if bow > _MIN_SIGNIFICANCE * bow_sigma:
        yield "note", f"The board is bent: its corners lie {1e3 * bow:.2g} mm off a plane. The result allows for that."
    if abs(stretch) > _MIN_SIGNIFICANCE * stretch_sigma:
        text = f"The print is {100 * abs(stretch):.2g} % {'longer' if stretch > 0.0 else 'shorter'} along its columns"
        yield "note", f"{text} than along its rows. The result allows for that."
    if found.contradiction > 1.0:
        text = (
            "The views contradict each other more than the errors of their corners explain. So all standard deviations "
            f"are {np.sqrt(found.contradiction):.1f} times larger. Did the board bend or move between the photos?"
        )
        yield "note", text + ("" if found.free.all() else " Or does the lens need more terms (`--distortion 5`)?")
    dropped = int(sum((~k).sum() for k, u in zip(found.kept, found.used, strict=True) if u))
    if dropped:
        yield "note", f"{dropped} corner{'s were' if dropped > 1 else ' was'} false and left out."


# ---- JSON and terminal ----


def camera_json(calibration: CameraCalibration) -> dict[str, Any]:
    """Return the figures in px, m and degrees; `sigma` is of fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    found, camera = calibration.found, calibration.found.camera
    interior = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return {
        "camera": {
            **interior,
            "dist": camera.distortion.tolist(),
            "sigma": found.deviations.tolist(),
            "correlation": correlation(camera.covariance).tolist(),
        },
        "rms_px": found.rms,
        "contradiction": found.contradiction,
        "coverage": {
            "regions": calibration.coverage.regions.tolist(),
            "leans": dict(zip(LEANS, calibration.coverage.leans.tolist(), strict=True)),
            "reach": calibration.coverage.reach,
        },
        "board_views": _describe_views(calibration),
        "advice": [text for _, text in advise(calibration)],
    }


def _describe_views(calibration: CameraCalibration) -> list[dict[str, Any]]:
    """Return an object for each photo. `why` is the reason against a photo that is not used; None for the others.

    A photo without a whole board has the file, the reason and no figures. `distance_m` is from the camera to the
    board's first corner, and `tilt_deg` is between the board's normal and the camera's axis.
    """
    found, reasons = calibration.found, inconsistent_views(calibration)
    rms, position, tilts = found.view_rms(), found.camera_positions(), np.degrees(found.tilts())
    views: dict[int, dict[str, Any]] = {
        i: {
            "file": calibration.photos[i].path.name,
            "rms_px": float(rms[k]),
            "used": bool(found.used[k]),
            "corners": len(calibration.views[k].uv),
            "false_corners": int((~found.kept[k]).sum()) if found.used[k] else None,
            "tilt_deg": float(tilts[k]),
            "distance_m": float(np.linalg.norm(position[k])),
            "why": reasons.get(i),
        }
        for k, i in enumerate(calibration.index)
    }
    for i, why in calibration.skipped.items():
        views[i] = {"file": calibration.photos[i].path.name, "rms_px": None, "used": False, "why": why}
    return [views[i] for i in sorted(views)]


def print_camera(calibration: CameraCalibration, console: "Console") -> None:
    """Print the number of views, the residual and the advice. The page and the JSON have all figures."""
    found, camera = calibration.found, calibration.found.camera
    console.print(
        f"{int(found.used.sum())} views of {len(calibration.photos)} photos, {camera.width}x{camera.height}: "
        f"reprojection {found.rms:.3f} px RMS"
    )
    print_advice(console, advise(calibration))


# ---- the page ----


def write_camera_report(path: Path, calibration: CameraCalibration, provenance: Mapping[str, Any]) -> None:
    """Write the page, whole or not at all; ConfigurationError if it cannot be written."""
    C = correlation(calibration.found.camera.covariance)
    strong = sorted((-abs(C[i, j]), i, j) for i in range(9) for j in range(i) if abs(C[i, j]) > _NAMED_CORRELATION)
    names = ", ".join(f"{PARAMETERS[j]} and {PARAMETERS[i]} ({C[i, j]:+.3f})" for _, i, j in strong)
    content = Content(
        title="Camera calibration",
        lead=_summary(calibration),
        headlines=_headlines(calibration),
        advice=advise(calibration),
        draw=lambda: _corners_figure(calibration),
        caption=f"Residuals of all corners, {_magnification(calibration):g} times larger. They should point anywhere. "
        "A common direction in one place is an error of the lens model. The number in a region counts the views with "
        "corners there. In a region without any, the lens is not known.",
        values="From the adjustment, with the variances of the corners estimated in each view. Correlated by more than "
        f"{_NAMED_CORRELATION}: {names or 'none'}. Of correlated values only the combination is certain.",
        legend="Blue: corners; red: corners that were not used.",
        pictures=[_thumbnail(calibration, k) for k in range(len(calibration.views))],
    )
    write_report(path, content, camera_json(calibration), provenance)


def _summary(calibration: CameraCalibration) -> str:
    """Return the first paragraph: views, board, distances and picture size."""
    found, camera, pattern = calibration.found, calibration.found.camera, calibration.pattern
    kind = "chessboard" if pattern.marker is None else "ChArUco board"
    distance = np.linalg.norm(found.camera_positions()[found.used], axis=1)
    return (
        f"{int(found.used.sum())} views of a {kind} with {pattern.columns} × {pattern.rows} inner corners, squares of "
        f"{1e3 * pattern.square:g} mm, from {distance.min():.2f} to {distance.max():.2f} m; images of {camera.width} × "
        f"{camera.height} px. It holds for this mode of the camera, this zoom and this focus, and for no other."
    )


def _headlines(calibration: CameraCalibration) -> list[tuple[str, str, str]]:
    """Return the name, value and uncertainty of each main result."""
    found, camera, sigma = calibration.found, calibration.found.camera, calibration.found.deviations
    return [
        ("focal length", f"{camera.fx:.1f} px", f"± {sigma[0]:.2f} px, {100 * sigma[0] / camera.fx:.3f} %"),
        ("principal point", f"{camera.cx:.1f}, {camera.cy:.1f}", f"± {sigma[2]:.2f}, {sigma[3]:.2f} px"),
        ("reprojection error", f"{found.rms:.3f} px", f"RMS of {sum(int(k.sum()) for k in found.kept)} corners"),
    ]


# ---- figures ----


def _corners_figure(calibration: CameraCalibration) -> "Figure":
    """Residuals of all corners in one picture, in px, and the number of views with corners in each region."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.4, 5.2), layout="constrained")
    axes, found = figure.subplots(), calibration.found
    w, h = found.camera.width, found.camera.height
    axes.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), aspect="equal", xlabel="px")
    axes.spines[["top", "right"]].set_visible(True)
    rows, columns = calibration.coverage.regions.shape
    w, h = w / columns, h / rows
    for (i, j), views in np.ndenumerate(calibration.coverage.regions):
        x, y = w * j - 0.5, h * i - 0.5
        axes.plot([x, x + w, x + w], [y + h, y + h, y], color=GRID, lw=0.6)
        if views == 0:
            axes.fill([x, x + w, x + w, x], [y, y, y + h, y + h], color=RED, alpha=0.25, lw=0)
        box = {"boxstyle": "round,pad=0.25", "facecolor": PAPER, "edgecolor": "none", "alpha": 0.9}
        look = {"ha": "center", "va": "center", "fontsize": 13, "fontweight": "bold", "bbox": box, "zorder": 3}
        axes.annotate(str(views), (x + 0.5 * w, y + 0.5 * h), color=INK if views else RED, **look)
    look = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "color": BLUE, "width": 0.0012, "alpha": 0.85}
    for view, residual, kept, used in zip(calibration.views, found.residuals, found.kept, found.used, strict=True):
        if used:
            axes.quiver(*view.uv[kept].T, *(_magnification(calibration) * residual[kept]).T, **look)
    return figure


def _magnification(calibration: CameraCalibration) -> float:
    """A round number that makes the RMS a fortieth of the picture's width."""
    return round_number(calibration.found.camera.width / 40.0 / max(calibration.found.rms, 1e-6))


def _thumbnail(calibration: CameraCalibration, k: int) -> tuple[bytes, str]:
    """Return a JPEG of view k with its corners, blue if used and red if not, and its caption."""
    photo, used = calibration.photos[calibration.index[k]], calibration.found.used[k]
    scale = _THUMBNAIL_WIDTH / photo.size[0]
    size = _THUMBNAIL_WIDTH, max(1, round(scale * photo.size[1]))
    small = cv2.resize(image(photo), size, interpolation=cv2.INTER_AREA)
    kept = calibration.found.kept[k] if used else np.zeros(len(calibration.views[k].uv), bool)
    for (u, v), good in zip(calibration.views[k].uv, kept, strict=True):
        at = round(16 * ((u + 0.5) * scale - 0.5)), round(16 * ((v + 0.5) * scale - 0.5))
        cv2.circle(small, at, 28, (176, 133, 47) if good else (61, 85, 220), -1, cv2.LINE_AA, 4)
    data = bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1])
    tilt, distance = np.degrees(calibration.found.tilts()[k]), np.linalg.norm(calibration.found.camera_positions()[k])
    remark = f"{calibration.found.view_rms()[k]:.3f} px, {tilt:.0f}° aslant, from {distance:.2f} m"
    return data, f"{photo.path.name}: {remark}" + ("" if used else ", left out")
