"""JSON of strangers as plain data."""

import json
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from spheremouse.files.plain_json import loads


@given(st.from_regex(r"-?[1-9]\.[0-9]{1,20}[eE][+-]?[0-9]{1,4}", fullmatch=True), st.booleans())
@example("1e999", False)
@example("-1e999", True)
@example("1.7976931348623157e308", False)
@example("1e-999", False)
def test_a_number_is_read_as_python_reads_it_unless_it_overflows(text, constants):
    """Also within lists and objects, and where NaN and Infinity are allowed."""
    value = float(text)
    for document in (text, f"[{text}]", f'{{"a": [{text}]}}'):
        if math.isinf(value):
            with pytest.raises(ValueError, match="exceeds the largest number"):
                loads(document, constants=constants)
        else:
            assert loads(document, constants=constants) == json.loads(document)
