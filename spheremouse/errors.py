"""Errors that the user can mend: a line with problem and remedy, which the command line prints without a traceback."""

import contextlib
import traceback
import unicodedata
from collections.abc import Callable, Iterator


def printable(thing: object) -> str:
    """Return the text of a thing without control characters, which could steer the terminal."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(thing))


def has_control_characters(text: str) -> bool:
    """Return whether a text has a control character or a line separator, which a terminal would obey."""
    return not text.isprintable() and any(unicodedata.category(c) in ("Cc", "Zl", "Zp") for c in text)


def one_line(text: str) -> str:
    """Any text as one short line."""
    return " ".join(text.split())[:120]


def format_count(n: int, noun: str) -> str:
    """Return a number with its noun, as in `1 frame` or `2 frames`."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def reason_of(error: Exception) -> str:
    """Return the message of an error in one line, or the name of its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def internal_error_text() -> str:
    """Return the log lines for the exception in progress, a fault of this program."""
    return "internal error, please report it:\n" + traceback.format_exc().rstrip()


class SpheremouseError(Exception):
    """Base of all errors that are the user's to mend. The message is `problem; hint`, or the problem alone."""

    def __init__(self, problem: str = "", hint: str = "") -> None:
        """Take the problem with its place, as in `uinput: /dev/uinput does not exist`, and the remedy."""
        super().__init__(f"{problem}; {hint}" if hint else problem)
        self.problem, self.hint = problem, hint


class ConfigurationError(SpheremouseError):
    """A configuration, rig or camera file that cannot be used."""


class DatasetError(SpheremouseError):
    """A recording that cannot be read."""


class SourceError(SpheremouseError):
    """A source gives no frames."""


class DamagedFrameError(SourceError):
    """One frame that is no whole picture; the next may be."""


class TransferError(SourceError):
    """A camera answers with errors of its bus. `reset` resets it and returns a line for the log."""

    def __init__(self, problem: str, reset: Callable[[], str]) -> None:
        super().__init__(problem)
        self.reset = reset


class OutputError(SpheremouseError):
    """Motion cannot be sent."""


class PoseError(SpheremouseError):
    """The camera's pose cannot be found."""


class CalibrationError(SpheremouseError):
    """Photos, measures or a recording from which nothing can be calibrated."""


class ControlError(SpheremouseError):
    """The running daemon cannot be asked, or refuses."""


class ServiceError(SpheremouseError):
    """The service cannot be installed, started or removed."""


@contextlib.contextmanager
def os_errors_as(kind: type[SpheremouseError], problem: str, hint: str = "") -> Iterator[None]:
    """Raise an OSError of this block as an error of a kind: `problem: reason; hint`."""
    try:
        yield
    except OSError as e:
        raise kind(f"{problem}: {e.strerror or e}", hint) from None
