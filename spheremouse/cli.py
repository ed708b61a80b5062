"""The command line: `spheremouse COMMAND`. Errors are one line on standard error and exit code 2, never a traceback."""

import os
import signal
import sys
from typing import Annotated, NoReturn

import typer
from threadpoolctl import threadpool_limits

from spheremouse import (
    __version__,
    cli_bench,
    cli_config,
    cli_ctl,
    cli_doctor,
    cli_experiments,
    cli_firmware,
    cli_layout,
    cli_map,
    cli_run,
    cli_service,
    cli_simulate,
    cli_tray,
    cli_wand,
    demo,
)
from spheremouse.calibrate import cli as cli_calibrate
from spheremouse.cli_evaluate import evaluate
from spheremouse.errors import SpheremouseError

_USERS_ERROR, _OUR_ERROR = 2, 70  # exit codes; 70 is EX_SOFTWARE of sysexits.h
_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=_SETTINGS,
)
app.command(epilog=cli_run.EXAMPLE)(cli_run.run)
app.command(epilog=demo.EXAMPLE)(demo.demo)
app.command(epilog=cli_simulate.EXAMPLE)(cli_simulate.simulate)
app.command(epilog="Example: spheremouse evaluate demo/roll --tracker so3 --json figures.json")(evaluate)
app.command(epilog=cli_bench.EXAMPLE)(cli_bench.bench)
app.command(epilog=cli_layout.EXAMPLE)(cli_layout.layout)
app.command(epilog=cli_doctor.EXAMPLE)(cli_doctor.doctor)
app.add_typer(cli_ctl.app, name="ctl", epilog=cli_ctl.EPILOG)
app.command(epilog=cli_tray.EXAMPLE)(cli_tray.tray)
app.add_typer(cli_service.app, name="service", epilog="Example: sudo spheremouse service install")
app.add_typer(cli_wand.app, name="wand", epilog="Example: spheremouse wand simulate demo/drive --seed 1")
app.add_typer(cli_experiments.app, name="experiments", epilog="Example: spheremouse experiments wand --quick --out out")
app.add_typer(cli_config.app, name="config", epilog="Example: spheremouse config init spheremouse.yaml")
app.add_typer(cli_calibrate.app, name="calibrate", epilog="Begin with: spheremouse calibrate next")
app.add_typer(cli_firmware.app, name="firmware", epilog="Example: spheremouse firmware check")
app.add_typer(cli_map.app, name="map", epilog="Example: spheremouse map show rig.map.yaml")

_debug = False


def _version(asked: bool) -> None:
    if asked:
        print(f"spheremouse {__version__}")
        raise typer.Exit


@app.callback(epilog="Begin with: spheremouse demo")
def spheremouse(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an internal error.")] = False,
) -> None:
    """Watch a ball with a camera, measure how it turns, and be the mouse."""
    global _debug  # noqa: PLW0603  read by `main` when everything else has been unwound
    _debug = debug


def main() -> NoReturn:
    """The entry point: runs a command and turns what it raises into a message and an exit code."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # what FFmpeg has to say of a file, our own errors say
    for number in (signal.SIGTERM, signal.SIGHUP) if hasattr(signal, "SIGHUP") else (signal.SIGTERM,):
        signal.signal(number, lambda n, _: sys.exit(128 + n))  # unwinds, so that nothing is left half
    try:
        with threadpool_limits(1):  # our matrices are small: threads of the linear algebra only wait for each other
            app(prog_name="spheremouse")
    except SpheremouseError as e:
        _complain(str(e))
        sys.exit(_USERS_ERROR)
    except KeyboardInterrupt:
        _complain("interrupted")
        sys.exit(128 + signal.SIGINT)
    except BrokenPipeError:  # whoever read us has gone
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115  until the end
        sys.exit(1)
    except Exception as e:
        if _debug:
            raise
        what = " ".join(f"{type(e).__name__}: {e}".split())
        _complain(f"internal error, please report it with what `spheremouse --debug ...` prints: {what}")
        sys.exit(_OUR_ERROR)
    sys.exit(0)


def _complain(message: str) -> None:
    for line in message.splitlines():
        print(f"spheremouse: {line}", file=sys.stderr)
