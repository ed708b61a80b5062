"""`spheremouse calibrate print`: the PDF files are read back by a small reader of their own, measured and looked at.

What is measured is what stands in the file: paths in points, not what the drawing code meant.
"""

import os
import re
import subprocess
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.ball.rig import CODES
from spheremouse.calibrate.board import Board
from spheremouse.calibrate.prints.page import PAPERS, pdf
from spheremouse.calibrate.prints.recipe import recipe
from spheremouse.calibrate.prints.sheets import (
    board_page,
    charuco,
    chessboard,
    disc_pages,
    largest_square,
    target_pages,
)
from spheremouse.commands import app
from spheremouse.errors import SpheremouseError

pytest.importorskip("matplotlib")

COMMITTED = Path(__file__).parents[3] / "calibration" / "print"
MM = 25.4 / 72.0  # of a point
BOARD = Board(11, 8)
YELLOW, MAGENTA, CYAN, BLACK = (1, 1, 0), (1, 0, 1), (0, 1, 1), (0, 0, 0)


def run(*words):
    result = CliRunner().invoke(app, ["calibrate", "print", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


# ---- a reader of what a PDF page draws ----


@dataclass
class Drawn:
    fill: bool
    colour: tuple[float, ...]
    paths: list[np.ndarray]  # (n, 2) mm from the lower left corner

    @property
    def box(self):
        points = np.concatenate(self.paths)
        return np.concatenate([points.min(axis=0), points.max(axis=0)])


@dataclass
class Sheet:
    size: tuple[float, float]  # mm
    drawn: list[Drawn]
    words: list[str]

    def filled(self, colour):
        return [d for d in self.drawn if d.fill and np.allclose(d.colour, colour)]

    def raster(self, dpi):
        """BGR picture, each pixel as far as it is covered; pixel (0, 0) is centred half a pixel from the corner."""
        scale = dpi / 25.4
        w, h = (round(s * scale) for s in self.size)
        picture = np.full((h, w, 3), 255.0, np.float32)
        for d in self.drawn:
            paths = [np.stack([p[:, 0], self.size[1] - p[:, 1]], axis=1) * scale for p in d.paths]
            paths = [np.clip(p, 0.0, [w, h]) for p in paths]
            colour = 255.0 * np.array(d.colour[::-1], np.float32)
            if d.fill:
                cover = np.zeros((h, w), np.float32)
                for path in paths:
                    (x, y), part = covered(path)
                    cover[y : y + part.shape[0], x : x + part.shape[1]] += part
                cover = np.minimum(cover, 1.0)[:, :, None]
                picture += cover * (colour - picture)
            else:
                fixed = [np.rint(16 * (p - 0.5)).astype(np.int32) for p in paths]
                cv2.polylines(picture, fixed, False, colour.tolist(), 1, cv2.LINE_8, 4)
        return np.rint(picture).astype(np.uint8)


def covered(path):
    """Upper left pixel, and how much of each pixel a polygon covers: exact for a rectangle."""
    low, high = path.min(axis=0), path.max(axis=0)
    first = np.floor(low).astype(int)
    n = np.ceil(high).astype(int) - first
    if len(path) <= 5:
        x, y = (
            np.clip(np.minimum(np.arange(k) + 1.0, b - o) - np.maximum(np.arange(k), a - o), 0.0, 1.0)
            for k, a, b, o in zip(n, low, high, first, strict=True)
        )
        return first, np.outer(y, x)
    over = 8
    fine = np.zeros(over * n[::-1], np.uint8)
    cv2.fillPoly(fine, [np.rint(256 * ((path - first) * over - 0.5)).astype(np.int32)], 1, shift=8)
    return first, fine.reshape(n[1], over, n[0], over).mean(axis=(1, 3))


def read(data):
    """The sheets of a PDF as matplotlib writes them."""
    objects = {int(k): body for k, body in re.findall(rb"\n(\d+) 0 obj\n(.*?)\nendobj", data, re.DOTALL)}
    sheets = []
    for body in objects.values():
        if not re.search(rb"/Type /Page\b", body):
            continue
        box = [float(x) for x in re.search(rb"/MediaBox \[([^]]*)\]", body)[1].split()]
        assert box[:2] == [0.0, 0.0]
        content = objects[int(re.search(rb"/Contents (\d+) 0 R", body)[1])]
        head, stream = content.split(b"stream\n", 1)
        assert b"/FlateDecode" in head
        text = zlib.decompressobj().decompress(stream).decode("latin-1")
        drawn, words = draw(text)
        sheets.append(Sheet((box[2] * MM, box[3] * MM), drawn, words))
    return sheets


def draw(text):
    """Filled and stroked paths of a content stream, in mm, and the strings it shows."""
    string = r"\((?:\\.|[^\\()])*\)"
    shown = re.findall(rf"\[((?:\s|{string}|-?[\d.]+)*)\]\s*TJ|({string})\s*Tj", text)
    pieces = ["".join(s[1:-1] for s in re.findall(string, a or b)) for a, b in shown]
    strings = [re.sub(r"\\(.)", r"\1", s) for s in pieces]
    text = re.sub(string, " ", text)
    text = re.sub(r"\bBT\b.*?\bET\b", " ", text, flags=re.DOTALL)
    matrix, kept, numbers = np.eye(3), [], []
    fill, stroke, paths, drawn = BLACK, BLACK, [], []
    saved = []

    def at(x, y):
        return (np.array([x, y, 1.0]) @ matrix)[:2] * MM

    for token in text.split():
        if re.fullmatch(r"[-+]?\d*\.?\d+", token):
            numbers.append(float(token))
            continue
        n, numbers = numbers, []
        if token == "q":
            saved.append((matrix, fill, stroke))
        elif token == "Q":
            matrix, fill, stroke = saved.pop()
        elif token == "cm":
            matrix = np.array([[n[0], n[1], 0.0], [n[2], n[3], 0.0], [n[4], n[5], 1.0]]) @ matrix
        elif token in ("rg", "g"):
            fill = tuple(n * 3 if token == "g" else n)
        elif token in ("RG", "G"):
            stroke = tuple(n * 3 if token == "G" else n)
        elif token == "m":
            paths.append([at(*n)])
        elif token == "l":
            paths[-1].append(at(*n))
        elif token == "c":
            a, b, c, d = paths[-1][-1], at(*n[:2]), at(*n[2:4]), at(*n[4:])
            for t in np.linspace(0.0, 1.0, 25)[1:]:
                u = 1.0 - t
                paths[-1].append(u**3 * a + 3 * u * u * t * b + 3 * u * t * t * c + t**3 * d)
        elif token == "re":
            x, y, w, h = n
            paths.append([at(*p) for p in ((x, y), (x + w, y), (x + w, y + h), (x, y + h))])
        elif token in ("f", "f*", "B", "b", "S", "s", "n"):
            kept = [np.array(p) for p in paths]
            paths = []
            if token in ("f", "f*", "B", "b"):
                drawn.append(Drawn(True, fill, kept))
            if token in ("S", "s"):
                drawn.append(Drawn(False, stroke, kept))
    return drawn, strings


def sheets_of(pages):
    return read(pdf(pages, "test"))


def grey(picture):
    return cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)


# ---- scale ----


@pytest.mark.parametrize("paper", PAPERS)
def test_every_page_has_its_paper_s_size_and_two_rulers_of_100_mm(paper):
    square = largest_square(BOARD, paper)
    pages = [
        target_pages((12, 24, 36), paper)[-1],
        disc_pages(26, 20, paper)[-1],
        board_page(chessboard(BOARD, square), paper),
        board_page(charuco(BOARD, square), paper),
    ]
    for sheet in sheets_of(pages):
        assert_allclose(sorted(sheet.size), PAPERS[paper], atol=0.01)
        rulers = [d for d in sheet.drawn if not d.fill and len(d.paths) == 102]
        assert len(rulers) == 2
        for ruler, axis in zip(rulers, (0, 1), strict=True):
            marks = sorted(p[0, axis] for p in ruler.paths[:-1])
            assert_allclose(np.diff(marks), 1.0, atol=1e-4)
            assert_allclose(np.ptp(ruler.paths[-1][:, axis]), 100.0, atol=1e-4)
        assert any("100 mm" in w for w in sheet.words)
        boxes = np.array([d.box for d in sheet.drawn if not np.allclose(d.colour, 1.0)])
        assert boxes[:, :2].min() >= 5.0  # the printer's margin
        assert np.all(boxes[:, 2:] <= np.array(sheet.size) - 5.0)


# ---- targets ----


def test_targets_have_their_radii_and_the_tracker_reads_their_codes_where_they_are():
    found = {}
    for sheet in sheets_of(target_pages((12.0, 24.0, 36.0), "a4")):
        circles = [d.box for colour in (YELLOW, MAGENTA, CYAN) for d in sheet.filled(colour)]
        sizes = np.array([[b[2] - b[0], b[3] - b[1]] for b in circles])
        assert_allclose(sizes[:, 0], sizes[:, 1], atol=0.005)
        assert sorted(np.rint(sizes[:, 0])) == sorted([24.0, 48.0, 72.0] * (len(circles) // 3))
        assert_allclose(sizes, np.rint(sizes), atol=0.005)
        centres = np.array([[(b[0] + b[2]) / 2, (b[1] + b[3]) / 2] for b in circles])
        dpi = 100
        seen = detect_targets(sheet.raster(dpi), np.array([12.0, 24.0, 36.0]), RingSettings())
        at = (seen.centre + 0.5) * 25.4 / dpi
        at[:, 1] = sheet.size[1] - at[:, 1]
        for code, centre, radius in zip(seen.codes, at, seen.radius, strict=True):
            found[code] = radius * 25.4 / dpi
            assert np.min(np.linalg.norm(centres - centre, axis=1)) < 0.03
    assert sorted(found) == sorted(CODES)
    assert_allclose(list(found.values()), 36.0, atol=0.1)


def test_many_small_targets_share_a_page_and_large_ones_are_refused():
    assert len(target_pages((5.0, 10.0, 15.0), "a4")) == 1
    assert len(target_pages((25.0, 50.0, 70.0), "a4")) == 6
    with pytest.raises(SpheremouseError, match=r"does not fit on a4.*a larger --paper"):
        target_pages((40.0, 80.0, 120.0), "a4")


# ---- discs ----


def test_discs_are_as_many_and_as_large_as_asked_for():
    n, radius = 50, 17.0
    pages = disc_pages(n, radius, "letter")
    black, cut, numbers = [], [], []
    for sheet in sheets_of(pages):
        black += [d.box for d in sheet.filled(BLACK)]
        cut += [d.box for d in sheet.drawn if not d.fill and len(d.paths) == 1 and len(d.paths[0]) > 50]
        numbers += [int(w) for w in sheet.words if w.isdigit()]
    black, cut = np.array(black), np.array(cut)
    assert len(black) == n
    assert_allclose(black[:, 2:] - black[:, :2], 2 * radius, atol=0.005)
    assert_allclose(cut[:, 2:] - cut[:, :2], 2 * radius + 2.0, atol=0.005)
    assert_allclose(cut[:, :2] + cut[:, 2:], black[:, :2] + black[:, 2:], atol=0.005)
    assert set(range(1, n + 1)) <= set(numbers)


# ---- boards ----


@pytest.mark.parametrize("paper", ["a4", "letter", "a3"])
def test_opencv_finds_the_chessboard_at_its_scale(paper):
    square, dpi = largest_square(BOARD, paper), 100
    (sheet,) = sheets_of([board_page(chessboard(BOARD, square), paper)])
    picture = grey(sheet.raster(dpi))
    for find in (cv2.findChessboardCornersSB, cv2.findChessboardCorners):
        found, corners = find(picture, tuple(BOARD))
        assert found
    _, corners = cv2.findChessboardCornersSB(picture, tuple(BOARD))
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
    ("board", "paper"), [(BOARD, "a4"), (BOARD, "a3"), (Board(6, 9), "letter"), (Board(5, 4), "a4")]
)
def test_opencv_finds_the_charuco_board_at_its_scale(board, paper):
    square, dpi = largest_square(board, paper), 150
    pattern = charuco(board, square)
    (sheet,) = sheets_of([board_page(pattern, paper)])
    corners, ids, *_ = detector(pattern.file).detectBoard(grey(sheet.raster(dpi)))
    assert ids is not None
    assert np.ravel(ids).tolist() == list(range(board.columns * board.rows))
    check_grid(corners.reshape(board.rows, board.columns, 2) * 25.4 / dpi, square)


def test_a_charuco_board_of_many_markers_has_the_dictionary_for_them():
    board = Board(17, 13)  # 126 markers
    pattern = charuco(board, 10.0)
    assert "5x5_250" in pattern.file
    (sheet,) = sheets_of([board_page(pattern, "a4")])
    _, ids, *_ = detector(pattern.file).detectBoard(grey(sheet.raster(150)))
    assert len(ids) == board.columns * board.rows
    with pytest.raises(SpheremouseError, match="1000 can be told apart"):
        charuco(Board(99, 99), 10.0)


# ---- files ----


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("print")
    run("--out", folder)
    return folder


def test_what_is_in_the_repository_is_what_the_command_makes(made):
    """Another version of matplotlib may write other bytes; it must draw the same."""
    assert sorted(p.name for p in COMMITTED.iterdir()) == sorted(p.name for p in made.iterdir())
    for path in sorted(COMMITTED.iterdir()):
        data, again = path.read_bytes(), (made / path.name).read_bytes()
        assert len(data) < 100_000
        if path.suffix != ".pdf":
            assert data == again, path.name
            continue
        for one, other in zip(read(data), read(again), strict=True):
            assert len(one.drawn) == len(other.drawn)
            assert one.words == other.words
            for a, b in zip(one.drawn, other.drawn, strict=True):
                assert (a.fill, a.colour) == (b.fill, b.colour)
                assert_allclose(np.concatenate(a.paths), np.concatenate(b.paths), atol=1e-3)


def test_made_again_elsewhere_the_files_are_the_same_to_the_byte(made, tmp_path):
    matplotlibrc = tmp_path / "matplotlibrc"
    matplotlibrc.write_text("font.size: 20\nlines.linewidth: 5\nfont.family: serif\npdf.fonttype: 42\n")
    env = {**os.environ, "PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "MATPLOTLIBRC": str(matplotlibrc)}
    command = [sys.executable, "-m", "spheremouse", "calibrate", "print", "--out", str(tmp_path / "again")]
    subprocess.run(command, env=env, check=True, capture_output=True)
    for path in made.iterdir():
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes(), path.name


def test_files_that_differ_are_left_alone_without_force(tmp_path):
    run("--out", tmp_path, "--only", "discs", "--discs", 1)
    (path,) = tmp_path.iterdir()
    good = path.read_bytes()
    run("--out", tmp_path, "--only", "discs", "--discs", 1)  # the same content is no obstacle
    path.write_bytes(b"mine")
    with pytest.raises(SpheremouseError, match=r"discs-1-20mm-a4\.pdf: differs.*--force"):
        run("--out", tmp_path, "--only", "discs", "--discs", 1, "--only", "recipe")
    assert path.read_bytes() == b"mine"
    assert len(list(tmp_path.iterdir())) == 1  # nor anything beside it
    run("--out", tmp_path, "--only", "discs", "--discs", 1, "--force")
    assert path.read_bytes() == good
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--square", "22"], "22 of what"),
        (["--square", "2000mm"], "must be from 0.5 to 1000 mm"),
        (["--only", "boards", "--square", "300mm"], "does not fit on a4; take a smaller square or a larger --paper"),
        (["--board", "eleven"], "no board"),
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


# ---- the recipe ----


def test_the_recipe_names_the_board_that_was_printed():
    page = recipe(Board(9, 6), 30.0, "letter")
    assert "--board 9x6 --square 30mm" in page
    assert "--for camera --square 30mm" in page
    assert "11x8" not in page
    assert "size: Letter" in page
    assert page.count("<svg") == 3
    assert "sketch:" not in page
