"""Read device.yaml, a person's description and tape measurements of a device, in metres."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, create_model

from spheremouse.ball.device import Axes, Device, Distance
from spheremouse.ball.rig import CODES
from spheremouse.files.access import shipped
from spheremouse.files.rig.checks import repeated_targets
from spheremouse.files.rig.models import Code
from spheremouse.files.safe_files import read_bytes
from spheremouse.files.validate import Part, validate
from spheremouse.files.yaml import MAX_BYTES, Problem, read_document, without_schema

UNTOUCHED = "# NOT FILLED IN YET: delete this line when all below is true of your device."

_MIN_TARGETS = 3  # targets; fewer define no axes
_MAX_PART_RADIUS_M = 0.5  # m; a target or disc with a larger radius would be as large as a ball: mm or cm were meant
_MAX_DISTANCE_M = 10.0  # m between targets of one frame that a camera sees at once: mm or cm were meant
_MAX_RELATIVE_SIGMA = 0.1  # sigma over distance: a tape is never as bad

Id = Annotated[int, Field(ge=0, le=10**6, description="the id of a target, one of those under `targets`")]
Positive = Annotated[float, Field(gt=0, le=1e4)]  # m: no tape is longer
_MAX_DISTANCES = 100  # six targets have fifteen, each may be measured several times


class _Target(Part):
    id: int = Field(ge=0, le=10**6, description="a whole number of your choice that names the target")
    code: Code = Field(description="colours inside to outside: C cyan, M magenta, Y yellow")


class _Axes(Part):
    origin: Id
    up: Id
    plane: Id


_TapeDistance = create_model(
    "_TapeDistance",
    __base__=Part,
    **{"from": (Id, ...), "to": (Id, ...)},  # type: ignore[call-overload]  `from` is no name in Python
    metres=(Positive, Field(description="from centre to centre in metres, as in 0.750")),
    sigma=(Positive, Field(description="how exactly it was measured in metres; a tape held taut: 0.001")),
)


class DeviceFile(Part):
    targets: tuple[_Target, ...] = Field(
        min_length=_MIN_TARGETS, max_length=len(CODES), description="list of {id, code}, one for each target"
    )
    target_radii: tuple[Positive, Positive, Positive] = Field(
        description="[inner disc, middle ring, outer ring] in metres, each from the target's centre outwards"
    )
    disc_radius: Positive = Field(description="radius of a disc on the ball in metres, along the surface")
    axes: _Axes = Field(description="{origin, up, plane}: ids of three targets")
    distances: tuple[_TapeDistance, ...] = Field(  # type: ignore[valid-type]
        (), max_length=_MAX_DISTANCES, description="list of {from, to, metres, sigma}; [] where nothing was measured"
    )


def load_device(path: Path) -> Device:
    """Read a device file; ConfigurationError with a line for each problem."""
    document = read_document(path)
    if not isinstance(document.data, dict) or "schema" in document.data:
        document = without_schema(document, "device")
    file = validate(document, DeviceFile)
    distances = tuple(Distance(getattr(d, "from"), d.to, d.metres, d.sigma) for d in file.distances)
    if problems := list(_problems(file, distances)):
        raise document.error(problems)
    return Device(
        ids=tuple(t.id for t in file.targets),
        codes=tuple(t.code for t in file.targets),
        target_radii=np.array(file.target_radii),
        disc_radius=file.disc_radius,
        axes=Axes(file.axes.origin, file.axes.up, file.axes.plane),
        distances=distances,
    )


def is_untouched(path: Path) -> bool:
    """Return True if the device file is readable and has the first line that `calibrate init` writes."""
    try:
        return UNTOUCHED.encode() in read_bytes(path, MAX_BYTES, "device file")
    except OSError:
        return False


def device_template() -> str:
    """Return a device file to fill in, with an explanation of each line; it loads as it is."""
    return shipped("calibration/device.yaml")


def _problems(file: DeviceFile, distances: Sequence[Distance]) -> Iterator[Problem]:
    ids = [t.id for t in file.targets]
    yield from repeated_targets([(t.id, t.code) for t in file.targets])
    yield from _size_problems(file)
    if len(set(ids)) == len(ids):  # repeated ids are ambiguous
        yield from _axes_problems(file.axes, ids)
    for i, d in enumerate(distances):
        yield from _distance_problems(i, d, ids if len(set(ids)) == len(ids) else None, file.target_radii[2])


def _size_problems(file: DeviceFile) -> Iterator[Problem]:
    radii = file.target_radii
    if max(radii) > _MAX_PART_RADIUS_M:
        yield Problem(("target_radii",), f"are {_format_list(radii)} m; give {_in_metres(radii, _MAX_PART_RADIUS_M)}")
    elif not radii[0] < radii[1] < radii[2]:
        text = f"are {_format_list(radii)}; they must grow: inner disc, middle ring, outer ring, each from the centre"
        yield Problem(("target_radii",), text)
    if file.disc_radius > _MAX_PART_RADIUS_M:
        text = f"is {file.disc_radius:g} m; give {_in_metres([file.disc_radius], _MAX_PART_RADIUS_M)}"
        yield Problem(("disc_radius",), text)


def _axes_problems(axes: _Axes, ids: Sequence[int]) -> Iterator[Problem]:
    named: list[int] = []
    for name in ("origin", "up", "plane"):
        id_ = getattr(axes, name)
        if id_ not in ids:
            yield Problem(("axes", name), f"{id_} is no target; there are {_format_list(ids)}")
        elif id_ in named:
            yield Problem(("axes", name), f"{id_} is named for another axis already; name three different targets")
        named.append(id_)


def _distance_problems(i: int, d: Distance, ids: Sequence[int] | None, outer: float) -> Iterator[Problem]:
    for name, id_ in (("from", d.start), ("to", d.end)):
        if ids is not None and id_ not in ids:
            yield Problem(("distances", i, name), f"{id_} is no target; there are {_format_list(ids)}")
    if d.start == d.end:
        yield Problem(("distances", i, "to"), f"target {d.end} to itself; name the other target")
    key = ("distances", i, "metres")
    if d.metres > _MAX_DISTANCE_M:
        yield Problem(key, f"is {d.metres:g} m; give {_in_metres([d.metres], _MAX_DISTANCE_M)}")
    elif outer <= _MAX_PART_RADIUS_M and d.metres < 2.0 * outer:
        text = f"is {d.metres:g} m, and targets of radius {outer:g} m would overlap; check it and target_radii: metres"
        yield Problem(key, text)
    if d.metres <= _MAX_DISTANCE_M and d.sigma > _MAX_RELATIVE_SIGMA * d.metres:
        text = f"is {d.sigma:g} m for a length of {d.metres:g} m; give it in metres: a tape held taut is 0.001"
        yield Problem(("distances", i, "sigma"), text)


def _in_metres(values: Sequence[float], limit: float) -> str:
    """Return `metres: 0.075 if that was mm, 0.75 if cm`, for the units in which the values make sense."""
    meant = [
        f"{_format_list([v * factor for v in values])} if that was {unit}"
        for unit, factor in (("mm", 1e-3), ("cm", 1e-2))
        if max(values) * factor <= limit
    ]
    return "metres" + (": " if meant else "") + ", or ".join(meant)


def _format_list(values: Sequence[float]) -> str:
    return ", ".join(f"{v:g}" for v in values)
