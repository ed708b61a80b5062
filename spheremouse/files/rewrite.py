"""A YAML file changed by a program: comments, quotes and the digits of numbers stay as a person wrote them."""

from collections.abc import Callable, MutableMapping
from io import StringIO
from typing import Any

from ruamel.yaml import YAML, YAMLError
from ruamel.yaml.constructor import RoundTripConstructor
from ruamel.yaml.representer import RoundTripRepresenter

from spheremouse.errors import ConfigurationError
from spheremouse.files.yaml import parse_document


def rewritten(text: str, change: Callable[[MutableMapping[str, Any]], None], wanted: Any, name: str) -> str:
    """The text after `change`, which is given its data; what is read of it is `wanted`, plain data.

    Raises ConfigurationError where it cannot be written so; `name` is what messages call the text.
    """
    yaml = YAML(typ="rt")
    yaml.Constructor, yaml.Representer = _Constructor, _Representer
    yaml.preserve_quotes = True
    yaml.width = 1_000_000
    yaml.indent(mapping=2, sequence=4, offset=2)
    stream = StringIO()
    try:
        data = yaml.load(text)
        change(data)
        yaml.dump(data, stream)
        written = parse_document(stream.getvalue(), name)
    except (YAMLError, ConfigurationError) as e:
        raise ConfigurationError(" ".join(str(e).split())[:120]) from None
    if written.data != wanted:
        raise ConfigurationError("what was written reads differently")
    return stream.getvalue()


class _Number(float):
    """A number that remembers how it was written: ruamel.yaml's own way may change the last digit."""

    text: str

    def __new__(cls, text: str) -> "_Number":
        number = super().__new__(cls, text.replace("_", "").lower().replace(".inf", "inf").replace(".nan", "nan"))
        number.text = text
        return number


class _Constructor(RoundTripConstructor):
    pass


class _Representer(RoundTripRepresenter):
    pass


_FLOAT = "tag:yaml.org,2002:float"
_Constructor.add_constructor(_FLOAT, lambda _, node: _Number(node.value))
_Representer.add_representer(type(None), lambda r, _: r.represent_scalar("tag:yaml.org,2002:null", "null"))
_Representer.add_representer(_Number, lambda r, number: r.represent_scalar(_FLOAT, number.text))
