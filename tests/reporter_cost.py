"""What the reporter costs and how late it is: python -m tests.reporter_cost [--seconds S] [--work WHAT ...].

A camera of 60 Hz without pictures; the tracker itself at work on simulated ones in a thread of its own, as in the
daemon; and a thread that computes in Python without a pause, which is the worst. The motion is that of a ball that
rolls on evenly, so that every report has counts; the output does nothing. Prints a Markdown table: processor time of
the reporter's thread as a share of a core; from `give` to the call of `send`; how much longer than a period it is from
a report to the next; and how late a process of its own is that merely sleeps. Times are the median and what 99 % stay
below.
"""

import argparse
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from reporting import report

from spheremouse.ball.build import begin, build
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import step
from spheremouse.output import Report
from spheremouse.output.pointer import PointerSettings
from spheremouse.output.reporter import OutputThread
from spheremouse.session.offline import initialise
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate

FPS = 60.0
HEAD = ("at work", "Hz", "switch interval", "of a core", "reports/s", "give to send", "late", "a mere sleep is late")
SLEEPER = """
import sys, time
late, end = [], time.monotonic() + float(sys.argv[1])
while (now := time.monotonic()) < end:
    time.sleep(0.001)
    late.append(time.monotonic() - now - 0.001)
late.sort()
print(late[len(late) // 2], late[len(late) * 99 // 100])
"""

Give = Callable[[Report], None]


@dataclass
class Sink:
    """An output that notes when."""

    times: list[float] = field(default_factory=list)
    frames: list[bool] = field(default_factory=list)
    given: dict[float, float] = field(default_factory=dict)  # s of `give`, by stamp
    waited: list[float] = field(default_factory=list)

    def send(self, report):
        now = time.monotonic()
        gave = self.given.pop(report.estimate.stamp, None)
        self.times.append(now)
        self.frames.append(gave is not None)
        if gave is not None:
            self.waited.append(now - gave)

    def describe(self, report):
        return ""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


def roll(give: Give, until: float, work: Callable[[], None] = lambda: None) -> None:
    """A ball that rolls on at 1200 counts/s; `work` is done for every frame before it is given."""
    rate = (20.0 * FPS, -20.0 * FPS, 0.0)
    start, k = time.monotonic(), 0
    while (then := start + k / FPS) < until:
        time.sleep(max(0.0, then - time.monotonic()))
        work()
        give(report(20, -20, stamp=then, counts_rate=rate))
        k += 1


def with_tracker() -> Callable[[Give, float], None]:
    """Somebody plays, over and over, and the tracker is at work."""
    simulation = prepare(SimulationOptions(motion="play", seconds=4.0, fps=FPS, noise=3.0))
    rig, settings = simulation.scene.rig(), Settings()
    frames = [made.frame for made in simulate(simulation)]
    tracker = build(rig, initialise(iter(frames), rig, settings).pose, settings)

    def steps() -> Iterator[None]:
        while True:
            state = begin(tracker, frames[0].stamp)
            for frame in frames:
                state = step(state, frame, tracker).state
                yield

    endless = steps()
    for _ in frames:  # compiled, and caches warm
        next(endless)
    return lambda give, until: roll(give, until, lambda: next(endless))


def with_python(give: Give, until: float) -> None:
    """A thread that never lets go by itself."""
    over = False

    def compute() -> None:
        while not over:
            sum(range(1000))

    thread = threading.Thread(target=compute)
    thread.start()
    try:
        roll(give, until)
    finally:
        over = True
        thread.join()


WORK = {
    "nothing": ("nobody else", roll),
    "tracker": ("the tracker", None),  # made when it is wanted
    "python": ("a Python loop", with_python),
}


def measure(camera: Callable[[Give, float], None], rate: float, seconds: float) -> list[str]:
    """Cells of a row."""
    sink = Sink()
    reporter = OutputThread(lambda: sink, PointerSettings(rate=rate), lambda text: print(text, file=sys.stderr))

    def give(report: Report) -> None:
        sink.given[report.estimate.stamp] = time.monotonic()
        reporter.submit(report, report.estimate.stamp)

    thread = threading.Thread(target=camera, args=(give, time.monotonic() + seconds))
    clock = time.pthread_getcpuclockid(reporter._thread.ident)
    with subprocess.Popen([sys.executable, "-c", SLEEPER, str(seconds)], stdout=subprocess.PIPE, text=True) as sleeper:
        begun, processor = time.monotonic(), time.clock_gettime(clock)
        thread.start()
        thread.join()
        share = (time.clock_gettime(clock) - processor) / (time.monotonic() - begun)
        reporter.close()
        slept = [float(word) for word in sleeper.communicate()[0].split()]
    between = ~np.array(sink.frames[1:])
    gaps = np.diff(sink.times)[between]
    late = gaps - 1.0 / rate
    times = [np.percentile(sink.waited, (50, 99)), np.percentile(late, (50, 99)), np.array(slept)]
    cells = [f"{abs(1e3 * p50):.2f} / {abs(1e3 * p99):.2f} ms" for p50, p99 in times]
    return [f"{100.0 * share:.1f} %", f"{len(sink.times) / seconds:.0f}", *cells]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each row")
    parser.add_argument("--switch", type=float, nargs="+", default=[0.005, 0.0005], help="s, sys.setswitchinterval")
    parser.add_argument("--work", nargs="+", choices=WORK, default=list(WORK), help="what is at work")
    given = parser.parse_args()
    print(f"| {' | '.join(HEAD)} |\n|{' --- |' * len(HEAD)}")
    for work in given.work:
        name, camera = WORK[work]
        if camera is None:
            camera = with_tracker()
        for rate in (250.0, 1000.0):
            for switch in given.switch:
                sys.setswitchinterval(switch)
                cells = measure(camera, rate, given.seconds)
                print("| " + " | ".join([name, f"{rate:.0f}", f"{1e3 * switch:g} ms", *cells]) + " |", flush=True)


if __name__ == "__main__":
    main()
