"""The demonstration: filmed, tracked, watched, and compared with the truth."""

import sys
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from spheremouse.ball.build import build
from spheremouse.ball.rig import Rig
from spheremouse.ball.state import Epoch, Tracker
from spheremouse.ball.truth import DiscTruth, Truth
from spheremouse.capture.signals import SignalHandler
from spheremouse.errors import ConfigurationError, PoseError
from spheremouse.evaluate.history import History
from spheremouse.evaluate.metrics import Reference, Run, report
from spheremouse.evaluate.plot import plot_run
from spheremouse.geometry.rotation import rotation_between
from spheremouse.output import open_output
from spheremouse.output.counts import Counter
from spheremouse.session import messages
from spheremouse.session.offline import Start, initialise, make_ready, track
from spheremouse.session.overlay.ball import Overlay, target_marks
from spheremouse.session.overlay.file import OverlayFile, write_picture
from spheremouse.session.overlay.pen import Image
from spheremouse.session.screen import StatusTable, Tally
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.film import SimulatedFrame, Simulation, SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame, Status

_SETTINGS = Configuration()
FILES = ("overlay.png", "overlay.mp4", "plot.png", "motion.txt")
_NOISE = 4.0  # grey values: a webcam in a lit room


def play(out: Path, seconds: float, seed: int) -> None:
    """Simulate, track and compare, and write what there is to see into a folder."""
    simulation = prepare(SimulationOptions(motion="play", seconds=seconds, noise=_NOISE, seed=seed))
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigurationError(f"--out {out}: cannot be made: {e.strerror or e}") from None
    console = Console(file=sys.stderr, highlight=False)
    console.print(
        f"A simulated camera (640x480, {simulation.fps:g} Hz, noise {_NOISE:g}) films a ball with "
        f"{len(simulation.scene.disc_directions)} discs,\nand bolts that look like discs. "
        "The tracker gets the pictures and the rig, nothing else."
    )
    make_ready(_SETTINGS)
    with SignalHandler() as stopping:
        film = _Film(simulation)
        frames = stopping.frames(iter(film))
        with console.status("lighting the scene, looking for the targets") if console.is_terminal else nullcontext():
            rig = simulation.scene.rig()
            start = _started(frames, rig, stopping)
        tracker = build(rig, start.pose, _SETTINGS)
        seen = _watch(replace(start, frames=stopping.frames(start.frames)), tracker, out, simulation.fps, console)
    if not seen.history.epochs:
        raise typer.Exit(130)
    run, truth = seen.history.run(), film.truth()
    result = report(
        run, film.reference(), rig, dataset="demo", tracker="so3", frames=len(film.filmed), found=start.pose
    )
    _draw_plot(run, truth, out / "plot.png")
    print()
    Console(file=sys.stdout, highlight=False).print(_summary(result, seen, truth, tracker))
    for name in FILES:
        if (out / name).exists():
            print(f"  {out / name}")


def _started(frames: Iterator[Frame], rig: Rig, stopping: SignalHandler) -> Start:
    try:
        return initialise(frames, rig, _SETTINGS)
    except PoseError:
        if stopping.asked:  # no frame came any more
            raise typer.Exit(130) from None
        raise


class _Film:
    """Frames for the tracker; what really happened is kept for later."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.filmed: list[SimulatedFrame] = []  # without their images

    def __iter__(self) -> Iterator[Frame]:
        for made in simulate(self._simulation):
            self.filmed.append(replace(made, frame=_without_image(made.frame)))
            yield made.frame

    def truth(self) -> Truth:
        """The ball's motion."""
        return Truth(
            np.array([f.frame.stamp for f in self.filmed]),
            np.array([f.attitude for f in self.filmed]),
            np.array([f.rate for f in self.filmed]),
        )

    def reference(self) -> Reference:
        """All there is to compare with."""
        rows = [replace(f.discs, frame=np.full(len(f.discs), i)) for i, f in enumerate(self.filmed)]
        discs = DiscTruth(*(np.concatenate([getattr(r, n) for r in rows]) for n in DiscTruth.__slots__))
        scene = self._simulation.scene
        return Reference(self.truth(), discs, scene.pose, scene.disc_directions)


@dataclass
class _Seen:
    """Results of the tracker, frame by frame."""

    tally: Tally = field(default_factory=Tally)
    history: History = field(default_factory=History)

    def add(self, epoch: Epoch, counts: tuple[int, int, int]) -> None:
        """One more."""
        self.tally.add(counts, sum(epoch.seconds.values()))
        self.history.add(epoch)


