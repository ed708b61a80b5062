"""Ring targets on the frame: image in, centres of targets with their colour codes out.

A target is a disc inside two rings, in cyan, magenta and yellow; their order, inside to outside, is its name
(Wittich 2017, section 3.6.2, eq. 99-101). Found by hue masks and nested contours; measured by the centroids of the
three filled circles, weighted by how much of each pixel they cover.
"""

from dataclasses import dataclass
from itertools import chain, permutations

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import COLOURS
from spheremouse.geometry.matching import suppress
from spheremouse.geometry.rotation import Array
from spheremouse.settings import param

MAX_COPIES = 10  # copies of a target that are measured in a picture, the best: a device has one, a room a few
_MAX_MEASURED_PICTURE_AREAS = 2.0  # areas of the picture that are measured in all: targets side by side do not fill one
_MEDIAN_PX = 3  # width of the median filter of a picture; it removes salt and keeps thin rings
_PAPER_STEP = 4  # px, in which the brightness of paper is averaged, against noise
_PAPER_SHARE = 0.1  # of the picture's width, in which a target shows paper or two of its colours
_DARKEST_PAPER = 56  # grey value of the paper from which noise would seem coloured: a quarter of white
_WHITE = 230.0  # grey value that paper gets, as in good light
_OPENING_PX = 3  # width of the opening of a colour's mask; not more than a ring is wide
_FEW_PAIRS = 1 << 16  # of spots, all compared: in 2 ms
_MIN_PIXELS_OF_COLOUR = 4  # on each side of an edge
_MIN_CONTRAST = 10.0  # grey levels between the colours beside an edge
_EDGE_BAND_HALF_WIDTH_PX = 2.0  # px, half width of the band in which an edge is measured: blur of lens and demosaicing


@dataclass(frozen=True, slots=True)
class RingSettings:
    """Bounds of the targets' colours and shapes."""

    cyan: tuple[int, int] = param(
        (63, 117), "OpenCV hue", "cyan print is 90; blur mixes hues, up to halfway", ge=0, le=180
    )
    magenta: tuple[int, int] = param((123, 180), "OpenCV hue", "magenta print is 150, up to halfway", ge=0, le=180)
    yellow: tuple[int, int] = param((6, 54), "OpenCV hue", "yellow print is 30, up to halfway", ge=0, le=180)
    saturation: tuple[int, int] = param((60, 255), "-", "saturation bounds (Wittich 2017, table 4)", ge=0, le=255)
    value: tuple[int, int] = param(
        (60, 255), "-", "value bounds; table 4 has 110, which loses a dimmed scene", ge=0, le=255
    )
    # Not settings, since they follow from pixels and print. The search for rejected targets widens them.
    min_radius: float = 1.5  # px, of an inner disc; below it a colour is a guess
    concentric: float = 0.2  # of a target's radius, within which the centres of its contours agree
    ratio: float = 1.5  # factor by which radii may differ from the rig's proportions; a mask loses the mixed pixels

    def __post_init__(self) -> None:
        for name in ("cyan", "magenta", "yellow", "saturation", "value"):
            least, greatest = getattr(self, name)
            if least > greatest:
                raise ValueError(f"{name}: {least} is above {greatest}, which selects nothing; exchange them")


@dataclass(frozen=True, slots=True)
class TargetDetections:
    """Targets detected in one image. If the room contains a copy, its code occurs twice."""

    codes: tuple[str, ...]
    centre: Array  # (n, 2) px, mean centroid of the three filled ellipses: eccentricity not yet corrected
    radius: Array  # (n,) px, of the outer ring, geometric mean of the semi-axes
    contours: tuple[Image, ...]  # outer outlines, for the overlay
    crowded: bool = False  # there was more than is measured: the best were

    def __len__(self) -> int:
        return len(self.codes)


@dataclass(frozen=True, slots=True)
class Spots:
    """Pixels of one colour."""

    contours: tuple[Image, ...]  # (k, 2) px each
    centre: Array  # (n, 2) px
    radius: Array  # (n,) px, of the circle of equal area

    def __len__(self) -> int:
        return len(self.contours)


@dataclass(frozen=True, slots=True)
class Candidate:
    """Circles arranged as in a target, before the measurement."""

    code: str
    outline: Image  # (k, 2) px, of the outer circle
    middle: Array  # (2,) px, its centroid
    half: Array  # (2,) px, semi-axes
    axes: Array  # (2, 2) their directions, in rows
    window: tuple[int, int, int, int]  # px of the measurement: first column and row, and those after the last

    @property
    def area(self) -> int:
        """px² of the window."""
        x0, y0, x1, y1 = self.window
        return (x1 - x0) * (y1 - y0)


