"""`KIND:ARGUMENT`, as the command line names a source or an output; a kind is a module of a package.

Adding one is a new file with a function `open`, and its name in the package's `KINDS`. Only the module asked for is
imported.
"""

import importlib
from types import ModuleType

from spheremouse.errors import SpheremouseError
from spheremouse.files.validate import nearest


def resolve(package: ModuleType, what: str, spec: str, error: type[SpheremouseError]) -> tuple[ModuleType, str]:
    """Module and argument of `KIND:ARGUMENT`, a `what`; `error` lists the kinds where there is none of that name."""
    kind, _, argument = spec.partition(":")
    known = package.KINDS
    if kind not in known:
        raise error(f"unknown {what} {spec!r}; {nearest(kind, known)} ({what}s are {', '.join(known)})")
    return importlib.import_module(f"{package.__name__}.{kind}"), argument


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
