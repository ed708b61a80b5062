"""The status of a run: one record that the daemon builds and that its clients read.

Unknown keys of a later daemon are kept.
"""

from enum import StrEnum
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError

from spheremouse.errors import ControlError, one_line


class State(StrEnum):
    """States of the daemon; motion is sent in `tracking` only."""

    STARTING = "starting"
    NO_CAMERA = "no-camera"
    SEARCHING_TARGETS = "searching-targets"
    TRACKING = "tracking"
    LOST = "lost"
    PAUSED = "paused"
    FAILED_OUTPUT = "failed-output"


STATES: tuple[str, ...] = tuple(State)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("Input should be text")
    return value


Text = Annotated[str, PlainValidator(_text)]  # names of files may have half a surrogate pair, which `str` rejects
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Counts = Annotated[list[int], Field(min_length=3, max_length=3)]  # x, y, third axis


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True, frozen=True, defer_build=True)


class Quantiles(_Part):
    """Times of the last frames, ms."""

    p50: float | None
    p99: float | None
    max: float | None = None


class PoseStatus(_Part):
    """The camera's pose in `obj`."""

    position_m: Triple
    sigma_mm: Triple
    sigma_deg: Triple
    age_s: float


class TargetsStatus(_Part):
    """Codes of the targets while the camera's pose is unknown. `strangers` are seen and not in the rig."""

    seen: list[Text]
    missing: list[Text]
    strangers: list[Text]


class MotionStatus(_Part):
    """The motion of the ball that points: right, down or towards the player, third axis; and in words."""

    rate: Triple
    unit: Text  # °/s or m/s
    words: Text


class BallStatus(_Part):
    """A ball in a hand, in `cam`; the numbers are None if its pose is unknown."""

    name: Text
    state: Text  # searching, tracking, hidden, lost
    position_m: Triple | None
    angles_deg: Triple | None
    sigma_mm: Triple | None
    sigma_deg: Triple | None


class OutputStatus(_Part):
    spec: Text
    left_out: Text | None
    failed: Text | None
    reports: int
    unsent: Counts
    ahead: Counts
    dropped: int
    latency_ms: Quantiles | None


class ReplayStatus(_Part):
    """A recording that is replayed: the number of the present frame, and s after the first one."""

    frame: int
    frames: int | None
    seconds: float
    begin: float
    end: float | None  # None: that of the recording
    speed: float
    loop: bool


class SourceStatus(_Part):
    spec: Text
    description: Text
    replay: ReplayStatus | None = None


class CameraStatus(_Part):
    """One camera of two."""

    spec: Text  # of its source
    description: Text
    trouble: Text  # why it takes no part in tracking; empty if it does
    rig: Text | None
    frames: int  # tracked
    restarts: int
    pose: PoseStatus | None


class RecordingStatus(_Part):
    folder: Text
    frames: int
    seconds: float
    bytes: int
    dropped: int


class TrackerStatus(_Part):
    """The part of the status that the tracker's adapter fills."""

    discs: int | None = None
    discs_seen: int | None = None
    discs_known: int | None = None
    centre_shift_mm: float | None = None
    pose: PoseStatus | None = None
    targets: TargetsStatus | None = None
    motion: MotionStatus | None = None
    balls: list[BallStatus] | None = None


class StatusReport(TrackerStatus):
    """The status. Its keys are described in docs/control.md."""

    state: Text  # of `State`, or of a later version
    reason: Text
    since_s: float
    fps: float
    latency_ms: Quantiles | None
    stages_ms: dict[str, Quantiles]
    tracker: Text
    frames: int
    skipped: int
    dropped: int
    damaged: int
    counts: Counts
    outputs: list[OutputStatus]  # the main one first
    source: SourceStatus  # of the first camera
    cameras: list[CameraStatus] = Field(default_factory=list)  # of two cameras, else none
    unseen_s: float
    lost_count: int
    camera_restarts: int
    uptime_s: float
    version: Text
    pid: int
    config: Text | None
    changes: list[Text]
    given: list[Text]
    saved: list[Text] | None  # None: the daemon keeps no file of saved settings
    rig: Text | None
    map: Text | None
    recording: RecordingStatus | None
    recordings: Text  # the folder
    memory_mb: float
    cpu_share: float | None
    scheduling: Text
    paused: bool

    @classmethod
    def read(cls, data: dict[str, Any]) -> Self:
        """Return the status in a daemon's reply. ControlError names the first value of a wrong type."""
        try:
            return cls.model_validate(data)
        except ValidationError as e:
            error = e.errors(include_url=False)[0]
            raise ControlError(f"{'.'.join(map(str, error['loc']))}: {one_line(error['msg'])}") from None

    def as_json(self) -> dict[str, Any]:
        """Return the status as plain data, without `replay` of a camera and `max` of stages."""
        return self.model_dump(exclude_unset=True)
