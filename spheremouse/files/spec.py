"""`KIND:ARGUMENT`, as the command line names a source or an output; a kind is a module of a package, found by name.

Adding one is a new file: a module `spheremouse.<package>.<kind>` with a function `open`. Modules whose names begin
with an underscore are not kinds. Only the module asked for is imported.
"""

import importlib
import pkgutil
from types import ModuleType

from spheremouse.errors import SpheremouseError
from spheremouse.files.validate import nearest


def kinds(package: ModuleType) -> list[str]:
    """Names of the modules in a package that are kinds."""
    return sorted(m.name for m in pkgutil.iter_modules(package.__path__) if not m.name.startswith("_"))


def resolve(package: ModuleType, spec: str, error: type[SpheremouseError]) -> tuple[ModuleType, str]:
    """Module and argument of `KIND:ARGUMENT`; `error` lists the kinds where there is none of that name."""
    kind, _, argument = spec.partition(":")
    what = package.__name__.rpartition(".")[2]
    known = kinds(package)
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
