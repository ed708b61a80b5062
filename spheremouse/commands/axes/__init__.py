"""`spheremouse axes`: three gestures tell where the player stands, and the pointer goes where the hand goes."""

import os
import sys
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer

from spheremouse.errors import CalibrationError, ConfigurationError

if TYPE_CHECKING:
    from spheremouse.capture.stopping import Stopping
    from spheremouse.geometry.rotation import Array
    from spheremouse.output.gestures import Understood
    from spheremouse.session.directions import Directions
    from spheremouse.session.follower import Follower, Tracked
    from spheremouse.session.plan import Plan, Request
    from spheremouse.session.settings import Configuration

_SHIFT = 0.4  # m of a hand that are taken for a radian: a forearm does the one with as much ease as a wrist the other
_ON_TOP = "push the top of the ball, not its front or its underside, each time one way"
_MIRRORED = "no player's right, away and counter-clockwise go together so"


def axes(
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="What is understood is saved into it, comments kept; made if missing."),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="KIND:ARG", help="Camera or recording, as of `run`.  [default: `source` of the configuration]"
        ),
    ] = None,
    rig: Annotated[Path | None, typer.Option(metavar="FILE", help="The device as calibrated.")] = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Interior orientation, in place of the rig's.")
    ] = None,
    tracker: Annotated[
        Literal["so3", "wand"] | None, typer.Option(help="A ball in its frame, or in a hand.  [default: as configured]")
    ] = None,
    balls: Annotated[
        list[Path] | None, typer.Option("--ball", metavar="FILE", help="Wand: a ball's wand file.")
    ] = None,
    assignments: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter of the configuration.")
    ] = None,
    dry: Annotated[bool, typer.Option("--dry-run", help="Say what is understood, and save nothing.")] = False,
) -> None:
    """Say by three gestures which way the pointer shall go.

    Roll the ball to the right, roll it away from you, spin it; each time one way, and let it rest. Then the pointer
    goes right and up with your hand. With a recording, the gestures are looked for in it.
    """
    from spheremouse.capture.stopping import Stopping
    from spheremouse.commands.run import follow, serve
    from spheremouse.files.edit import check_place
    from spheremouse.session import trackers
    from spheremouse.session.cameras import is_camera
    from spheremouse.session.plan import Request, read_plan
    from spheremouse.session.process.standard_error import unhurried

    said = () if tracker is None else (f"tracker={tracker}",)
    there = config is not None and config.exists()
    if config is not None and not dry:
        check_place(config)
        if not os.access(config.parent, os.W_OK) or (there and not os.access(config, os.W_OK)):
            raise ConfigurationError(f"{config}: this account may not write it; use sudo, or only look with --dry-run")
    file, told = config if there else None, (*(assignments or ()), *said)
    request = Request(file, told, source, "null", rig, camera, None, no_map=True, balls=tuple(balls or ()))
    plan = read_plan(request)
    live = is_camera(plan.source)
    with unhurried() if live else nullcontext(), Stopping() as stopping:
        setup = trackers.setup(plan)
        plan = setup.planned(request, plan)
        dialogue = Dialogue(plan.configuration, stopping, live)
        failure, _ = (serve if live else follow)(request, plan, setup, stopping, dialogue, None)
    if dialogue.found is None and failure is not None:
        raise failure
    values = dialogue.conclusion()
    if dialogue.stopped:
        raise KeyboardInterrupt
    for key, value, before in values:
        print(f"{key}: {_shown(value)} ({'as it was' if value == before else f'was {_shown(before)}'})")
    kept = {} if config is None or there else _begun(plan, request, config.parent)
    _keep(config, kept | {tuple(key.split(".")): value for key, value, _ in values}, dry)


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked for, and the settings that may come of it."""

    gestures: tuple[str, str, str]
    section: tuple[str, ...]
    choices: tuple[tuple[str, Any, str], ...]  # a setting, its value, and of whom it is
    directions: tuple["Directions", ...]  # of each
    unit: float  # rad or m

    @property
    def ways(self) -> list["Array"]:
        """The gestures of each choice, (3, 3) unit vectors: along, against and along its directions."""
        return [np.array([[1.0], [-1.0], [1.0]]) * choice.axes for choice in self.directions]


def asked_of(configuration: "Configuration") -> Asked:
    """The gestures of a ball in its frame, or in a hand."""
    from spheremouse.output.counts import MotionSettings, Player
    from spheremouse.session.directions import of_ball, of_hand

    if configuration.tracker == "wand":
        pointing, turns = configuration.wand.pointing, configuration.wand.pointing.by == "turn"
        turn = ("point the ball to the right", "point it up", "turn it clockwise, as you see it")
        shift = ("move the ball to the right", "move it up", "move it ahead, the way you look")
        return Asked(
            turn if turns else shift,
            ("wand", "pointing"),
            (("facing", True, "you face the camera"), ("facing", False, "you look the way the camera does")),
            tuple(of_hand(replace(pointing, facing=facing)) for facing in (True, False)),
            1.0 if turns else _SHIFT,
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
    """Asks for one gesture after the other, and says what it has understood: what shows a run to a person."""

    def __init__(self, configuration: "Configuration", stopping: "Stopping", live: bool) -> None:
        """`stopping` is asked as soon as all is understood."""
        from spheremouse.output.gestures import Watch
        from spheremouse.session.screen import Tally

        self.tally, self._stopping, self._live = Tally(), stopping, live
        self._configuration, self._asked = configuration, asked_of(configuration)
        self._watch = Watch(self._asked.unit)
        self._made: list[Array] = []
        self._begun = False
        self.found: Understood | None = None

    @property
    def stopped(self) -> bool:
        """By a signal, before all was understood."""
        return self._stopping.asked and self.found is None

    def say(self, text: str) -> None:
        """Lines of the run."""
        print(text, file=sys.stderr, flush=True)

    def show(self, made: "Tracked", follower: "Follower") -> None:
        """Look at the motion of a frame."""
        self.tally.add(made.report.counts, sum(made.seconds.values()))
        motion = made.report.motion
        if not motion.confirmed or self.found is not None:
            return
        if not self._begun:
            self._begun = True
            self._ask()
        way = np.concatenate([motion.rotation, motion.shift])[self._asked.directions[0].part]
        self._take(self._watch.add(motion.stamp, way))

    def conclusion(self) -> list[tuple[str, Any, Any]]:
        """Settings by name, with their values and those before. Raises CalibrationError where too little was shown."""
        if self.stopped:
            return []
        self._take(self._watch.ended())  # a recording may end without a rest
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
        print(f"{len(self._made) + 1} of 3: {self._asked.gestures[len(self._made)]}, and let it rest", flush=True)

    def _take(self, gesture: Any) -> None:
        if gesture is None or self.found is not None:
            return
        size = f"{np.degrees(gesture.size):.0f}°" if self._asked.unit == 1.0 else f"{100 * gesture.size:.0f} cm"
        if not gesture.straight:
            print("   that went to and fro: once, one way, please", flush=True)
            return
        self._made.append(gesture.way)
        print(f"   seen: {size}", flush=True)
        if len(self._made) < len(self._asked.gestures):
            self._ask()
            return
        self._understand()

    def _understand(self) -> None:
        from spheremouse.output.gestures import understood

        found = understood(self._made, self._asked.ways)
        off = ", ".join(f"{np.degrees(angle):.0f}°" for angle in found.off)
        if found.fits:
            self.found = found
            saying = self._asked.choices[found.candidate][2]
            print(f"understood: {saying} (the gestures are off by {off})", flush=True)
            self._stopping.asked = True
            return
        what = f"not understood: {_MIRRORED} (off by {off}); {_ON_TOP}"
        if not self._live:
            raise CalibrationError(f"{what}; if it was so, the rig's Y points down: calibrate the device anew")
        print(f"{what}; again, from the first one", flush=True)
        self._made.clear()
        self._ask()


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _begun(plan: "Plan", request: "Request", beside: Path) -> dict[tuple[str, ...], Any]:
    """What the first lines of a configuration say: what this run was told on its command line."""
    from spheremouse.files.config import assigned
    from spheremouse.session.cameras import is_camera

    said: dict[tuple[str, ...], Any] = {("source",): plan.source} if is_camera(plan.source) else {}
    said |= assigned(plan.configuration, request.assignments)
    for key, path in (("rig", request.rig), ("camera_file", request.camera)):
        if path is not None:
            said[key,] = os.path.relpath(path, beside)
    if request.balls:
        said["wand", "balls"] = tuple(os.path.relpath(path, beside) for path in request.balls)
    return said


def _keep(config: Path | None, values: dict[tuple[str, ...], Any], dry: bool) -> None:
    """Write settings into the configuration, or say where they belong."""
    from spheremouse.files.edit import save_settings
    from spheremouse.session.settings import Configuration

    if dry:
        print("nothing is saved")
    elif config is None:
        print("write it into your configuration, or give that with --config and it is")
    else:
        save_settings(config, values, Configuration)
        print(f"{config}: saved")
