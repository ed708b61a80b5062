"""Tidy tables: results of jobs as rows, put together by what they have in common, and as Markdown."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.report.page import fixed, table


def tidy(records: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """A row a record; what is nested has columns `outer.inner`, what is not known is nan."""
    return pd.json_normalize(list(records)).replace({None: np.nan})  # pyright: ignore[reportArgumentType]


def rms(values: "pd.Series[float]") -> float:
    """Root mean square; nan where one is not known."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, float)))))


def markdown(frame: pd.DataFrame, digits: int | Mapping[str, int] = 2, sparse: Sequence[str] = ()) -> str:
    """A table as Markdown; text stays as it is, numbers have `digits`, one for all columns or by their names.

    Columns of `sparse` have a value only where it is another one than above.
    """

    def cells(name: str) -> list[str]:
        own = digits if isinstance(digits, int) else digits.get(name, 0)
        made = [x if isinstance(x, str) else fixed(x, own) for x in frame[name]]
        return [x if k == 0 or x != made[k - 1] else "" for k, x in enumerate(made)] if name in sparse else made

    names = [str(name) for name in frame.columns]
    return table(names, list(zip(*map(cells, names), strict=True)))


def by(frame: pd.DataFrame, keys: Sequence[str], **columns: tuple[str, str | Callable[..., Any]]) -> pd.DataFrame:
    """Rows of each group in the order in which groups first come, with the columns that `agg` is asked for."""
    return frame.groupby(list(keys), sort=False, dropna=False).agg(**columns).reset_index()
