"""Read a configuration file into settings, and write settings as YAML.

The settings dataclasses are the schema; their fields (`settings.param`) have unit, meaning and bounds. A file holds
only what differs from the defaults. `override` applies one `--set KEY=VALUE`.
"""

import contextlib
import dataclasses
import functools
import re
import textwrap
import types
import typing
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, create_model

from spheremouse.errors import ConfigurationError
from spheremouse.files.validate import GONE, gone, nearest, validated
from spheremouse.files.yaml import (
    SCHEMAS,
    Document,
    Key,
    Problem,
    dotted,
    parse_document,
    parse_value,
    read_document,
    without_schema,
)

S = TypeVar("S")

KIND = "configuration"

_WIDTH = 110
_JOINED = "\u00a0"  # a space at which a comment does not wrap


def load(path: Path, root: type[S]) -> S:
    """Read a configuration file: `root()` with the values of the file."""
    return loads(read_document(path), root)


def loads(document: Document, root: type[S]) -> S:
    """Return the settings of a document."""
    document = without_schema(document, KIND)
    names = [field.name for field in dataclasses.fields(typing.cast(Any, root))]
    strange = [key for key in document.data if key not in names]
    if len(strange) > max(2, len(document.data) // 2):  # too many for mistyped keys
        what = f"is this a configuration? It has no keys {', '.join(map(str, strange))}"
        raise document.error([Problem((strange[0],), f"{what}; name a rig file in a configuration, by `rig:`")])
    return _applied(document, root())


def in_force(file: Path | None, assignments: Iterable[str], root: type[S]) -> S:
    """Return the settings of a run: the defaults, then the file, then each KEY=VALUE in order."""
    settings = root() if file is None else load(file, root)
    for assignment in assignments:
        settings = override(settings, assignment)
    return settings


def assigned(settings: Any, assignments: Iterable[str]) -> dict[tuple[str, ...], Any]:
    """Return the values of the settings that the assignments name, by key."""
    found: dict[tuple[str, ...], Any] = {}
    for assignment in assignments:
        key, value = tuple(assignment.partition("=")[0].strip().split(".")), settings
        for name in key:
            value = getattr(value, name)
        found[key] = value
    return found


def override(settings: S, assignment: str, *, label: str = "--set ") -> S:
    """Return settings with one `KEY=VALUE`, such as `so3.acceleration_sigma=0.5`; the value is YAML.

    Messages begin with `label`, the place of the assignment.
    """
    key, equals, text = assignment.partition("=")
    key = key.strip()
    if not equals or not key:
        raise ConfigurationError(f"{label}{assignment}: not KEY=VALUE; write for example section.name=1.5")
    value = _single_value(text, f"{label}{key}")
    known = dict(parameters(settings))
    parts: Key = tuple(key.split("."))
    if parts not in known:
        names = [dotted(k) for k in known]
        inside = [n for n in names if n.startswith(key + ".")]
        if inside:
            raise ConfigurationError(f"{label}{key}: a section; set one of {', '.join(inside)}")
        advice = gone(parts, model_of(type(settings))) or f"unknown key; {nearest(key, names)}"
        raise ConfigurationError(f"{label}{key}: {advice}")
    data: Any = value
    for part in reversed(parts):
        data = {part: data}
    try:
        return _applied(Document("", data, {}), settings)
    except ConfigurationError as e:  # a single value has no line
        raise ConfigurationError("\n".join(label + line.removeprefix(":1: ") for line in str(e).split("\n"))) from None


def dump_commented(settings: Any, keys: Collection[str] | None = None) -> str:
    """Return a configuration file in which a comment gives meaning, unit, bounds and default of each setting.

    With `keys` it has these settings only, such as "motion.player". Without, it loads back to equal settings.
    """
    lines = ["# Configuration of spheremouse. Settings that are left out keep their defaults."]
    if keys is not None:
        lines.append("# `spheremouse config init --all FILE` writes the settings for experts too.")
    return "\n".join([*lines, f"schema: {SCHEMAS[KIND]}", *_commented(settings, (), keys)]) + "\n"


def dump(settings: S, default: S) -> str:
    """Return settings as YAML without comments, but for the default of each setting that differs from `default`."""
    before, nulls = dict(parameters(default)), set(_with_null(settings))
    lines = [f"schema: {SCHEMAS[KIND]}"]
    section: Key = ()
    for key, value in parameters(settings):
        for depth in range(len(key) - 1):
            if section[: depth + 1] != key[: depth + 1]:
                lines.append(f"{'  ' * depth}{key[depth]}:")
        section = key[:-1]
        mark = "" if value == before.get(key) else f"  # default: {to_yaml(before.get(key))}"
        unset = "# " if value is None and key in nulls else ""  # a written null would mean a value
        lines.append(f"{'  ' * len(section)}{unset}{key[-1]}: {to_yaml(value)}{mark}")
    return "\n".join(lines) + "\n"


def parameters(settings: Any, prefix: Key = ()) -> Iterator[tuple[Key, Any]]:
    """Yield every setting with its key and value, those outside of sections first."""
    for field in _ordered(type(settings)):
        value = getattr(settings, field.name)
        if _is_section(type(settings), field):
            yield from parameters(value, (*prefix, field.name))
        else:
            yield (*prefix, field.name), value


def _with_null(settings: Any, prefix: Key = ()) -> Iterator[Key]:
    """Yield the keys for which a written null means a value."""
    for field in _ordered(type(settings)):
        if _is_section(type(settings), field):
            yield from _with_null(getattr(settings, field.name), (*prefix, field.name))
        elif field.metadata.get("null") is not None:
            yield (*prefix, field.name)


@functools.cache
def model_of(cls: type) -> type[BaseModel]:
    """Return the pydantic model of a settings dataclass. It converts only int to float and rejects unknown keys."""
    hints = _hints(cls)
    fields: dict[str, Any] = {}
    for field in _ordered(cls):
        annotation = _annotation(hints[field.name], field.metadata.get("bounds", {}), field.metadata.get("most"))
        required = _is_required(field)
        description = None if _is_section(cls, field) else _advice(field)
        fields[field.name] = (annotation, Field(... if required else None, description=description))
    config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, protected_namespaces=())
    made = create_model(cls.__name__, __config__=config, **fields)
    setattr(made, GONE, getattr(cls, GONE, {}))
    return made


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    """Return the types of a settings class; cached, since each call would evaluate text."""
    return typing.get_type_hints(cls)


