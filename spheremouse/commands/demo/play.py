"""Run the demonstration: simulate, track, show, and compare with the truth.

The tracker gets the pictures and the rig. The truth is used at the end alone.
"""

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Column, Table

from spheremouse.ball.build import build
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import Epoch, Tracker
from spheremouse.ball.truth import DiscTruth, Truth
from spheremouse.capture.signals import SignalHandler
from spheremouse.errors import ConfigurationError, PoseError
from spheremouse.evaluation.metrics import History, Reference, Run, report
from spheremouse.evaluation.plot import plot_run
from spheremouse.geometry.rotation import rotation_between
from spheremouse.output import open_output, report_of
from spheremouse.output.counts import Counter
from spheremouse.output.sample import Sample
from spheremouse.session import messages
from spheremouse.session.offline import Start, initialise, track
from spheremouse.session.overlay.ball import Overlay
from spheremouse.session.overlay.file import OverlayFile, write_picture
from spheremouse.session.overlay.marks import target_marks
from spheremouse.session.overlay.pen import Image
from spheremouse.session.run_description import versions
from spheremouse.session.screen import StatusLine, Tally, ball_line
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.film import SimulatedFrame, Simulation, SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame, Status

_SETTINGS = Configuration()
FILES = {
    "overlay.png": "one picture with the targets, discs and axes that the tracker found",
    "overlay.mp4": "the same as a video",
    "plot.png": "attitude and angular velocity against the truth, with three standard deviations",
    "motion.csv": "the motion as a table, one row for each frame: attitude, angular velocity, covariances, counts",
    "motion.csv.json": "the description of the run: settings, versions, losses",
}
_TABLE = ("motion.csv", "motion.csv.json")
_NEXT = (
    ("demo --seed 2", "another ball, another play"),
    ("demo --play", "a game that a simulated ball plays, or the ball of the running service"),
    ("run --source synthetic --output text:-", "a simulated camera as the source, motion as text"),
    ("preview", "the picture of your own camera"),
    ("calibrate next", "the steps to your own ball, one after the other"),
)
_NO_IMAGE = np.zeros((0, 0), np.uint8)
_NOISE = 4.0  # grey values: a webcam in a lit room


def play(out: Path, seconds: float, seed: int) -> None:
    """Simulate, track and compare, and write FILES into a folder."""
    simulation = prepare(SimulationOptions(motion="play", seconds=seconds, noise=_NOISE, seed=seed))
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in _TABLE:  # of an earlier demo, which would be continued
            (out / name).unlink(missing_ok=True)
    except OSError as e:
        raise ConfigurationError(f"--out {out}: cannot be made: {e.strerror or e}") from None
    console = Console(file=sys.stderr, highlight=False)
    console.print(
        f"A simulated camera (640x480, {simulation.fps:g} Hz, noise {_NOISE:g}) films a ball with "
        f"{len(simulation.scene.disc_directions)} discs,\nand bolts that look like discs. "
        "The tracker gets the pictures and the rig, nothing else."
    )
    with SignalHandler() as signals:
        film = _Film(simulation)
        frames = signals.frames(iter(film))
        with console.status("rendering the scene, searching for the targets") if console.is_terminal else nullcontext():
            rig = simulation.scene.rig()
            start = _start(frames, rig, signals)
        tracker = build(rig, start.pose, _SETTINGS)
        start = replace(start, frames=signals.frames(start.frames))
        history, tally = _watch(start, tracker, out, simulation.fps, console)
    if not history.epochs:
        raise typer.Exit(130)
    run, truth = history.run(), film.truth()
    result = report(
        run, film.reference(), rig, dataset="demo", tracker="so3", frames=len(film.filmed), found=start.pose
    )
    _draw_plot(run, truth, out / "plot.png")
    print()
    Console(file=sys.stdout, highlight=False).print(_summary(result, tally, history, truth, tracker))
    files = [(str(out / name), meaning) for name, meaning in FILES.items() if (out / name).exists()]
    _print_pairs("files:", files)
    _print_pairs("next:", [(f"{_program()} {words}", meaning) for words, meaning in _NEXT])


def _print_pairs(title: str, pairs: list[tuple[str, str]]) -> None:
    width = max(len(first) for first, _ in pairs)
    print(title)
    for first, second in pairs:
        print(f"  {first:{width}}  {second}")


def _program() -> str:
    """Return the words that start this program: its name, its path, or the module."""
    path = Path(sys.argv[0])
    if path.name == "__main__.py":
        return f"{Path(sys.executable).name} -m spheremouse"
    return path.name if shutil.which(path.name) else os.path.relpath(path)