_Pairs = tuple[NDArray[np.intp], NDArray[np.intp]]  # indices of spots, and of those they lie in


def detect_targets(image: Image, radii: Array, settings: RingSettings) -> TargetDetections:
    """Return all targets in a BGR image, (h, w, 3). `radii` (3,) are the rig's circles, in any unit.

    The detector ignores single discs, rings within rings of two colours, and nested circles that are not concentric or
    not in proportion. Of more than `MAX_COPIES` candidates with one code, it measures the best. If all together are
    larger than two images, it measures the smallest, and a flag reports this.
    """
    proportion = np.asarray(radii, dtype=float) / radii[-1]
    candidates, crowded = candidates_of(spots_of(image, settings), proportion, settings, image.shape)
    areas = np.array([c.area for c in candidates])
    smaller = np.argsort(areas, kind="stable")
    # As many candidates as possible, the smallest first
    room = np.cumsum(areas[smaller]) <= _MAX_MEASURED_PICTURE_AREAS * image.shape[0] * image.shape[1]
    measured = [(c, _measure(image, c, proportion)) for c in (candidates[k] for k in np.sort(smaller[room]))]
    seen = [(c, *m) for c, m in measured if m is not None]
    return TargetDetections(
        tuple(c.code for c, _, _ in seen),
        np.array([centre for _, centre, _ in seen]).reshape(-1, 2),
        np.array([radius for _, _, radius in seen], dtype=float),
        tuple(c.outline for c, _, _ in seen),
        crowded or not room.all(),
    )


def spots_of(image: Image, settings: RingSettings) -> dict[str, Spots]:
    """Return the pixels of each of the three colours in a BGR image, (h, w, 3)."""
    return {c: _spots(m, settings) for c, m in zip(COLOURS, _masks(image, settings), strict=True)}


def candidates_of(
    spots: dict[str, Spots], proportion: Array, settings: RingSettings, shape: tuple[int, ...]
) -> tuple[list[Candidate], bool]:
    """Return spots in one another, as a target's are, and whether there were more than `MAX_COPIES`.

    `proportion` (2,) has the radii of inner disc and middle ring over that of the outer one. `shape` is the picture's.
    """
    candidates: list[Candidate] = []
    crowded = False
    for code in permutations(COLOURS):
        nests, more = _nests((spots[code[0]], spots[code[1]], spots[code[2]]), proportion, settings)
        outer, crowded = spots[code[2]], crowded or more
        for k in nests:
            candidate = _candidate("".join(code), outer.contours[k], outer.centre[k], shape)
            if candidate is not None:
                candidates.append(candidate)
    return candidates, crowded


def _on_white(image: Image) -> Image:
    """Return a BGR image, (h, w, 3), in the light under which the paper of a target is white.

    Each channel is divided by its greatest value nearby, which is that of the paper. Two rings beside each other
    have it, too. So neither the colour of the light nor its strength changes the hues of a print.
    """
    height, width = image.shape[:2]
    reach = max(int(width * _PAPER_SHARE / _PAPER_STEP), 2) | 1
    small = cv2.resize(image, (-(-width // _PAPER_STEP), -(-height // _PAPER_STEP)), interpolation=cv2.INTER_AREA)
    paper = cv2.blur(cv2.dilate(small, np.ones((reach, reach), np.uint8)), (reach, reach))
    paper = cv2.resize(np.maximum(paper, _DARKEST_PAPER), (width, height), interpolation=cv2.INTER_LINEAR)
    return cv2.divide(image, paper, scale=_WHITE)


def _masks(image: Image, settings: RingSettings) -> list[Image]:
    hsv = cv2.cvtColor(_on_white(cv2.medianBlur(image, _MEDIAN_PX)), cv2.COLOR_BGR2HSV)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_OPENING_PX, _OPENING_PX))
    masks = []
    for low, high in (settings.cyan, settings.magenta, settings.yellow):
        s, v = settings.saturation, settings.value
        mask = cv2.inRange(hsv, np.array([low, s[0], v[0]]), np.array([high, s[1], v[1]]))
        masks.append(cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel))
    return masks


