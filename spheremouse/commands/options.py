"""Make command-line options from the fields of a dataclass, and parse sizes, lenses and lists of numbers.

A field is declared with `settings.param`: its meaning is the option's help, its unit the metavar. The unit of a size
or a list is its form, WxH or X,Y,Z. A length in m may be typed with its unit.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, Field, fields
from functools import partial, wraps
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import typer

from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.settings import option_name

_MAX_SIDE_PX = 8192  # px, a side
_LENS = "k1,k2,p1,p2,k3"  # of at most 2: no lens bends more

Command = Callable[..., None]
T = TypeVar("T")


Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One parameter of the configuration; may be repeated."),
]
Balls = Annotated[
    list[Path] | None,
    typer.Option(
        "--ball", metavar="FILE", help="Wand: a ball's wand file; may be repeated.  [default: the recording's own]"
    ),
]
CameraFile = Annotated[
    Path | None, typer.Option("--camera", metavar="FILE", help="Interior orientation, in place of the rig's.")
]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Configuration file; see `spheremouse config`.")
]
JsonFile = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the results as JSON; - prints them.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]
Cabinet = Annotated[
    Path | None, typer.Argument(metavar="[FOLDER]", help="Folder from `calibrate init`.  [default: cabinet]")
]
RigFile = Annotated[
    Path | None, typer.Option("--rig", metavar="FILE", help="The device as calibrated, in place of the recording's.")
]
Report = Annotated[
    Path | None, typer.Option("--report", metavar="FILE.html", help="Report with pictures.  [default: beside --out]")
]
Socket = Annotated[
    Path | None,
    typer.Option(metavar="PATH", help="The daemon's socket.  [default: $SPHEREMOUSE_SOCKET, else where one answers]"),
]


# The board: by default as in its board.yaml, or as printed

Corners = Annotated[
    str | None,
    typer.Option(
        "--board",
        metavar="CxR",
        help="Inner corners along and down: one less than squares.  [default: from board.yaml]",
    ),
]
Square = Annotated[
    str | None,
    typer.Option(
        metavar="LENGTH", help="Side of a square, measured on the print, as in 86mm.  [default: from board.yaml]"
    ),
]
Marker = Annotated[
    str | None, typer.Option(metavar="LENGTH", help="Side of a marker, as in 60mm: it is a ChArUco board.")
]
Dictionary = Annotated[str | None, typer.Option(metavar="NAME", help="ChArUco markers, as printed on the board.")]


def one_or_all(values: Sequence[T] | None) -> T | Sequence[T] | None:
    """Return the value of a setting that is one or a list: the only one of several, else all."""
    return values[0] if values is not None and len(values) == 1 else values


def settings_given(assignments: list[str] | None, config: Path | None, options: Mapping[str, Any]) -> tuple[str, ...]:
    """Return --set and the `options` that stand for a setting, by its key, as KEY=VALUE. None and [] leave it.

    A path becomes absolute if there is a configuration file: paths of settings are relative to it.
    """
    from spheremouse.files.config import assignments as as_assignments

    def plain(value: Any) -> Any:
        if isinstance(value, Path):
            return str(value if config is None else value.absolute())
        return tuple(map(plain, value)) if isinstance(value, list) else value

    given = {key: plain(value) for key, value in options.items() if value not in (None, [])}
    return (*(assignments or ()), *as_assignments(given))


def with_fields(**names: tuple[str, ...]) -> Callable[[Command], Command]:
    """Decorate a command: replace its keyword `options` by one option for each field of the dataclass that it takes.

    A field is declared with `settings.param`, or with typer's annotation. `names` has the names of options that differ
    from their fields.
    """

    def decorate(command: Command) -> Command:
        written = dict(inspect.signature(command).parameters)
        kind = written["options"].annotation
        made = [_option(field, names.get(field.name, ())) for field in fields(kind)]
        signature = inspect.Signature([p for name in written for p in (made if name == "options" else [written[name]])])

        @wraps(command)
        def call(*args: Any, **kwargs: Any) -> None:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            given = bound.arguments
            options = kind(**{f.name: _value(f, given.pop(f.name), names.get(f.name)) for f in fields(kind)})
            command(**given, options=options)

        vars(call)["__signature__"] = signature
        return call

    return decorate


def _option(field: "Field[Any]", names: tuple[str, ...]) -> inspect.Parameter:
    """Return the command-line option of a field: a setting's unit and bounds become metavar and limits."""
    parameter = partial(inspect.Parameter, field.name, inspect.Parameter.KEYWORD_ONLY)
    if not field.metadata:  # with typer's annotation
        default = inspect.Parameter.empty if field.default is MISSING else field.default
        return parameter(default=default, annotation=field.type)
    unit, bounds, annotation, default = field.metadata["unit"], field.metadata["bounds"], field.type, field.default
    metavar: str | None = unit.upper()
    if _is_word(unit):
        annotation, default, bounds = str | None, _word(unit, default), {}
        metavar = "LENGTH" if unit == "m" else unit
    elif unit == "-":
        kinds = (annotation, *get_args(annotation))
        metavar = "N" if int in kinds else "F" if float in kinds else None
    if default is False:
        names = names or (option_name(field.name),)  # and no opposite
    option = typer.Option(
        *names, metavar=metavar, min=bounds.get("ge"), max=bounds.get("le"), help=field.metadata["meaning"]
    )
    return parameter(default=default, annotation=Annotated[annotation, option])