def _start(frames: Iterator[Frame], rig: Rig, signals: SignalHandler) -> Start:
    try:
        return initialise(frames, rig, _SETTINGS)
    except PoseError:
        if signals.asked:  # the frames ended with the signal
            raise typer.Exit(130) from None
        raise


class _Film:
    """Yields frames for the tracker, and keeps the truth."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.filmed: list[SimulatedFrame] = []  # without their images

    def __iter__(self) -> Iterator[Frame]:
        for simulated in simulate(self._simulation):
            self.filmed.append(replace(simulated, frame=replace(simulated.frame, image=_NO_IMAGE)))
            yield simulated.frame

    def truth(self) -> Truth:
        """Return the motion of the ball."""
        return Truth(
            np.array([f.frame.stamp for f in self.filmed]),
            np.array([f.attitude for f in self.filmed]),
            np.array([f.rate for f in self.filmed]),
        )

    def reference(self) -> Reference:
        """Return the truth of motion, discs and camera pose."""
        rows = [replace(f.discs, frame=np.full(len(f.discs), i)) for i, f in enumerate(self.filmed)]
        discs = DiscTruth(*(np.concatenate([getattr(r, n) for r in rows]) for n in DiscTruth.__slots__))
        scene = self._simulation.scene
        return Reference(self.truth(), discs, scene.pose, scene.disc_directions)


def _watch(start: Start, tracker: Tracker, out: Path, fps: float, console: Console) -> tuple[History, Tally]:
    """Track all frames. Show the status, write motion and video, and a picture of the frame with most to see."""
    history, tally = History(), Tally()
    marks = target_marks(tracker.rig, start.pose, start.resection)
    best: tuple[float, Image | None] = (-1.0, None)
    large = Overlay(tracker, marks, scale=2)
    counter = Counter(_SETTINGS.motion.matrix(tracker.rig.radius_m))
    with (
        open_output(f"csv:{out / 'motion.csv'}") as motions,
        OverlayFile(out / "overlay.mp4", fps) as video,
        StatusLine(True, console) as screen,
    ):
        motions.begin(lambda: {"configuration": asdict(_SETTINGS), "source": "demo", "versions": versions()})
        if start.resection is not None:
            screen.log(messages.standing(start.resection, tracker.rig))
        video.begin(tracker, marks)
        for epoch in track(start.frames, tracker):
            report = report_of((Sample(epoch.estimate),), counter)
            motions.send(report)
            tally.add(report.counts, sum(epoch.seconds.values()))
            history.add(epoch)
            if epoch.events:
                screen.log(f"{epoch.frame.stamp:9.3f} s  {messages.line(epoch.events)}")
            screen.show(ball_line, epoch, tally)
            video.add(epoch, lambda: tally.counts)
            large.remember(epoch.state)
            interest = _interest(epoch)
            if interest > best[0]:
                best = interest, large.draw(epoch, tally.counts)
    if best[1] is not None:
        write_picture(out / "overlay.png", best[1])
    return history, tally


def _interest(epoch: Epoch) -> float:
    """Return how much the picture shows: discs in use, and long traces."""
    speed = float(np.linalg.norm(epoch.state.filter.rate))  # rad/s
    return 0.0 if epoch.state.status is not Status.TRACKING else len(epoch.used) * (0.3 + min(speed, 1.2))


def _draw_plot(run: Run, truth: Truth, path: Path) -> None:
    kept = run.tracked
    if len(kept):
        true = truth.attitude[run.frame[kept]], truth.rate[run.frame[kept]]
        plot_run(run.stamp[kept], run.attitude[kept], run.rate[kept], *true, run.covariance[kept], path)


def _summary(result: dict[str, Any], tally: Tally, history: History, truth: Truth, tracker: Tracker) -> Table:
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
        ("counts sent", _triple(tally.counts), f"exact would be {_triple(_exact_counts(history, truth, tracker))}"),
        ("discs", _number(result["mean_discs"], " per frame", 1), _known_discs(history)),
        ("time per frame", f"{median:.1f} ms", f"{1e3 / median:.0f} frames per second on one core"),
    ]
    columns = Column(style="dim"), Column(style="bold", justify="right"), Column(style="dim")
    table = Table(*columns, title="Against truth", title_justify="left", title_style="bold", box=None, padding=(0, 2))
    table.show_header = False
    for row in rows:
        table.add_row(*row)
    return table


def _exact_counts(history: History, truth: Truth, tracker: Tracker) -> tuple[int, int, int]:
    """Return the integral of the true motion over the tracked frames, in counts."""
    at = [epoch.frame.sequence for epoch in history.epochs]
    matrix = _SETTINGS.motion.matrix(tracker.rig.radius_m)
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
