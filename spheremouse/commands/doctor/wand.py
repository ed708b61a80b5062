"""Hand-held balls: the files of camera and balls, and the balls in the picture."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from spheremouse.commands.doctor.files import size
from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.finding import Finding, Verdict, classify, ok, refused, unchecked, wrong
from spheremouse.session.run_config import CommandLineOverrides, RunConfig, read_balls, wand_files
from spheremouse.session.settings import Configuration
from spheremouse.session.setup import Setup
from spheremouse.session.wand.messages import trouble_and_remedy
from spheremouse.tracker import Frame, Status
from spheremouse.wand.state import WandPose, WandTracker
from spheremouse.wand.track import begin, step

_MIN_FOUND = 0.5  # of the pictures: a ball before the camera is in view in most


def tracker_of(
    plan: RunConfig, overrides: CommandLineOverrides, given: Setup | None
) -> tuple[WandTracker | None, Finding]:
    """Return the tracker, None if the configuration is invalid, and a finding. `given`: the setup of a recording."""
    try:
        c = config.in_force(overrides.file, overrides.assignments, Configuration)
        balls = read_balls(wand_files(overrides.file, c))
        tracker = (given or Setup()).wand_tracker(replace(plan, balls=balls))
    except ConfigurationError as e:
        return None, refused("ball", e)
    descriptions = (f"{b.name}, {2e3 * b.radius:g} mm across, {len(b.discs)} discs" for b in tracker.balls)
    return tracker, ok("ball", "; ".join(descriptions), balls=len(tracker.balls))


def sight(views: tuple[Frame, ...], tracker: WandTracker) -> Iterator[Finding]:
    """Yield a finding about each ball: its place in the pictures, without prior knowledge, and its uncertainty."""
    height, width = views[0].image.shape[:2]
    sized = size(tracker.camera, width, height)
    yield sized
    if sized.verdict is not Verdict.OK:
        return
    if any(v.image.ndim == 2 for v in views):
        yield unchecked("sight", "the pictures are grey", "choose a format with colour: YUYV or MJPG")
        return
    state, seen = begin(tracker, seed=1), list[tuple[WandPose, ...]]()
    for view in views:
        state = step(state, view, tracker).state
        seen.append(state.poses)
    for k in range(len(tracker.balls)):
        yield _ball_finding([poses[k] for poses in seen])


def _ball_finding(poses: list[WandPose]) -> Finding:
    good = [p for p in poses if p.phase is Status.TRACKING]
    name, events = poses[0].name, [p.event for p in poses if p.event is not None]
    if not good:
        problem, advice = trouble_and_remedy(events[-1]) if events else (f"{name} is not seen", "")
        return wrong(
            "sight", problem, advice or "hold it before the camera; `spheremouse wand colours` picks its colours"
        )
    last = good[-1]
    assert last.position is not None, "a ball that is tracked has a pose"
    assert last.covariance is not None, "and its covariance"
    distance = float(np.linalg.norm(last.position))
    sigma = float(np.sqrt(np.trace(last.covariance[:3, :3])))
    seldom = len(good) < _MIN_FOUND * len(poses)
    return classify(
        "sight",
        f"{name}: found in {len(good)} of {len(poses)} pictures, last {distance:.2f} m away, "
        f"known to {1e3 * sigma:.0f} mm",
        (seldom, Verdict.WARNING, "", "more light, or other bounds: spheremouse wand colours PICTURE"),
        pictures=len(poses),
        found=len(good),
        distance_m=round(distance, 3),
        sigma_mm=round(1e3 * sigma, 1),
    )


def camera_file(plan: RunConfig, given: Setup | None) -> Finding:
    """Report the origin of the camera's interior orientation."""
    path = plan.camera_path or plan.rig_path
    if path is not None:
        return ok("camera file", str(path))
    if given is not None and given.camera is not None:
        return ok("camera file", "the source brings its own")
    advice = "give --camera FILE, or `camera_file:`; `spheremouse calibrate camera` makes one"
    return unchecked("camera file", "none is named", advice)
