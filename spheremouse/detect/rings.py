"""Ring targets on the frame: image in, centres of targets with their colour codes out.

A target is a disc inside two rings, in cyan, magenta and yellow; their order, inside to outside, is its name
(Wittich 2017, section 3.6.2, eq. 99-101). Found by hue masks and nested contours; measured by the centroids of the
three filled circles, weighted by how much of each pixel they cover.
"""

from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np

from spheremouse.detect.detections import Image
from spheremouse.rig import COLOURS
from spheremouse.rotation import Array
from spheremouse.settings import SHARE, WIDTH, param

_BAND = 2.0  # px, half width of the band in which an edge is measured: blur of lens and demosaicing


@dataclass(frozen=True, slots=True)
class RingSettings:
    """Which pixels have a target's colour, and what shapes make a target."""

    median: int = param(
        3, "px", "width of the median filter, odd; 1 is none; 3 removes salt and keeps thin rings", **WIDTH
    )
    opening: int = param(3, "px", "width of the opening of the masks, 1 is none; not more than a ring is wide", **WIDTH)
    cyan: tuple[int, int] = param(
        (75, 105), "OpenCV hue, 0..180", "cyan print is 90; 15 either way for the light", ge=0, le=180
    )
    magenta: tuple[int, int] = param(
        (135, 170), "OpenCV hue, 0..180", "magenta print is 150 and leans to red", ge=0, le=180
    )
    yellow: tuple[int, int] = param(
        (18, 42), "OpenCV hue, 0..180", "yellow print is 30; orange ends at 18", ge=0, le=180
    )
    saturation: tuple[int, int] = param((60, 255), "0..255", "saturation bounds (Wittich 2017, table 4)", ge=0, le=255)
    value: tuple[int, int] = param(
        (60, 255), "0..255", "value bounds; table 4 has 110, which loses a dimmed scene", ge=0, le=255
    )
    min_radius: float = param(1.5, "px", "smallest inner disc: below, a colour is a guess", ge=0.5, le=1000)
    concentric: float = param(
        0.2,
        "-",
        "centres of a target's contours agree within this part of its radius; beyond all of it they are not nested",
        **SHARE,
    )
    ratio: float = param(
        1.5,
        "-",
        "radii may differ from the rig's proportions by this factor: a mask loses the mixed pixels",
        gt=1,
        le=10,  # ten times as large is no target
    )

    def __post_init__(self) -> None:
        if self.median % 2 == 0:
            raise ValueError("median: the width of a median filter is odd")
        for name in ("cyan", "magenta", "yellow", "saturation", "value"):
            least, greatest = getattr(self, name)
            if least > greatest:
                raise ValueError(f"{name}: {least} is above {greatest}, which selects nothing; exchange them")


@dataclass(frozen=True, slots=True)
class TargetDetections:
    """Targets seen in one image. A code may occur twice where the room holds a copy."""

    codes: tuple[str, ...]
    centre: Array  # (n, 2) px, mean centroid of the three filled ellipses: eccentricity not yet corrected
    radius: Array  # (n,) px, of the outer ring, geometric mean of the semi-axes
    contours: tuple[Image, ...]  # outer outlines, for the overlay

    def __len__(self) -> int:
        return len(self.codes)


@dataclass(frozen=True, slots=True)
class _Blob:
    contour: Image  # (k, 2) px
    centre: Array  # (2,) px
    radius: float  # px, of the circle of equal area


def detect_targets(image: Image, radii: Array, settings: RingSettings) -> TargetDetections:
    """All targets in a BGR image, (h, w, 3). `radii` (3,) are the rig's circles, in any unit.

    Single discs, rings within rings of two colours, and nestings whose circles are not concentric or not in
    proportion are ignored.
    """
    blobs = {c: _colour_blobs(m, settings) for c, m in zip(COLOURS, _masks(image, settings), strict=True)}
    proportion = np.asarray(radii, dtype=float) / radii[-1]
    codes: list[str] = []
    centres, sizes, contours = [], [], []
    for code in permutations(COLOURS):
        for nest in _nests([blobs[c] for c in code], proportion, settings):
            measured = _measure(image, nest, proportion)
            if measured is not None:
                codes.append("".join(code))
                centres.append(measured[0])
                sizes.append(measured[1])
                contours.append(nest[-1].contour)
    return TargetDetections(
        tuple(codes), np.array(centres).reshape(-1, 2), np.array(sizes, dtype=float), tuple(contours)
    )


def _masks(image: Image, settings: RingSettings) -> list[Image]:
    smooth = cv2.medianBlur(image, settings.median) if settings.median > 1 else image
    hsv = cv2.cvtColor(smooth, cv2.COLOR_BGR2HSV)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (settings.opening, settings.opening))
    masks = []
    for low, high in (settings.cyan, settings.magenta, settings.yellow):
        s, v = settings.saturation, settings.value
        mask = cv2.inRange(hsv, np.array([low, s[0], v[0]]), np.array([high, s[1], v[1]]))
        if settings.opening > 1:
            mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel)
        masks.append(mask)
    return masks


