"""`spheremouse evaluate --tracker wand`: run the particle filter on recordings of wands, compare with their truth."""

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console

from spheremouse.commands import terminal
from spheremouse.commands.evaluate import Options, about
from spheremouse.errors import DatasetError, SpheremouseError
from spheremouse.evaluation.table import consistency, wand_table
from spheremouse.evaluation.wand import WandHistory
from spheremouse.files import config
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import open_wand
from spheremouse.files.rig import load_camera
from spheremouse.session.evaluate import run_wand, wand_reports
from spheremouse.session.offline import Known
from spheremouse.session.run_config import read_balls, with_distinct_names
from spheremouse.session.settings import Configuration
from spheremouse.session.wand.messages import sentence
from spheremouse.wand.ball import WandBall
from spheremouse.wand.build import build

_NO_TRUTH = "no truth.csv: no errors are known; the table has the frames tracked and times"
_MAX_EVENTS = 10  # printed of the first run


def evaluate_wands(options: Options, out: Console, err: Console) -> tuple[list[dict[str, Any]], bool]:
    """Print a table of the datasets. Return reports, and whether one failed. DatasetError: `--pose known`, no truth."""
    settings = config.in_force(options.config_file, options.assignments or (), Configuration).wand
    camera = None if options.camera_file is None else load_camera(options.camera_file)
    given = read_balls(options.balls or ())
    recordings = [open_wand(path) for path in options.datasets]
    for recording in recordings:
        if options.pose == "known" and recording.truth is None:
            raise DatasetError(f"{recording.path}: no truth.csv; --pose known needs its first pose")
    results: list[dict[str, Any]] = []
    failed = False
    for recording in recordings:
        try:
            balls = with_distinct_names(given.balls or recording.balls)
            tracker = build(recording.camera if camera is None else camera, balls, settings, given.colours)
            known: Known | None = None
            if options.pose == "known":
                truths = recording.truths[: len(balls)]
                known = {k: (truth.position[0], truth.rotation[0]) for k, truth in enumerate(truths)}
            histories: list[WandHistory] = []
            for seed in range(1, options.runs + 1):
                with terminal.progress_bar() as progress:
                    text = f"{recording.name}, seed {seed}"
                    frames = progress.track(read_frames(recording), recording.frames, description=text)
                    histories.append(run_wand(frames, tracker, seed, known))
        except SpheremouseError as e:
            terminal.error(about(recording.path, str(e)))
            failed = True
            continue
        results.append(wand_reports(recording, balls, histories))
        lines = [f"frame {frame}: {sentence(event)}" for frame, event in histories[0].events()[:_MAX_EVENTS]]
        lines += _never_found(balls, histories)
        for line in [*lines, *([] if recording.truth is not None else [_NO_TRUTH])]:
            err.print(about(recording.path, line), markup=False)
    if results:
        out.print(wand_table(results))
        for result in results:
            for line in [line for each in (result, *result.get("more_balls", ())) for line in consistency(each)]:
                out.print(line, markup=False)
    return results, failed


def _never_found(balls: Sequence[WandBall], histories: Sequence[WandHistory]) -> Iterator[str]:
    """Yield a line for each ball that a run has not found, with the last reason."""
    for k, ball in enumerate(balls):
        vain = [history for history in histories if not history.run(k).found.any()]
        if vain:
            events = [e for history in vain for poses in history.poses if (e := poses[k].event) is not None]
            runs = "" if len(histories) == 1 else f" in {len(vain)} of {len(histories)} runs"
            yield f"{ball.name} was never found{runs}: {sentence(events[-1]) if events else 'the cause is not known'}"
