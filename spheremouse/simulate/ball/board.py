"""A chessboard in an empty room: black squares on white card."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import render_backdrop
from spheremouse.simulate.ball.scene import BLACK, LAMPS, PAPER, Scene, room
from spheremouse.simulate.light import Lighting
from spheremouse.simulate.shapes import Face

COLUMNS, ROWS = 11, 8  # inner corners
SQUARE, BORDER = 0.086, 0.043  # m; white around the squares
MIDDLE = np.array([0.0, 0.45, 0.6])  # m, obj: where the board hangs, facing +Z
SIZE = np.array([COLUMNS + 1, ROWS + 1]) * SQUARE  # m, width and height of all squares
_INK_Z = np.array([0.0, 0.0, 1e-6])  # m, of the squares before the card


def corners() -> Array:
    """Inner corners, (COLUMNS * ROWS, 3) m, obj, row by row from the top left."""
    return np.array([_corner(column + 1, row + 1) for row in range(ROWS) for column in range(COLUMNS)])


def outline(beyond: float) -> Array:
    """Corners of a rectangle that reaches `beyond` m past the outermost inner corners, (4, 3) m, obj."""
    half = 0.5 * SIZE - SQUARE + beyond
    return MIDDLE + np.array([[x * half[0], y * half[1], 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def _corner(column: int, row: int) -> Array:
    """Return a corner of the squares, (3,) m, obj, from the top left one."""
    return MIDDLE + np.array([column * SQUARE - 0.5 * SIZE[0], 0.5 * SIZE[1] - row * SQUARE, 0.0])


def render_board(scene: Scene) -> NDArray[np.float32]:
    """The board in the room without ball and device through the scene's camera, (h, w, 3) grey values."""
    places = [(column, row) for row in range(ROWS + 1) for column in range(row % 2, COLUMNS + 1, 2)]
    around = ((0, 1), (1, 1), (1, 0), (0, 0))
    squares = [Face(np.array([_corner(x + dx, y + dy) for dx, dy in around]) + _INK_Z, BLACK) for x, y in places]
    card = Face(outline(SQUARE + BORDER), PAPER)
    hung = replace(scene, surroundings=(*squares, card, *room()), lighting=Lighting(LAMPS, (), 1e-3))
    return render_backdrop(hung, ball=False).white
