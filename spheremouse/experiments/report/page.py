"""The sections of experiments as a page of Markdown, and their numbers as JSON."""

from collections.abc import Mapping
from pathlib import Path

from spheremouse import __version__
from spheremouse.experiments.kit.job import Figure, Result, Section, Table
from spheremouse.experiments.report.plot import save
from spheremouse.files.atomic import write_atomically, write_json

_MISSING = "–"
_QUICK = " A quick run: mostly one short film where the whole has several; not to be quoted."


def write_report(out: Path, sections: Mapping[str, tuple[str, Section]], command: str) -> list[Path]:
    """experiments.md, experiments.json and the figures in experiments/; what was written.

    `sections`: title and section by the experiments' names, in their order; `command` is what was typed.
    """
    folder, written = out / "experiments", []
    lines = [
        "# Experiments",
        "",
        f"Made by `{command}`, spheremouse {__version__}. Values of the theses are typed in; all others come from the "
        "run, and so do the figures." + (_QUICK if "--quick" in command.split() else ""),
        "",
        "`ekf1` and `ekf2` are the filters of Wittich 2017 as published, with our detector unless it says otherwise; "
        "`so3` is ours, the default. RMSE: root mean square error; attitude as a rotation vector, relative to the "
        "first frame; combined: of all three axes together. What failed is a row that says so, or is counted among the "
        f"films of its row; {_MISSING} stands where there is no value.",
        "",
        "The bound (Cramér-Rao, posterior): what a best filter reaches on average with centres as noisy as those that "
        "`so3` measured ([accuracy](accuracy.md)). It takes for noise what centres have wrong alike in every frame, "
        "and an error is that of one film: values below it occur.",
        "",
        "The films of Wittich 2017 that ours are compared with: R1 is real, somebody plays on a ball of 32 discs. S1, "
        "S2 and S3 are modelled, with 26, 50 and 74 discs before the far camera (2.35 m from the ball's centre), S4 "
        "with 50 before the near one (1.35 m); the ball turns for ten seconds at up to 28 °/s and back, 300 frames. "
        "Those films are not available: ours have those cameras and that motion. far26 is a Blender recording like S1, "
        "with struts, highlights and a room; our own films show the same device and room, each experiment says with "
        "what noise. So figures are compared between films that were made alike, not between the same pictures.",
    ]
    for name, (title, section) in sections.items():
        lines += ["", f"({name})=", f"## {title}", ""]
        for part in section.parts:
            if isinstance(part, Table):
                lines += [*_table(part), ""]
            elif isinstance(part, Figure):
                written += save(part, folder)
                lines += [*_figure(part, folder.name), ""]
            else:
                lines += [part, ""]
    page, numbers = out / "experiments.md", out / "experiments.json"
    write_atomically(page, "\n".join(lines).rstrip() + "\n")
    write_json(numbers, {name: section.figures for name, (_, section) in sections.items()})
    return [page, numbers, *written]


def value(result: Result | None, *path: str, digits: int = 2, factor: float = 1.0) -> str:
    """A number of a result for a cell: `value(r, "rate_rmse_deg_s", "combined")`. A failure says so, nothing is –."""
    if result is None:
        return _MISSING
    if "error" in result:
        return "failed"
    found = result
    for key in path:
        found = found.get(key) if isinstance(found, dict) else None
    return _MISSING if not isinstance(found, int | float) else f"{factor * found:.{digits}f}"


def failures(results: Mapping[str, Result]) -> list[str]:
    """What failed, a line each, as a list of Markdown."""
    return [f"- {key}: {result['error']}" for key, result in results.items() if "error" in result]


def _table(table: Table) -> list[str]:
    title = [f"**{table.title}**", ""] if table.title else []
    lines = [table.head, ("---",) * len(table.head), *table.rows]
    return title + ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def _figure(figure: Figure, folder: str) -> list[str]:
    """Both forms of it: the page shows the one that suits."""
    lines: list[str] = []
    for kind in ("light", "dark"):
        lines += [
            f"```{{figure}} {folder}/{figure.name}-{kind}.svg",
            f":class: only-{kind}",
            "",
            figure.caption,
            "```",
        ]
    return lines
