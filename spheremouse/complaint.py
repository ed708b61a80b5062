"""How the program says on standard error that something is wrong: one way for all commands."""

import sys


def complain(message: str) -> None:
    """Every line of a message, with the program's name before it."""
    for line in message.splitlines():
        print(f"spheremouse: {line}", file=sys.stderr)
