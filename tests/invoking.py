"""A command as a user runs it, with our errors as their text; and the error of a call."""

import pytest
from typer.testing import CliRunner

from spheremouse.errors import SpheremouseError


def invoke(app, *words):
    """Return exit code and output of a command of a typer application. Raises what no user should see."""
    try:
        result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    except SpheremouseError as e:
        return 2, str(e)
    return result.exit_code, result.output


def succeed(app, *words):
    """Return the output of a command that must succeed."""
    code, output = invoke(app, *words)
    assert code == 0, output
    return output


def fail(app, *words):
    """Return the line of a command that must be refused."""
    code, output = invoke(app, *words)
    assert (code, len(output.splitlines())) == (2, 1), output
    return output


def refusal(kind, call, *arguments, **options):
    """Return the message of the error that a call must raise, which is one line."""
    with pytest.raises(kind) as e:
        call(*arguments, **options)
    assert "\n" not in str(e.value)
    return str(e.value)