def _colour_blobs(mask: Image, settings: RingSettings) -> list[_Blob]:
    """Outlines of the connected regions of a mask, filled: their moments are those of discs, not of rings."""
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    blobs = []
    for contour in contours:
        if len(contour) < 4 * settings.min_radius:
            continue
        m = cv2.moments(contour)
        # the contour runs through pixel centres: half a pixel is missing all round
        radius = np.sqrt(m["m00"] / np.pi) + 0.5
        if radius >= settings.min_radius and m["m00"] > 0:
            blobs.append(_Blob(contour[:, 0], np.array([m["m10"], m["m01"]]) / m["m00"], radius))
    return blobs


def _nests(layers: list[list[_Blob]], proportion: Array, settings: RingSettings) -> list[tuple[_Blob, ...]]:
    """Triples (inner, middle, outer) that lie in one another, concentric and in proportion; the best of each place."""
    found = []
    least = settings.min_radius / proportion[0] / settings.ratio  # no smaller outer ring holds a large enough disc
    for outer in layers[2]:
        if outer.radius < least:
            continue
        inside = [
            [b for b in layer if _fits(b, outer, expected, settings)]
            for layer, expected in zip(layers[:2], proportion[:2], strict=True)
        ]
        pairs = [(a, b) for a in inside[0] for b in inside[1] if a.radius < b.radius]
        if pairs:
            found.append((*min(pairs, key=lambda p: _misfit((*p, outer), proportion)), outer))
    best: list[tuple[_Blob, ...]] = []
    for nest in sorted(found, key=lambda n: _misfit(n, proportion)):  # a hole's outline repeats its ring's
        if all(np.linalg.norm(nest[2].centre - other[2].centre) > other[2].radius for other in best):
            best.append(nest)
    return best


def _fits(blob: _Blob, outer: _Blob, expected: float, settings: RingSettings) -> bool:
    ratio = blob.radius / (outer.radius * expected)
    offset = np.linalg.norm(blob.centre - outer.centre)
    near = offset < max(settings.concentric * outer.radius, 1.0)
    return bool(near and 1.0 / settings.ratio < ratio < settings.ratio)


def _misfit(nest: tuple[_Blob, ...], proportion: Array) -> float:
    ratios = np.array([b.radius for b in nest]) / proportion
    return float(np.ptp(np.log(ratios)))


def _measure(image: Image, nest: tuple[_Blob, ...], proportion: Array) -> tuple[Array, float] | None:
    """Sub-pixel centre (2,) px and radius of the outer circle.

    Each edge separates two flat colours A and B; a pixel near it is covered by (I - B)(A - B) / |A - B|^2 parts of the
    inside. Coverage, not a threshold, is what the lens integrates: its centroid is the ellipse's centre.
    """
    outer = nest[2]
    ellipse = cv2.fitEllipse(outer.contour) if len(outer.contour) >= 5 else None
    if ellipse is None or min(ellipse[1]) <= 0 or not np.all(np.isfinite((*ellipse[0], *ellipse[1]))):
        return None
    margin = max(ellipse[1]) / 2 + 6.0
    x0, y0 = (max(int(np.floor(c - margin)), 0) for c in outer.centre)
    x1, y1 = (int(np.ceil(c + margin)) + 1 for c in outer.centre)
    patch = image[y0:y1, x0:x1].astype(float)
    grid = np.stack(np.meshgrid(np.arange(patch.shape[1]) + x0, np.arange(patch.shape[0]) + y0), axis=-1)
    half = np.array(ellipse[1]) / 2 + 0.5
    turn = np.deg2rad(ellipse[2])
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    scale = float(np.sqrt(half[0] * half[1]))
    centre = outer.centre
    centres = []
    area = 0.0
    for _ in range(2):  # the second pass places the bands by the first one's centre
        rho = np.linalg.norm((grid - centre) @ axes.T / half, axis=-1) * scale  # px, 0 at the centre, scale on the rim
        edges = proportion * scale
        centres = []
        for k, edge in enumerate(edges):
            ring_in = edge - (edges[k - 1] if k else 0.0)
            ring_out = edges[k + 1] - edge if k < 2 else np.inf
            width = min(_BAND, ring_in / 3, ring_out / 3)
            inside = (rho < edge - width) & (rho > (edge - 2 * width if k else -1.0))
            outside = (rho > edge + width) & (rho < edge + 2 * width)
            if np.count_nonzero(inside) < 4 or np.count_nonzero(outside) < 4:
                return None
            A, B = np.median(patch[inside], axis=0), np.median(patch[outside], axis=0)
            contrast = A - B
            if contrast @ contrast < 100.0:
                return None
            cover = np.clip((patch - B) @ contrast / (contrast @ contrast), 0.0, 1.0)
            cover = np.where(rho < edge - width, 1.0, np.where(rho > edge + width, 0.0, cover))
            area = float(cover.sum())
            centres.append(np.tensordot(cover, grid, axes=([0, 1], [0, 1])) / area)
        centre = np.mean(centres, axis=0)
    if np.max(np.ptp(np.array(centres), axis=0)) > 0.5 + 0.1 * scale:
        return None
    return centre, float(np.sqrt(area / np.pi))
