"""How blurred a picture is: across edges that are sharp in the world, the standard deviation of what blurs them, in px.

A step of height h that a Gaussian of standard deviation s blurs has the greatest slope h / (s sqrt(2 pi)). What is
compared are therefore edges alone: neither light nor what is printed changes the figure, as it does a "sharpness".
"""

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.geometry.rotation import Array

SHARP = 1.0  # px: a lens in focus, its pixels, and demosaicing
BLURRED = 3.0  # px: more than any lens in focus gives, even where the camera's software enlarges its pictures
_WORSE = 1.5  # times the sharpest: motion then blurs as much as the lens does
_STEP = 0.25  # px between samples
_REACH = 10.0  # px at most to each side: three times what is refused
_ALONG = 9  # samples along an edge between two corners
_AROUND = 32  # samples around a spot
_CONTRAST = 25.0  # grey values, the least step that is measured
_FEWEST = 4  # edges or spots from which a picture is judged


def blur_of_board(grey: Image, grid: Array, free: float = 0.3) -> float:
    """px, by the edges between a board's inner corners, (rows, columns, 2) px; nan where none can be judged.

    Corners that are not seen are nan. `free` of an edge's length there is nothing else to its sides.
    """
    ends = [(grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])]
    start = np.concatenate([a.reshape(-1, 2) for a, _ in ends])
    way = np.concatenate([b.reshape(-1, 2) for _, b in ends]) - start
    length = np.linalg.norm(way, axis=1)
    good = np.isfinite(length) & (length > 4.0)
    start, way, length = start[good], way[good], length[good]
    # a part of the way: near the corners the neighbouring edges are in the window
    points = start[:, None] + way[:, None] * np.linspace(0.35, 0.65, _ALONG)[:, None]
    normals = np.stack([-way[:, 1], way[:, 0]], axis=1) / length[:, None]
    return _typical(_widths(grey, points, normals[:, None], free * length))


def blur_of_spots(grey: Image, spots: Detections) -> float:
    """px, of dark spots with their outlines; nan where there are too few."""
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    points, normals, reach = [], [], []
    for contour in spots.contours:
        if len(contour) < 8:
            continue
        centre, (d0, d1), turn = cv2.fitEllipse(contour)
        if min(d0, d1) < 4.0:
            continue
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        R = np.array([[c, s], [-s, c]])  # rows: the axes
        points.append(np.array(centre) + 0.5 * np.stack([d0 * np.cos(angle), d1 * np.sin(angle)], axis=1) @ R)
        across = np.stack([np.cos(angle) / d0, np.sin(angle) / d1], axis=1) @ R
        normals.append(across / np.linalg.norm(across, axis=1, keepdims=True))
        reach.append(0.4 * min(d0, d1))
    if not points:
        return float("nan")
    return _typical(_widths(grey, np.array(points), np.array(normals), np.array(reach)))


def not_sharp(blur: float, sharpest: float) -> str:
    """Words for a picture that is less sharp than the sharpest of its camera, both px; none where it is as sharp."""
    if np.isnan(blur):
        return "its edges cannot be made out: more light, or come closer"
    if blur <= min(max(SHARP, _WORSE * sharpest), BLURRED):
        return ""
    least = f", {sharpest:.1f} px at best" if sharpest < blur else ""
    return f"blurred (edges of {blur:.1f} px{least}): more light, or go where the lens is focused"


def _typical(widths: Array) -> float:
    known = widths[np.isfinite(widths)]
    return float(np.median(known)) if len(known) >= _FEWEST else float("nan")


def _widths(grey: Image, points: Array, normals: Array, reach: Array) -> Array:
    """Of edges with samples (n, m, 2) px, normals (n, 1 or m, 2), as far as (n,) px to both sides; (n,), nan: none."""
    reach = np.minimum(reach, _REACH)
    picture, n = grey.astype(np.float32), int(np.ceil(_REACH / _STEP))
    off = np.asarray(_STEP * np.arange(-n, n + 1), float)
    at = points[:, :, None] + off[:, None] * normals[:, :, None]  # (n, m, samples, 2)
    flat = at.reshape(len(at), -1, 2).astype(np.float32)
    profile = cv2.remap(picture, flat[..., 0], flat[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    profile = profile.reshape(at.shape[:3]).mean(axis=1)
    height, width = grey.shape
    out = np.any((at < 1.0) | (at > np.array([width, height]) - 2.0), axis=(1, 2, 3))
    return np.where(out, np.nan, np.array([_width(p, off, r) for p, r in zip(profile, reach, strict=True)]))


def _width(profile: Array, off: Array, reach: float) -> float:
    """Of one profile, as far as `reach` px to both sides."""
    inside = np.abs(off) <= reach
    p, x = profile[inside], off[inside]
    if len(p) < 9:
        return float("nan")
    end = max(len(p) // 6, 1)
    step = abs(float(p[-end:].mean() - p[:end].mean()))
    if step < _CONTRAST:
        return float("nan")
    slope = np.abs(p[2:] - p[:-2]).max() / (x[2] - x[0])
    return float(step / (np.sqrt(2.0 * np.pi) * slope))
