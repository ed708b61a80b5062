"""Dialogue of `spheremouse axes`: the gestures, and their evaluation."""

import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spheremouse.capture.signals import SignalHandler
from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array
from spheremouse.output import Report
from spheremouse.output.counts import MotionSettings, Player
from spheremouse.output.gestures import DirectionMatch, GestureDetector, match_directions
from spheremouse.session.directions import Directions, of_ball, of_hand
from spheremouse.session.screen import Tally
from spheremouse.session.settings import Configuration
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter

# m of a hand that count as a radian: a forearm moves so far as easily as a wrist turns by that
_SHIFT_PER_RADIAN_M = 0.4
_ON_TOP = "push the top of the ball, not its front or its underside, each time one way"
_MIRRORED = "no player's right, away and counter-clockwise go together so"


@dataclass(frozen=True, slots=True)
class Asked:
    """Requested gesture, and the settings that it can change."""

    gestures: tuple[str, str, str]
    section: tuple[str, ...]
    choices: tuple[tuple[str, Any, str], ...]  # a setting, its value, and the player that it fits
    directions: tuple[Directions, ...]  # of each
    unit: float  # rad or m

    @property
    def ways(self) -> list[Array]:
        """Unit vectors, (3, 3), of the gestures for each choice: its directions, the second one reversed."""
        return [np.array([[1.0], [-1.0], [1.0]]) * choice.axes for choice in self.directions]


def asked_of(configuration: Configuration) -> Asked:
    """Return the gestures of a ball in its frame, or in a hand."""
    if configuration.tracker == "wand":
        pointing, turns = configuration.wand.pointing, configuration.wand.pointing.by == "turn"
        turn = ("point the ball to the right", "point it up", "turn it clockwise, as you see it")
        shift = ("move the ball to the right", "move it up", "move it ahead, the way you look")
        return Asked(
            turn if turns else shift,
            ("wand", "pointing"),
            (("facing", True, "you face the camera"), ("facing", False, "you look the way the camera does")),
            tuple(of_hand(replace(pointing, facing=facing)) for facing in (True, False)),
            1.0 if turns else _SHIFT_PER_RADIAN_M,
        )
    seats: dict[Player, str] = {
        "far-side": "you stand on the far side of the ball, opposite the camera",
        "camera-side": "you stand on the camera's side of the ball",
        "left": "you stand at the left of the ball, as the camera sees it",
        "right": "you stand at the right of the ball, as the camera sees it",
    }
    return Asked(
        (
            "roll the ball to the right, your hand on its top",
            "roll it away from you",
            "spin it counter-clockwise, as seen from above",
        ),
        ("motion",),
        tuple(("player", player, saying) for player, saying in seats.items()),
        tuple(of_ball(MotionSettings(player=player)) for player in seats),
        1.0,
    )


class Dialogue:
    """Asks for one gesture after the other, and prints the result. It is the view of a run."""

    def __init__(self, configuration: Configuration, stopping: SignalHandler, live: bool) -> None:
        """Prepare; the dialogue ends the run through `stopping` as soon as it has a result."""
        self.tally, self._stopping, self._live = Tally(), stopping, live
        self._configuration, self._asked = configuration, asked_of(configuration)
        self._detector = GestureDetector(self._asked.unit)
        self._made: list[Array] = []
        self._begun = False
        self.found: DirectionMatch | None = None

    @property
    def stopped(self) -> bool:
        """True if a signal ended it before it had a result."""
        return self._stopping.stop_requested and self.found is None

    def log(self, text: str) -> None:
        """Lines of the run."""
        print(text, file=sys.stderr, flush=True)

    def show(self, result: FrameResult, report: Report, adapter: TrackerAdapter) -> None:
        """Look at the motion of a frame."""
        self.tally.add(report.counts, sum(result.seconds.values()))
        estimate = result.samples[result.pointing].estimate
        if not estimate.confirmed or self.found is not None:
            return
        if not self._begun:
            self._begun = True
            self._ask()
        way = estimate.increment[self._asked.directions[0].part]
        self._take(self._detector.add(estimate.stamp, way))

    def conclusion(self) -> list[tuple[str, Any, Any]]:
        """Return settings by name, with their new and old values. Raises CalibrationError if gestures are missing."""
        if self.stopped:
            return []
        self._take(self._detector.finish())  # a recording may end without a rest
        if self.found is None:
            which = " and ".join(f"'{words}'" for words in self._asked.gestures[len(self._made) :])
            raise CalibrationError(f"{len(self._made)} of 3 gestures were seen; missing: {which}")
        before: Any = self._configuration
        for name in self._asked.section:
            before = getattr(before, name)
        name, value, _ = self._asked.choices[self.found.candidate]
        wanted = {name: value} | {name: False for name in ("invert_x", "invert_y") if getattr(before, name)}
        prefix = ".".join(self._asked.section)
        return [(f"{prefix}.{name}", value, getattr(before, name)) for name, value in wanted.items()]

    def _ask(self) -> None:
        gesture = self._asked.gestures[len(self._made)]
        prompt = f"{gesture}, and let it rest" if self._live else f"in the recording: {gesture}"
        print(f"{len(self._made) + 1} of 3: {prompt}", flush=True)

    def _take(self, gesture: Any) -> None:
        """Accept a gesture if it was straight, and prompt for the next one or evaluate all three."""
        if gesture is None or self.found is not None:
            return
        size = f"{np.degrees(gesture.size):.0f}°" if self._asked.unit == 1.0 else f"{100 * gesture.size:.0f} cm"
        if not gesture.straight:
            print(f"   that went to and fro{': once, one way, please' if self._live else ', and is none'}", flush=True)
            return
        self._made.append(gesture.displacement)
        print(f"   seen: {size}", flush=True)
        if len(self._made) < len(self._asked.gestures):
            self._ask()
            return
        self._understand()

    def _understand(self) -> None:
        """Match the three gestures with the players' places. If none fits, begin again, or fail for a recording."""
        found = match_directions(self._made, self._asked.ways)
        errors = ", ".join(f"{np.degrees(angle):.0f}°" for angle in found.errors)
        if found.fits:
            self.found = found
            saying = self._asked.choices[found.candidate][2]
            print(f"understood: {saying} (the gestures are off by {errors})", flush=True)
            self._stopping.stop_requested = True
            return
        what = f"not understood: {_MIRRORED} (off by {errors}); {_ON_TOP}"
        if not self._live:
            raise CalibrationError(f"{what}; if you did this, the rig's Y points down: calibrate the device again")
        print(f"{what}; again, from the first one", flush=True)
        self._made.clear()
        self._ask()
