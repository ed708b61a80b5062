"""`spheremouse wand`: films of a hand-held ball with exact truth, and the bounds that select its colours."""

from dataclasses import fields
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.commands.options import parse_numbers, with_fields
from spheremouse.commands.simulate import write_film
from spheremouse.errors import ConfigurationError, format_count, os_errors_as
from spheremouse.simulate.wand.options import WandOptions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from spheremouse.wand.pick_colours import PickedBounds

app = typer.Typer(no_args_is_help=True, help="A hand-held ball: film it, or pick the bounds of its colours.")

_OVERLAY = ".colours.png"  # end of the names of pictures that only `wand colours` makes: they may be replaced


@app.command(epilog="Example: spheremouse wand simulate demo/drive --seed 1")
@with_fields(motion=("--motion", "--path"))
def simulate(
    folder: Annotated[Path, typer.Argument(metavar="OUT_DIR", help="Folder of the dataset; made, or empty.")],
    *,
    options: WandOptions,
    wand: Annotated[
        Path | None, typer.Option("--ball", metavar="FILE", help="Another ball than Grzonka's: a wand file.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a dataset that is there.")] = False,
) -> None:
    """Film a simulated wand: a dataset with exact truth.

    The renderer casts rays and has discs as true spherical caps, shading, highlights, a robot or a hand, and a room
    that changes with the seed. The folder appears when it is complete.
    """
    from spheremouse.files.wand import load_wand
    from spheremouse.simulate.to_dataset import write_wand
    from spheremouse.simulate.wand.film import prepare_wand

    film = prepare_wand(options, None if wand is None else load_wand(wand).ball)
    megabytes = write_film(folder, film.frames, write_wand(folder, film, replace=force))
    camera = film.scene.camera
    print(
        f"{folder}: {format_count(film.frames, 'frame')} of {camera.width}x{camera.height} at "
        f"{film.fps:g} Hz, motion {options.motion}, ball {film.scene.balls[0].ball.name}; {megabytes:.1f} MB"
    )
    print(f"next: spheremouse evaluate {folder} --tracker wand")


@app.command(epilog="Example: spheremouse wand colours photo.png --out wand.yaml")
def colours(
    picture: Annotated[
        Path,
        typer.Argument(metavar="PICTURE", show_default=False, help="Picture with the ball in it, or a wand's dataset."),
    ],
    wand: Annotated[
        Path | None, typer.Option("--ball", metavar="FILE", help="The ball's wand file.  [default: Grzonka's ball]")
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(metavar="U,V,RADIUS", help="Place of the ball, px.  [default: the command searches it]"),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Show the pixels that the bounds of --ball select; pick no others.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the ball with its bounds.  [default: print them]")
    ] = None,
    show: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png", help="Picture of the selection.  [default: PICTURE.colours.png, which is replaced]"
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """Pick the bounds that select a ball's colours, and draw their selection.

    Hold the ball so that discs of every colour face the camera, in the light it will be used in.
    """
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.files.wand import WandFile, load_wand, save_wand
    from spheremouse.session.overlay.file import write_picture
    from spheremouse.wand.ball import grzonka_ball
    from spheremouse.wand.colour import DEFAULT_COLOURS
    from spheremouse.wand.pick_colours import Circle, check_bounds, draw_selection, find_ball, pick_bounds

    ball = grzonka_ball()
    given = WandFile(ball, {c: DEFAULT_COLOURS[c] for c in ball.colours}) if wand is None else load_wand(wand)
    if check and out is not None:
        raise ConfigurationError("--out: does not go with --check, which picks no bounds; leave one of them out")
    beside = picture.resolve()
    show = show or beside.parent / f"{beside.name}{_OVERLAY}"
    if show.suffix.lower() != ".png":
        raise ConfigurationError(f"--show {show}: must end in .png")
    check_outputs([out], [picture, wand], force=force)
    check_outputs([show], [picture, wand, out], force=force or show.name.endswith(_OVERLAY))
    image = read_picture(picture)
    circle = None if at is None else Circle(*parse_numbers("--at", at, 3, inf, "640,480,25: centre and radius in px"))
    if check:
        picked = check_bounds(image, given.colours, find_ball(image, given.ball) if circle is None else circle)
    else:
        picked = pick_bounds(image, given.ball, circle)
    write_picture(show, draw_selection(image, picked))
    _print(picked, narrower=check)
    print(f"{show}: the selected pixels")
    if out is not None:
        save_wand(out, given.ball, picked.colours, {"colours_from": picture.name})
        print(f"{out}: the ball with these bounds")
    elif not check:
        print("next: look at the picture, then write the bounds with --out wand.yaml")


def read_picture(path: Path) -> "NDArray[np.uint8]":
    """Return a picture, (h, w, 3) BGR, or the first frame of a wand's dataset.

    Raises ConfigurationError if the file cannot be read, or if its picture is below 32 px.
    """
    from spheremouse.files.dataset.frames import read_frames
    from spheremouse.files.dataset.wand import open_wand
    from spheremouse.files.pictures import FRAME_PIXELS, MAX_BYTES, decode, read_header
    from spheremouse.files.safe_files import read_bytes

    if path.is_dir():
        return next(read_frames(open_wand(path))).image
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file; name a picture with the ball in it")
    with os_errors_as(ConfigurationError, f"{path}"):
        data = read_bytes(path, MAX_BYTES, "picture")
        read_header(data, FRAME_PIXELS)
        image = decode(data, upright=True)
    if min(image.shape[:2]) < 32:
        raise ConfigurationError(f"{path}: is {image.shape[1]}x{image.shape[0]} px; too small to show a ball")
    return image


def _print(picked: "PickedBounds", narrower: bool) -> None:
    """Print the ball's place, its bounds and their selection; with `narrower`, advise also to narrow the bounds."""
    c = picked.circle
    print(f"the ball is at {c.u:.0f}, {c.v:.0f}, radius {c.radius:.0f} px (if this is wrong, give --at U,V,RADIUS)")
    for name, colour in picked.colours.items():
        bounds = ((f.name, getattr(colour, f.name), getattr(type(colour)(), f.name)) for f in fields(colour))
        print(f"{name}: {', '.join(f'{bound} {value:g}' for bound, value, default in bounds if value != default)}")
        print(
            f"  selects {100 * picked.inside[name]:.1f} % of the ball, {100 * picked.outside[name]:.2f} % of the rest"
        )
        if name in picked.stray_colours():
            alternative = ", or narrow the bounds" if narrower else ""
            print(f"  much beside the ball is {name}: clear it away, or use another background{alternative}")