def _is_word(unit: str) -> bool:
    return unit in ("WxH", "m") or "," in unit


def _word(unit: str, value: Any) -> str | None:
    if value is None:
        return None
    return f"{value:g}m" if unit == "m" else ("x" if unit == "WxH" else ",").join(f"{part:g}" for part in value)


def _value(field: "Field[Any]", typed: Any, names: tuple[str, ...] | None) -> Any:
    """Return the typed words in the form of the field. Raises ConfigurationError for an unknown word."""
    unit, option = field.metadata.get("unit", "-"), names[0] if names else option_name(field.name)
    if typed is None or not _is_word(unit):
        return typed
    if unit == "m":
        return _length(option, typed)
    # Only colours have no default
    example = "-0.1,0,0,0,0" if unit == _LENS else _word(unit, field.default) or "30,30,200 for red"
    if unit == "WxH":
        return parse_size(typed, field.metadata["bounds"]["ge"], example)
    return parse_numbers(option, typed, unit.count(",") + 1, 2.0 if unit == _LENS else inf, example)


def _length(option: str, text: str) -> float:
    from spheremouse.calibrate.board import parse_length

    with suppress(ValueError):
        return float(text)
    try:
        return parse_length(text)
    except CalibrationError as e:
        raise ConfigurationError(f"{option}: {e}") from None


def parse_size(text: str, least: int, example: str) -> tuple[int, int]:
    """Return width and height in px of `640x480`; ConfigurationError if a side is below `least`."""
    from spheremouse.files.pictures import FRAME_PIXELS

    width, _, height = text.lower().partition("x")
    fits = all(side.isdecimal() and len(side) < 10 and least <= int(side) <= _MAX_SIDE_PX for side in (width, height))
    if fits and int(width) * int(height) > FRAME_PIXELS:
        raise ConfigurationError(
            f"--size {text}: at most {FRAME_PIXELS // 1_000_000} megapixels (8K) can be read again"
        )
    if not fits:
        raise ConfigurationError(
            f"--size {text}: write WIDTHxHEIGHT in px, as in {example}, each from {least} to {_MAX_SIDE_PX}"
        )
    return int(width), int(height)


def parse_numbers(option: str, text: str, n: int, limit: float, example: str) -> tuple[float, ...]:
    """Return `n` numbers between commas, of at most `limit`; ConfigurationError for other texts."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
        if len(numbers) != n or not all(isfinite(x) and abs(x) <= limit for x in numbers):
            raise ValueError(text)
    except ValueError:
        bounds = f" from -{limit:g} to {limit:g}" if isfinite(limit) else ""
        raise ConfigurationError(f"{option} {text}: write {n} numbers{bounds}, as in {example}") from None
    return numbers
