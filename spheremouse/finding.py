"""The result of a check: a verdict, a line with the measurement, and the remedy."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from spheremouse.errors import SpheremouseError


class Verdict(StrEnum):
    """Outcomes of a check."""

    OK = "ok"
    WARNING = "warning"  # it works, and less well than it could
    WRONG = "wrong"  # it does not work
    UNCHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check."""

    name: str  # of the check, the same in every report
    verdict: Verdict
    text: str
    advice: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)  # for programs; units in the keys
    passing: bool = False  # may change without a change of the configuration: a device is not plugged in


def ok(name: str, text: str, advice: str = "", **values: Any) -> Finding:
    """Return a finding that needs no action."""
    return Finding(name, Verdict.OK, text, advice, values)


def warning(name: str, text: str, advice: str, **values: Any) -> Finding:
    """Return a finding about a part that works less well than it could."""
    return Finding(name, Verdict.WARNING, text, advice, values)


def wrong(name: str, text: str, advice: str = "", **values: Any) -> Finding:
    """Return a finding about a part that does not work."""
    return Finding(name, Verdict.WRONG, text, advice, values)


def absent(name: str, text: str, advice: str) -> Finding:
    """Return a finding about a device that is not there now, or that this account may not use."""
    return Finding(name, Verdict.WRONG, text, advice, passing=True)


def unchecked(name: str, text: str, advice: str = "", **values: Any) -> Finding:
    """Return a finding about a part that cannot be checked."""
    return Finding(name, Verdict.UNCHECKED, text, advice, values)


def classify(name: str, text: str, *cases: tuple[bool, Verdict, str, str], **values: Any) -> Finding:
    """Return the finding of the first case that holds, else one that needs no action.

    A case is a condition, its verdict, the words that it adds to the text, and the remedy.
    """
    for holds, verdict, words, advice in cases:
        if holds:
            return Finding(name, verdict, text + words, advice, values)
    return ok(name, text, **values)


def refused(name: str, error: Exception, **values: Any) -> Finding:
    """Return a finding from an error with a hint, or from a message `problem; remedy`."""
    if isinstance(error, SpheremouseError) and error.hint:
        return wrong(name, error.problem, error.hint, **values)
    text, _, advice = " ".join(str(error).split()).partition("; ")
    return wrong(name, text, advice, **values)


def refusals(name: str, error: Exception) -> list[Finding]:
    """Return a finding for each line of an error, which may list several problems of a file."""
    return [refused(name, type(error)(line)) for line in str(error).splitlines() if line.strip()]
