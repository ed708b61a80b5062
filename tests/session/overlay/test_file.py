"""Files of overlays: complete under their name or not there, and nothing else is lost."""

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from spheremouse.commands import app
from spheremouse.errors import OutputError, SpheremouseError
from spheremouse.files.wand import save_wand
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.wand.ball import grzonka_ball


def test_a_file_has_its_name_only_when_it_is_complete(tmp_path):
    path = tmp_path / "seen.mp4"
    with OverlayFile(path, 30.0) as file:
        for k in range(3):
            file.show(lambda level=k: np.full((480, 640, 3), 80 * level, np.uint8))
            assert not path.exists()
            assert len(list(tmp_path.iterdir())) == 1
    assert list(tmp_path.iterdir()) == [path]
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(30.0)
    read = [capture.read()[0] for _ in range(4)]
    capture.release()
    assert read == [True, True, True, False]


def test_no_frame_gives_no_file(tmp_path):
    for name in ("seen.png", "seen.avi"):
        with OverlayFile(tmp_path / name, None):
            pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["seen.gif", "seen", "nowhere/seen.png"])
def test_what_cannot_be_written_is_refused_at_once(tmp_path, name):
    with pytest.raises(OutputError, match=name):
        OverlayFile(tmp_path / name, 30.0)


@pytest.mark.parametrize(
    "name",
    ["film/video.mkv", "film/scene.json", "film/frames/000000.png", "axes.png", "out.mp4", "ball.avi", "folder.mp4"],
)
@pytest.mark.slow
def test_an_overlay_destroys_nothing_that_the_run_needs(tmp_path, name):
    film = prepare_wand(WandOptions(motion="hand", size=(320, 240), seconds=0.2, seed=2))
    list(write_wand(tmp_path / "film", film))
    (tmp_path / "film" / "frames").mkdir()  # as recordings of single frames have it
    (tmp_path / "film" / "frames" / "000000.png").write_bytes(b"a frame")
    save_wand(tmp_path / "ball.avi", grzonka_ball())
    (tmp_path / "folder.mp4").mkdir()
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    words = ["--output", f"text:{tmp_path / 'out.mp4'}", "--output", f"text:{tmp_path / 'axes.png'}"]
    told = CliRunner().invoke(
        app, ["run", "--tracker", "wand", "--source", f"dataset:{tmp_path / 'film'}", *words,
              "--ball", str(tmp_path / "ball.avi"), "--overlay", str(tmp_path / name)],
    )  # fmt: skip
    assert isinstance(told.exception, SpheremouseError)
    assert str(tmp_path / name) in str(told.exception)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
