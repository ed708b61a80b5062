"""The parts of a status, checked where they are read."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from spheremouse.errors import one_line

State = Literal["starting", "no-camera", "searching-targets", "tracking", "lost", "paused", "failed-output"]
STATES: tuple[str, ...] = State.__args__  # pyright: ignore[reportAttributeAccessIssue]


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)


_Triple = Annotated[list[float], Field(min_length=3, max_length=3)]


class Quantiles(_Part):
    """Of the last frames, ms."""

    p50: float
    p99: float
    max: float | None = None


class PoseStatus(_Part):
    """Where the camera is, in `obj`."""

    position_m: _Triple
    sigma_mm: _Triple
    sigma_deg: _Triple
    age_s: float


class TargetsStatus(_Part):
    """Codes of targets while the camera's pose is sought: those of the rig, and those that it does not have."""

    seen: list[str]
    missing: list[str]
    strangers: list[str]


class MotionStatus(_Part):
    """How the ball that points moves: right, down or towards who stands there, third; and in words."""

    rate: _Triple
    unit: Literal["°/s", "m/s"]
    words: str


class BallStatus(_Part):
    """A ball in a hand, in `cam`; null where it is not known."""

    name: str
    state: Literal["searching", "tracking", "hidden", "lost"]
    position_m: _Triple | None
    angles_deg: _Triple | None
    sigma_mm: _Triple | None
    sigma_deg: _Triple | None


class OutputStatus(_Part):
    """Where motion goes."""

    spec: str
    left_out: str | None = None
    failed: str | None
    reports: int
    unsent: list[int] = Field(min_length=3, max_length=3)
    ahead: list[int] = Field(min_length=3, max_length=3)


class SourceStatus(_Part):
    """Where pictures come from."""

    spec: str
    description: str


class RecordingStatus(_Part):
    """A recording that runs."""

    folder: str
    frames: int
    seconds: float
    bytes: int
    dropped: int


class StatusReport(_Part):
    """What a status holds; later versions may add to it, and take nothing away."""

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
    """What in a status no daemon says, in words: a value that is not of its kind. None where it may be shown.

    What is missing, or null, an older version did not know; a state that is not known here is a later one's; the name
    of a file need not be text.
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