def to_yaml(value: Any) -> str:
    """Return a value on one line of YAML."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return value if _is_plain_word(value) else _quoted(value)
    if dataclasses.is_dataclass(value):
        return "{" + ", ".join(f"{f.name}: {to_yaml(getattr(value, f.name))}" for f in _ordered(type(value))) + "}"
    if isinstance(value, tuple):
        return "[" + ", ".join(to_yaml(v) for v in value) + "]"
    return repr(value)


def _quoted(text: str) -> str:
    """Return text in single quotes, or in double quotes with escapes if it has control characters."""
    if text.isprintable():
        return "'" + text.replace("'", "''") + "'"
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'


def _single_value(text: str, name: str) -> Any:
    try:
        return parse_value(text, name)
    except ConfigurationError as e:
        raise ConfigurationError(str(e).replace(f"{name}:1: ", f"{name}: ", 1)) from None


def _is_plain_word(text: str) -> bool:
    return text.isidentifier() and text.isascii() and parse_document(text, "").data == text


def _annotation(hint: Any, bounds: dict[str, float], most: int | None = None) -> Any:
    """Return the type for pydantic, with bounds on each number and `most` on each list's length."""
    origin, args = get_origin(hint), get_args(hint)
    if dataclasses.is_dataclass(hint):
        return model_of(typing.cast(type, hint))
    if hint in (int, float):
        return Annotated[hint, Field(**typing.cast(dict[str, Any], bounds))] if bounds else hint
    if hint in (bool, str, type(None)) or origin is Literal:
        return hint
    if origin in (typing.Union, types.UnionType):
        return typing.Union[tuple(_annotation(a, bounds, most) for a in args)]  # noqa: UP007  built at run time
    if origin is tuple:
        inner = tuple[tuple(a if a is ... else _annotation(a, bounds) for a in args)]  # type: ignore[misc]
        return Annotated[inner, Field(max_length=most)] if most is not None and args[-1] is ... else inner
    raise TypeError(f"settings cannot hold {hint}: use bool, int, float, str, Literal, None, tuples and dataclasses")


