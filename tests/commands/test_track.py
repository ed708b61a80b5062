"""`spheremouse track` refuses wrong requests before it tracks. `tests/test_api.py` checks its samples."""

import socket
from pathlib import Path

import pytest
from invoking import fail, invoke, succeed

from spheremouse.commands import app

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((CLIP / "nowhere", "--output", "text:-"), "nowhere"),
        ((CLIP, "--output", "nothing:x"), "nothing"),
        ((CLIP, "--smooth", "--set", "tracker=ekf1", "--output", "text:-"), "--smooth: there is no smoother for ekf1"),
        ((CLIP, "--set", "tracker=wand", "--output", "text:-"), "scene.json"),
        ((CLIP, "--output", "null", "--output", "null"), "null is given twice"),
    ],
)
def test_a_wrong_request_is_one_line(words, message):
    assert message in fail(app, "track", *words)


def test_an_output_that_cannot_be_opened_is_one_line_and_the_others_go_on(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken, file = f"tcp:{server.getsockname()[1]}", tmp_path / "a.txt"
        reason = "Address already in use; stop the other program, or take another port"
        wrong = "udp:9,formt=json"
        words = [word for spec in (taken, wrong, f"text:{file}") for word in ("--output", spec)]
        text = succeed(app, "track", CLIP, *words)
        assert f"output {taken}: {reason}\n" in text
        assert f"output {wrong}: unknown key formt; did you mean format or frame?\n" in text
        assert len(file.read_text().splitlines()) > 10
        assert invoke(app, "track", CLIP, "--output", taken) == (2, f"{taken}: {reason}")
