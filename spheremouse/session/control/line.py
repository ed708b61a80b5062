"""A message of the control socket as a line: one JSON object, UTF-8."""

import json
import math
from typing import Any

MAX_LINE = 65536  # bytes, with its end of line; both ways


def encode(message: dict[str, Any]) -> bytes:
    """The line of a message. A number that is not finite is null. ValueError where it is longer than a line may be."""
    text = json.dumps(plain(message), ensure_ascii=False, allow_nan=False)
    line = text.encode("utf-8", "backslashreplace") + b"\n"  # half a surrogate pair becomes JSON's own escape of it
    if len(line) > MAX_LINE:
        raise ValueError(f"a message of {len(line)} bytes")
    return line


def plain(value: Any) -> Any:
    """Data as JSON can hold it: NumPy's scalars and arrays, tuples, paths and enumerations too."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, int):
        return int(value)
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return str(value)
