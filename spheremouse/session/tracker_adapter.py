"""The interface of trackers for the service and for the loop over recordings.

An adapter keeps the tracker's state from frame to frame. It turns estimates into samples and events into sentences, and
gives status, recordings and snapshots their contents.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.smooth import Observation
from spheremouse.errors import SpheremouseError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.output import Counts, Mapping
from spheremouse.output.sample import Sample
from spheremouse.session.control.status import PoseStatus, TrackerStatus
from spheremouse.session.process.threads import Work
from spheremouse.session.run_config import RunConfig
from spheremouse.tracker import Frame, Status

Submit = Callable[[str, Work], None]  # has another thread do work of a kind
TARGETS, POSE, MAP = "targets", "pose", "map"  # kinds of work that adapters have done


def here(_: str, work: Work) -> None:
    """Do the work in this thread, at once. A `Submit`."""
    follow_up = work()
    if follow_up is not None:
        follow_up()


@dataclass(frozen=True, slots=True)
class FrameResult:
    """The result of a tracked frame."""

    frame: Frame
    samples: tuple[Sample, ...]  # of all balls
    pointing: int  # index of the ball that moves the pointer
    seconds: dict[str, float]  # time of each stage
    epoch: Any  # the tracker's own record


class LogMessages(NamedTuple):
    """Log lines since the previous call; empty if there are none."""

    change: str = ""  # of the ball that moves the pointer, with the state that it leads to
    more: tuple[str, ...] = ()  # others


@dataclass(frozen=True, eq=False)
class Subject:
    """The subject of a recording: a tracker's ball before its camera. A camera that was moved has another one."""

    camera: InteriorOrientation
    view: object  # the same object until the camera is moved
    parts: str  # the kept part of a picture, in words; empty if the whole picture is needed
    kept: Callable[[], Image]  # 255 where a recording keeps a pixel, else 0, (h, w) uint8; PoseError without a ball
    scene: Callable[[], dict[str, Any]]  # contents of scene.json
    files: Callable[[], dict[str, str]]  # other files, name and text, so that a replay tracks in the same way


def camera_scene(camera: InteriorOrientation, pose: Pose | None) -> dict[str, Any]:
    """Return a camera at a pose as plain data; its position, rotation and covariance are None if the pose is."""
    return {
        "position": None if pose is None else pose.position.tolist(),
        "rotation": None if pose is None else pose.rotation.T.ravel().tolist(),  # R_cam_obj
        "covariance": None if pose is None else pose.covariance[:3, :3].ravel().tolist(),
        "focal": [camera.fx, camera.fy],
        "centre": [camera.cx, camera.cy],
        "size": [camera.width, camera.height],
    }


class TrackerAdapter(Protocol):
    """One tracker on one stream of frames, called by one thread. Other threads may read the attributes.

    Derive an adapter from it.
    """

    status: Status  # of the ball that moves the pointer
    untracked: int  # frames that came before anything could be tracked
    mapping: Mapping  # conversion of the pointing ball's motion to counts

    @property
    def waiting(self) -> str:
        """Reason why nothing can be tracked yet; empty if it can."""
        return ""

    @property
    def reason(self) -> str:
        """State of the ball that moves the pointer, in words."""
        ...

    @property
    def camera(self) -> InteriorOrientation:
        """Interior orientation of the camera whose frames it tracks."""
        ...

    @property
    def subject(self) -> Subject | None:
        """Subject of a recording; None while nothing can be tracked."""
        ...

    def wants_colour(self, stamp: float, camera: int = 0) -> bool:
        """Return True if the frame of a camera at `stamp`, s, is needed in colour."""
        ...

    def begin(self, *frames: Iterator[Frame]) -> Iterator[Frame]:
        """Return the frames of a recording from the first that can be tracked, with the pose before it.

        `frames` are those of each camera. The result is in the order of the stamps, with the numbers of the cameras.
        """
        return frames[0]

    def trouble_of(self, camera: int) -> str:
        """Return the reason why a camera takes no part in tracking; empty if it does."""
        return ""

    def pose_of(self, camera: int) -> PoseStatus | None:
        """Return the pose of a camera for the status; None while it is not known, and of a hand-held ball."""
        return None

    def follow(self, frame: Frame) -> FrameResult | None:
        """Track a frame. Return None if it was not tracked. Raise SourceError if it cannot be used."""
        ...

    def observation(self, result: FrameResult) -> Observation | None:
        """Return the information of the last frame for the smoother; None if there is no smoother for this tracker."""
        return None

    def take_messages(self) -> LogMessages:
        """Return the log lines since the previous call, and clear them. Of several changes it keeps the last."""
        ...

    def interrupted(self, reason: str) -> None:
        """Handle a break in the frames. Estimates stay.

        A pending pose request gets `reason` as its answer. A hand-held ball's motion across the break is not counted.
        """
        ...

    def slept(self) -> None:
        """Count no motion to the next frame, because the ball may have turned while the computer slept."""
        ...

    def restart(self, reason: str) -> None:
        """Search the ball again with the next frame."""
        ...

    def prepare(self, plan: RunConfig, changed: Collection[str]) -> Callable[[], "TrackerAdapter"]:
        """Prepare another plan, in which these sections have changed. Raise SpheremouseError to refuse it.

        The result applies the plan, and returns the adapter from then on.
        """
        ...

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        """Estimate the pose, or search the balls, again; call `answer` (error, text). Stop when not `wanted`."""
        ...

    def tracker_status(self, seeing: bool) -> TrackerStatus:
        """Return the tracker's part of the status, from any thread. `seeing` is False if no frames arrive."""
        ...

    def scene(self) -> dict[str, Any]:
        """Return camera, ball, discs and targets in 3-D as plain data (docs/control.md), from any thread."""
        ...

    def annotations(self, result: FrameResult | None) -> dict[str, Any]:
        """Return the marks on the last frame as plain data (docs/control.md); None: it was not tracked."""
        ...

    def picture(self, result: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        """Return a function that draws the overlay with the sum of counts, for another thread.

        It is black except for the part that `subject` keeps, unless `everything`. The image is copied.
        """
        ...

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        """Return a function that draws a frame without tracking, for another thread. The image is copied.

        Unless `everything`, persons stay unrecognisable.
        """
        ...

    def failure(self, unused: str) -> SpheremouseError | None:
        """Return the error if no frame of the run could be tracked, else None.

        `unused` is the reason why the frames that came could not be used.
        """
        ...

    def final_messages(self, failed: bool) -> tuple[str, ...]:
        """Return further log lines for the end of a run. If it `failed`, the failure is reported already."""
        return ()

    def close(self) -> None:
        """Save the map of the ball, if there is one."""
