"""`spheremouse evaluate --tracker wand`: run the particle filter on recordings of wands, compare with their truth.

The command line is that of `evaluate`, which hands over here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from spheremouse.commands import terminal
from spheremouse.errors import ConfigurationError, DatasetError, SpheremouseError
from spheremouse.evaluate.wand import WandHistory, followed, wand_report
from spheremouse.files import config
from spheremouse.files.dataset.wand import WandRecording, open_wand, read_wand_frames
from spheremouse.files.rig import load_camera
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.balls import read_balls, told_apart
from spheremouse.session.settings import Configuration
from spheremouse.session.wand.messages import sentence
from spheremouse.session.wand.offline import Known, track_wand
from spheremouse.wand.ball import WandBall
from spheremouse.wand.build import build
from spheremouse.wand.settings import ColourSettings, WandSettings

_NO_TRUTH = "no truth.csv to compare with: no errors are known; frames tracked and times say what can be said without"


@dataclass(frozen=True, slots=True)
class WandEvaluation:
    """Options of an evaluation."""

    datasets: list[Path]
    assignments: list[str]
    config_file: Path | None = None
    ball_files: Sequence[Path] = ()
    camera_file: Path | None = None
    known_pose: bool = False
    runs: int = 1


def evaluate_wands(asked: WandEvaluation, say: Console) -> tuple[list[dict[str, Any]], bool]:
    """Reports of the datasets, and whether one of them failed, which `say` tells."""
    if asked.runs < 1:
        raise ConfigurationError(f"--runs: must be 1 or more, is {asked.runs}")
    settings = config.in_force(asked.config_file, asked.assignments, Configuration).wand
    camera = None if asked.camera_file is None else load_camera(asked.camera_file)
    given = read_balls(asked.ball_files)
    recordings = [open_wand(path) for path in asked.datasets]
    for recording in recordings:
        if asked.known_pose and recording.truth is None:
            raise DatasetError(f"{recording.path}: no truth.csv, whose first pose --pose known takes")
    results: list[dict[str, Any]] = []
    failed = False
    for recording in recordings:
        try:
            balls = told_apart(given.balls or recording.balls)
            histories = [
                _run(recording, balls, settings, given.colours, camera, seed, asked.known_pose, say)
                for seed in range(1, asked.runs + 1)
            ]
        except SpheremouseError as e:
            terminal.error(_about(recording, str(e)))
            failed = True
            continue
        first, *more = _reports(recording, balls, histories)
        results.append({**first, "more_balls": more} if more else first)
        for line in [*_never_found(balls, histories), *([] if recording.truth is not None else [_NO_TRUTH])]:
            say.print(_about(recording, line), markup=False, highlight=False)
    return results, failed


def _reports(
    recording: WandRecording, balls: Sequence[WandBall], histories: Sequence[WandHistory]
) -> list[dict[str, Any]]:
    """Compare each ball with the ball of the film that it follows."""
    runs = [[history.run(k) for k in range(len(balls))] for history in histories]
    truths = [followed(each, balls, recording.truths, recording.balls) for each in runs]
    reports = []
    for k, ball in enumerate(balls):
        of_ball = [run[k] for run in runs]
        true = [truth for each in truths if (truth := each[k]) is not None]
        reports.append(
            wand_report(
                of_ball,
                true if len(true) == len(of_ball) else None,  # more balls than were filmed
                dataset=recording.name if k == 0 else f"{recording.name}, ball {k + 1}",
                frames=recording.frames,
                radius=ball.radius,
            )
        )
    return reports


def _never_found(balls: Sequence[WandBall], histories: Sequence[WandHistory]) -> Iterator[str]:
    """A line for each ball that a run has not found, with the reason that was given last."""
    for k, ball in enumerate(balls):
        vain = [history for history in histories if not history.run(k).found.any()]
        if vain:
            events = [e for history in vain for poses in history.poses if (e := poses[k].event) is not None]
            runs = "" if len(histories) == 1 else f" in {len(vain)} of {len(histories)} runs"
            yield f"{ball.name} was never found{runs}: {sentence(events[-1]) if events else 'nobody knows why'}"


def _run(
    recording: WandRecording,
    balls: tuple[WandBall, ...],
    settings: WandSettings,
    colours: dict[str, ColourSettings],
    camera: InteriorOrientation | None,
    seed: int,
    known_pose: bool,
    say: Console,
) -> WandHistory:
    """One run over a recording."""
    tracker = build(recording.camera if camera is None else camera, balls, settings, colours)
    known: Known | None = None
    if known_pose:
        truths = recording.truths[: len(balls)]
        known = {k: (truth.position[0], truth.rotation[0]) for k, truth in enumerate(truths)}
    history = WandHistory()
    with terminal.progress_bar() as progress:
        task = progress.add_task(f"{recording.name}, seed {seed}", total=recording.frames)
        for epoch in track_wand(read_wand_frames(recording), tracker, seed, known):
            history.add(epoch)
            progress.update(task, completed=len(history.stamps))
    if seed == 1:
        for frame, event in history.events()[:10]:
            say.print(_about(recording, f"frame {frame}: {sentence(event)}"), markup=False, highlight=False)
    return history


def _about(recording: WandRecording, message: str) -> str:
    return message if str(recording.path) in message else f"{recording.path}: {message}"
