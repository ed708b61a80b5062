"""The examples of docs/examples run."""

import contextlib
import importlib
import itertools
import json
import re
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle

from spheremouse.output import Report, open_output
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status, unknown

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
CLIP = Path(__file__).parent / "data" / "far26_clip"


def turning(vector, sequence=1):
    estimate = unknown(sequence / 30.0, sequence, Status.TRACKING)
    return Sample(estimate._replace(increment=np.array([*vector, 0.0, 0.0, 0.0]), confirmed=True))


@pytest.fixture
def game(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    pytest.importorskip("pygame")
    return importlib.import_module("spheremouse.commands.demo.boulder")


@pytest.mark.parametrize(("direction", "hits"), [(1.0, 1), (-1.0, 0)])
def test_the_boulder_rolls_right_over_the_first_hut(game, direction, hits):
    """The hut is 200 px to the right. For a player on the far side, a push to the right is a turn about +Z of `obj`."""
    steps = 20
    turn = direction * 200.0 / game.ROLL / steps
    assert game.play([turning((0.0, 0.0, turn))] * steps) == hits


def test_closing_the_window_ends_the_game(game):
    import pygame

    def samples():
        for k in itertools.count():
            if k == 5:
                pygame.event.post(pygame.event.Event(pygame.QUIT))
            assert k < 10
            yield turning((0.0, 0.0, 0.0))

    assert game.play(samples()) == 0


def test_demo_plays_the_game_with_a_simulated_ball(game):
    command = [sys.executable, "-m", "spheremouse", "demo", "--play", "--seconds", "2"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert re.fullmatch(r"huts hit: \d+\n", run.stdout)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_the_client_of_fictrac_reads_our_lines():
    port, lines = free_port(), []
    client = subprocess.Popen(
        [sys.executable, EXAMPLES / "fictrac_client.py", str(port)], stdout=subprocess.PIPE, text=True
    )
    reader = threading.Thread(target=lambda: lines.append(client.stdout.readline()))
    reader.start()
    try:
        with open_output(f"udp:127.0.0.1:{port},format=fictrac") as output:
            while reader.is_alive():  # the client may not listen yet
                output.send(Report((0, 0, 0), None, 0.0, (turning((0.3, 0.0, 0.4), sequence=6),)))
                reader.join(0.05)
    finally:
        client.kill()
        client.communicate()
    assert re.match(r"frame 7: heading [\d.]+ rad, speed 0\.5 rad a frame, \d+", lines[0]), lines


@pytest.mark.parametrize("name", ["ball.gd", "Ball.cs"])
def test_the_scripts_of_game_engines_read_messages_that_we_send(name):
    """Addresses and number of values alone: no engine runs here."""
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5.0)
        with contextlib.closing(open_output(f"osc:127.0.0.1:{receiver.getsockname()[1]}")) as output:
            output.send(Report((0, 0, 0), None, 0.0, (turning((0.1, 0.0, 0.0)),)))
            sent = {m.address: m.params for m in OscBundle(receiver.recv(65536))}
    read = set(re.findall(r'"(/spheremouse/[^"]+)"', text))
    assert read == {"/spheremouse/1/quaternion"}
    assert sent[read.pop()] == [1.0, 0.0, 0.0, 0.0]


def test_the_notebook_runs_from_top_to_bottom(tmp_path, monkeypatch):
    """And the errors that it plots are within their bands."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / "roll").symlink_to(CLIP)
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((EXAMPLES / "attitude.ipynb").read_text(encoding="utf-8"))
    there = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec("".join(cell["source"]), there)
    assert len(there["smoothed"]) == 50
    assert (np.abs(there["error"]) <= 3.0 * there["sigma"] + 1e-9).mean() > 0.98
    assert [len(axis.lines) for axis in there["axes"].flat] == [2] * 6
