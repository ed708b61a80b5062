"""Runs of hand-held balls put together by film and tracker, and held against what was asked."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from experiments import wand_films as wand
from experiments.kit.job import Result, Results
from spheremouse.evaluate.wand import RECOVERED, errors

ENOUGH = 20  # runs, to judge 19 or 18 of them
SOME = 6  # runs, to judge what none may do
Verdict = tuple[str, str, str, bool | None]
KEPT = {  # by film: what is asked of all its runs, what the thesis says of it, and how many make a judgement
    "hand-held": ("a fast hand, 0.4 m/s, 180 °/s, 15 Hz: runs kept, all", "not done", ENOUGH),
    "drive-hand": ("a distractor in one colour, a hand, 0.8 Hz: runs kept, all", "kept, not counted", SOME),
    "hand-hand": ("a distractor in one colour, a hand, 15 Hz: runs kept, all", "kept, not counted", SOME),
    "hand-card": (
        f"a distractor in both colours, a card, 15 Hz: off for {RECOVERED:g} s at most, all",
        "may draw particles away",
        SOME,
    ),
}


@dataclass(frozen=True, slots=True)
class Row:
    """One film with one variant, over its seeds."""

    film: wand.Film
    variant: str
    runs: int  # that were made; several balls count each
    lost: int
    found: int  # within `FOUND_WITHIN` frames
    tracked: float  # share of the frames
    figures: dict[str, Any] = field(default_factory=dict)  # as evaluate.wand.errors


def rows(results: Results) -> list[Row]:
    """What is known of each film and variant, and of the shared recording; `results` by the jobs' keys."""
    found = []
    for film in wand.films(False):
        of_film = [results[key] for seed in film.seeds if (key := wand.Job(film, seed).key) in results]
        for variant in film.variants:
            found.append(_row(film, variant, [k for r in of_film for k in r["variants"].get(variant.name, ())]))
    film = wand.recording_film(False)
    for variant in film.variants:
        result = results.get(wand.recording_key(variant), {"variants": {}})
        found.append(_row(film, variant, result["variants"].get(variant.name, ())))
    return [row for row in found if row.runs]


def _row(film: wand.Film, variant: wand.Variant, kept: Sequence[Result]) -> Row:
    total = sum(k["frames"] for k in kept)
    return Row(
        film,
        variant.name,
        len(kept),
        sum(k["lost"] for k in kept),
        sum(k["found_from"] is not None and k["found_from"] < wand.FOUND_WITHIN for k in kept),
        sum(len(k["index"]) for k in kept) / total if total else 0.0,
        errors(*wand.restored(kept)) if kept else {},
    )


def verdicts(table: Sequence[Row], speeds: Result) -> list[Verdict]:
    """What is asked, the thesis' figure, ours, and whether it is reached (None: not measured)."""
    found = [*_of_drive(table, "drive", ""), *_of_drive(table, wand.RECORDING, ", shared recording")]
    for name, (asked, thesis, enough) in KEPT.items():
        of_film = [r for r in table if r.film.name == name and r.runs]
        if of_film:
            row = of_film[0]
            found.append((asked, thesis, f"{row.runs - row.lost} of {row.runs}", _kept_runs(row, 0.0, enough)))
    for speed in wand.SPEEDS:
        if speed.name in speeds and speed.least is not None:
            fps = speeds[speed.name]["fps"]
            asked = f"{speed.name}: ≥ {speed.least:g} fps"
            thesis = "–" if speed.thesis is None else f"{speed.thesis:g} fps"
            found.append((asked, thesis, f"{fps:.0f} fps", fps >= speed.least))
    return found


def _kept_runs(row: Row, most: float, enough: int = ENOUGH) -> bool | None:
    """Whether at most a share of the runs lost the ball."""
    return None if row.runs < enough else row.lost <= most * row.runs


def _of_drive(table: Sequence[Row], film: str, where: str) -> list[Verdict]:
    """What is asked of the drive."""
    drive = {row.variant: row for row in table if row.film.name == film}
    found: list[Verdict] = []
    row = drive.get("350, known start")
    limits = (10.0, 40.0, 100.0)
    if row is not None and row.runs:
        p95 = [row.figures["position_p95_mm"][a] for a in "xyz"]
        turned = row.figures["rotation_p95_deg"]
        whole = None not in (*p95, turned)
        ours = f"{' / '.join(f'{0.1 * p:.2f}' for p in p95)} cm / {turned:.1f}°" if whole else "–"
        good = whole and all(p <= m for p, m in zip(p95, limits, strict=True)) and turned <= 4.0
        asked = f"350 particles: 95th percentile of x / y / z / rotation ≤ 1 / 4 / 10 cm / 4°{where}"
        found.append((asked, "largest 3 / 15 / 40 cm / 7°", ours, good))
        text = f"{row.runs - row.lost} of {row.runs}"
        found.append((f"350 particles: runs kept, all{where}", "all", text, _kept_runs(row, 0.0)))
    row = drive.get("50, known start")
    if row is not None:
        asked = f"50 particles: runs that lose the ball, ≤ 2 of 20{where}"
        found.append((asked, "2 of 3", f"{row.lost} of {row.runs}", _kept_runs(row, 0.1)))
    row = drive.get("350, own start")
    if row is not None:
        asked = f"start without a pose: found within {wand.FOUND_WITHIN} frames, 19 of 20{where}"
        good = None if row.runs < ENOUGH else row.found >= 0.95 * row.runs
        found.append((asked, "not done", f"{row.found} of {row.runs}", good))
    return found
