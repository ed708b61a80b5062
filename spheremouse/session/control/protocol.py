"""Messages of the control socket: one JSON object a line, UTF-8. docs/control.md describes them.

The tests play the examples of that page.
"""

import json
import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import to_jsonable_python

from spheremouse.errors import ConfigurationError, ControlError, one_line
from spheremouse.files import plain_json
from spheremouse.files.validate import nearest, validate
from spheremouse.files.yaml import Document

MAX_LINE = 65536  # bytes of a message, with its end of line
MAX_MARKS = 500  # brackets, braces and commas in a request: parsing JSON holds the interpreter, 0.1 ms a thousand
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")

Id = str | int


class BadRequestError(ControlError):
    """A line is no valid request. `id` is the client's, if it could be read."""

    def __init__(self, message: str, id_: Id | None = None) -> None:
        super().__init__(message)
        self.id = id_


# ---- requests ----


def _plain_name(text: str) -> str:
    if not _NAME.fullmatch(text):
        raise ValueError("must be a name of letters, digits, '.', '_' and '-', not a path")
    return text


def _picture_name(text: str) -> str:
    if not text.lower().endswith((".png", ".jpg", ".jpeg")):
        raise ValueError("must end in .png or .jpg")
    return text


Name = Annotated[str, AfterValidator(_plain_name)]
_MODEL = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


class Request(BaseModel):
    """A request without arguments."""

    model_config = _MODEL
    command: str  # of COMMANDS
    id: Id | None = None


class Set(Request):
    """Change parameters until the next start or reload. If one is invalid, none is changed."""

    assignments: tuple[Annotated[str, Field(max_length=1000)], ...] = Field(
        min_length=1, max_length=50, description='write for example ["motion.scale_x=2"]'
    )


class Profile(Request):
    """Use a profile of the configuration file until the next start or reload, in place of all changes by `set`."""

    name: str | None = Field(default=None, max_length=50, description="leave it out for the list of profiles")


class Save(Request):
    """Keep what was set, in the service's own file beside its state. Only the daemon's user and root may."""

    keys: tuple[Annotated[str, Field(max_length=200)], ...] | None = Field(
        default=None, max_length=50, description="leave it out for all that was set"
    )
    forget: bool = Field(default=False, description="true removes the file and reads the configuration again")


class Record(Request):
    """Begin a recording, or end it. `folder` is a name in the daemon's folder of recordings, not a path."""

    seconds: float | None = Field(default=None, gt=0, le=86400, description="leave it out for the configured length")
    folder: Name | None = Field(default=None, description="leave it out and the daemon makes one of date and time")
    everything: bool = Field(default=False, description="false keeps the ball and the targets only")
    stop: bool = Field(default=False, description="true ends the recording that runs")


class Snapshot(Request):
    """Write the next frame as a picture into the daemon's folder of recordings."""

    file: Annotated[Name, AfterValidator(_picture_name)] | None = Field(default=None, description="such as bug-1.png")
    everything: bool = Field(default=False, description="false keeps the ball and the targets only")


class Watch(Request):
    """Send the status every `interval` s, each line that the daemon logs, and the samples of each frame if asked."""

    interval: float = Field(default=1.0, ge=0.1, le=60.0, description="the default is 1 s")
    samples: bool = Field(default=False, description="true sends the samples of each frame")


class Replay(Request):
    """Set what is given of a replay: the speed, and the section from `begin` to `end` in s after the first frame."""

    speed: float | None = Field(default=None, ge=0.05, le=20.0, description="1 is the recording's own")
    loop: bool | None = Field(default=None, description="false pauses at the end")
    begin: float | None = Field(default=None, ge=0.0, le=1e6, description="in s")
    end: float | None = Field(default=None, ge=0.0, le=1e6, description="in s; 0 is the end of the recording")
    step: bool = Field(default=False, description="true pauses and plays one more frame")
    rewind: bool = Field(default=False, description="true goes back to the begin of the section")


