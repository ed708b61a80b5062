"""`text:-` and `text:FILE[,format=json|counts|reports|fictrac]`: write reports as lines.

Lines to a stream are flushed one by one, and those to a regular file twice a second. The output appends to FILE, so a
second run or a full disk costs no line. Each opening writes the header line of the format again, if it has one. A file
with other contents is refused. `reports` writes the counts that a mouse would get, also those between two frames.
"""

import contextlib
import os
import sys
from pathlib import Path
from typing import BinaryIO

from spheremouse.files.safe_files import is_stream, open_to_append
from spheremouse.finding import Finding, ok
from spheremouse.output import OutputClosed, Report, log_file
from spheremouse.output.lines import LineFormat, parse_address


class Text(log_file.BatchOutput):
    """Writes reports as lines."""

    hang_hint = "its reader does not read"

    def __init__(self, file: BinaryIO, name: str, form: LineFormat, *, at_once: bool) -> None:
        super().__init__(at_once=at_once or form.paced)
        self._file, self._name, self._form, self._reader_gone = file, name, form, False
        self.paced = form.paced
        if form.header:
            with contextlib.suppress(OutputClosed):  # the first `send` raises it, inside the `with` block
                self._write(form.header)

    def write(self, reports: list[Report]) -> None:
        self._write(b"".join(line for report in reports for line in self._form.lines(report)))

    def _write(self, lines: bytes) -> None:
        """Write lines. Raise OutputClosed if the reader is gone; discard unwritten text after an error."""
        if self._reader_gone:
            raise OutputClosed(self._name)
        try:
            self._file.write(lines)
            self._file.flush()
        except BrokenPipeError:
            self._reader_gone = True
            self._drop_unwritten()
            raise OutputClosed(self._name) from None
        except OSError as e:
            self._drop_unwritten()
            raise log_file.write_error(self._name, e) from None

    def _drop_unwritten(self) -> None:
        """Send the rest of the buffer to the null device; otherwise Python's flush at its exit prints an error."""
        with contextlib.suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._file.fileno())
            os.close(null)

    def close(self) -> None:
        try:
            self.write_kept()
        finally:
            if self._file is not sys.stdout.buffer:
                self._file.close()


def open(argument: str) -> Text:
    name, form = parse_address("text", argument)
    if name in ("", "-"):
        return Text(sys.stdout.buffer, "standard output", form, at_once=True)
    path = Path(name)
    try:
        log_file.refuse_other_files(path, form.start)
        file = open_to_append(path)
        log_file.drop_unfinished_line(path, file.fileno())
        return Text(file, str(path), form, at_once=is_stream(path))
    except (OSError, ValueError) as e:
        raise log_file.write_error(path, e) from None


def check(argument: str) -> None:
    name, form = parse_address("text", argument)
    if name not in ("", "-"):
        log_file.refuse_other_files(Path(name), form.start)


def file_of(argument: str) -> Path | None:
    """Return the file that an argument names; None for standard output."""
    name, _ = parse_address("text", argument)
    return None if name in ("", "-") else Path(name)


def probe(argument: str) -> list[Finding]:
    path = file_of(argument)
    if path is None:
        return [ok("output", "text to standard output")]
    return log_file.probe_file(path, "text")
