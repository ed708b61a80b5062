"""Read JSON from untrusted files and sockets as plain data.

Raises ValueError, in one line, for invalid JSON, deep nesting, long or infinite numbers, a repeated key, and half a
surrogate pair.
"""

import json
import math
from typing import Any

MAX_DEPTH = 20  # levels; a scene has 5
_NESTED = (list, dict)  # a union in `isinstance` is built at each call
_CHECKED = (str, *_NESTED)
MAX_DIGITS = 30  # of a whole number; 64 bits have 20


def loads(text: str | bytes, *, constants: bool = False, surrogates: bool = False) -> Any:
    """Return the data of a JSON text, as `json.loads` does, but refuse what this module names.

    `constants` allows NaN and Infinity, which `json.dumps` writes, but not 1e999. `surrogates` allows half a surrogate
    pair: Python represents a byte of a file's name that is not UTF-8 by one (`surrogateescape`). Raises
    json.JSONDecodeError, which has the line, for invalid JSON, and ValueError without a line for valid JSON that is
    refused.
    """
    constant = None if constants else _refuse_constant
    try:
        data = json.loads(
            text,
            parse_constant=constant,
            parse_int=_bounded_integer,
            parse_float=_finite_float,
            object_pairs_hook=_refuse_repeated_key,
        )
    except RecursionError:
        raise ValueError(f"nested deeper than {MAX_DEPTH} levels") from None
    _check(data, MAX_DEPTH, surrogates)
    return data


def tuples(value: Any) -> Any:
    """Return the value with tuples in place of lists, as `validate.validate` expects."""
    if isinstance(value, list):
        return tuple(map(tuples, value))
    return {k: tuples(v) for k, v in value.items()} if isinstance(value, dict) else value


def message_of(error: ValueError) -> str:
    """Return the message of an error of `loads` in one line, without its line number."""
    words = error.msg if isinstance(error, json.JSONDecodeError) else str(error)
    return " ".join(words.split())[:120]


def _bounded_integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"a whole number of {len(text)} digits")
    return int(text)


def _finite_float(text: str) -> float:
    value = float(text)
    if math.isinf(value):  # as 1e999, which is valid JSON
        raise ValueError(f"{text[:MAX_DIGITS]} exceeds the largest number")
    return value


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _refuse_repeated_key(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        raise ValueError("a key stands twice in one object")
    return data


def _check(value: Any, depth: int, surrogates: bool) -> None:
    """Raise ValueError if data are nested deeper than `depth`, or have half a surrogate pair."""
    if isinstance(value, str):
        if not (surrogates or value.isascii()) and any("\ud800" <= c <= "\udfff" for c in value):
            raise ValueError("half a surrogate pair")
    elif isinstance(value, _NESTED):
        if depth == 0:
            raise ValueError(f"nested deeper than {MAX_DEPTH} levels")
        for inner in (*value, *value.values()) if isinstance(value, dict) else value:
            if isinstance(inner, _CHECKED):  # most are numbers
                _check(inner, depth - 1, surrogates)
