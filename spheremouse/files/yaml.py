"""Read a YAML text as plain data with line numbers, and report problems by line.

Plain data are mappings, lists, text, numbers, true, false and null. The reader refuses tags, anchors and aliases, so
that no file can run code or fill the memory. A message has the form `FILE:LINE: key: problem; remedy`.
"""

import re
from codecs import BOM_UTF8
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML, YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, DocumentStartEvent, NodeEvent
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode

from spheremouse.errors import ConfigurationError, has_control_characters, one_line
from spheremouse.files.plain_json import MAX_DEPTH
from spheremouse.files.safe_files import read_bytes

# The schema of each kind of file that this program reads and writes. No older schema was ever released.
SCHEMAS = {"map": 1, "rig": 1, "device": 1, "wand": 1, "configuration": 2}

MAX_BYTES = 1_000_000  # the map of 260 discs has this size
MAX_NODES = 20_000  # keys, values, sections and lists; a map of 260 discs has 4,000, a rig 1,000
MAX_PROBLEMS = 20  # reported of one file; each one is compared with all known names
_MAX_DIGITS = 1_000  # of a whole number; Python prints at most 4,300

Key = tuple[str | int, ...]

_TAGS = {f"tag:yaml.org,2002:{t}": t for t in ("null", "bool", "int", "float", "str", "timestamp", "value", "merge")}


@dataclass(frozen=True, slots=True)
class Problem:
    key: Key
    text: str


@dataclass(frozen=True, slots=True)
class Document:
    """Content of a YAML text as dicts, tuples and scalars, with the line (from 1) of every key and item."""

    name: str  # in messages; usually the path, or the whole start of a message if no lines are known
    data: Any
    lines: dict[Key, int] = field(default_factory=dict)

    def line(self, key: Key) -> int:
        """Return the line of a key, or of the nearest section around it."""
        while key not in self.lines and key:
            key = key[:-1]
        return self.lines.get(key, 1)

    def place(self, key: Key) -> str:
        """Return the start of a message about a key: the name, and the line if lines are known."""
        return f"{self.name}:{self.line(key)}: " if self.lines else self.name

    def error(self, problems: Sequence[Problem], more: int = 0) -> ConfigurationError:
        """Return one error: a line for each problem, by line, at most MAX_PROBLEMS, and the number of the others."""
        ordered = sorted(problems, key=lambda p: self.line(p.key))
        listed, more = ordered[:MAX_PROBLEMS], more + len(ordered[MAX_PROBLEMS:])
        lines = [f"{self.place(p.key)}{dotted(p.key)}{': ' if p.key else ''}{p.text}" for p in listed]
        if more:
            lines.append(f"{self.place(listed[-1].key)}and {more} more problems from here on")
        return ConfigurationError("\n".join(" ".join(line.splitlines()) for line in lines))


def dotted(key: Key) -> str:
    """Return a key as text: ("a", "b", 2, "c") becomes `a.b[2].c`."""
    text = "".join(f"[{k}]" if isinstance(k, int) else f".{_word(k)}" for k in key)
    return text.removeprefix(".")


def _word(key: str) -> str:
    """Return a key on one line of at most 60 characters."""
    text = key if key.isprintable() else repr(key)
    return text if len(text) <= 60 else text[:57] + "..."


def read_document(path: Path) -> Document:
    """Read the document in a file. Raise ConfigurationError, with the line, for anything but plain YAML."""
    return parse_bytes(read_raw(path), str(path))


