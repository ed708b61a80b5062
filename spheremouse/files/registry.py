"""`KIND:ARGUMENT`, as the command line names a source or an output; a kind is a module of a package, or a plug-in.

Adding one is a new file with a function `open`, one `check` where slips in an argument can be told without opening
anything, and its name in the package's `KINDS`; or a module of another
distribution, named by an entry point in the group `spheremouse.source` or `spheremouse.output`. Only the module asked
for is imported.
"""

import importlib
from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType
from typing import Any

from spheremouse.errors import SpheremouseError
from spheremouse.files.validate import nearest

_REMEDY = "update it, or uninstall it"


def resolve(package: ModuleType, what: str, spec: str, error: type[SpheremouseError]) -> tuple[ModuleType, str]:
    """Module and argument of `KIND:ARGUMENT`, a `what`.

    Raises `error`, which lists the kinds where there is none of that name, and names a plug-in that is of no use.
    """
    kind, _, argument = spec.partition(":")
    if kind in package.KINDS:
        return importlib.import_module(f"{package.__name__}.{kind}"), argument
    plugged = {entry.name: entry for entry in entry_points(group=f"spheremouse.{what}")}
    if kind in plugged:
        return _loaded(plugged[kind], what, error), argument
    known = (*package.KINDS, *sorted(plugged))
    form = "" if ":" in spec else f"{what}s are written KIND:ARGUMENT; "
    raise error(f"unknown {what} {spec!r}; {form}{nearest(kind, known)}")


def check(package: ModuleType, what: str, spec: str, error: type[SpheremouseError]) -> None:
    """Raise as `resolve` does, and where the module has a function `check` that refuses the argument; opens nothing."""
    module, argument = resolve(package, what, spec, error)
    if callable(look := getattr(module, "check", None)):
        look(argument)


def opened(
    package: ModuleType, what: str, spec: str, error: type[SpheremouseError], members: Iterable[str], *more: Any
) -> Any:
    """What the module of `KIND:ARGUMENT` opens, given the argument and `more`.

    Raises `error` as `resolve` does, and where what a plug-in opened lacks some of the `members` of a `what`.
    """
    module, argument = resolve(package, what, spec, error)
    made, kind = module.open(argument, *more), spec.partition(":")[0]
    missing = [name for name in members if kind not in package.KINDS and not hasattr(made, name)]
    if missing:
        raise error(f"{what} {kind}: breaks the contract: has no {', '.join(missing)}; {_REMEDY}")
    return made


def _loaded(entry: EntryPoint, what: str, error: type[SpheremouseError]) -> ModuleType:
    whose = f"{what} {entry.name}: the plug-in {entry.value}"
    try:
        module = entry.load()
    except Exception as e:  # whatever a stranger's module does
        why = " ".join(f"{type(e).__name__}: {e}".split())[:200]
        raise error(f"{whose} cannot be loaded ({why}); {_REMEDY}") from None
    if not callable(getattr(module, "open", None)):
        raise error(f"{whose} breaks the contract: has no function `open`; {_REMEDY}")
    return module


def options(
    text: str, known: dict[str, type[int] | type[float] | type[str]], name: str, error: type[SpheremouseError]
) -> dict[str, int | float | str]:
    """`KEY=VALUE,KEY=VALUE` as values of the `known` types; `name` is what messages call the whole."""
    found: dict[str, int | float | str] = {}
    for item in filter(None, (part.strip() for part in text.split(","))):
        key, equals, value = (s.strip() for s in item.partition("="))
        if not equals:
            raise error(f"{name}: {item!r} is not KEY=VALUE; keys are {', '.join(known)}")
        if key not in known:
            raise error(f"{name}: unknown key {key}; {nearest(key, list(known))}")
        if key in found:
            raise error(f"{name}: {key} is given twice; leave one out")
        try:
            found[key] = known[key](value)
        except ValueError:
            kind = {int: "a whole number", float: "a number"}.get(known[key], "text")
            raise error(f"{name}: {key} must be {kind}, is {value!r}") from None
    return found
