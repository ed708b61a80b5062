"""How a parameter is declared: one line with its default, unit, meaning and bounds, read by the configuration.

Settings are frozen dataclasses beside the code that uses them; `config` builds its schema from them, so that a
parameter is written down once.
"""

from dataclasses import field
from typing import Any


def param(
    default: Any,
    unit: str,
    meaning: str,
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """A dataclass field with its unit ("-" for none), its meaning with the reason for the default, and its bounds."""
    bounds = {k: v for k, v in {"gt": gt, "ge": ge, "lt": lt, "le": le}.items() if v is not None}
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "bounds": bounds})
