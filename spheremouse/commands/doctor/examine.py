"""`spheremouse doctor`: check everything from the camera to the pointer, and change nothing.

Each subject is a module of small functions that return findings. Here is their order. A check that fails ends no other.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse import capture, output
from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.detect.fit_model import noise_of
from spheremouse.ball.detect.projection import GREY, sample_weights_of
from spheremouse.ball.rig import Rig
from spheremouse.capture.nodes import Node, nodes
from spheremouse.commands.doctor import (
    computer,
    controls,
    files,
    installed,
    light,
    program,
    running,
    timing,
    wand,
)
from spheremouse.commands.doctor import sight as sights
from spheremouse.commands.doctor.footage import Footage, film
from spheremouse.commands.doctor.report import Section
from spheremouse.errors import SpheremouseError
from spheremouse.files.rig import with_camera
from spheremouse.finding import Finding, Verdict, ok, refused, unchecked, wrong
from spheremouse.session.cameras import node_of
from spheremouse.session.plan import Plan, Request, without_map
from spheremouse.session.wand.setup import WandSetup, wand_setup
from spheremouse.wand.state import WandTracker

_NO_CAMERA = "v4l2:"  # the source if none is named and no camera is there
SECONDS = 2.0  # of film: sixty frames give a rate to 2 % and flicker to a percent

Progress = Callable[[str], None]


def examine(
    request: Request, *, seconds: float = SECONDS, socket: Path | None = None, progress: Progress = lambda _: None
) -> Iterator[Section]:
    """Yield each section when it is done. `progress` takes a line about the step in progress."""
    progress("checking the program")
    code = _guarded("compiled code", program.compiled_code)
    if any(f.verdict is not Verdict.OK for f in code):
        show = progress
        progress = lambda text: show(f"{text} (compiling for this computer, once: about a minute)")  # noqa: E731
    yield Section("program", (*_guarded("version", program.version), *code))
    status, told = running.ask(socket)
    yield Section("daemon", (told, *(_guarded("state", running.check, status) if status else ())))
    there = nodes()
    usual = files.usual(request, status)
    plan, findings = files.read(usual, _first(there))
    if plan is None:
        yield Section("configuration", tuple(findings))
    else:
        named = bool(usual.output or plan.configuration.output)
        yield from _with_plan(plan, usual, named, findings, there, status, seconds, progress)
    node = None if plan is None else node_of(plan)
    node = node if node is not None and node.exists() else None
    yield Section("service", tuple(_guarded("service", installed.check, node)))
    yield Section("computer", tuple(_computer(plan, files.service_state(usual), progress)))


def _with_plan(
    plan: Plan,
    request: Request,
    named: bool,
    findings: list[Finding],
    there: list[Node],
    status: dict[str, Any] | None,
    seconds: float,
    progress: Progress,
) -> Iterator[Section]:
    node = None if plan.source == _NO_CAMERA else node_of(plan)
    live = plan.source.partition(":")[0] in ("v4l2", "opencv")
    camera = [_cameras(there, live)]
    camera += _guarded("camera", capture.probe, plan.source) if node is not None else []
    footage: Footage | None = None
    of_wand, brought = plan.configuration.tracker == "wand", None
    rig: Rig | None = None
    if _is_in_use(plan, status):
        camera.append(
            unchecked(
                "film",
                "the daemon that runs has the camera: its figures are above",
                "to look through it, stop the daemon (systemctl stop spheremouse, or ctl stop) and repeat this",
            )
        )
    elif not any(f.verdict is Verdict.WRONG for f in camera):
        progress(f"filming {seconds:g} s with {plan.source}")
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
        progress("looking for the ball" if of_wand else "looking for targets and discs")
        if not of_wand:
            yield Section("picture", tuple(_picture(plan, footage, rig)))
        elif tracker is not None:
            yield Section("picture", tuple(_guarded("sight", wand.sight, footage.views, tracker)))
    none = unchecked(
        "output", "none is named, and a recording needs none", "give --output KIND:ARG to have it looked at"
    )
    yield Section("output", tuple(_guarded("output", output.probe, plan.output) if named or live else [none]))


def _first(there: list[Node]) -> str | None:
    """Return the source that names the first camera."""
    return f"v4l2:{there[0].lasting or there[0].path}" if there else None


def _cameras(there: list[Node], live: bool) -> Finding:
    """List the cameras of this computer."""
    if there:
        listed = "; ".join(f"{n.path} ({n.name}){f' = {n.lasting}' if n.lasting else ''}" for n in there)
        return ok("cameras", listed, cameras=[str(n.lasting or n.path) for n in there])
    if not live:
        return ok("cameras", "there is none, and this source needs none")
    if not sys.platform.startswith("linux"):
        return unchecked("cameras", "this system does not list them by name")
    return wrong("cameras", "there is no camera", "plug a webcam in (docs/camera.md: which one); see `dmesg`")


def _filmed(
    plan: Plan, seconds: float, node: Path | None, brings: bool, camera: list[Finding]
) -> tuple[Footage | None, WandSetup | None]:
    """Film, and return the wands of a source that `brings` its own. A failure is added to `camera`."""
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
    """Return the device and its map; findings about them are added to `findings`."""
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
    """Yield findings about rate, stamps and exposure."""
    yield ok("source", footage.description)
    yield from _guarded("rate", timing.rate, footage)
    yield from _guarded("stamps", timing.stamps, footage)
    if footage.controls is not None:
        yield from _guarded("exposure", controls.check, footage.controls)


def _picture(plan: Plan, footage: Footage, rig: Rig | None) -> Iterator[Finding]:
    """Yield findings about the frames: size, targets, ball, light, discs, blur."""
    settings = plan.configuration
    seen: sights.Sight | None = None
    if rig is None:
        yield unchecked("targets", "without a rig there is nothing to look for", "see rig, above")
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
    """Return the noise in grey values, the median over the views."""
    if seen is not None:
        return float(np.median([seen.detector.noise(v.image) for v in footage.views]))
    images = [v.image if v.image.ndim == 3 else v.image[:, :, None] for v in footage.views]
    return float(
        np.median([noise_of(i, sample_weights_of(GREY, i.shape[2]), 0, i.shape[0], 0, i.shape[1]) for i in images])
    )


def _exposure(plan: Plan, footage: Footage, rig: Rig) -> float | None:
    """Return the exposure in s: of the camera, else of the settings, else of the rig."""
    if footage.controls is not None and footage.controls.exposure_s is not None:
        return footage.controls.exposure_s
    return plan.configuration.camera.exposure_s or rig.exposure_s or None


def _is_in_use(plan: Plan, status: dict[str, Any] | None) -> bool:
    """Return whether the running daemon uses the camera of this plan."""
    spec = None if status is None else (status.get("source") or {}).get("spec")
    if not spec:
        return False
    here, there = node_of(plan), node_of(replace(plan, source=spec))
    return here is not None and there is not None and here.resolve() == there.resolve()


def _computer(plan: Plan | None, state: Path | None, progress: Progress) -> list[Finding]:
    from spheremouse.commands.service.systemd import Place
    from spheremouse.session.settings.record import RecordSettings

    progress("checking the computer")
    settings = RecordSettings() if plan is None else plan.configuration.record
    return [
        *_guarded("disk", computer.disk, settings, state),
        *_guarded("memory", computer.memory),
        *_guarded("scheduling", computer.scheduling, Place().unit.exists()),
        *_guarded("load", computer.load),
    ]


def _guarded(name: str, check: Callable[..., Any], *given: Any) -> list[Finding]:
    """Return the findings of a check, or one about its failure."""
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
