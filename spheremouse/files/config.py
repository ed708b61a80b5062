"""Read a configuration file into settings, and write settings as YAML. The settings dataclasses are the schema."""

import dataclasses
import functools
import re
import textwrap
import types
import typing
from collections.abc import Collection, Iterable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, Field, create_model

from spheremouse.errors import ConfigurationError
from spheremouse.files import yaml
from spheremouse.files.validate import CONFIG_SHOW, Part, nearest, validate
from spheremouse.files.yaml import SCHEMAS, Document, Key, Problem, dotted

S = TypeVar("S")

KIND = "configuration"

_PROFILES = "profiles"  # key of the named sets of settings
PROFILE_NAME = re.compile(r"[A-Za-z0-9_-]{1,50}")
Profiles = dict[str, tuple[str, ...]]  # assignments KEY=VALUE by name

_KINDS = {bool: "flag", int: "integer", float: "number", str: "text"}
_MAX_LINE_CHARACTERS = 110
_JOINED = "\u00a0"  # a space at which a comment does not wrap


def load(path: Path, root: type[S]) -> S:
    """Read a configuration file: `root()` with the values of the file."""
    return loads(yaml.read_document(path), root)


def loads(document: Document, root: type[S]) -> S:
    document = yaml.without_schema(document, KIND)
    names = [field.name for field in dataclasses.fields(typing.cast(Any, root))]
    strange = [key for key in document.data if key not in names]
    if len(strange) > max(2, len(document.data) // 2):  # too many for mistyped keys
        what = f"is this a configuration? It has no keys {', '.join(map(str, strange))}"
        raise document.error([Problem((strange[0],), f"{what}; name a rig file in a configuration, by `rig:`")])
    if _PROFILES not in document.data or _PROFILES not in names:
        return _apply(document, root())
    data = {key: value for key, value in document.data.items() if key != _PROFILES}
    settings = _apply(dataclasses.replace(document, data=data), root())
    return dataclasses.replace(typing.cast(Any, settings), profiles=_profiles(document, settings))


def _profiles(document: Document, settings: Any) -> Profiles:
    """Return the profiles of a document, each checked as a change of its settings."""
    found: Profiles = {}
    sections = document.data[_PROFILES] or {}
    if not isinstance(sections, dict):
        raise document.error([Problem((_PROFILES,), "must be sections, one for each profile")])
    for name, values in sections.items():
        key: Key = (_PROFILES, name)
        if not PROFILE_NAME.fullmatch(name):
            raise document.error([Problem(key, "must be a name of letters, digits, '_' and '-'")])
        if not isinstance(values, dict):
            raise document.error([Problem(key, "must be a section of `motion.scale_x: 2` lines")])
        changed, assignments = settings, []
        for setting, value in values.items():
            place = f"{document.place((*key, setting))}{dotted(key)}: "
            if isinstance(value, dict):
                advice = f"write `{setting}.KEY: VALUE` lines in place of a section"
                raise ConfigurationError(f"{place}{setting}: {advice}")
            assignments.append(f"{setting}={to_yaml(value)}")
            changed = override(changed, assignments[-1], label=place)
        found[name] = tuple(assignments)
    return found


def in_force(file: Path | None, assignments: Iterable[str], root: type[S]) -> S:
    """Return the settings of a run: defaults, then file, then each KEY=VALUE. ConfigurationError: one is invalid."""
    settings = root() if file is None else load(file, root)
    for assignment in assignments:
        settings = override(settings, assignment)
    return settings


def key_of(assignment: str) -> str:
    return assignment.partition("=")[0].strip()


def assignments(values: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(f"{key}={to_yaml(value)}" for key, value in values.items())


def assigned_values(settings: Any, assignments: Iterable[str]) -> dict[tuple[str, ...], Any]:
    """Return the values of the settings that the assignments name, by key."""
    return {tuple(key.split(".")): attrgetter(key)(settings) for key in map(key_of, assignments)}


def override(settings: S, assignment: str, *, label: str = "--set ") -> S:
    """Return settings with one `KEY=VALUE`, such as `so3.acceleration_sigma=0.5`; the value is YAML.

    Messages begin with `label`, the place of the assignment. Raises ConfigurationError for an unknown key or an invalid
    value.
    """
    key, equals, text = assignment.partition("=")
    key = key.strip()
    if not equals or not key:
        raise ConfigurationError(f"{label}{assignment}: not KEY=VALUE; write for example section.name=1.5")
    try:
        value = yaml.parse_value(text, f"{label}{key}")
    except ConfigurationError as e:
        raise ConfigurationError(str(e).replace(f"{label}{key}:1: ", f"{label}{key}: ", 1)) from None
    known = dict(parameters(settings))
    parts: Key = tuple(key.split("."))
    if parts not in known:
        names = [dotted(k) for k in known]
        inside = [n for n in names if n.startswith(key + ".")]
        if inside:
            raise ConfigurationError(f"{label}{key}: a section; set one of {', '.join(inside)}")
        raise ConfigurationError(f"{label}{key}: unknown key; {nearest(key, names, CONFIG_SHOW)}")
    for part in reversed(parts):
        value = {part: value}
    return _apply(Document(label, value), settings)


def dump_commented(settings: Any, keys: Collection[str] | None = None) -> str:
    """Return a configuration file in which a comment gives meaning, unit, bounds and default of each setting.

    With `keys` it has these settings only, such as "motion.player". Without, it loads back to equal settings.
    """
    lines = ["# Configuration of spheremouse. Settings that are left out keep their defaults."]
    if keys is not None:
        lines.append("# `spheremouse config init --all FILE` writes the settings for experts too.")
    return "\n".join([*lines, f"schema: {SCHEMAS[KIND]}", *_commented_lines(settings, (), keys)]) + "\n"


def dump(settings: S, default: S) -> str:
    """Return all settings as YAML. A comment gives the default of each setting that differs from `default`."""
    before = dict(parameters(default))
    lines = [f"schema: {SCHEMAS[KIND]}"]
    section: Key = ()
    for key, field, _, value in _fields(settings):
        for depth in range(len(key) - 1):
            if section[: depth + 1] != key[: depth + 1]:
                lines.append(f"{'  ' * depth}{key[depth]}:")
        section = key[:-1]
        mark = "" if value == before.get(key) else f"  # default: {to_yaml(before.get(key))}"
        lines.append(f"{'  ' * len(section)}{_assignment(field, value)}{mark}")
    return "\n".join(lines) + "\n"


def parameters(settings: Any) -> Iterator[tuple[Key, Any]]:
    """Yield every setting with its key and value, those outside of sections first."""
    return ((key, value) for key, _, _, value in _fields(settings))


def describe(settings: Any) -> Iterator[dict[str, Any]]:
    """Yield key, value, unit, meaning, type, bounds and choices of every setting as plain data (docs/control.md)."""
    for key, field, hint, value in _fields(settings):
        about, bounds = field.metadata, field.metadata["bounds"]
        choices = list(_choices(hint))
        yield {
            "key": dotted(key),
            "group": dotted(key[:-1]),
            "value": value,
            "default": field.default,
            "unit": "" if about["unit"] == "-" else about["unit"],
            "meaning": about["meaning"],
            "type": _kind(hint),
            "minimum": bounds.get("ge"),
            "maximum": bounds.get("le"),
            "choices": choices or None,
        }


def _kind(hint: Any) -> str:
    kinds = get_args(hint) if get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    if any(get_origin(kind) is tuple for kind in kinds):
        return "list"
    return next((_KINDS[kind] for kind in kinds if kind in _KINDS), "choice")


def _fields(settings: Any, prefix: Key = ()) -> "Iterator[tuple[Key, dataclasses.Field[Any], Any, Any]]":
    for field in _ordered_fields(type(settings)):
        key, value = (*prefix, field.name), getattr(settings, field.name)
        if _is_section(type(settings), field):
            yield from _fields(value, key)
        else:
            yield key, field, _hints(type(settings))[field.name], value


@functools.cache
def model_of(cls: type) -> type[BaseModel]:
    """Return the pydantic model of a settings dataclass. It converts only int to float and rejects unknown keys."""
    fields: dict[str, Any] = {}
    for field in _ordered_fields(cls):
        section, about = _is_section(cls, field), field.metadata
        annotation = _annotation(_hints(cls)[field.name], about.get("bounds", {}), about.get("most"))
        read = BeforeValidator(functools.partial(_without_short_form, about, section))
        fields[field.name] = (Annotated[annotation, read], Field(None, description=None if section else _advice(field)))
    return create_model(cls.__name__, __base__=Part, **fields)


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
        plain = value.isidentifier() and value.isascii() and yaml.parse_document(value, "").data == value
        return value if plain else _quote(value)
    if isinstance(value, tuple):
        return "[" + ", ".join(to_yaml(v) for v in value) + "]"
    return repr(value)


def _quote(text: str) -> str:
    """Return text in single quotes, or in double quotes with escapes if it has control characters."""
    if text.isprintable():
        return "'" + text.replace("'", "''") + "'"
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'


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
        inner = tuple[tuple(a if a is ... else _annotation(a, bounds, most) for a in args)]  # type: ignore[misc]
        return Annotated[inner, Field(max_length=most)] if most is not None and args[-1] is ... else inner
    raise TypeError(f"settings cannot hold {hint}: use bool, int, float, str, Literal, None and tuples")


def _apply(document: Document, settings: S) -> S:
    return _update(settings, validate(document, model_of(type(settings))), document, ())


def _without_short_form(about: Mapping[str, Any], section: bool, value: Any) -> Any:
    """Return the value that 640x480, a written null or an empty section means."""
    if value is None:
        return {} if section else about["null"]
    sign = about.get("pair")
    if sign and isinstance(value, str) and (found := re.fullmatch(rf"(\d{{1,9}}) ?{sign} ?(\d{{1,9}})", value)):
        return int(found[1]), int(found[2])
    return value


def _update(settings: S, checked: BaseModel, document: Document, key: Key) -> S:
    """Return `settings` with the values of the document; an error of `__post_init__` gets file and line."""
    changes: dict[str, Any] = {}
    for name in checked.model_fields_set:
        value = getattr(checked, name)
        section = isinstance(value, BaseModel)
        changes[name] = _update(getattr(settings, name), value, document, (*key, name)) if section else value
    try:
        return dataclasses.replace(typing.cast(Any, settings), **changes)
    except ValueError as e:
        raise document.error([Problem(key, str(e))]) from None


def _is_section(cls: type, field: "dataclasses.Field[Any]") -> bool:
    return dataclasses.is_dataclass(_hints(cls)[field.name])


@functools.cache
def _ordered_fields(cls: type) -> tuple["dataclasses.Field[Any]", ...]:
    """Return the fields in the order of a YAML file: settings, then sections. Fields without `param` are constants."""
    found = [f for f in dataclasses.fields(cls) if f.metadata or _is_section(cls, f)]
    return tuple(sorted(found, key=lambda f: _is_section(cls, f)))


def _unit(field: "dataclasses.Field[Any]") -> str:
    unit = field.metadata["unit"]
    return "" if unit == "-" else f" {unit}"


def _advice(field: "dataclasses.Field[Any]") -> str:
    value, refused = field.default, field.metadata["refused"]
    default = f"the default is {to_yaml(value)}{'' if value is None or isinstance(value, str) else _unit(field)}"
    return f"{default}; {refused}" if refused else default


def _assignment(field: "dataclasses.Field[Any]", value: Any) -> str:
    """Return `key: value`, or a comment if no value is set and a written null would mean one."""
    unset = "# " if value is None and field.metadata["null"] is not None else ""
    return f"{unset}{field.name}: {to_yaml(value)}"


def _commented_lines(settings: Any, prefix: Key, keys: Collection[str] | None) -> Iterator[str]:
    """Yield the lines of a configuration file: each setting below its description, sections indented."""
    hints, indent = _hints(type(settings)), "  " * len(prefix)
    first = bool(prefix)
    for field in _ordered_fields(type(settings)):
        value, key = getattr(settings, field.name), dotted((*prefix, field.name))
        section = _is_section(type(settings), field)
        if keys is not None and not any(k == key or (section and k.startswith(f"{key}.")) for k in keys):
            continue
        if not first:
            yield ""
        first = False
        if section:
            first_paragraph = (type(value).__doc__ or type(value).__name__).strip().split("\n\n")[0]
            yield from _comment_lines(" ".join(first_paragraph.split()), indent)
            yield f"{indent}{field.name}:"
            yield from _commented_lines(value, (*prefix, field.name), keys)
            continue
        yield from _comment_lines(_about(field, hints[field.name]), indent)
        yield f"{indent}{_assignment(field, value)}"


def _about(field: "dataclasses.Field[Any]", hint: Any) -> str:
    """Return the meaning of a setting, then choices, unit, bounds and default in brackets."""
    words = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    meaning, about = field.metadata["meaning"].rstrip("."), field.metadata
    choices, unit = [to_yaml(a) for a in _choices(hint)], _unit(field).strip()
    facts = [f"one of {', '.join(choices)}"] if choices else []
    facts += [unit] if unit else []
    facts += [f"{words[k]} {v:g}" for k, v in about["bounds"].items()]
    facts += [] if about["most"] is None else [f"at most {about['most']} of them"]
    unset = field.default is None and about["null"] is not None
    facts.append("not set by default" if unset else f"default {to_yaml(field.default)}")
    if meaning.partition(" ")[0].isalpha():  # a symbol keeps its case
        meaning = meaning[:1].upper() + meaning[1:]
    bracket = f"[{'; '.join(facts)}]"
    return f"{meaning}. {bracket.replace(' ', _JOINED) if len(bracket) <= 60 else bracket}"


def _choices(hint: Any) -> Iterator[Any]:
    if get_origin(hint) is Literal:
        yield from get_args(hint)
    elif get_origin(hint) in (typing.Union, types.UnionType):
        for a in get_args(hint):
            yield from _choices(a)


def _comment_lines(text: str, indent: str) -> list[str]:
    mark = f"{indent}# "
    wrap = textwrap.TextWrapper(
        _MAX_LINE_CHARACTERS,
        initial_indent=mark,
        subsequent_indent=mark,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(_JOINED, " ") for line in wrap.wrap(text)]
