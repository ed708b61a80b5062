"""Films of a simulated ball: `prepare` builds the scene for the options of a film, and `simulate` films it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from spheremouse.errors import ConfigurationError
from spheremouse.geometry.rotation import Array, from_euler
from spheremouse.settings import option_name
from spheremouse.simulate.ball.events import Change, Dimming, Flicker, HandVisit, Lift, Sway, bump, facing, move_disc
from spheremouse.simulate.ball.options import Named, SimulationOptions, check_bounds
from spheremouse.simulate.ball.pattern import Pattern
from spheremouse.simulate.ball.profile import TURN_SECONDS, Profile, profile_of
from spheremouse.simulate.ball.render import Renderer, RenderOptions, SimulatedFrame
from spheremouse.simulate.ball.scene import BLACK, WHITE_BALL, Scene, default_scene
from spheremouse.simulate.light import reflectance

MAX_FRAMES = 1_000_000  # of one recording: nine hours at 30 Hz, 300 GB of video


@dataclass(frozen=True, slots=True)
class Simulation:
    """Everything that `simulate` needs."""

    scene: Scene  # at the start
    profile: Profile
    options: RenderOptions
    seconds: float  # s
    fps: float  # Hz
    seed: int
    changes: tuple[Change, ...] = ()  # of the scene, by time
    azimuth: float = 0.0  # deg, of the camera about the ball's vertical axis
    late: float = 0.0  # s, stamp of the first frame

    @property
    def turn(self) -> Array:
        """R_first_obj, (3, 3), from the axes of this camera's targets to those of a camera at azimuth 0."""
        return from_euler(np.array([0.0, np.radians(self.azimuth), 0.0]))

    @property
    def frames(self) -> int:
        """Number of frames to come."""
        return max(1, round(self.seconds * self.fps))


def prepare(options: SimulationOptions, named: Named = option_name) -> Simulation:
    """Return scene, motion and effects for the options. Raise ConfigurationError if they are invalid.

    `named` returns the name of a field in its source, for example its command-line option.
    """
    _check(options, named)
    profile = profile_of(options)
    seconds = profile.seconds if options.seconds is None else options.seconds
    for field in ("bump", "lift", "cover", "dim_at", "disc_off", "disc_moved"):
        time = getattr(options, field)
        if time is not None and time >= seconds:
            raise ConfigurationError(f"{named(field)}: {time:g} s is after the end, at {seconds:g} s")
    layout = options.seed if options.layout is None else options.layout
    pattern = None if options.pattern is None else Pattern(options.pattern, layout)
    (width, height), lens = options.size, np.array(options.dist)
    try:
        scene = default_scene(
            options.disc_count, options.view, layout, width=width, height=height, distortion=lens, pattern=pattern
        )
    except ValueError as e:
        raise ConfigurationError(f"{named('discs')}: {e}") from None
    scene = replace(
        scene,
        exposure_s=options.blur,
        readout_s=options.readout,
        ball_colour=WHITE_BALL if options.ball_colour is None else reflectance(options.ball_colour),
        disc_colour=BLACK if options.disc_colour is None else reflectance(options.disc_colour),
    ).scaled(options.radius / scene.ball_radius)
    changes, effects = _changes(options, scene, profile, named), _effects(options, seconds)
    film = Simulation(
        scene, profile, effects, seconds, options.fps, options.seed, changes, options.azimuth, options.late
    )
    if options.azimuth == 0.0:
        return film
    back = film.turn.T
    lifts = tuple(replace(lift, shift=tuple(back @ lift.shift)) for lift in effects.lifts)
    return replace(film, profile=replace(profile, turn=back), options=replace(effects, lifts=lifts))


def simulate(simulation: Simulation) -> Iterator[SimulatedFrame]:
    """Yield the frames with truth. Stamps start at `late`."""
    renderer = Renderer(simulation.scene, simulation.options)
    camera = [round(1000.0 * simulation.azimuth) % 360000] if simulation.azimuth else []
    rng = np.random.Generator(np.random.SFC64([simulation.seed, 1, *camera]))  # the fastest: noise takes most time
    changes = list(simulation.changes)
    for index in range(simulation.frames):
        t = simulation.late + index / simulation.fps
        while changes and t >= changes[0].time:
            scene = changes.pop(0).scene
            pose_unchanged = scene.pose is renderer.scene.pose
            renderer = Renderer(scene, simulation.options, renderer.backdrop if pose_unchanged else None)
        yield renderer.frame(simulation.profile, t, index, rng)


