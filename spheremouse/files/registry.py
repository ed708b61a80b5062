"""Open a source or an output that is named as `KIND:ARGUMENT`; a kind is a module of a package, or a plug-in.

The module has a function `open`. Its `check` may report mistakes in the argument without opening anything, and its
`probe` may return findings about the device. Modules of a package are in its `KINDS`; docs/plugins.md has plug-ins.
"""

import importlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType
from typing import Any

from spheremouse.errors import SpheremouseError
from spheremouse.files.validate import nearest
from spheremouse.finding import Finding

_REMEDY = "update it, or uninstall it"


def resolve(package: ModuleType, what: str, spec: str, error: type[SpheremouseError]) -> tuple[ModuleType, str]:
    """Return module and argument of `KIND:ARGUMENT`. `what` is the kind of plug-in, "source" or "output".

    A package may complete a shorter form by its function `full_spec`. If there is no such kind, `error` is raised with
    the known kinds. If a plug-in cannot be used, `error` is raised with its name.
    """
    kind, _, argument = _full(package, spec).partition(":")
    if kind in package.KINDS:
        return importlib.import_module(f"{package.__name__}.{kind}"), argument
    plugged = {entry.name: entry for entry in entry_points(group=f"spheremouse.{what}")}
    if kind in plugged:
        return _load(plugged[kind], what, error), argument
    known = (*package.KINDS, *sorted(plugged))
    form = "" if ":" in spec else f"{what}s are written KIND:ARGUMENT; "
    raise error(f"unknown {what} {spec!r}; {form}{nearest(kind, known)}")


def check(package: ModuleType, what: str, spec: str, error: type[SpheremouseError]) -> None:
    """Raise as `resolve` and the module's function `check`, if it has one, do; open nothing."""
    module, argument = resolve(package, what, spec, error)
    if callable(look := getattr(module, "check", None)):
        look(argument)


def probe(package: ModuleType, what: str, spec: str, error: type[SpheremouseError]) -> list[Finding]:
    """Return the findings of the module's `probe`, if it has one, without disturbing a run. Raises as `check` does."""
    check(package, what, spec, error)
    module, argument = resolve(package, what, spec, error)
    return module.probe(argument) if hasattr(module, "probe") else []


def open_spec(
    package: ModuleType, what: str, spec: str, error: type[SpheremouseError], members: Iterable[str], *more: Any
) -> Any:
    """Open `KIND:ARGUMENT`: call the module's `open` with the argument and `more`, and return its result.

    Raises `error` as `resolve` does, and if the object that a plug-in returns lacks some of the `members`. Any later
    exception of a plug-in also becomes `error`, with the plug-in's name.
    """
    module, argument = resolve(package, what, spec, error)
    kind = _full(package, spec).partition(":")[0]
    if kind in package.KINDS:
        return module.open(argument, *more)
    named_errors = partial(_named_errors, f"{what} {kind}: the plug-in {module.__name__}", error)
    with named_errors():
        plugin = module.open(argument, *more)
    missing = [name for name in members if not hasattr(plugin, name)]
    if missing:
        raise error(f"{what} {kind}: breaks the contract: has no {', '.join(missing)}; {_REMEDY}")
    return _PlugIn(plugin, named_errors)


@contextmanager
def _named_errors(origin: str, error: type[SpheremouseError]) -> Iterator[None]:
    """Turn unexpected exceptions of a plug-in into errors that begin with its `origin`."""
    try:
        yield
    except SpheremouseError:
        raise
    except Exception as e:  # a plug-in may raise anything
        raise error(f"{origin} fails ({_reason(e)}); {_REMEDY}") from e


def _reason(e: Exception) -> str:
    return " ".join(f"{type(e).__name__}: {e}".split())[:200]


class _PlugIn:
    """An opened plug-in. Its exceptions contain its name."""

    def __init__(self, plugin: Any, named_errors: Callable[[], AbstractContextManager[None]]) -> None:
        self._plugin, self._named_errors = plugin, named_errors
        for name in dir(type(plugin)):  # methods as attributes: from Python 3.12 on, protocols look for no others
            if not name.startswith("_") and callable(getattr(type(plugin), name)):
                setattr(self, name, self._with_named_errors(getattr(plugin, name)))

    def __getattr__(self, name: str) -> Any:
        member = getattr(self._plugin, name)
        return self._with_named_errors(member) if callable(member) else member

    def _with_named_errors(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            with self._named_errors():
                return function(*args, **kwargs)

        return call

    def __iter__(self) -> Iterator[Any]:
        with self._named_errors():
            yield from self._plugin

    def __enter__(self) -> "_PlugIn":
        with self._named_errors():
            entered = self._plugin.__enter__()
        return self if entered is self._plugin else _PlugIn(entered, self._named_errors)

    def __exit__(self, *error: object) -> bool | None:
        with self._named_errors():
            return self._plugin.__exit__(*error)


def _full(package: ModuleType, spec: str) -> str:
    return package.full_spec(spec) if hasattr(package, "full_spec") else spec


def _load(entry: EntryPoint, what: str, error: type[SpheremouseError]) -> ModuleType:
    """Return the module of a plug-in; `error` if it cannot be loaded or has no function `open`."""
    origin = f"{what} {entry.name}: the plug-in {entry.value}"
    try:
        module = entry.load()
    except Exception as e:  # a plug-in may raise anything
        raise error(f"{origin} cannot be loaded ({_reason(e)}); {_REMEDY}") from None
    if not callable(getattr(module, "open", None)):
        raise error(f"{origin} breaks the contract: has no function `open`; {_REMEDY}")
    return module


def options(
    text: str, known: dict[str, type[int] | type[float] | type[str]], name: str, error: type[SpheremouseError]
) -> dict[str, int | float | str]:
    """Return `KEY=VALUE,KEY=VALUE` as values of the `known` types; messages call the whole `name`."""
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
