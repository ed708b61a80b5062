"""The targets of the fuzzer: a check for each, and the strategy that makes its input. Other modules add them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from spheremouse.errors import SpheremouseError

TARGETS: dict[str, Callable[[Any], None]] = {}
STRATEGIES: dict[str, Callable[[], st.SearchStrategy[Any]]] = {}
EVERY: dict[str, Callable[[], list[Any]]] = {}  # examples that are tried first
Check = Callable[[Any], None]


def target(
    name: str, strategy: Callable[[], st.SearchStrategy[Any]], every: Callable[[], list[Any]] = list
) -> Callable[[Check], Check]:
    def add(function: Check) -> Check:
        TARGETS[name], STRATEGIES[name], EVERY[name] = function, strategy, every
        return function

    return add


def refused(action: Callable[[], Any]) -> Any:
    """Return the result of the action; None if it is refused by an error with a message."""
    try:
        return action()
    except SpheremouseError as e:
        message = str(e)
    assert message.strip(), "an empty message"
    return None


def file(content: str | bytes, name: str = "file.yaml") -> Path:
    path = Path(name)
    path.write_bytes(content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content)
    return path
