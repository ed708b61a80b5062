"""Outputs: lines into real files and pipes, and the events of the mouse as text; the device itself in tests/system."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reporting import refused, report

from spheremouse.files import registry
from spheremouse.output import gamepad, open_output, uinput
from spheremouse.output.lines import count_lines
from spheremouse.output.third_axis import NOTCH

REPOSITORY = Path(__file__).parents[2]


finite = st.floats(allow_nan=False, allow_infinity=False)


def turned(x=0, y=0, z=0, stamp=1.5):
    return report(x, y, z, stamp=stamp, rotation=(0.1, -0.2, 1e-17), rate=(1 / 3, 0.0, np.nan))


# ---- text ----


def counts_log(path):
    return f"text:{path},format=counts"


def test_a_log_of_counts_is_a_header_and_a_line_per_report(tmp_path):
    path = tmp_path / "log.txt"
    with open_output(counts_log(path)) as output:
        output.send(turned(3, -2, 0))
        assert path.read_text().count("\n") == 2  # every line is out at once
        output.send(turned(stamp=2.0))
    assert path.read_text().splitlines() == ["# stamp dx dy dz (s, counts)", "1.5 3 -2 0", "2.0 0 0 0"]


@given(finite, st.tuples(*[st.integers(-(2**63), 2**63)] * 3))
def test_stamp_and_counts_read_back_exactly(stamp, counts):
    (line,) = count_lines(report(*counts, stamp=stamp))
    read, *whole = line.split()
    assert float(read) == stamp
    assert tuple(map(int, whole)) == counts


def test_standard_output(capsys):
    for spec in ("text:-,format=counts", "text:,format=counts"):
        with open_output(spec) as output:
            output.send(turned(1, 2, 3))
        assert capsys.readouterr().out == "# stamp dx dy dz (s, counts)\n1.5 1 2 3\n"
    with open_output("text") as output:
        output.send(turned(1, 2, 3))
    assert json.loads(capsys.readouterr().out)["counts"] == [1, 2, 3]


def test_a_log_is_continued_and_no_other_file_is_written_to(tmp_path):
    log, rig = tmp_path / "log.txt", tmp_path / "rig.yaml"
    rig.write_text("schema: 1\n")
    log.touch()
    for runs in (1, 2, 3):
        with open_output(f"text:{log}") as output:
            output.send(turned(runs))
        assert [json.loads(line)["counts"][0] for line in log.read_text().splitlines()] == [*range(1, runs + 1)]
    for spec in (f"text:{rig}", counts_log(log)):
        assert refused(spec).endswith(": exists and is no log in this format; choose another name or remove it")
    assert rig.read_text() == "schema: 1\n"


def test_a_log_on_a_full_disk_keeps_its_whole_lines_when_it_is_opened_again(tmp_path):
    log = tmp_path / "log.txt"
    for cut in ("1.5 2 0 0\n1.5 0 0", "1.5 0 0"):  # what a full disk leaves
        log.write_text(f"# stamp dx dy dz\n1.5 1 0 0\n{cut}")
        whole = log.read_text().rpartition("\n")[0]
        with open_output(counts_log(log)) as output:
            output.send(turned(3))
        assert log.read_text() == f"{whole}\n# stamp dx dy dz (s, counts)\n1.5 3 0 0\n"


def test_files_that_cannot_be_written(tmp_path):
    assert "Is a directory" in refused(f"text:{tmp_path}")
    assert "No such file or directory" in refused(f"text:{tmp_path / 'no' / 'log.txt'}")
    assert "cannot be written" in refused("text:a\0b")
    assert refused("text:/dev/full,format=counts") == "/dev/full: cannot be written: No space left on device"


PROGRAM = """
from spheremouse.errors import OutputError
from spheremouse.output import Report, open_output
sent = 0
try:
    with open_output("text:-,format=counts") as output:
        for sent in range(100_000):
            output.send(Report((1, 2, 3), None, sent / 30))
except OutputError as e:
    print(e, file=__import__("sys").stderr)
print("ended quietly", sent < 99_999, file=__import__("sys").stderr)
"""


def test_a_reader_that_goes_away_is_a_quiet_end():
    """A real pipe, as in `spheremouse run --output text:- | head`."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=REPOSITORY
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == "ended quietly True\n"
    assert process.returncode == 0


def test_standard_output_on_a_full_disk_is_one_line():
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-c", PROGRAM], stdout=full, stderr=subprocess.PIPE, text=True, cwd=REPOSITORY, check=True
        )
    assert run.stderr == "standard output: cannot be written: No space left on device\nended quietly True\n"


# ---- the mouse, as far as text tells it ----


