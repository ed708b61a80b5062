"""The pages of docs/ can be found: each once in the index, under one of four kinds; decisions by their numbers."""

import importlib
import re
from collections import Counter
from pathlib import Path

from spheremouse.files.config import loads, parameters
from spheremouse.files.yaml import parse_document
from spheremouse.session.settings import Configuration

DOCS = Path(__file__).parents[1] / "docs"
NO_PAGES = {"index", "figures"}  # the index itself, and a part of accuracy


def test_every_page_is_of_one_kind_and_the_list_that_is_read_is_the_one_of_the_sidebar():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    kinds = re.findall(r"^## (.+?)\n(.+?)```{toctree}\n:caption: \1\n:hidden:\n\n(.+?)\n```", index, re.M | re.S)
    assert [name for name, _, _ in kinds] == ["Tutorials", "How-to guides", "Reference", "Explanation"]
    listed = [re.findall(r"^- \[.+?\]\((.+?)\.md\): .", text, re.MULTILINE) for _, text, _ in kinds]
    assert listed == [sidebar.splitlines() for _, _, sidebar in kinds]
    pages = {path.stem for path in DOCS.glob("*.md")} - NO_PAGES
    assert Counter(name for names in listed for name in names) == Counter(pages)
    assert "(decisions/index.md)" in index


def test_decisions_are_numbered_without_a_gap_and_say_why():
    pages = sorted((DOCS / "decisions").glob("[0-9]*.md"))
    assert [int(path.name[:4]) for path in pages] == list(range(1, len(pages) + 1))
    for number, path in enumerate(pages, 1):
        text = path.read_text(encoding="utf-8")
        assert text.startswith(f"# {number}. "), path.name
        assert "\n## Rationale\n" in text, path.name


def test_the_pages_of_settings_have_each_setting_once(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    made, listed = importlib.import_module("configuration_page"), []
    for path, tables in made.PAGES:
        page = path.read_text(encoding="utf-8")
        assert page == made.written(page, tables()), "python docs/configuration_page.py --write"
        text = page.partition("configuration_page.py --write -->")[2]
        listed += re.findall(r"^\| `([a-z_0-9.]+)` \|", text, re.MULTILINE)
    assert sorted(listed) == sorted(".".join(key) for key, _ in parameters(Configuration()))


def test_the_file_that_the_configuration_page_shows_is_one():
    text = (DOCS / "configuration.md").read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0]
    assert loads(parse_document(text, "page"), Configuration).motion.counts_per_mm == 2.0
