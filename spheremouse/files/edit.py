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
    end = "\r\n" if "\r\n" in text else "\n"
    node: Any = YAML(typ="safe", pure=True).compose(text)
    indent, after = "", None  # indentation within the section; end of the section's own key
    for depth, name in enumerate(key):
        pair = next(((k, v) for k, v in node.value if k.value == name), None)
        if pair is None:
            return _inserted(text, node, key[depth:], value, indent, after, end)
        name_node, node = pair
        if depth == len(key) - 1:
            return text[: node.start_mark.index] + config.to_yaml(value) + text[node.end_mark.index :]
        if isinstance(node, ScalarNode):  # the section is null, or all its keys are commented out
            whole = text[: node.start_mark.index] + text[node.end_mark.index :] if node.value else text
            return _inserted(whole, None, key[depth + 1 :], value, indent + "  ", name_node.end_mark.index, end)
        if not node.flow_style and node.value:
            indent = " " * node.value[0][0].start_mark.column
        after = name_node.end_mark.index
    return text


def _inserted(
    text: str, node: MappingNode | None, key: tuple[str, ...], value: Any, indent: str, after: int | None, end: str
) -> str:
    """Return the text with a new key and its sections, in the section `node`. The key of `node` ends at `after`."""
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


def put(data: Any, key: Key, value: Any) -> None:
    """Set the value of a key in plain data. Sections on the way are made if they are missing or null."""
    for name in key[:-1]:
        if data.get(name) is None:
            data[name] = {}
        data = data[name]
    data[key[-1]] = value
