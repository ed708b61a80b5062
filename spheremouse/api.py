"""The functions of `import spheremouse as sm`. docs/python.md describes them."""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from spheremouse.ball.rig import Rig
from spheremouse.capture import Source, Stream
from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.files.dataset import ball
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import WandRecording, is_wand, open_wand
from spheremouse.files.rig import load_rig as _load_rig
from spheremouse.output.sample import Sample
from spheremouse.session import evaluate as evaluation
from spheremouse.session import offline
from spheremouse.session.run_config import RunConfig, with_distinct_names
from spheremouse.session.settings import Configuration
from spheremouse.session.setup import Setup
from spheremouse.session.tracker_adapter import here
from spheremouse.wand.build import build

Recording = ball.Recording | WandRecording

_log = logging.getLogger("spheremouse").info


def open_dataset(path: str | Path) -> Recording:
    """Return the description of a recording of either tracker, with its truth if it has one.

    It can be tracked any number of times. Raises DatasetError if the folder has no valid recording.
    """
    return open_wand(Path(path)) if is_wand(path) else ball.open_dataset(path)


def load_rig(path: str | Path) -> Rig:
    """Return the calibrated device of a rig file. Raises ConfigurationError with a line for each problem."""
    return _load_rig(Path(path))


def load_configuration(path: str | Path | None = None, *assignments: str) -> Configuration:
    """Return the settings of a configuration file, or the defaults, with assignments such as "so3.levels=3".

    Raises ConfigurationError with file and line.
    """
    return config.in_force(None if path is None else Path(path), assignments, Configuration)


def track(
    source: Source | Recording, rig: Rig | None = None, settings: Configuration | None = None
) -> Iterator[Sample]:
    """Yield a sample for each ball and frame, from the first frame that shows where the camera is.

    `rig` replaces that of the source. Of the settings, source, output, files and map do not count. By default a
    recording of a hand-held ball is tracked as such, and any other source as a ball in its frame. The caller closes a
    source.

    Raises ConfigurationError if the source does not match the settings or has no rig, and PoseError or SourceError if
    the recording ends before anything was tracked.
    """
    name = "source"
    if isinstance(source, WandRecording):
        name, setup = str(source.path), Setup(Stream(read_frames(source)), source.camera, source.balls)
        settings = _settings_for(source, settings)
    elif isinstance(source, ball.Recording):
        name, setup = str(source.path), Setup(Stream(read_frames(source), source.rig))
        settings = _settings_for(source, settings)
    else:
        setup, settings = Setup(source), settings or Configuration()
    return _samples(
        setup, RunConfig(settings, name, (), rig, rig_path=None, camera=None, camera_path=None, map_path=None)
    )


def _settings_for(recording: Recording, given: Configuration | None) -> Configuration:
    """Return the given settings, or the defaults of the recording's tracker. ConfigurationError for another tracker."""
    of_wand = isinstance(recording, WandRecording)
    settings = given or Configuration(tracker="wand" if of_wand else "so3")
    if of_wand is not (settings.tracker == "wand"):
        raise ConfigurationError(
            f"{recording.path}: tracker {settings.tracker} cannot track this recording",
            f"use tracker={'wand' if of_wand else 'so3'}",
        )
    return settings


def _samples(setup: Setup, plan: RunConfig) -> Iterator[Sample]:
    """Yield the samples of a plan; those of a ball in its frame have their observation."""
    source = setup.source
    assert source is not None
    adapter = setup.adapter(plan, _log, here)
    frames = iter(source) if source.live else adapter.begin(iter(source))
    for tracked in offline.results(frames, adapter):
        for sample in tracked.samples:
            yield replace(sample, observation=adapter.observation(tracked))
    if (failure := adapter.failure("")) is not None:
        raise failure


def smooth(samples: Iterable[Sample], settings: Configuration | None = None) -> list[Sample]:
    """Return samples of `track` with estimates given all of them, also the later ones.

    It is the fixed-interval smoother of Rauch, Tung and Striebel (1965), for a ball in its frame and tracker so3. Give
    it the settings of `track`. Raises ConfigurationError for other samples.
    """
    return offline.smooth_samples(samples, (settings or Configuration()).so3)


def evaluate(
    recording: Recording, rig: Rig | None = None, settings: Configuration | None = None, *, smooth: bool = False
) -> dict[str, Any]:
    """Track a recording, and return the report of `spheremouse evaluate --json` with its errors.

    With `smooth` it is the report of the smoother, for a ball in its frame and tracker so3. Values are None without a
    truth. For hand-held balls `rig` has no effect. Raises SpheremouseError if the recording cannot be tracked.
    """
    settings = _settings_for(recording, settings)
    if smooth and settings.tracker != "so3":
        raise ConfigurationError(f"smooth: there is no smoother for tracker {settings.tracker}", "use so3")
    if isinstance(recording, WandRecording):
        balls = with_distinct_names(recording.balls)
        tracker = build(recording.camera, balls, settings.wand)
        return evaluation.wand_reports(recording, balls, [evaluation.run_wand(read_frames(recording), tracker)])
    frames, device = evaluation.numbered_frames(recording), evaluation.rig_of(recording, rig)
    run = evaluation.run_ball(frames, device, settings)
    return evaluation.ball_reports(run, recording, smooth)[-1]
