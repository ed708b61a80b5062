"""Files of an older schema brought to the one this program reads: a step from each number to the next.

A step changes plain data in place, whether read to be used or read with its comments to be written again. Whoever
changes a schema writes it; a number shared by several kinds (`yaml.SCHEMA`) rises for all of them, and a kind to
which nothing happened gets `unchanged`. The original stays beside the file.
"""

import os
from codecs import BOM_UTF8
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML, YAMLError
from ruamel.yaml.constructor import RoundTripConstructor
from ruamel.yaml.representer import RoundTripRepresenter

from spheremouse.errors import ConfigurationError
from spheremouse.files.atomic import replace
from spheremouse.files.lookup import open_to_read
from spheremouse.files.yaml import MAX_BYTES, SCHEMA, Document, Problem, parse_bytes, parse_document, shown

Step = Callable[[MutableMapping[str, Any]], None]

# The first step of each goes from schema 1 to 2.
STEPS: dict[str, Sequence[Step]] = {"map": (), "rig": (), "device": (), "configuration": ()}


def unchanged(data: MutableMapping[str, Any]) -> None:
    """The step of a kind that is the same in both schemas."""


def newest(kind: str) -> int:
    """The schema that this program reads and writes."""
    return 1 + len(STEPS[kind])


def kind_of(data: Mapping[str, Any]) -> str:
    """Kind of a file, by what only such a file has; camera files count as rigs."""
    camera = data.get("camera")
    if "correlation_root" in data:
        return "map"
    if isinstance(camera, Mapping) and "fx" in camera:
        return "rig"
    return "device" if "axes" in data and "targets" in data else "configuration"


def converted(document: Document) -> Document:
    """The document as the newest schema would say it; as it is where there is nothing to do or no schema to go by.

    Lines are those of the text that was read. ConfigurationError for a file from a newer version.
    """
    data = document.data
    if not isinstance(data, dict) or (version := _version(data)) is None:
        return document
    kind = kind_of(data)
    if version > newest(kind):
        text = f"is {version}, of a newer spheremouse; this one reads {newest(kind)}: update it"
        raise document.error([Problem(("schema",), text)])
    if version == newest(kind):
        return document
    copied = _copied(data)
    _step_up(copied, kind, version)
    return Document(document.name, copied, document.lines)


def due(path: Path) -> str:
    """The change that `migrate_file` would make to a file, in words; empty where it would make none."""
    try:
        document = _read(path).document
    except ConfigurationError:
        return ""  # whoever reads it says what is wrong
    if not isinstance(document.data, dict) or (version := _version(document.data)) is None:
        return ""
    wanted = newest(kind_of(document.data))
    if version < wanted:
        return f"from schema {version} to {wanted}, the original stays as {backup_path(path, version).name}"
    if version > wanted and os.path.lexists(older := backup_path(path, wanted)):
        return f"back from schema {version}: {older.name} is what this version reads"
    return ""


def due_in(folder: Path) -> list[tuple[str, str]]:
    """Name and what `due` says, of each file of a folder where there is something to do."""
    found = ((path.name, due(path)) for path in sorted(folder.glob("*.yaml")) if path.name.isprintable())
    return [(name, words) for name, words in found if words]


def migrate_file(path: Path) -> bool:
    """Convert a file, comments kept, and keep the original as FILE.schemaN.bak; whether there was anything to do.

    A file from a newer version, of which an original that this version reads was kept, changes places with it: that is
    what going back to the last version needs. Without one it is refused.
    """
    there = _read(path)
    document = there.document
    if not isinstance(document.data, dict) or (version := _version(document.data)) is None:
        return False
    kind = kind_of(document.data)
    if version == newest(kind):
        return False
    older, backup = backup_path(path, newest(kind)), backup_path(path, version)
    if version > newest(kind) and os.path.lexists(older):
        wanted = _read(older).raw
    else:
        wanted = _rewritten(there.raw.removeprefix(BOM_UTF8).decode("utf-8"), kind, version, document).encode("utf-8")
    try:
        if version > newest(kind) or not os.path.lexists(backup):  # of several, the first is what nobody has converted
            replace(backup, there.raw, there.mode)
        replace(path, wanted)
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be converted: {e.strerror or e}") from None
    return True


