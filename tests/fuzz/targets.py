"""What is fuzzed: a check for each target, and the strategy that makes its input; modules of targets add theirs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from spheremouse.errors import SpheremouseError

TARGETS: dict[str, Callable[[Any], None]] = {}
STRATEGIES: dict[str, Callable[[], st.SearchStrategy[Any]]] = {}
EVERY: dict[str, Callable[[], list[Any]]] = {}  # what is tried first, one after the other
Check = Callable[[Any], None]


def target(
    name: str, strategy: Callable[[], st.SearchStrategy[Any]], every: Callable[[], list[Any]] = list
) -> Callable[[Check], Check]:
    def add(function: Check) -> Check:
        TARGETS[name], STRATEGIES[name], EVERY[name] = function, strategy, every
        return function

    return add


def refused(action: Callable[[], Any]) -> Any:
    """What the action returns, or None where it is refused as a user may be: in lines that say something."""
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
