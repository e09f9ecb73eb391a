"""What README and CONTRIBUTING say is so: tables are what their commands print, links and commands are there."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import pathlib
import re
import shlex

import pytest
from PIL import Image
from test_imports import FLOORS

from tutorial_lib.cli import _parser, main

ROOT = pathlib.Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tables():
    spec = importlib.util.spec_from_file_location("docs_tables", ROOT / "docs" / "tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_are_what_their_commands_print(tables):
    commands = [found[2] for found in tables.TABLE.finditer(README)]
    assert sorted(commands) == ["data list --markdown", "pretrained list --markdown", "results"]
    for found in tables.TABLE.finditer(README):
        assert found[3].rstrip() == tables.printed(found[2]).rstrip(), "python docs/tables.py writes it anew"


def test_every_lesson_has_its_row():
    for path in sorted((ROOT / "notebooks").glob("[0-9]*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        title = "".join(cells[0]["source"]).splitlines()[0].removeprefix("# ").strip()
        rows = [line for line in README.splitlines() if f"(notebooks/{path.name})" in line and line.startswith("| ")]
        assert len(rows) == 1 and rows[0].startswith(f"| [{title}]("), path.name
        assert len(rows[0].split(" | ")) == 4 and re.search(r"\d+ min \|$", rows[0]), path.name


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_lead_somewhere(name):
    text = re.sub(r"```.*?```", "", (ROOT / name).read_text(encoding="utf-8"), flags=re.DOTALL)
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", text)
    assert links
    assert [link for link in links if not link.startswith("https:") and not (ROOT / link).exists()] == []


def test_commands_are_such():
    """Each of the README's lines is understood, though not run; FILE and the like stand for files."""
    lines = re.findall(r"^(?:\S*/)?python -m tutorial_lib (.+)$", README, flags=re.MULTILINE)
    assert len(lines) > 10
    for line in lines:
        words = shlex.split(line.replace("FILE...", "FILE"), comments=True)
        with contextlib.redirect_stderr(io.StringIO()) as told:
            try:
                _parser().parse_args(words)
            except SystemExit as end:
                raise AssertionError(f"{line}: {told.getvalue()}") from end


def test_the_picture_moves_and_is_small():
    path = ROOT / "docs" / "moving.gif"
    assert "(docs/moving.gif)" in README and path.stat().st_size < 400_000
    with Image.open(path) as image:
        assert image.n_frames > 50 and image.info.get("loop") == 0
        first = image.convert("RGB").tobytes()
        image.seek(image.n_frames // 2)
        assert image.convert("RGB").tobytes() != first


def test_the_house_is_as_it_is_drawn():
    """From the roof down, a floor a line."""
    drawn = CONTRIBUTING.partition("<!-- floors -->")[2].partition("<!-- end -->")[0]
    floors = [re.split(r" {3,}", line)[0].split() for line in drawn.strip().splitlines()[1:-1]]
    assert [set(floor) for floor in floors] == [set(floor) for floor in reversed(FLOORS)]


def test_files_that_contributing_names_are_there():
    named = set(re.findall(r"`((?:tutorial_lib|tests|notebooks|docs)/[\w/.]+\.(?:py|json|yml))`", CONTRIBUTING))
    assert len(named) > 6
    assert [name for name in sorted(named) if not (ROOT / name).exists() and "name" not in name] == []


def test_results_of_one_paper_and_of_none(capsys, fails):
    assert main(["results", "acrnn"]) == 0
    told = capsys.readouterr().out
    assert "Martial Arts" in told and "What the paper finds, and whether it is so here:" in told
    assert main(["results", "side-by-side"]) == 0 and "What the papers say, and whether" in capsys.readouterr().out
    assert "there are acrnn, acrnn-wider, vae-lstm" in fails("results", "nobody")