def read_raw(path: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the bytes of a file. Raise ConfigurationError if it cannot be read."""
    try:
        return read_bytes(path, max_bytes, "file of spheremouse")
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such file; check the path") from None
    except IsADirectoryError:
        raise ConfigurationError(f"{path}: is a directory; name the YAML file in it") from None
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be read: {e.strerror or e}") from None
    except ValueError as e:  # a NUL in the name
        raise ConfigurationError(f"{str(path)!r}: cannot be read: {e}") from None


def parse_bytes(raw: bytes, name: str) -> Document:
    """Return the document in the bytes of the file `name`. ConfigurationError: too large, not UTF-8, no YAML."""
    if len(raw) > MAX_BYTES:
        raise ConfigurationError(f"{name}: larger than {MAX_BYTES} bytes; this is not a file of spheremouse")
    try:
        text = raw.removeprefix(BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as e:
        line = e.object.count(b"\n", 0, e.start) + 1
        problem = "is not UTF-8 text; save it as UTF-8, or check that it is the YAML file"
        raise ConfigurationError(f"{name}:{line}: {problem}") from None
    return parse_document(text, name)


def parse_document(text: str, name: str) -> Document:
    """Return the document in a text, `name` in messages. Raises ConfigurationError if it is empty or invalid."""
    try:
        root = _compose(text, name)
    except YAMLError as e:
        raise _syntax_error(e, text, name) from None
    except (ValueError, TypeError, AttributeError, IndexError, KeyError, AssertionError, RecursionError) as e:
        # ruamel.yaml raises these on some malformed texts
        raise ConfigurationError(f"{name}:1: not readable as YAML ({type(e).__name__}: {one_line(str(e))})") from None
    if root is None:
        raise ConfigurationError(f"{name}:1: empty; the first line must have its `schema`")
    lines: dict[Key, int] = {(): root.start_mark.line + 1}
    problems: list[Problem] = []
    data = _plain(root, (), lines, problems)
    document = Document(name, data, lines)
    if problems:
        raise document.error(problems)
    return document


def parse_value(text: str, name: str) -> Any:
    """Return one plain value, as in `--set KEY=VALUE`; an empty text is null."""
    return parse_document(text, name).data if text.strip() and not text.lstrip().startswith("#") else None


def without_schema(document: Document, kind: str) -> Document:
    """Return a document of this kind without `schema`. ConfigurationError: no mapping, or another schema than ours."""
    wanted, data = SCHEMAS[kind], document.data
    if not isinstance(data, dict):
        raise document.error([Problem((), f"must be `key: value` lines; the first is `schema: {wanted}`")])
    version = data.get("schema")
    if version is None:
        raise document.error([Problem((), f"schema: missing; write `schema: {wanted}` as the first line")])
    if type(version) is not int or version != wanted:
        text = f"is {shown(version)}; this program reads version {wanted}: update the program or the file"
        raise document.error([Problem(("schema",), text)])
    if kind != "configuration":  # people make their own configuration, and pass the other files on
        refuse_control_characters(document)
    return Document(document.name, {k: v for k, v in data.items() if k != "schema"}, document.lines)


def refuse_control_characters(document: Document) -> None:
    """Raise ConfigurationError for text that could steer the terminal on which it is printed; not for provenance."""
    problems = [
        Problem(key, "has a control character; write it in letters, digits and signs")
        for key, text in _texts(document.data, ())
        if has_control_characters(text) and key[:1] != ("provenance",)
    ]
    if problems:
        raise document.error(problems)


def _texts(data: Any, key: Key) -> Iterator[tuple[Key, str]]:
    """Yield all texts of the data with their keys, names of keys included."""
    if isinstance(data, str):
        yield key, data
    elif isinstance(data, dict):
        for name, value in data.items():
            yield (*key, name), name
            yield from _texts(value, (*key, name))
    elif isinstance(data, tuple):
        for i, value in enumerate(data):
            yield from _texts(value, (*key, i))


def shown(value: Any) -> str:
    """Return a value as a message quotes it, in at most 40 characters."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a section"
    if isinstance(value, tuple):
        return f"a list of {len(value)}"
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _compose(text: str, name: str) -> Node | None:
    """Return the nodes of the only document in a text, after its events have shown nothing but plain data."""
    depth = documents = nodes = 0
    for event in _yaml().parse(text):
        at = f"{name}:{event.start_mark.line + 1}"
        if isinstance(event, AliasEvent):
            raise ConfigurationError(f"{at}: aliases (*{one_line(event.anchor)}) are not read; write the value out")
        if isinstance(event, NodeEvent) and (tag := getattr(event, "tag", None)):
            raise ConfigurationError(f"{at}: tags ({one_line(str(tag))}) are not read; write a plain value")
        documents += isinstance(event, DocumentStartEvent)
        nodes += isinstance(event, NodeEvent)
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ConfigurationError(f"{at}: nested deeper than {MAX_DEPTH} levels; this is not a file of spheremouse")
        if nodes > MAX_NODES:
            raise ConfigurationError(f"{at}: more than {MAX_NODES} values; this is not a file of spheremouse")
        if documents > 1:
            raise ConfigurationError(f"{at}: a second document begins here; keep one and remove the `---`")
    return _yaml().compose(text)


class _Yaml(YAML):
    def official_plug_ins(self) -> list[str]:
        """Return none. Otherwise each value of `ctl set` would search ruamel's folder on the disk."""
        return []


def _yaml() -> YAML:
    return _Yaml(typ="safe", pure=True)


def _syntax_error(e: YAMLError, text: str, name: str) -> ConfigurationError:
    mark = getattr(e, "problem_mark", None) or getattr(e, "context_mark", None)
    if mark is not None:
        where, what = mark.line + 1, f"column {mark.column + 1}: {one_line(getattr(e, 'problem', '') or 'not YAML')}"
    else:  # for a character that YAML does not allow, the reader gives the position alone
        position = getattr(e, "position", None)
        where = text.count("\n", 0, position) + 1 if isinstance(position, int) else 1
        what = "a character that YAML does not allow"
    return ConfigurationError(f"{name}:{where}: not YAML: {what}; mind indentation, colons and quotes")


def _plain(node: Node, key: Key, lines: dict[Key, int], problems: list[Problem]) -> Any:
    """Return a node as plain data. Add the line of each key to `lines`, and faults to `problems`."""
    if isinstance(node, ScalarNode):
        return _scalar(node, key, problems)
    if not isinstance(node, MappingNode):
        items = []
        for i, item in enumerate(node.value):
            lines[(*key, i)] = item.start_mark.line + 1
            items.append(_plain(item, (*key, i), lines, problems))
        return tuple(items)
    data: dict[str, Any] = {}
    for name, value in node.value:
        word, line = name.value if isinstance(name, ScalarNode) else "?", name.start_mark.line + 1
        path = (*key, word)
        if word in data:
            problems.append(Problem(path, f"stands here and in line {line}; remove one of them"))
            continue
        lines[path] = line
        if isinstance(name, ScalarNode):
            data[word] = _plain(value, path, lines, problems)
        else:
            problems.append(Problem(path, "a key must be a word, not a list or a section"))
    return data


def _scalar(node: ScalarNode, key: Key, problems: list[Problem]) -> Any:
    """Return the value of a scalar node. Add a number that cannot be read to `problems`."""
    text: str = node.value
    kind = _TAGS.get(str(node.tag), "str")
    number = text.replace("_", "").lower()
    try:
        if kind == "null":
            return None
        if kind == "bool":
            return text.lower() == "true"
        if kind == "int" and len(number) > _MAX_DIGITS:
            raise ValueError(text)
        if kind == "int":
            prefixed = re.match(r"[-+]?0[box]", number)
            return int(number, 0) if prefixed else int(number)
        if kind == "float":
            return float(number.replace(".inf", "inf").replace(".nan", "nan"))
    except ValueError:
        problems.append(Problem(key, f"{shown(text)} is not a number that can be read"))
    return text
