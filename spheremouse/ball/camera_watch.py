"""Check whether the camera has moved, by the shifts of the ring targets in the image.

The monitor keeps a patch of each target from the frame that gave the pose. It searches the patch again within a few
pixels by normalised correlation, and finds the target's new place, or that something hides it. The errors of rig and
pose are the same before and after a bump. So the shifts alone give the camera's motion, by a resection relative to the
pose before (Gauss-Newton, as Wittich 2017, section 2.4.3). With enough colour and light the shifts come from the rings'
edges, good to a hundredth of a pixel. Otherwise they come from the correlation, good to a tenth, because the background
of a target shifts by another amount.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.ball.pose import adjust_pose, predict_targets
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import Pose, ellipse_to_pixel, project_circle
from spheremouse.geometry.rotation import Array, log

_PATCH_HALF_WIDTH_PX = 17  # px, half width of a reduced patch: larger ones are reduced to about that
# half width of a patch in outer radii of the target: it includes the ring's edge and some background
_PATCH_HALF_WIDTH_RADII = 1.3
_SEARCH_REACH_PX = 3  # px of the reduced patch, reach of an ordinary search
_POINT_SYMMETRY = 0.7  # correlation of a patch with itself turned by 180°, from which it is taken for a target
_MIN_CONTRAST_GREY = 5.0  # grey values, standard deviation within a patch: less is a wall, or the dark
DISPLACED_PX = 0.15  # shift of a moved target: seven standard deviations of its rings, 0.05° of the ball far away
RING_SIGMA_PX = 0.02  # standard deviation of a shift measured on the rings' edges
MATCH_SIGMA_PX = 0.1  # standard deviation of a shift by correlation: the background of a target shifts otherwise
_INTERVAL_S = 1.0  # the time in which each target is measured once, one at a time
_SHAKES_S = 1.0  # s, after which a camera that was displaced counts as at rest
_MIN_CORRELATION = 0.7  # with the remembered patch; below, something hides the target
_STILL_PX = 0.15  # shift of the targets between two frames while the camera stands
_MAX_DISPLACEMENT_WIDTHS = 0.05  # image widths within which a displaced target is searched; beyond, its colours find it


@dataclass(frozen=True, slots=True)
class CameraMonitor:
    """Appearance of the targets, and the next one to check."""

    patches: tuple[Image | None, ...]  # of each target (h, w) grey, reduced; None: not seen yet
    corner: NDArray[np.intp]  # (n, 2) px, top left pixel of each patch: column, row
    size: NDArray[np.intp]  # (n,) px of the patch, its width and height
    reduction: NDArray[np.intp]  # (n,) px of the image to one of the patch
    zero: Array  # (n, 2) px, result of the correlation for a target that has not moved
    place: Array  # (n, 2) px, measured centres of the rings; nan without a measurement
    seen: NDArray[np.bool_]  # (n,) visible at the last check
    last_target: int = 0  # the target checked last
    due: float = -np.inf  # s, time of the next check
    shift: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2) px of a displaced camera; nan: hidden
    moving_since: float | None = None  # s, start of the camera's displacement; None: not displaced
    shaken: float = -np.inf  # s, last frame in which the camera was displaced
    tried: float = -np.inf  # s, last search for the targets by their colours
    colour_frame_requested: bool = False  # a grey frame showed a displaced target: check all in the next, in colour

    def __len__(self) -> int:
        return len(self.patches)


def begin(rig: Rig, pose: Pose) -> CameraMonitor | None:
    """Return a monitor of the rig's targets for a camera pose; None if fewer than three lie in the image."""
    if len(rig.targets.codes) < 3:
        return None
    centre = predict_targets(pose, rig)
    points = pose.to_cam(rig.targets.position)
    normal = np.broadcast_to(pose.rotation.T @ rig.targets.normal, points.shape)
    _, shape = ellipse_to_pixel(*project_circle(points, normal, float(rig.targets.radii[-1])), rig.camera)
    radius = np.sqrt(np.maximum(shape[:, 0, 0], shape[:, 1, 1]))
    seen = np.isfinite(centre).all(axis=1) & np.isfinite(radius) & (points[:, 2] > 0.0)
    half = np.ceil(_PATCH_HALF_WIDTH_RADII * radius[seen])
    reduction = np.maximum(np.rint(half / _PATCH_HALF_WIDTH_PX), 1.0)
    size = (2 * np.ceil(half / reduction) + 1) * reduction
    corner = np.rint(centre[seen] - 0.5 * (size[:, None] - 1))
    room = (corner >= 0).all(axis=1) & (corner + size[:, None] <= (rig.camera.width, rig.camera.height)).all(axis=1)
    if np.count_nonzero(room) < 3:
        return None
    which = np.flatnonzero(seen)
    patches = len(rig.targets.codes)
    corners, sizes, reductions = np.full((patches, 2), -1), np.zeros(patches), np.ones(patches)
    corners[which[room]], sizes[which[room]], reductions[which[room]] = corner[room], size[room], reduction[room]
    return CameraMonitor(
        (None,) * patches,
        corners.astype(np.intp),
        sizes.astype(np.intp),
        reductions.astype(np.intp),
        np.zeros((patches, 2)),
        np.full((patches, 2), np.nan),
        np.zeros(patches, dtype=bool),
    )


