"""Validate plain data with a pydantic model, and report every problem as a line that a user can act on.

The lines read `FILE:LINE: key: problem, is VALUE; remedy`. The remedy for a value is the description of the model's
field; for an unknown key it is the nearest known name.
"""

import difflib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from spheremouse.errors import one_line
from spheremouse.files.yaml import MAX_PROBLEMS, Document, Key, Problem, dotted, read_document, shown, without_schema

M = TypeVar("M", bound=BaseModel)

CONFIG_SHOW = "`spheremouse config show` lists those that are known"  # advice on an unknown setting
_MAX_LISTED_KEYS = 12  # of a section, in a message


class Part(BaseModel):
    """Base of models of a file's sections. Only whole numbers convert, to float. Unknown keys and NaN are errors."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        protected_namespaces=(),
        defer_build=True,  # a run reads few kinds of files
    )


class Provenance(BaseModel):
    """Date, version, photos and notes for people; the program does not read them."""

    model_config = ConfigDict(extra="allow", defer_build=True)


def read_checked(path: Path, model: type[M], kind: str) -> tuple[Document, M]:
    """Read a file of a `kind` of SCHEMAS: document and model instance. ConfigurationError has its problems."""
    document = without_schema(read_document(path), kind)
    return document, validate(document, model)


def validate(document: Document, model: type[M]) -> M:
    """Return the model instance of a document, or raise one ConfigurationError with all problems."""
    try:
        return model.model_validate(document.data)
    except ValidationError as e:
        problems, more = _problems(e, document, model)
        raise document.error(problems, more) from None


def nearest(word: str, names: Sequence[str], otherwise: str = "") -> str:
    """Return advice on an unknown name: up to three nearest `names`, else the advice `otherwise`, or all names."""
    close = difflib.get_close_matches(word, names, n=3, cutoff=0.6)
    if not close:  # perhaps the section is wrong
        close = [n for n in names if n.rpartition(".")[2] == word.rpartition(".")[2]][:3]
    if close:
        return f"did you mean {' or '.join(close)}?"
    return otherwise or (f"known here: {', '.join(names)}" if names else "no keys are known here")


def _problems(error: ValidationError, document: Document, model: type[BaseModel]) -> tuple[list[Problem], int]:
    """Return pydantic's errors, one for a key, sorted by line, at most MAX_PROBLEMS, and the number of the others."""
    found: dict[Key, list[Any]] = {}
    for e in error.errors(include_url=False):
        key = _within(e["loc"], document.data, missing=e["type"] in ("missing", "extra_forbidden"))
        found.setdefault(key, []).append(e)
    first = sorted(found, key=document.line)[:MAX_PROBLEMS]
    return [Problem(key, _message(key, found[key], document.data, model)) for key in first], len(found) - len(first)


def _message(key: Key, complaints: Sequence[Any], data: Any, model: type[BaseModel]) -> str:
    if complaints[0]["type"] == "extra_forbidden":
        return f"unknown key; {_advice_on_name(str(key[-1]), key[:-1], model)}"
    text = ", or ".join(map(_complaint_text, complaints))
    if complaints[0]["type"] != "missing":
        for part in key:
            data = data[part]
        text += f", is {shown(data)}"
    along = [info for info, _ in _walk(key, model) if info]
    if key and isinstance(key[-1], str):  # the sections around a key give no advice on it
        along = along[-1:]
    described = [f.description for f in along if f.description]
    return f"{text}; {described[-1]}" if described else text


def _within(loc: tuple[int | str, ...], data: Any, *, missing: bool) -> Key:
    """Return the key of a location, without branches of unions. A `missing` or unknown key stays at the end."""
    key: list[int | str] = []
    for i, part in enumerate(loc):
        there = (isinstance(data, dict) and part in data) or (
            isinstance(data, tuple) and isinstance(part, int) and part < len(data)
        )
        if there:
            data = data[part]  # type: ignore[index]
        elif not (missing and i == len(loc) - 1):
            continue
        key.append(part)
    return tuple(key)


_WORDS = {
    "missing": "missing",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text",
    "none_required": "empty (null)",
    "tuple_type": "must be a list [a, b, ...]",
    "finite_number": "must be a finite number",
    "model_type": "must be a section of `key: value` lines",
    "model_attributes_type": "must be a section of `key: value` lines",
}
_BOUNDS = {
    "greater_than": ("gt", "must be greater than {}"),
    "greater_than_equal": ("ge", "must be at least {}"),
    "less_than": ("lt", "must be less than {}"),
    "less_than_equal": ("le", "must be at most {}"),
    "multiple_of": ("multiple_of", "must be a multiple of {}"),
    "too_long": ("max_length", "must be a list of at most {}"),
    "too_short": ("min_length", "must be a list of at least {}"),
    "literal_error": ("expected", "must be {}"),
}


def _complaint_text(e: Any) -> str:
    if e["type"] in _WORDS:
        return _WORDS[e["type"]]
    if e["type"] in _BOUNDS:
        name, text = _BOUNDS[e["type"]]
        bound = e["ctx"][name]
        return text.format(f"{bound:g}" if isinstance(bound, float) else bound)
    if e["type"] == "value_error":
        return str(e["ctx"]["error"])
    return one_line(e["msg"])


def _advice_on_name(word: str, parent: Key, model: type[BaseModel]) -> str:
    """Return advice on an unknown key `word` of the section `parent`, for example "did you mean motion.scale_x?".

    Similar keys of this section come first. Then the section may be wrong, so keys of all sections count, if they are
    more similar. Otherwise the advice lists the keys of this section.
    """
    *_, annotation = (model, *(annotation for _, annotation in _walk(parent, model)))
    section = next(_models(annotation), None)
    siblings = list(section.model_fields) if section else []
    if difflib.get_close_matches(word, siblings, cutoff=0.6):
        return nearest(word, siblings)
    everywhere = [dotted(k) for k in _all_keys(model)]
    elsewhere = [k for k in everywhere if difflib.get_close_matches(word, [k.rpartition(".")[2]], cutoff=0.85)]
    if elsewhere:
        return f"did you mean {' or '.join(elsewhere[:3])}?"
    return nearest(word, siblings, CONFIG_SHOW if len(siblings) > _MAX_LISTED_KEYS else "")


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in an annotation, also within Optional, unions and Annotated, but not in tuples."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) is not tuple:
        for a in get_args(annotation):
            yield from _models(a)


def _element(annotation: Any) -> Any:
    if get_origin(annotation) is tuple:
        return get_args(annotation)[0]
    return next((e for a in get_args(annotation) if (e := _element(a)) is not None), None)


def _walk(key: Key, model: type[BaseModel]) -> Iterator[tuple[FieldInfo | None, Any]]:
    """Yield field and type of each part of a key, from the model down; None where the model has none."""
    annotation: Any = model
    for part in key:
        info = None
        if isinstance(part, int):
            annotation = _element(annotation)
        else:
            here = next(_models(annotation), None)
            info = here.model_fields.get(part) if here else None
            annotation = info.annotation if info else None
        yield info, annotation


def _all_keys(model: type[BaseModel], prefix: Key = ()) -> Iterator[Key]:
    for name, info in model.model_fields.items():
        yield (*prefix, name)
        for inner in _models(info.annotation):
            yield from _all_keys(inner, (*prefix, name))
