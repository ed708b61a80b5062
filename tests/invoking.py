"""A command as a user runs it, with our errors as their text."""

from typer.testing import CliRunner

from spheremouse.errors import SpheremouseError


def invoke(app, *words):
    """Return exit code and output of a command of a typer application. Raises what no user should see."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    if isinstance(result.exception, SpheremouseError):
        return 2, str(result.exception)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output
