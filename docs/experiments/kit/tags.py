"""Printed sheets painted onto a rendered picture: ring targets, and square tags as other systems use them.

A picture is rendered once without them (`backdrop`); each sheet is then mixed in under the scene's light, by the share
of every pixel that its colours cover. Sheets face +Z of `obj` and nothing may stand before them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import project, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.scene import BLACK, FRONT, INK, PAPER, Scene
from spheremouse.simulate.light import develop
from spheremouse.simulate.shapes import Colour

_MARGIN = 1.22  # outer radii from the middle of a sheet to its edge, as the cards of `furniture.frame`
_RAYS_PER_PIXEL = 144  # rays in a pixel
# The R2 sequence (Roberts 2018): no two rays in a row or a column, so that an edge along either is cut as finely as
# there are rays.
_WITHIN = (
    np.mod(0.5 + np.outer(np.arange(1, _RAYS_PER_PIXEL + 1), 1.0 / 1.324717957244746 ** np.array([1.0, 2.0])), 1.0)
    - 0.5
)


@dataclass(frozen=True, slots=True)
class Sheet:
    """A square of paper."""

    centre: Array  # (3,) m, obj
    half: float  # m, half of its side
    palette: tuple[Colour, ...]
    colour_at: Callable[[Array], NDArray[np.intp]]  # (n, 2) m right and up of the centre -> index into the palette


def ring_sheet(centre: Array, radii: Array, code: str) -> Sheet:
    """A ring target with radii (3,) m, as `furniture.frame` has them."""

    def colour_at(place: Array) -> NDArray[np.intp]:
        return np.searchsorted(radii, np.linalg.norm(place, axis=1), side="right")

    return Sheet(centre, _MARGIN * float(radii[-1]), (*(INK[c] for c in code), PAPER), colour_at)


def tag_sheet(centre: Array, half: float, cells: NDArray[np.bool_]) -> Sheet:
    """A tag of side 2 `half` m whose `cells` (k, k), border included, are white or not, the first row on top."""
    k = len(cells)

    def colour_at(place: Array) -> NDArray[np.intp]:
        column, row = (np.floor((sign * place[:, i] / half + 1.0) * 0.5 * k) for i, sign in ((0, 1.0), (1, -1.0)))
        inside = (column >= 0) & (column < k) & (row >= 0) & (row < k)
        index = np.clip(row, 0, k - 1).astype(np.intp), np.clip(column, 0, k - 1).astype(np.intp)
        return np.where(inside, cells[index].astype(np.intp), 1)

    return Sheet(centre, _MARGIN * half, (BLACK, PAPER), colour_at)


def tag_cells(family: int, number: int) -> NDArray[np.bool_]:
    """White cells of a tag of one of OpenCV's predefined families, (k, k), with its border."""
    dictionary = cv2.aruco.getPredefinedDictionary(family)
    side = dictionary.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, side)) > 127


def tag_corners(centre: Array, half: float) -> Array:
    """Corners of tags at (n, 3) m, obj: (n, 4, 3), in OpenCV's order, clockwise from the top left."""
    offset = half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    return centre[:, None] + offset


def painted(picture: NDArray[np.float32], scene: Scene, sheets: Iterable[Sheet]) -> NDArray[np.float32]:
    """A picture (h, w, 3), grey values blue, green, red, with sheets that are not in the scene."""
    out = picture.copy()
    for sheet in sheets:
        _paint(out, scene, sheet)
    return out


def _paint(out: NDArray[np.float32], scene: Scene, sheet: Sheet) -> None:
    h, w = out.shape[:2]
    corners, _ = project(scene.pose.to_cam(tag_corners(sheet.centre[None], sheet.half)[0]), scene.camera)
    low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 1, 0, (w, h))
    high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 2, 0, (w, h))
    v, u = (x.ravel() for x in np.mgrid[low[1] : high[1], low[0] : high[0]])
    if len(u) == 0:
        return
    uv = np.stack([u, v], axis=1).astype(float)
    fine, depth = _on_plane((uv[:, None] + _WITHIN).reshape(-1, 2), scene, sheet)
    on = (np.abs(fine[:, :2]).max(axis=1) <= sheet.half) & (depth > 0.0)  # nan compares false
    colour = np.where(on, sheet.colour_at(np.nan_to_num(fine[:, :2])), len(sheet.palette)).reshape(
        len(u), _RAYS_PER_PIXEL
    )
    middle, _ = _on_plane(uv, scene, sheet)
    light = scene.lighting.on_room(sheet.centre + np.nan_to_num(middle), np.broadcast_to(FRONT, middle.shape))
    mixed = np.mean(colour == len(sheet.palette), axis=1)[:, None] * out[v, u]
    for k, ink in enumerate(sheet.palette):
        mixed = mixed + np.mean(colour == k, axis=1)[:, None] * develop(np.array(ink) * light)
    out[v, u] = mixed


def _on_plane(uv: Array, scene: Scene, sheet: Sheet) -> tuple[Array, Array]:
    """Points where rays of pixels (n, 2) meet a sheet's plane, (n, 3) m from its centre, and distances (n,) in rays."""
    xy, _ = unproject(uv, scene.camera)
    rays = xy @ scene.pose.rotation[:, :2].T + scene.pose.rotation[:, 2]
    s = (sheet.centre[2] - scene.pose.position[2]) / rays[:, 2]
    return scene.pose.position + s[:, None] * rays - sheet.centre, s
