"""`spheremouse wand`: films of a hand-held ball with exact truth, and the bounds that select its colours."""

from dataclasses import fields
from pathlib import Path
from typing import Annotated, cast

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from spheremouse.commands.options import parse_distortion, parse_size
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError
from spheremouse.files.atomic import replace
from spheremouse.files.bounded import read_bytes
from spheremouse.files.pictures import FRAME_PIXELS, MOST_BYTES, decoded, read_header
from spheremouse.files.wand import WandFile, load_wand, save_wand
from spheremouse.simulate.wand.film import Light, Motion, WandOptions, prepare_wand

app = typer.Typer(no_args_is_help=True, help="A hand-held ball: film it, or pick the bounds of its colours.")

_DEFAULT = WandOptions()
_OVERLAY = ".colours.png"  # how pictures end that only `wand colours` makes: they may be replaced


@app.command(epilog="Example: spheremouse wand simulate demo/drive --seed 1")
def simulate(
    folder: Annotated[Path, typer.Argument(metavar="OUT_DIR", help="Folder of the dataset; made, or empty.")],
    motion: Annotated[
        str,
        typer.Option(
            "--motion",
            "--path",
            metavar="[drive|hand]",
            help="drive: on a robot, as in Grzonka 2005; hand: on a stick.",
        ),
    ] = _DEFAULT.motion,
    seed: Annotated[int, typer.Option(metavar="N", help="Of path, room, paints and noise.")] = _DEFAULT.seed,
    fps: Annotated[
        float | None, typer.Option(metavar="HZ", help="Frames per second.  [default: 0.8 of a drive, 15 of a hand]")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", help="Length in s.  [default: the whole drive, 20 s of a hand]")
    ] = None,
    begin: Annotated[float, typer.Option(metavar="S", help="Time of the motion at which the film begins.")] = 0.0,
    speed: Annotated[
        float | None,
        typer.Option(
            metavar="M/S", help="Largest speed; a drive turns in proportion.  [default: 0.035, 0.4 of a hand]"
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="DEG/S", help="Largest turning rate of a hand.  [default: 180]")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the images in px.")] = "1280x960",
    focal: Annotated[
        float | None,
        typer.Option(metavar="PX", help="Focal length.  [default: 2100 of a drive, 1000 of a hand, at 1280 columns]"),
    ] = None,
    dist: Annotated[
        str, typer.Option(metavar="k1,k2,p1,p2,k3", help="Lens distortion in OpenCV's order.")
    ] = "0,0,0,0,0",
    distance: Annotated[
        float | None, typer.Option(metavar="M", help="From the camera to a hand.  [default: 1]")
    ] = None,
    wand: Annotated[
        Path | None, typer.Option("--ball", metavar="FILE", help="Another ball than Grzonka's: a wand file.")
    ] = None,
    balls: Annotated[int, typer.Option(metavar="N", help="Balls in view, 1 to 3.")] = _DEFAULT.balls,
    light: Annotated[
        str, typer.Option(metavar="[indoor|outdoor]", help="outdoor: sun, with glare on the ball.")
    ] = _DEFAULT.light,
    noise: Annotated[
        float, typer.Option(metavar="LEVELS", help="Standard deviation of the image noise in grey values.")
    ] = _DEFAULT.noise,
    blur: Annotated[float, typer.Option(metavar="S", help="Exposure time in s: motion blur.")] = _DEFAULT.blur,
    hand: Annotated[
        float | None, typer.Option(metavar="S", help="Time at which a hand passes beside the ball.")
    ] = None,
    card: Annotated[
        float | None, typer.Option(metavar="S", help="Time at which a card in the ball's colours passes before it.")
    ] = None,
    clutter: Annotated[bool, typer.Option(help="A red mug and a blue book.")] = _DEFAULT.clutter,
    vary: Annotated[
        float, typer.Option(metavar="F", help="Share by which paints differ from seed to seed.")
    ] = _DEFAULT.vary,
    force: Annotated[bool, typer.Option("--force", help="Replace a dataset that is there.")] = False,
) -> None:
    """Film a simulated wand: a dataset with exact truth.

    Ray-cast and anti-aliased: discs as true spherical caps, shading, highlights, robot or hand, a room that changes
    with the seed. Nothing is written unless all of it is.
    """
    from spheremouse.simulate.to_dataset import write_wand

    if motion == "drive" and distance is not None:
        raise ConfigurationError("--distance: belongs to a hand; on a drive the robot's way decides")
    options = WandOptions(
        motion=cast(Motion, motion),  # `prepare_wand` refuses others
        seed=seed,
        fps=fps,
        seconds=seconds,
        begin=begin,
        speed=speed,
        rate=rate,
        size=parse_size(size, 64, "1280x960"),
        focal=focal,
        dist=parse_distortion(dist, "-0.1,0,0,0,0"),
        distance=_DEFAULT.distance if distance is None else distance,
        balls=balls,
        light=cast(Light, light),
        noise=noise,
        blur=blur,
        hand=hand,
        card=card,
        clutter=clutter,
        vary=vary,
    )
    ball = None if wand is None else load_wand(wand).ball
    film = prepare_wand(options, ball)
    with progress_bar() as bar:
        task = bar.add_task(f"filming {folder}", total=film.frames)
        for done in write_wand(folder, film, replace=force):
            bar.update(task, completed=done)
    megabytes = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) / 1e6
    camera = film.scene.camera
    print(
        f"{folder}: {film.frames} frame{'' if film.frames == 1 else 's'} of {camera.width}x{camera.height} at "
        f"{film.fps:g} Hz, motion {motion}, ball {film.scene.balls[0].ball.name}; {megabytes:.1f} MB"
    )
    print(f"next: spheremouse evaluate {folder} --tracker wand")


