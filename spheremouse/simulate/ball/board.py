"""A chessboard in a room, and its picture: black squares on white card, anti-aliased through the lens.

If one edge crosses a pixel, the black fraction is that of a half plane. Near a corner it is that of a product of two.
Edges are taken as straight within a part of a pixel. The scene behind the board is out of focus and rendered coarsely.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, Pose, project, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import render_backdrop
from spheremouse.simulate.ball.scene import BLACK, LAMPS, PAPER, Scene, room
from spheremouse.simulate.ball.surface import half_plane
from spheremouse.simulate.layers import window
from spheremouse.simulate.light import Lighting, develop
from spheremouse.simulate.shapes import pixel_parts

COLUMNS, ROWS = 11, 8  # inner corners
SQUARE, BORDER = 0.086, 0.043  # m; white around the squares
MIDDLE = np.array([0.0, 0.45, 0.6])  # m, obj: where the board hangs, facing +Z
_SQUARES = np.array([COLUMNS + 1, ROWS + 1])
SIZE = _SQUARES * SQUARE  # m, width and height of all squares
_HALF_CARD = 0.5 * SIZE + BORDER  # m
_FRONT = np.array([0.0, 0.0, 1.0])
_BACKGROUND_STEP_PX = 4  # px, of which the room behind has one
_SUBPIXELS_AT_EDGE = 4  # parts of a pixel's side where an edge runs through it
_FINE_MARGIN_PX = 3  # px around the board that are rendered finely


def corners() -> Array:
    """Inner corners, (COLUMNS * ROWS, 3) m, obj, row by row from the top left."""
    x = (np.arange(COLUMNS) - 0.5 * (COLUMNS - 1)) * SQUARE
    y = (0.5 * (ROWS - 1) - np.arange(ROWS)) * SQUARE
    points = np.zeros((ROWS, COLUMNS, 3))
    points[..., 0], points[..., 1] = np.meshgrid(x, y)
    return MIDDLE + points.reshape(-1, 3)


def outline(beyond: float) -> Array:
    """Corners of a rectangle that reaches `beyond` m past the outermost inner corners, (4, 3) m, obj."""
    half = 0.5 * SIZE - SQUARE + beyond
    return MIDDLE + np.array([[x * half[0], y * half[1], 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


class BoardCoverage(NamedTuple):
    """Parts of a board that pixels show."""

    place: Array  # (n, 2) m on the board, from its middle; nan where a ray misses its plane
    card: Array  # (n,) share that shows the card
    dark: Array  # (n,) black share of that


def render_board(scene: Scene) -> NDArray[np.float32]:
    """The board in an empty room through the scene's camera, (h, w, 3) grey values."""
    camera, pose = scene.camera, scene.pose
    light = Lighting(LAMPS, (), 1e-3)
    # the room without ball and device, coarsely
    w, h = -(-camera.width // _BACKGROUND_STEP_PX), -(-camera.height // _BACKGROUND_STEP_PX)
    sx, sy = w / camera.width, h / camera.height
    cx, cy = (camera.cx + 0.5) * sx - 0.5, (camera.cy + 0.5) * sy - 0.5
    small = replace(camera, width=w, height=h, fx=camera.fx * sx, fy=camera.fy * sy, cx=cx, cy=cy)
    behind = replace(scene, camera=small, surroundings=tuple(room()), lighting=light)
    coarse = render_backdrop(behind, ball=False).white
    picture = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR).astype(np.float32)

    along = np.linspace(0.0, 1.0, 40)[:, None]
    ends = outline(SQUARE + BORDER)
    rim = np.concatenate([a + along * (b - a) for a, b in zip(ends, np.roll(ends, -1, axis=0), strict=True)])
    fine = window(project(pose.to_cam(rim), camera)[0], _FINE_MARGIN_PX, camera)
    uv = fine.pixels()
    seen = board_coverage(camera, pose, uv.reshape(-1, 2))
    white, black = _grey(light, seen.place.reshape(uv.shape))
    card, dark = (share.astype(np.float32).reshape(*uv.shape[:2], 1) for share in (seen.card, seen.dark))
    part = picture[fine.slices]
    part += card * (white + dark * (black - white) - part)
    return picture


