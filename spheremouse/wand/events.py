"""Problems of a hand-held ball that its pose does not show: the events, and the rules that raise them."""

from dataclasses import dataclass, field, replace

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Event, Status
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import Fields
from spheremouse.wand.likelihood import FULL_FACING
from spheremouse.wand.peaks import CERTAIN_MATCH, Modes, Scene, SearchContext, modes_without_prior
from spheremouse.wand.state import Track, WandState, WandTracker

_PATIENCE_TURNED_AWAY = 10.0  # searches: a hand does not hold one side towards the camera for so long
MIN_SIGHTINGS = 3  # of a second ball in a row: accidental matches of clutter do not last
_MIN_COLOUR_FRACTION, _MAX_COLOUR_FRACTION = 2e-6, 0.25  # of the picture: a ball has more and less


@dataclass(frozen=True, slots=True)
class BallEvent(Event):
    ball: str


class NotInView(BallEvent):
    """The tracker has not found the ball yet."""


class BallLost(BallEvent):
    """The tracker has lost the ball."""


class BallHidden(BallEvent):
    """The ball does not show for a moment. Its pose is predicted."""


class SecondBall(BallEvent):
    """Another ball like this one is in view, but not declared."""


@dataclass(frozen=True, slots=True)
class ColourNowhere(Event):
    """The bounds of a colour match nothing in the picture."""

    colour: str


@dataclass(frozen=True, slots=True)
class ColourEverywhere(Event):
    """The bounds of a colour match more of the picture than a ball has."""

    colour: str
    fraction: float = field(compare=False)  # of the picture


def missing_ball(ball: WandBall, last_seen: float) -> Event:
    """Return the event of a ball that is not in view; `last_seen` s is -inf if it never was."""
    return BallLost(ball.name) if np.isfinite(last_seen) else NotInView(ball.name)


def colours_turned_away(tracker: WandTracker, tracks: list[Track]) -> set[str]:
    """Return the colours of which no disc faces the camera. A ball without a pose may show all of its discs."""
    away = set(tracker.names)
    for ball, discs, track in zip(tracker.balls, tracker.discs, tracks, strict=True):
        margin = np.ones(len(discs))  # cosine from the line of sight to each disc, less that of the horizon
        if track.phase == Status.TRACKING and track.pose is not None:
            position, R_cam_ball, _ = track.pose
            distance = np.linalg.norm(position)
            margin = -(discs[:, :3] @ R_cam_ball.T) @ position / distance - ball.radius / distance
        away -= {disc.colour for disc, m in zip(ball.discs, margin, strict=True) if m > FULL_FACING}
    return away


def colour_problem(whole: Fields, turned_away: set[str]) -> tuple[Event | None, float]:
    """Return the problem with the bounds of the colours, or None, and the number of searches for which it must last.

    A colour of `turned_away` may be missing for longer: after that time its bounds are wrong, and so is the pose.
    """
    found: list[tuple[Event, float]] = []
    for name, fraction in zip(whole.colours, whole.fraction, strict=True):
        if fraction < _MIN_COLOUR_FRACTION:
            found.append((ColourNowhere(name), _PATIENCE_TURNED_AWAY if name in turned_away else 1.0))
        if fraction > _MAX_COLOUR_FRACTION and name not in ("dark", "light"):
            found.append((ColourEverywhere(name, float(fraction)), 0.0))
    return min(found, key=lambda one: one[1], default=(None, 0.0))


def update_colour_problem(state: WandState, stamp: float, scene: Scene, tracks: list[Track]) -> WandState:
    """Return the state with the problem of the colours that the fields of the whole picture show, if they are known."""
    if scene.whole is None:
        return state
    problem, patience = colour_problem(scene.whole, colours_turned_away(scene.tracker, tracks))
    unchanged = problem == state.colour_problem
    age, lasted = (state.colour_problem_age, stamp - state.colour_problem_stamp) if unchanged else (0.0, 0.0)
    age = age + lasted / (patience * scene.tracker.settings.look_around) if patience else 1.0
    return replace(state, colour_problem=problem, colour_problem_age=age, colour_problem_stamp=stamp)


def second_ball_unconfirmed(track: Track) -> bool:
    """Return true after a sighting of a second ball that needs more sightings."""
    return track.second is not None and track.second[0] < MIN_SIGHTINGS


def update_second_ball(
    track: Track, modes: Modes, first: Array | None, dt: float, context: SearchContext
) -> tuple[Track, SecondBall | None]:
    """Count sightings of a second ball in a search of the whole picture; return the track, and the event or None.

    `first` (3,) m is the position of the tracked ball. A second ball lies beside it in the picture, has half
    its evidence, and passes without a prior three times in a row. Between two sightings it moves no farther than a ball
    can in `dt` s.
    """
    s, ball = context.tracker.settings, context.ball
    if first is None or not modes.peaks:
        return replace(track, second=None), None
    least = max(s.evidence, 0.5 * modes.log_likelihood[0])
    good = [i for i, value in enumerate(modes.log_likelihood) if value >= least and modes.match[i] >= CERTAIN_MATCH]
    for k in modes_without_prior(modes.select(good), context).peaks:
        separation = np.linalg.norm(k.position[:2] / k.position[2] - first[:2] / first[2])
        if separation < ball.radius / k.position[2] + ball.radius / first[2]:
            continue
        times, before = track.second or (0, k.position)
        moved_by = np.linalg.norm(k.position[:2] / k.position[2] - before[:2] / before[2]) * k.position[2]
        times = min(times + 1, MIN_SIGHTINGS) if moved_by < ball.radius + s.fastest * dt else 1
        return replace(track, second=(times, k.position)), SecondBall(ball.name) if times == MIN_SIGHTINGS else None
    return replace(track, second=None), None
