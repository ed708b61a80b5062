"""The command line: `spheremouse COMMAND`. Errors are one line on standard error and exit code 2, never a traceback."""

import os
import signal
import sys
from collections import UserDict
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from threadpoolctl import threadpool_limits
from typer.core import TyperGroup

from spheremouse import __version__
from spheremouse.commands import terminal
from spheremouse.errors import SpheremouseError

_USERS_ERROR, _OUR_ERROR = 2, 70  # exit codes; 70 is EX_SOFTWARE of sysexits.h
_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
_COMMANDS = {  # the last line of their help, by their names, which are those of their modules
    "run": "Example: spheremouse run --source dataset:demo/roll --output text:-",
    "track": "Example: spheremouse track demo/roll --smooth --output text:roll.jsonl",
    "ball": "Example: spheremouse ball film.mkv --vfov 45 --out mouse",
    "import-fictrac": "Example: spheremouse import-fictrac config.txt --out mouse",
    "export": "Example: spheremouse export demo/roll roll.mcap",
    "demo": "Example: spheremouse demo --seconds 20 --seed 2",
    "simulate": "Example: spheremouse simulate demo/roll --motion roll --turns 1 --noise 3",
    "evaluate": "Example: spheremouse evaluate demo/roll --tracker so3 --json figures.json",
    "tune": "Example: spheremouse tune demo/roll --budget 5min --output tuned.yaml",
    "match": "Example: spheremouse match recording trackball.csv --out trackball.yaml",
    "log-mouse": "Example: spheremouse log-mouse --device Logitech --out trackball.csv",
    "bench": "Example: spheremouse bench --steps 100000 --json speed.json",
    "layout": "Example: spheremouse layout --discs 26 --out calibration/placement-26",
    "preview": "Example: spheremouse preview v4l2:/dev/video0 --every 1",
    "doctor": "Example: spheremouse doctor --source dataset:demo/roll",
    "tray": "Example: spheremouse tray",
    "view": "Example: spheremouse view --port 8765",
    "ctl": "Exit codes: 0 done, 1 the daemon refuses, 2 wrong usage, 3 no daemon.",
    "service": "Example: sudo spheremouse service install",
    "wand": "Example: spheremouse wand simulate demo/drive --seed 1",
    "config": "Example: spheremouse config init spheremouse.yaml",
    "axes": "Example: spheremouse axes --config cabinet/config.yaml",
    "calibrate": "Begin with: spheremouse calibrate next",
    "firmware": "Example: spheremouse firmware check",
    "map": "Example: spheremouse map show rig.map.yaml",
}


class _Commands(UserDict[str, Any]):
    """The commands by their names. Each module is loaded at the first use of its command."""

    def __getitem__(self, name: str) -> Any:
        if isinstance(self.data[name], str):
            self.data[name] = _load_command(name, self.data[name])
        return self.data[name]


class _Group(TyperGroup):
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = _Commands(_COMMANDS)


def _load_command(name: str, epilog: str) -> Any:
    """Return a command, the function of its module's name, or the group of commands that is the module's `app`."""
    function = name.replace("-", "_")
    module, one = import_module(f"spheremouse.commands.{function}"), _new_typer()
    if hasattr(module, "app"):
        one.add_typer(module.app, name=name, epilog=epilog)
        return typer.main.get_group(one).commands[name]
    one.command(name, epilog=epilog)(getattr(module, function))
    return typer.main.get_command(one)


def _new_typer(completion: bool = False, **options: Any) -> typer.Typer:
    return typer.Typer(
        no_args_is_help=True,
        add_completion=completion,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings=_SETTINGS,
        **options,
    )


app = _new_typer(completion=True, cls=_Group)

_debug = False


def _version(requested: bool) -> None:
    if requested:
        print(f"spheremouse {__version__}")
        raise typer.Exit


@app.callback(epilog="Begin with: spheremouse demo")
def spheremouse(
    version: Annotated[
        bool, typer.Option("-V", "--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an internal error.")] = False,
) -> None:
    """Watch a ball with a camera, measure how it turns, and be the mouse."""
    global _debug  # noqa: PLW0603  `main` reads it after the command
    _debug = debug


def main() -> NoReturn:
    """Run a command, and turn an exception into a message and an exit code. This is the entry point."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # our own errors name the problems of a file
    # There are none, and pydantic would read the metadata of each installed package to find them
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    for number in (signal.SIGTERM, signal.SIGHUP) if hasattr(signal, "SIGHUP") else (signal.SIGTERM,):
        signal.signal(number, lambda n, _: sys.exit(128 + n))  # unwinds, so no file is left half written
    try:
        with threadpool_limits(1):  # our matrices are small: threads of the linear algebra only wait for each other
            app(prog_name="spheremouse")
    except SpheremouseError as e:
        terminal.error(str(e))
        sys.exit(_USERS_ERROR)
    except KeyboardInterrupt:
        terminal.error("interrupted")
        sys.exit(128 + signal.SIGINT)
    except BrokenPipeError:  # the reader of our output has gone
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115  until the end
        sys.exit(1)
    except Exception as e:
        if _debug:
            raise
        what = " ".join(f"{type(e).__name__}: {e}".split())
        terminal.error(f"internal error, please report it with the output of `spheremouse --debug ...`: {what}")
        sys.exit(_OUR_ERROR)
    sys.exit(0)
