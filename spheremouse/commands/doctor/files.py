"""The files of a run: configuration, rig, camera and map. A broken one is a finding, and the rest is checked."""

import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from spheremouse.ball.build import map_kind
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.capture import full_spec
from spheremouse.commands.options import one_or_all
from spheremouse.commands.service.systemd import Place
from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.files.ball_map import age, check_fits, load_map, map_path
from spheremouse.files.yaml import read_document
from spheremouse.finding import Finding, Verdict, classify, ok, refusals, unchecked, warning, wrong
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.cameras import is_camera
from spheremouse.session.control.status import StatusReport
from spheremouse.session.run_config import CommandLineOverrides, RunConfig, read_run_config
from spheremouse.session.settings import Configuration

_DAY_S = 86400.0  # s


def usual(overrides: CommandLineOverrides, status: StatusReport | None) -> CommandLineOverrides:
    """Return the request. If it names nothing, return that of the running daemon, else that of the service."""
    if overrides != CommandLineOverrides():
        return overrides
    if status is not None:
        outputs = tuple(output.spec for output in status.outputs)
        named = {"source": status.source.spec, "output": outputs, "rig": status.rig, "map": status.map}
        settings = config.assignments({key: value for key, value in named.items() if value is not None})
        file = None if status.config is None else Path(status.config)
        return CommandLineOverrides(file, settings, no_map=status.map is None)
    places = [Place(user=u).configuration / "config.yaml" for u in (False, True)]
    return replace(overrides, file=next((p for p in places if os.access(p, os.R_OK)), None))


def service_state(overrides: CommandLineOverrides) -> Path | None:
    """Return the service's folder of map and recordings; None if the configuration is not that of the service."""
    place = Place()
    return place.state if overrides.file == place.configuration / "config.yaml" else None


def read(overrides: CommandLineOverrides, camera: str | None) -> tuple[RunConfig | None, list[Finding]]:
    """Return as much of the plan as can be read, or None, and the problems. `camera` is the source if none is named.

    Hand-held balls are not read here: they have a finding of their own.
    """
    findings: list[Finding] = []
    given = (*overrides.assignments, "wand.balls=[]")
    attempts = [
        replace(overrides, assignments=given),
        replace(overrides, assignments=(*given, "rig=null", "camera_file=null"), no_map=True),
        CommandLineOverrides(assignments=tuple(a for a in given if config.key_of(a) in ("source", "output"))),
    ]
    plan: RunConfig | None = None
    for attempt in attempts:
        try:
            plan = read_run_config(_with_defaults(attempt, camera))
            break
        except ConfigurationError as e:
            findings += [f for f in refusals("configuration", e) if f not in findings]
    if not findings:
        where = "none: built-in parameters" if overrides.file is None else str(overrides.file)
        findings.append(ok("configuration", where))
    return None if plan is None else _as_the_service(plan, overrides), findings


def _as_the_service(plan: RunConfig, overrides: CommandLineOverrides) -> RunConfig:
    """Return the plan with the service's own map folder: the service may not write beside the rig."""
    state = service_state(overrides)
    if state is None or plan.rig_path is None or plan.rig is None:
        return plan
    usual_map = map_path(plan.rig_path, map_kind(plan.rig, plan.configuration))
    if plan.map_path != usual_map:
        return plan
    return replace(plan, map_path=state / usual_map.name)


def _with_defaults(overrides: CommandLineOverrides, camera: str | None) -> CommandLineOverrides:
    """Return the request with a source and an output, which a plan needs."""
    c = config.in_force(overrides.file, overrides.assignments, Configuration)
    sources = c.sources or (camera or "v4l2:",)
    output = c.outputs or ("auto" if is_camera(full_spec(sources[0])) else "null",)
    settings = config.assignments({"source": one_or_all(sources), "output": output})
    return replace(overrides, assignments=(*overrides.assignments, *settings))


def rig_file(path: Path | None, rig: Rig | None, given: Rig | None) -> Finding:
    """Report the rig and its age; `given` is that of a recording."""
    if rig is None and given is not None:
        return ok("rig", "the source brings its own")
    if rig is None or path is None:
        advice = "calibrate (`spheremouse calibrate next`), or give --rig FILE, or `rig:` in the configuration"
        return unchecked("rig", "no rig yet: the pictures cannot be measured", advice)
    made, verb = _calibration_time(path)
    days = (datetime.now(UTC) - made).total_seconds() / _DAY_S
    targets = f"{len(rig.targets.codes)} targets" if rig.pose is None else "the camera's pose"
    diameter = "unknown size" if rig.scale_free else f"{2.0 * rig.ball.radius:.3g} m"
    when = age(made) if days > -1.0 else f"{-days:.0f} days from now"
    text = f"{path}: {verb} {when}; {targets}, ball of {diameter}"
    return classify(
        "rig",
        text,
        (days <= -1.0, Verdict.WARNING, "", "set this computer's clock"),
        age_days=round(days, 1),
        targets=len(rig.targets.codes),
    )


def size(camera: InteriorOrientation, width: int, height: int) -> Finding:
    """Compare the size of the pictures with that of the calibration."""
    calibrated = camera.width, camera.height
    values: dict[str, Any] = {"calibrated_px": list(calibrated), "pictures_px": [width, height]}
    if (width, height) != calibrated:
        calibration = f"{calibrated[0]}x{calibrated[1]}"
        text = f"pictures of {width}x{height}, but the camera was calibrated at {calibration}"
        return wrong("size", text, f"set camera.size: {list(calibrated)}, or calibrate at this size", **values)
    return ok("size", f"{width}x{height}, as calibrated", **values)


def map_of(path: Path | None, rig: Rig | None, settings: Settings) -> Finding:
    """Report the map of the ball, which the tracker learns while the ball turns."""
    if path is None:
        none = "none is kept for this source"
        return ok("map", none if rig is not None else "none yet: it is learnt once there is a rig file")
    if not path.exists():
        return ok("map", f"{path}: does not exist yet; the tracker creates it as the ball turns")
    try:
        saved = load_map(path)
        if rig is not None:
            check_fits(saved, rig, path, map_kind(rig, settings))
    except ConfigurationError as e:
        return warning("map", *str(e).partition("; ")[::2])
    return ok("map", f"{path}: {saved.map.text}, saved {age(saved.saved)}", known=round(saved.map.amount))


def _calibration_time(path: Path) -> tuple[datetime, str]:
    """Return the time of a rig's calibration, from its contents, else that of its file."""
    data = read_document(path).data
    try:
        made = datetime.fromisoformat(data["provenance"]["date"])
    except (TypeError, KeyError, ValueError):
        return datetime.fromtimestamp(path.stat().st_mtime, UTC), "written"
    return made if made.tzinfo is not None else made.replace(tzinfo=UTC), "calibrated"
