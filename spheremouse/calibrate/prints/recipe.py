"""The capture recipe as a page to print: `recipe.md` in, one HTML file with its drawings out."""

import re
from importlib import resources

from markupsafe import Markup

from spheremouse.calibrate.board import Board
from spheremouse.calibrate.prints.sheets import mm
from spheremouse.calibrate.prints.sketches import sketches
from spheremouse.files.report.page import page


def recipe(board: Board, square: float, paper_name: str) -> str:
    """The page as HTML, its commands for a board of squares of so many mm. It needs no other file."""
    from markdown_it import MarkdownIt

    text = resources.files("spheremouse.calibrate.prints").joinpath("recipe.md").read_text(encoding="utf-8")
    text = text.replace("--board 11x8", f"--board {board.columns}x{board.rows}")
    title, text = text.replace("--square 20mm", f"--square {mm(square)}mm").removeprefix("# ").split("\n", 1)
    drawings = sketches()
    body = MarkdownIt("commonmark").render(text)
    body = re.sub(r"<!-- sketch: (\w+) -->", lambda m: f'<figure class="{m[1]}">{drawings[m[1]]}</figure>', body)
    paper = paper_name.capitalize() if paper_name == "letter" else paper_name.upper()
    return page(title, "", [Markup(body)], paper=paper)
