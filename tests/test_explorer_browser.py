"""The explorer in a real browser: sliders, schedule, curves, motions, themes, several on a page, exported."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from browser import new_page

from tutorial_lib.data import load
from tutorial_lib.motion import Motion
from tutorial_lib.view import Cell, explorer, show

EXPLORER = "document.querySelector('[data-motion-explorer]').explorer"


pytestmark = pytest.mark.usefixtures("closed_afterwards")


@pytest.fixture(scope="module")
def clips() -> list[Motion]:
    return [load(name)[0].resample(30)[:n] for name, n in (("samples/walking", 90), ("samples/dancing", 150))]


@pytest.fixture(scope="module")
def shown(clips):
    """(2, 2) walks, (5, 5) dances, (1, 5) has no clip, teacher forcing walks; (2, 5) and others are not there."""
    level = np.ones(400)
    return explorer(
        {
            (5, 5): Cell(0.15 * level, clips[1], {"error at 400 ms": 1.885, "frozen": "0 of 20"}, seed_frames=30),
            (2, 2): Cell(0.05 * level, clips[0], {"error at 400 ms": 2.31}, seed_frames=10),
            (1, 5): Cell(0.1 * level, notes={"frozen": "5 of 20"}),
            (5, 0): Cell(0.01 * level, clips[0], {"frozen": "20 of 20"}),
        },
        truth=0.16,
    )


def ready(page, count: int = 1) -> None:
    page.wait_for_function(
        "n => [...document.querySelectorAll('[data-motion-explorer]')].filter(e => e.explorer?.player).length >= n",
        arg=count,
        timeout=20_000,
    )


def opened(browser, shown, folder, **choices):
    page = new_page(browser, **choices)
    page.goto(shown.save(folder / "page.html").as_uri())
    ready(page)
    return page


def fed(page) -> str:
    """The drawn schedule's lowest row, T for truth and o for own output, from left to right."""
    boxes = page.locator(".schedule > rect.truth, .schedule > rect.own")
    return "".join(boxes.evaluate_all("all => all.map(b => b.classList.contains('own') ? 'o' : 'T')"))


def watch(page, u: int, v: int) -> None:
    """Choose a pair and wait until its motion is the one on the stage."""
    page.evaluate(f"{EXPLORER}.choose({u}, {v})")
    page.wait_for_function(f"{EXPLORER}.player.drawn && !document.querySelector('[data-motion-explorer]')"
                           ".shadowRoot.querySelector('.next')", timeout=10_000)  # fmt: skip


def test_sliders_redraw_the_schedule_and_swap_the_motion(browser, shown, clips, tmp_path):
    page = opened(browser, shown, tmp_path)
    assert fed(page)[:12] == "TTTTToooooTT" and 25 <= len(fed(page)) <= 40
    assert page.evaluate(f"{EXPLORER}.player.characters[0].frames") == len(clips[1])
    assert page.get_by_text("1.89").is_visible() and page.get_by_text("50 % of what it is fed").is_visible()
    arrows = page.locator(".schedule .head").get_attribute("d").count("M")
    assert arrows == fed(page).count("o")

    u, v = page.get_by_role("slider", name="u, frames of truth"), page.get_by_role("slider", name="v, own frames")
    assert (u.get_attribute("max"), v.get_attribute("max")) == ("2", "2"), (
        "one place for each of 1, 2, 5 and of 0, 2, 5"
    )
    v.fill("1")
    assert fed(page)[:9] == "TTTTTooTT", "(5, 2) is not in the grid; its schedule is drawn"
    assert page.get_by_text("not in the grid").is_visible() and page.get_by_text("Nothing to watch").is_visible()
    assert page.locator(".curve.mine").count() == 0 and page.locator(".curve").count() == 4
    u.focus()
    page.keyboard.press("ArrowLeft")
    page.wait_for_function(f"{EXPLORER}.player.characters?.[0].frames === {len(clips[0])}")
    assert fed(page)[:6] == "TTooTT" and page.locator(".curve.mine").count() == 1
    assert page.get_by_text("2.31").is_visible() and not page.get_by_text("Nothing to watch").is_visible()
    seen = np.reshape(page.evaluate(f"[...{EXPLORER}.player.characters[0].positions]"), (len(clips[0]), -1, 3))
    assert np.linalg.norm(seen + clips[0].positions[0, 0] - clips[0].positions, axis=-1).max() < 9e-4
    page.keyboard.press("Home")
    v.focus()
    page.keyboard.press("End")
    assert fed(page)[:7] == "ToooooT" and page.get_by_text("No clip was kept").is_visible()
    page.keyboard.press("Home")
    assert set(fed(page)) == {"T"} and page.locator(".schedule .head").get_attribute("d") == ""
    assert page.get_by_text("20 of 20").is_visible(), "teacher forcing is the same for every u"
    assert page.errors == [] and len(page.asked) == 1, "the page itself"


