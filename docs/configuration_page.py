"""Make the tables of docs/configuration.md and docs/expert-settings.md: python docs/configuration_page.py [--write].

Without `--write` it prints them. tests/test_docs.py compares the pages with the settings.
"""

import dataclasses
import sys
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from spheremouse.files.config import to_yaml
from spheremouse.files.safe_files import write_atomically
from spheremouse.session.settings import Configuration

COMMON_PAGE, EXPERT_PAGE = (Path(__file__).with_name(f"{name}.md") for name in ("configuration", "expert-settings"))
MARKS = ("<!-- made by docs/configuration_page.py --write -->", "<!-- end -->")
HEAD = ("key", "default", "range", "meaning")


def common_table() -> str:
    """Return the settings of daily use as one Markdown table, in the order of `Configuration.COMMON`."""
    return table(tuple(found for key in Configuration.COMMON for found in parameters(key)))


def expert_tables() -> str:
    """Return all other settings as Markdown, a table for each section in the order of the file."""
    parts = [table(parameters("", without=Configuration.COMMON))]
    for name, cls in sections(Configuration):
        found = parameters(name, without=Configuration.COMMON)
        summary = " ".join((cls.__doc__ or "").split("\n\n")[0].split())
        parts += [f"## {name}", summary, table(found)] if found else []
    return "\n\n".join(parts)


def sections(cls: type, prefix: str = "") -> Iterator[tuple[str, type]]:
    """Yield the sections of settings and their classes, in the order of the file."""
    for name, inner in get_type_hints(cls).items():
        if dataclasses.is_dataclass(inner):
            yield f"{prefix}{name}", inner  # pyright: ignore[reportReturnType]
            yield from sections(inner, f"{prefix}{name}.")  # pyright: ignore[reportArgumentType]


def parameters(name: str, without: Collection[str] = ()) -> tuple[tuple[str, "dataclasses.Field[Any]", Any], ...]:
    """Return key, field and type of the setting of this name, or of all those directly in the section."""
    cls, prefix = dict([("", Configuration), *sections(Configuration)]).get(name), f"{name}." if name else ""
    if cls is None:
        section, _, last = name.rpartition(".")
        return tuple(found for found in parameters(section) if found[1].name == last)
    hints = get_type_hints(cls)
    return tuple(
        (f"{prefix}{field.name}", field, hints[field.name])
        for field in dataclasses.fields(cls)
        if field.metadata and not dataclasses.is_dataclass(hints[field.name]) and f"{prefix}{field.name}" not in without
    )


def table(found: Iterable[tuple[str, "dataclasses.Field[Any]", Any]]) -> str:
    """Return settings as a Markdown table."""
    lines = [HEAD, ("---",) * len(HEAD), *(row(*one) for one in found)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def row(key: str, field: "dataclasses.Field[Any]", hint: Any) -> tuple[str, ...]:
    """Return the cells of a setting."""
    unit, meaning = field.metadata["unit"], field.metadata["meaning"]
    unit, empty = "" if unit == "-" else f" {unit}", field.default in (None, ())
    if meaning.partition(" ")[0].rstrip(",;:").isalpha():  # leave symbols as they are
        meaning = meaning[:1].upper() + meaning[1:]
    default = f"`{short(field.default)}`{'' if empty else unit}"
    if field.default is None and field.metadata["null"] is not None:
        default = "not set"
    return f"`{key}`", default, allowed(field, hint, unit if empty else ""), meaning


def allowed(field: "dataclasses.Field[Any]", hint: Any, unit: str) -> str:
    """Return the choices or bounds; empty for words and files."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    found = [f"`{to_yaml(value)}`" for kind in kinds if get_origin(kind) is Literal for value in get_args(kind)]
    if bounds := field.metadata["bounds"]:
        low = short(bounds["ge"]) if "ge" in bounds else f"over {short(bounds['gt'])}"
        high = short(bounds["le"]) if "le" in bounds else f"below {short(bounds['lt'])}"
        found.append(f"{low} to {high}{unit}")
    if bool in kinds:
        found += ["`true`", "`false`"]
    if (most := field.metadata["most"]) is not None:
        found.append(f"at most {most} of them")
    return ", ".join(found)


def short(value: Any) -> str:
    """Return a default as YAML, with six digits of a number."""
    return to_yaml(value) if not isinstance(value, float) else f"{value:.0f}" if value >= 1e6 else f"{value:.6g}"


def written(page: str, made: str) -> str:
    """Return the page with new tables."""
    before, rest = page.split(MARKS[0])
    return f"{before}{MARKS[0]}\n\n{made}\n\n{MARKS[1]}{rest.split(MARKS[1])[1]}"


PAGES = ((COMMON_PAGE, common_table), (EXPERT_PAGE, expert_tables))

if __name__ == "__main__":
    for path, tables in PAGES:
        if "--write" in sys.argv[1:]:
            write_atomically(path, written(path.read_text(encoding="utf-8"), tables()))
        else:
            print(tables())
