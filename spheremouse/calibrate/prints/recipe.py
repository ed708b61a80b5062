"""The calibration instructions as a page to print: `recipe.md` and its drawings in, one HTML file out."""

import re
from importlib import resources

from markupsafe import Markup

from spheremouse.calibrate.board import Board
from spheremouse.calibrate.prints.sheets import mm
from spheremouse.files.report.page import page


def recipe(board: Board, square: float, paper_name: str) -> str:
    """Return the page as HTML that needs no other file; its commands are for a board with squares of so many mm."""
    from markdown_it import MarkdownIt

    folder = resources.files(__package__ or "")

    def drawing(match: re.Match[str]) -> str:
        return f'<figure class="{match[1]}">{folder.joinpath(f"{match[1]}.svg").read_text(encoding="utf-8")}</figure>'

    text = folder.joinpath("recipe.md").read_text(encoding="utf-8")
    text = text.replace("--board 11x8", f"--board {board.columns}x{board.rows}")
    title, text = text.replace("--square 20mm", f"--square {mm(square)}mm").removeprefix("# ").split("\n", 1)
    body = re.sub(r"<!-- sketch: (\w+) -->", drawing, MarkdownIt("commonmark").render(text))
    paper = paper_name.capitalize() if paper_name == "letter" else paper_name.upper()
    return page(title, "", Markup(body), paper=paper)
