"""`spheremouse doctor`: the order of all checks. A check that fails ends no other."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse import capture, output
from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.detect.projection import GREY, weights_of
from spheremouse.ball.rig import Rig
from spheremouse.capture.nodes import Node, nodes
from spheremouse.commands.doctor import camera as cameras
from spheremouse.commands.doctor import computer, files, running, sight, wand
from spheremouse.commands.findings import Section
from spheremouse.commands.service import check as service
from spheremouse.commands.service.systemd import Place
from spheremouse.errors import SpheremouseError
from spheremouse.finding import Finding, Verdict, ok, refused, unchecked, wrong
from spheremouse.geometry.camera import Pose
from spheremouse.native import kernels
from spheremouse.session.cameras import is_camera, node_of
from spheremouse.session.control.status import StatusReport
from spheremouse.session.run_config import CommandLineOverrides, RunConfig
from spheremouse.session.settings import RecordSettings
from spheremouse.session.setup import Setup, open_setup

_NO_CAMERA = "v4l2:"  # the source if none is named and no camera is there
SECONDS = 2.0  # of film: sixty frames give a rate to 2 %

Progress = Callable[[str], None]


def examine(
    overrides: CommandLineOverrides,
    *,
    seconds: float = SECONDS,
    socket: Path | None = None,
    progress: Progress = lambda _: None,
) -> Iterator[Section]:
    """Yield each section when it is done. `progress` takes a line about the step in progress."""
    progress("checking the program")
    yield Section("program", tuple(_run_check("version", computer.version)))
    status, told = running.ask(socket)
    yield Section("daemon", (told, *(_run_check("state", running.check, status) if status else ())))
    there = nodes()
    usual = files.usual(overrides, status)
    plan, findings = files.read(usual, f"v4l2:{there[0].lasting or there[0].path}" if there else None)
    node = None
    if plan is None:
        yield Section("configuration", tuple(findings))
    else:
        node = None if plan.source == _NO_CAMERA else node_of(plan.source)
        run = _Run(plan, usual, node, findings)
        yield from run.examine(there, status, seconds, progress)
        for number, other in enumerate(plan.cameras[1:], 2):
            second = _Run(other, usual, node_of(other.source), [])
            for section in second.examine(there, status, seconds, progress):
                if section.subject != "output":  # that of the run
                    findings = tuple(f for f in section.findings if f.name != "map")
                    yield Section(f"{section.subject} {number}", findings)
    node = node if node is not None and node.exists() else None
    yield Section("service", tuple(_run_check("service", service.installed, node)))
    progress("checking the computer")
    record = RecordSettings() if plan is None else plan.configuration.record
    checks = (
        _run_check("disk", computer.disk, record, files.service_state(usual)),
        _run_check("memory", computer.memory),
        _run_check("scheduling", computer.scheduling, Place().unit.exists()),
        _run_check("load", computer.load),
    )
    yield Section("computer", tuple(f for check in checks for f in check))


class _Run:
    def __init__(
        self, plan: RunConfig, overrides: CommandLineOverrides, node: Path | None, findings: list[Finding]
    ) -> None:
        self.plan, self.overrides, self.node, self.findings = plan, overrides, node, findings
        self.live = is_camera(plan.source)
        self.of_wand = plan.configuration.tracker == "wand"
        self.footage: cameras.Footage | None = None
        self.brought: Setup | None = None  # camera and balls of a recording of wands

    def examine(
        self, there: list[Node], status: StatusReport | None, seconds: float, progress: Progress
    ) -> Iterator[Section]:
        camera = [_cameras(there, self.live)]
        camera += _run_check("camera", capture.probe, self.plan.source) if self.node is not None else []
        if self._is_in_use(status):
            advice = "to look through it, stop the daemon (systemctl stop spheremouse, or ctl stop) and repeat this"
            camera.append(unchecked("film", "the daemon that runs has the camera: its figures are above", advice))
        elif not any(f.verdict is Verdict.WRONG for f in camera):
            progress(f"filming {seconds:g} s with {self.plan.source}")
            camera += _run_check("film", self._film, seconds)
        picture = self._check_wand_files() if self.of_wand else self._check_rig_and_map()
        yield Section("configuration", tuple(self.findings))
        yield Section("camera", tuple(camera))
        if self.footage is not None:
            progress(f"looking for {'the ball' if self.of_wand else 'targets and discs'}")
            if findings := tuple(picture(self.footage)):
                yield Section("picture", findings)
        findings = tuple(f for spec in self.plan.outputs for f in _run_check("output", output.probe, spec))
        if not self.live and self.plan.outputs == ("null",):
            advice = "give --output KIND:ARG to have it looked at"
            findings = (unchecked("output", "none is named, and a recording needs none", advice),)
        yield Section("output", findings)

    def _is_in_use(self, status: StatusReport | None) -> bool:
        specs = [] if status is None else [status.source.spec, *(camera.spec for camera in status.cameras)]
        taken = [node.resolve() for node in map(node_of, specs) if node is not None]
        return self.node is not None and self.node.resolve() in taken

    def _film(self, seconds: float) -> Iterator[Finding]:
        """Film for some seconds, keep the footage, and yield the findings on source, rate, stamps and controls."""
        if self.of_wand and not self.live:
            self.brought = open_setup(self.plan)
        source = None if self.brought is None else self.brought.source
        self.footage = footage = cameras.film(self.plan, seconds, self.node, source)
        yield ok("source", footage.description)
        yield from _run_check("rate", cameras.rate, footage)
        yield from _run_check("stamps", cameras.stamps, footage)
        if footage.controls is not None:
            yield from _run_check("exposure", cameras.controls, footage.controls)

    def _check_wand_files(self) -> Callable[[cameras.Footage], Iterator[Finding]]:
        """Check camera file and balls, and return the check of the pictures."""
        self.findings += _run_check("camera file", wand.camera_file, self.plan, self.brought)
        if self.findings[-1].verdict is not Verdict.OK:
            return lambda _: iter(())
        tracker, found = _pair("ball", wand.tracker_of, self.plan, self.overrides, self.brought)
        self.findings.append(found)
        if tracker is None:
            return lambda _: iter(())
        return lambda footage: iter(_run_check("sight", wand.sight, footage.views, tracker))

    def _check_rig_and_map(self) -> Callable[[cameras.Footage], Iterator[Finding]]:
        """Add findings about rig (the plan's, else the recording's) and map. Return the check of the pictures by it."""
        plan, recorded = self.plan, None if self.footage is None else self.footage.rig
        if recorded is not None and plan.map_path is not None and plan.rig_path is None:
            plan = replace(plan, map_path=None)  # as in a run: such a map is of another ball
        rig = plan.rig or recorded
        rig = replace(rig, camera=plan.camera) if rig is not None and plan.camera is not None else rig
        has_errors = any(f.verdict is Verdict.WRONG for f in self.findings)  # of configuration, rig or camera file
        if has_errors and plan.rig is None and recorded is not None:
            text = "the recording's own rig is used, because the configuration has errors"
            self.findings.append(unchecked("rig", text))
        elif rig is not None or not has_errors:
            self.findings += _run_check("rig", files.rig_file, plan.rig_path, plan.rig, recorded)
        self.findings += _run_check("map", files.map_of, plan.map_path, rig, plan.configuration)
        return lambda footage: self._picture(footage, rig)

    def _picture(self, footage: cameras.Footage, rig: Rig | None) -> Iterator[Finding]:
        """Yield findings about the frames: size, targets, ball, light, discs, blur."""
        settings = self.plan.configuration
        seen: sight.Sight | None = None
        pose: Pose | None = None
        in_view = False
        if rig is None:
            yield unchecked("targets", "without a rig there is nothing to look for", "see rig, above")
        else:
            sized = files.size(rig.camera, *footage.size)
            yield sized
            if sized.verdict is Verdict.OK:
                pose, found = _pair("targets", sight.targets, footage.views, rig, settings)
                yield found
                if pose is not None:
                    seen, found = _pair("ball", sight.sight, rig, pose, settings)
                    yield found
                    in_view = seen is not None or found.verdict is not Verdict.WRONG
        seen = None if seen is None else sight.in_colours(seen, footage.views)
        projection = GREY if seen is None else seen.projection
        mask = None if rig is None or pose is None or not in_view else ball_mask(rig, pose)
        greys = [sight.grey(v.image) for v in footage.views]
        noise = _noise(footage, seen)
        yield from _run_check(
            "brightness", sight.brightness, greys, mask, sight.contrasts(settings, rig), noise, projection
        )
        if seen is not None:
            exposure = None if footage.controls is None else footage.controls.exposure_s
            exposure = exposure or settings.camera.exposure_s or seen.rig.exposure_s
            yield from _run_check("discs", sight.discs, footage.views, seen, settings.discs)
            yield from _run_check("blur", sight.blur, seen, exposure, settings.discs, seen.rig.exposure_s > 0.0)


def _cameras(nodes_found: list[Node], live: bool) -> Finding:
    """Return the finding on connected cameras; `live`: the source is one."""
    if nodes_found:
        listed = "; ".join(f"{n.path} ({n.name}){f' = {n.lasting}' if n.lasting else ''}" for n in nodes_found)
        return ok("cameras", listed, cameras=[str(n.lasting or n.path) for n in nodes_found])
    if not live:
        return ok("cameras", "no camera, and this source needs none")
    if not sys.platform.startswith("linux"):
        return unchecked("cameras", "this system does not list them by name")
    return wrong("cameras", "there is no camera", "plug a webcam in (docs/camera.md: which one); see `dmesg`")


def _noise(footage: cameras.Footage, seen: sight.Sight | None) -> float:
    if seen is not None:
        return float(np.median([seen.detector.noise(v.image) for v in footage.views]))
    images = [v.image if v.image.ndim == 3 else v.image[:, :, None] for v in footage.views]
    return float(
        np.median([kernels.noise_of(i, weights_of(GREY, i.shape[2]), 0, i.shape[0], 0, i.shape[1]) for i in images])
    )


def _run_check(name: str, check: Callable[..., Any], *given: Any) -> list[Finding]:
    """Return the findings of a check. If it fails, the last one is about its failure."""
    found: list[Finding] = []
    try:
        made = check(*given)
        found.extend([made] if isinstance(made, Finding) else made)
    except Exception as e:
        found.append(_failure(name, e))
    return found


def _pair(name: str, check: Callable[..., tuple[Any, Finding]], *given: Any) -> tuple[Any, Finding]:
    """Return the result and the finding of a check. If it fails, the result is None."""
    try:
        return check(*given)
    except Exception as e:
        return None, _failure(name, e)


def _failure(name: str, error: Exception) -> Finding:
    if isinstance(error, SpheremouseError):
        return refused(name, error)
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return wrong(name, f"this check itself failed: {what}", "please report it")
