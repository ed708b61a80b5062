"""Output files of the calibration commands, and their notes and advice on a terminal."""

import hashlib
import os
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from spheremouse.errors import CalibrationError, os_errors_as
from spheremouse.files.safe_files import open_to_read

if TYPE_CHECKING:
    from rich.console import Console

_MARKS = {"good": ("✓", "green"), "note": ("i", "blue"), "warning": ("!", "yellow")}


def check_outputs(outputs: Sequence[Path | None], inputs: Iterable[Path | None], *, force: bool) -> None:
    """Refuse outputs that cannot be written, or that exist; `-` and None are no files.

    An output never replaces an input, a file in a folder of the inputs, or another output, even with `force`.
    """
    paths = [p for p in outputs if p is not None and p != Path("-")]
    given = [path for path in inputs if path is not None]
    used = {path.resolve() for path in given}
    for path in filter(os.path.isdir, given):  # of a name that is too long, Path.is_dir raises OSError
        with os_errors_as(CalibrationError, f"{path}: cannot be read"):
            used |= {p.resolve() for p in path.iterdir()}
    for i, path in enumerate(paths):
        if path.is_dir():
            raise CalibrationError(f"{path}: is a folder; name a file")
        if not path.parent.is_dir():
            raise CalibrationError(f"{path}: there is no folder {path.parent}; make it, or name another file")
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise CalibrationError(f"{path}: the folder {path.parent} may not be written; name a file elsewhere")
        if path.resolve() in used:
            raise CalibrationError(f"{path}: is read or written by this very command; name another file to write")
        if path.resolve() in [p.resolve() for p in paths[:i]]:
            raise CalibrationError(f"{path}: would be written twice; give each output a name of its own")
    if not force and (existing := [str(p) for p in paths if p.exists()]):
        raise CalibrationError(f"{', '.join(existing)}: there already; name another file, or replace it with --force")


def note(text: str) -> None:
    """Print a note on standard error."""
    print(f"note: {text}", file=sys.stderr)


def sha256(path: Path) -> str:
    """Return the hash of a file, for provenance; CalibrationError if it cannot be read."""
    with os_errors_as(CalibrationError, f"{path}: cannot be read"), open_to_read(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def option_words(options: Mapping[str, str | Path | None]) -> list[str | Path]:
    """Return options of a command as words, without those that are None."""
    return [word for name, value in options.items() if value is not None for word in (name, value)]


def copyable(*words: str | Path) -> str:
    """Quote a command for a shell."""
    return shlex.join([str(w) for w in words])


def print_advice(console: "Console", advice: Iterable[tuple[str, str]]) -> None:
    """Print a list of ("good" | "note" | "warning", text)."""
    from rich.table import Table
    from rich.text import Text

    for kind, text in advice:
        mark, colour = _MARKS[kind]
        line = Table.grid(padding=(0, 1, 0, 0))
        line.add_row(Text(mark, style=colour), Text(text.replace("`", "")))
        console.print(line)
