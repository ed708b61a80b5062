"""The option `third=` of mouse outputs: send the ball's spin, an axis that a mouse does not have."""

from spheremouse.errors import OutputError
from spheremouse.files.registry import options
from spheremouse.output.response import KEYS

NONE = "none"
VALUES = {  # of `third=` for each kind of output, besides `none`
    "auto": ("wheel",),  # the only one that all three outputs have
    "desktop": ("wheel",),
    "serial": ("wheel", "pan"),
    "uinput": ("wheel", "rz"),
}
NOTCH = 120  # counts of one notch of a wheel, as in REL_WHEEL_HI_RES
_AXIS_NAMES = {"wheel": "the wheel (REL_WHEEL_HI_RES)", "rz": "REL_RZ", "pan": "the sideways wheel (REL_HWHEEL_HI_RES)"}


def parse_third(kind: str, argument: str) -> str:
    """Return the value of `third=`, the only option that an output reads itself. OutputError if it is invalid."""
    given = options(argument, {"third": str, **KEYS}, f"{kind}:{argument}", OutputError)
    return validate_third(kind, str(given.get("third", NONE)))


def validate_third(kind: str, third: str) -> str:
    """Return the value of `third=`. Raise OutputError if the output does not have it."""
    known = (NONE, *VALUES[kind])
    if third not in known:
        raise OutputError(f"{kind}: third={third}", f"write third= with one of {', '.join(known)}")
    return third


def whole_notches(counts: int) -> tuple[int, int]:
    """Return the whole notches in some counts of the wheel, and the counts left over, both towards zero."""
    notches = abs(counts) // NOTCH * (1 if counts > 0 else -1)
    return notches, counts - notches * NOTCH


def left_out(spec: str) -> OutputError | None:
    """Return problem and hint of an output `KIND:ARGUMENT` that omits the spin; None for others and plug-ins."""
    kind, _, argument = spec.partition(":")
    if kind not in VALUES or _third_option(argument) != NONE:
        return None
    values = " or ".join(f"third={value}" for value in VALUES[kind])
    problem = "the third axis (the ball's spin) is not sent"
    return OutputError(f"{problem}: output {kind} has no `third=`", f"{values} sends it (docs/outputs.md)")


def sent_as(spec: str) -> str:
    """Return the axis that carries the spin of an output `KIND:ARGUMENT`, in words; empty if there is none."""
    kind, _, argument = spec.partition(":")
    return _AXIS_NAMES.get(_third_option(argument), "") if kind in VALUES else ""


def _third_option(argument: str) -> str:
    pairs = (part.partition("=") for part in argument.split(","))
    return next((value.strip() for key, _, value in pairs if key.strip() == "third"), NONE)
