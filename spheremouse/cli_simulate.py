"""`spheremouse simulate`: a dataset with exact truth from our own renderer."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from spheremouse.errors import ConfigurationError
from spheremouse.recording import write_simulation
from spheremouse.simulate import Motion, SimulationOptions, View, prepare

EXAMPLE = "Example: spheremouse simulate demo/roll --motion roll --turns 1 --noise 3"

_DEFAULT = SimulationOptions()


def simulate(  # noqa: PLR0917  options, named by whoever types them
    folder: Annotated[Path, typer.Argument(metavar="OUT_DIR", help="Folder of the dataset; made, or empty.")],
    discs: Annotated[int, typer.Option(metavar="N", help="Discs on the ball.")] = _DEFAULT.discs,
    view: Annotated[View, typer.Option(help="Camera 2.35 m or 1.35 m from the ball's centre.")] = _DEFAULT.view,
    motion: Annotated[
        Motion, typer.Option(help="What the ball does; roll goes through phi = 90 degrees.")
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
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the images in px.")] = "640x480",
    dist: Annotated[
        str, typer.Option(metavar="k1,k2,p1,p2,k3", help="Lens distortion in OpenCV's order.")
    ] = "0,0,0,0,0",
    hands: Annotated[bool, typer.Option("--hands", help="Hands reach over the ball, first one, later two.")] = False,
    dim: Annotated[
        float | None, typer.Option(metavar="F", help="Factor on the light in the middle fifth of the time.")
    ] = _DEFAULT.dim,
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
        size=_size(size),
        dist=_distortion(dist),
        hands=hands,
        dim=dim,
    )
    simulation = prepare(options)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(file=sys.stderr),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as bar:
        task = bar.add_task(f"filming {folder}", total=simulation.frames)
        for done in write_simulation(folder, simulation, replace=force):
            bar.update(task, completed=done)
    megabytes = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) / 1e6
    width, height = options.size
    print(
        f"{folder}: {simulation.frames} frames of {width}x{height} at {fps:g} Hz, {discs} discs, motion {motion}; "
        f"{megabytes:.1f} MB"
    )


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 16 <= int(width) <= 8192 and 16 <= int(height) <= 8192):
        raise ConfigurationError(f"--size {text}: write WIDTHxHEIGHT in px, as in 640x480, each from 16 to 8192")
    return int(width), int(height)


def _distortion(text: str) -> tuple[float, float, float, float, float]:
    try:
        k1, k2, p1, p2, k3 = (float(part) for part in text.split(","))
        if not all(abs(k) <= 2.0 for k in (k1, k2, p1, p2, k3)):  # nan, too: no lens bends more
            raise ValueError(text)
    except ValueError:
        raise ConfigurationError(
            f"--dist {text}: write five numbers k1,k2,p1,p2,k3 from -2 to 2, as in -0.1,0,0,0,0"
        ) from None
    return k1, k2, p1, p2, k3
