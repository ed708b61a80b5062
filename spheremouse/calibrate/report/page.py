"""The HTML page of a calibration: the figures of its JSON, a drawing, and pictures of the photos."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from spheremouse.files.figures import figure_rows, photo_rows
from spheremouse.files.report.page import page, render
from spheremouse.files.report.style import styled
from spheremouse.files.safe_files import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Content(NamedTuple):
    """All of a page but the tables, which come from the JSON."""

    title: str
    lead: str
    headlines: Sequence[tuple[str, str, str]]  # name, value, remark
    advice: Sequence[tuple[str, str]]  # "good", "note" or "warning", and a sentence
    draw: "Callable[[], Figure]"
    caption: str  # of the drawing
    values: str  # remark on the table of values
    legend: str  # of the pictures
    pictures: Sequence[tuple[bytes, str]]  # JPEG and caption


def write_report(path: Path, content: Content, data: Any, provenance: Mapping[str, Any]) -> None:
    """Write one HTML file that needs no other; `data` are the figures as JSON. ConfigurationError if that fails."""
    photos = list(photo_rows(data))
    with styled():
        body = render(
            "spheremouse.calibrate.report",
            "report.html",
            content=content,
            drawing=content.draw(),
            rows=list(figure_rows(data)),
            photos=[
                (p["file"], "-" if p["rms_px"] is None else f"{p['rms_px']:.3f}", str(p["points"] or "-"), p["why"])
                for p in photos
            ],
            faulty=[bool(p["why"]) for p in photos],
        )
    foot = " · ".join(str(provenance[key]) for key in ("made_by", "date") if key in provenance)
    write_atomically(path, page(content.title, content.lead, body, foot))