def _applied(document: Document, settings: S) -> S:
    document = Document(document.name, _with_meant_values(document.data, settings), document.lines)
    checked = validated(document, model_of(type(settings)))
    return _updated(settings, checked, document, ())


def _with_meant_values(data: Any, settings: Any) -> Any:
    """Return data with an empty section for null, and the values that `null` and 640x480 mean by `settings.param`."""
    if not isinstance(data, dict):
        return data
    fields = {field.name: field for field in dataclasses.fields(settings)}
    meant = {}
    for name, value in data.items():
        field = fields.get(name)
        if field is None:
            meant[name] = value
        elif _is_section(type(settings), field):
            meant[name] = {} if value is None else _with_meant_values(value, getattr(settings, name))
        else:
            meant[name] = _meant(value, field)
    return meant


def _meant(value: Any, field: "dataclasses.Field[Any]") -> Any:
    sign = field.metadata.get("pair")
    if value is None:
        return field.metadata.get("null")
    if sign and isinstance(value, str) and (found := re.fullmatch(rf"(\d{{1,9}}) ?{sign} ?(\d{{1,9}})", value)):
        return int(found[1]), int(found[2])
    return value


def _updated(settings: S, checked: BaseModel, document: Document, key: Key) -> S:
    """Return `settings` with the values of the document."""
    changes: dict[str, Any] = {}
    for name in checked.model_fields_set:
        old, new = getattr(settings, name), getattr(checked, name)
        nested = isinstance(new, BaseModel) and dataclasses.is_dataclass(old)
        field = next(f for f in dataclasses.fields(typing.cast(Any, settings)) if f.name == name)
        hint = _hints(type(settings))[name]
        if nested and _is_section(type(settings), field):
            changes[name] = _updated(old, new, document, (*key, name))
        else:
            changes[name] = _built(hint, new, document, (*key, name))
    with _refusal(document, key):
        return dataclasses.replace(typing.cast(Any, settings), **changes)


def _built(hint: Any, checked: Any, document: Document, key: Key) -> Any:
    """Return validated data as the dataclasses of the type hint."""
    if isinstance(checked, BaseModel):
        cls = next(_dataclasses_in(hint))
        hints = _hints(cls)
        given = {n: _built(hints[n], getattr(checked, n), document, (*key, n)) for n in checked.model_fields_set}
        with _refusal(document, key):
            return cls(**given)
    if isinstance(checked, tuple):
        inner = next((h for h in (hint, *get_args(hint)) if get_origin(h) is tuple), hint)
        args = get_args(inner)
        return tuple(
            _built(args[i] if i < len(args) and args[i] is not ... else args[0], v, document, (*key, i))
            for i, v in enumerate(checked)
        )
    return checked


@contextlib.contextmanager
def _refusal(document: Document, key: Key) -> Iterator[None]:
    """Turn the ValueError of a dataclass's `__post_init__` into an error with file and line."""
    try:
        yield
    except ValueError as e:
        raise document.error([Problem(key, str(e))]) from None


def _dataclasses_in(hint: Any) -> Iterator[type]:
    if dataclasses.is_dataclass(hint):
        yield typing.cast(type, hint)
    for a in get_args(hint):
        yield from _dataclasses_in(a)


def _is_section(cls: type, field: "dataclasses.Field[Any]") -> bool:
    return dataclasses.is_dataclass(_hints(cls)[field.name])


def _ordered(cls: type) -> list["dataclasses.Field[Any]"]:
    """Return the settings of a class, sections last, so that YAML reads top-down.

    A field with a default, but without `settings.param`, is a constant of the code.
    """
    found = [f for f in dataclasses.fields(cls) if f.metadata or _is_required(f) or _is_section(cls, f)]
    return sorted(found, key=lambda f: _is_section(cls, f))


