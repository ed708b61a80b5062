"""What a check has found: one line that says how it is, and one that says what to do."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


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
    advice: str = ""  # what to do
    values: Mapping[str, Any] = field(default_factory=dict)  # the numbers, for programs; their units in the keys


@dataclass(frozen=True, slots=True)
class Section:
    """The findings of one subject."""

    subject: str
    findings: tuple[Finding, ...]


def ok(name: str, text: str, advice: str = "", **values: Any) -> Finding:
    """Nothing to do."""
    return Finding(name, Verdict.OK, text, advice, values)


def warning(name: str, text: str, advice: str, **values: Any) -> Finding:
    """Better mended."""
    return Finding(name, Verdict.WARNING, text, advice, values)


def wrong(name: str, text: str, advice: str = "", **values: Any) -> Finding:
    """To be mended."""
    return Finding(name, Verdict.WRONG, text, advice, values)


def unchecked(name: str, text: str, advice: str = "", **values: Any) -> Finding:
    """Cannot be told."""
    return Finding(name, Verdict.UNCHECKED, text, advice, values)


def refused(name: str, error: Exception, **values: Any) -> Finding:
    """An error of ours, which says after its semicolon what to do."""
    text, _, advice = " ".join(str(error).split()).partition("; ")
    return Finding(name, Verdict.WRONG, text, advice, values)


def refusals(name: str, error: Exception) -> list[Finding]:
    """A line to each of the problems that an error of ours lists, as that of a file does."""
    return [refused(name, type(error)(line)) for line in str(error).splitlines() if line.strip()]