def backup_path(path: Path, version: int) -> Path:
    """Path of the original of a file of schema `version`."""
    return path.with_name(f"{path.name}.schema{version}.bak")


# ---- within ----


class _Number(float):
    """A number that remembers how it was written: ruamel.yaml's own way may change the last digit."""

    text: str

    def __new__(cls, text: str) -> "_Number":
        number = super().__new__(cls, text.replace("_", "").lower().replace(".inf", "inf").replace(".nan", "nan"))
        number.text = text
        return number


class _Constructor(RoundTripConstructor):
    pass


class _Representer(RoundTripRepresenter):
    pass


_FLOAT = "tag:yaml.org,2002:float"
_Constructor.add_constructor(_FLOAT, lambda _, node: _Number(node.value))
_Representer.add_representer(_Number, lambda r, number: r.represent_scalar(_FLOAT, number.text))


def _rewritten(text: str, kind: str, version: int, document: Document) -> str:
    """The text in the newest schema; it is read again, and must say what the steps make of the plain data."""
    wanted = converted(document)  # refuses what is newer
    yaml = YAML(typ="rt")
    yaml.Constructor, yaml.Representer = _Constructor, _Representer
    yaml.preserve_quotes = True
    yaml.width = 1_000_000
    yaml.indent(mapping=2, sequence=4, offset=2)
    stream = StringIO()
    try:
        data = yaml.load(text)
        _step_up(data, kind, version)
        yaml.dump(data, stream)
        written = parse_document(stream.getvalue(), document.name)
    except (YAMLError, ConfigurationError) as e:
        raise _failed(document, " ".join(str(e).split())[:120]) from None
    if written.data != wanted.data:
        raise _failed(document, "what was written reads differently")
    return stream.getvalue()


def _failed(document: Document, why: str) -> ConfigurationError:
    text = f"{document.name}: cannot be brought to the newest schema ({why}); it is as it was: change it by hand"
    return ConfigurationError(text)


def _step_up(data: MutableMapping[str, Any], kind: str, version: int) -> None:
    for number, step in enumerate(STEPS[kind][version - 1 :], start=version + 1):
        step(data)
        data["schema"] = number


def _version(data: Mapping[str, Any]) -> int | None:
    version = data.get("schema")
    return version if type(version) is int and version >= 1 else None


class _There(NamedTuple):
    """Content of a file, as it is and as it reads."""

    raw: bytes
    mode: int
    document: Document


def _read(path: Path) -> _There:
    """A file, where others may write beside it; ConfigurationError for what is no file, or no plain YAML."""
    try:
        with open_to_read(path) as file:
            raw, mode = file.read(MAX_BYTES + 1), os.fstat(file.fileno()).st_mode & 0o777
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be read: {e.strerror or e}") from None
    return _There(raw, mode, parse_bytes(raw, str(path)))


def _copied(value: Any) -> Any:
    """Plain data that may be changed: sections of its own. Lists stay tuples, as they are read."""
    if isinstance(value, dict):
        return {k: _copied(v) for k, v in value.items()}
    return tuple(_copied(v) for v in value) if isinstance(value, tuple) else value


def without_schema(document: Document) -> Document:
    """The document less its `schema` key, which must be the version this program reads."""
    if not isinstance(document.data, dict):
        raise document.error([Problem((), f"must be `key: value` lines; the first is `schema: {SCHEMA}`")])
    document = converted(document)
    data = dict(document.data)
    version = data.pop("schema", None)
    if version is None:
        raise document.error([Problem((), f"schema: missing; write `schema: {SCHEMA}` as the first line")])
    if version is True or version != SCHEMA:
        text = f"is {shown(version)}; this program reads version {SCHEMA}: update one of the two"
        raise document.error([Problem(("schema",), text)])
    return Document(document.name, data, document.lines)
