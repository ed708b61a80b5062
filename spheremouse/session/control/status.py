"""The status of a run: one record that the daemon builds and that its clients read.

Each value may be None, since an older daemon lacks it. Unknown keys of a later daemon are kept.
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
    model_config = ConfigDict(extra="allow", strict=True, frozen=True)


class Quantiles(_Part):
    """Times of the last frames, ms."""

    p50: float | None = None
    p99: float | None = None
    max: float | None = None


class PoseStatus(_Part):
    """The camera's pose in `obj`."""

    position_m: Triple | None = None
    sigma_mm: Triple | None = None
    sigma_deg: Triple | None = None
    age_s: float | None = None


class TargetsStatus(_Part):
    """Codes of the targets while the camera's pose is unknown. `strangers` are seen and not in the rig."""

    seen: list[Text] | None = None
    missing: list[Text] | None = None
    strangers: list[Text] | None = None


class MotionStatus(_Part):
    """The motion of the ball that points: right, down or towards the player, third axis; and in words."""

    rate: Triple | None = None
    unit: Text | None = None  # °/s or m/s
    words: Text | None = None


class BallStatus(_Part):
    """A ball in a hand, in `cam`; the numbers are None if its pose is unknown."""

    name: Text | None = None
    state: Text | None = None  # searching, tracking, hidden, lost
    position_m: Triple | None = None
    angles_deg: Triple | None = None
    sigma_mm: Triple | None = None
    sigma_deg: Triple | None = None


class OutputStatus(_Part):
    spec: Text | None = None
    left_out: Text | None = None
    failed: Text | None = None
    reports: int | None = None
    unsent: Counts | None = None
    ahead: Counts | None = None
    dropped: int | None = None
    latency_ms: Quantiles | None = None


class ReplayStatus(_Part):
    """A recording that is replayed: the number of the present frame, and s after the first one."""

    frame: int | None = None
    frames: int | None = None
    seconds: float | None = None
    begin: float | None = None
    end: float | None = None
    speed: float | None = None
    loop: bool | None = None


class SourceStatus(_Part):
    spec: Text | None = None
    description: Text | None = None
    replay: ReplayStatus | None = None


class RecordingStatus(_Part):
    folder: Text | None = None
    frames: int | None = None
    seconds: float | None = None
    bytes: int | None = None
    dropped: int | None = None


class TrackerStatus(_Part):
    """The part of the status that the tracker's adapter fills."""

    discs: int | None = None
    discs_seen: int | None = None
    discs_known: int | None = None
    pose: PoseStatus | None = None
    targets: TargetsStatus | None = None
    motion: MotionStatus | None = None
    balls: list[BallStatus] | None = None


class StatusReport(TrackerStatus):
    """The status. Its keys are described in docs/control.md."""

    state: Text | None = None  # of `State`, or of a later version
    reason: Text | None = None
    since_s: float | None = None
    fps: float | None = None
    latency_ms: Quantiles | None = None
    stages_ms: dict[str, Quantiles] | None = None
    tracker: Text | None = None
    frames: int | None = None
    skipped: int | None = None
    dropped: int | None = None
    damaged: int | None = None
    counts: Counts | None = None
    outputs: list[OutputStatus] | None = None  # the main one first
    source: SourceStatus | None = None
    unseen_s: float | None = None
    lost_count: int | None = None
    camera_restarts: int | None = None
    uptime_s: float | None = None
    version: Text | None = None
    pid: int | None = None
    config: Text | None = None
    changes: list[Text] | None = None
    given: list[Text] | None = None
    saved: list[Text] | None = None  # None: the daemon keeps no file of saved settings
    rig: Text | None = None
    map: Text | None = None
    recording: RecordingStatus | None = None
    recordings: Text | None = None  # the folder
    memory_mb: float | None = None
    cpu_share: float | None = None
    scheduling: Text | None = None
    paused: bool | None = None

    @classmethod
    def read(cls, data: dict[str, Any]) -> Self:
        """Return the status in a daemon's reply. ControlError names the first value of a wrong type."""
        try:
            return cls.model_validate(data)
        except ValidationError as e:
            error = e.errors(include_url=False)[0]
            raise ControlError(f"{'.'.join(map(str, error['loc']))}: {one_line(error['msg'])}") from None

    def as_json(self) -> dict[str, Any]:
        """Return the status as plain data, without the values that were not given."""
        return self.model_dump(exclude_unset=True)
