"""Why a ball is not seen."""

from dataclasses import replace

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Event, Status
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import Fields
from spheremouse.wand.events import BallLost, ColourEverywhere, ColourNowhere, NotInView, SecondBall
from spheremouse.wand.likelihood import FULLY
from spheremouse.wand.peaks import SURE, Found, SearchContext, passes_without_prior, some_peaks
from spheremouse.wand.state import Track, WandTracker

_AWAY = 10.0  # searches in which no hand holds one side towards the camera
_SIGHTINGS = 3  # in a row, of a second ball before a word is said: what clutter makes of a spot or two does not last
_NOTHING, _TOO_MUCH = 2e-6, 0.25  # part of the picture of one colour that no ball makes


def turned_away(tracker: WandTracker, tracks: list[Track]) -> set[str]:
    """Colours that all balls that have them are known to hide."""
    away = set(tracker.names)
    for ball, discs, track in zip(tracker.balls, tracker.discs, tracks, strict=True):
        facing = np.ones(len(discs))
        if track.phase == Status.TRACKING and track.pose is not None:
            p, R, _ = track.pose
            facing = -(discs[:, :3] @ R.T) @ p / np.linalg.norm(p) - ball.radius / np.linalg.norm(p)
        away -= {disc.colour for disc, faces in zip(ball.discs, facing, strict=True) if faces > FULLY}
    return away


def complaint_of(whole: Fields, away: set[str]) -> tuple[Event | None, float]:
    """What is wrong with the colours, and for how long it should be before a word: in searches.

    `away`: colours that are turned away, or else their bounds are wrong and the pose is one that does without.
    """
    found: list[tuple[Event, float]] = []
    for name, share in zip(whole.colours, whole.share, strict=True):
        if share < _NOTHING:
            found.append((ColourNowhere(name), _AWAY if name in away else 1.0))
        if share > _TOO_MUCH and name not in ("dark", "light"):
            found.append((ColourEverywhere(name, float(share)), 0.0))
    return min(found, key=lambda one: one[1], default=(None, 0.0))


def doubtful(track: Track) -> bool:
    """Has a second ball been seen, but not often enough to say so?"""
    return track.second is not None and track.second[0] < _SIGHTINGS


def second_ball(
    track: Track, found: Found, first: Array | None, dt: float, sought: SearchContext
) -> tuple[Track, SecondBall | None]:
    """The track with what a search of the whole picture says of a second ball like it, and that where it is there.

    `first` is where the ball is. A second one lies beside it in the picture, shows half as much, and is a ball wherever
    it is looked for, `_SIGHTINGS` times in a row, no farther from where it was than it can have moved in `dt` s.
    """
    s, ball = sought.tracker.settings, sought.ball
    if first is None or not found.peaks:
        return replace(track, second=None), None
    least = max(s.evidence, 0.5 * found.log_likelihood[0])
    good = [i for i in range(len(found.peaks)) if found.log_likelihood[i] >= least and found.match[i] >= SURE]
    for k in passes_without_prior(some_peaks(found, good), sought).peaks:
        apart = np.linalg.norm(k.position[:2] / k.position[2] - first[:2] / first[2])
        if apart < ball.radius / k.position[2] + ball.radius / first[2]:
            continue
        times, before = track.second or (0, k.position)
        moved_by = np.linalg.norm(k.position[:2] / k.position[2] - before[:2] / before[2]) * k.position[2]
        times = min(times + 1, _SIGHTINGS) if moved_by < ball.radius + s.fastest * dt else 1
        return replace(track, second=(times, k.position)), SecondBall(ball.name) if times == _SIGHTINGS else None
    return replace(track, second=None), None


def unseen(ball: WandBall, seen: float) -> Event:
    """Of a ball that is not in view, and was `seen` last, s."""
    return BallLost(ball.name) if np.isfinite(seen) else NotInView(ball.name)
