"""Style of figures: matplotlib with `light.mplstyle` and `dark.mplstyle`.

And the colours that figures name: a page in HTML has a variable for each, lighter where the screen is dark.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

INK, MUTED, GRID, PAPER = "#2b2b2b", "#8a8a8a", "#e6e6e6", "#fefefd"
RED, GREEN, BLUE, GOLD = "#c8553d", "#3a7d5d", "#2f6690", "#b8860b"  # apart in grey and for most colour-blind eyes


@contextmanager
def styled(*over: str | Mapping[str, Any]) -> Iterator[None]:
    """The light style for figures that are made and saved in this block, with others ("dark") or rcParams over it.

    Nothing of a user's matplotlibrc.
    """
    from matplotlib import style

    sheets = [f"{__package__}.{s}" if isinstance(s, str) else s for s in ("light", *over)]
    with style.context(["default", *sheets]):  # type: ignore[list-item]
        yield


def round_number(most: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten up to `most`, for the magnification of a figure."""
    power = 10.0 ** math.floor(math.log10(most))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= most * (1.0 + 1e-9))
