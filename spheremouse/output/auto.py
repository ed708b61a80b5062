"""`auto[:third=none|wheel]`: take the best mouse of this computer, and print to standard error which one, and why.

The order is uinput, a board, the desktop's pointer. Every program takes a uinput device for a mouse. A board is known
by its USB identity. A plain adapter is never taken, because any device may be behind it.
"""

import sys
from functools import partial

from spheremouse.errors import OutputError
from spheremouse.finding import Finding, Verdict, absent, ok, unchecked, warning
from spheremouse.output import Output, desktop, serial, uinput
from spheremouse.output.serial.ports import connected_ports, find_board
from spheremouse.output.third_axis import parse_third

check = partial(parse_third, "auto")


def open(argument: str) -> Output:
    """Open the first that works of uinput, serial and desktop. Raises OutputError with all reasons if none does."""
    check(argument)
    failures: list[str] = []
    for module in (uinput, serial, desktop):
        kind = module.__name__.rpartition(".")[2]
        try:
            whole = _board(argument) if module is serial else argument
            output = module.open(whole)
        except OutputError as e:
            failures.append(str(e))
            continue
        spec = f"{kind}:{whole}" if whole else kind
        sys.stderr.write(f"auto: takes {spec}" + (f" ({' | '.join(failures)})" if failures else "") + "\n")
        return output
    raise OutputError(f"auto: found no mouse. {' | '.join(failures)}")


def _board(option: str) -> str:
    """Return the argument for the board's port; by its USB serial number the board is found at any port."""
    ports = connected_ports()
    port = find_board(ports=ports, adapters=False)
    number = next((p.serial_number for p in ports if p.device == port), None)
    return ",".join(filter(None, (f"auto,id={number}" if number else port, option)))


def probe(argument: str) -> list[Finding]:
    check(argument)
    tried = [*uinput.probe(argument), *_probe_board(argument), *desktop.probe(argument)]
    taken = next((f for f in tried if f.verdict is Verdict.OK), None)
    if taken is None:
        none = absent("output", "auto finds none", "mend one of these; uinput is the usual one")
        return [none, *(warning(f.name, f.text, f.advice) for f in tried)]
    others = [f if f is taken else unchecked(f.name, f"not needed: {f.text}") for f in tried]
    return [ok("output", f"auto takes {taken.name}"), *others]


def _probe_board(option: str) -> list[Finding]:
    try:
        return serial.probe(_board(option))
    except OutputError:
        remedy = "for a game on another computer: docs/microcontroller.md"
        return [absent("serial board", "none of ours is plugged in", remedy)]
