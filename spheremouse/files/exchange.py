"""Settings as the text of a configuration file, to export and import them."""

import io
from collections.abc import Iterator, Mapping
from typing import Any

from ruamel.yaml import YAML

from spheremouse.errors import ConfigurationError
from spheremouse.files.edit import put
from spheremouse.files.yaml import SCHEMAS, parse_bytes


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


def read_settings(text: str) -> dict[str, Any]:
    """Return the settings, by dotted key, in the text of an imported file. Raises ConfigurationError with its line."""
    data = parse_bytes(text.encode(), "the imported file").data
    if not isinstance(data, dict):
        raise ConfigurationError("the imported file: has no settings", "export one to see its form")
    return dict(_flat({k: v for k, v in data.items() if k not in ("schema", "profiles")}))


def _flat(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
