"""A sample: the estimate of one ball at one frame, as a run publishes it, and its form in JSON.

Every output gets the same samples. All numbers are in SI units and radians. docs/samples.md and
docs/sample.schema.json describe the JSON object.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import copysign, sqrt
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import orjson

from spheremouse.geometry import Array
from spheremouse.tracker import Estimate, Status, unknown

if TYPE_CHECKING:
    from spheremouse.ball.smooth import Observation
    from spheremouse.geometry.camera import Pose

StillAxes = Literal["obj", "cam"]


@dataclass(frozen=True, eq=False)
class Sample:
    """The estimate of one ball at one frame, with wall clock, latency and events."""

    estimate: Estimate
    ball: int = 1  # number of the ball, from 1
    name: str = "ball"
    coordinates: StillAxes = "obj"  # of all vectors: obj of the ball in its frame, cam of a hand-held ball
    events: tuple[str, ...] = ()  # names of changes with this frame, for example "ball-lost"
    wall: float | None = None  # s since 1970 (UTC) at the exposure; None unless a service or --realtime made it
    latency: float | None = None  # s from the exposure to publication; None as `wall`
    camera: "Pose | None" = None  # in obj; None for a hand-held ball, and for a sample read from JSON
    observation: "Observation | None" = None  # information of the frame alone, for the smoother; None: not kept
    # Counts and text of the last `to_json`: the outputs of a run share them.
    _line: tuple[tuple[int, int, int], bytes] | None = field(default=None, init=False, repr=False)

    @property
    def sequence(self) -> int:
        """Number of frames since the tracker began."""
        return self.estimate.sequence

    @property
    def stamp(self) -> float:
        """Mid-exposure, s, on the source's own clock."""
        return self.estimate.stamp

    @property
    def status(self) -> Status:
        """Phase of tracking."""
        return self.estimate.status

    @property
    def confirmed(self) -> bool:
        """True if this frame supports the estimate; False if it is a prediction."""
        return self.estimate.confirmed

    @property
    def rotation(self) -> Array:
        """Attitude, (3, 3), from the ball's axes to the still axes, `coordinates`."""
        return self.estimate.rotation

    @property
    def quaternion(self) -> Array:
        """Attitude as a unit quaternion (w, x, y, z), w >= 0."""
        return np.array(to_quaternion(self.estimate.rotation))

    @property
    def position(self) -> Array:
        """Position, (3,) m; zero for the ball in its frame."""
        return self.estimate.position

    @property
    def rate(self) -> Array:
        """Angular velocity, (3,) rad/s."""
        return self.estimate.rate[:3]

    @property
    def velocity(self) -> Array:
        """Velocity of the centre, (3,) m/s."""
        return self.estimate.rate[3:]

    @property
    def increment(self) -> Array:
        """Rotation vector since the last confirmed estimate, (3,) rad."""
        return self.estimate.increment[:3]

    @property
    def shift(self) -> Array:
        """Motion of the centre since the last confirmed estimate, (3,) m."""
        return self.estimate.increment[3:]

    @property
    def attitude_covariance(self) -> Array:
        """Covariance of the attitude error e, exp(e) @ rotation, (3, 3) rad²."""
        return self.estimate.covariance[:3, :3]

    @property
    def position_covariance(self) -> Array:
        """Covariance of the position, (3, 3) m²."""
        return self.estimate.covariance[3:6, 3:6]

    @property
    def rate_covariance(self) -> Array:
        """Covariance of the angular velocity, (3, 3) rad²/s²."""
        return self.estimate.covariance[6:9, 6:9]

    @property
    def increment_covariance(self) -> Array:
        """Covariance of the increment, (3, 3) rad²."""
        return self.estimate.increment_covariance[:3, :3]

    @property
    def sigma(self) -> Array:
        """Standard deviations of the attitude about the still axes, (3,) rad."""
        return np.sqrt(np.diag(self.attitude_covariance).clip(0.0))

    @property
    def statistics(self) -> dict[str, float]:
        """Figures of the frame by name, for example `discs_used`."""
        return dict(self.estimate.statistics)


def to_object(sample: Sample, counts: tuple[int, int, int]) -> dict[str, Any]:
    """Return the object of `to_json`."""
    return orjson.loads(to_json(sample, counts))


