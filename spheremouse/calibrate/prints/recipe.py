"""The capture recipe as a page to print: `recipe.md` in, one HTML file with its drawings out."""

import re
from importlib import resources

from spheremouse.calibrate.lengths import Board
from spheremouse.calibrate.prints.sheets import mm
from spheremouse.calibrate.prints.sketches import sketches


def recipe(board: Board, square: float, paper_name: str) -> str:
    """The page as HTML, its commands for a board of squares of so many mm. It needs no other file."""
    from markdown_it import MarkdownIt

    text = resources.files("spheremouse.calibrate.prints").joinpath("recipe.md").read_text(encoding="utf-8")
    here = f"--board {board.columns}x{board.rows} --square {mm(square)}mm"
    text = text.replace("--board 11x8 --square 20mm", here)
    drawings = sketches()
    body = MarkdownIt("commonmark").render(text)
    body = re.sub(r"<!-- sketch: (\w+) -->", lambda m: f"<figure class='{m[1]}'>{drawings[m[1]]}</figure>", body)
    style = _STYLE.replace("PAPER", paper_name.capitalize() if paper_name == "letter" else paper_name.upper())
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>Calibration in one evening</title>
<style>{style}</style>
</head>
<body>
{body}</body>
</html>
"""


_STYLE = """
@page { size: PAPER; margin: 13mm 16mm; }
* { box-sizing: border-box; }
body { font: 9.8pt/1.4 "Helvetica Neue", Arial, "Liberation Sans", "DejaVu Sans", sans-serif; color: #000;
  background: #fff; max-width: 178mm; margin: 0 auto; }
h1 { font-size: 22pt; line-height: 1.15; margin: 0 0 3mm; padding-bottom: 2mm; border-bottom: 1.2pt solid #000; }
h2 { font-size: 13pt; margin: 5mm 0 1.5mm; break-after: avoid; }
p { margin: 0 0 2mm; }
ul, ol { margin: 0 0 2mm; padding-left: 6mm; }
li { margin-bottom: 1mm; }
code { font: 9pt ui-monospace, "Liberation Mono", "DejaVu Sans Mono", monospace; }
pre { margin: 2mm 0 2.5mm; padding: 2mm 3mm; border: 0.6pt solid #000; border-radius: 1.5mm; white-space: pre-wrap;
  break-inside: avoid; }
figure { margin: 3mm 0 4mm; break-inside: avoid; }
svg { display: block; width: 100%; height: auto; }
.frame svg { width: 60%; margin: 0 auto; }
.device svg { width: 84%; margin: 0 auto; }
svg text { font-family: inherit; fill: #000; }
@media screen { body { padding: 10mm 5mm; } }
@media print { * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""
