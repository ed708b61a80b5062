"""Forms of a report as lines of text, for outputs that write or send lines.

`json` has one object a ball and frame, with attitude, rate and their covariances. `counts` has the stamp and the counts
of a mouse. `fictrac` has FicTrac's 25 columns.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.files.validate import nearest
from spheremouse.output import Report, fictrac
from spheremouse.output.response import KEYS
from spheremouse.output.sample import to_json

OptionType = type[int] | type[float] | type[str]
Options = dict[str, int | float | str]


@dataclass(frozen=True, slots=True)
class LineFormat:
    """A form of reports as lines."""

    lines: Callable[[Report], list[bytes]]  # each with its end
    start: bytes  # of the first line of a file
    header: bytes = b""  # line before the others, if there is one
    paced: bool = False  # the counts of each report, as a mouse gets them, in place of each frame's


def json_lines(report: Report) -> list[bytes]:
    """Return a JSON object for each ball of a frame."""
    return [to_json(sample, counts) for sample, counts in report.counted]


def count_lines(report: Report) -> list[bytes]:
    """Return stamp (s) and counts of a report as a line."""
    x, y, z = report.counts
    return [f"{float(report.stamp)!r} {x} {y} {z}\n".encode()]


_COUNTS = b"# stamp dx dy dz"
_OPTIONS = {"format": str, "frame": str, "forward": float}
_FICTRAC = ("frame", "forward")  # options of that format alone
_FORMATS: dict[str, Callable[[Options], LineFormat]] = {
    "json": lambda _: LineFormat(json_lines, b'{"sequence":'),
    "counts": lambda _: LineFormat(count_lines, _COUNTS, _COUNTS + b" (s, counts)\n"),
    "reports": lambda _: LineFormat(count_lines, _COUNTS, _COUNTS + b" (s, counts)\n", paced=True),
    "fictrac": lambda given: LineFormat(
        fictrac.FicTrac(str(given.get("frame", "camera")), float(given.get("forward", 0.0))).lines, b"FT, "
    ),
}


def parse_address(kind: str, argument: str) -> tuple[str, LineFormat]:
    """Return the address or file of `ADDRESS[,format=NAME]`, and its format. Raise OutputError if it is invalid."""
    return parse_target(kind, argument, {})[:2]


def parse_target(kind: str, argument: str, known: Mapping[str, OptionType]) -> tuple[str, LineFormat, Options]:
    """Return address, format and all options, whose types are in `known` or the format's; OutputError if invalid."""
    address, _, rest = argument.partition(",")
    place = f"{kind}:{argument}"
    given = options(rest, _OPTIONS | dict(known) | KEYS, place, OutputError)
    name = str(given.get("format", "json"))
    if name not in _FORMATS:
        raise OutputError(f"{place}: unknown format {name!r}", nearest(name, list(_FORMATS)))
    if name != "fictrac" and (unused := [key for key in _FICTRAC if key in given]):
        raise OutputError(f"{place}: {unused[0]} is an option of format=fictrac")
    if (frame := str(given.get("frame", "camera"))) not in fictrac.FRAMES:
        raise OutputError(f"{place}: unknown frame {frame!r}", nearest(frame, list(fictrac.FRAMES)))
    return address, _FORMATS[name](given), given
