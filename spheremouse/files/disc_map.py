"""Write and read the map of a ball's discs, a file beside the rig that makes the next run's attitude absolute.

A line of the file is a disc: its direction in `ball`, its standard deviations along `rotation.tangent_basis`, and its
sightings. Their correlations follow as a Cholesky factor, which gives a covariance even after rounding. The reader
rejects a damaged file; the tracker then builds a new map.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from spheremouse import __version__
from spheremouse.ball.detect.projection import GREY, NEGATIVE, Projection, normalised
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import MOST_DISCS, Rig
from spheremouse.errors import ConfigurationError
from spheremouse.files.safe_files import write_atomically
from spheremouse.files.validate import Part, validated
from spheremouse.files.yaml import SCHEMAS, Document, Problem, read_document, shown, without_schema
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import correlation

_UNIT = 100_000  # of the Cholesky factor's digits: a standard deviation keeps four of them in any combination
BALL_DIFFERS, _DISC_DIFFERS = 0.05, 0.25  # parts of a radius; less is calibration, more is another device

Length = Annotated[float, Field(ge=1e-6, le=1e6)]  # as in the rig file
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]  # likewise
Sigma = Annotated[float, Field(ge=0, lt=10)]
Weight = Annotated[float, Field(ge=-1, le=1)]


@dataclass(frozen=True, slots=True)
class SavedMap:
    """A map, the sizes of its device, and its age."""

    map: DiscMap
    ball_radius: float  # m
    disc_radius: float  # m, along the surface
    saved: datetime  # with its time zone
    version: str  # of the program that wrote it


class _Disc(Part):
    direction: tuple[Coordinate, Coordinate, Coordinate] = Field(description="unit vector [x, y, z] in ball")
    sigma: tuple[Sigma, Sigma] = Field(description="two standard deviations in rad")
    sightings: int = Field(ge=0, lt=10**15, description="frames in which the disc was seen")


class MapFile(Part):
    """Content of a map file."""

    spheremouse: str = Field(description="version of the program that wrote the file")
    saved: str = Field(description='date and time as "2025-01-31T12:00:00+00:00"')
    ball_radius: Length = Field(description="radius of the ball in m")
    disc_radius: Length = Field(description="radius of a disc in m")
    discs: tuple[_Disc, ...] = Field(
        min_length=1, max_length=MOST_DISCS, description="list of {direction, sigma, sightings}"
    )
    weights: tuple[Weight, Weight, Weight] = Field(
        default=GREY.weights, description="[blue, green, red] of the sum of colours in which discs are darker"
    )
    correlation_root: tuple[str, ...] = Field(
        max_length=2 * MOST_DISCS, description="two lines of whole numbers, in quotes, for each disc"
    )


def map_path(rig_file: Path) -> Path:
    """Return the path of a device's map: `rig.map.yaml` beside `rig.yaml`."""
    return rig_file.with_suffix(".map.yaml")


def old_path(path: Path) -> Path:
    """Return the path for a map that another ball's map replaces: `rig.map.old.yaml` for `rig.map.yaml`."""
    return path.with_suffix(f".old{path.suffix}")


def saved_now(disc_map: DiscMap, rig: Rig) -> SavedMap:
    """Return a map to save, with the sizes of this device, the time and our version."""
    assert rig.disc_radius is not None
    now = datetime.now(UTC).replace(microsecond=0)
    return SavedMap(disc_map, rig.ball.radius, rig.disc_radius, now, __version__)


def save_map(path: Path, saved: SavedMap) -> None:
    """Write a map file, whole or not at all; it reads back to the same map."""
    write_atomically(path, map_text(saved))


def load_map(path: Path) -> SavedMap:
    """Read a map file; ConfigurationError with problem and remedy."""
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file; check the path")
    try:
        return _parsed(read_document(path))
    except ConfigurationError as e:
        first, *others = str(e).splitlines()
        more = f" (and {len(others)} more)" if others else ""
        raise ConfigurationError(
            f"{first}{more}; mend that, or move the file away: a new map is made as the ball turns"
        ) from None


def check_fits(saved: SavedMap, rig: Rig, path: Path) -> None:
    """Raise ConfigurationError if the ball or the discs of a map have other sizes than those of the rig."""
    for what, there, here, most in (
        ("a ball", saved.ball_radius, rig.ball.radius, BALL_DIFFERS),
        ("discs", saved.disc_radius, rig.disc_radius, _DISC_DIFFERS),
    ):
        if here is not None and abs(there - here) > most * here:
            raise ConfigurationError(
                f"{path}: was made with {what} of radius {there:g} m, the rig has {here:g} m: name this device's map "
                "with --map, or move the file away, and the tracker creates a new one as the ball turns"
            )


def age(saved: SavedMap) -> str:
    """Return the time since a map was saved, in words."""
    seconds = (datetime.now(UTC) - saved.saved).total_seconds()
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {unit} ago"
    return "just now"


