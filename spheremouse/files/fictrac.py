"""Read a configuration of FicTrac 2.1: lines of `key : value`, with lists in braces.

Keys and values are those of FicTrac's doc/params.md and of the files that its configGui writes. The last of several
lines of a key counts, as in FicTrac.
"""

import re
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from spheremouse.errors import ConfigurationError, os_errors_as
from spheremouse.files.safe_files import read_text
from spheremouse.files.validate import nearest

_MAX_BYTES = 1_000_000
_MAX_NUMBER = 1e6  # of all numbers; com_baud has 115200
_TEXT, _NUMBER, _FLAG, _LIST, _LISTS = "text", "a number", "y or n", "a list { a, b, ... }", "lists { { a, b, ... } }"
_PIXELS = "all pixels of the ball count, by their noise"
_SHOWN = "`spheremouse view` and `run --overlay` show the run"
_SEARCHED = "a lost ball is searched by itself"
_CONTRAST = "contrast takes the place of thresholds"
_GROUPS = (  # reason why a key is not needed, form of its value, keys
    ("", _TEXT, "src_fn c2a_src sock_host"),
    ("", _NUMBER, "vfov roi_r sock_port"),
    ("", _LIST, "roi_c roi_circ c2a_r c2a_cnrs_xy c2a_cnrs_yz c2a_cnrs_xz"),
    ("", _LISTS, "roi_ignr"),
    ("", _FLAG, "fisheye"),
    (_PIXELS, _NUMBER, "q_factor opt_max_evals opt_bound opt_tol opt_max_err"),
    (_SEARCHED, _NUMBER, "max_bad_frames"),
    (_SEARCHED, _FLAG, "opt_do_global"),
    (_CONTRAST, _NUMBER, "thr_ratio thr_win_pc"),
    (_CONTRAST, _TEXT, "thr_rgb_tfrm"),
    (_SHOWN, _FLAG, "do_display save_debug"),
    ("`spheremouse ctl record` records", _FLAG, "save_raw"),
    ("recordings are lossless", _TEXT, "vid_codec"),
    ("the stamps of film or camera count; `camera.fps` sets a camera's rate", _NUMBER, "src_fps"),
    ("a rotation needs no place", _LIST, "c2a_t"),
    ("use sock_port: no output writes FicTrac's lines to a serial port", _TEXT, "com_port com_baud"),
    ("the ball's pattern is learnt at each start", _TEXT, "sphere_map_fn"),
    ("it has no effect on the tracking", _TEXT, "output_fn out_port do_socket socket_port reconfig enh_cfg_disp"),
)
KEYS = {key: (form, reason) for reason, form, keys in _GROUPS for key in keys.split()}


class FicTracConfig(NamedTuple):
    """Values of a configuration by their keys, with their lines."""

    path: Path
    values: dict[str, Any]
    lines: dict[str, int]

    def refuse(self, key: str, problem: str, hint: str) -> NoReturn:
        """Raise ConfigurationError about the value of a key, with its line if there is one."""
        line = f":{self.lines[key]}" if key in self.lines else ""
        raise ConfigurationError(f"{self.path}{line}: {key}: {problem}", hint)

    def numbers(self, key: str, n: int, least: int = 0) -> tuple[float, ...]:
        """Return the numbers of a list, () without the key: `n` of them, or pairs, at least `least`, if n is 2."""
        found = self.values.get(key, ())
        if key in self.values and (len(found) % n or len(found) < max(n, least)):
            wanted = f"{n} numbers" if n != 2 else f"at least {least // 2} points x, y"
            self.refuse(key, f"must be {wanted}, has {len(found)} numbers", "run configGui again, or correct the line")
        return found


def read_fictrac(path: Path) -> FicTracConfig:
    """Read a configuration. Raises ConfigurationError, with the line, for an unknown key or a value of another form."""
    with os_errors_as(ConfigurationError, f"{path}: cannot be read"):
        try:
            text = read_text(path, _MAX_BYTES, "FicTrac configuration")
        except UnicodeDecodeError:
            raise ConfigurationError(f"{path}: is no text; name FicTrac's config.txt") from None
    config = FicTracConfig(path, {}, {})
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith(("#", "%")):
            continue
        key, colon, value = (part.strip(" ,\t") for part in line.partition(":"))
        config.lines[key] = number
        if not colon:
            raise ConfigurationError(f"{path}:{number}: is no `key : value`", "delete it, or begin it with #")
        if key not in KEYS:
            advice = nearest(key, list(KEYS), otherwise="is this FicTrac's config.txt?")
            config.refuse(key, "unknown key", f"{advice} Correct the key, or begin the line with #")
        config.values[key] = _value(config, key, value, KEYS[key][0])
    return config


def _value(config: FicTracConfig, key: str, text: str, form: str) -> Any:
    """Parse the value of a key by the form of its text; a wrong one is refused with its line."""
    try:
        if form == _NUMBER:
            return _number(text)
        if form == _FLAG:
            return {"y": True, "1": True, "n": False, "0": False}[text.lower()]
        if form == _LIST:
            return _numbers(re.fullmatch(r"\{([^{}]*)\}", text)[1])  # type: ignore[index]
        if form == _LISTS:
            inner = re.fullmatch(r"\{((?:\s*,?\s*\{[^{}]*\})*)\s*\}", text)[1]  # type: ignore[index]
            return tuple(filter(None, map(_numbers, re.findall(r"\{([^{}]*)\}", inner))))
    except (KeyError, TypeError, ValueError):
        config.refuse(key, f"must be {form}, is {text[:40]!r}", "correct the line, or run configGui again")
    return text


def _number(text: str) -> float:
    value = float(text)
    if not abs(value) <= _MAX_NUMBER:  # nan is not
        raise ValueError(text)
    return value


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(_number, text.replace(",", " ").split()))