def _spots(mask: Image, settings: RingSettings) -> Spots:
    """Return the outlines of the connected regions of a mask, filled: their moments are those of discs, not of rings.

    The hole of a region is no region. The hole of an outer ring is as large as the middle ring, and where a camera
    washes colours out, it would fit the smaller circles better than its ring.
    """
    contours, levels = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    regions = [c[:, 0] for c, level in zip(contours, levels[0], strict=True) if level[3] < 0] if contours else []
    outlines = [c for c in regions if len(c) >= 4 * settings.min_radius]
    if not outlines:
        return Spots((), np.zeros((0, 2)), np.zeros(0))
    moments = [cv2.moments(outline) for outline in outlines]
    area = np.array([m["m00"] for m in moments])
    centre = np.array([(m["m10"], m["m01"]) for m in moments]) / np.where(area == 0.0, 1.0, area)[:, None]
    radius = np.sqrt(area / np.pi) + 0.5  # the contour runs through pixel centres: half a pixel is missing all round
    good = np.flatnonzero((radius >= settings.min_radius) & (area > 0))
    return Spots(tuple(outlines[k] for k in good), centre[good], radius[good])


def _nests(
    layers: tuple[Spots, Spots, Spots], proportion: Array, settings: RingSettings
) -> tuple[NDArray[np.intp], bool]:
    """Outer circles of the triples (inner, middle, outer) that lie in one another, concentric and in proportion.

    The best of each place, best first, and whether there were more than `MAX_COPIES`.
    """
    inner, middle, outer = layers
    least = settings.min_radius / proportion[0] / settings.ratio  # no smaller outer ring holds a large enough disc
    large = np.flatnonzero(outer.radius >= least)
    around = concentric_pairs(middle, outer, large, proportion[1], settings)
    inmost = concentric_pairs(inner, outer, np.unique(around[1]), proportion[0], settings)
    if not len(inmost[0]):
        return inmost[0], False
    misfit = _misfits(inner.radius, inmost, middle.radius, around, outer.radius, proportion)
    left = np.flatnonzero(np.isfinite(misfit))
    left = left[np.argsort(misfit[left], kind="stable")]
    best = left[suppress(outer.centre[left], outer.radius[left])]
    return best[:MAX_COPIES], len(best) > MAX_COPIES


def concentric_pairs(
    inner: Spots, outer: Spots, which: NDArray[np.intp], proportion: float, settings: RingSettings
) -> _Pairs:
    """Return all concentric pairs, as indices into `inner` and `outer`, (p,) each.

    An inner radius is about `proportion` times the outer one. `which` (k,) are indices of the outer spots to consider.
    """
    if len(which) * len(inner) > _FEW_PAIRS:
        i, o = _candidate_pairs(inner, outer, which, proportion, settings)
    else:
        i, o = np.tile(np.arange(len(inner)), len(which)), np.repeat(which, len(inner))
    offset = np.linalg.norm(inner.centre[i] - outer.centre[o], axis=1)
    deviation = inner.radius[i] / (outer.radius[o] * proportion)
    in_proportion = (1.0 / settings.ratio < deviation) & (deviation < settings.ratio)
    good = (offset < _max_offset(outer.radius[o], settings)) & in_proportion
    return i[good], o[good]


def _max_offset(radius: Array, settings: RingSettings) -> Array:
    """Return the greatest distance of concentric centres, px, by the outer radius, px."""
    return np.maximum(settings.concentric * radius, 1.0)


def _candidate_pairs(
    inner: Spots, outer: Spots, which: NDArray[np.intp], proportion: float, settings: RingSettings
) -> _Pairs:
    """Return a superset of the pairs of many spots that fit.

    The search takes place and size as one box, with sizes stretched to its shape. A place has room for few outlines of
    one size, but a large outline may contain many small ones.
    """
    from scipy.spatial import KDTree  # it takes 0.3 s, and most pictures have few spots

    least, most = proportion / settings.ratio, proportion * settings.ratio
    stretch = 2.0 * settings.concentric / (most - least)
    reach = _max_offset(outer.radius[which], settings)
    at = np.column_stack((outer.centre[which], 0.5 * stretch * (least + most) * outer.radius[which]))
    tree = KDTree(np.column_stack((inner.centre, stretch * inner.radius)))
    near = tree.query_ball_point(at, reach * (1.0 + 1e-9), p=np.inf)
    counts = np.fromiter(map(len, near), np.intp, len(near))
    return np.fromiter(chain.from_iterable(near), np.intp, int(counts.sum())), np.repeat(which, counts)


