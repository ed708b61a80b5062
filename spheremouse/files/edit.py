"""Write settings into a configuration file and leave every other character as it is.

A value is replaced in its place. A new key becomes the first of its section, a new section the last of the file.
"""

from codecs import BOM_UTF8
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, ScalarNode

from spheremouse.errors import ConfigurationError, os_errors_as
from spheremouse.files import config
from spheremouse.files.safe_files import replace
from spheremouse.files.yaml import SCHEMAS, Key, parse_document


def save_settings(path: Path, values: Mapping[tuple[str, ...], Any], root: type[Any] | None) -> None:
    """Write settings into a configuration file, whole or not at all; a missing file is made.

    `root` are the settings by which the file is checked; None checks its syntax alone, for values that a daemon uses.
    Raises ConfigurationError if the file is a link, cannot be read or written, or would become invalid.
    """
    check_place(path)
    with os_errors_as(ConfigurationError, f"{path}: cannot be written"):
        if path.exists() and root is not None:
            config.load(path, root)  # reports the mistakes that are there already, with their lines
        raw = path.read_bytes() if path.exists() else f"schema: {SCHEMAS[config.KIND]}\n".encode()
        mark, text = raw[: len(BOM_UTF8)] if raw.startswith(BOM_UTF8) else b"", raw.removeprefix(BOM_UTF8).decode()
        wanted = parse_document(text, str(path)).data
        for key, value in values.items():
            text = _with(text, key, value)
            put(wanted, key, value)
        document = parse_document(text, str(path))
        if root is not None:
            config.loads(document, root)
        if document.data != wanted:
            raise ConfigurationError(f"{path}: the program cannot edit it and left it unchanged; edit it by hand")
        if mark + text.encode() != raw or not path.exists():
            replace(path, mark + text.encode())


def check_place(path: Path) -> None:
    """Raise ConfigurationError if `path` is a link, or its folder does not exist."""
    if path.is_symlink():
        raise ConfigurationError(f"{path}: is a link; name the file itself, {path.resolve()}")
    if not path.parent.is_dir():
        raise ConfigurationError(f"{path}: cannot be written: there is no folder {path.parent}")


def _with(text: str, key: tuple[str, ...], value: Any) -> str:
    """Return the text with one setting replaced or added."""
    newline = "\r\n" if "\r\n" in text else "\n"
    node: Any = YAML(typ="safe", pure=True).compose(text)
    indent, after = "", None  # indentation within the section; end of the section's own key
    for depth, name in enumerate(key):
        pair = next(((k, v) for k, v in node.value if k.value == name), None)
        if pair is None:
            return _insert_key(text, node, key[depth:], value, indent, after, newline)
        name_node, node = pair
        if depth == len(key) - 1:
            return text[: node.start_mark.index] + config.to_yaml(value) + text[node.end_mark.index :]
        if isinstance(node, ScalarNode):  # the section is null, or all its keys are commented out
            whole = text[: node.start_mark.index] + text[node.end_mark.index :] if node.value else text
            return _insert_key(whole, None, key[depth + 1 :], value, indent + "  ", name_node.end_mark.index, newline)
        if not node.flow_style and node.value:
            indent = " " * node.value[0][0].start_mark.column
        after = name_node.end_mark.index
    return text


def _insert_key(
    text: str, node: MappingNode | None, key: tuple[str, ...], value: Any, indent: str, after: int | None, newline: str
) -> str:
    """Return the text with a new key as the first of a section, or as the last of the file.

    `key` is the missing end of the path: sections that the text lacks, then the name. `node` is the section that the
    text has; None if that is empty, and then the text has no `null` there. The section's name ends at the offset
    `after`; None is the top level. `indent` stands before the new key in a section that has no braces.
    """
    if node is not None and node.flow_style:
        inner = config.to_yaml(value)
        for name in reversed(key[1:]):
            inner = f"{{{name}: {inner}}}"
        brace_end = node.start_mark.index + 1
        return text[:brace_end] + f"{key[0]}: {inner}{', ' if node.value else ''}" + text[brace_end:]
    lines = [f"{indent}{'  ' * k}{name}:" for k, name in enumerate(key)]
    block = newline.join(lines) + f" {config.to_yaml(value)}{newline}"
    if after is None:
        return text + ("" if text.endswith("\n") or not text else newline) + block
    line_end = text.find("\n", after)
    return text + newline + block if line_end < 0 else text[: line_end + 1] + block + text[line_end + 1 :]


def put(data: Any, key: Key, value: Any) -> None:
    """Set the value of a key in plain data. Sections on the way are made if they are missing or null."""
    for name in key[:-1]:
        if data.get(name) is None:
            data[name] = {}
        data = data[name]
    data[key[-1]] = value
