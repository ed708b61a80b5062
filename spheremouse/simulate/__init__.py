"""A simulated camera films a simulated ball: frames and exact truth, without files, clocks or a graphics card.

`SimulationOptions` says what to film, in the words of the command line; `prepare` builds it and `simulate` films it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from spheremouse.errors import ConfigurationError
from spheremouse.simulate.hands import HandVisit
from spheremouse.simulate.profile import Profile, play, roll, still, thesis
from spheremouse.simulate.render import Dimming, Renderer, RenderOptions, SimulatedFrame
from spheremouse.simulate.scene import Scene, View, default_scene

__all__ = [
    "Dimming",
    "HandVisit",
    "Motion",
    "RenderOptions",
    "Renderer",
    "Scene",
    "SimulatedFrame",
    "Simulation",
    "SimulationOptions",
    "View",
    "default_scene",
    "prepare",
    "simulate",
]

Motion = Literal["thesis", "roll", "play", "still"]


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """What to film; the fields are the options of `spheremouse simulate`."""

    discs: int = 26
    view: View = "far"
    motion: Motion = "thesis"
    turns: float = 20.0  # of motion "roll"
    seconds: float | None = None  # s; None: as long as the motion takes
    fps: float = 30.0  # Hz
    noise: float = 0.0  # grey values
    brightness: float = 0.0  # grey values
    blur: float = 0.0  # s, exposure time
    readout: float = 0.0  # s, rolling shutter
    seed: int = 0
    size: tuple[int, int] = (640, 480)  # px, width and height
    dist: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1, k2, p1, p2, k3
    hands: bool = False  # one hand for a while, later two
    dim: float | None = None  # factor on the brightness for a while in the middle


@dataclass(frozen=True, slots=True)
class Simulation:
    """Everything that `simulate` needs."""

    scene: Scene
    profile: Profile
    options: RenderOptions
    seconds: float  # s
    fps: float  # Hz
    seed: int

    @property
    def frames(self) -> int:
        """How many there will be."""
        return max(1, round(self.seconds * self.fps))


def prepare(options: SimulationOptions) -> Simulation:
    """Scene, motion and effects of some options; ConfigurationError where they make no sense."""
    _check(options)
    width, height = options.size
    try:
        scene = default_scene(
            options.discs,
            options.view,
            options.seed,
            width=width,
            height=height,
            distortion=np.array(options.dist),
            exposure_s=options.blur,
            readout_s=options.readout,
        )
    except ValueError as e:
        raise ConfigurationError(f"--discs {options.discs}: {e}") from None
    profile = _profile(options)
    seconds = profile.seconds if options.seconds is None else options.seconds
    hands = dimming = ()
    if options.hands:
        hands = (
            HandVisit(0.25 * seconds, 0.45 * seconds, True),
            HandVisit(0.65 * seconds, 0.90 * seconds, True),
            HandVisit(0.68 * seconds, 0.90 * seconds, False),
        )
    if options.dim is not None:
        dimming = (Dimming(0.4 * seconds, 0.6 * seconds, options.dim),)
    effects = RenderOptions(options.noise, options.brightness, dimming, hands)
    return Simulation(scene, profile, effects, seconds, options.fps, options.seed)


def simulate(simulation: Simulation, renderer: Renderer | None = None) -> Iterator[SimulatedFrame]:
    """Its frames one by one, with truth; stamps start at 0. A `renderer` made before may be handed in."""
    renderer = Renderer(simulation.scene, simulation.options) if renderer is None else renderer
    rng = np.random.Generator(np.random.SFC64([simulation.seed, 1]))  # NumPy's fastest: noise takes most of the time
    for index in range(simulation.frames):
        yield renderer.frame(simulation.profile, index / simulation.fps, index, rng)


def _profile(options: SimulationOptions) -> Profile:
    if options.motion == "thesis":
        return thesis()
    if options.motion == "roll":
        return roll(options.turns, options.seconds)
    if options.motion == "play":
        return play(20.0 if options.seconds is None else options.seconds, np.random.default_rng([options.seed, 2]))
    return still(10.0)


def _check(options: SimulationOptions) -> None:
    positive = {"--turns": options.turns, "--fps": options.fps, "--discs": options.discs, "--size": min(options.size)}
    not_negative = {"--noise": options.noise, "--blur": options.blur, "--readout": options.readout}
    if options.seconds is not None:
        positive["--seconds"] = options.seconds
    if options.dim is not None:
        not_negative["--dim"] = options.dim
    for name, value in positive.items():
        if not value > 0 or not np.isfinite(value):
            raise ConfigurationError(f"{name}: {value} must be above 0")
    for name, value in not_negative.items():
        if not value >= 0 or not np.isfinite(value):
            raise ConfigurationError(f"{name}: {value} must not be below 0")
    for name, value in (("--blur", options.blur), ("--readout", options.readout)):
        if value > 1.0 / options.fps:
            raise ConfigurationError(f"{name}: {value:g} s is longer than a frame at {options.fps:g} Hz")
