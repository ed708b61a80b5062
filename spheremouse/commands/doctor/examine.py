"""`spheremouse doctor`: everything from the camera to the pointer, looked at once; nothing is changed.

Each subject is a module of small functions that return Findings; here is the order, and that no check ends the others.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.detect.fit_model import noise_of
from spheremouse.ball.detect.projection import GREY, sample_weights_of
from spheremouse.ball.rig import Rig
from spheremouse.commands.doctor import (
    computer,
    controls,
    files,
    installed,
    light,
    nodes,
    outputs,
    program,
    running,
    timing,
    wand,
)
from spheremouse.commands.doctor import sight as sights
from spheremouse.commands.doctor.finding import Finding, Section, Verdict, ok, refused, unchecked, wrong
from spheremouse.commands.doctor.footage import Footage, film
from spheremouse.errors import SpheremouseError
from spheremouse.files.rig import with_camera
from spheremouse.session.cameras import node_of
from spheremouse.session.plan import Plan, Request, without_map
from spheremouse.session.wand.setup import WandSetup, wand_setup
from spheremouse.wand.state import WandTracker

_NO_CAMERA = "v4l2:"  # source of a plan where none is named and none is there
SECONDS = 2.0  # of film: sixty frames tell a rate to 2 % and flicker to a percent

Say = Callable[[str], None]


def examine(
    request: Request, *, seconds: float = SECONDS, socket: Path | None = None, say: Say = lambda _: None
) -> Iterator[Section]:
    """Section by section, as they are done. `say` is told what takes its time."""
    say("looking at the program")
    code = _guarded("compiled code", program.compiled_code)
    if any(f.verdict is not Verdict.OK for f in code):
        tell = say
        say = lambda text: tell(f"{text} (compiling for this computer, once: about a minute)")  # noqa: E731
    yield Section("program", (*_guarded("version", program.version), *code))
    status, told = running.ask(socket)
    yield Section("daemon", (told, *(_guarded("state", running.check, status) if status else ())))
    there = nodes.nodes()
    usual = files.usual(request, status)
    plan, findings = files.read(usual, nodes.first(there))
    if plan is None:
        yield Section("configuration", tuple(findings))
    else:
        named = bool(usual.output or plan.configuration.output)
        yield from _with_plan(plan, usual, named, findings, there, status, seconds, say)
    node = None if plan is None else node_of(plan)
    node = node if node is not None and node.exists() else None
    yield Section("service", tuple(_guarded("service", installed.check, node)))
    yield Section("computer", tuple(_computer(plan, files.service_state(usual), say)))


def _with_plan(
    plan: Plan,
    request: Request,
    named: bool,
    findings: list[Finding],
    there: list[nodes.Node],
    status: dict[str, Any] | None,
    seconds: float,
    say: Say,
) -> Iterator[Section]:
    node = None if plan.source == _NO_CAMERA else node_of(plan)
    live = plan.source.partition(":")[0] in ("v4l2", "opencv")
    camera = [*_guarded("cameras", nodes.present, there, node, live)]
    camera += _guarded("camera access", nodes.permitted, node) if node is not None and node.exists() else []
    footage: Footage | None = None
    of_wand, brought = plan.configuration.tracker == "wand", None
    rig: Rig | None = None
    if _is_theirs(plan, status):
        camera.append(
            unchecked(
                "film",
                "the daemon that runs has the camera: its figures are above",
                "to look through it, stop the daemon (systemctl stop spheremouse, or ctl stop) and repeat this",
            )
        )
    elif not any(f.verdict is Verdict.WRONG for f in camera):
        say(f"filming {seconds:g} s with {plan.source}")
        footage, brought = _filmed(plan, seconds, node, of_wand and not live, camera)
    tracker: WandTracker | None = None
    if of_wand:
        findings += _guarded("camera file", wand.camera_file, plan, brought)
        if findings[-1].verdict is Verdict.OK:
            tracker, found = _pair(lambda: wand.tracker_of(plan, request, brought), "ball")
            findings.append(found)
    else:
        plan, rig = _with_rig(plan, footage, findings)
    yield Section("configuration", tuple(findings))
    if footage is not None:
        camera += _camera(footage)
    yield Section("camera", tuple(camera))
    if footage is not None:
        say("looking for the ball" if of_wand else "looking for targets and discs")
        if not of_wand:
            yield Section("picture", tuple(_picture(plan, footage, rig)))
        elif tracker is not None:
            yield Section("picture", tuple(_guarded("sight", wand.sight, footage.views, tracker)))
    none = unchecked(
        "output", "none is named, and a recording needs none", "give --output KIND:ARG to have it looked at"
    )
    yield Section("output", tuple(_guarded("output", outputs.check, plan.output) if named or live else [none]))


def _filmed(
    plan: Plan, seconds: float, node: Path | None, brings: bool, camera: list[Finding]
) -> tuple[Footage | None, WandSetup | None]:
    """Frames, and what a source that `brings` its own wands has of them; why there are none is added to `camera`."""
    brought = None
    try:
        brought = wand_setup(plan.source, realtime=False) if brings else None
        return film(plan, seconds, node, None if brought is None else brought.source), brought
    except SpheremouseError as e:
        camera.append(refused("film", e))
    except Exception as e:
        camera.append(_ours("film", e))
    return None, brought


def _with_rig(plan: Plan, footage: Footage | None, findings: list[Finding]) -> tuple[Plan, Rig | None]:
    """The device and its map, with what is to be said of them added to `findings`."""
    if footage is not None and footage.rig is not None and plan.map_path is not None and plan.rig_path is None:
        plan = without_map(plan)
    given = None if footage is None else footage.rig
    rig = plan.rig or given
    rig = with_camera(rig, plan.camera) if rig is not None and plan.camera is not None else rig
    broken = any(f.verdict is Verdict.WRONG for f in findings)
    if broken and plan.rig is None and given is not None:
        findings.append(unchecked("rig", "the source's own is taken, since not all that is named can be read"))
    elif rig is not None or not broken:
        findings += _guarded("rig", files.rig_file, plan.rig_path, plan.rig, given)
    findings += _guarded("map", files.map_of, plan.map_path, rig)
    return plan, rig


def _camera(footage: Footage) -> Iterator[Finding]:
    """Findings on how the frames came: rate, stamps, exposure."""
    yield ok("source", footage.description)
    yield from _guarded("rate", timing.rate, footage)
    yield from _guarded("stamps", timing.stamps, footage)
    if footage.controls is not None:
        yield from _guarded("exposure", controls.check, footage.controls)


def _picture(plan: Plan, footage: Footage, rig: Rig | None) -> Iterator[Finding]:
    """Findings on the frames: size, targets, ball, light, discs, blur."""
    settings = plan.configuration
    seen: sights.Sight | None = None
    if rig is None:
        yield unchecked("targets", "without a rig nobody knows what to look for", "see rig, above")
    else:
        sized = files.size(rig, *footage.size)
        yield sized
        if sized.verdict is Verdict.OK:
            pose, found = _pair(lambda: sights.targets(footage.views, rig, settings), "targets")
            yield found
            if pose is not None:
                seen, found = _pair(lambda: sights.sight(rig, pose, settings), "ball")
                yield found
    seen = None if seen is None else sights.in_colours(seen, footage.views)
    projection = GREY if seen is None else seen.projection
    mask = None if seen is None else ball_mask(seen.rig, seen.pose)
    greys = [sights.grey(v.image) for v in footage.views]
    noise = _noise(footage, seen)
    yield from _guarded("brightness", lambda: light.brightness(greys, mask, settings.discs, noise, projection))
    yield from _guarded("flicker", light.flicker, footage, mask, settings.discs)
    if seen is not None:
        sight = seen
        yield from _guarded("discs", sights.discs, footage.views, sight, settings.discs)
        exposure = _exposure(plan, footage, sight.rig)
        yield from _guarded("blur", lambda: sights.blur(sight, exposure, settings.discs, sight.rig.exposure_s > 0.0))


def _noise(footage: Footage, seen: "sights.Sight | None") -> float:
    """Grey values, the median over the views."""
    if seen is not None:
        return float(np.median([seen.detector.noise(v.image) for v in footage.views]))
    images = [v.image if v.image.ndim == 3 else v.image[:, :, None] for v in footage.views]
    return float(
        np.median([noise_of(i, sample_weights_of(GREY, i.shape[2]), 0, i.shape[0], 0, i.shape[1]) for i in images])
    )


def _exposure(plan: Plan, footage: Footage, rig: Rig) -> float | None:
    """s, as the camera tells, else as it is set, else as the rig says."""
    if footage.controls is not None and footage.controls.exposure_s is not None:
        return footage.controls.exposure_s
    return plan.configuration.camera.exposure_s or rig.exposure_s or None


def _is_theirs(plan: Plan, status: dict[str, Any] | None) -> bool:
    """Has the daemon that runs the camera that we would take?"""
    spec = None if status is None else (status.get("source") or {}).get("spec")
    if not spec:
        return False
    here, there = node_of(plan), node_of(replace(plan, source=spec))
    return here is not None and there is not None and here.resolve() == there.resolve()


def _computer(plan: Plan | None, state: Path | None, say: Say) -> list[Finding]:
    from spheremouse.commands.service.systemd import Place
    from spheremouse.session.settings.record import RecordSettings

    say("looking at the computer")
    settings = RecordSettings() if plan is None else plan.configuration.record
    return [
        *_guarded("disk", computer.disk, settings, state),
        *_guarded("memory", computer.memory),
        *_guarded("scheduling", computer.scheduling, Place().unit.exists()),
        *_guarded("load", computer.load),
    ]


def _guarded(name: str, check: Callable[..., Any], *given: Any) -> list[Finding]:
    """Findings of a check; one of its own where it fails."""
    try:
        made = check(*given)
    except SpheremouseError as e:
        return [refused(name, e)]
    except Exception as e:
        return [_ours(name, e)]
    return [made] if isinstance(made, Finding) else list(made)


def _pair(check: Callable[[], tuple[Any, Finding]], name: str) -> tuple[Any, Finding]:
    try:
        return check()
    except SpheremouseError as e:
        return None, refused(name, e)
    except Exception as e:
        return None, _ours(name, e)


def _ours(name: str, error: Exception) -> Finding:
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return wrong(name, f"this check itself failed: {what}", "please report it")
