"""Settings as the text of a configuration file, to export and import them, or to save them beside one."""

import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from spheremouse.errors import ConfigurationError
from spheremouse.files import config, plain_json, safe_files
from spheremouse.files.edit import put
from spheremouse.files.validate import CONFIG_SHOW, nearest
from spheremouse.files.yaml import SCHEMAS, Document, parse_value, read_document

Settings = Iterable[Mapping[str, Any]]  # with `key`, `value` and `default`, as the daemon describes its settings


def export_settings(settings: Settings) -> str:
    """Return the settings that differ from their defaults, as the text of a configuration file."""
    return settings_text({about["key"]: about["value"] for about in settings if about["value"] != about["default"]})


def import_settings(settings: Settings, document: Document) -> dict[str, Any]:
    """Return the values of a document, by dotted key, that are not in force. A list is equal to a tuple."""
    known = {about["key"]: plain_json.tuples(about["value"]) for about in settings}
    read = read_settings(document).items()
    return {key: v for key, v in read if key not in known or known[key] != plain_json.tuples(v)}


def defaults(settings: Settings, keys: Iterable[str]) -> dict[str, Any]:
    """Return the defaults of settings, by dotted key. Raises ConfigurationError for a key that is not there."""
    known = {about["key"]: about["default"] for about in settings}
    unknown = [key for key in keys if key not in known]
    if unknown:
        raise ConfigurationError(f"{unknown[0]}: unknown setting", nearest(unknown[0], list(known), CONFIG_SHOW))
    return {key: known[key] for key in keys}


def settings_text(values: Mapping[str, Any]) -> str:
    """Return settings, by dotted key, as the text of a configuration file."""
    sections: dict[str, Any] = {}
    for key, value in values.items():
        put(sections, tuple(key.split(".")), value)
    text = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = yaml.representer.sort_base_mapping_type_on_output = False
    yaml.dump({"schema": SCHEMAS["configuration"], **sections}, text)
    return text.getvalue()


def read_settings(document: Document) -> dict[str, Any]:
    """Return the settings of a document, by dotted key. Raises ConfigurationError if it has none."""
    if not isinstance(document.data, dict):
        raise ConfigurationError(f"{document.name}: has no settings", "export one to see its form")
    return dict(_flat({k: v for k, v in document.data.items() if k not in ("schema", "profiles")}))


def values_of(assignments: Iterable[str]) -> dict[str, Any]:
    pairs = [assignment.partition("=") for assignment in assignments]
    return {key.strip(): parse_value(text, key) for key, _, text in pairs}


def read_saved(path: Path) -> tuple[str, ...]:
    """Return the settings of a file as KEY=VALUE; none without a file. Raises ConfigurationError if it is invalid."""
    found = read_settings(read_document(path)) if path.exists() else {}
    return config.assignments(found)


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
