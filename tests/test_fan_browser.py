"""The fan of futures in a real browser: controls, swapped motions, themes; in JupyterLab, where Python imagines."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from browser import new_page, running_cell, wait_until_ready
from test_fan import Imagination
from widget_page import page_of

from tutorial_lib.view import Fan
from tutorial_lib.view.benchmark import stand_in

FAN = "document.querySelector('.host').fan"

pytestmark = pytest.mark.usefixtures("closed_afterwards")


@pytest.fixture(scope="module")
def clips():
    return {"stroll": stand_in(60, seed=1), "jog": stand_in(25, seed=2)}


@pytest.fixture
def fan(clips) -> Fan:
    return Fan(clips, Imagination(), count=4, picture=False)


def opened(browser, folder, *fans, copies: int = 1, **choices):
    page = new_page(browser, **choices)
    page.goto(page_of(list(fans), folder / "page.html", copies))
    page.wait_for_function(
        "n => [...document.querySelectorAll('.host')].filter(e => e.fan?.player?.drawn).length >= n",
        arg=copies * len(fans),
    )
    return page


def asked(page) -> list[dict]:
    """What Python would have been asked for, one message after another."""
    return [message["choice"] for message in page.evaluate("models[0].told")]


def answer(page, fan: Fan) -> None:
    """What Python would have answered to the last message."""
    fan.widget.choice = asked(page)[-1]
    page.evaluate("shown => models[0].set('shown', shown)", fan.widget.shown)
    page.wait_for_function(f"{FAN}.player.characters?.length === {len(fan.motions)}")


def test_controls_ask_when_they_are_let_go(browser, fan, tmp_path):
    page = opened(browser, tmp_path, fan)
    assert page.evaluate(f"{FAN}.player.characters.length") == 4
    seen = np.reshape(page.evaluate(f"[...{FAN}.player.characters[3].positions]"), (40, -1, 3))
    really = fan.motions[3].positions
    assert np.abs(seen + really[0, 0] - really).max() < 3e-3
    names = ("Where the past", "How many", "Temperature")
    first, count, heat = (page.get_by_role("slider", name=name) for name in names)
    assert (first.get_attribute("max"), count.get_attribute("max"), heat.get_attribute("max")) == ("40", "12", "3")
    first.fill("33")
    assert page.get_by_text("at 1.10 s, 20 frames").is_visible()
    count.fill("2")
    heat.fill("0")
    assert page.get_by_text("0.0, no chance at all").is_visible()
    page.get_by_role("button", name="Draw others").click()
    page.get_by_role("button", name="jog").click()
    base = {"clip": 0, "first": 33, "count": 4, "temperature": 1, "seed": 0}
    assert asked(page) == [base, base | {"count": 2}, base | {"count": 2, "temperature": 0},
                           base | {"count": 2, "temperature": 0, "seed": 1},
                           {"clip": 1, "first": 5, "count": 2, "temperature": 0, "seed": 1}]  # fmt: skip
    assert first.get_attribute("max") == "5", "a shorter clip"
    answer(page, fan)
    assert page.get_by_role("button", name="jog").get_attribute("aria-pressed") == "true"
    page.get_by_role("button", name="jog").click()
    assert len(asked(page)) == 5 and page.errors == [] and len(page.asked) == 1, "the page itself"


def test_time_and_view_stay_when_other_futures_come(browser, fan, tmp_path):
    page = opened(browser, tmp_path, fan)
    page.evaluate(f"{FAN}.player.seek(31)")
    page.evaluate(f"Object.assign({FAN}.player.state, {{ zoom: 0.5, overlay: false }})")
    page.get_by_role("slider", name="How many").fill("6")
    answer(page, fan)
    state = page.evaluate(f"({{ ...{FAN}.player.state }})")
    assert state["t"] == pytest.approx(31 / 30) and state["zoom"] == 0.5 and not state["overlay"]
    assert page.locator("canvas").count() == 1 and page.errors == []


def test_what_python_says_is_told(browser, fan, tmp_path):
    page = opened(browser, tmp_path, fan)
    page.evaluate("models[0].set('busy', true)")
    assert page.get_by_text("imagining").is_visible()
    page.evaluate("models[0].set('note', 'a prefix of another skeleton'); models[0].set('busy', false)")
    assert page.get_by_text("a prefix of another skeleton").is_visible()
    page.evaluate(f"models[0].set('choice', {{ ...{FAN}.state, count: 9 }})")
    assert page.get_by_role("slider", name="How many").input_value() == "9" and asked(page) == []


def test_keys_move_the_slider_and_nothing_else(browser, fan, tmp_path):
    """JupyterLab listens on the document while keys are on their way down, and moves from cell to cell."""
    page = opened(browser, tmp_path, fan)
    page.evaluate("window.taken = 0; document.addEventListener('keydown', () => taken++, true)")
    page.get_by_role("slider", name="How many").focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("taken") == 0 and asked(page)[-1]["count"] == 5
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("taken") == 1 and len(asked(page)) == 1


def test_two_fans_one_shown_twice_narrow_and_dark(browser, fan, clips, tmp_path):
    other = Fan(clips, Imagination(), clip="jog", count=2, picture=False)
    page = opened(browser, tmp_path, fan, other, copies=2, viewport={"width": 360, "height": 900}, color_scheme="dark")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    counts = page.evaluate("[...document.querySelectorAll('.host')].map(e => e.fan.player.characters.length)")
    assert counts == [4, 2, 4, 2]
    shade = "e => getComputedStyle(e).backgroundColor.match(/\\d+/g).reduce((a, b) => a + +b, 0)"
    assert page.locator(".fan").first.evaluate(shade) < 150
    page.evaluate("leave[0]()")
    page.locator(".host").nth(2).get_by_role("button", name="Draw others").click()
    assert len(asked(page)) == 1 and page.errors == []


# -- notebooks -----------------------------------------------------------------------------------------------

CELL = """import numpy as np
from tutorial_lib.motion import Motion
from tutorial_lib.view import Fan
from tutorial_lib.view.benchmark import stand_in

