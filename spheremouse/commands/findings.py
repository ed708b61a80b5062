"""The report for people, with words beside every colour, and for programs."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from spheremouse import __version__
from spheremouse.errors import format_count, printable
from spheremouse.finding import Finding, Verdict

FORMAT = 1  # of the data
_STYLES = {
    Verdict.OK: ("✓", "+", "green"),
    Verdict.WARNING: ("▲", "!", "bold yellow"),
    Verdict.WRONG: ("✗", "X", "bold red"),
    Verdict.UNCHECKED: ("·", "-", "dim"),
}
_NAME_COLUMNS = 16  # columns of the longest name of a check


@dataclass(frozen=True, slots=True)
class Section:
    """The findings of one subject."""

    subject: str
    findings: tuple[Finding, ...]


def show(section: Section, console: Console) -> None:
    """Print a section: a line for each finding, and its remedy below it."""
    console.print(Text(section.subject, style="bold"))
    table = Table.grid(padding=(0, 1))
    table.add_column(width=max(map(len, Verdict)) + 2, no_wrap=True)
    table.add_column(width=_NAME_COLUMNS, no_wrap=True)
    table.add_column(ratio=1, overflow="fold")
    for finding in section.findings:
        sign, plain, style = _STYLES[finding.verdict]
        mark = Text(f"{sign if _draws(console) else plain} {finding.verdict}", style=style)
        table.add_row(mark, finding.name, _words(finding, console))
    console.print(Padding(table, (0, 0, 0, 2)))


def summary(sections: Sequence[Section]) -> Text:
    """Return one line with the numbers of wrong findings and warnings; others, such as unchecked ones, do not count."""
    verdicts = [f.verdict for s in sections for f in s.findings]
    wrong, warnings = verdicts.count(Verdict.WRONG), verdicts.count(Verdict.WARNING)
    if wrong:
        words = f"{wrong} wrong, {format_count(warnings, 'warning')}: mend the faults first, from the top"
        return Text(words, style="bold red")
    if warnings:
        return Text(f"nothing wrong, {format_count(warnings, 'warning')}", style="bold yellow")
    return Text("all is well", style="bold green")


def data(sections: Sequence[Section]) -> dict[str, Any]:
    """Return the report as JSON data."""
    verdicts = [f.verdict for s in sections for f in s.findings]
    return {
        "format": FORMAT,
        "version": __version__,
        "wrong": verdicts.count(Verdict.WRONG),
        "warnings": verdicts.count(Verdict.WARNING),
        "checks": [
            {
                "subject": section.subject,
                "name": f.name,
                "verdict": str(f.verdict),
                "text": f.text,
                "advice": f.advice,
                "values": {k: None if isinstance(v, float) and not isfinite(v) else v for k, v in f.values.items()},
            }
            for section in sections
            for f in section.findings
        ],
    }


def _words(finding: Finding, console: Console) -> Text:
    dim = finding.verdict in (Verdict.OK, Verdict.UNCHECKED)
    words = Text(printable(finding.text), style="" if not dim or finding.verdict is Verdict.OK else "dim")
    if finding.advice:
        arrow = "→" if _draws(console) else "->"
        words.append(f"\n{arrow} {printable(finding.advice)}", style="dim" if dim else "bold")
    return words


def _draws(console: Console) -> bool:
    """Return whether the terminal shows more than ASCII."""
    return (console.encoding or "").lower().replace("-", "").startswith("utf")
