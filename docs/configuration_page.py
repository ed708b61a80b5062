"""The tables of docs/configuration.md, from the settings' code: python docs/configuration_page.py [--write].

Without `--write` they are printed; tests/test_docs.py holds the page against them.
"""

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from spheremouse.ball.settings import Settings
from spheremouse.files.atomic import write_atomically
from spheremouse.files.config import to_yaml
from spheremouse.session.settings import Configuration

PAGE = Path(__file__).with_name("configuration.md")
MARKS = ("<!-- made by docs/configuration_page.py --write -->", "<!-- end -->")
HEAD = ("key", "default", "may be", "what it is, and why this default")
RUN, USE, BALL, WAND = "What runs", "In use", "Tracking the ball", "Tracking a ball in a hand"
LEADS = {
    RUN: "Where frames come from, where motion goes, and what tracks between the two. These keys stand in no section.",
    USE: "How the ball moves the pointer, how the camera films, what the daemon serves and keeps.",
    BALL: "Seldom changed: the defaults are those that everything in these pages was measured with.",
    WAND: "For `tracker: wand` ([how](wand.md)).",
}


def tables() -> str:
    """Markdown: every parameter once, by what it is for, a table for each section of the file in the file's order."""
    made = {kind: [f"## {kind}", lead] for kind, lead in LEADS.items()}
    links: dict[str, list[str]] = {kind: [] for kind in LEADS}
    made[RUN].append(table(Configuration, ""))
    for name, cls in sections(Configuration):
        links[kind_of(name)].append(f"[`{name}`](#{name.replace('.', '')})")
        own = f"### {name}\n\n{' '.join((cls.__doc__ or '').split(chr(10) + chr(10))[0].split())}\n\n{table(cls, name)}"
        made[kind_of(name)].append(own)
    places = [f"[{kind}](#{kind.lower().replace(' ', '-')})" for kind in LEADS]
    listed = [
        ": ".join([place, *([", ".join(of)] if of else [])]) for place, of in zip(places, links.values(), strict=True)
    ]
    contents = "\n".join(f"- {line}" for line in listed)
    return "\n\n".join([contents, *(part for parts in made.values() for part in parts)])


def kind_of(section: str) -> str:
    """Where it stands: what the ball's tracker itself has is its own, but for the pointer's scale."""
    room = section.partition(".")[0]
    if room == "wand":
        return WAND
    return BALL if room in {f.name for f in dataclasses.fields(Settings)} - {"motion"} else USE


def sections(cls: type, prefix: str = "") -> Iterator[tuple[str, type]]:
    """Sections of settings and their classes, in the file's order; those within others after them."""
    for name, inner in get_type_hints(cls).items():
        if dataclasses.is_dataclass(inner):
            yield f"{prefix}{name}", inner  # pyright: ignore[reportReturnType]
            yield from sections(inner, f"{prefix}{name}.")  # pyright: ignore[reportArgumentType]


def table(cls: type, section: str) -> str:
    """Parameters of a section, without those of sections in it."""
    prefix, hints = f"{section}." if section else "", get_type_hints(cls)
    fields = [f for f in dataclasses.fields(cls) if not dataclasses.is_dataclass(hints[f.name])]
    lines = [HEAD, ("---",) * len(HEAD), *(row(f, hints[f.name], prefix) for f in fields)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def row(field: "dataclasses.Field[Any]", hint: Any, prefix: str) -> tuple[str, ...]:
    """Cells of a parameter."""
    unit, meaning = field.metadata["unit"], field.metadata["meaning"]
    unit, empty = "" if unit == "-" else f" {unit}", field.default in (None, ())
    if meaning.partition(" ")[0].rstrip(",;:").isalpha():  # a symbol keeps its case
        meaning = meaning[:1].upper() + meaning[1:]
    default = f"`{short(field.default)}`{'' if empty else unit}"
    return f"`{prefix}{field.name}`", default, may_be(field, hint, unit if empty else ""), meaning


def may_be(field: "dataclasses.Field[Any]", hint: Any, unit: str) -> str:
    """Choices, or bounds; empty for words and files."""
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
    """A default as YAML, numbers to the digits that one writes."""
    return to_yaml(value) if not isinstance(value, float) else f"{value:.0f}" if value >= 1e6 else f"{value:.6g}"


def written(page: str, made: str) -> str:
    """The page with its tables anew."""
    before, rest = page.split(MARKS[0])
    return f"{before}{MARKS[0]}\n\n{made}\n\n{MARKS[1]}{rest.split(MARKS[1])[1]}"


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        write_atomically(PAGE, written(PAGE.read_text(encoding="utf-8"), tables()))
    else:
        print(tables())