def futures(prefix, count, temperature, seed):
    later = np.linspace(0, 1, 20)[:, None, None] * (1, 0, 1)
    return [Motion(prefix.skeleton, 30, np.concatenate([prefix.positions, prefix.positions[-1] + k * later]))
            for k in range(count)]

Fan({"stroll": stand_in(60, seed=1)}, futures, count=2)"""


def test_in_jupyterlab_python_imagines_what_is_asked_for(browser, tmp_path):
    with running_cell(browser, tmp_path, CELL) as page:
        panel = page.locator(".fan")
        panel.wait_for(timeout=60_000)
        panel.scroll_into_view_if_needed()
        page.locator(".jp-RenderedImage").wait_for(state="hidden")
        page.locator("[data-motion-player]").wait_for(state="hidden")
        live = "[...document.querySelectorAll('*')].find(e => e.fan).fan"
        page.wait_for_function(f"{live}.player?.drawn", timeout=30_000)
        page.get_by_role("slider", name="How many").fill("5")
        page.wait_for_function(f"{live}.player.characters?.length === 5", timeout=30_000)
        page.get_by_role("slider", name="How many").focus()
        page.keyboard.press("ArrowLeft")
        page.wait_for_function(f"{live}.player.characters?.length === 4", timeout=30_000)
        assert [e for e in page.errors if "WebSocket" not in e] == []


def test_an_exported_notebook_shows_the_first_fan_in_a_player(browser, clips, tmp_path):
    nbconvert, nbformat = pytest.importorskip("nbconvert"), pytest.importorskip("nbformat")
    fan = Fan(clips, Imagination(), count=3)
    view = {"version_major": 2, "version_minor": 0, "model_id": "none"}
    bundles = [
        {"image/png": base64.b64encode(fan.png).decode(), "text/plain": fan.alt},
        {"text/html": fan.player.html, "text/plain": repr(fan.player)},
        {"application/vnd.jupyter.widget-view+json": view, "text/html": fan.html, "text/plain": repr(fan)},
    ]
    outputs = [nbformat.v4.new_output("display_data", data=json.loads(json.dumps(data))) for data in bundles]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("fan", outputs=outputs)])
    body, _ = nbconvert.HTMLExporter().from_notebook_node(notebook)
    (tmp_path / "exported.html").write_text(body, encoding="utf-8")
    page = new_page(browser)
    page.route(lambda url: not url.startswith("file:"), lambda route: route.abort())  # nbconvert's own MathJax
    page.goto((tmp_path / "exported.html").as_uri())
    wait_until_ready(page)
    assert page.locator("img").bounding_box()["width"] == 720
    assert page.evaluate("document.querySelector('[data-motion-player]').player.characters.length") == 3
    assert page.get_by_text("Choosing needs a live kernel").is_visible()
