"""The hand-held ball: accuracy, runs that lose it, start without a pose, speed (Grzonka 2005, chapter 4)."""

from typing import Any

from spheremouse import wand_experiments as wand
from spheremouse.cli_evaluate_wand import axes, shown
from spheremouse.experiments.experiment import Job, Request, Result, Results, Section, Table
from spheremouse.experiments.report import failures

TITLE = "The hand-held ball (Grzonka 2005, chapter 4)"
_SPEEDS = "speeds"
_HEAD = (
    "film",
    "particles",
    "runs",
    "lost",
    "tracked, %",
    "found in 5",
    "p95 x  y  z, cm",
    "max x  y  z, cm",
    "rotation p95, max, °",
    "ANEES position, rotation",
    "within 95 %, %",
)


def jobs(request: Request) -> list[Job]:
    """Each film with each seed, and the speeds."""
    films = [
        Job(job.key, film, {"key": job.key, "quick": request.quick}, cost=10.0 * len(job.film.variants))
        for job in wand.jobs(request.quick)
    ]
    return [*films, Job(_SPEEDS, speeds, alone=True)]


def film(key: str, quick: bool) -> Result:
    """What the trackers made of one film."""
    (job,) = [job for job in wand.jobs(quick) if job.key == key]
    return wand.work(job)


def speeds() -> Result:
    """Frames per second."""
    return wand.measure_speeds()


def section(request: Request, results: Results) -> Section:
    """What is to be reached, what each film gave, and how fast it was."""
    timed = results.get(_SPEEDS, {})
    timed = {} if "error" in timed else timed
    table = wand.rows(request.quick, {key: r for key, r in results.items() if key != _SPEEDS})
    reached = wand.verdicts(table, timed)
    failed = failures(results)
    parts = (
        Table(("asked", "thesis", "ours", "reached"), tuple((a, t, o, _word(good)) for a, t, o, good in reached)),
        Table(_HEAD, tuple(_cells(row) for row in table), "Films and trackers"),
        Table(
            ("", "median fps", "mean fps", "90th percentile, ms"),
            tuple((n, f"{s['fps']:.0f}", f"{s['mean_fps']:.0f}", f"{s['p90_ms']:.1f}") for n, s in timed.items()),
            "Speed, one core",
        ),
        *(["\n".join(failed)] if failed else []),
    )
    figures: dict[str, Any] = {
        "rows": [
            {
                "film": row.film.name,
                "variant": row.variant,
                "runs": row.runs,
                "lost_runs": row.lost,
                "found_within_5": row.found,
                "tracked": row.tracked,
                "failures": list(row.failures),
                **row.figures,
            }
            for row in table
        ],
        "speeds": timed,
        "reached": [{"asked": a, "thesis": t, "ours": o, "reached": good} for a, t, o, good in reached],
    }
    return Section(parts, figures)


def _cells(row: wand.Row) -> tuple[str, ...]:
    figures = row.figures
    if row.runs == 0:
        failed = "failed: see below" if row.failures else "not done"
        return f"{row.film.name}: {row.film.words}", row.variant, "0", failed, *["–"] * (len(_HEAD) - 4)
    name = f"{row.film.name}: {row.film.words}" + (f" ({len(row.failures)} failed)" if row.failures else "")
    return (
        name,
        row.variant,
        str(row.runs),
        str(row.lost),
        f"{100.0 * row.tracked:.1f}",
        str(row.found),
        axes(figures["position_p95_mm"], ".2f", 0.1),
        axes(figures["position_max_mm"], ".2f", 0.1),
        f"{shown(figures['rotation_p95_deg'], '.2f')}  {shown(figures['rotation_max_deg'], '.2f')}",
        f"{shown(figures['anees']['position'])}  {shown(figures['anees']['rotation'])}",
        "–" if figures["within_95"] is None else f"{100.0 * figures['within_95']:.1f}",
    )


def _word(good: bool | None) -> str:
    return "not measured" if good is None else "yes" if good else "no"
