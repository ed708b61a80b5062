"""Which disc was seen where: the tracker runs with a rough rig, and its map says what belongs together.

Takes frames and where the ball roughly is; gives the sightings that the adjustment takes. Where the tracker had lost
the ball and begun a new map, the stretches are joined again by the constellation of the discs.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.associate import identify
from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import TrackState
from spheremouse.ball.track import step
from spheremouse.calibrate.rolling.problem import Rolling, Sightings
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame, Status

R_OBJ_CAM = np.diag([1.0, -1.0, -1.0])  # axes for the time being: those of the picture, Y up and Z to the camera
_SLIVER = 2.0  # px, semi-minor axis below which both rims are one blur: what is wrong with it is the same every time
_SIGMA = 0.003  # rad, of a direction when a map is searched for it
_RISK = 1e-4  # that two stretches are joined wrongly
_TRIED = 50  # frames of a stretch in which another one's discs are looked for


@dataclass(frozen=True, slots=True)
class Tracked:
    """Results of the tracker on the frames."""

    rolling: Rolling
    sightings: Sightings
    size: float  # of the discs as fitted, over what was expected
    lost: int  # times it lost the ball
    frames: int  # all there were


@dataclass(slots=True)
class _Stretch:
    """Frames in which one map was kept: of each frame what it showed."""

    stamp: list[float] = field(default_factory=list)
    attitude: list[Array] = field(default_factory=list)  # R_obj_ball
    direction: list[Array] = field(default_factory=list)  # (n, 3) obj
    centre: list[Array] = field(default_factory=list)
    covariance: list[Array] = field(default_factory=list)
    discs: Array = field(default_factory=lambda: np.zeros((0, 3)))  # the map in the end


def provisional_pose(direction: Array, ratio: float) -> Pose:
    """The camera in `obj`, its axes those of the picture, for a ball of radius 1."""
    return Pose(R_OBJ_CAM, -ratio * (R_OBJ_CAM @ direction))


def track_rolling(
    frames: Iterable[Frame], rig: Rig, pose: Pose, settings: Settings, seen: Callable[[], None] = lambda: None
) -> Tracked:
    """Run the tracker over all frames; `seen` is called after each.

    CalibrationError where it hardly ever holds the ball.
    """
    tracker = build(rig, pose, settings)
    state: TrackState | None = None
    stretches = [_Stretch()]
    sizes: list[float] = []
    lost, count, status = 0, 0, Status.SEARCHING
    for frame in frames:
        state = state or begin(tracker, frame.stamp)
        state = step(state, frame, tracker).state
        count += 1
        lost += state.status is Status.LOST and status is not Status.LOST
        status = state.status
        f = state.filter
        if state.search.size > 0.0:
            sizes.append(state.search.size)
        if not state.known_to_turn:  # any candidate may be a look-alike; and what comes then is another map
            if stretches[-1].stamp:
                stretches.append(_Stretch())
        elif isinstance(f, So3State) and state.confirmed and status is Status.TRACKING:
            into, points = stretches[-1], state.points
            into.stamp.append(frame.stamp)
            into.attitude.append(f.attitude)
            into.direction.append(points.direction)
            into.centre.append(state.detections.centre[points.index])
            into.covariance.append(state.detections.covariance[points.index])
            into.discs = f.discs
        seen()
    best = max(stretches, key=lambda s: len(s.stamp))
    if len(best.stamp) < 10:
        raise CalibrationError("the ball is hardly seen to turn: roll it on in all directions, slowly, for a minute")
    joined = [s if s is best else _in_frame_of(best, s, rig, pose) for s in stretches]
    rolling, sightings = _numbered([s for s in joined if s is not None], best.discs, rig, pose)
    return Tracked(rolling, sightings, float(np.median(sizes)) if sizes else 1.0, lost, count)


def _in_frame_of(best: _Stretch, other: _Stretch, rig: Rig, pose: Pose) -> _Stretch | None:
    """The other stretch with the attitudes of the best one's map, where its discs are recognised there."""
    towards = pose.position / np.linalg.norm(pose.position)
    order = np.argsort([-len(d) for d in other.direction], kind="stable")[:_TRIED]
    for k in order:
        found = identify(
            other.direction[k],
            best.discs,
            sigma=_SIGMA,
            view_axis=towards,
            horizon=rig.ball.radius / float(np.linalg.norm(pose.position)),
            risk=_RISK,
        )
        if found is not None:
            turn = other.attitude[k].T @ found.rotation
            other.attitude = [R @ turn for R in other.attitude]
            return other
    return None


def _numbered(stretches: list[_Stretch], discs: Array, rig: Rig, pose: Pose) -> tuple[Rolling, Sightings]:
    """All frames in the order of time, with the discs of the map that each sighting is nearest to."""
    stamp = np.concatenate([s.stamp for s in stretches])
    attitude = np.concatenate([np.array(s.attitude) for s in stretches])
    direction = [d for s in stretches for d in s.direction]
    frame = np.repeat(np.arange(len(stamp)), [len(d) for d in direction])
    ball = np.einsum("nji,nj->ni", attitude[frame], np.concatenate(direction))
    cosine = ball @ discs.T
    disc = cosine.argmax(axis=1)
    near = cosine.max(axis=1) > np.cos(2.0 * rig.disc_radius / rig.ball.radius)
    near &= _plain(np.concatenate(direction), rig, pose)
    to_centre = pose.to_cam(rig.ball.centre)
    ratio = float(np.linalg.norm(to_centre))
    rolling = Rolling(to_centre / ratio, ratio, discs, stamp, pose.rotation.T @ attitude, rig.readout_s)
    centre = np.concatenate([c for s in stretches for c in s.centre])
    covariance = np.concatenate([c for s in stretches for c in s.covariance])
    return rolling, Sightings(frame, disc, centre, covariance).take(near & _once(frame, disc, cosine.max(axis=1)))


def _plain(directions: Array, rig: Rig, pose: Pose) -> NDArray[np.bool_]:
    """Which discs at `directions`, (n, 3) in obj, are seen well enough to tell a centre without bias, (n,)."""
    shape = np.nan_to_num(appearance(directions, rig, pose).shape)
    minor = np.sqrt(np.maximum(np.linalg.eigvalsh(shape)[:, 0], 0.0))
    return minor >= min(_SLIVER, 0.5 * float(minor.max(initial=0.0)))


def _once(frame: NDArray[np.intp], disc: NDArray[np.intp], worth: Array) -> NDArray[np.bool_]:
    """Of sightings of one disc in one frame the one that is worth most, (n,)."""
    order = np.lexsort((-worth, disc, frame))
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(frame[order]) != 0) | (np.diff(disc[order]) != 0)
    keep = np.empty(len(order), dtype=bool)
    keep[order] = first
    return keep
