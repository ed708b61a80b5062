"""What a layout is worth, in figures and in words."""

from typing import Any

import numpy as np

from spheremouse.calibrate.layout.limits import CLEAR, ENOUGH
from spheremouse.calibrate.layout.search import Judgement, Trials

TRIALS, MISSING = 300, 0.2  # attitudes, and the probability that a disc is hidden
SIGMA = np.radians(0.1)


def figures(j: Judgement, t: Trials, radius: float) -> dict[str, Any]:
    """Figures of a layout, as JSON has them."""
    return {
        "in_view": j.in_view,
        "nearest_mm": round(1e3 * radius * j.apart, 1),
        "alike_mm": round(1e3 * radius * j.alike, 1),
        "separability": round(j.separability, 2),
        "separability_median": round(float(np.median(j.contradictions)), 2),
        "unclear_share": round(j.unclear, 4),
        "symmetries": len(j.symmetries),
        "recognised": {
            "sigma_deg": round(float(np.degrees(SIGMA)), 3),
            "missing": MISSING,
            "found": t.found,
            "refused": t.refused,
            "wrong": t.wrong,
        },
    }


def verdict(j: Judgement, t: Trials, radius: float, disc_radius: float) -> list[str]:
    """The same in words, a line each."""
    mm = 1e3 * radius
    return [
        f"in view: {j.in_view} discs or more from anywhere ({ENOUGH} are enough)",
        f"nearest: discs {j.closest[0] + 1} and {j.closest[1] + 1}, {j.apart * mm:.0f} mm apart "
        f"({2e3 * disc_radius:.0f} mm would touch)",
        f"separability: {j.separability:.1f} discs tell the worst view from the one most like it, "
        f"{np.median(j.contradictions):.1f} the median (within {j.alike * mm:.0f} mm is alike; {CLEAR:g} are clear)",
        f"unclear views: {100 * j.unclear:.1f} %; symmetries: {len(j.symmetries)}",
        f"recognised from one picture (0.1 degrees, {100 * MISSING:.0f} % hidden): {100 * t.found:.1f} %, "
        f"left open {100 * t.refused:.1f} %, mistaken {100 * t.wrong:.1f} %",
    ]
