"""Print errors, tables and progress in the same way for all commands."""

import sys
from typing import TYPE_CHECKING

from spheremouse.errors import printable
from spheremouse.session.process.standard_error import nonblocking_stderr

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


def error(message: str) -> None:
    """Print each line of a message on standard error after the program's name, without waiting for a reader."""
    with nonblocking_stderr():
        for line in message.splitlines():
            print(f"spheremouse: {printable(line)}", file=sys.stderr)


def table_console(*, stderr: bool = False, markup: bool = True) -> "Console":
    """Return a console as wide as the terminal. In a file or pipe, tables have their full width."""
    from rich.console import Console

    console = Console(stderr=stderr, soft_wrap=True, highlight=False, markup=markup)
    if not console.is_terminal:
        console.width = 1000
    return console


def progress_bar(auto_refresh: bool = True) -> "Progress":
    """Return a progress bar that is shown on terminals alone, and disappears at the end."""
    # imported here, since every command imports this file and few show a bar
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    return Progress(
        *columns, console=console, transient=True, auto_refresh=auto_refresh, disable=not console.is_terminal
    )
