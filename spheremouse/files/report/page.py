"""A report as one HTML file: blocks of text, tables and figures in, a page that needs nothing beside it out.

It follows the reader's light or dark screen, and prints in black on white. Figures are drawn by matplotlib in the
colours below and put in as SVG, whose ink then follows the page. Needs matplotlib, loaded when something is drawn.
"""

import base64
import html
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from spheremouse.files.report.style import require_matplotlib
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours of figures. Each is also a variable of the page, lighter where the screen is dark.
INK, MUTED, GRID, PAPER = "#222831", "#7b8490", "#dfe3e8", "#fefefd"
BLUE, RED, GREEN, GOLD = "#2f6690", "#c8553d", "#3a7d5d", "#b8860b"
_VARIABLES = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    PAPER: "paper",
    BLUE: "blue",
    RED: "red",
    GREEN: "green",
    GOLD: "gold",
}
_MARKS = {"good": "✓", "note": "i", "warning": "!"}

_STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.edgecolor": MUTED,
    "axes.facecolor": "none",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "figure.facecolor": "none",
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "svg.fonttype": "none",  # words stay words
    "svg.hashsalt": "spheremouse",  # the same report twice is the same file
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}

_CSS = """
:root { color-scheme: light dark; --ink: #222831; --muted: #67707b; --grid: #dfe3e8; --paper: #fefefd;
  --panel: #f4f6f8; --blue: #2f6690; --red: #c8553d; --green: #3a7d5d; --gold: #b8860b; }
@media screen and (prefers-color-scheme: dark) { :root { --ink: #e4e8ec; --muted: #98a2ad; --grid: #353c45;
  --paper: #16191d; --panel: #1f242a; --blue: #74add6; --red: #ec8a73; --green: #77c39d; --gold: #dcb54f; } }
* { box-sizing: border-box; }
html { background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
body { max-width: 62rem; margin: 0 auto; padding: 2.5rem 1.25rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; letter-spacing: -.01em; }
h2 { font-size: 1.2rem; margin: 2.8rem 0 .7rem; padding-top: .9rem; border-top: 1px solid var(--grid); }
p { margin: .5rem 0; max-width: 46rem; }
.lead { color: var(--muted); }
code { font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: .9em; }
.numbers { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.2rem 0; }
.numbers div { flex: 1 1 11rem; background: var(--panel); border-radius: .6rem; padding: .8rem 1rem; }
.numbers dt { color: var(--muted); font-size: .82rem; }
.numbers dd { margin: 0; font-size: 1.35rem; font-variant-numeric: tabular-nums; }
.numbers small { display: block; color: var(--muted); font-size: .78rem; }
ul.advice { list-style: none; padding: 0; margin: 1rem 0; max-width: 48rem; }
ul.advice li { display: flex; gap: .7rem; margin: .45rem 0; }
ul.advice b { flex: none; width: 1.35rem; height: 1.35rem; margin-top: .1rem; border-radius: 50%; text-align: center;
  font-size: .85rem; line-height: 1.35rem; color: var(--paper); background: var(--blue); }
ul.advice .good b { background: var(--green); }
ul.advice .warning b { background: var(--red); }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; }
th, td { padding: .26rem .75rem; text-align: right; white-space: nowrap; }
th { color: var(--muted); font-weight: 500; border-bottom: 1px solid var(--grid); vertical-align: bottom; }
td:first-child, th:first-child, .text { text-align: left; }
tbody tr:nth-child(even) td { background: var(--panel); }
tr.faulty td { color: var(--red); }
table.matrix td, table.matrix th { padding: .26rem .5rem; }
table.matrix tbody tr:nth-child(even) td { background: none; }
figure { margin: 1.2rem 0; }
figure svg, figure img { display: block; max-width: 100%; height: auto; }
figure svg text { font-family: inherit !important; }
figcaption { color: var(--muted); font-size: .84rem; margin-top: .4rem; max-width: 46rem; }
.beside { display: flex; flex-wrap: wrap; gap: 0 1.5rem; }
.beside > div { flex: 1 1 22rem; min-width: 0; }
.sheet { display: flex; flex-wrap: wrap; gap: .9rem; margin: 1rem 0; }
.sheet figure { flex: 0 0 11.4rem; margin: 0; }
.sheet img { width: 100%; border-radius: .35rem; }
footer { margin-top: 3.5rem; padding-top: .8rem; border-top: 1px solid var(--grid); color: var(--muted);
  font-size: .8rem; }
@media print { html { font-size: 11px; } body { max-width: none; padding: 0; } h2 { break-after: avoid; }
  figure, .numbers, tr, li { break-inside: avoid; } @page { margin: 16mm; } }
"""


