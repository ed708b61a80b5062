"""The examples of docs/examples run."""

import contextlib
import importlib
import itertools
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from reporting import free_port
from scipy.spatial.transform import Rotation

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


@pytest.mark.slow
def test_demo_plays_the_game_with_a_simulated_ball(game):
    command = [sys.executable, "-m", "spheremouse", "demo", "--play", "--seconds", "2"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert re.fullmatch(r"huts hit: \d+\n", run.stdout)


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


GODOT_3 = {  # names of Godot 4, and those of Debian's engine
    "Node3D": "Spatial",
    "receiver.bind(": "receiver.listen(",
    "quaternion = Quaternion(": "transform.basis = Basis(Quat(",
    "get_float(), w)": "get_float(), w))",
}
PRINTED = """
func _physics_process(_delta):
\tvar b = transform.basis
\tprint([b.x.x, b.x.y, b.x.z, b.y.x, b.y.y, b.y.z, b.z.x, b.z.y, b.z.z])
"""


@pytest.mark.skipif(shutil.which("godot3-server") is None, reason="apt-get install godot3-server")
def test_godot_turns_a_node_as_the_ball_turns(tmp_path):
    script, port = (EXAMPLES / "ball.gd").read_text(encoding="utf-8"), free_port()
    for new, old in GODOT_3.items():
        assert new in script
        script = script.replace(new, old)
    (tmp_path / "ball.gd").write_text(script.replace("9000", str(port)) + PRINTED)
    (tmp_path / "main.tscn").write_text(
        '[gd_scene load_steps=2 format=2]\n[ext_resource path="res://ball.gd" type="Script" id=1]\n'
        '[node name="Ball" type="Spatial"]\nscript = ExtResource( 1 )\n'
    )
    (tmp_path / "project.godot").write_text('config_version=4\n[application]\nrun/main_scene="res://main.tscn"\n')
    R = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    sample = replace(turning((0.1, 0.0, 0.0)), estimate=turning((0.0, 0.0, 0.0)).estimate._replace(rotation=R))
    command = ["godot3-server", "--path", tmp_path]
    with (
        open_output(f"osc:{port}") as output,
        subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=os.environ | {"HOME": str(tmp_path)}
        ) as engine,
    ):
        assert engine.stdout is not None
        basis = np.zeros((3, 3))
        for line in itertools.islice(engine.stdout, 1000):
            output.send(Report((0, 0, 0), None, 0.0, (sample,)))
            if line.startswith("["):
                basis = np.array(json.loads(line)).reshape(3, 3).T  # its vectors are the columns of the rotation
            if np.allclose(basis, R, rtol=0.0, atol=1e-5):
                break
        engine.terminate()
    assert np.allclose(basis, R, rtol=0.0, atol=1e-5)


def test_unity_gets_the_attitude_in_its_left_handed_axes():
    """The quaternion's rotation matrix is R_obj_ball with the sign of Z changed in both frames."""
    script = (EXAMPLES / "Ball.cs").read_text(encoding="utf-8")
    made = re.findall(r"(-?)q\.GetElementAsFloat\((\d)\)", script)
    R, mirror = Rotation.from_rotvec([0.4, -0.7, 1.1]), np.diag([1.0, 1.0, -1.0])
    wxyz = R.as_quat(canonical=True, scalar_first=True)
    xyzw = [(-1.0 if sign else 1.0) * wxyz[int(k)] for sign, k in made]
    assert np.allclose(Rotation.from_quat(xyzw).as_matrix(), mirror @ R.as_matrix() @ mirror)


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
