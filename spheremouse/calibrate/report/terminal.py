"""Tables and advice of the calibrations on a terminal."""

from collections.abc import Collection, Iterable, Sequence

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

_MARKS = {"good": ("✓", "green"), "note": ("i", "blue"), "warning": ("!", "yellow")}


def print_table(
    console: Console,
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    words: Collection[int] = (0,),
    faulty: Collection[int] = (),
) -> None:
    """Print a table. The columns `words` have text, the others numbers. The `faulty` rows are red."""
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for i, name in enumerate(head):
        table.add_column(name, justify="left" if i in words else "right")
    for i, row in enumerate(rows):
        table.add_row(*map(Text, row), style="red" if i in faulty else None)
    console.print(Padding(table, (0, 0, 1, 0), expand=False))


def print_advice(console: Console, advice: Iterable[tuple[str, str]]) -> None:
    """Print a list of ("good" | "note" | "warning", text)."""
    for kind, text in advice:
        mark, colour = _MARKS[kind]
        line = Table.grid(padding=(0, 1, 0, 0))
        line.add_row(Text(mark, style=colour), Text(text.replace("`", "")))
        console.print(line)
