"""Broken text, bytes and plain data, as hypothesis makes them."""

import math
import re
from typing import Any

from hypothesis import strategies as st

numbers = st.one_of(
    st.sampled_from([0, -1, 1, 2, 3, 4, 0.5, 255, 256, 1e-12, 1e-300, 1e9, 1e300, -0.0, math.inf, -math.inf, math.nan]),
    st.integers(-100, 100),
    st.floats(-1e3, 1e3),
)
words = st.one_of(
    st.sampled_from(
        ["", "~", "null", "true", "off", "1e3", "0x10", "1_000", ".nan", "-.inf", "[", "{", "- ", ": ", "#"]
    ),
    st.sampled_from(
        ["&a", "*a", "!!python/none", "%", "'", '"', "\t", "|", ">", "---", "2001-01-01", "\ufeff", "\u2028"]
    ),
    st.text(max_size=8),
    numbers.map(str),
)
json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=6)),
    lambda inner: st.one_of(st.lists(inner, max_size=5), st.dictionaries(st.text(max_size=4), inner, max_size=3)),
    max_leaves=6,
)
letters = st.characters(exclude_characters="/\\\0", exclude_categories=["Cs"])


@st.composite
def mutated(draw: st.DrawFn, text: str) -> str:
    """A text with a few of its words, lines or characters changed."""
    for _ in range(draw(st.integers(1, 3))):
        lines = text.split("\n")
        i = draw(st.integers(0, len(lines) - 1))
        tokens = re.split(r"([\s,:\[\]{}]+)", lines[i])
        match draw(st.integers(0, 5)):
            case 0:
                tokens[draw(st.integers(0, len(tokens) - 1))] = draw(words)
                lines[i] = "".join(tokens)
            case 1:
                del lines[i]
            case 2:
                lines.insert(i, lines[draw(st.integers(0, len(lines) - 1))])
            case 3:
                at = draw(st.integers(0, len(lines[i])))
                lines[i] = lines[i][:at] + draw(words) + lines[i][at:]
            case 4:
                lines[i] = " " * draw(st.integers(0, 5)) + lines[i].lstrip()
            case 5:
                lines = lines[: i + 1]
        text = "\n".join(lines)
    return text


@st.composite
def mutated_json(draw: st.DrawFn, tree: Any) -> Any:
    """A tree of plain data with one of its nodes replaced or removed."""
    if not isinstance(tree, dict | list) or not tree or draw(st.integers(0, 5)) == 0:
        return draw(json_values)
    places = list(tree) if isinstance(tree, dict) else list(range(len(tree)))
    place = draw(st.sampled_from(places))
    copy = dict(tree) if isinstance(tree, dict) else list(tree)
    if draw(st.integers(0, 5)) == 0:
        del copy[place]
    else:
        copy[place] = draw(mutated_json(tree[place]))
    return copy


@st.composite
def mutated_bytes(draw: st.DrawFn, data: bytes) -> bytes:
    """Bytes overwritten here and there, or cut short."""
    out = bytearray(data)
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(out) - 1))
        new = draw(st.binary(min_size=1, max_size=8))
        out[at : at + len(new)] = new
    if draw(st.booleans()):
        del out[draw(st.integers(0, len(out))) :]
    return bytes(out)
