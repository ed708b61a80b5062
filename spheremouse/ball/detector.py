"""The protocol of a detector: what the tracker, its messages, recordings and pictures ask of what sees the ball.

A detector turns a frame and a prediction into points of the image with covariances. `points.intersect` carries them to
the ball. The filter takes their `Measurement`, and forms residual and Jacobian by the points' places on its map. Only
`build.py` knows which detectors there are.
"""

from typing import Any, NamedTuple, Protocol

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.diagnosis import Absence
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame


class Words(NamedTuple):
    """Words for sentences about what a detector sees."""

    part: str  # one of its points
    parts: str
    subject: str  # all of them, by which a ball is followed
    masked: str  # what became of things that stand still, with their number {n} and a plural's {s}
    altered: str  # why those of the same ball may have changed
    absent: str  # it sees none, and the ball is not tracked


class Detector(Protocol):
    """A way to see the ball. It is a constant without data of a device: `prepare` returns those."""

    @property
    def words(self) -> Words:
        """Words for sentences."""
        ...

    @property
    def map_type(self) -> type[BallMap]:
        """Type of the map of its points that a file keeps."""
        ...

    @property
    def sees_discs(self) -> bool:
        """Return whether its points are the discs of the rig, with its radius, and not parts of anything."""
        ...

    @property
    def is_exact(self) -> bool:
        """Return whether its covariances are right, so that points show a lifted ball."""
        ...

    @property
    def uses_colours(self) -> bool:
        """Return whether it takes a projection of colours, so that the tracker looks for the best one."""
        ...

    @property
    def keeps_state(self) -> bool:
        """Return whether its state holds at another pose of the camera and with other settings."""
        ...

    def landmark_angle(self, rig: Rig) -> float:
        """Return the angular radius, rad, of the place that a point takes on the ball."""
        ...

    def mark_radius(self, rig: Rig) -> float:
        """Return the radius, m, of a mark on a point in a picture."""
        ...

    def shared_errors(self, rig: Rig, pose: Pose) -> Array:
        """Return the covariance, (10, 10) of pose and ball, equivalent to the errors that all frames share."""
        ...

    def prepare(self, rig: Rig, pose: Pose, settings: Settings, before: object = None) -> Any:
        """Return its constant data for a device and one pose of the camera. Those of `before` may be used again.

        Raises ConfigurationError if the settings leave nothing of the ball.
        """
        ...

    def detect(self, state: Any, frame: Frame, tracker: Any, predicted: Any) -> tuple[Detections, Any]:
        """Return the points of a frame, and the detector's state for the next one.

        `state` is the TrackState before the frame, `tracker` the Tracker with the data of `prepare`, and `predicted`
        the filter's state at the frame.
        """
        ...

    def clear_points(self, points: int) -> int:
        """Return how many of so many points, seen by a tracker that does not track, prove that light and focus do."""
        ...

    def why_absent(self, image: Image, rig: Rig, pose: Pose, settings: Settings, known: bool) -> Absence:
        """Return why an image shows no points. The ball is `known` if it was tracked before."""
        ...

    def support_mask(self, rig: Rig, pose: Pose, settings: Settings) -> Image:
        """Return a mask, (h, w), 255 for the pixels that it reads; masks of the settings do not count."""
        ...
