"""The option `third=` of mouse outputs: how they send the ball's spin, an axis that a mouse does not have."""

from spheremouse.errors import OutputError

NONE = "none"
WAYS = {  # values of `third=` for each kind, besides `none`
    "auto": ("wheel",),  # the only one that all three outputs have
    "desktop": ("wheel",),
    "serial": ("wheel", "pan"),
    "uinput": ("wheel", "rz"),
}
_WORDS = {"wheel": "the wheel (REL_WHEEL_HI_RES)", "rz": "REL_RZ", "pan": "the sideways wheel (REL_HWHEEL_HI_RES)"}


def checked(kind: str, third: str) -> str:
    """Return the value of `third=`. Raise OutputError if the output does not have it."""
    known = (NONE, *WAYS[kind])
    if third not in known:
        raise OutputError(f"{kind}: third={third}; write third= with one of {', '.join(known)}")
    return third


def left_out(spec: str) -> str:
    """Return the hint for an output `KIND:ARGUMENT` that does not send the spin; empty if it does or is a plug-in."""
    kind, _, argument = spec.partition(":")
    if kind not in WAYS or _given(argument) != NONE:
        return ""
    ways = " or ".join(f"third={way}" for way in WAYS[kind])
    what = "the third axis (the ball's spin) is not sent"
    return f"{what}: output {kind} has no `third=`; {ways} sends it (docs/outputs.md)"


def sent_as(spec: str) -> str:
    """Return the axis that carries the spin of an output `KIND:ARGUMENT`, in words; empty if there is none."""
    kind, _, argument = spec.partition(":")
    return _WORDS.get(_given(argument), "") if kind in WAYS else ""


def _given(argument: str) -> str:
    found = [
        value.strip()
        for key, _, value in (part.partition("=") for part in argument.split(","))
        if key.strip() == "third"
    ]
    return found[0] if found else NONE