def _effects(options: SimulationOptions, seconds: float) -> RenderOptions:
    """Return the disturbances of a film of this length."""
    hands = [(0.25, 0.45, True), (0.65, 0.90, True), (0.68, 0.90, False)] if options.hands else []
    visits = [HandVisit(start * seconds, end * seconds, right) for start, end, right in hands]
    if options.cover is not None:  # half a second to come and to go
        start, end = options.cover - 0.5, options.cover + options.cover_seconds + 0.5
        visits += [HandVisit(start, end, right, size=1.12) for right in (True, False)]
    light: list[Dimming | Flicker] = []
    if options.dim is not None:
        at, middle = options.dim_at, (0.4 * seconds, 0.6 * seconds)
        light.append(Dimming(*(middle if at is None else (at, at + options.dim_seconds)), options.dim))
    if options.flicker > 0.0:
        light.append(Flicker(options.flicker, options.mains))
    x, y, z = (1e-3 * v for v in options.lift_by)
    shifts: list[Lift | Sway] = [Sway((1e-3 * options.sway, 0.0, 0.0))] if options.sway else []
    if options.lift is not None:
        shifts.append(Lift(options.lift, options.lift + options.lift_seconds, (x, y, z)))
    return RenderOptions(
        noise=options.noise,
        brightness=options.brightness,
        light=tuple(light),
        hands=tuple(visits),
        limited=options.limited,
        lifts=tuple(shifts),
        eccentric=(1e-3 * options.eccentric / 3.0**0.5,) * 3,
    )


def _changes(options: SimulationOptions, scene: Scene, profile: Profile, named: Named) -> tuple[Change, ...]:
    """Return the changes of the scene in order of time. Each starts from the scene after the previous one."""
    times = {"bump": options.bump, "disc off": options.disc_off, "disc moved": options.disc_moved}
    changes: list[Change] = []
    for what, time in sorted(((w, t) for w, t in times.items() if t is not None), key=lambda item: item[1]):
        disc = None
        if what == "bump":
            scene = bump(scene, options.bump_by)
        else:
            disc = facing(scene, profile.attitude(np.array([time]))[0])
            try:
                scene = replace(scene, fallen=(*scene.fallen, disc)) if what == "disc off" else move_disc(scene, disc)
            except ValueError as e:
                raise ConfigurationError(f"{named('disc_moved')}: {e}") from None
        changes.append(Change(time, scene, what, disc))
    return tuple(changes)


def _check(options: SimulationOptions, named: Named) -> None:
    """Raise ConfigurationError if an option is out of bounds or contradicts another."""
    check_bounds(options, named)
    fps, name, seconds = options.fps, "seconds", options.seconds
    if seconds is None:  # of all motions only a roll may be too long
        name, seconds = "turns", TURN_SECONDS * options.turns * (options.motion == "roll")
    if seconds * fps > MAX_FRAMES + 0.5:
        raise ConfigurationError(
            f"{named(name)}: {seconds:g} s at {fps:g} Hz are {seconds * fps:.7g} frames; "
            f"at most {MAX_FRAMES} make a recording, {MAX_FRAMES / fps:.6g} s at that rate"
        )
    for name, value in (("blur", options.blur), ("readout", options.readout)):
        if value > 1.0 / fps:
            raise ConfigurationError(f"{named(name)}: {value:g} s is longer than a frame at {fps:g} Hz")
    if options.dim_at is not None and options.dim is None:
        raise ConfigurationError(f"{named('dim_at')}: needs {named('dim')}, the factor")
    for name in ("disc_off", "disc_moved"):
        if getattr(options, name) is not None and options.disc_count == 0:
            raise ConfigurationError(f"{named(name)}: the ball has no discs; add them by {named('discs')}")
    if np.linalg.norm(options.lift_by) + options.eccentric > 200.0:
        name = "eccentric" if options.eccentric > 100.0 else "lift_by"
        raise ConfigurationError(f"{named(name)}: the ball must stay within 200 mm of its place")
    if np.linalg.norm(options.bump_by[:3]) > 200.0 or np.linalg.norm(options.bump_by[3:]) > 20.0:
        raise ConfigurationError(
            f"{named('bump_by')}: at most 200 mm and 20 degrees: the ball must stay in the picture"
        )
