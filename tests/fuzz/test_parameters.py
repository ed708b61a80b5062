"""Every parameter at its extremes, alone and with others, while balls are tracked.

What is accepted must work: no exception, no number that is none, and no frame that takes many times as long as with
the defaults.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from hypothesis import strategies as st

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.pose import gather, resect
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import step, with_settings
from spheremouse.errors import SpheremouseError
from spheremouse.files import config
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.output.wand_mapping import WandMapping
from spheremouse.session.settings import Configuration
from spheremouse.simulate.wand.film import WandFilm, WandOptions, prepare_wand, simulate_wand
from spheremouse.tracker import Estimate, Frame, Status
from spheremouse.wand import state as state_module
from spheremouse.wand import track as wand
from spheremouse.wand.build import build as build_wand
from tests.fuzz.extremes import extremes, numbers
from tests.fuzz.fuzzing import bounded, fuzz, refused

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"
TIMES, FLOOR = 20.0, 0.2  # a frame may take so many times as long as with the defaults; s of a core that are no matter

T = TypeVar("T")


@cache
def accepted() -> dict[str, list[str]]:
    """Of every parameter, KEY=VALUE for those of its extremes that the configuration takes alone."""
    found: dict[str, list[str]] = {}
    for key, hint, bounds, default in numbers(Configuration):
        found[key] = [a for value in extremes(hint, bounds, default) if _taken([a := f"{key}={value}"])]
    return found


def _taken(assignments: list[str]) -> bool:
    try:
        config.in_force(None, assignments, Configuration)
    except SpheremouseError:
        return False
    return True


@cache
def rounds() -> list[list[str]]:
    """All of them, those of a section together: the first of each of its parameters, the second of each, ..."""
    sections: dict[str, list[list[str]]] = {}
    for key, values in accepted().items():
        sections.setdefault(key.partition(".")[0], []).append(values)
    together = [
        [values[k % len(values)] for values in section if values]
        for section in sections.values()
        for k in range(max(map(len, section)))
    ]
    return [some for group in together for some in ([group] if _taken(group) else [[one] for one in group])]


@fuzz(
    lambda: st.lists(
        st.sampled_from(list(accepted())).flatmap(lambda key: st.sampled_from(accepted()[key] or [f"{key}=0"])),
        min_size=1,
        max_size=3,
    )
)
def test_parameters(assignments: list[str]) -> None:
    track(assignments)


def test_every_extreme() -> None:
    for assignments in rounds():
        bounded(track, assignments)


def track(assignments: list[str]) -> None:
    c = refused(lambda: config.in_force(None, assignments, Configuration))
    if c is None:
        return
    sections = {assignment.partition("=")[0].partition(".")[0] for assignment in assignments}
    if "wand" in sections or c.tracker == "wand":
        _in_a_hand(c)
        c = replace(c, tracker="so3")
    if sections & {"rings", "pose"}:
        _targets(c)
    if sections - {"wand", "rings", "pose", "camera", "pointer", "control", "record", "metrics"}:
        for tracker in ("ekf1", "ekf2") if "euler" in sections else (c.tracker,):
            _in_its_frame(replace(c, tracker=tracker, detector="blobs" if "blobs" in sections else c.detector))


def in_time(what: str, action: Callable[[], T], usual: Callable[[], Any], share: float = 1.0) -> T:
    """What the action returns; an AssertionError where it takes `TIMES` as long as the usual one (times `share`)."""
    if what not in _USUAL:
        usual()  # what is loaded or cached is so by then
        begun = time.process_time()
        usual()
        _USUAL[what] = time.process_time() - begun
    begun = time.process_time()
    result = action()
    taken = time.process_time() - begun
    most = max(TIMES * share * _USUAL[what], FLOOR)
    assert taken < most, f"{what}: {taken:.3f} s of a core, usual are {_USUAL[what]:.3f}"
    return result


_USUAL: dict[str, float] = {}


def sound(estimate: Estimate) -> None:
    assert np.all(np.isfinite(estimate.increment))
    assert np.all(np.isfinite(estimate.rate))
    assert np.all(np.isfinite(estimate.covariance))


def _targets(c: Configuration) -> None:
    rig, frames = clip()
    image, usual = frames[0].image, Configuration()
    seen = in_time(
        "targets",
        lambda: detect_targets(image, rig.targets.radii, c.rings),
        lambda: detect_targets(image, rig.targets.radii, usual.rings),
    )
    assert np.all(np.isfinite(seen.centre))
    seen = detect_targets(image, rig.targets.radii, usual.rings) if len(seen) < 3 else seen
    refused(lambda: resect(gather([seen] * c.pose.frames), rig, image))


def _in_its_frame(c: Configuration) -> None:
    """A ball tracked from a start, and with these settings from the midst of a run on."""
    rig, frames = clip()
    assert rig.pose is not None
    tracker = refused(lambda: build(rig, rig.pose, c))
    if tracker is None:
        return
    state = begin(tracker, frames[0].stamp)
    for frame in frames[:3]:
        state = _step(state, frame, tracker)
    state, tracker = with_settings(*_rolling(), c)
    for frame in frames[-3:]:
        state = _step(state, frame, tracker)


def _step(state: TrackState, frame: Frame, tracker: Tracker) -> TrackState:
    s = tracker.settings
    state, estimate, _ = in_time(f"{s.tracker}, {s.detector}", lambda: step(state, frame, tracker), lambda: as_usual(s))
    sound(estimate)
    assert np.all(np.isfinite(state.filter.covariance))
    assert np.all(np.isfinite(state.filter.attitude))
    return state


def as_usual(settings: Any) -> None:
    """A frame with the default settings, by that tracker and detector."""
    rig, frames = clip()
    assert rig.pose is not None
    tracker = build(rig, rig.pose, replace(Configuration(), tracker=settings.tracker, detector=settings.detector))
    step(begin(tracker, frames[0].stamp), frames[0], tracker)


@cache
def clip() -> tuple[Rig, list[Frame]]:
    """A device with its camera's pose, and frames in which its ball begins to roll."""
    data = open_dataset(CLIP)
    frames = list(read_frames(data))
    seen = [detect_targets(f.image, data.rig.targets.radii, Configuration().rings) for f in frames[:3]]
    pose = resect(gather(seen), data.rig, frames[0].image).pose
    return replace(data.rig, pose=pose), frames


