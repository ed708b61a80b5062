"""`spheremouse calibrate print`: pages are true to scale, OpenCV and the tracker find what is on them."""

import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.ball.rig import CODES
from spheremouse.calibrate.board import Board
from spheremouse.calibrate.prints.page import PAPERS, figure_of, pdf
from spheremouse.calibrate.prints.sheets import (
    board_page,
    charuco,
    chessboard,
    disc_pages,
    largest_square,
    recipe,
    target_pages,
)
from spheremouse.commands import app
from spheremouse.errors import SpheremouseError

matplotlib = pytest.importorskip("matplotlib")

COMMITTED = Path(__file__).parents[3] / "calibration" / "print"
LOCK = Path(__file__).parents[2] / "requirements.lock"
BOARD = Board(11, 8)


def run(*words):
    return CliRunner().invoke(app, ["calibrate", "print", *map(str, words)], catch_exceptions=False)


def shapes(figure, kind):
    """Patches of a page in mm: `kind` fill or line, in the order of drawing."""
    (axes,) = figure.axes
    return [p for p in sorted(axes.patches, key=lambda p: p.zorder) if p.get_fill() == (kind == "fill")]


def box(patch):
    return patch.get_path().get_extents(patch.get_patch_transform()).extents


def raster(page, dpi):
    """BGR picture of a page; pixel (0, 0) is centred half a pixel from the corner."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with matplotlib.rc_context({"path.snap": False, "path.simplify": False}):
        figure = figure_of(page)
        figure.set_dpi(dpi)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, 2::-1])


def grey(picture):
    return cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)


@pytest.mark.slow
@pytest.mark.parametrize("paper", [pytest.param("a0", marks=pytest.mark.slow), "a4", "letter"])
def test_every_page_has_its_paper_s_size_and_two_rulers_of_100_mm(paper):
    square = largest_square(BOARD, paper)
    pages = [
        target_pages((12, 24, 36), paper)[-1],
        disc_pages(26, 20, paper)[-1],
        board_page(chessboard(BOARD, square), paper),
        board_page(charuco(BOARD, square), paper),
    ]
    points = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", pdf(pages, "test"))
    for page, size in zip(pages, 25.4 / 72.0 * np.array(points, dtype=float), strict=True):
        assert_allclose(size, (page.paper.width, page.paper.height), atol=0.01)
        assert_allclose(sorted(size), PAPERS[paper], atol=0.01)
    for page in (disc_pages(26, 20, paper)[-1], board_page(chessboard(BOARD, square), paper)):
        figure = figure_of(page)
        (axes,) = figure.axes
        scale = figure.dpi_scale_trans.inverted()
        assert_allclose(25.4 * scale.transform(axes.transData.transform([[0, 0], [100, 100]])), [[0, 0], [100, 100]])
        rulers = [p.get_path().vertices.reshape(-1, 2, 2) for p in shapes(figure, "line")]
        rulers = [r for r in rulers if len(r) == 102]
        assert len(rulers) == 2
        for ruler, axis in zip(rulers, (0, 1), strict=True):
            assert_allclose(np.diff(ruler[:-1, 0, axis]), 1.0)
            assert_allclose(np.ptp(ruler[-1, :, axis]), 100.0)
        boxes = np.array([box(p) for kind in ("fill", "line") for p in shapes(figure, kind)])
        assert boxes[:, :2].min() >= 5.0  # the printer's margin
        assert np.all(boxes[:, 2:] <= np.array([page.paper.width, page.paper.height]) - 5.0)


def test_targets_have_their_radii_and_the_tracker_reads_their_codes_where_they_are():
    found = {}
    for page, again in zip(*(target_pages((12.0, 24.0, 36.0), "a4") for _ in range(2)), strict=True):
        circles = np.array([box(p) for p in shapes(figure_of(page), "fill")])
        sizes = circles[:, 2:] - circles[:, :2]
        assert_allclose(sizes, np.tile([[72.0], [48.0], [24.0]], (len(circles) // 3, 2)))
        centres, dpi = (circles[:, :2] + circles[:, 2:]) / 2, 100
        seen = detect_targets(raster(again, dpi), np.array([12.0, 24.0, 36.0]), RingSettings())
        at = (seen.centre + 0.5) * 25.4 / dpi
        at[:, 1] = page.paper.height - at[:, 1]
        for code, centre, radius in zip(seen.codes, at, seen.radius, strict=True):
            found[code] = radius * 25.4 / dpi
            assert np.min(np.linalg.norm(centres - centre, axis=1)) < 0.1  # half a pixel
    assert sorted(found) == sorted(CODES)
    assert_allclose(list(found.values()), 36.0, atol=0.1)


def test_many_small_targets_share_a_page_and_large_ones_are_refused():
    assert len(target_pages((5.0, 10.0, 15.0), "a4")) == 1
    assert len(target_pages((25.0, 50.0, 70.0), "a4")) == 6
    with pytest.raises(SpheremouseError, match=r"does not fit on a4.*a larger --paper"):
        target_pages((40.0, 80.0, 120.0), "a4")


def test_discs_are_as_many_and_as_large_as_asked_for():
    n, radius = 50, 17.0
    figures = [figure_of(page) for page in disc_pages(n, radius, "letter")]
    black = np.array([box(p) for figure in figures for p in shapes(figure, "fill")])
    cut = [box(p) for f in figures for p in shapes(f, "line") if isinstance(p, matplotlib.patches.Circle)]
    assert len(black) == n
    assert_allclose(black[:, 2:] - black[:, :2], 2 * radius)
    assert_allclose(np.array(cut), black + np.array([-1.0, -1.0, 1.0, 1.0]))
    words = [t.get_text() for figure in figures for t in figure.axes[0].texts]
    assert set(map(str, range(1, n + 1))) <= set(words)


@pytest.mark.parametrize("paper", ["a4", "letter", "a3"])
def test_opencv_finds_the_chessboard_at_its_scale(paper):
    square, dpi = largest_square(BOARD, paper), 100
    picture = grey(raster(board_page(chessboard(BOARD, square), paper), dpi))
    assert cv2.findChessboardCorners(picture, tuple(BOARD))[0]
    found, corners = cv2.findChessboardCornersSB(picture, tuple(BOARD))
    assert found
    check_grid(corners.reshape(BOARD.rows, BOARD.columns, 2) * 25.4 / dpi, square)


def check_grid(corners, square, atol=0.04):
    """Corners (rows, columns, 2) in mm are a grid of that square."""
    assert_allclose(np.linalg.norm(np.diff(corners, axis=0), axis=2), square, atol=atol)
    assert_allclose(np.linalg.norm(np.diff(corners, axis=1), axis=2), square, atol=atol)
    span = np.linalg.norm(corners[-1, -1] - corners[0, 0])
    assert_allclose(span, square * np.hypot(*(np.array(corners.shape[:2]) - 1)), rtol=2e-4)


def detector(name):
    """OpenCV's detector for the board that a file's name tells."""
    found = re.match(r"charuco-(\d+)x(\d+)-([\d.]+)mm-([\d.]+)mm-(\dx\d_\d+)", name)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{found[5].upper()}"))
    size = int(found[1]) + 1, int(found[2]) + 1
    return cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(size, float(found[3]), float(found[4]), dictionary))


@pytest.mark.parametrize(
    ("board", "paper", "dictionary"),
    [
        (BOARD, "a4", "_100"),
        (Board(6, 9), "letter", "_100"),
        (Board(5, 4), "a4", "_100"),
        (Board(17, 13), "a4", "_250"),
    ],
)
def test_opencv_finds_the_charuco_board_at_its_scale(board, paper, dictionary):
    square, dpi = largest_square(board, paper), 150
    pattern = charuco(board, square)
    assert pattern.file.endswith(dictionary)  # enough markers
    corners, ids, *_ = detector(pattern.file).detectBoard(grey(raster(board_page(pattern, paper), dpi)))
    assert np.ravel(ids).tolist() == list(range(board.columns * board.rows))
    check_grid(corners.reshape(board.rows, board.columns, 2) * 25.4 / dpi, square)


def test_a_board_of_more_markers_than_any_dictionary_has_is_refused():
    with pytest.raises(SpheremouseError, match="there are 1000 codes"):
        charuco(Board(99, 99), 10.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("print")
    run("--out", folder)
    return folder


def test_what_is_in_the_repository_is_what_the_command_makes(made):
    """Another version of matplotlib may write other bytes."""
    assert sorted(p.name for p in COMMITTED.iterdir()) == sorted(p.name for p in made.iterdir())
    locked = re.search(r"^matplotlib==(\S+)", LOCK.read_text(), re.MULTILINE)[1]
    for path in COMMITTED.iterdir():
        assert path.stat().st_size < 100_000
        if path.suffix != ".pdf" or matplotlib.__version__ == locked:
            assert path.read_bytes() == (made / path.name).read_bytes(), path.name


def test_files_that_differ_are_left_alone_without_force(tmp_path):
    run("--out", tmp_path, "--only", "discs", "--discs", 1)
    (path,) = tmp_path.iterdir()
    good = path.read_bytes()
    run("--out", tmp_path, "--only", "discs", "--discs", 1)  # the same content is no obstacle
    path.write_bytes(b"mine")
    with pytest.raises(SpheremouseError, match=r"discs-1-20mm-a4\.pdf: exists with other contents.*--force"):
        run("--out", tmp_path, "--only", "discs", "--discs", 1, "--only", "recipe")
    assert path.read_bytes() == b"mine"
    assert len(list(tmp_path.iterdir())) == 1  # nor anything beside it
    run("--out", tmp_path, "--only", "discs", "--discs", 1, "--force")
    assert path.read_bytes() == good
    assert len(list(tmp_path.iterdir())) == 1


def test_a_pipe_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "discs-1-20mm-a4.pdf")
    with pytest.raises(SpheremouseError, match="exists with other contents"):
        run("--out", tmp_path, "--only", "discs", "--discs", 1)


def test_with_force_no_old_file_is_read(tmp_path, monkeypatch):
    """So a file that may not be read is replaced."""
    (tmp_path / "discs-1-20mm-a4.pdf").write_bytes(b"mine")
    monkeypatch.setattr("spheremouse.commands.calibrate.print.read_bytes", None)
    assert run("--out", tmp_path, "--only", "discs", "--discs", 1, "--force").exit_code == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--square", "2000mm"], "must be from 0.5 to 1000 mm"),
        (["--only", "boards", "--square", "300mm"], "does not fit on a4; take a smaller square or a larger --paper"),
        (["--ring-radii", "12/24"], "three radii"),
        (["--ring-radii", "36/24/12"], "must grow"),
        (["--ring-radii", "1.2.3/4/5"], "no length|three radii"),
        (["--only", "discs", "--disc-radius", "200mm"], "does not fit"),
        (["--only", "recipe", "--out", "/dev/null/x"], "cannot be written"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, words, message):
    with pytest.raises(SpheremouseError, match=message) as caught:
        run("--out", tmp_path, *words)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_the_recipe_names_the_board_that_was_printed():
    page = recipe(Board(9, 6), 30.0, "letter")
    assert "--board 9x6 --square 30mm" in page
    assert "--for camera --square 30mm" in page
    assert "11x8" not in page
    assert "size: Letter" in page
    assert page.count("<svg") == 3
    assert "sketch:" not in page