def remember_targets(
    watch: CameraMonitor, image: Image, which: Iterable[int], rig: Rig, rings: RingSettings
) -> CameraMonitor:
    """Store the current patches of the targets `which`, their indices.

    A patch is stored only if it shows a target: it has contrast and is point-symmetric.
    """
    patches, seen, place, zero = list(watch.patches), watch.seen.copy(), watch.place.copy(), watch.zero.copy()
    for k in which:
        if watch.size[k] == 0:
            continue
        patch = _window(watch, image, k, 0)[0]
        values = patch.astype(np.float32)
        turned = np.ascontiguousarray(values[::-1, ::-1])
        good = float(values.std()) > _MIN_CONTRAST_GREY
        good = good and float(cv2.matchTemplate(values, turned, cv2.TM_CCOEFF_NORMED)[0, 0]) > _POINT_SYMMETRY
        patches[k], seen[k] = (patch if good else None), good
        if good:
            zero[k] = _top(cv2.matchTemplate(_window(watch, image, k, 1)[0], patch, cv2.TM_CCOEFF_NORMED))[1]
            zero[k] -= np.rint(zero[k])
            place[k] = _on_rings(watch, image, k, np.zeros(2), rig, rings)
    return replace(watch, patches=tuple(patches), zero=zero, place=place, seen=seen)


def target_shift(watch: CameraMonitor, image: Image, which: int, far: bool = False) -> Array:
    """Return the shift, (2,) px, of a target; nan if it is hidden.

    With `far`, the search covers _MAX_DISPLACEMENT_WIDTHS.
    """
    template = watch.patches[which]
    if template is None:
        return np.full(2, np.nan)
    f = int(watch.reduction[which])
    reach = int(np.ceil(_MAX_DISPLACEMENT_WIDTHS * image.shape[1] / f)) if far else _SEARCH_REACH_PX
    window, before = _window(watch, image, which, reach)
    score = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
    best, at = _top(score)
    return f * (at - before - watch.zero[which]) if best >= _MIN_CORRELATION else np.full(2, np.nan)


def target_shifts(watch: CameraMonitor, image: Image) -> tuple[CameraMonitor, Array]:
    """Return the shift of every target, (n, 2) px; nan if it is hidden.

    If a target is not near its place, the search covers a larger part of the image.
    """
    shift = np.array([target_shift(watch, image, k) for k in range(len(watch))])
    for k in range(len(watch)):
        if not np.hypot(*shift[k]) < _SEARCH_REACH_PX - 1:
            shift[k] = target_shift(watch, image, k, far=True)
    return replace(watch, seen=np.isfinite(shift[:, 0])), shift


def check_next_target(
    watch: CameraMonitor, image: Image, stamp: float, bump_suspected: bool
) -> tuple[CameraMonitor, bool]:
    """Check the next target if it is due, or the next two at once if a bump is suspected.

    A camera that was displaced may go on to shake, so a bump is suspected for a second. Return the monitor, and whether
    one is displaced. A target that has just disappeared counts as displaced once. A displaced target does not prove
    that the camera has moved. That decision needs a check of all targets.
    """
    step = _INTERVAL_S / len(watch)
    bump_suspected |= watch.shaken <= stamp < watch.shaken + _SHAKES_S
    if not bump_suspected and watch.due - step <= stamp < watch.due:
        return watch, False
    seen, odd, k = watch.seen.copy(), False, watch.last_target
    for _ in range(2 if bump_suspected else 1):
        k = (k + 1) % len(watch)
        if watch.patches[k] is None:
            continue
        shift = target_shift(watch, image, k)
        visible = bool(np.isfinite(shift[0]))
        odd |= bool(np.hypot(*shift) > DISPLACED_PX) if visible else bool(seen[k])
        seen[k] = visible
    return replace(watch, seen=seen, last_target=k, due=stamp + step), odd


def most_have_moved(shift: Array, limit: float) -> bool | None:
    """Return whether most targets have moved by more than `limit` px, from their shifts, (n, 2) px.

    Returns None if fewer than three targets are visible.
    """
    seen = np.isfinite(shift[:, 0])
    if np.count_nonzero(seen) < 3:
        return None
    return bool(2 * np.count_nonzero(np.hypot(*shift[seen].T) > limit) > np.count_nonzero(seen))