@pytest.mark.parametrize(
    ("third", "counts", "words"),
    [
        ("none", (3, -2, 9), "REL_X +3 REL_Y -2"),
        ("none", (0, 5, 0), "REL_Y +5"),
        ("none", (0, 0, 7), ""),
        ("none", (0, 0, 0), ""),
        ("rz", (1, 0, -7), "REL_X +1 REL_RZ -7"),
        ("rz", (0, 0, 0), ""),
        ("wheel", (0, 0, 119), "REL_WHEEL_HI_RES +119"),
        ("wheel", (1, 1, -250), "REL_X +1 REL_Y +1 REL_WHEEL -2 REL_WHEEL_HI_RES -250"),
        ("none", (2**31, -(2**40), 0), "REL_X +2147483647 REL_Y -2147483647"),
        ("none", (40_000, -40_000, 0), "REL_X +40000 REL_Y -40000"),
    ],
)
def test_to_events_a_motion(third, counts, words):
    expected = [
        (getattr(uinput, name), int(n)) for name, n in zip(words.split()[::2], words.split()[1::2], strict=True)
    ]
    assert uinput.to_events(turned(*counts), third)[0] == expected


@given(st.lists(st.integers(-500, 500), max_size=50))
def test_notches_follow_the_fine_wheel(turns):
    """Whole notches never lag the sum of the fine ones by a notch, whichever way it turns."""
    notch = fine = whole = 0
    for z in turns:
        made, notch = uinput.to_events(turned(z=z), "wheel", notch)
        events = dict(made)
        fine += events.get(uinput.REL_WHEEL_HI_RES, 0)
        whole += events.get(uinput.REL_WHEEL, 0)
        assert 0 not in events.values()
        assert fine - whole * NOTCH == notch
        assert abs(notch) < NOTCH
    assert fine == sum(turns)


def test_the_numbers_are_the_kernels():
    ecodes = vars(pytest.importorskip("evdev").ecodes)
    ours = vars(uinput) | vars(gamepad)
    named = {name: n for name, n in ours.items() if name.startswith(("EV_", "REL_", "ABS_", "BTN_", "SYN_"))}
    assert len(named) == 23
    assert named == {name: ecodes[name] for name in named}
    assert ecodes["BUS_VIRTUAL"] == uinput.BUS


@pytest.mark.parametrize("kind", ["uinput", "gamepad"])
def test_a_device_where_it_cannot_be_made(kind):
    if os.path.exists("/dev/uinput"):
        pytest.skip("/dev/uinput is here; tests/system uses it")
    assert refused(kind) == f"{kind}: /dev/uinput does not exist; as root: modprobe uinput"


# ---- all ----


def test_the_plug_in_of_the_docs_prints_what_it_gets(monkeypatch, capsys):
    page = (REPOSITORY / "docs" / "plugins.md").read_text()
    module = ModuleType("lamp")
    exec(re.findall(r"```python\n(.*?)```", page, re.S)[0], module.__dict__)
    plug_ins = [SimpleNamespace(name="lamp", value="lamp", load=lambda: module)]
    monkeypatch.setattr(registry, "entry_points", lambda group: plug_ins)
    with open_output("lamp:red,gain=2") as lamp:
        lamp.send(report(1, -2, 3, rate=(0.5, 0.0, 0.0)))
    assert capsys.readouterr().out == "red (1, -2, 3) [0.5 0.  0. ]\n"


def test_an_unknown_kind_names_the_nearest_or_all():
    assert refused("txt:-") == "unknown output 'txt:-'; did you mean text?"
    assert "known here: auto, csv, " in refused("xyzzy:-")


@pytest.mark.parametrize("kind", ["udp", "tcp", "osc"])
def test_a_bad_address_names_a_right_one(kind):
    for bad in ("", "localhost", "127.0.0.1:http", "127.0.0.1:0", "127.0.0.1:65536", "a:-1"):
        assert refused(f"{kind}:{bad}") == f"{kind}:{bad}: is not HOST:PORT; write for example {kind}:127.0.0.1:9000"
    assert refused(f"{kind}:nowhere.invalid:9").startswith(f"{kind}:nowhere.invalid:9: unknown host: ")
    assert refused(f"{kind}:9,gian=2") == f"{kind}:9,gian=2: unknown key gian; did you mean gain?"


@pytest.mark.parametrize(("kind", "package"), [("parquet", "pyarrow"), ("lsl", "pylsl")])
def test_a_missing_package_is_named_with_its_extra(monkeypatch, kind, package):
    monkeypatch.setitem(sys.modules, package, None)
    assert refused(f"{kind}:a") == f"{kind}: needs the package {package}; pip install 'spheremouse[{kind}]'"


def send_and_fail(spec):
    with open_output(spec) as output:
        output.send(turned(1))
        raise ZeroDivisionError


def test_leaving_does_not_hide_errors(tmp_path):
    for spec in (f"text:{tmp_path / 'log.txt'}", "null"):
        with pytest.raises(ZeroDivisionError):
            send_and_fail(spec)
    assert "takes no argument" in refused("null:x")
