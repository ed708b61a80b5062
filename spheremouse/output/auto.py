"""`auto[:third=none|wheel]`: the best mouse there is here, and standard error says which, and why none before it.

uinput, which every program takes for a mouse, where the kernel lets us; else the board, known by its USB identity and
never a mere adapter, behind which anything may sit; else the pointer of the desktop.
"""

import sys
from collections.abc import Callable

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.output import Output, desktop, serial, uinput
from spheremouse.output.serial import ports as ports_module
from spheremouse.output.third_axis import NONE, checked


def open(argument: str) -> Output:
    """The first that can be opened."""
    third = check(argument)
    ways: list[Callable[[str], tuple[str, Output]]] = [_uinput, _board, _desktop]
    failures: list[str] = []
    for way in ways:
        try:
            spec, output = way(f"third={third}" if third != NONE else "")
        except OutputError as e:
            failures.append(str(e))
            continue
        print(f"auto: takes {spec}" + (f" ({' | '.join(failures)})" if failures else ""), file=sys.stderr)
        return output
    raise OutputError(f"auto: no mouse to be had. {' | '.join(failures)}")


def check(argument: str) -> str:
    """The way of the third axis; OutputError where the argument is of no use."""
    given = options(argument, {"third": str}, f"auto:{argument}", OutputError)
    return checked("auto", str(given.get("third", NONE)))


def _uinput(given: str) -> tuple[str, Output]:
    return _spec("uinput", given), uinput.open(given)


def _board(given: str) -> tuple[str, Output]:
    ports = ports_module.ports_here()
    port = ports_module.find_board(ports=ports, adapters=False)
    number = next((p.serial_number for p in ports if p.device == port), None)
    # By its number, so that it is found again at another port.
    where = f"auto,id={number}" if number else port
    whole = ",".join(filter(None, (where, given)))
    return f"serial:{whole}", serial.open(whole)


def _desktop(given: str) -> tuple[str, Output]:
    return _spec("desktop", given), desktop.open(given)


def _spec(kind: str, given: str) -> str:
    return f"{kind}:{given}" if given else kind