def test_the_view_and_the_time_stay_when_the_motion_is_swapped(browser, shown, tmp_path):
    page = opened(browser, shown, tmp_path)
    page.evaluate(f"{EXPLORER}.player.seek(60)")
    page.evaluate(f"Object.assign({EXPLORER}.player.state, {{ zoom: 0.5, elevation: 0.6, speed: 0.25 }})")
    page.evaluate(f"{EXPLORER}.player.state.azimuth += 1")
    turned = page.evaluate(f"{EXPLORER}.player.state.azimuth - {EXPLORER}.player.azimuth")
    page.evaluate(f"{EXPLORER}.player.play()")
    watch(page, 2, 2)
    page.wait_for_function(f"{EXPLORER}.cell.u === 2 && {EXPLORER}.player.characters[0].frames === 90")
    now = page.evaluate(f"({{ ...{EXPLORER}.player.state }})")
    assert now["playing"] and 2 <= now["t"] < 2.9 and (now["zoom"], now["elevation"], now["speed"]) == (0.5, 0.6, 0.25)
    assert now["azimuth"] - page.evaluate(f"{EXPLORER}.player.azimuth") == pytest.approx(turned)
    assert page.locator("canvas").count() == 1, "the old figure is gone"


def test_swapping_faster_than_motions_load_ends_with_the_last(browser, shown, clips, tmp_path):
    page = opened(browser, shown, tmp_path)
    page.evaluate(f"for (const [u, v] of [[2, 2], [5, 0], [5, 5], [2, 2], [1, 5], [2, 2]]) {EXPLORER}.choose(u, v)")
    page.wait_for_function(f"{EXPLORER}.player.characters[0].frames === {len(clips[0])}")
    page.wait_for_timeout(200)
    assert (
        page.locator("canvas").count() == 1 and page.evaluate(f"{EXPLORER}.player.characters[0].name") == "u = 2, v = 2"
    )
    assert page.errors == []


def test_the_grid_and_the_curves_can_be_chosen_from(browser, shown, tmp_path):
    page = opened(browser, shown, tmp_path)
    assert page.locator(".dot.known").count() == 6, "three pairs, and teacher forcing for each u"
    page.locator(".dot", has=page.locator("title", has_text="u = 2, v = 5")).locator(".touch").click()
    assert page.evaluate(f"[{EXPLORER}.state.u, {EXPLORER}.state.v, {EXPLORER}.cell]") == [2, 5, None]
    box = page.locator(".curves").bounding_box()
    paths = page.locator(".curve").evaluate_all("all => all.map(p => p.getBoundingClientRect().y)")
    page.mouse.move(box["x"] + box["width"] / 2, paths[1])  # (2, 2), a level line
    assert page.locator(".curve.over").count() == 1
    page.mouse.click(box["x"] + box["width"] / 2, paths[1])
    assert page.evaluate(f"[{EXPLORER}.state.u, {EXPLORER}.state.v]") == [2, 2]
    truth = page.locator(".true").bounding_box()["y"]
    assert truth < min(paths), "the true motion lies above them all"


def test_a_line_on_the_curves_goes_with_the_motion(browser, shown, tmp_path):
    page = opened(browser, shown, tmp_path)
    at = "document.querySelector('[data-motion-explorer]').shadowRoot.querySelector('.playhead').getBBox().x"
    assert page.locator(".playhead").get_attribute("d") == "", "the first frames are the seed"
    places = []
    for frame in (30, 130):
        page.evaluate(f"{EXPLORER}.player.seek({frame})")
        page.wait_for_function(f"{EXPLORER}.player.state.t * 30 > {frame - 1}")
        page.wait_for_timeout(100)
        places.append(page.evaluate(at))
    width = page.locator(".curves").bounding_box()["width"] - 48
    assert places[1] - places[0] == pytest.approx(100 / 400 * width, abs=1)