_REQUESTS: dict[str, type[Request]] = {
    **dict.fromkeys(("status", "settings", "scene", "picture", "reinit", "pause", "resume", "reload", "stop"), Request),
    "set": Set,
    "profile": Profile,
    "save": Save,
    "record": Record,
    "snapshot": Snapshot,
    "watch": Watch,
    "replay": Replay,
}
COMMANDS = tuple(_REQUESTS)


def parse(line: bytes) -> Request:
    """Return the request in a line. BadRequestError names the problem in one line."""
    data = _read(line)
    if not isinstance(data, dict):
        raise BadRequestError('a request is a JSON object, such as {"command": "status"}')
    id_ = data.get("id")
    if not (id_ is None or _is_id(id_)):
        raise BadRequestError("id: must be text of at most 64 characters or a whole number below 2^53")
    command = data.get("command")
    if not isinstance(command, str):
        raise BadRequestError(f"command: missing; known here: {', '.join(COMMANDS)}", id_)
    if command not in _REQUESTS:
        name = one_line(repr(command))
        raise BadRequestError(f"unknown command {name}; {nearest(command[:60], COMMANDS)}", id_)
    try:
        request = validate(Document("", data), _REQUESTS[command])
    except ConfigurationError as e:
        raise BadRequestError(f"{command}: {'; '.join(str(e).splitlines())}"[:500], id_) from None
    if isinstance(request, Record) and request.stop and request.model_fields_set - {"command", "id", "stop"}:
        raise BadRequestError("record: stop goes alone; leave seconds, folder and everything out", id_)
    return request


def _read(line: bytes) -> Any:
    if sum(line.count(mark) for mark in (b"[", b"{", b",")) > MAX_MARKS:
        raise BadRequestError(f"not a request: more than {MAX_MARKS} values")
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        raise BadRequestError("not UTF-8 text; send one JSON object a line") from None
    try:
        return plain_json.tuples(plain_json.loads(text))
    except ValueError as e:
        raise BadRequestError(f"not JSON: {one_line(str(e))}; send one JSON object a line") from None


def _is_id(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= 64
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53


# ---- replies ----


class LivePicture(BaseModel):
    """A frame as the camera sent it, with the tracker's marks. Raises ValidationError for other values."""

    model_config = ConfigDict(strict=True, frozen=True, defer_build=True)
    stamp: float  # s, mid-exposure, on the source's own clock
    format: Literal["jpeg", "yuyv", "nv12", "grey", "bgr"]
    width: int  # px
    height: int  # px
    annotations: dict[str, Any]  # described in docs/control.md
    pixels: bytes  # rows without padding, or a JPEG file


def done(reply: dict[str, Any], id_: Id | None = None) -> dict[str, Any]:
    """Return the reply to a completed request. `reply` may be one of `refused`, which stays a refusal."""
    return {"ok": True, **({} if id_ is None else {"id": id_}), **reply}


def refused(error: str, id_: Id | None = None) -> dict[str, Any]:
    """Return the reply to a refused request."""
    line = "; ".join(" ".join(part.split()) for part in error.splitlines() if part.strip())
    return {"ok": False, **({} if id_ is None else {"id": id_}), "error": line[:2000]}


def internal_error(e: Exception) -> str:
    """Return the reply's text for an error of the program itself."""
    return f"internal error ({type(e).__name__}: {' '.join(str(e).split())}); please report it"


def encode(message: dict[str, Any]) -> bytes:
    """Return a message as a line. Numbers that are not finite become null. ValueError if it exceeds MAX_LINE."""
    plain = to_jsonable_python(message, inf_nan_mode="null", fallback=lambda array: array.tolist())
    text = json.dumps(plain, ensure_ascii=False, allow_nan=False)
    line = text.encode("utf-8", "backslashreplace") + b"\n"  # half a surrogate pair becomes JSON's own escape of it
    if len(line) > MAX_LINE:
        raise ValueError(f"a message of {len(line)} bytes")
    return line
