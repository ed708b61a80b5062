"""The capture recipe as a page to print: `recipe.md` in, one HTML file with its drawings out."""

import re
from importlib import resources

from markupsafe import Markup

from spheremouse.calibrate.lengths import Board
from spheremouse.calibrate.prints.sheets import mm
from spheremouse.calibrate.prints.sketches import sketches
from spheremouse.files.report.page import page


def recipe(board: Board, square: float, paper_name: str) -> str:
    """The page as HTML, its commands for a board of squares of so many mm. It needs no other file."""
    from markdown_it import MarkdownIt

    text = resources.files("spheremouse.calibrate.prints").joinpath("recipe.md").read_text(encoding="utf-8")
    here = f"--board {board.columns}x{board.rows} --square {mm(square)}mm"
    title, text = text.replace("--board 11x8 --square 20mm", here).removeprefix("# ").split("\n", 1)
    drawings = sketches()
    body = MarkdownIt("commonmark").render(text)
    body = re.sub(r"<!-- sketch: (\w+) -->", lambda m: f'<figure class="{m[1]}">{drawings[m[1]]}</figure>', body)
    paper = paper_name.capitalize() if paper_name == "letter" else paper_name.upper()
    return page(title, "", [Markup(body)], paper=paper)