def _is_required(field: "dataclasses.Field[Any]") -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _default(field: "dataclasses.Field[Any]") -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default
    return None if field.default_factory is dataclasses.MISSING else field.default_factory()


def _unit(field: "dataclasses.Field[Any]") -> str:
    unit = field.metadata.get("unit", "-")
    return "" if unit == "-" else f" {unit}"


def _advice(field: "dataclasses.Field[Any]") -> str | None:
    if _is_required(field):
        return None
    value, refused = _default(field), field.metadata.get("refused")
    default = f"the default is {to_yaml(value)}{'' if value is None or isinstance(value, str) else _unit(field)}"
    return f"{default}; {refused}" if refused else default


def _commented(settings: Any, prefix: Key, keys: Collection[str] | None) -> Iterator[str]:
    hints, indent = _hints(type(settings)), "  " * len(prefix)
    first = bool(prefix)
    for field in _ordered(type(settings)):
        value, key = getattr(settings, field.name), dotted((*prefix, field.name))
        section = _is_section(type(settings), field)
        if keys is not None and not any(k == key or (section and k.startswith(f"{key}.")) for k in keys):
            continue
        if not first:
            yield ""
        first = False
        if section:
            yield from _comment(_summary(type(value)), indent)
            yield f"{indent}{field.name}:"
            yield from _commented(value, (*prefix, field.name), keys)
            continue
        yield from _comment(_about(field, hints[field.name]), indent)
        for inner in _dataclasses_in(hints[field.name]):
            inner_hints = _hints(inner)
            for f in _ordered(inner):
                yield from _comment(f"{f.name}: {_about(f, inner_hints[f.name])}", indent, hang="  ")
        if isinstance(value, tuple) and any(dataclasses.is_dataclass(v) for v in value):
            yield f"{indent}{field.name}:"
            yield from (f"{indent}  - {to_yaml(v)}" for v in value)
        else:
            unset = "# " if value is None and field.metadata.get("null") is not None else ""
            yield f"{indent}{unset}{field.name}: {to_yaml(value)}"


def _about(field: "dataclasses.Field[Any]", hint: Any) -> str:
    """Return the meaning of a setting, then choices, unit, bounds and default in brackets."""
    words = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    meaning = field.metadata.get("meaning", "").rstrip(".")
    limits = [f"{words[k]} {v:g}" for k, v in field.metadata.get("bounds", {}).items()]
    choices = [to_yaml(a) for a in _choices(hint)]
    facts = [f"one of {', '.join(choices)}"] if choices else []
    facts += [unit] if (unit := _unit(field).strip()) else []
    facts += limits
    if (most := field.metadata.get("most")) is not None:
        facts.append(f"at most {most} of them")
    if not _is_required(field):
        unset = _default(field) is None and field.metadata.get("null") is not None
        facts.append("not set by default" if unset else f"default {to_yaml(_default(field))}")
    first = meaning.partition(" ")[0]
    if first.isalpha():  # a symbol keeps its case
        meaning = meaning[:1].upper() + meaning[1:]
    bracket = f"[{'; '.join(facts)}]"
    if len(bracket) <= 60:
        bracket = bracket.replace(" ", _JOINED)
    return f"{meaning}. {bracket}" if facts else f"{meaning}."


def _choices(hint: Any) -> Iterator[Any]:
    if get_origin(hint) is Literal:
        yield from get_args(hint)
    elif get_origin(hint) in (typing.Union, types.UnionType):
        for a in get_args(hint):
            yield from _choices(a)


def _summary(cls: type) -> str:
    """Return the first paragraph of a settings class, for the head of its section."""
    text = (cls.__doc__ or cls.__name__).strip().split("\n\n")[0]
    return " ".join(text.split())


def _comment(text: str, indent: str, hang: str = "") -> list[str]:
    lines = textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=f"{indent}# {hang}",
        subsequent_indent=f"{indent}# {hang}",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(_JOINED, " ") for line in lines]
