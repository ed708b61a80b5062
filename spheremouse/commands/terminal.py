"""What all commands say on standard error in one way: that something is wrong, and how far they are."""

import sys
from typing import TYPE_CHECKING

from spheremouse.errors import printable
from spheremouse.session.process.standard_error import unhurried

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


def error(message: str) -> None:
    """Every line of a message, with the program's name before it; who does not listen keeps nobody."""
    with unhurried():
        for line in message.splitlines():
            print(f"spheremouse: {printable(line)}", file=sys.stderr)


def table_console(*, stderr: bool = False, markup: bool = True) -> "Console":
    """As wide as the terminal; into a file or a pipe, as wide as it takes."""
    from rich.console import Console

    console = Console(stderr=stderr, soft_wrap=True, highlight=False, markup=markup)
    if not console.is_terminal:
        console.width = 1000
    return console


def progress_bar(auto_refresh: bool = True) -> "Progress":
    """One bar, on a terminal alone, gone when it is done; without `auto_refresh` it is drawn only when asked to."""
    # every command imports this file, few show a bar
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    return Progress(
        *columns, console=console, transient=True, auto_refresh=auto_refresh, disable=not console.is_terminal
    )
