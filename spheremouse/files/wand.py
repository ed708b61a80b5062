"""Write and read files of hand-held balls (wand.yaml): discs, and the bounds that select their colours.

Units and frame are those of `wand.ball`, with angles in degrees: origin at the centre, z towards the pole, azimuth
counter-clockwise seen from above. The reader reports every problem with its line.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from spheremouse.files.config import model_of
from spheremouse.files.safe_files import write_atomically
from spheremouse.files.validate import Part, Provenance, read_checked
from spheremouse.files.yaml import SCHEMAS, Problem
from spheremouse.geometry.rotation import Array, align
from spheremouse.geometry.rotation import log as rotation_vector
from spheremouse.wand.ball import WandBall, WandDisc, wand_disc
from spheremouse.wand.colour import DEFAULT_COLOURS
from spheremouse.wand.settings import ColourSettings

# Discs this near to one another are the same one: half of the smallest disc
_MAX_SEPARATION_OF_SAME_DISC_RAD = np.radians(6.0)
_MIN_TURN_RAD = np.radians(15.0)  # smaller turns onto itself are the same attitude, in effect
_MIN_DISCS, _MAX_DISCS = 3, 64  # discs: three give an attitude; in a circle of 12 degrees each, 64 cover the ball

Length = Annotated[float, Field(ge=1e-4, le=2.0)]  # m: a tenth of a millimetre is dust


@dataclass(frozen=True, slots=True)
class WandFile:
    ball: WandBall
    colours: dict[str, ColourSettings]  # of every colour on the ball, and of no other


class _Disc(Part):
    azimuth: float = Field(ge=-360, le=360, description="degrees about the pole, counter-clockwise from above")
    latitude: float = Field(ge=-90, le=90, description="degrees above the equator, 90 at the pole")
    diameter: Length = Field(description="straight across the disc's rim, in m")
    colour: str = Field(min_length=1, description="a name of `colours`, or red, blue, dark or light")
    points: Length | None = Field(None, description="m along the surface from the centre to the four outer points")


class WandModel(Part):
    name: str = Field("wand", min_length=1, description="name of the ball in messages")
    radius: float = Field(ge=0.005, le=1.0, description="radius of the ball in m, 0.05 for 10 cm across")
    body: Literal["white", "black"] = Field("white", description="the ball between its discs: white or black")
    discs: tuple[_Disc, ...] = Field(
        min_length=_MIN_DISCS, max_length=_MAX_DISCS, description="list of {azimuth, latitude, diameter, colour}"
    )
    colours: dict[str, model_of(ColourSettings)] = Field(  # type: ignore[valid-type]
        {}, max_length=_MAX_DISCS, description="bounds of each colour; `spheremouse wand colours` picks them"
    )
    provenance: Provenance | None = Field(None, description="where the numbers come from: a section, for people")


def load_wand(path: Path) -> WandFile:
    """Read a ball from a file; ConfigurationError with a line for each problem."""
    document, file = read_checked(path, WandModel, "wand")
    colours = {name: ColourSettings(**given.model_dump(exclude_unset=True)) for name, given in file.colours.items()}
    if problems := [*_disc_problems(file), *_colour_problems(file, colours)]:
        raise document.error(problems)
    discs = (disc_of(file.radius, d.azimuth, d.latitude, d.diameter, d.colour, d.points) for d in file.discs)
    ball = WandBall(file.name, file.radius, tuple(discs), file.body)
    if problems := [*_overlaps(ball), *_symmetry_problem(ball)]:
        raise document.error(problems)
    return WandFile(ball, {name: (DEFAULT_COLOURS | colours)[name] for name in ball.colours})


def save_wand(
    path: Path,
    ball: WandBall,
    colours: Mapping[str, ColourSettings] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write the file of a ball, whole or not at all. `load_wand` returns the same ball from it."""
    write_atomically(path, wand_text(ball, colours, provenance))


def wand_text(
    ball: WandBall, colours: Mapping[str, ColourSettings] | None = None, provenance: Mapping[str, Any] | None = None
) -> str:
    lines = [
        "# A hand-held ball. Lengths in m, angles in degrees. Frame: origin at the centre, pole away from the stick,",
        "# azimuth counter-clockwise seen from above. A disc's diameter is measured straight across its rim.",
        f"schema: {SCHEMAS['wand']}",
    ]
    if provenance:
        lines += ["provenance:", *(f"  {key}: {json.dumps(value)}" for key, value in provenance.items())]
    lines += [f"name: {ball.name}", f"radius: {ball.radius:.9g}", f"body: {ball.body}", "discs:"]
    for disc in ball.discs:
        azimuth, latitude = angles_of(disc)
        lines.append(
            f"  - {{azimuth: {_short(azimuth % 360.0)}, latitude: {_short(latitude)}, "
            f"diameter: {_short(2.0 * ball.radius * np.sin(disc.angle))}, colour: {disc.colour}, "
            f"points: {_short(ball.radius * disc.points_angle)}}}"
        )
    if colours:
        lines.append("colours:  # brightness (value) of a picture with a mean of 127")
        for name, colour in colours.items():
            bounds = ", ".join(f"{f.name}: {_short(getattr(colour, f.name))}" for f in fields(colour))
            lines.append(f"  {name}: {{{bounds}}}")
    return "\n".join(lines) + "\n"


