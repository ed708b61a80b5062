"""A command as a user runs it, with our errors as their text."""

from typer.testing import CliRunner

from spheremouse.errors import SpheremouseError


def invoke(app, *words):
    """Return exit code and output of a command of a typer application. Raises what no user should see."""
    try:
        result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    except SpheremouseError as e:
        return 2, str(e)
    return result.exit_code, result.output
