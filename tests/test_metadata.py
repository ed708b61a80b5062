"""What an index of packages shows of the program: a description that reads without our pages, and known classifiers."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from trove_classifiers import classifiers

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def metadata():
    command = [sys.executable, "-m", "scikit_build_core.build", "project-table"]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout)


def test_the_description_leads_nowhere_that_an_index_has_not(metadata):
    inline = [t for token in MarkdownIt().parse(metadata["readme"]["text"]) for t in token.children or ()]
    places = [t.attrGet("href") or t.attrGet("src") for t in inline if t.type in ("link_open", "image")]
    assert [place for place in places if not place.startswith("https://")] == []
    assert "<!--" not in metadata["readme"]["text"]
    assert "](" not in metadata["readme"]["text"]
    assert metadata["readme"]["content-type"] == "text/markdown"


def test_nothing_but_links_pictures_and_notes_is_left_out_of_it(metadata):
    kept, there = set(metadata["readme"]["text"].splitlines()), (ROOT / "README.md").read_text().splitlines()
    gone = [line for line in there if line not in kept]
    assert all("](" in line or line.startswith(("<!--", "*The ")) for line in gone), gone


def test_classifiers_are_known_and_somebody_has_written_it(metadata):
    assert set(metadata["classifiers"]) <= classifiers
    assert metadata["authors"]
    assert metadata["keywords"]
    assert "urls" not in metadata  # until there are some


def test_an_upper_bound_has_its_reason_beside_it():
    for line in (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines():
        if line.startswith('  "') and ",<" in line:
            assert "#" in line, line
