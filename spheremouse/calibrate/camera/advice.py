"""What is wrong with a camera's calibration and what would make it better, in words for whoever took the photos."""

from collections.abc import Iterator

import numpy as np

from spheremouse.calibrate.camera.calibrate import Calibrated, false_views
from spheremouse.calibrate.camera.coverage import VIEWS, bare, listed, unleant

_REACH = 0.85  # of the way to the picture's corners: beyond the last corner seen, the lens is extrapolated
_GOOD_FOCAL = 5e-4  # of the focal length: 1 mm at 2 m, which is what targets are wanted to
_INSIGNIFICANT = 2.0  # standard deviations


def advise(done: Calibrated) -> list[tuple[str, str]]:
    """("good" | "note" | "warning", sentence), warnings first."""
    said = [*_of_views(done), *_of_values(done)]
    if not any(kind == "warning" for kind, _ in said):
        said.append(("good", "The camera is well determined."))
    return sorted(said, key=lambda item: ("warning", "good", "note").index(item[0]))


def _of_views(done: Calibrated) -> Iterator[tuple[str, str]]:
    """Photos that were left out, and what the others do not show."""
    covered = done.coverage
    for i, why in false_views(done).items():
        yield "warning", f"{done.photos[i].path.name} {why} It was left out."
    if done.skipped:
        names = ", ".join(done.photos[i].path.name for i in done.skipped)
        yield "note", f"Left out, because the whole board is not found in them: {names}."
    if covered.views < VIEWS:
        yield "warning", f"Only {covered.views} views; {VIEWS} to 20 make a lens reliable."
    if places := bare(covered):
        yield "note", f"No view shows the board {listed(places)}."
    if ways := unleant(covered):
        yield "note", f"Too few views of the board facing {listed(ways)}: tilt it by 20° to 45°, twice to each side."
    if covered.reach < _REACH:
        yield (
            "note",
            f"No corner lies beyond {100 * covered.reach:.0f} % of the way from the middle of the picture to its "
            "corners: what the lens does farther out is a guess. Bring the board into the corners.",
        )


def _of_values(done: Calibrated) -> Iterator[tuple[str, str]]:
    """Values that are uncertain, and corners that contradict them."""
    found, camera, sigma = done.found, done.found.camera, done.found.deviations
    if found.free[:2].all() and sigma[0] / camera.fx > _GOOD_FOCAL:
        tilt = np.degrees(found.tilts()[found.used])
        yield (
            "warning",
            f"The focal length is uncertain by {100 * sigma[0] / camera.fx:.2f} %; the "
            f"board is tilted by {np.min(tilt):.0f}° to {np.max(tilt):.0f}°. More views at 30° to 45° help most.",
        )
    k3 = camera.distortion[4]
    if found.free[8] and abs(k3) < _INSIGNIFICANT * sigma[8]:
        yield (
            "note",
            f"k3 is {k3:.3f} with a standard deviation of {sigma[8]:.3f}: it may as well be 0, and "
            "`--distortion 4` would do.",
        )
    if found.contradiction > 1.0:
        yield (
            "note",
            "The views contradict each other more than their corners say; all standard deviations were "
            f"made {np.sqrt(found.contradiction):.1f} times larger. Is the board flat, and did it stand still?"
            + ("" if found.free.all() else " Or does the lens need more terms (`--distortion 5`)?"),
        )
    dropped = int(sum((~k).sum() for k, u in zip(found.kept, found.used, strict=True) if u))
    if dropped:
        yield "note", f"{dropped} corner{'s were' if dropped > 1 else ' was'} false and left out."