def map_text(saved: SavedMap) -> str:
    sigma, root = _factored(saved.map.covariance)
    lines = [
        "# The discs on one ball, as tracked. Written by spheremouse and read at the next start; without it a new one",
        "# is made as the ball turns. Unit vectors in `ball`; rad along the axes of rotation.tangent_basis.",
        f"schema: {SCHEMAS['map']}",
        f'spheremouse: "{saved.version}"',
        f'saved: "{saved.saved.isoformat()}"',
        f"ball_radius: {float(saved.ball_radius)!r}  # m",
        f"disc_radius: {float(saved.disc_radius)!r}  # m, along the surface",
        *_weights_line(saved.map.projection),
        "discs:",
    ]
    for direction, s, sightings in zip(saved.map.directions, sigma.reshape(-1, 2), saved.map.sightings, strict=True):
        x, y, z = direction
        lines.append(
            f"  - {{direction: [{x:.9f}, {y:.9f}, {z:.9f}], sigma: [{s[0]:.4e}, {s[1]:.4e}], "
            f"sightings: {int(sightings)}}}"
        )
    lines.append(f"correlation_root:  # L with L L^T the correlations, row by row, times {_UNIT}")
    for i, row in enumerate(np.rint(_UNIT * root).astype(int).tolist()):
        lines.append(f'  - "{" ".join(map(str, row[: i + 1]))}"')
    return "\n".join(lines) + "\n"


def _weights_line(projection: Projection) -> list[str]:
    """Return the line of the colour weights; none for grey, the default."""
    if projection == GREY:
        return []
    blue, green, red = projection.weights
    return [f"weights: [{blue:.6f}, {green:.6f}, {red:.6f}]  # of blue, green and red: so the discs are darker"]


def _factored(covariance: Array) -> tuple[Array, Array]:
    """Return standard deviations, (n,), and the lower triangular root, (n, n), of the correlations, with unit rows."""
    sigma = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(correlation(covariance))  # Cholesky fails for a disc with zero covariance
    root = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1].T
    root *= np.where(np.diag(root) < 0.0, -1.0, 1.0)
    return sigma, root / np.linalg.norm(root, axis=1, keepdims=True)


def _parsed(document: Document) -> SavedMap:
    file = validated(without_schema(document, "map"), MapFile)
    if problems := list(_problems(file)):
        raise document.error(problems)
    directions = np.array([d.direction for d in file.discs])
    sigma = np.array([d.sigma for d in file.discs]).ravel()
    root = _root(file)
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    disc_map = DiscMap(
        directions / np.linalg.norm(directions, axis=1, keepdims=True),
        (root @ root.T) * np.outer(sigma, sigma),
        np.array([d.sightings for d in file.discs], dtype=np.intp),
        _projection(file.weights),
    )
    saved = datetime.fromisoformat(file.saved)
    return SavedMap(disc_map, file.ball_radius, file.disc_radius, saved, file.spheremouse)


def _problems(file: MapFile) -> Iterator[Problem]:
    try:
        if datetime.fromisoformat(file.saved).tzinfo is None:
            yield Problem(("saved",), f"{shown(file.saved)} has no time zone; end it in +00:00")
    except ValueError:
        yield Problem(("saved",), f'is {shown(file.saved)}; write date and time as "2025-01-31T12:00:00+00:00"')
    for i, disc in enumerate(file.discs):
        length = np.linalg.norm(disc.direction)
        if not abs(length - 1.0) <= 1e-3:
            yield Problem(("discs", i, "direction"), f"has length {length:.4g}; it is a unit vector")
    if not any(file.weights):
        yield Problem(("weights",), "are all 0; remove the line: they are found as the ball turns")
    if len(file.correlation_root) != 2 * len(file.discs):
        text = f"has {len(file.correlation_root)} lines for {len(file.discs)} discs; each disc has two"
        yield Problem(("correlation_root",), text)
        return
    for i, text in enumerate(file.correlation_root):
        if not re.fullmatch(r"-?[0-9]{1,6}( -?[0-9]{1,6})*", text) or len(text.split()) != i + 1:
            yield Problem(("correlation_root", i), f"must be {i + 1} whole numbers, is {shown(text)}")
        elif not abs(np.linalg.norm(np.array(text.split(), dtype=float)) / _UNIT - 1.0) <= 1e-3:
            yield Problem(("correlation_root", i), f"its squares must sum to {_UNIT} squared: a digit was changed")


def _projection(weights: tuple[float, float, float]) -> Projection:
    """Return the projection of a file; grey and its negative are exact, since grey images show both."""
    found = normalised(np.array(weights))
    return next((p for p in (GREY, NEGATIVE) if np.allclose(p.weights, found.weights, rtol=0.0, atol=1e-5)), found)


def _root(file: MapFile) -> Array:
    root = np.zeros((len(file.correlation_root),) * 2)
    for i, text in enumerate(file.correlation_root):
        root[i, : i + 1] = np.array(text.split(), dtype=float) / _UNIT
    return root
