"""The part of a map file that all kinds of maps have: version, time and the ball's radius."""

from collections.abc import Iterator
from datetime import datetime
from typing import Annotated

from pydantic import Field

from spheremouse.files.validate import Part
from spheremouse.files.yaml import SCHEMAS, Problem, shown

Length = Annotated[float, Field(ge=1e-6, le=1e6)]  # as in the rig file


class MapHeader(Part):
    """Base of the content of a map file."""

    spheremouse: str = Field(description="version of the program that wrote the file")
    saved: str = Field(description='date and time as "2025-01-31T12:00:00+00:00"')
    ball_radius: Length = Field(description="radius of the ball in m")


def header_lines(version: str, saved: datetime, ball_radius: float) -> list[str]:
    """Return the lines of a file."""
    return [
        f"schema: {SCHEMAS['map']}",
        f'spheremouse: "{version}"',
        f'saved: "{saved.isoformat()}"',
        f"ball_radius: {float(ball_radius)!r}  # m",
    ]


def header_problems(header: MapHeader) -> Iterator[Problem]:
    """Yield what is wrong with the date of a file."""
    try:
        if datetime.fromisoformat(header.saved).tzinfo is None:
            yield Problem(("saved",), f"{shown(header.saved)} has no time zone; end it in +00:00")
    except ValueError:
        yield Problem(("saved",), f'is {shown(header.saved)}; write date and time as "2025-01-31T12:00:00+00:00"')
