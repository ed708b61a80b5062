"""The text of a map of discs.

A line of the file is a disc: its direction in `ball`, its standard deviations along `rotation.tangent_basis`, and its
sightings. Their correlations follow as a Cholesky factor, which gives a covariance even after rounding.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from typing import Annotated

import numpy as np
from pydantic import Field

from spheremouse.ball.detect.projection import GREY, NEGATIVE, Projection, normalise
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import MAX_DISCS
from spheremouse.files.validate import Part, validate
from spheremouse.files.yaml import Document, Problem, shown, without_schema
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import correlation

_UNIT = 100_000  # of the Cholesky factor's digits: a standard deviation keeps four of them in any combination

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]  # likewise
Length = Annotated[float, Field(ge=1e-6, le=1e6)]  # as in the rig file
Sigma = Annotated[float, Field(ge=0, lt=10)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Weight = Annotated[float, Field(ge=-1, le=1)]


class MapHeader(Part):
    """The part of a map file that all kinds of maps have: version, time and the ball's radius."""

    spheremouse: str = Field(description="version of the program that wrote the file")
    saved: str = Field(description='date and time as "2025-01-31T12:00:00+00:00"')
    ball_radius: Length = Field(description="radius of the ball in m")


class DiscItem(Part):
    direction: tuple[Coordinate, Coordinate, Coordinate] = Field(description="unit vector [x, y, z] in ball")
    sigma: tuple[Sigma, Sigma] = Field(description="two standard deviations in rad")
    sightings: int = Field(ge=0, lt=10**15, description="frames in which the disc was seen")


class CentreItem(Part):
    place: tuple[Coordinate, Coordinate, Coordinate] = Field(description="[x, y, z] in ball from the pivot, m")
    sigma: Positive = Field(description="its largest standard deviation in m")


class LandmarksFile(MapHeader):
    """Directions with their joint covariance, and the centre of an eccentric ball."""

    centre: CentreItem | None = Field(default=None, description="of an eccentric ball: {place, sigma}")
    discs: tuple[DiscItem, ...] = Field(
        min_length=1, max_length=MAX_DISCS, description="list of {direction, sigma, sightings}"
    )
    correlation_root: tuple[str, ...] = Field(
        max_length=2 * MAX_DISCS, description="two lines of whole numbers, in quotes, for each disc"
    )


class MapFile(LandmarksFile):
    """Content of the file of a map of discs."""

    disc_radius: Length = Field(description="radius of a disc in m")
    weights: tuple[Weight, Weight, Weight] = Field(
        default=GREY.weights, description="[blue, green, red] of the sum of colours in which discs are darker"
    )


def lines(header: list[str], disc_map: DiscMap, disc_radius: float) -> list[str]:
    weights = ", ".join(f"{weight:.6f}" for weight in disc_map.projection.weights)
    of_colours = [f"weights: [{weights}]  # of blue, green and red: so the discs are darker"]
    return [
        "# The discs on one ball, as tracked. Written by spheremouse and read at the next start; without it a new one",
        "# is made as the ball turns. Unit vectors in `ball`; rad along the axes of rotation.tangent_basis.",
        *header,
        f"disc_radius: {float(disc_radius)!r}  # m, along the surface",
        *(of_colours if disc_map.projection != GREY else []),
        *landmark_lines(disc_map),
    ]


def landmark_lines(disc_map: DiscMap) -> list[str]:
    sigma, root = _factor(disc_map.covariance)
    lines = list[str]()
    if disc_map.eccentricity_sigma > 0.0:
        place = ", ".join(f"{x:.4e}" for x in disc_map.eccentricity)
        sigma_of_centre = f"sigma: {disc_map.eccentricity_sigma:.4e}"
        lines.append(f"centre: {{place: [{place}], {sigma_of_centre}}}  # m, from the point that the ball turns about")
    lines.append("discs:")
    for direction, s, sightings in zip(disc_map.directions, sigma.reshape(-1, 2), disc_map.sightings, strict=True):
        x, y, z = direction
        lines.append(
            f"  - {{direction: [{x:.9f}, {y:.9f}, {z:.9f}], sigma: [{s[0]:.4e}, {s[1]:.4e}], "
            f"sightings: {int(sightings)}}}"
        )
    lines.append(f"correlation_root:  # L with L L^T the correlations, row by row, times {_UNIT}")
    for i, row in enumerate(np.rint(_UNIT * root).astype(int).tolist()):
        lines.append(f'  - "{" ".join(map(str, row[: i + 1]))}"')
    return lines


def _factor(covariance: Array) -> tuple[Array, Array]:
    """Return standard deviations, (n,), and the lower triangular root, (n, n), of the correlations, with unit rows."""
    sigma = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(correlation(covariance))  # Cholesky fails for a disc with zero covariance
    root = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1].T
    root *= np.where(np.diag(root) < 0.0, -1.0, 1.0)
    return sigma, root / np.linalg.norm(root, axis=1, keepdims=True)


def parse(document: Document) -> tuple[MapFile, DiscMap]:
    """Return the content of a file and its map. Raise ConfigurationError with all problems."""
    file = validate(without_schema(document, "map"), MapFile)
    problems = [*landmark_problems(file)]
    if not any(file.weights):
        problems.append(Problem(("weights",), "are all 0; remove the line: they are found as the ball turns"))
    if problems:
        raise document.error(problems)
    return file, replace(landmarks(file), projection=_projection(file.weights))


def landmarks(file: LandmarksFile) -> DiscMap:
    """Return the directions of a file without problems, and their covariance."""
    directions = np.array([d.direction for d in file.discs])
    sigma = np.array([d.sigma for d in file.discs]).ravel()
    root = np.zeros((len(file.correlation_root),) * 2)
    for i, text in enumerate(file.correlation_root):
        root[i, : i + 1] = np.array(text.split(), dtype=float)
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    found = DiscMap(
        directions / np.linalg.norm(directions, axis=1, keepdims=True),
        (root @ root.T) * np.outer(sigma, sigma),
        np.array([d.sightings for d in file.discs], dtype=np.intp),
    )
    centre = file.centre
    if centre is None:
        return found
    return replace(found, eccentricity=np.array(centre.place), eccentricity_sigma=centre.sigma)


def landmark_problems(file: LandmarksFile) -> Iterator[Problem]:
    """Yield what is wrong with date, directions and correlations of a file."""
    try:
        if datetime.fromisoformat(file.saved).tzinfo is None:
            yield Problem(("saved",), f"{shown(file.saved)} has no time zone; end it in +00:00")
    except ValueError:
        yield Problem(("saved",), f'is {shown(file.saved)}; write date and time as "2025-01-31T12:00:00+00:00"')
    for i, disc in enumerate(file.discs):
        length = np.linalg.norm(disc.direction)
        if not abs(length - 1.0) <= 1e-3:
            yield Problem(("discs", i, "direction"), f"has length {length:.4g}; it is a unit vector")
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
    found = normalise(np.array(weights))
    return next((p for p in (GREY, NEGATIVE) if np.allclose(p.weights, found.weights, rtol=0.0, atol=1e-5)), found)