def page(title: str, lead: str, blocks: Sequence[str], foot: str) -> str:
    """The whole file. `blocks` are what the functions below give; all other text is plain."""
    body = "\n".join(blocks)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_plain(title)}</title>\n<style>{_CSS}</style>\n</head>\n<body>\n"
        f'<h1>{_plain(title)}</h1>\n<p class="lead">{_plain(lead)}</p>\n{body}\n<footer>{_plain(foot)}</footer>\n'
        "</body>\n</html>\n"
    )


def section(heading: str, *blocks: str) -> str:
    """Blocks under a heading."""
    return f"<section>\n<h2>{_plain(heading)}</h2>\n" + "\n".join(blocks) + "\n</section>"


def paragraph(text: str) -> str:
    """Plain text; what stands between backticks is set as code."""
    return f"<p>{_worded(text)}</p>"


def numbers(items: Sequence[tuple[str, str, str]]) -> str:
    """The few figures that matter most, large: what it is, its value, a remark."""
    cards = "".join(
        f"<div><dt>{_plain(name)}</dt><dd>{_plain(value)}<small>{_plain(remark)}</small></dd></div>"
        for name, value, remark in items
    )
    return f'<dl class="numbers">{cards}</dl>'


def advice(items: Sequence[tuple[str, str]]) -> str:
    """A list of ("good" | "note" | "warning", text)."""
    lines = "".join(
        f'<li class="{kind}"><b>{_MARKS[kind]}</b><span>{_worded(text)}</span></li>' for kind, text in items
    )
    return f'<ul class="advice">{lines}</ul>'


def table(head: Sequence[str], rows: Sequence[Sequence[str]], faulty: Sequence[bool] = (), text: int = 1) -> str:
    """A table. `faulty` rows are set in red; the first `text` columns hold words, the others figures."""

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(
            f'<{tag} class="text">{_worded(c)}</{tag}>' if i < text else f"<{tag}>{_worded(c)}</{tag}>"
            for i, c in enumerate(row)
        )

    bad = [*faulty, *[False] * (len(rows) - len(faulty))]
    body = "".join(
        f"<tr{' class=faulty' if b else ''}>{cells(row, 'td')}</tr>" for row, b in zip(rows, bad, strict=True)
    )
    return f'<div class="wide"><table><thead><tr>{cells(head, "th")}</tr></thead><tbody>{body}</tbody></table></div>'


def correlations(names: Sequence[str], matrix: Array) -> str:
    """The lower half of a correlation matrix, (n, n), each cell the fuller of colour the nearer it is to 1 or -1."""
    rows = []
    for i, name in enumerate(names):
        cells = [f"<td>{_plain(name)}</td>"]
        for j in range(i):
            r = float(matrix[i, j])
            colour, share = ("blue" if r >= 0 else "red"), round(70 * abs(r))
            cells.append(
                f'<td style="background: color-mix(in srgb, var(--{colour}) {share}%, transparent)">{r:+.2f}</td>'
            )
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = "".join(f"<th>{_plain(name)}</th>" for name in ("", *names[:-1]))
    return (
        f'<div class="wide"><table class="matrix"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows[1:])}</tbody></table></div>"
    )


def figure(drawing: "Figure", caption: str) -> str:
    """A figure of matplotlib as SVG that follows the page's colours; the caption is what a screen reader says, too."""
    return f"<figure>{svg(drawing, caption)}<figcaption>{_worded(caption)}</figcaption></figure>"


def picture(data: bytes, caption: str, kind: str = "jpeg") -> str:
    """An encoded image, put into the page."""
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    return (
        f'<figure><img src="{source}" alt="{_plain(caption)}" loading="lazy">'
        f"<figcaption>{_worded(caption)}</figcaption></figure>"
    )


def beside(*blocks: str) -> str:
    """Blocks next to each other where the screen is wide enough."""
    return f'<div class="beside">{"".join(f"<div>{b}</div>" for b in blocks)}</div>'


def sheet(pictures: Sequence[str]) -> str:
    """Many small pictures."""
    return f'<div class="sheet">{"".join(pictures)}</div>'


@contextmanager
def drawn() -> Iterator[None]:
    """Figures made in this block look like the page; ConfigurationError without matplotlib."""
    require_matplotlib()
    import matplotlib as mpl
    from matplotlib import style

    with style.context("default"), mpl.rc_context(_STYLE):  # type: ignore[arg-type]
        yield


def svg(drawing: "Figure", title: str) -> str:
    """An `<svg>` element whose colours are variables of the page."""
    file = io.StringIO()
    with drawn():
        drawing.savefig(file, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, f"var(--{variable})")
    return text.replace("<svg ", f'<svg role="img" aria-label="{_plain(title)}" ', 1)


def _plain(text: str) -> str:
    return html.escape(str(text), quote=True)


def _worded(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", _plain(text))
