"""The marks of a frame as plain data for live pictures; docs/control.md lists the keys."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from spheremouse.ball.detect.rings import TargetDetections
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.geometry.camera import InteriorOrientation, ellipse_to_pixel, project_circle, sphere_outline
from spheremouse.geometry.rotation import Array
from spheremouse.session.overlay.marks import Mark, StillMarks, detected, masked, predicted
from spheremouse.tracker import Status
from spheremouse.wand.ball import WandBall
from spheremouse.wand.state import WandPose

Plain = dict[str, Any]


def plain(sequence: int | None, status: Status, **marks: Any) -> Plain:
    """Return annotations with these marks and no others."""
    none: Plain = {key: [] for key in ("outline", "detected", "predicted", "targets", "masked", "strangers")}
    return {"sequence": sequence, "status": str(status), **none, **marks}


def of_still(still: StillMarks) -> Plain:
    """Return the ball's outline and the targets."""
    return {"outline": _points(still.outline[::2]), "targets": [_target(mark) for mark in still.targets]}


def of_targets(seen: TargetDetections, codes: tuple[str, ...]) -> Plain:
    """Return detected targets, those outside the rig's `codes` as strangers."""
    targets, strangers = [], []
    for code, centre, radius in zip(seen.codes, seen.centre, seen.radius, strict=True):
        if code in codes:
            targets.append(_target(Mark(code, centre, radius**2 * np.eye(2))))
        else:
            x, y, r = np.round([*centre, radius], 2).tolist()
            strangers.append({"code": code, "x": x, "y": y, "radius": r})
    return {"targets": targets, "strangers": strangers}


def of_discs(state: TrackState, tracker: Tracker, interval: float) -> Plain:
    """Return detected, predicted and masked discs. A gate is that of the next frame, `interval` s later."""
    found, known = detected(state, tracker), predicted(state, tracker)
    angle = tracker.rig.disc_radius / tracker.rig.ball.radius
    wider = (tracker.filter.gate_radius(state.filter, known.discs, interval) / angle) ** 2
    gates = _shapes(known.shape * wider[:, None, None])
    return {
        "detected": [
            {**disc, "used": used}
            for disc, used in zip(_ellipses(found.centre, found.shape), found.used.tolist(), strict=True)
        ],
        "predicted": [
            {**disc, "gate": gate} for disc, gate in zip(_ellipses(known.centre, known.shape), gates, strict=True)
        ],
        "masked": _points(masked(state)),
    }


def of_balls(balls: Iterable[tuple[WandBall, WandPose]], points: int, camera: InteriorOrientation) -> Plain:
    """Return outlines and discs of balls in a hand. The ball `points` has the outline, the others have `others`."""
    marks: Plain = {"detected": [], "predicted": [], "others": []}
    for k, (ball, pose) in enumerate(balls):
        p, R = pose.position, pose.rotation
        if p is None or R is None or p[2] <= ball.radius:
            continue
        outline = _points(sphere_outline(p, ball.radius, camera, 90))
        if k == points:
            marks["outline"] = outline
        else:
            marks["others"].append(outline)
        discs = _ellipses(*_whole_discs(ball, p, R, camera))
        if pose.seen:
            marks["detected"] += [{**disc, "used": True} for disc in discs]
        else:
            marks["predicted"] += [{**disc, "gate": disc["shape"]} for disc in discs]
    return marks


def _whole_discs(ball: WandBall, position: Array, rotation: Array, camera: InteriorOrientation) -> tuple[Array, Array]:
    """Return centres (k, 2) px and shapes (k, 2, 2) px² of the discs whose rims face the camera as a whole."""
    angle = np.array([disc.angle for disc in ball.discs])
    normal = np.array([disc.direction for disc in ball.discs]).reshape(-1, 3) @ rotation.T
    distance = np.linalg.norm(position)
    whole = -normal @ position > np.cos(np.arccos(ball.radius / distance) - angle) * distance
    normal, angle = normal[whole], angle[whole]
    centre = position + ball.radius * np.cos(angle)[:, None] * normal
    return ellipse_to_pixel(*project_circle(centre, normal, ball.radius * np.sin(angle)), camera)


def _target(mark: Mark) -> Plain:
    (ellipse,) = _ellipses(mark.centre[None], mark.shape[None])
    return {"code": mark.code, **ellipse}


def _ellipses(centre: Array, shape: Array) -> list[Plain]:
    places = np.round(centre, 2).tolist()
    return [{"x": x, "y": y, "shape": s} for (x, y), s in zip(places, _shapes(shape), strict=True)]


def _shapes(shape: Array) -> list[list[float]]:
    """Return xx, xy, yy of each shape, (n, 2, 2) px²."""
    return np.round(shape.reshape(-1, 4)[:, [0, 1, 3]], 2).tolist()


def _points(points: Array) -> list[list[float]]:
    return np.round(points[np.isfinite(points).all(axis=1)], 2).tolist()