def _misfits(inner: Array, inmost: _Pairs, middle: Array, around: _Pairs, outer: Array, proportion: Array) -> Array:
    """Return the deviation of the radii from their proportions, (n,), of the best triple of each outer circle, or inf.

    That is the range of the three log ratios, for the best of the smaller circles `inmost` and `around` it: to an inner
    circle belongs the least middle one that reaches the range of the other two, or the next smaller.
    """
    misfit = np.full(len(outer), np.inf)
    # Above all radii, to sort them by circle
    span = 2.0 * float(outer.max(initial=0.0)) * max(1.0, *(1.0 / proportion))
    order = np.argsort(span * around[1] + middle[around[0]], kind="stable")
    b, whose = middle[around[0]][order], around[1][order]
    key = span * whose + b
    a, k = inner[inmost[0]], inmost[1]
    larger = np.searchsorted(key, span * k + a, side="right")
    reaches = np.searchsorted(key, span * k + proportion[1] * np.minimum(a / proportion[0], outer[k]))
    for j in (np.maximum(larger, reaches), np.maximum(larger, reaches) - 1):
        good = (j >= larger) & (j < len(b))
        good[good] = whose[j[good]] == k[good]
        ratios = np.column_stack((a[good], b[j[good]], outer[k[good]])) / proportion
        np.minimum.at(misfit, k[good], np.ptp(np.log(ratios), axis=1))
    return misfit


def _candidate(code: str, outline: Image, middle: Array, shape: tuple[int, ...]) -> Candidate | None:
    """Return the measurement of a nest in an image of that shape; None if its outline is no ellipse."""
    ellipse = cv2.fitEllipse(outline) if len(outline) >= 5 else None
    if ellipse is None or min(ellipse[1]) <= 0 or not np.all(np.isfinite((*ellipse[0], *ellipse[1]))):
        return None
    margin = max(ellipse[1]) / 2 + 6.0
    x0, y0 = (max(int(np.floor(c - margin)), 0) for c in middle)
    x1, y1 = (min(int(np.ceil(c + margin)) + 1, end) for c, end in zip(middle, (shape[1], shape[0]), strict=True))
    turn = np.deg2rad(ellipse[2])
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return Candidate(code, outline, middle, np.array(ellipse[1]) / 2 + 0.5, axes, (x0, y0, x1, y1))


def _measure(image: Image, nest: Candidate, proportion: Array) -> tuple[Array, float] | None:
    """Return the subpixel centre (2,) px and the radius of the outer circle.

    Each edge separates two flat colours A and B. The inside covers the part (I - B)(A - B) / |A - B|^2 of a pixel near
    the edge. A pixel integrates this coverage, so the centroid of the coverage, not of a threshold, is the ellipse's
    centre.
    """
    x0, y0, x1, y1 = nest.window
    patch, centre = image[y0:y1, x0:x1].reshape(-1, 3), nest.middle
    pixels = np.stack(np.meshgrid(np.arange(x0, x1, dtype=float), np.arange(y0, y1)), axis=-1).reshape(-1, 2)
    scale = float(np.sqrt(nest.half[0] * nest.half[1]))
    edges = proportion * scale
    rings = np.append(np.diff(edges, prepend=0.0), np.inf)
    width = np.minimum(_EDGE_BAND_HALF_WIDTH_PX, np.minimum(rings[:-1], rings[1:]) / 3)
    bands = edges + np.outer([-2.0, -1.0, 1.0, 2.0], width)  # colour A up to the second, B from the third
    bands[0, 0] = -1.0
    area, centres = 0.0, np.zeros((3, 2))
    for _ in range(2):  # the second pass places the bands by the first one's centre
        rho = np.hypot(*(scale / nest.half[:, None] * nest.axes @ (pixels - centre).T))  # px, `scale` on the rim
        outwards = np.argsort(rho)
        ends = np.searchsorted(rho[outwards], bands)
        colours, places = patch[outwards], pixels[outwards]
        for k, (a, b, c, d) in enumerate(ends.T):
            if b - a < _MIN_PIXELS_OF_COLOUR or d - c < _MIN_PIXELS_OF_COLOUR:
                return None
            A, B = _median(colours[a:b]), _median(colours[c:d])
            contrast = A - B
            if contrast @ contrast < _MIN_CONTRAST**2:
                return None
            cover = np.clip((colours[b:c] - B) @ contrast / (contrast @ contrast), 0.0, 1.0)
            area = float(b + cover.sum())
            centres[k] = (places[:b].sum(axis=0) + cover @ places[b:c]) / area
        centre = np.mean(centres, axis=0)
    if np.max(np.ptp(centres, axis=0)) > 0.5 + 0.1 * scale:
        return None
    return centre, float(np.sqrt(area / np.pi))


def _median(colours: Image) -> Array:
    """Return the median of n colours, (n, 3), by channel. `np.median` takes five times as long."""
    low, high = (len(colours) - 1) // 2, len(colours) // 2
    parts = np.partition(colours, (low, high), axis=0)
    return 0.5 * (parts[low].astype(float) + parts[high])
