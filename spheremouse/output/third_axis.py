"""The third axis of an output: the ball's spin about the vertical, sent where `third=` asks for it.

An output whose mouse has no such axis of its own leaves it out unless it is told what to send it as.
"""

from spheremouse.errors import OutputError

NONE = "none"
WAYS = {  # what `third=` of each kind may be besides `none`
    "auto": ("wheel",),  # what all of them can
    "desktop": ("wheel",),
    "serial": ("wheel", "pan"),
    "uinput": ("wheel", "rz"),
}
_WORDS = {"wheel": "the wheel (REL_WHEEL_HI_RES)", "rz": "REL_RZ", "pan": "the sideways wheel (REL_HWHEEL_HI_RES)"}


def checked(kind: str, way: str) -> str:
    """What `third=` of an output was given, as it stands; OutputError where the output cannot do that."""
    known = (NONE, *WAYS[kind])
    if way not in known:
        raise OutputError(f"{kind}: third={way}; write third= with one of {', '.join(known)}")
    return way


def left_out(spec: str) -> str:
    """Why an output `KIND:ARGUMENT` sends no third axis, and what to write; empty where it does or nobody knows."""
    kind, _, argument = spec.partition(":")
    if kind not in WAYS or _given(argument) != NONE:
        return ""
    ways = " or ".join(f"third={way}" for way in WAYS[kind])
    what = "the third axis (the ball's spin) is not sent"
    return f"{what}: output {kind} has no `third=`; {ways} sends it (docs/third-axis.md)"


def sent_as(spec: str) -> str:
    """What an output sends the third axis as, in words; empty where it does not, or has no mouse."""
    kind, _, argument = spec.partition(":")
    return _WORDS.get(_given(argument), "") if kind in WAYS else ""


def _given(argument: str) -> str:
    found = [
        value.strip()
        for key, _, value in (part.partition("=") for part in argument.split(","))
        if key.strip() == "third"
    ]
    return found[0] if found else NONE
