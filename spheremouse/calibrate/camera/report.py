"""What `calibrate camera` found: figures for programs, text for the terminal, a page with pictures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.calibrate.camera.advice import advise
from spheremouse.calibrate.camera.bundle import PARAMETERS
from spheremouse.calibrate.camera.calibrate import Calibrated, false_views
from spheremouse.calibrate.camera.coverage import LEANS
from spheremouse.calibrate.camera.figures import (
    arrows_figure,
    coverage_figure,
    magnification,
    scatter_figure,
    small_picture,
    stands_figure,
    tilt_figure,
    views_figure,
)
from spheremouse.files.atomic import write_atomically
from spheremouse.files.report import page
from spheremouse.files.report.style import styled
from spheremouse.geometry.camera import interior_vector
from spheremouse.geometry.rotation import Array, hat, log

_CORRELATED = 0.98  # from which on two unknowns are named
_PIXELS = ("fx", "fy", "cx", "cy")


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
        "held_out_px": held_out_rms(done),
        "contradiction": found.contradiction,
        "coverage": {
            "regions": done.coverage.regions.tolist(),
            "leans": dict(zip(LEANS, done.coverage.leans.tolist(), strict=True)),
            "reach": done.coverage.reach,
        },
        "board_views": [views[i] for i in sorted(views)],
        "advice": [text for _, text in advise(done)],
    }


def write_camera_report(path: Path, done: Calibrated, provenance: Mapping[str, Any]) -> None:
    """The page, whole or not at all; ConfigurationError where it cannot be written."""
    with styled():
        write_atomically(path, _page(done, provenance))


def _page(done: Calibrated, provenance: Mapping[str, Any]) -> str:
    blocks = [
        page.numbers(_headlines(done)),
        page.advice(advise(done)),
        _coverage_section(done),
        _residual_section(done),
        page.section(
            "Where the camera stood",
            page.figure(
                stands_figure(done),
                "The board and, in its frame, the camera's places and viewing directions, from two sides. "
                "The coloured axes are three squares long.",
            ),
        ),
        _value_section(done),
        _view_section(done),
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
    return page.page("Camera calibration", _lead(done), blocks, foot)


def _lead(done: Calibrated) -> str:
    """What was photographed, and what the calibration holds for."""
    found, camera, pattern = done.found, done.found.camera, done.pattern
    kind = "chessboard" if pattern.marker is None else "ChArUco board"
    distance = np.linalg.norm(found.camera_positions()[found.used], axis=1)
    return (
        f"{int(found.used.sum())} views of a {kind} with {pattern.columns} × {pattern.rows} inner corners, squares of "
        f"{1e3 * pattern.square:g} mm, from {distance.min():.2f} to {distance.max():.2f} m; images of {camera.width} × "
        f"{camera.height} px. It holds for this mode of the camera, this zoom and this focus, and for no other."
    )


def _headlines(done: Calibrated) -> list[tuple[str, str, str]]:
    found, camera, sigma = done.found, done.found.camera, done.found.deviations
    held = held_out_rms(done)
    return [
        ("focal length", f"{camera.fx:.1f} px", f"± {sigma[0]:.2f} px, {100 * sigma[0] / camera.fx:.3f} %"),
        ("principal point", f"{camera.cx:.1f}, {camera.cy:.1f}", f"± {sigma[2]:.2f}, {sigma[3]:.2f} px"),
        ("reprojection error", f"{found.rms:.3f} px", f"RMS of {sum(int(k.sum()) for k in found.kept)} corners"),
        ("views held out", "–" if held is None else f"{held:.3f} px", "RMS, calibrated without them"),
    ]


def _coverage_section(done: Calibrated) -> str:
    return page.section(
        "What the views cover",
        page.beside(
            page.figure(
                coverage_figure(done),
                "All corners in the picture. The number in a region counts the views that show corners there; "
                "where there are none, the lens is not known.",
            ),
            page.figure(
                tilt_figure(done),
                "Where the printed face points, seen from the camera: the farther from the middle, the more the "
                "board was tilted. Views in all four quarters are best.",
            ),
        ),
    )


def _residual_section(done: Calibrated) -> str:
    return page.section(
        "Reprojection errors",
        page.figure(
            views_figure(done),
            "Root mean square distance of the corners seen from where the camera found puts them, per view; and "
            "the same where the camera was calibrated without that view. Bars that stand out are bad photos.",
        ),
        page.beside(
            page.figure(
                arrows_figure(done),
                f"Residuals of all views in one picture, {magnification(done):.0f} times enlarged. They should "
                "point anywhere; a common direction in one place is what the lens model does not explain.",
            ),
            page.figure(
                scatter_figure(done),
                "All residuals from one origin, with the circle of the RMS. A round cloud is random error.",
            ),
        ),
    )


def _value_section(done: Calibrated) -> str:
    found = done.found
    text = "From the inverse normal matrix of the adjustment, with the variances of the corners estimated in each view."
    if found.contradiction > 1.0:
        text += f" Widened by {np.sqrt(found.contradiction):.2f} because views contradict each other."
    return page.section(
        "Values and standard deviations",
        page.table(["", "value", "std. dev.", "value / std. dev."], parameter_rows(done)),
        page.paragraph(text),
        page.correlations(PARAMETERS, found.correlation()[:9, :9]),
        page.paragraph(_correlated(done)),
    )


def _view_section(done: Calibrated) -> str:
    head, rows = ["view", "RMS, px", "held out, px", "tilt, °", "distance, m", "remark"], view_rows(done)
    return page.section(
        "Views",
        page.table(head, [row for row, _ in rows], [not good for _, good in rows]),
        page.sheet([small_picture(done, k) for k in range(len(done.views))]),
    )


# ---- tables ----


_POSE_HEAD = ["view", "x, mm", "y, mm", "z, mm", "± mm", "r x, °", "r y, °", "r z, °", "± °"]


def held_out_rms(done: Calibrated) -> float | None:
    """RMS over all views held out, px."""
    good = done.held_out[np.isfinite(done.held_out)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def parameter_rows(done: Calibrated) -> list[list[str]]:
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


def view_rows(done: Calibrated) -> list[tuple[list[str], bool]]:
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
