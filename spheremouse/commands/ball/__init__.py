"""`spheremouse ball`: fit the outline of a ball in a film, and write a rig for it. No calibration is needed."""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.commands.options import Force
from spheremouse.errors import CalibrationError, ConfigurationError, SourceError

if TYPE_CHECKING:
    from spheremouse.ball.detect.detections import Image
    from spheremouse.calibrate.outline.fit import Outline
    from spheremouse.geometry import Array
    from spheremouse.geometry.camera import InteriorOrientation

DEFAULT_VFOV = 45.0  # degrees; webcams have 40 to 50
POINT_PX = 1.0  # standard deviation of a point that a person gives

_MIN_POINTS = 3  # points
_MAX_COORDINATE_PX = 1e5  # px
_PICTURE_INTERVAL_S = 0.09  # s between pictures: a ball turns little in less
_MAX_BYTES = 250_000_000  # of pictures in memory
_MAX_MARKS = 40  # points in the picture
_MAX_OFF_PX, _MAX_OFF_RADII = 4.0, 0.04  # px, and part of the radius, that a point may be off
_MAX_RELATIVE_SIGMA = 0.05  # of the angular radius


def ball(
    source: Annotated[
        str,
        typer.Argument(
            metavar="VIDEO",
            show_default=False,
            help="A film, a recording, or another source as of `run --source`. The camera must stand still.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")] = Path("ball"),
    vfov: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            min=0.1,
            max=150.0,
            help="Field of view from the upper to the lower edge of the picture.  [default: the recording's camera, "
            f"else {DEFAULT_VFOV:g}]",
        ),
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Calibrated interior orientation, in place of --vfov.")
    ] = None,
    points: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y X,Y X,Y",
            help="Three or more points on the ball's outline, px, in place of the search. [0, 0 is the upper left "
            "pixel]",
        ),
    ] = None,
    more_points: Annotated[list[str] | None, typer.Argument(metavar="X,Y", hidden=True)] = None,
    seconds: Annotated[float, typer.Option(metavar="S", min=0.5, help="Search in the first S seconds.")] = 10.0,
    force: Force = False,
) -> None:
    """Find a ball that turns in a film by its outline, and write a folder with which `run` and `track` follow it.

    It needs no calibration, no ring targets and no discs. Lengths are in radii of the ball. Rates are in the camera's
    axes: X right, Y up, Z towards the camera. Look at outline.png in the folder: the line must be on the ball's edge.
    """
    from spheremouse.calibrate.outline.find import find_outline
    from spheremouse.calibrate.outline.fit import fit_outline, pinhole, rays_of, rig_of, rotation_scale
    from spheremouse.commands.ball.folder import check_folder, describe, draw_outline, next_steps, write_folder
    from spheremouse.files.rig import load_camera
    from spheremouse.tracker import Frame, check_size

    if camera is not None and vfov is not None:
        raise ConfigurationError("--camera and --vfov: give one of the two")
    if more_points and points is None:
        raise ConfigurationError(f"{more_points[0]}: give one film; points come after --points")
    outlined = None if points is None else parse_points([*points, *(more_points or ())])
    check_folder(out, [camera], force)
    known = None if camera is None else load_camera(camera)
    spec = source_spec(source)
    images, recorded = film(spec, seconds if outlined is None else None)
    known = known or (None if vfov else recorded)
    lens = known or pinhole(images[0].shape[1::-1], vfov or DEFAULT_VFOV)
    check_size(Frame(images[0], 0.0, 0), lens)
    if outlined is None:
        outline, outlined = find_outline(images, lens)
    else:
        outline = fit_outline(rays_of(outlined, lens), POINT_PX / math.sqrt(lens.fx * lens.fy))
        check_points(outlined, outline, lens)
    rig = rig_of(outline, lens)
    picture = draw_outline(images[-1], outline.pixels(lens), outlined[:: max(1, len(outlined) // _MAX_MARKS)])
    write_folder(out, rig, picture, spec, (), "spheremouse ball")
    print(describe(outline, rig))
    if known is None and vfov is None:
        print(
            f"assumed: a field of view of {DEFAULT_VFOV:g}° from top to bottom. If it is a tenth too large, rotations "
            f"across the view come out {1.0 - rotation_scale(outline, 1.1):.1%} too small. Give --vfov if you can"
        )
    print(next_steps(out, "csv:ball.csv"))


def parse_points(texts: list[str]) -> "Array":
    """Return the points (n, 2) px of texts such as `63,171 81,145`. Raises ConfigurationError for other texts."""
    import numpy as np

    words = " ".join(texts).replace(";", " ").split()
    try:
        points = np.array([[float(x) for x in word.split(",")] for word in words]).reshape(len(words), 2)
    except ValueError:
        points = np.full((1, 2), np.nan)
    if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > _MAX_COORDINATE_PX:
        raise ConfigurationError(f'--points {" ".join(texts)!r}: write X,Y in px, as in "320,72 489,240 320,408"')
    if len(points) < _MIN_POINTS:
        raise ConfigurationError(
            f"--points: {len(points)} points fix no outline; give {_MIN_POINTS} or more all around it"
        )
    return points


def source_spec(source: str) -> str:
    """Return a source as `KIND:ARGUMENT`, with the absolute path of a file or folder. Raises SourceError without it."""
    from spheremouse.capture import full_spec

    kind, colon, argument = full_spec(source).partition(":")
    if not colon and not Path(source).exists():
        raise SourceError(f"{source}: no such file", "name a film, a recording's folder, or KIND:ARGUMENT")
    return (
        f"{kind}:{Path(argument).absolute()}" if kind in ("video", "dataset") and argument else kind + colon + argument
    )


def film(spec: str, seconds: float | None) -> "tuple[list[Image], InteriorOrientation | None]":
    """Return pictures of the first seconds, or one, and the source's own camera. SourceError: it gives none."""
    from spheremouse.capture import section
    from spheremouse.session.cameras import looked_through
    from spheremouse.session.settings import Configuration

    images: list[Image] = []
    with looked_through(spec, Configuration().camera) as source:
        last = -math.inf
        if source.live and seconds is not None:
            print(f"filming {seconds:g} s: turn the ball", file=sys.stderr)
        for frame in section(source, 0.0, math.inf if seconds is None else seconds):
            if images and frame.image.shape != images[0].shape:
                raise SourceError(f"{spec}: frame {frame.sequence} has another size than the first")
            if frame.stamp - last >= _PICTURE_INTERVAL_S and (len(images) + 1) * frame.image.size < _MAX_BYTES:
                images.append(frame.image.copy())
                last = frame.stamp
            if seconds is None:
                break
        rig = source.rig
    if not images:
        raise SourceError(f"{spec}: the source gave no frame")
    return images, None if rig is None else rig.camera


def check_points(points: "Array", outline: "Outline", camera: "InteriorOrientation") -> None:
    """Raise CalibrationError if points, (n, 2) px, are not on the outline, or fix it badly."""
    import numpy as np

    from spheremouse.calibrate.outline.fit import rays_of, residuals

    px = math.sqrt(camera.fx * camera.fy)
    distance_px = np.abs(residuals(outline, rays_of(points, camera))) * px
    k = int(np.argmax(distance_px))
    if distance_px[k] > max(_MAX_OFF_PX, _MAX_OFF_RADII * outline.angle * px):
        x, y = points[k].tolist()
        raise CalibrationError(
            f"the point {x:g},{y:g} is {distance_px[k]:.1f} px off the outline of the others", "correct it"
        )
    if outline.sigma[1] > _MAX_RELATIVE_SIGMA * outline.angle:
        raise CalibrationError("the points fix the outline badly", "give more, all around it")
