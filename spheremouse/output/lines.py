"""Forms of a report as lines of text, for outputs that write or send lines.

`json` has one object a ball and frame, with attitude, rate and their covariances. `counts` has the stamp and the counts
of a mouse.
"""

from collections.abc import Callable
from dataclasses import dataclass

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.files.validate import nearest
from spheremouse.output import Report
from spheremouse.output.sample import to_json


@dataclass(frozen=True, slots=True)
class LineFormat:
    """A form of reports as lines."""

    lines: Callable[[Report], list[str]]
    start: str  # of the first line of a file
    header: str = ""  # line before the others, if there is one
    paced: bool = False  # the counts of each report, as a mouse gets them, in place of each frame's


def json_lines(report: Report) -> list[str]:
    """Return a JSON object for each ball of a frame."""
    return [
        to_json(sample, report.counts if k == report.pointing else (0, 0, 0)) for k, sample in enumerate(report.samples)
    ]


def count_lines(report: Report) -> list[str]:
    """Return stamp (s) and counts of a report as a line."""
    return [" ".join([repr(float(report.stamp)), *map(str, report.counts)])]


_COUNTS = "# stamp dx dy dz"
_FORMATS: dict[str, Callable[[], LineFormat]] = {
    "json": lambda: LineFormat(json_lines, '{"sequence":'),
    "counts": lambda: LineFormat(count_lines, _COUNTS, f"{_COUNTS} (s, counts)"),
    "reports": lambda: LineFormat(count_lines, _COUNTS, f"{_COUNTS} (s, counts)", paced=True),
}


def parse_address(kind: str, argument: str) -> tuple[str, LineFormat]:
    """Return the address or file of `ADDRESS[,format=NAME]`, and its format. Raise OutputError if it is invalid."""
    address, _, rest = argument.partition(",")
    name = str(options(rest, {"format": str}, f"{kind}:{argument}", OutputError).get("format", "json"))
    if name not in _FORMATS:
        raise OutputError(f"{kind}:{argument}: unknown format {name!r}; {nearest(name, list(_FORMATS))}")
    return address, _FORMATS[name]()