def is_still(before: Array, now: Array) -> bool:
    """Return whether the shifts of the targets, (n, 2) px, are the same in frames `before` and `now`."""
    if len(before) != len(now):
        return False
    step = np.hypot(*(now - before).T)
    return bool(np.count_nonzero(np.isfinite(step)) >= 3 and np.nanmedian(step) < _STILL_PX)


def on_rings(watch: CameraMonitor, image: Image, shift: Array, rig: Rig, rings: RingSettings) -> Array:
    """Return the shifts, (n, 2) px, measured on the rings' edges near the correlation's result; nan without rings."""
    if image.ndim != 3:
        return np.full_like(shift, np.nan)
    now = [_on_rings(watch, image, k, shift[k], rig, rings) for k in range(len(watch))]
    return np.array(now) - watch.place


def moved_pose(shift: Array, rig: Rig, pose: Pose, sigma: float) -> tuple[Pose, Array] | None:
    """Return the camera pose for the targets' shifts, (n, 2) px, and the added covariance, (6, 6).

    The result is the solution nearest to `pose`. With more than three targets, targets that fit no other are left out.
    Returns None if no pose near `pose` fits.
    """
    which = np.flatnonzero(np.isfinite(shift[:, 0]))
    observed = predict_targets(pose, rig) + shift
    while len(which) >= 3:
        k = len(which)
        fit = adjust_pose(pose, observed[which], which, rig, sigma**2 * np.eye(2 * k), np.zeros((3 * k, 3 * k)))
        if fit is None:
            return None
        residual_px = np.hypot(*fit.residual.reshape(-1, 2).T)
        if residual_px.max() < 5.0 * sigma:
            rotation, position, added = fit.pose.rotation, fit.pose.position, fit.covariance
            return replace(pose, rotation=rotation, position=position, covariance=pose.covariance + added), added
        which = np.delete(which, int(np.argmax(residual_px)))
    return None


def difference(before: Pose, after: Pose) -> tuple[float, float]:
    """Return the distance of two poses in m and in rad."""
    turn = log(after.rotation @ before.rotation.T)
    return float(np.linalg.norm(after.position - before.position)), float(np.linalg.norm(turn))


def _on_rings(watch: CameraMonitor, image: Image, which: int, shift: Array, rig: Rig, rings: RingSettings) -> Array:
    """Return the centre, (2,) px, of a target about `shift` px from its place; nan if its rings are not visible."""
    if image.ndim != 3 or not np.all(np.isfinite(shift)):
        return np.full(2, np.nan)
    margin = int(watch.size[which]) // 4 + 6
    x, y = np.maximum(np.rint(watch.corner[which] + shift).astype(int) - margin, 0)
    side = int(watch.size[which]) + 2 * margin
    found = detect_targets(image[y : y + side, x : x + side], rig.targets.radii, rings)
    matching = [c for code, c in zip(found.codes, found.centre, strict=True) if code == rig.targets.codes[which]]
    return matching[0] + (x, y) if len(matching) == 1 else np.full(2, np.nan)


def _window(watch: CameraMonitor, image: Image, which: int, reach: int) -> tuple[Image, Array]:
    """Return a patch with a margin, in grey and reduced, and the widths of the left and upper margin.

    The margin is up to `reach` reduced pixels wide on all sides.
    """
    f, size = int(watch.reduction[which]), int(watch.size[which])
    x, y = (int(v) for v in watch.corner[which])
    h, w = image.shape[:2]
    left, above = min(reach, x // f), min(reach, y // f)
    right, below = min(reach, (w - x - size) // f), min(reach, (h - y - size) // f)
    window = image[y - above * f : y + size + below * f, x - left * f : x + size + right * f]
    if window.ndim == 3:
        window = cv2.cvtColor(window, cv2.COLOR_BGR2GRAY)
    if f > 1:
        window = cv2.resize(window, (window.shape[1] // f, window.shape[0] // f), interpolation=cv2.INTER_AREA)
    return window, np.array([left, above], dtype=float)


def _top(score: cv2.typing.MatLike) -> tuple[float, Array]:
    """Return the largest value of a correlation map and its subpixel position, (2,) column and row."""
    _, best, _, (x, y) = cv2.minMaxLoc(score)
    return best, np.array([x + _peak(score[y], x), y + _peak(score[:, x], y)])


def _peak(score: cv2.typing.MatLike, at: int) -> float:
    """Return the offset of the vertex of a parabola through a maximum and its neighbours; 0 at the row's end."""
    if not 0 < at < len(score) - 1:
        return 0.0
    a, b, c = (float(s) for s in score[at - 1 : at + 2])
    bend = a - 2.0 * b + c
    return 0.5 * (a - c) / bend if bend < 0.0 else 0.0
