"""`spheremouse simulate`: a dataset with exact truth from our own renderer."""

from math import isfinite
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import parse_distortion, parse_size
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError
from spheremouse.simulate.ball.film import Motion, SimulationOptions, View, prepare
from spheremouse.simulate.to_dataset import write_simulation

_DEFAULT = SimulationOptions()


def _text(numbers: tuple[float, ...]) -> str:
    """As these options are written."""
    return ",".join(f"{x:g}" for x in numbers)


def simulate(
    folder: Annotated[Path, typer.Argument(metavar="OUT_DIR", help="Folder of the dataset; made, or empty.")],
    discs: Annotated[int, typer.Option(metavar="N", help="Discs on the ball.")] = _DEFAULT.discs,
    view: Annotated[View, typer.Option(help="Camera 2.35 m or 1.35 m from the ball's centre.")] = _DEFAULT.view,
    motion: Annotated[
        Motion,
        typer.Option(
            help="What the ball does; roll goes through phi = 90 degrees. rest, creep and flick first show the ball "
            "from all sides for 8 s: then it lies still, or turns by 0.05 deg/s for a minute, or is flicked at "
            "400 deg/s, stopped within 50 ms and flicked back. axes: what `spheremouse axes` asks for."
        ),
    ] = _DEFAULT.motion,
    turns: Annotated[float, typer.Option(metavar="N", help="Turns of --motion roll.")] = _DEFAULT.turns,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", help="Length in s.  [default: as long as the motion takes]")
    ] = _DEFAULT.seconds,
    fps: Annotated[float, typer.Option(metavar="HZ", help="Frames per second.")] = _DEFAULT.fps,
    noise: Annotated[
        float, typer.Option(metavar="LEVELS", help="Standard deviation of the image noise in grey values.")
    ] = _DEFAULT.noise,
    brightness: Annotated[
        float, typer.Option(metavar="LEVELS", help="Grey values added to every pixel; may be negative.")
    ] = _DEFAULT.brightness,
    blur: Annotated[float, typer.Option(metavar="S", help="Exposure time in s: motion blur.")] = _DEFAULT.blur,
    readout: Annotated[
        float, typer.Option(metavar="S", help="Time a rolling shutter takes over all rows in s.")
    ] = _DEFAULT.readout,
    seed: Annotated[int, typer.Option(metavar="N", help="Of discs, noise and play.")] = _DEFAULT.seed,
    layout: Annotated[
        int | None,
        typer.Option(metavar="N", help="Seed of the places of the discs alone: another ball.  [default: as --seed]"),
    ] = _DEFAULT.layout,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the images in px.")] = "640x480",
    dist: Annotated[
        str, typer.Option(metavar="k1,k2,p1,p2,k3", help="Lens distortion in OpenCV's order.")
    ] = "0,0,0,0,0",
    ball_colour: Annotated[
        str | None,
        typer.Option(
            metavar="B,G,R", help="Blue, green and red of the ball, 0 to 255 as on a screen.  [default: white]"
        ),
    ] = None,
    disc_colour: Annotated[
        str | None, typer.Option(metavar="B,G,R", help="The same of the discs.  [default: black]")
    ] = None,
    hands: Annotated[bool, typer.Option("--hands", help="Hands reach over the ball, first one, later two.")] = False,
    cover: Annotated[
        float | None, typer.Option(metavar="S", help="Two hands cover a third of the ball from this time on.")
    ] = _DEFAULT.cover,
    cover_seconds: Annotated[
        float, typer.Option(metavar="S", help="For how long; half a second more to come and to go.")
    ] = _DEFAULT.cover_seconds,
    dim: Annotated[
        float | None, typer.Option(metavar="F", help="Factor on the light, in the middle fifth of the time.")
    ] = _DEFAULT.dim,
    dim_at: Annotated[
        float | None, typer.Option(metavar="S", help="Time at which --dim begins instead.")
    ] = _DEFAULT.dim_at,
    dim_seconds: Annotated[float, typer.Option(metavar="S", help="And how long it lasts.")] = _DEFAULT.dim_seconds,
    flicker: Annotated[
        float, typer.Option(metavar="F", help="Share of the light that comes and goes with the mains, 0 to 1.")
    ] = _DEFAULT.flicker,
    mains: Annotated[
        float, typer.Option(metavar="HZ", help="Frequency of the mains; light flickers at twice that.")
    ] = _DEFAULT.mains,
    limited: Annotated[
        bool, typer.Option("--limited", help="Grey values from 16 to 235 in place of 0 to 255.")
    ] = False,
    bump: Annotated[
        float | None, typer.Option(metavar="S", help="Time at which the camera is pushed; it stays so.")
    ] = _DEFAULT.bump,
    bump_by: Annotated[
        str,
        typer.Option(metavar="X,Y,Z,RX,RY,RZ", help="By how much: mm and degrees along and about the camera's axes."),
    ] = _text(_DEFAULT.bump_by),
    lift: Annotated[
        float | None, typer.Option(metavar="S", help="Time at which the ball is lifted off its bearings.")
    ] = _DEFAULT.lift,
    lift_by: Annotated[str, typer.Option(metavar="X,Y,Z", help="By how much, in mm, Y up.")] = _text(_DEFAULT.lift_by),
    lift_seconds: Annotated[float, typer.Option(metavar="S", help="For how long.")] = _DEFAULT.lift_seconds,
    eccentric: Annotated[
        float, typer.Option(metavar="MM", help="From the point the ball turns about to its centre.")
    ] = _DEFAULT.eccentric,
    disc_off: Annotated[
        float | None, typer.Option(metavar="S", help="Time at which a disc in view falls off.")
    ] = _DEFAULT.disc_off,
    disc_moved: Annotated[
        float | None, typer.Option(metavar="S", help="Time at which a disc in view is put 12 cm beside its place.")
    ] = _DEFAULT.disc_moved,
    force: Annotated[bool, typer.Option("--force", help="Replace a dataset that is there.")] = False,
) -> None:
    """Film a simulated ball: a dataset with exact truth.

    Ray-cast and anti-aliased: discs as true spherical caps, shading, highlights, struts, bolts that look like discs,
    ring targets. 300 frames take seconds. Nothing is written unless all of it is.
    """
    options = SimulationOptions(
        discs=discs,
        view=view,
        motion=motion,
        turns=turns,
        seconds=seconds,
        fps=fps,
        noise=noise,
        brightness=brightness,
        blur=blur,
        readout=readout,
        seed=seed,
        layout=layout,
        size=parse_size(size, 16, "640x480"),
        dist=parse_distortion(dist, "-0.1,0,0,0,0"),
        ball_colour=None if ball_colour is None else _colour("--ball-colour", ball_colour),
        disc_colour=None if disc_colour is None else _colour("--disc-colour", disc_colour),
        hands=hands,
        cover=cover,
        cover_seconds=cover_seconds,
        dim=dim,
        dim_at=dim_at,
        dim_seconds=dim_seconds,
        flicker=flicker,
        mains=mains,
        limited=limited,
        bump=bump,
        bump_by=_bump(bump_by),
        lift=lift,
        lift_by=_lift(lift_by),
        lift_seconds=lift_seconds,
        eccentric=eccentric,
        disc_off=disc_off,
        disc_moved=disc_moved,
    )
    simulation = prepare(options)
    with progress_bar() as bar:
        task = bar.add_task(f"filming {folder}", total=simulation.frames)
        for done in write_simulation(folder, simulation, replace=force):
            bar.update(task, completed=done)
    megabytes = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) / 1e6
    width, height = options.size
    print(
        f"{folder}: {simulation.frames} frame{_s(simulation.frames)} of {width}x{height} at {fps:g} Hz, "
        f"{discs} disc{_s(discs)}, motion {motion}; {megabytes:.1f} MB"
    )


def _s(n: int) -> str:
    return "" if n == 1 else "s"


def _numbers(option: str, text: str, n: int, example: str) -> list[float]:
    """`n` numbers between commas."""
    try:
        numbers = [float(part) for part in text.split(",")]
        if len(numbers) != n or not all(isfinite(x) for x in numbers):
            raise ValueError(text)
    except ValueError:
        raise ConfigurationError(f"{option} {text}: write {n} numbers, as in {example}") from None
    return numbers


def _colour(option: str, text: str) -> tuple[float, float, float]:
    blue, green, red = _numbers(option, text, 3, "30,30,200 for red")
    return blue, green, red


def _lift(text: str) -> tuple[float, float, float]:
    x, y, z = _numbers("--lift-by", text, 3, _text(_DEFAULT.lift_by))
    return x, y, z


def _bump(text: str) -> tuple[float, float, float, float, float, float]:
    x, y, z, rx, ry, rz = _numbers("--bump-by", text, 6, _text(_DEFAULT.bump_by))
    return x, y, z, rx, ry, rz
