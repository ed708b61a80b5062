"""Printed sheets on a rendered picture: ring targets, and square tags as other systems use them.

A picture is rendered once without them (`backdrop`), and the window of each sheet once more with it. Sheets face +Z of
`obj`, and nothing may stand before them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import grey_values
from spheremouse.simulate.ball.scene import BLACK, CARD_MARGIN, FRONT, PAPER, Scene, card
from spheremouse.simulate.layers import window
from spheremouse.simulate.shapes import Shape

_MARGIN_PX = 2  # px around a sheet that are rendered once more


def tag(centre: Array, half: float, cells: NDArray[np.bool_]) -> list[Shape]:
    """A tag of side 2 `half` m whose `cells` (k, k), border included, are white or not, the first row on top."""
    side = 2.0 * half / len(cells)
    shapes: list[Shape] = [card(centre - 0.001 * FRONT, CARD_MARGIN * half, CARD_MARGIN * half, PAPER)]
    shapes.append(card(centre, half, half, BLACK))
    for row, column in np.argwhere(cells):
        at = centre + np.array([(column + 0.5) * side - half, half - (row + 0.5) * side, 1e-5])
        shapes.append(card(at, 0.5 * side, 0.5 * side, PAPER))
    return shapes


def tag_cells(family: int, number: int) -> NDArray[np.bool_]:
    """White cells of a tag of one of OpenCV's predefined families, (k, k), with its border."""
    dictionary = cv2.aruco.getPredefinedDictionary(family)
    side = dictionary.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, side)) > 127


def tag_corners(centre: Array, half: float) -> Array:
    """Corners of tags at (n, 3) m, obj: (n, 4, 3), in OpenCV's order, clockwise from the top left."""
    offset = half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    return centre[:, None] + offset


def painted(picture: NDArray[np.float32], scene: Scene, sheets: Iterable[Sequence[Shape]]) -> NDArray[np.float32]:
    """A picture (h, w, 3), grey values blue, green, red, with sheets that are not in the scene, the card first."""
    out = picture.copy()
    for sheet in sheets:
        view = replace(scene, surroundings=(*sheet, *scene.surroundings)).viewpoint()
        corners = project(scene.pose.to_cam(sheet[0].outline()), scene.camera)[0]
        # a pixel needs its neighbours to know that it has an edge
        place, around = (window(corners, margin, scene.camera) for margin in (_MARGIN_PX, _MARGIN_PX + 1))
        if not place.empty:
            grey = view.paint(around, scene.camera, partial(grey_values, scene, view))
            top, left = place.top - around.top, place.left - around.left
            out[place.slices] = grey[top:, left:][: place.bottom - place.top, : place.right - place.left, :3]
    return out
