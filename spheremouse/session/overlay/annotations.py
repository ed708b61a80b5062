"""The marks of a frame as plain data, for live pictures, overlays and MCAP files; docs/control.md lists the keys."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from spheremouse.ball.detect.appearance import appearance, ball_outline
from spheremouse.ball.detect.lookalikes import MASK_RADIUS_PX
from spheremouse.ball.detect.rings import TargetDetections
from spheremouse.ball.points import directions_at
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.geometry.camera import InteriorOrientation, Pose, ellipse_to_pixel, project_circle, sphere_outline
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Status

if TYPE_CHECKING:
    from spheremouse.wand.ball import WandBall
    from spheremouse.wand.state import WandPose

Plain = dict[str, Any]


def plain(sequence: int | None, status: Status, **marks: Any) -> Plain:
    """Return annotations with these marks and no others."""
    none: Plain = {key: [] for key in ("outline", "detected", "predicted", "targets", "masked", "strangers")}
    return {"sequence": sequence, "status": str(status), **none, **marks}


def of_still(rig: Rig, pose: Pose) -> Plain:
    """Return the ball's outline, and the targets at their predicted places."""
    marks: Plain = {"outline": _points(ball_outline(rig, pose)[::2]), "targets": []}
    if rig.targets.codes:
        points = pose.to_cam(rig.targets.position)
        normal = np.broadcast_to(pose.rotation.T @ rig.targets.normal, points.shape)
        _, shape = ellipse_to_pixel(*project_circle(points, normal, float(rig.targets.radii[-1])), rig.camera)
        for code, place, s in zip(rig.targets.codes, predict_targets(pose, rig), shape, strict=True):
            if np.isfinite(place).all():
                marks["targets"].append(_target(code, place, s))
    return marks


def of_targets(seen: TargetDetections, codes: tuple[str, ...]) -> Plain:
    """Return detected targets, those outside the rig's `codes` as strangers."""
    targets, strangers = [], []
    for code, centre, radius in zip(seen.codes, seen.centre, seen.radius, strict=True):
        if code in codes:
            targets.append(_target(code, centre, radius**2 * np.eye(2)))
        else:
            x, y, r = np.round([*centre, radius], 2).tolist()
            strangers.append({"code": code, "x": x, "y": y, "radius": r})
    return {"targets": targets, "strangers": strangers}


def of_discs(state: TrackState, tracker: Tracker, interval: float) -> Plain:
    """Return detected, predicted and masked discs; none predicted if the ball is lost.

    Only discs whose whole rim faces the camera are returned. A gate is that of the next frame, `interval` s later.
    """
    rig, pose = replace(tracker.rig, disc_radius=tracker.detector.mark_radius(tracker.rig)), tracker.pose
    centre = state.detections.centre[state.points.index]
    directions, which = directions_at(centre, rig, pose)
    seen = appearance(directions, rig, pose)
    which = which[seen.whole]
    used = np.isin(which, state.filter.used).tolist()
    discs = np.asarray(state.filter.discs, dtype=float).reshape(-1, 3)
    discs = discs[:0] if state.status is Status.LOST else discs
    expected = appearance(discs @ state.filter.attitude.T, rig, pose)
    shape, known = expected.shape[expected.whole], np.flatnonzero(expected.whole)
    gate_factor = tracker.filter.gate_radius(state.filter, known, interval) / rig.disc_angle
    gates = _shapes(shape * (gate_factor**2)[:, None, None])
    detected = _ellipses(centre[which], seen.shape[seen.whole])
    predicted = _ellipses(expected.centre[expected.whole], shape)
    return {
        "detected": [{**disc, "used": u} for disc, u in zip(detected, used, strict=True)],
        "predicted": [{**disc, "gate": gate} for disc, gate in zip(predicted, gates, strict=True)],
        "masked": _points(_masked_places(state)),
    }


def _masked_places(state: TrackState) -> Array:
    """Return the detections set aside as look-alikes, (k, 2) px."""
    offset = state.detections.centre[:, None] - state.lookalikes.masks[None]
    near = np.linalg.norm(offset, axis=2) < MASK_RADIUS_PX
    near[state.points.index] = False
    return state.detections.centre[near.any(axis=1)]


def of_balls(balls: Iterable["tuple[WandBall, WandPose]"], points: int, camera: InteriorOrientation) -> Plain:
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


def _whole_discs(
    ball: "WandBall", position: Array, rotation: Array, camera: InteriorOrientation
) -> tuple[Array, Array]:
    """Return centres (k, 2) px and shapes (k, 2, 2) px² of the discs whose rims face the camera as a whole."""
    angle = np.array([disc.angle for disc in ball.discs])
    normal = np.array([disc.direction for disc in ball.discs]).reshape(-1, 3) @ rotation.T
    distance = np.linalg.norm(position)
    whole = -normal @ position > np.cos(np.arccos(ball.radius / distance) - angle) * distance
    normal, angle = normal[whole], angle[whole]
    centre = position + ball.radius * np.cos(angle)[:, None] * normal
    return ellipse_to_pixel(*project_circle(centre, normal, ball.radius * np.sin(angle)), camera)


def _target(code: str, centre: Array, shape: Array) -> Plain:
    (ellipse,) = _ellipses(centre[None], shape[None])
    return {"code": code, **ellipse}


def _ellipses(centre: Array, shape: Array) -> list[Plain]:
    places = np.round(centre, 2).tolist()
    return [{"x": x, "y": y, "shape": s} for (x, y), s in zip(places, _shapes(shape), strict=True)]


def _shapes(shape: Array) -> list[list[float]]:
    """Return xx, xy, yy of each shape, (n, 2, 2) px²."""
    return np.round(shape.reshape(-1, 4)[:, [0, 1, 3]], 2).tolist()


def _points(points: Array) -> list[list[float]]:
    return np.round(points[np.isfinite(points).all(axis=1)], 2).tolist()
