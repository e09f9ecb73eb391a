"""The site of lessons: built offline by one command, alive in a browser, and asking no other host for anything."""

from __future__ import annotations

import html.parser
import importlib.util
import json
import os
import pathlib
import re
import subprocess
import sys

import pytest
from browser import new_page, picture

ROOT = pathlib.Path(__file__).resolve().parents[1]
LESSONS = sorted(path.stem for path in (ROOT / "notebooks").glob("[0-9]*.ipynb"))
LACKING = [name for name in ("sphinx", "myst_nb", "furo") if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.skipif(bool(LACKING), reason=f"not installed: {', '.join(LACKING)} (pip install -e '.[docs]')"),
    pytest.mark.usefixtures("closed_afterwards"),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[pathlib.Path, str]:
    """The folder of pages, and what the build told."""
    folder = tmp_path_factory.mktemp("site")
    result = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-c", "docs", ".", str(folder / "html")],
        cwd=ROOT, capture_output=True, text=True, timeout=600, env={**os.environ, "TUTORIAL_OFFLINE": "1"},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return folder / "html", result.stderr


@pytest.fixture(scope="module")
def site(built) -> pathlib.Path:
    return built[0]


class Needed(html.parser.HTMLParser):
    """What a page loads by itself, and where its links lead."""

    def __init__(self, page: pathlib.Path):
        super().__init__()
        self.loads, self.links = [], []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag == "a" and attributes.get("href"):
            self.links.append(attributes["href"])
        elif tag in ("script", "img", "iframe", "source", "video") and attributes.get("src"):
            self.loads.append(attributes["src"])
        elif tag == "link" and attributes.get("rel") in ("stylesheet", "icon", "preload", "modulepreload"):
            self.loads.append(attributes["href"])


def figures(lesson: str, kind: str) -> int:
    """How many moving figures of a kind a notebook holds."""
    notebook = json.loads((ROOT / "notebooks" / f"{lesson}.ipynb").read_text(encoding="utf-8"))
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", ())]
    pages = ["".join(output.get("data", {}).get("text/html", "")) for output in outputs]
    return sum(text.lstrip().startswith(f"<div data-motion-{kind}=") for text in pages)


def test_the_build_finds_nothing_wrong(built):
    """But for how docstrings are laid out, which is their modules' matter."""
    told = [line for line in built[1].splitlines() if ("WARNING" in line or "ERROR" in line)]
    assert [line for line in told if "docstring of" not in line] == []


def test_pages_load_and_link_only_what_is_there(site):
    pages = sorted(site.rglob("*.html"))
    assert {f"{lesson}.html" for lesson in LESSONS} <= {page.name for page in pages}
    for page in pages:
        needed = Needed(page)
        assert [load for load in needed.loads if re.match(r"(https?:)?//", load)] == [], page
        if "_modules" in page.parts:
            continue
        for link in (*needed.loads, *needed.links):
            target = link.partition("#")[0].partition("?")[0]
            if target and not re.match(r"[a-z]+:", target):
                assert (page.parent / target).exists(), f"{page.relative_to(site)} leads to {link}"


def test_every_public_module_is_told_of(site):
    told = "".join(page.read_text(encoding="utf-8") for page in (site / "docs" / "api").glob("*.html"))
    for name in ("motion.clip.Motion", "data.windows.WindowSampler", "training.trainer.Trainer", "generate.generate",
                 "view.player.show", "training.parallel.Workers"):  # fmt: skip
        assert f'id="tutorial_lib.{name}"' in told, name


@pytest.mark.parametrize("lesson", LESSONS)
def test_a_lesson_is_alive(browser, site, lesson):
    """All its figures are there and move, formulas are set, and nothing is asked of any host."""
    page = new_page(browser)
    page.set_default_timeout(180_000)  # beside other load
    page.goto((site / "notebooks" / f"{lesson}.html").as_uri())
    count = figures(lesson, "player")
    page.wait_for_function(
        "n => [...document.querySelectorAll('[data-motion-player]')].filter(e => e.player).length === n",
        arg=count,
    )  # fmt: skip
    if not count:
        pytest.skip("this lesson has no outputs: python notebooks/execute.py makes them")
    player = page.locator(":nth-match([data-motion-player], 1)")
    player.scroll_into_view_if_needed()
    page.wait_for_function("document.querySelector('[data-motion-player]').player.drawn")
    still = picture(page)
    player.get_by_title("Play").click()
    page.wait_for_function("document.querySelector('[data-motion-player]').player.state.t > 0.1")
    assert picture(page) != still
    player.get_by_title("Pause").click()
    stills = page.locator(
        "img.still:has(+ .output [data-motion-player]), img.still:has(+ .output [data-motion-explorer])"
    )
    shown = [stills.nth(k).is_visible() for k in range(stills.count())]
    assert shown and not any(shown), "a picture beside a figure that moves"  # that of a path canvas, a widget, stays
    if figures(lesson, "explorer"):
        page.wait_for_function("document.querySelector('[data-motion-explorer]').explorer")
        text = "document.querySelector('[data-motion-explorer]').shadowRoot.textContent"
        before = page.evaluate(text)
        page.evaluate("document.querySelector('[data-motion-explorer]').explorer.choose(1, 1)")
        assert page.evaluate(text) != before
    source = (ROOT / "notebooks" / f"{lesson}.ipynb").read_text(encoding="utf-8")
    if "$$" in source:
        page.wait_for_function("document.querySelectorAll('mjx-container svg').length > 0")
        assert page.locator("mjx-merror, [data-mjx-error]").count() == 0
    assert page.errors == []
    assert [url for url in page.asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_a_walk_through_the_site(browser, site):
    """From the first address by its links, as a reader goes."""
    page = new_page(browser, viewport={"width": 1400, "height": 900})
    page.set_default_timeout(180_000)
    page.goto((site / "index.html").as_uri())
    page.wait_for_url("**/docs/index.html")
    for name in ("Beyond one machine", "Weights", "The library"):
        page.locator(".sidebar-tree a").get_by_text(name, exact=True).click()
        page.locator("h1").filter(has_text=name).wait_for()
    page.locator("article a").get_by_text("Training", exact=True).click()
    page.locator("article").get_by_text("Trainer", exact=True).first.wait_for()
    page.goto((site / "docs" / "weights.html").as_uri())
    assert "aclstm-cmu-martial" in page.locator("article").inner_text()
    page.locator(".theme-toggle-header, .theme-toggle").locator("visible=true").first.click()
    assert page.evaluate("document.body.dataset.theme") in ("light", "dark")
    assert page.evaluate("document.body.dataset.jpThemeLight") in ("true", "false"), "the figures are told"
    assert page.errors == []
    assert [url for url in page.asked if not url.startswith(("file:", "data:", "blob:"))] == []
