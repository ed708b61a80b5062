"""Films of a simulated wand: `prepare_wand` builds a scene as in Grzonka 2005, chapter 4; `simulate_wand` films it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array
from spheremouse.settings import option_name
from spheremouse.simulate.ball.film import MAX_FRAMES
from spheremouse.simulate.ball.options import check_bounds
from spheremouse.simulate.wand.options import WandOptions
from spheremouse.simulate.wand.path import DRIVE_SPEED, HAND_RATE, HAND_SPEED, WandPath, drive, hand
from spheremouse.simulate.wand.render import Carried, WandRenderer, WandScene, indoor_light, outdoor_light
from spheremouse.simulate.wand.room import Passing
from spheremouse.tracker import Frame
from spheremouse.wand.ball import WandBall, WandTruth, grzonka_ball

_FPS = {"drive": 0.8, "hand": 15.0}  # Hz: of the thesis' recording, and as required for a hand
_FOCAL = {"drive": 2100.0, "hand": 1000.0}  # px at 1280 columns: the thesis' lens, and that of a webcam
_HAND_SECONDS = 20.0
_REFERENCE_WIDTH_PX = 1280  # px, that those focal lengths are for
_HAND_SPEED_M_S = 0.10  # m/s, of the hand past the robot, as in the shared recording


@dataclass(frozen=True, slots=True)
class WandFilm:
    """Everything that `simulate_wand` needs."""

    scene: WandScene
    fps: float  # Hz
    begin: float  # s
    frames: int

    @property
    def stamps(self) -> Array:
        """(n,) s, from 0."""
        return np.arange(self.frames) / self.fps

    def truth(self, ball: int = 0) -> WandTruth:
        """True motion of one of the balls."""
        return WandTruth(self.stamps, *self.scene.balls[ball].path.pose(self.begin + self.stamps))


@dataclass(frozen=True, slots=True)
class WandShot:
    """A frame with its ground truth."""

    frame: Frame
    position: Array  # (k, 3) m, centres of the k balls in cam
    rotation: Array  # (k, 3, 3) R_cam_ball


def prepare_wand(options: WandOptions, ball: WandBall | None = None) -> WandFilm:
    """Return scene and motion, with `ball` or Grzonka's. Raise ConfigurationError if the options are invalid."""
    _check_options(options)
    fps = options.fps or _FPS[options.motion]
    paths = _paths(options)
    length = min(p.seconds for p in paths) - options.begin
    seconds = length if options.seconds is None else options.seconds
    if seconds > length + 1e-9:
        raise ConfigurationError(
            f"--seconds: {seconds:g} s from {options.begin:g} s on; this motion ends {length:.1f} s after that"
        )
    frames = max(1, int(np.floor(seconds * fps + 1e-9)))
    if frames > MAX_FRAMES:
        raise ConfigurationError(f"--seconds: {frames} frames; at most {MAX_FRAMES} make a recording")
    for field in ("hand", "card"):
        time = getattr(options, field)
        if time is not None and not 0.0 <= time < seconds:
            raise ConfigurationError(f"--{field}: {time:g} s is not within the film's {seconds:g} s")
    rng = np.random.default_rng([options.seed, 12])
    outdoors, (width, height) = options.light == "outdoor", options.size
    focal = _FOCAL[options.motion] * width / _REFERENCE_WIDTH_PX if options.focal is None else options.focal
    scene = WandScene(
        InteriorOrientation(width, height, focal, focal, 0.5 * width, 0.5 * height, np.array(options.dist)),
        tuple(Carried(ball or grzonka_ball(), p, "robot" if options.motion == "drive" else "stick") for p in paths),
        outdoor_light(rng) if outdoors else indoor_light(),
        outdoors=outdoors,
        clutter=options.clutter,
        exposure_s=options.blur,
        noise=options.noise,
        hands=_passing(options, paths[0], options.hand, rng, beside=True),
        cards=_passing(options, paths[0], options.card, rng, beside=False),
        seed=options.seed,
        vary=options.vary,
    )
    return WandFilm(scene, fps, options.begin, frames)


def simulate_wand(film: WandFilm) -> Iterator[WandShot]:
    """Yield the frames with truth. Stamps start at 0."""
    renderer = WandRenderer(film.scene)
    rng = np.random.Generator(np.random.SFC64([film.scene.seed, 13]))
    truths = [film.truth(k) for k in range(len(film.scene.balls))]
    for index, stamp in enumerate(film.stamps.tolist()):
        image = renderer.picture(film.begin + stamp, rng)
        position = np.array([truth.position[index] for truth in truths])
        rotation = np.array([truth.rotation[index] for truth in truths])
        yield WandShot(Frame(image, stamp, index), position, rotation)


def _paths(options: WandOptions) -> list[WandPath]:
    """Return one path per ball. The first path does not depend on the others."""
    rngs = [np.random.default_rng([options.seed, 14, k]) for k in range(options.balls)]
    if options.motion == "drive":
        speed = (options.speed or DRIVE_SPEED) / DRIVE_SPEED
        return [drive(rng, speed=speed, part=k, of=options.balls) for k, rng in enumerate(rngs)]
    distance, speed = options.distance or 1.0, options.speed or HAND_SPEED
    rate = np.radians(options.rate) if options.rate else HAND_RATE
    seconds = options.begin + (options.seconds or _HAND_SECONDS)
    asides = [0.45 * distance * (k - 0.5 * (options.balls - 1)) for k in range(options.balls)]
    motion = {"distance": distance, "speed": speed, "rate": rate, "seconds": seconds}
    return [hand(rng, aside=aside, **motion) for rng, aside in zip(rngs, asides, strict=True)]


def _passing(
    options: WandOptions, path: WandPath, at: float | None, rng: np.random.Generator, beside: bool
) -> tuple[Passing, ...]:
    """A hand, fingers first, just beside the ball and a little nearer; or a card straight across the ball."""
    if at is None:
        return ()
    centre = path.pose(np.array([options.begin + at]))[0][0]
    angle = np.radians(rng.uniform(-30.0, 30.0)) + rng.choice([0.0, np.pi]) if beside else rng.uniform(-np.pi, np.pi)
    x, y = np.cos(angle), np.sin(angle)
    aside = 0.12 * rng.choice([-1.0, 1.0]) if beside else 0.0
    speed = _HAND_SPEED_M_S if options.motion == "drive" else 0.5
    nearest = centre + np.array([-y * aside, x * aside, -0.12])
    return (Passing(options.begin + at, speed * np.array([x, y, 0.0]), nearest, (0.6 if beside else 0.5) / speed),)


def _check_options(options: WandOptions) -> None:
    """Raise ConfigurationError if options are out of bounds or do not go together."""
    check_bounds(options, option_name)
    if options.fps is not None and options.blur > 1.0 / options.fps:
        raise ConfigurationError(f"--blur: {options.blur:g} s is longer than a frame at {options.fps:g} Hz")
    if options.motion == "drive" and options.distance is not None:
        raise ConfigurationError("--distance: belongs to a hand; on a drive the robot's way decides")
    if options.motion == "drive" and options.rate is not None:
        raise ConfigurationError("--rate: belongs to a hand; a drive turns in proportion to --speed")