def board_coverage(camera: InteriorOrientation, pose: Pose, uv: Array) -> BoardCoverage:
    """The board in pixels `uv`, (n, 2), that are whole numbers or not: a square of 1 px around each."""
    place, slope = _intersect_board(uv, camera, pose)
    reach = np.abs(slope[:, :, 0]) + np.abs(slope[:, :, 1])  # m on the board, from the middle of a pixel to the next
    lines = place / SQUARE + 0.5 * _SQUARES
    within = np.abs(place) < _HALF_CARD + reach  # nan compares false
    near = (np.abs(lines - np.rint(lines)) * SQUARE < reach) | (np.abs(np.abs(place) - _HALF_CARD) < reach)
    inside = within[:, 0] & within[:, 1]
    edge = inside & (near[:, 0] | near[:, 1])
    card, black = np.zeros(len(place)), np.zeros(len(place))
    for pixels, fine in ((np.flatnonzero(inside & ~edge), 1), (np.flatnonzero(edge), _SUBPIXELS_AT_EDGE)):
        for part in pixel_parts(fine):
            at = place[pixels] + slope[pixels] @ part
            shown, dark = _cover(at, np.abs(slope[pixels]) / fine)
            card[pixels] += shown / fine**2
            black[pixels] += shown * dark / fine**2
    return BoardCoverage(place, card, black / np.maximum(card, 1e-9))


def _intersect_board(uv: Array, camera: InteriorOrientation, pose: Pose) -> tuple[Array, Array]:
    """Return the points, (n, 2) m from the board's middle, where rays of pixels (n, 2) meet its plane, and their slope.

    The slope dplace_duv, (n, 2, 2) m/px, is the part of the board that a pixel shows. `pose` is that of the camera in
    `obj`, whose X and Y are those of the board. Both are nan for a ray that does not meet the plane.
    """
    xy, dxy_duv = unproject(uv, camera)
    ray = xy @ pose.rotation[:, :2].T + pose.rotation[:, 2]
    s = (MIDDLE[2] - pose.position[2]) / ray[:, 2]
    s = np.where(s > 0.0, s, np.nan)  # the plane is behind; nan also if the lens maps no ray
    place = pose.position[:2] - MIDDLE[:2] + s[:, None] * ray[:, :2]
    dray = pose.rotation[:, :2] @ dxy_duv
    dplace = s[:, None, None] * (dray[:, :2] - ray[:, :2, None] * dray[:, 2:] / ray[:, 2, None, None])
    return place, dplace


def _cover(place: Array, slope: Array) -> tuple[Array, Array]:
    """Shares of card, and of black in it, of parts of pixels around `place`, (n, 2), each crossed by few edges.

    `slope` (n, 2, 2) are absolute values of dplace by the part's sides.
    """
    shown, squares, sign = np.ones(len(place)), np.ones(len(place)), np.ones(len(place))
    for axis in (0, 1):
        x, dx = place[:, axis], slope[:, axis]
        shown *= half_plane(_HALF_CARD[axis] - np.abs(x), dx)
        squares *= half_plane(0.5 * SIZE[axis] - np.abs(x), dx)
        n = _SQUARES[axis]
        line = np.clip(np.rint(x / SQUARE + 0.5 * n), 1, n - 1)  # the nearest one between squares
        beyond = half_plane(x - (line - 0.5 * n) * SQUARE, dx)
        sign *= (1.0 - 2.0 * beyond) * np.where(line % 2 == 0, 1.0, -1.0)
    return shown, squares * (0.5 + 0.5 * sign)


def _grey(light: Lighting, place: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Grey values of white and of black at places (h, w, 2) m on the board, (h, w, 3) each, interpolated on a grid."""
    count = np.array([41, 31])
    x, y = (np.linspace(-h, h, k) for h, k in zip(_HALF_CARD, count, strict=True))
    points = np.stack([*np.meshgrid(x, y), np.zeros((count[1], count[0]))], axis=-1).reshape(-1, 3) + MIDDLE
    falling = light.on_room(points, np.broadcast_to(_FRONT, points.shape))
    at = (np.nan_to_num(place / _HALF_CARD) * 0.5 + 0.5) * (count - 1)
    u, v = (at[..., axis].astype(np.float32) for axis in (0, 1))
    greys = (develop(falling * albedo).reshape(count[1], count[0], 3).astype(np.float32) for albedo in (PAPER, BLACK))
    white, black = (cv2.remap(g, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for g in greys)
    return np.asarray(white, np.float32), np.asarray(black, np.float32)
