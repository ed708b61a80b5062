"""Settings as the text of a configuration file, to export and import them, or to save them beside one."""

import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from spheremouse.errors import ConfigurationError
from spheremouse.files import safe_files
from spheremouse.files.config import to_yaml
from spheremouse.files.edit import put
from spheremouse.files.yaml import MAX_BYTES, SCHEMAS, parse_bytes, parse_value


def settings_text(values: Mapping[str, Any]) -> str:
    """Return settings, by dotted key, as the text of a configuration file."""
    sections: dict[str, Any] = {}
    for key, value in values.items():
        put(sections, tuple(key.split(".")), value)
    text = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.dump({"schema": SCHEMAS["configuration"], **sections}, text)
    return text.getvalue()


def read_settings(text: str, name: str = "the imported file") -> dict[str, Any]:
    """Return the settings, by dotted key, in the text of a file. Raises ConfigurationError with its name and line."""
    data = parse_bytes(text.encode(), name).data
    if not isinstance(data, dict):
        raise ConfigurationError(f"{name}: has no settings", "export one to see its form")
    return dict(_flat({k: v for k, v in data.items() if k not in ("schema", "profiles")}))


def values_of(assignments: Iterable[str]) -> dict[str, Any]:
    """Return the values of KEY=VALUE, by dotted key."""
    pairs = [assignment.partition("=") for assignment in assignments]
    return {key.strip(): parse_value(text, key) for key, _, text in pairs}


def read_saved(path: Path) -> tuple[str, ...]:
    """Return the settings of a file as KEY=VALUE; none without a file. Raises ConfigurationError if it is invalid."""
    try:
        found = read_settings(safe_files.read_text(path, MAX_BYTES, "settings"), str(path))
    except FileNotFoundError:
        return ()
    except (OSError, UnicodeError) as e:
        raise ConfigurationError(f"{path}: cannot be read ({e})") from None
    return tuple(f"{key}={to_yaml(value)}" for key, value in found.items())


def save(path: Path, assignments: Iterable[str]) -> None:
    """Add KEY=VALUE to the file, or replace its values. Raises ConfigurationError if it is invalid or not writable."""
    values = values_of((*read_saved(path), *assignments))
    safe_files.write_atomically(path, settings_text(values))


def _flat(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
