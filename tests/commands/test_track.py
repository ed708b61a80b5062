"""`spheremouse track` refuses wrong requests before it tracks. `tests/test_api.py` checks its samples."""

from pathlib import Path

import pytest
from invoking import invoke

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
    code, text = invoke(app, "track", *words)
    assert code == 2
    assert message in text
    assert len(text.splitlines()) == 1