def to_json(sample: Sample, counts: tuple[int, int, int]) -> bytes:
    """Return the sample and its counts (x, y, third axis) as a line: a JSON object with the keys of docs/samples.md.

    Every number reads back exactly. Unknown values and numbers that are not finite are null. Attitude, motion and their
    covariances are null unless the ball is tracked. Only a hand-held ball has `position`, `velocity`, `shift`,
    `position_covariance` and `yaw_pitch_roll` (rad).
    """
    kept = sample._line
    if kept is not None and kept[0] == counts:
        return kept[1]
    e = sample.estimate
    known = e.status is Status.TRACKING
    made: dict[str, Any] = {
        "sequence": e.sequence,
        "stamp": e.stamp,
        "wall": sample.wall,
        "latency": sample.latency,
        "ball": sample.ball,
        "name": sample.name,
        "coordinates": sample.coordinates,
        "status": e.status,
        "confirmed": e.confirmed,
        "events": sample.events,
        "quaternion": to_quaternion(e.rotation) if known else None,
        "rate": e.rate[:3].tolist() if known else None,
        "increment": e.increment[:3].tolist() if known else None,
        "attitude_covariance": e.covariance[:3, :3].tolist() if known else None,
        "rate_covariance": e.covariance[6:9, 6:9].tolist() if known else None,
        "increment_covariance": e.increment_covariance[:3, :3].tolist() if known else None,
        "statistics": e.statistics,
        "counts": counts,
    }
    if sample.coordinates == "cam":
        made |= {
            "position": e.position.tolist() if known else None,
            "velocity": e.rate[3:].tolist() if known else None,
            "shift": e.increment[3:].tolist() if known else None,
            "position_covariance": e.covariance[3:6, 3:6].tolist() if known else None,
            "yaw_pitch_roll": _yaw_pitch_roll(e) if known else None,
        }
    line = orjson.dumps(made, dict, orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_APPEND_NEWLINE)
    object.__setattr__(sample, "_line", (counts, line))
    return line


def from_object(read: Mapping[str, Any]) -> Sample:
    """Return the sample of a JSON object of `to_object`, without its counts. Raises ValueError if it is none.

    The object has no covariances between attitude, position and rate, and none of the velocity: they are zero. So are
    values that are None, except that an unknown attitude is the identity, and an unknown figure of the statistics nan.
    """
    try:
        quaternion = read["quaternion"]
        zero = unknown(float(read["stamp"]), int(read["sequence"]), Status(read["status"]))
        covariance, increment_covariance = zero.covariance.copy(), zero.increment_covariance.copy()
        covariance[:3, :3] = _array(read, "attitude_covariance", 3, 3)
        covariance[3:6, 3:6] = _array(read, "position_covariance", 3, 3)
        covariance[6:9, 6:9] = _array(read, "rate_covariance", 3, 3)
        increment_covariance[:3, :3] = _array(read, "increment_covariance", 3, 3)
        estimate = zero._replace(
            rotation=zero.rotation if quaternion is None else _to_matrix(_array(read, "quaternion", 4)),
            position=_array(read, "position", 3),
            rate=np.concatenate([_array(read, "rate", 3), _array(read, "velocity", 3)]),
            covariance=covariance,
            increment=np.concatenate([_array(read, "increment", 3), _array(read, "shift", 3)]),
            increment_covariance=increment_covariance,
            confirmed=bool(read["confirmed"]),
            statistics={str(k): np.nan if v is None else float(v) for k, v in read["statistics"].items()},
        )
        wall, latency = (None if read[key] is None else float(read[key]) for key in ("wall", "latency"))
        still: StillAxes = "cam" if read["coordinates"] == "cam" else "obj"
        return Sample(
            estimate, int(read["ball"]), str(read["name"]), still, tuple(map(str, read["events"])), wall, latency
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as e:
        raise ValueError(f"this is no JSON object of a sample: {e}") from None


def _array(read: Mapping[str, Any], key: str, *shape: int) -> Array:
    """Return finite numbers of a shape; zeros if there are none."""
    if read.get(key) is None:
        return np.zeros(shape)
    values = np.array(read[key], dtype=float)
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"{key} must be finite numbers of shape {shape}")
    return values


def _yaw_pitch_roll(estimate: Estimate) -> list[float]:
    from spheremouse.wand.axes import estimated_axes

    return estimated_axes(estimate).angles.tolist()


def to_quaternion(R: Array) -> list[float]:
    """Return the unit quaternion w, x, y, z, w >= 0, of a rotation matrix, (3, 3) (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    if a + e + i > max(a, e, i):
        w, x, y, z = 1.0 + a + e + i, h - f, c - g, d - b
    elif a >= max(e, i):
        w, x, y, z = h - f, 1.0 + a - e - i, b + d, c + g
    elif e >= i:
        w, x, y, z = c - g, b + d, 1.0 - a + e - i, f + h
    else:
        w, x, y, z = d - b, c + g, f + h, 1.0 - a - e + i
    scale = copysign(1.0, w) / sqrt(w * w + x * x + y * y + z * z)
    return [w * scale, x * scale, y * scale, z * scale]


def _to_matrix(quaternion: Array) -> Array:
    """Return the rotation matrix, (3, 3), of w, x, y, z of any length but zero, else ValueError."""
    if not quaternion.any():
        raise ValueError("the quaternion is zero")
    w, x, y, z = (quaternion / np.linalg.norm(quaternion)).tolist()
    V = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * (w * V + V @ V)
