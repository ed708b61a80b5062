"""Settings put into a configuration file by the program: every other character of what a person wrote stays.

A value is exchanged where it stands; a new key is the first of its section, a new section the last of the file.
"""

from codecs import BOM_UTF8
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, ScalarNode

from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.files.atomic import replace
from spheremouse.files.migrate import copied, migrate_file, newest
from spheremouse.files.yaml import Key, parse_document


def save_settings(path: Path, values: Mapping[tuple[str, ...], Any], root: type[Any]) -> None:
    """Write settings into a configuration file, made where it is missing; whole or not at all.

    One of an older schema is converted, its original kept. Raises ConfigurationError where the file cannot be read or
    written, is a link, or would be wrong.
    """
    check_place(path)
    try:
        if path.exists():
            config.load(path, root)  # its own mistakes, with their lines
            migrate_file(path)
        raw = path.read_bytes() if path.exists() else f"schema: {newest(config.KIND)}\n".encode()
        mark, text = raw[: len(BOM_UTF8)] if raw.startswith(BOM_UTF8) else b"", raw.removeprefix(BOM_UTF8).decode()
        wanted = copied(parse_document(text, str(path)).data)
        for key, value in values.items():
            text = _with(text, key, value)
            _put(wanted, key, value)
        document = parse_document(text, str(path))
        config.loads(document, root)
        if document.data != wanted:
            raise ConfigurationError(f"{path}: cannot be written by the program; change it by hand, it is as it was")
        if mark + text.encode() != raw or not path.exists():
            replace(path, mark + text.encode())
    except OSError as e:
        raise ConfigurationError(f"{path}: cannot be written: {e.strerror or e}") from None


def check_place(path: Path) -> None:
    """Raise ConfigurationError where a configuration would not be saved: a link, or no such folder."""
    if path.is_symlink():
        raise ConfigurationError(f"{path}: is a link; name the file itself, {path.resolve()}")
    if not path.parent.is_dir():
        raise ConfigurationError(f"{path}: cannot be written: there is no folder {path.parent}")


def _with(text: str, key: tuple[str, ...], value: Any) -> str:
    """A text with one setting."""
    end = "\r\n" if "\r\n" in text else "\n"
    node: Any = YAML(typ="safe", pure=True).compose(text)
    indent, after = "", None  # of what is in the section; the line of its key
    for depth, name in enumerate(key):
        pair = next(((k, v) for k, v in node.value if k.value == name), None)
        if pair is None:
            return _inserted(text, node, key[depth:], value, indent, after, end)
        name_node, node = pair
        if depth == len(key) - 1:
            return text[: node.start_mark.index] + config.to_yaml(value) + text[node.end_mark.index :]
        if isinstance(node, ScalarNode):  # all of it is commented out, or `null`
            whole = text[: node.start_mark.index] + text[node.end_mark.index :] if node.value else text
            return _inserted(whole, None, key[depth + 1 :], value, indent + "  ", name_node.end_mark.index, end)
        if not node.flow_style and node.value:
            indent = " " * node.value[0][0].start_mark.column
        after = name_node.end_mark.index
    return text


def _inserted(
    text: str, node: MappingNode | None, key: tuple[str, ...], value: Any, indent: str, after: int | None, end: str
) -> str:
    """A text with a key, and sections that it needs, in a section that is there: `node`, whose own key ends `after`."""
    if node is not None and node.flow_style:
        inner = config.to_yaml(value)
        for name in reversed(key[1:]):
            inner = f"{{{name}: {inner}}}"
        at = node.start_mark.index + 1
        return text[:at] + f"{key[0]}: {inner}{', ' if node.value else ''}" + text[at:]
    lines = [f"{indent}{'  ' * k}{name}:" for k, name in enumerate(key)]
    block = end.join(lines) + f" {config.to_yaml(value)}{end}"
    if after is None:
        return text + ("" if text.endswith("\n") or not text else end) + block
    line = text.find("\n", after)
    return text + end + block if line < 0 else text[: line + 1] + block + text[line + 1 :]


def _put(data: Any, key: Key, value: Any) -> None:
    for name in key[:-1]:
        if data.get(name) is None:
            data[name] = {}
        data = data[name]
    data[key[-1]] = value