def test_keys_are_not_left_to_the_page(browser, shown, tmp_path):
    """JupyterLab listens on the document while keys are on their way down, and moves from cell to cell."""
    page = opened(browser, shown, tmp_path)
    page.evaluate("window.taken = 0; document.addEventListener('keydown', () => taken++, true)")
    page.get_by_role("slider", name="u, frames of truth").focus()
    page.keyboard.press("ArrowLeft")
    assert page.evaluate(f"[taken, {EXPLORER}.state.u]") == [0, 2]
    page.keyboard.press("Tab")
    page.evaluate("document.activeElement.blur()")
    before = page.evaluate("taken")
    page.keyboard.press("ArrowRight")
    assert page.evaluate(f"[taken - {before}, {EXPLORER}.state.u]") == [1, 2], (
        "without the focus the keys are the page's"
    )


def test_touch_on_a_telephone(browser, shown, tmp_path):
    page = opened(browser, shown, tmp_path, has_touch=True, viewport={"width": 360, "height": 900})
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert 12 <= len(fed(page)) <= 20
    box = page.get_by_role("slider", name="u, frames of truth").bounding_box()
    page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert page.evaluate(f"{EXPLORER}.state.u") == 2
    page.set_viewport_size({"width": 760, "height": 900})
    page.wait_for_function(f"{EXPLORER}.frames > 25")
    assert page.errors == []


def test_dark_where_the_notebook_is_dark(browser, shown, tmp_path):
    page = opened(browser, shown, tmp_path, color_scheme="light")
    shade = "e => getComputedStyle(e).backgroundColor.match(/\\d+/g).reduce((a, b) => a + +b, 0)"
    assert page.locator(".explorer").evaluate(shade) > 600
    page.evaluate("document.body.dataset.jpThemeLight = 'false'")
    page.wait_for_function("document.querySelector('[data-motion-explorer]').shadowRoot.querySelector('.dark')")
    assert page.locator(".explorer").evaluate(shade) < 150 and page.locator(".player.dark").count() == 1


def test_two_explorers_and_a_player_on_one_page_and_one_output_twice(browser, shown, clips, tmp_path):
    other = explorer({(3, 3): Cell(np.ones(50), clips[0])})
    parts = (shown.html, other.html, show(clips[0]).html, shown.html)
    (tmp_path / "all.html").write_text(
        "<!doctype html><meta charset=utf-8><body>" + "<hr>".join(parts), encoding="utf-8"
    )
    page = new_page(browser)
    page.goto((tmp_path / "all.html").as_uri())
    ready(page, 3)
    first, second, third = (f"document.querySelectorAll('[data-motion-explorer]')[{i}].explorer" for i in range(3))
    page.evaluate(f"{first}.choose(2, 2)")
    assert page.evaluate(f"[{first}, {second}, {third}].map(e => [e.state.u, e.state.v])") == [[2, 2], [3, 3], [5, 5]]
    page.evaluate(f"{third}.dispose()")
    page.evaluate(f"{first}.choose(5, 5)")
    page.wait_for_timeout(200)
    assert page.errors == [] and len(page.asked) == 1


def test_an_exported_notebook_shows_the_picture_then_the_explorer(browser, shown, tmp_path):
    nbconvert, nbformat = pytest.importorskip("nbconvert"), pytest.importorskip("nbformat")
    bundles = [{"image/png": base64.b64encode(shown.png).decode()}, {"text/html": shown.html}]
    outputs = [nbformat.v4.new_output("display_data", data=data) for data in bundles]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("explorer(cells)", outputs=outputs)])
    body, _ = nbconvert.HTMLExporter().from_notebook_node(notebook)
    (tmp_path / "exported.html").write_text(body, encoding="utf-8")
    page = new_page(browser)
    page.route(lambda url: not url.startswith("file:"), lambda route: route.abort())  # nbconvert's own MathJax
    page.goto((tmp_path / "exported.html").as_uri())
    ready(page)
    assert page.locator("img").first.bounding_box()["y"] < page.locator(".explorer").bounding_box()["y"]
    page.evaluate(f"{EXPLORER}.choose(2, 2)")
    assert fed(page)[:4] == "TToo"


def test_without_scripts_the_picture_is_there(browser, shown, tmp_path):
    page = new_page(browser, java_script_enabled=False)
    page.goto(shown.save(tmp_path / "page.html").as_uri())
    assert page.locator("img").bounding_box()["width"] == 720
    assert page.get_by_text("The explorer needs its script").is_visible()
