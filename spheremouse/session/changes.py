"""What differs between the plan that is followed and another one, and what each was read from."""

from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.ball.settings import Settings
from spheremouse.session.plan import Plan, Request
from spheremouse.wand.settings import WandSettings

AT_START = ("control", "metrics", "realtime")  # what is read at the start only


def stamps_of(request: Request, plan: Plan) -> dict[Path, int]:
    """When the files that a plan was read from were last written."""
    found: dict[Path, int] = {}
    for path in (request.file, plan.rig_path, plan.camera_path, *plan.ball_paths):
        if path is not None:
            try:
                found[path] = path.stat().st_mtime_ns
            except OSError:
                found[path] = 0
    return found


def stages_of(plan: Plan) -> tuple[str, str]:
    """What is compiled for a plan."""
    return plan.configuration.tracker, plan.configuration.detector


def latest(assignments: tuple[str, ...]) -> tuple[str, ...]:
    """The last assignment to each key, in their order: however often something is set, no more is kept."""
    last = {a.partition("=")[0].strip(): k for k, a in enumerate(assignments)}
    return tuple(a for k, a in enumerate(assignments) if last[a.partition("=")[0].strip()] == k)


def differences(before: Plan, now: Plan) -> list[str]:
    """What has changed, in the words of the configuration; of what the tracker in use does not read, nothing."""
    a, b = before.configuration, now.configuration
    if b.tracker == "wand":
        tuned = any(getattr(a.wand, f) != getattr(b.wand, f) for f in (*WandSettings.__dataclass_fields__, "points"))
        moved, axes = a.wand.pointing != b.wand.pointing, a.wand.axes != b.wand.axes
    else:
        tuned = any(getattr(a, f) != getattr(b, f) for f in Settings.__dataclass_fields__)
        moved, axes = a.motion != b.motion, False
    found = {
        "tracker": tuned,
        "source": before.source != now.source or a.camera != b.camera,
        "output": before.output != now.output,
        "axes": axes,
        "rig": before.rig_path != now.rig_path
        or not _same(before.rig, now.rig)
        or not _same(before.camera, now.camera),
        "map": before.map_path != now.map_path,
        "balls": before.ball_paths != now.ball_paths or not _same(before.balls, now.balls),
        "motion": moved,
    }
    for name in ("pointer", "record", *AT_START):
        found[name] = getattr(a, name) != getattr(b, name)
    return [name for name, other in found.items() if other]


def _same(a: Any, b: Any) -> bool:
    """Are two devices, of nested dataclasses with arrays, equal?"""
    if a is None or b is None:
        return a is b
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if isinstance(a, tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(_same, a, b))
    if hasattr(type(a), "__dataclass_fields__"):
        return type(a) is type(b) and all(_same(getattr(a, f), getattr(b, f)) for f in type(a).__dataclass_fields__)
    return bool(a == b)
