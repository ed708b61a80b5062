"""`spheremouse simulate`: render a dataset with exact truth."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import with_fields
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import format_count
from spheremouse.simulate.ball.options import SimulationOptions


@with_fields()
def simulate(
    folder: Annotated[Path, typer.Argument(metavar="OUT_DIR", help="Folder of the dataset; made, or empty.")],
    *,
    options: SimulationOptions,
    force: Annotated[bool, typer.Option("--force", help="Replace a dataset that is there.")] = False,
) -> None:
    """Film a simulated ball: a dataset with exact truth.

    The renderer casts rays and has discs as true spherical caps or a painted ball, shading, highlights, struts, bolts
    that look like discs, and ring targets. 300 frames take seconds. The folder appears when it is complete.
    """
    from spheremouse.simulate.ball.film import prepare
    from spheremouse.simulate.to_dataset import write_simulation

    film = prepare(options)
    megabytes = write_film(folder, film.frames, write_simulation(folder, film, replace=force))
    width, height = options.size
    pattern = "" if options.pattern is None else f"pattern {options.pattern}, "
    print(
        f"{folder}: {format_count(film.frames, 'frame')} of {width}x{height} at {options.fps:g} Hz, "
        f"{pattern}{format_count(options.disc_count, 'disc')}, motion {options.motion}; {megabytes:.1f} MB"
    )


def write_film(folder: Path, frames: int, steps: Iterable[int]) -> float:
    """Write a film's folder in `steps`, which count its frames, and return its size in megabytes."""
    with progress_bar() as bar:
        task = bar.add_task(f"filming {folder}", total=frames)
        for done in steps:
            bar.update(task, completed=done)
    return sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) / 1e6
