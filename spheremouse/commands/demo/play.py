"""Run the demonstration: simulate, track by pictures and rig alone, show, and compare with the truth."""

import sys
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Column, Table

from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import Truth
from spheremouse.capture import Stream
from spheremouse.capture.signals import SignalHandler
from spheremouse.commands.run import follow
from spheremouse.commands.run.view import RunView
from spheremouse.errors import ConfigurationError, os_errors_as
from spheremouse.evaluation.metrics import report
from spheremouse.evaluation.plot import plot_run
from spheremouse.evaluation.run import History, Reference
from spheremouse.files import config
from spheremouse.geometry.rotation import rotation_between
from spheremouse.output import Report
from spheremouse.output.counts import MotionSettings
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.setup import Setup
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter
from spheremouse.simulate.ball.film import Simulation, SimulationOptions, prepare, simulate

FILES = {
    "overlay.mp4": "a video with the targets and discs that the tracker found",
    "plot.png": "attitude and angular velocity against the truth, with three standard deviations",
    "motion.csv": "the motion as a table, one row for each frame: attitude, angular velocity, covariances, counts",
    "motion.csv.json": "the description of the run: settings, versions, losses",
}
_TABLE = ("motion.csv", "motion.csv.json")
_NEXT = (
    ("demo --seed 2", "another ball, another play"),
    ("run --source synthetic --output text:-", "a simulated camera as the source, motion as text"),
    ("preview", "the picture of your own camera"),
    ("calibrate next", "the steps to your own ball, one after the other"),
)
_NOISE_GREY = 4.0  # grey values: a webcam in a lit room


def play(out: Path, seconds: float, seed: int) -> None:
    """Simulate, track and compare, and write FILES into a folder."""
    film = prepare(SimulationOptions(motion="play", seconds=seconds, noise=_NOISE_GREY, seed=seed))
    with os_errors_as(ConfigurationError, f"--out {out}: cannot be made"):
        out.mkdir(parents=True, exist_ok=True)
        for name in _TABLE:  # of an earlier demo, which would be continued
            (out / name).unlink(missing_ok=True)
    source = f"synthetic:motion=play,seconds={seconds:g},noise={_NOISE_GREY:g},seed={seed}"
    settings = config.assignments({"source": source, "output": f"csv:{out / 'motion.csv'}"})
    overrides = CommandLineOverrides(assignments=settings, no_map=True)
    with ExitStack() as stack:
        stopping = stack.enter_context(SignalHandler())
        view = _View(stack, out / "overlay.mp4", film.fps, status=True)
        view.log(
            f"A simulated camera (640x480, {film.fps:g} Hz, noise {_NOISE_GREY:g}) films a ball with "
            f"{len(film.scene.disc_directions)} discs,\nand bolts that look like discs. "
            "The tracker gets the pictures and the rig, nothing else."
        )
        setup = Setup(Stream((made.frame for made in simulate(film)), rig=film.scene.rig(), fps=film.fps))
        failure, _ = follow(overrides, read_run_config(overrides), setup, stopping, view, frames=None)
    if failure is not None:
        raise failure
    if view.adapter is None:
        raise typer.Exit(130)
    _compare(film, view, view.adapter, out)


def _compare(film: Simulation, view: "_View", adapter: BallAdapter, out: Path) -> None:
    run, found = view.history.run(), None if adapter.resection is None else adapter.resection.pose
    frames = view.history.epochs[-1].frame.sequence + 1
    stamp = np.arange(frames) / film.fps
    truth = Truth(stamp, film.profile.attitude(stamp), film.profile.rate(stamp))
    reference = Reference(truth, pose=film.scene.pose)
    result = report(run, reference, adapter.rig, dataset="demo", tracker="so3", frames=frames, found=found)
    if len(run.tracked):
        plot_run(run, truth, out / "plot.png")
    print()
    Console(file=sys.stdout, highlight=False).print(_summary(result, view, truth, adapter.rig))
    files = [(str(out / name), meaning) for name, meaning in FILES.items() if (out / name).exists()]
    _print_pairs("files:", files)
    _print_pairs("next:", [(f"spheremouse {words}", meaning) for words, meaning in _NEXT])


class _View(RunView):
    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self.history = History()
        self.adapter: BallAdapter | None = None

    def show(self, result: FrameResult, report: Report, adapter: TrackerAdapter) -> None:
        super().show(result, report, adapter)
        assert isinstance(adapter, BallAdapter)
        self.history.add(result.epoch)
        self.adapter = adapter


def _print_pairs(title: str, pairs: list[tuple[str, str]]) -> None:
    width = max(len(first) for first, _ in pairs)
    print(title)
    for first, second in pairs:
        print(f"  {first:{width}}  {second}")


def _summary(result: dict[str, Any], view: _View, truth: Truth, rig: Rig) -> Table:
    tally, history = view.tally, view.history
    pose, median, lost = result["pose_error"], 1e3 * tally.times.quantile(0.5), result["lost_episodes"]
    position, angle = (float(np.linalg.norm(pose[key])) for key in ("position_mm", "angle_deg"))
    rows = [
        (
            "frames tracked",
            f"{result['tracked']} of {result['frames']}",
            f"times lost: {lost}" if lost else "never lost",
        ),
        ("camera pose", f"{position:.1f} mm, {angle:.3f}°", "from the true one"),
        ("attitude", _number(result["attitude_rmse_deg"]["combined"], "°"), "RMS error, three axes together"),
        ("angular velocity", _number(result["rate_rmse_deg_s"]["combined"], " °/s"), "RMS error of the vector"),
        ("surface speed", _number(result["surface_speed_r"]["combined"], "", 5), "correlation with the true one"),
        ("counts sent", _triple(tally.counts), f"exact would be {_triple(_exact_counts(history, truth, rig))}"),
        ("discs", _number(result["mean_discs"], " per frame", 1), _known_discs(history)),
        ("time per frame", f"{median:.1f} ms", f"{1e3 / median:.0f} frames per second on one core"),
    ]
    columns = Column(style="dim"), Column(style="bold", justify="right"), Column(style="dim")
    table = Table(*columns, title="Against truth", title_justify="left", title_style="bold", box=None, padding=(0, 2))
    table.show_header = False
    for row in rows:
        table.add_row(*row)
    return table


def _exact_counts(history: History, truth: Truth, rig: Rig) -> tuple[int, int, int]:
    """Return the integral of the true motion over the tracked frames, in counts."""
    at = [epoch.frame.sequence for epoch in history.epochs]
    matrix = MotionSettings().matrix(rig.radius_m)
    steps = [matrix @ rotation_between(truth.attitude[a], truth.attitude[b]) for a, b in pairwise(at)]
    x, y, z = (round(float(v)) for v in np.sum([np.zeros(3), *steps], axis=0))
    return x, y, z


def _known_discs(history: History) -> str:
    state = history.epochs[-1].state
    masked = len(state.lookalikes.masks)
    known = f"{len(state.filter.discs)} in the map"
    return f"{known}, {masked} object{'s' if masked > 1 else ''} like discs ignored" if masked else known


def _number(value: float | None, unit: str, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def _triple(counts: tuple[int, int, int]) -> str:
    return " ".join(f"{n:+d}" for n in counts)