def _watch(start: Start, tracker: Tracker, out: Path, fps: float, console: Console) -> _Seen:
    """Track all frames: table, motion, overlay video, and a picture of the finest moment."""
    seen = _Seen()
    marks = target_marks(tracker.rig, start.pose, start.resection)
    best: tuple[float, Image | None] = (-1.0, None)
    large = Overlay(tracker, marks, scale=2)
    counter = Counter(_SETTINGS.motion.matrix(tracker.rig.radius_m))
    with (
        open_output(f"text:{out / 'motion.txt'}") as motions,
        OverlayFile(out / "overlay.mp4", fps) as video,
        StatusTable("spheremouse demo", True, seen.tally, console) as screen,
    ):
        if start.resection is not None:
            screen.say(messages.standing(start.resection, tracker.rig))
        video.begin(tracker, marks)
        for epoch in track(start.frames, tracker):
            report = counter.report(epoch.estimate)
            motions.send(report)
            seen.add(epoch, report.counts)
            if epoch.events:
                screen.say(f"{epoch.frame.stamp:9.3f} s  {messages.line(epoch.events)}")
            screen.show(epoch)
            video.add(epoch, lambda: seen.tally.counts)
            large.remember(epoch.state)
            fine = _fineness(epoch)
            if fine > best[0]:
                best = fine, large.draw(epoch, seen.tally.counts)
    if best[1] is not None:
        write_picture(out / "overlay.png", best[1])
    return seen


def _fineness(epoch: Epoch) -> float:
    """Amount that there is to see: discs in use, and long traces."""
    speed = float(np.linalg.norm(epoch.state.filter.rate))  # rad/s
    return 0.0 if epoch.state.status is not Status.TRACKING else len(epoch.used) * (0.3 + min(speed, 1.2))


def _draw_plot(run: Run, truth: Truth, path: Path) -> None:
    kept = run.tracked
    if len(kept) == 0:
        return
    at = run.frame[kept]
    plot_run(
        run.stamp[kept],
        run.attitude[kept],
        run.rate[kept],
        truth.attitude[at],
        truth.rate[at],
        run.covariance[kept],
        path,
    )


def _summary(result: dict[str, Any], seen: _Seen, truth: Truth, tracker: Tracker) -> Table:
    """The figures a visitor asks for."""
    times, pose = seen.tally.times, result["pose_error"]
    exact = _exact_counts(seen, truth, tracker)
    median = 1e3 * times.quantile(0.5)
    position = float(np.linalg.norm(pose["position_mm"]))
    angle = float(np.linalg.norm(pose["angle_deg"]))
    rows = [
        ("frames tracked", f"{result['tracked']} of {result['frames']}", _lost(result["lost_episodes"])),
        ("camera pose", f"{position:.1f} mm, {angle:.3f}°", "off the true one"),
        ("attitude", _number(result["attitude_rmse_deg"]["combined"], "°"), "RMS error, three axes together"),
        ("angular velocity", _number(result["rate_rmse_deg_s"]["combined"], " °/s"), "the same"),
        ("surface speed", _number(result["surface_speed_r"]["combined"], "", 5), "correlation with the true one"),
        ("counts sent", _triple(seen.tally.counts), f"exact would be {_triple(exact)}"),
        ("discs", _number(result["mean_discs"], " per frame", 1), _met(seen)),
        ("time per frame", f"{median:.1f} ms", f"{1e3 / median:.0f} frames per second on one core"),
    ]
    table = Table(
        title="Against truth", title_justify="left", title_style="bold", box=None, padding=(0, 2), pad_edge=True
    )
    table.show_header = False
    table.add_column(style="dim")
    table.add_column(style="bold", justify="right")
    table.add_column(style="dim")
    for row in rows:
        table.add_row(*row)
    return table


def _exact_counts(seen: _Seen, truth: Truth, tracker: Tracker) -> tuple[int, int, int]:
    """The integral of the true motion over the frames tracked, in counts."""
    at = [e.frame.sequence for e in seen.history.epochs]
    matrix = _SETTINGS.motion.matrix(tracker.rig.radius_m)
    total = np.zeros(3)
    for a, b in pairwise(at):
        total += matrix @ rotation_between(truth.attitude[a], truth.attitude[b])
    x, y, z = (round(float(v)) for v in total)
    return x, y, z


def _without_image(frame: Frame) -> Frame:
    return replace(frame, image=np.zeros((0, 0), np.uint8))


def _lost(episodes: int) -> str:
    return "never lost" if episodes == 0 else f"lost {episodes} time{'s' if episodes > 1 else ''}"


def _met(seen: _Seen) -> str:
    state = seen.history.epochs[-1].state
    masked = len(state.lookalikes.masks)
    met = f"{len(state.filter.discs)} met so far"
    return f"{met}, {masked} look-alike{'s' if masked > 1 else ''} masked" if masked else met


def _number(value: float | None, unit: str, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def _triple(counts: tuple[int, int, int]) -> str:
    return " ".join(f"{n:+d}" for n in counts)
