"""The interface of trackers for the service and for the loop over recordings.

An adapter keeps the tracker's state from frame to frame. It turns motion into reports and events into sentences, and
gives status, recordings and snapshots their contents. A `Setup` makes it.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from spheremouse.capture import Source
from spheremouse.errors import SpheremouseError
from spheremouse.output import Output, Report
from spheremouse.output.pointer import Counts
from spheremouse.session.overlay.pen import Image
from spheremouse.session.plan import Plan, Request
from spheremouse.session.process.threads import Work
from spheremouse.session.subject import Subject
from spheremouse.tracker import Frame, Status

Do = Callable[[str, Work], None]  # has another thread do work of a kind
TARGETS, POSE, MAP = "targets", "pose", "map"  # kinds of work that followers have done


@dataclass(frozen=True, slots=True)
class FrameResult:
    """The result of a tracked frame."""

    frame: Frame
    report: Report
    seconds: dict[str, float]  # that each stage took
    epoch: Any  # the tracker's own record


def here(_: str, work: Work) -> None:
    """Do it here and now: a `Do`."""
    then = work()
    if then is not None:
        then()


class LogMessages(NamedTuple):
    """Log lines since the previous call; empty if there are none."""

    change: str = ""  # of the ball that moves the pointer, with the state that it leads to
    more: tuple[str, ...] = ()  # besides


class Change(NamedTuple):
    """A prepared change to another plan."""

    outputs: tuple[Callable[[], Output], ...]  # what opens each; the pointer's first
    apply: Callable[[], "TrackerAdapter"]  # makes it so, and gives the follower from then on


class TrackerAdapter(Protocol):
    """One tracker on one stream of frames, called by one thread; attributes may be read by others."""

    @property
    def waiting(self) -> str:
        """Reason why nothing can be tracked yet; empty if it can."""
        ...

    @property
    def reason(self) -> str:
        """State of the ball that moves the pointer, in words."""
        ...

    @property
    def status(self) -> Status:
        """The same, in one."""
        ...

    @property
    def untracked(self) -> int:
        """Number of frames that came before anything could be tracked."""
        ...

    @property
    def outputs(self) -> tuple[Callable[[], Output], ...]:
        """Functions that open each output; the pointer's first."""
        ...

    @property
    def subject(self) -> Subject | None:
        """Subject of a recording; None while nothing can be tracked."""
        ...

    def wants_colour(self, stamp: float) -> bool:
        """Return True if the frame of `stamp`, s, is needed in colour."""
        ...

    def check(self, frame: Frame) -> None:
        """Raise SourceError if a frame cannot be used."""
        ...

    def follow(self, frame: Frame) -> FrameResult | None:
        """Track a frame; return None if it was not tracked."""
        ...

    def take_news(self) -> LogMessages:
        """Return the log lines since the previous call."""
        ...

    def interrupted(self, reason: str) -> None:
        """Drop the work on past frames, since no frames arrive."""
        ...

    def restart(self, reason: str) -> None:
        """Start again with the next frame."""
        ...

    def prepare(self, plan: Plan, changed: Collection[str]) -> Change:
        """Prepare another plan. Raises SpheremouseError if it cannot be applied."""
        ...

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        """Estimate the pose, or search the balls, again; call `answer` (error, text). Stop when not `wanted`."""
        ...

    def figures(self, seeing: bool) -> dict[str, Any]:
        """Return the tracker's part of the status, from any thread."""
        ...

    def picture(self, tracked: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        """Return a function that draws the overlay with the sum of counts, for another thread.

        It is black but for what `subject` keeps, unless `everything`.
        """
        ...

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        """Return a function that draws a frame without tracking, for another thread.

        Unless `everything`, persons stay unrecognisable.
        """
        ...

    def failure(self, unused: str) -> SpheremouseError | None:
        """Return the error if no frame of the run could be tracked.

        `unused` is why frames that came could not be used.
        """
        ...

    def last_words(self, failed: bool) -> tuple[str, ...]:
        """Return further closing lines; `failed`: the failure is reported already."""
        ...

    def close(self) -> None:
        """Save the learnt map."""
        ...


class Setup(Protocol):
    """The open source of a run, and the device or balls that it brings."""

    @property
    def source(self) -> Source | None:
        """None: a camera, which is opened again and again."""
        ...

    def planned(self, request: Request, plan: Plan) -> Plan:
        """The plan as it is followed with this source."""
        ...

    def open(self, plan: Plan) -> Source:
        """A recording that a plan names, held to its stamps."""
        ...

    def make_ready(self, plan: Plan, tell: Callable[[str], None] | None = None) -> None:
        """Compile what tracking by a plan calls, or read it from disk; `tell` as of `compiling.told`."""
        ...

    def follower(self, plan: Plan, say: Callable[[str], None], do: Do) -> TrackerAdapter:
        """Return the tracker's adapter; raises SpheremouseError if the plan is incomplete."""
        ...

    def begin(self, frames: Iterator[Frame], follower: Any) -> Iterator[Frame]:
        """Return the frames of a recording from the first that can be tracked, with the pose before it."""
        ...