@cache
def _rolling() -> tuple[TrackState, Tracker]:
    rig, frames = clip()
    assert rig.pose is not None
    tracker = build(rig, rig.pose, Configuration())
    state = begin(tracker, frames[0].stamp)
    for frame in frames[:-3]:
        state = step(state, frame, tracker).state
    assert state.status is Status.TRACKING
    assert state.known_to_turn
    return state, tracker


def _in_a_hand(c: Configuration) -> None:
    film, frames = hand()
    balls = tuple(carried.ball for carried in film.scene.balls)
    follow(build_wand(film.scene.camera, balls, c.wand), frames, c)


def follow(tracker: state_module.WandTracker, frames: list[Frame], c: Configuration) -> None:
    """The frames of a film of `hand` tracked, and their motion."""
    film, _ = hand()
    usual = build_wand(film.scene.camera, tuple(carried.ball for carried in film.scene.balls))
    state, mapping = wand.begin(tracker, 1, frames[0].stamp), WandMapping(c.wand.pointing)
    for frame in frames:
        found = in_time(
            "a ball in a hand",
            lambda s=state, f=frame: wand.step(s, f, tracker),
            lambda f=frame: wand.step(wand.begin(usual, 1, f.stamp), f, usual),
        )
        state = found.state
        counts, rate = mapping.counts(found.estimate)
        assert all(map(math.isfinite, (*counts, *(rate or ()))))
        for pose in state.poses:
            assert pose.position is None or np.all(np.isfinite(pose.position))
            assert pose.covariance is None or np.all(np.isfinite(pose.covariance))


@cache
def hand() -> tuple[WandFilm, list[Frame]]:
    film = prepare_wand(WandOptions(motion="hand", size=(320, 240), focal=300.0, seconds=0.27, seed=3, distance=0.6))
    return film, [shot.frame for shot in simulate_wand(film)]
