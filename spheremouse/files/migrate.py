"""Files of an older schema brought to the one this program reads: a step from each number to the next.

A step changes plain data in place, whether read to be used or read with its comments to be written again. Whoever
changes a schema writes it. Each kind has a number of its own. The original stays beside the file.
"""

import os
from codecs import BOM_UTF8
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml.comments import CommentedMap

from spheremouse.errors import ConfigurationError
from spheremouse.files.atomic import replace
from spheremouse.files.lookup import open_to_read
from spheremouse.files.rewrite import rewritten
from spheremouse.files.yaml import MAX_BYTES, Document, Problem, parse_bytes, shown

Step = Callable[[MutableMapping[str, Any]], None]


def _seated(data: MutableMapping[str, Any]) -> None:
    """A configuration says where the player stands, and Y counts downwards.

    Where an axis was reversed, or X and Y exchanged, the pointer goes as it went; where none was, it goes like the hand
    of who stands on the far side, and no longer like its mirror image.
    """
    motion = data.get("motion")
    if not isinstance(motion, MutableMapping) or "player" in motion:
        return
    old = [motion.get(key, False) for key in ("swap_xy", "invert_x", "invert_y")]
    if not {"swap_xy", "invert_x", "invert_y"} & set(motion) or not all(type(value) is bool for value in old):
        return
    swapped, x, y = old
    player = ("right" if x else "left") if swapped else ("camera-side" if x else "far-side")
    mirrored = any(old) and ((x != y) if swapped else (x == y))
    for key, value in (("invert_x", False), ("invert_y", mirrored)):
        if key in motion or value:
            _set(motion, key, value)
    _set(motion, "player", player, "swap_xy")


def _set(section: MutableMapping[str, Any], key: str, value: Any, instead: str = "") -> None:
    """A key of a section, in the place of another with its comments, or else as the first one."""
    if key in section or not isinstance(section, CommentedMap):
        section.pop(instead, None)
        section[key] = value
    elif instead in section:
        place, comment = list(section).index(instead), section.ca.items.pop(instead, None)
        del section[instead]
        section.insert(place, key, value)
        if comment is not None:
            section.ca.items[key] = comment
    else:
        section.insert(0, key, value)


# The first step of each goes from schema 1 to 2.
STEPS: dict[str, Sequence[Step]] = {"map": (), "rig": (), "device": (), "wand": (), "configuration": (_seated,)}


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
    if "axes" in data and "targets" in data:
        return "device"
    return "wand" if "body" in data and "discs" in data else "configuration"


def converted(document: Document, kind: str) -> Document:
    """The document as the newest schema of its kind would say it; as it is where it is, or has no schema to go by.

    Lines are those of the text that was read. ConfigurationError for a file from a newer version.
    """
    data = document.data
    if not isinstance(data, dict) or (version := _version(data)) is None:
        return document
    if version > newest(kind):
        text = f"is {version}, of a newer spheremouse; this one reads {newest(kind)}: update it"
        raise document.error([Problem(("schema",), text)])
    if version == newest(kind):
        return document
    newer = copied(data)
    _step_up(newer, kind, version)
    return Document(document.name, newer, document.lines)


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


def _rewritten(text: str, kind: str, version: int, document: Document) -> str:
    """The text in the newest schema."""
    wanted = converted(document, kind)  # refuses what is newer

    def change(data: MutableMapping[str, Any]) -> None:
        _step_up(data, kind, version)

    try:
        return rewritten(text, change, wanted.data, document.name)
    except ConfigurationError as e:
        what = f"{document.name}: cannot be brought to the newest schema ({e}); it is as it was: change it by hand"
        raise ConfigurationError(what) from None


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


def copied(value: Any) -> Any:
    """Plain data that may be changed: sections of its own. Lists stay tuples, as they are read."""
    if isinstance(value, dict):
        return {k: copied(v) for k, v in value.items()}
    return tuple(copied(v) for v in value) if isinstance(value, tuple) else value


def without_schema(document: Document, kind: str) -> Document:
    """The document in the newest schema of its kind, less that key."""
    wanted = newest(kind)
    if not isinstance(document.data, dict):
        raise document.error([Problem((), f"must be `key: value` lines; the first is `schema: {wanted}`")])
    document = converted(document, kind)
    data = dict(document.data)
    version = data.pop("schema", None)
    if version is None:
        raise document.error([Problem((), f"schema: missing; write `schema: {wanted}` as the first line")])
    if version is True or version != wanted:
        text = f"is {shown(version)}; this program reads version {wanted}: update one of the two"
        raise document.error([Problem(("schema",), text)])
    return Document(document.name, data, document.lines)
