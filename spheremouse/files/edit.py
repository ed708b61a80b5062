"""Settings put into a configuration file by the program: what a person wrote, and their comments, stay."""

from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.files.atomic import replace
from spheremouse.files.migrate import migrate_file, newest
from spheremouse.files.rewrite import rewritten
from spheremouse.files.yaml import Document, parse_bytes, read_document


def save_settings(path: Path, values: Mapping[tuple[str, ...], Any], root: type[Any]) -> None:
    """Write settings into a configuration file, made where it is missing; whole or not at all.

    What a file would say besides is checked first. One of an older schema is converted, its original kept. Raises
    ConfigurationError where the file cannot be read, would be wrong, or cannot be written.
    """
    try:
        there = path.exists()
        if there:
            config.load(path, root)  # its own mistakes, with their lines
            migrate_file(path)
        text = path.read_text(encoding="utf-8-sig") if there else f"schema: {newest(config.KIND)}\n"
        before = read_document(path) if there else parse_bytes(text.encode(), str(path))
        wanted = _plain(before.data)
        _put(wanted, values)
        config.loads(Document(str(path), wanted, before.lines), root)
        replace(path, rewritten(text, lambda data: _put(data, values), wanted, str(path)).encode())
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be written: {e.strerror or e}") from None


def _put(data: MutableMapping[str, Any], values: Mapping[tuple[str, ...], Any]) -> None:
    for (*sections, key), value in values.items():
        place = data
        for name in sections:
            if place.get(name) is None:  # missing, or all of it commented out
                place[name] = {}
            place = place[name]
        place[key] = value


def _plain(data: Any) -> Any:
    """A copy whose sections may be changed."""
    return {key: _plain(value) for key, value in data.items()} if isinstance(data, dict) else data
