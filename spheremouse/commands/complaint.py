"""How the program says on standard error that something is wrong: one way for all commands."""

import sys

from spheremouse.session.process.standard_error import unhurried


def complain(message: str) -> None:
    """Every line of a message, with the program's name before it; who does not listen keeps nobody."""
    with unhurried():
        for line in message.splitlines():
            print(f"spheremouse: {line}", file=sys.stderr)
