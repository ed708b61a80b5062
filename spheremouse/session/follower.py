"""A tracker at work, whatever it tracks: what the service and the loop for recordings know of it.

A follower has the tracker's state from frame to frame. It turns motion into reports, and events into sentences, and
says what a status, a recording and a snapshot show of it. A `Setup` makes it.
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
    """What a tracked frame gave."""

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
    """What is to be said since this was last asked; empty where nothing is."""

    change: str = ""  # of the ball that moves the pointer, with the state that it leads to
    more: tuple[str, ...] = ()  # besides


class Change(NamedTuple):
    """What another plan makes of a follower, while nothing has changed yet."""

    outputs: tuple[Callable[[], Output], ...]  # what opens each; the pointer's first
    apply: Callable[[], "TrackerAdapter"]  # makes it so, and gives the follower from then on


class TrackerAdapter(Protocol):
    """One tracker on one stream of frames, called by one thread; attributes may be read by others."""

    @property
    def waiting(self) -> str:
        """Why nothing can be tracked yet; empty where it can."""
        ...

    @property
    def reason(self) -> str:
        """What is known of the ball that moves the pointer, in words."""
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
        """What opens each output; the pointer's first."""
        ...

    @property
    def subject(self) -> Subject | None:
        """What a recording is of; None while nothing can be tracked."""
        ...

    def wants_colour(self, stamp: float) -> bool:
        """Should the frame of `stamp`, s, come in colour? Grey does otherwise."""
        ...

    def check(self, frame: Frame) -> None:
        """Raise SourceError where a frame cannot be used."""
        ...

    def follow(self, frame: Frame) -> FrameResult | None:
        """Do what there is to be done with a frame; None where it was not tracked."""
        ...

    def take_news(self) -> LogMessages:
        """What is to be said since this was last asked."""
        ...

    def interrupted(self, reason: str) -> None:
        """No frames come: what was begun with those before is void."""
        ...

    def restart(self, reason: str) -> None:
        """Begin anew with the next frame."""
        ...

    def prepare(self, plan: Plan, changed: Collection[str]) -> Change:
        """The way to another plan. Raises SpheremouseError where there is none."""
        ...

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        """Find anew what may have changed about the tracker; `answer` (error, text). Given up when not `wanted`."""
        ...

    def figures(self, seeing: bool) -> dict[str, Any]:
        """Its part of the status, where frames come or not; from any thread."""
        ...

    def picture(self, tracked: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        """Draws what the tracker sees, with the sum of counts, by another thread.

        It is black but for what `subject` keeps, unless `everything`.
        """
        ...

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        """Draws, by another thread, a frame that was not tracked, with what is made out in it.

        Nobody is recognised in it, unless `everything`.
        """
        ...

    def failure(self, unused: str) -> SpheremouseError | None:
        """Why it was of no use, at the end of all frames; None where something was tracked.

        `unused` is why frames that came could not be used.
        """
        ...

    def last_words(self, failed: bool) -> tuple[str, ...]:
        """What else is to be said then; `failed`: that failure is told."""
        ...

    def close(self) -> None:
        """Keep what was learnt."""
        ...


class Setup(Protocol):
    """What a run is of besides its plan: the source that is open already, and what it knows itself."""

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
        """What follows the ball; raises SpheremouseError where the plan does not say enough."""
        ...

    def begin(self, frames: Iterator[Frame], follower: Any) -> Iterator[Frame]:
        """Of a recording, the frames from the first that can be tracked, with what must be known before it."""
        ...
