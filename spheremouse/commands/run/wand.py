"""`spheremouse run --tracker wand`: hand-held balls as an input device, pointer and six axes from a source's frames.

Recordings are tracked frame by frame, deterministically; cameras, and recordings held to their stamps, in `wand_live`.
"""

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from spheremouse.capture import Source
from spheremouse.capture.stopping import Stopping
from spheremouse.errors import SourceError, SpheremouseError
from spheremouse.output.hand import Hand, Moved
from spheremouse.session.cameras import is_camera, opener, refuse_if_taken
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.session.overlay.wand import WandOverlay
from spheremouse.session.plan import Plan, Request
from spheremouse.session.screen import Tally
from spheremouse.session.wand.messages import Told
from spheremouse.session.wand.offline import track_wand
from spheremouse.session.wand.plan import Outputs, open_given, wand_outputs, wand_tracker
from spheremouse.session.wand.screen import WandBoard
from spheremouse.session.wand.service import WandLive
from spheremouse.wand.state import WandEpoch, WandTracker


@dataclass(frozen=True, slots=True)
class WandOptions:
    """What the command line says besides the plan."""

    balls: tuple[Path, ...] = ()  # wand files
    realtime: bool = False
    table: bool = False
    overlay: Path | None = None
    frames: int | None = None


def run_wand(request: Request, plan: Plan, options: WandOptions) -> None:
    """Track balls and send their motion, until the source ends or somebody ends it."""
    tally, told = Tally(), Told()
    failure: SpheremouseError | None = None
    latency: tuple[float, float] | None = None
    file: OverlayFile | None = None
    with ExitStack() as stack:
        stopping = stack.enter_context(Stopping())
        given = None if is_camera(plan.source) else open_given(plan.source, options.realtime)
        tracker = wand_tracker(plan, request, list(options.balls), given)
        outputs = wand_outputs(plan.output, plan.configuration.wand)
        board = stack.enter_context(WandBoard(options.table, tally))
        if options.overlay is not None:
            file = stack.enter_context(OverlayFile(options.overlay, None if given is None else given.source.fps))
        draw = _drawing(file, tracker, plan, tally)
        for ball in tracker.balls:
            board.say(f"ball: {ball.name}, {2e3 * ball.radius:g} mm across, {len(ball.discs)} discs")

        def show(epoch: WandEpoch, made: Moved) -> None:
            _count(tally, epoch, made)
            board.show(epoch.frame.stamp, epoch.poses)
            draw(epoch)

        try:
            if given is None or options.realtime:
                if given is None:
                    refuse_if_taken(plan)
                open_camera = opener(plan, None if given is None else given.source)
                live = WandLive(
                    tracker, plan.configuration, open_camera, outputs, told,
                    say=board.say, show=show, frames=options.frames,
                )  # fmt: skip
                live.run(stopping)
                latency = live.latency
                if live.finished:
                    _refuse_unseen(plan, tally, told)
            else:
                source = stack.enter_context(given.source)
                _follow(source, tracker, plan, outputs, stopping, board, told, show, options.frames)
                if not stopping.asked:
                    _refuse_unseen(plan, tally, told)
        except SpheremouseError as e:
            failure = e
    if file is not None and file.written:
        print(f"overlay: {file.path}", file=sys.stderr)
    if tally.frames or failure is None:
        print(tally if latency is None else f"{tally}; {_words(latency)}", file=sys.stderr)
    points = plan.configuration.wand.points - 1
    for line in told.never_found(but=points if failure is not None else None):  # that one may be the failure
        print(line, file=sys.stderr)
    if failure is not None:
        raise failure


def _follow(
    source: Source,
    tracker: WandTracker,
    plan: Plan,
    outputs: Outputs,
    stopping: Stopping,
    board: WandBoard,
    told: Told,
    show: Callable[[WandEpoch, Moved], None],
    frames: int | None,
) -> None:
    """A recording: every frame, one after the other."""
    settings = plan.configuration.wand
    hand, points = Hand(settings.pointing, settings.points - 1), settings.points - 1
    with ExitStack() as stack:  # readers of the outputs may go away: a quiet end
        sinks = [stack.enter_context(o()) for o in (outputs.open_pointer, outputs.open_axes) if o is not None]
        for epoch in track_wand(stopping.frames(islice(source, frames)), tracker):
            made, stamp = hand.move(epoch), epoch.frame.stamp
            for axes in outputs.axes:
                axes.expect(stamp, epoch.poses)
            for line in told.frame(stamp, epoch.poses, epoch.frame.image, points):
                board.say(f"{stamp:9.3f} s  {line}")
            for sink in sinks:
                sink.send(made.motion)
            show(epoch, made)


def _drawing(file: OverlayFile | None, tracker: WandTracker, plan: Plan, tally: Tally) -> Callable[[WandEpoch], None]:
    """Draws each epoch into the overlay's file, where one is wanted."""
    if file is None:
        return lambda _: None
    overlay = WandOverlay(tracker, plan.configuration.wand.points - 1, file.scale(tracker.camera.width))

    def draw(epoch: WandEpoch) -> None:
        overlay.remember(epoch)
        counts = tally.counts
        file.show(lambda: overlay.draw(epoch, counts))

    return draw


def _count(tally: Tally, epoch: WandEpoch, made: Moved) -> None:
    x, y, z = made.motion.counts
    tally.frames += 1
    tally.counts = (tally.counts[0] + x, tally.counts[1] + y, tally.counts[2] + z)
    tally.times.add(epoch.seconds, time.perf_counter())


def _refuse_unseen(plan: Plan, tally: Tally, told: Told) -> None:
    """A recording in which the ball was never seen is of no use."""
    if plan.configuration.wand.points - 1 not in told.found:
        frames = f"{tally.frames} frame{'' if tally.frames == 1 else 's'}"
        raise SourceError(f"{plan.source}: {told.why} (looked for in {frames})" if tally.frames else
                          f"{plan.source}: gave no frame")  # fmt: skip


def _words(latency: tuple[float, float]) -> str:
    return f"from stamp to output {1e3 * latency[0]:.1f} ms (99 %: {1e3 * latency[1]:.1f} ms)"
