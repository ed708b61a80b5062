"""The status report and its parts. A client checks the types of the values that it receives."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from spheremouse.errors import one_line

State = Literal["starting", "no-camera", "searching-targets", "tracking", "lost", "paused", "failed-output"]
STATES: tuple[str, ...] = State.__args__  # pyright: ignore[reportAttributeAccessIssue]


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)


_Triple = Annotated[list[float], Field(min_length=3, max_length=3)]


class Quantiles(_Part):
    """Times of the last frames, ms."""

    p50: float
    p99: float
    max: float | None = None


class PoseStatus(_Part):
    """The camera's pose in `obj`."""

    position_m: _Triple
    sigma_mm: _Triple
    sigma_deg: _Triple
    age_s: float


class TargetsStatus(_Part):
    """Codes of the targets while the camera's pose is unknown. `strangers` are seen and not in the rig."""

    seen: list[str]
    missing: list[str]
    strangers: list[str]


class MotionStatus(_Part):
    """The motion of the ball that points: right, down or towards the player, third axis; and in words."""

    rate: _Triple
    unit: Literal["°/s", "m/s"]
    words: str


class BallStatus(_Part):
    """A ball in a hand, in `cam`; None if its pose is unknown."""

    name: str
    state: Literal["searching", "tracking", "hidden", "lost"]
    position_m: _Triple | None
    angles_deg: _Triple | None
    sigma_mm: _Triple | None
    sigma_deg: _Triple | None


class OutputStatus(_Part):
    """The output."""

    spec: str
    left_out: str | None = None
    failed: str | None
    reports: int
    unsent: list[int] = Field(min_length=3, max_length=3)
    ahead: list[int] = Field(min_length=3, max_length=3)


class SourceStatus(_Part):
    """The source of the frames."""

    spec: str
    description: str


class RecordingStatus(_Part):
    """The recording in progress."""

    folder: str
    frames: int
    seconds: float
    bytes: int
    dropped: int


class StatusReport(_Part):
    """The status. Later versions may add keys and remove none."""

    state: State
    reason: str
    since_s: float
    fps: float | None
    latency_ms: Quantiles | None
    stages_ms: dict[str, Quantiles]
    tracker: str = "so3"
    discs: int | None
    discs_seen: int | None
    discs_known: int | None
    frames: int
    skipped: int
    dropped: int
    damaged: int
    pose: PoseStatus | None
    targets: TargetsStatus | None = None
    balls: list[BallStatus] | None = None
    motion: MotionStatus | None = None
    counts: list[int] | None = Field(None, min_length=3, max_length=3)
    output: OutputStatus
    source: SourceStatus
    unseen_s: float
    lost_count: int
    camera_restarts: int
    uptime_s: float
    version: str
    pid: int
    config: str | None
    changes: list[str] = []
    given: list[str] = []
    rig: str | None
    map: str | None
    recording: RecordingStatus | None
    memory_mb: float | None
    cpu_share: float | None
    scheduling: str
    paused: bool


def misfit(status: dict[str, Any]) -> str | None:
    """Return the first value of a status that has the wrong type, in words; None if there is none.

    Missing and null values are allowed, since older versions lack some; unknown states, since later versions have more;
    and file names that are not text.
    """
    try:
        StatusReport.model_validate(status)
    except ValidationError as e:
        for error in e.errors(include_url=False):
            place, value = error["loc"], error["input"]
            unknown = error["type"] in ("missing", "string_unicode") or (
                value is None and not isinstance(place[-1], int)
            )
            later = place == ("state",) and isinstance(value, str)
            if not (unknown or later):
                return f"{'.'.join(map(str, place))}: {one_line(error['msg'])}"
    return None