@app.command(epilog="Example: spheremouse wand colours photo.png --out wand.yaml")
def colours(
    picture: Annotated[
        Path, typer.Argument(metavar="PICTURE", show_default=False, help="With the ball in it; or a wand's dataset.")
    ],
    wand: Annotated[
        Path | None, typer.Option("--ball", metavar="FILE", help="The ball's wand file.  [default: Grzonka's ball]")
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(metavar="U,V,RADIUS", help="Where the ball is, px.  [default: it is looked for]"),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Show what the bounds of --ball select; pick no others.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the ball with its bounds.  [default: print them]")
    ] = None,
    show: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="What they select.  [default: PICTURE.colours.png, which is replaced]"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """Pick the bounds that select a ball's colours, and show what they select.

    Hold the ball so that discs of every colour face the camera, in the light it will be used in.
    """
    from spheremouse.wand.ball import grzonka_ball
    from spheremouse.wand.colour import DEFAULT_COLOURS
    from spheremouse.wand.pick_colours import Circle, find, judged, overlay, pick

    ball = grzonka_ball()
    given = WandFile(ball, {c: DEFAULT_COLOURS[c] for c in ball.colours}) if wand is None else load_wand(wand)
    if check and out is not None:
        raise ConfigurationError("--out: does not go with --check, which picks no bounds; leave one of them out")
    if show is None:
        beside = picture.resolve()
        show = beside.parent / f"{beside.name}{_OVERLAY}"
    if show.suffix.lower() != ".png":
        raise ConfigurationError(f"--show {show}: must end in .png")
    _refuse(out, [picture, wand], force)
    _refuse(show, [picture, wand, out], force or show.name.endswith(_OVERLAY))
    image = _image(picture)
    circle = None if at is None else Circle(*_circle(at))
    if check:
        picked = judged(image, given.colours, find(image, given.ball) if circle is None else circle)
    else:
        picked = pick(image, given.ball, circle)
    _write_png(show, overlay(image, picked))
    c = picked.circle
    print(f"the ball is at {c.u:.0f}, {c.v:.0f}, radius {c.radius:.0f} px (not so? say it with --at U,V,RADIUS)")
    for name, colour in picked.colours.items():
        bounds = ", ".join(f"{f.name} {getattr(colour, f.name):g}" for f in fields(colour) if _tells(colour, f.name))
        print(f"{name}: {bounds}")
        print(
            f"  selects {100 * picked.inside[name]:.1f} % of the ball, {100 * picked.outside[name]:.2f} % of the rest"
        )
        if name in picked.much():
            narrower = ", or narrow the bounds" if check else ""
            print(f"  much beside the ball is {name}: clear it away, or use another background{narrower}")
    print(f"{show}: what they select")
    if out is not None:
        save_wand(out, given.ball, picked.colours, {"colours_from": picture.name})
        print(f"{out}: the ball with these bounds")
    elif not check:
        print("next: look at the picture, then write the bounds with --out wand.yaml")


def _tells(colour: object, name: str) -> bool:
    """Does a bound differ from that which bounds nothing?"""
    return getattr(colour, name) != getattr(type(colour)(), name)


def _image(path: Path) -> NDArray[np.uint8]:
    """A picture, (h, w, 3) BGR, or the first frame of a wand's dataset."""
    from spheremouse.files.dataset.wand import open_wand, read_wand_frames

    if path.is_dir():
        return next(read_wand_frames(open_wand(path))).image
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file; name a picture with the ball in it")
    try:
        data = read_bytes(path, MOST_BYTES, "picture")
        read_header(data, FRAME_PIXELS)
        image = decoded(data, upright=True)
    except OSError as e:
        raise ConfigurationError(f"{path}: {e.strerror or e}") from None
    if min(image.shape[:2]) < 32:
        raise ConfigurationError(f"{path}: is {image.shape[1]}x{image.shape[0]} px; too small to show a ball")
    return image


def _circle(text: str) -> tuple[float, float, float]:
    try:
        u, v, radius = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigurationError(f"--at {text}: write the centre and the radius in px, as in 640,480,25") from None
    return u, v, radius


def _refuse(path: Path | None, others: list[Path | None], replace: bool) -> None:
    """A file is written where nothing is, or where it may `replace` that; never over one of the others."""
    if path is None:
        return
    if not path.parent.is_dir():
        raise ConfigurationError(f"{path}: there is no folder {path.parent}; make it, or name another file")
    if path.is_dir():
        raise ConfigurationError(f"{path}: is a folder; name a file")
    if path.resolve() in {p.resolve() for p in others if p is not None}:
        raise ConfigurationError(f"{path}: is another file of this very command; name another one to write")
    if path.exists() and not replace:
        raise ConfigurationError(f"{path}: there already; name another file, or replace it with --force")


def _write_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Whole or not at all."""
    try:
        replace(path, cv2.imencode(".png", image)[1].tobytes())
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be written ({e.strerror}); name another with --show") from None
