"""Jobs of an experiment. They return plain data, from which a section of the page follows.

A module of this package is an experiment: it has `jobs(request)`. A job names a function of that module, which runs in
a process of its own with the job's parameters and returns plain data for JSON.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Result = dict[str, Any]
Results = Mapping[
    str, Result
]  # by the jobs' keys; one that failed is {"error": one line}; one not asked for is missing


@dataclass(frozen=True, slots=True)
class Job:
    """The unit of work, and of what is kept: seconds to a minute of one core."""

    key: str  # unique in its experiment; a file's name
    work: Callable[..., Result]  # a function of a module
    parameters: dict[str, Any] = field(default_factory=dict)  # any JSON value
    cost: float = 10.0  # s of one core, about: long ones begin first
    alone: bool = False  # measures time: runs when nothing else of ours does

    @property
    def recipe(self) -> str:
        """Return the function and parameters, which with the program determine the result."""
        name = f"{self.work.__module__}.{self.work.__qualname__}"
        return f"{name} {json.dumps(self.parameters, sort_keys=True)}"


@dataclass(frozen=True, slots=True)
class Request:
    quick: bool
    datasets: Path | None  # folder of the reference recordings; None: they are not here
