"""How far a long command is, on a terminal: one bar for all commands; into a file or a pipe it is silent."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


def progress_bar(auto_refresh: bool = True) -> Progress:
    """On stderr, gone when it is done; without `auto_refresh` it is drawn only when asked to."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    return Progress(
        *columns, console=console, transient=True, auto_refresh=auto_refresh, disable=not console.is_terminal
    )