def _short(x: float) -> str:
    return f"{round(float(x), 9):.9g}"


def disc_of(
    radius: float, azimuth: float, latitude: float, diameter: float, colour: str, points: float | None
) -> WandDisc:
    """Return a disc on a ball of `radius` m, with angles in degrees. The diameter, m, is straight across the rim.

    `points`, m, are along the surface: the thesis' points lie on it, 0.5 and 1.2 cm from the centre.
    """
    angle = float(np.arcsin(0.5 * diameter / radius))
    place = float(np.radians(azimuth)), float(np.radians(latitude))
    return wand_disc(*place, angle, colour, None if points is None else points / radius)


def angles_of(disc: WandDisc) -> tuple[float, float]:
    x, y, z = disc.direction
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arcsin(np.clip(z, -1.0, 1.0))))


def _disc_problems(file: WandModel) -> Iterator[Problem]:
    for i, disc in enumerate(file.discs):
        if disc.diameter >= 2.0 * file.radius:
            text = f"is {disc.diameter:g} m, on a ball {2.0 * file.radius:g} m across; both are in metres"
            yield Problem(("discs", i, "diameter"), text)
        elif disc.points is not None and disc.points >= file.radius * np.arcsin(0.5 * disc.diameter / file.radius):
            text = f"is {disc.points:g} m from the centre, beyond the rim of a disc {disc.diameter:g} m across"
            yield Problem(("discs", i, "points"), text)


def _colour_problems(file: WandModel, colours: Mapping[str, ColourSettings]) -> Iterator[Problem]:
    used = {disc.colour for disc in file.discs}
    for i, disc in enumerate(file.discs):
        if disc.colour not in file.colours and disc.colour not in DEFAULT_COLOURS:
            text = f"is {disc.colour!r}, which has no bounds; write them under `colours`"
            yield Problem(("discs", i, "colour"), f"{text}, or use {', '.join(sorted(DEFAULT_COLOURS))}")
    for name, colour in colours.items():
        if name not in used:
            yield Problem(("colours", name), "no disc has this colour; remove it, or give it to a disc")
        for what in ("saturation", "value"):
            low, high = getattr(colour, f"{what}_min"), getattr(colour, f"{what}_max")
            if low >= high:
                text = f"is {low:g}, not below {what}_max, {high:g}: that selects nothing"
                yield Problem(("colours", name, f"{what}_min"), text)


def _overlaps(ball: WandBall) -> Iterator[Problem]:
    for i, disc in enumerate(ball.discs):
        for k, other in enumerate(ball.discs[:i]):
            angle = float(np.arccos(np.clip(disc.direction @ other.direction, -1.0, 1.0)))
            if angle < disc.angle + other.angle:
                gap = np.degrees(disc.angle + other.angle)
                text = f"overlaps disc {k + 1}: {np.degrees(angle):.1f} degrees apart, {gap:.1f} would touch"
                yield Problem(("discs", i), text)


def _symmetry_problem(ball: WandBall) -> Iterator[Problem]:
    """Yield a problem if a ball looks the same, within 6 degrees, after a turn of at least 15."""
    turn = symmetry(ball)
    if turn is None:
        return
    vector = rotation_vector(turn)
    x, y, z = vector / np.linalg.norm(vector)
    text = f"the ball looks the same turned by {np.degrees(np.linalg.norm(vector)):.0f} degrees about"
    yield Problem(("discs",), f"{text} ({x:.2f}, {y:.2f}, {z:.2f}); change the colour, size or place of a disc")


def symmetry(ball: WandBall) -> Array | None:
    """Return a rotation, (3, 3), that maps the discs onto discs of the same look, or None."""
    directions = np.array([d.direction for d in ball.discs])
    kinds = [(d.colour, round(float(np.degrees(d.angle)))) for d in ball.discs]
    second = int(np.argmin(np.abs(directions @ directions[0])))  # the nearest to a right angle with the first
    cosine, pair = directions[0] @ directions[second], (kinds[0], kinds[second])
    for i, k in product(range(len(kinds)), repeat=2):
        off = abs(directions[i] @ directions[k] - cosine)
        if (kinds[i], kinds[k]) != pair or off > np.sin(_MAX_SEPARATION_OF_SAME_DISC_RAD):
            continue
        turn = align(directions[[0, second]], directions[[i, k]])
        if np.linalg.norm(rotation_vector(turn)) < _MIN_TURN_RAD:
            continue
        angles = np.arccos(np.clip((directions @ turn.T) @ directions.T, -1.0, 1.0))
        nearest = np.argmin(angles, axis=1).tolist()
        is_symmetry = [kinds[n] for n in nearest] == kinds and len(set(nearest)) == len(kinds)
        if is_symmetry and float(np.max(np.min(angles, axis=1))) < _MAX_SEPARATION_OF_SAME_DISC_RAD:
            return turn
    return None
