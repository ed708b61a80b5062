"""What to try for a number of which the type and the bounds are known: at its bounds, beside them, and anywhere."""

import dataclasses
import math
import typing
from collections.abc import Iterator
from typing import Any, Literal

from spheremouse.files import config

USUAL = (0.0, -1.0, -1e12, 1e-300, 1e-12, 1e-6, 1e-3, 1.0, 2.0, 3.0, 30.0, 1e3, 1001.0, 1e6, 1e9, 1e12, 1e300)
LENGTHS = (0, 1, 2, 3, 8, 100)  # of lists


def numbers(cls: type, prefix: str = "") -> Iterator[tuple[str, Any, dict[str, float], Any]]:
    """Key, type, bounds and default of every parameter of (nested) settings."""
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        if dataclasses.is_dataclass(hint):
            yield from numbers(typing.cast(type, hint), f"{prefix}{field.name}.")
        else:
            made = field.default_factory
            default = field.default if made is dataclasses.MISSING else made()
            yield f"{prefix}{field.name}", hint, field.metadata.get("bounds", {}), default


def extremes(hint: Any, bounds: dict[str, float], default: Any) -> list[str]:
    """Values of a parameter, as YAML; text has none."""
    return list(dict.fromkeys(_extremes(hint, bounds, default)))


def _extremes(hint: Any, bounds: dict[str, float], default: Any) -> Iterator[str]:
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        yield from (config.to_yaml(choice) for choice in inner)
    elif hint is bool:
        yield from ("true", "false")
    elif hint is type(None):
        yield "null"
    elif hint in (int, float):
        at = list(bounds.values())
        beside = [b + 1 for b in at] + [b - 1 for b in at]
        if hint is float:
            beside = [math.nextafter(b, way) for b in at for way in (-math.inf, math.inf)]
        some = [0.5 * default, 2.0 * default] if isinstance(default, int | float) else []
        values = (*at, *beside, *some, *USUAL)
        yield from (str(int(v)) if hint is int else repr(float(v)) for v in values)
    elif origin is tuple and inner[-1] is ...:
        items = extremes(inner[0], bounds, None)
        for n in LENGTHS:
            yield from (f"[{', '.join([item] * n)}]" for item in items[:3])  # the bounds, and beside one
        for some in (default[:-1], default[1:], default[::-1], default[:2] * 2) if default else ():
            yield config.to_yaml(some)
    elif origin is tuple:
        items = extremes(inner[0], bounds, None)
        yield from (f"[{', '.join([item] * len(inner))}]" for item in items)
        ends = [repr(int(b) if inner[0] is int else float(b)) for b in bounds.values()]
        if len(ends) == 2:
            halves = [ends[k % 2] if k < len(inner) // 2 else ends[1 - k % 2] for k in range(len(inner))]
            yield from (f"[{', '.join(some)}]" for some in (ends * (len(inner) // 2), ends[::-1] * (len(inner) // 2)))
            yield f"[{', '.join(sorted(halves, key=ends.index))}]"
    else:
        for one in inner:
            yield from extremes(one, bounds, default)
