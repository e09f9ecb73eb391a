"""The path canvas in a real browser: mouse, finger, keys, themes; and in JupyterLab, where Python hears of it."""

from __future__ import annotations

import base64
import json
import time

import numpy as np
import pytest
from browser import new_page, running_cell
from widget_page import CANVAS, page_of

from tutorial_lib.motion.ground import check_path, circle, path_length, path_offset
from tutorial_lib.view import PathCanvas

pytestmark = pytest.mark.usefixtures("closed_afterwards")


def opened(browser, folder, *canvases, copies: int = 1, **choices):
    page = new_page(browser, **choices)
    page.goto(page_of(list(canvases) or [PathCanvas("circle")], folder / "page.html", copies))
    page.wait_for_function(
        "n => [...document.querySelectorAll('.host')].filter(e => e.canvas?.drawn > 1).length >= n",
        arg=copies * max(1, len(canvases)),
    )
    return page


def told(page, index: int = 0) -> list[dict]:
    """What Python would have been sent, message by message."""
    return page.evaluate(f"models[{index}].told")


def path_of(page, index: int = 0) -> np.ndarray:
    return np.array(page.evaluate(f"models[{index}].state.path"), float).reshape(-1, 2)


def screen(page, points) -> list[list[float]]:
    """Where places on the ground [x, z] are in the window."""
    box = page.locator(".surface").first.bounding_box()
    at = page.evaluate(f"points => points.map({CANVAS}.at)", np.asarray(points, float).tolist())
    return [[box["x"] + x, box["y"] + y] for x, y in at]


def settle(page) -> None:
    """Two pictures later: what was asked for has been drawn."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def drag(page, points) -> None:
    """Along places on the ground with the mouse, many small moves."""
    corners = np.array(screen(page, points))
    page.mouse.move(*corners[0])
    page.mouse.down()
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        for share in np.linspace(0, 1, 12)[1:]:
            page.mouse.move(*(a + share * (b - a)))
    page.mouse.up()


def test_drawing_with_the_mouse_sends_metres_when_the_pen_comes_up(browser, tmp_path):
    page = opened(browser, tmp_path)
    wanted = np.array([(1, -4), (3, -1), (3, 2), (0, 4)])
    corners = screen(page, wanted)
    page.mouse.move(*corners[0])
    page.mouse.down()
    page.mouse.move(*corners[1], steps=9)
    assert told(page) == [], "not while the pen is down"
    page.mouse.move(*corners[2], steps=9)
    page.mouse.move(*corners[3], steps=9)
    page.mouse.up()
    path = path_of(page)
    assert [set(message) for message in told(page)] == [{"path"}]
    assert np.abs(path_offset(path, wanted)).max() < 0.03 and path[[0, -1]] == pytest.approx(wanted[[0, -1]], abs=0.02)
    assert path_length(path) == pytest.approx(path_length(wanted), abs=0.1)
    assert check_path(path) is not None and page.get_by_text(f"{path_length(path):.1f} m ·").is_visible()
    drag(page, [(0, 4), (0, 0)])  # from the end on
    assert path_of(page)[: len(path)] == pytest.approx(path) and path_of(page)[-1] == pytest.approx([0, 0], abs=0.02)
    drag(page, [(0, -4), (0, 0)])  # anew
    assert path_of(page)[0] == pytest.approx([0, -4], abs=0.02) and len(told(page)) == 3
    page.mouse.click(*screen(page, [(2, 3)])[0])  # a tap: straight there
    assert path_of(page)[-1] == pytest.approx([2, 3], abs=0.02) and len(told(page)) == 4
    assert page.errors == [] and len(page.asked) == 1, "the page itself"


def test_a_finger_draws_and_the_page_does_not_scroll(browser, tmp_path):
    page = opened(browser, tmp_path, has_touch=True, viewport={"width": 360, "height": 500})
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.evaluate("document.body.insertAdjacentHTML('beforeend', '<div style=height:3000px></div>')")
    touch = page.context.new_cdp_session(page)
    points = screen(page, [(1.0, -3.0), (1.0, 0.0), (-1.0, 3.0)])

    def send(kind: str, *places) -> None:
        fingers = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    send("touchStart", points[0])
    for a, b in zip(points[:-1], points[1:], strict=True):
        for share in np.linspace(0, 1, 10)[1:]:
            send("touchMove", np.array(a) + share * (np.array(b) - a))
    send("touchMove", points[2], points[0])  # a second finger, which does not draw
    send("touchEnd")
    path = path_of(page)
    assert len(told(page)) == 1 and path[[0, -1]] == pytest.approx(np.array([[1, -3], [-1, 3]]), abs=0.05)
    assert page.evaluate("scrollY") == 0 and page.errors == []


def test_keys_draw_undo_and_clear(browser, tmp_path):
    page = opened(browser, tmp_path)
    page.evaluate(
        "window.taken = 0; document.addEventListener('keydown', e => { taken += !/Shift|Control/.test(e.key); }, true)"
    )
    page.locator(".surface").focus()
    keys = page.keyboard
    keys.press("Delete")
    assert told(page)[-1] == {"path": []} and page.get_by_text("Draw a path here").is_visible()
    for key in ("ArrowRight", "ArrowRight", "ArrowUp", "Shift+ArrowLeft"):
        keys.press(key)
    assert len(told(page)) == 1, "the next key may come"
    keys.press("Enter")
    assert path_of(page).tolist() == [[0, 0], [0, 0.5], [0, 1], [0.5, 1], [0.5, 0.9]] and len(told(page)) == 2
    keys.down("ArrowRight")
    keys.down("ArrowDown")  # both: across
    keys.up("ArrowDown")
    keys.up("ArrowRight")
    page.wait_for_function("models[0].told.length === 3")
    assert path_of(page)[-1] == pytest.approx([0.5 - 0.354, 0.9 + 0.5 + 0.354], abs=2e-3)
    keys.press("Backspace")
    keys.press("Control+z")
    assert path_of(page)[-1].tolist() == [0.5, 0.9]
    keys.press("Control+y")
    assert path_of(page)[-1] == pytest.approx([0.5, 1.4])
    for _ in range(14):
        keys.press("ArrowUp")  # out of sight: more ground is shown
    top = page.locator(".surface").bounding_box()["y"]
    page.wait_for_function("models[0].state.path.length > 15")
    assert screen(page, path_of(page)[-1:])[0][1] > top
    span = page.evaluate(f"{CANVAS}.state.span")
    keys.press("-")
    assert page.evaluate(f"{CANVAS}.state.span") > span
    assert page.evaluate("taken") == 0, "JupyterLab, which listens on the document, would move between cells"
    page.evaluate("document.activeElement.blur()")
    keys.press("ArrowUp")
    assert page.evaluate("taken") == 1 and page.errors == []


def test_prepared_paths_undo_and_redo_by_buttons(browser, tmp_path):
    page = opened(browser, tmp_path)
    undo, redo, clear = (page.get_by_role("button", name=name, exact=True) for name in ("Undo", "Redo", "Clear"))
    assert undo.is_disabled() and redo.is_disabled()
    page.get_by_role("button", name="zigzag").click()
    zigzag = path_of(page)
    assert zigzag[-1, 1] > 9
    box = page.locator(".surface").bounding_box()
    corners = np.array(screen(page, zigzag))
    assert (corners > [box["x"], box["y"]]).all() and (corners[:, 0] < box["x"] + box["width"]).all(), "all in sight"
    clear.click()
    settle(page)
    assert len(path_of(page)) == 0 and clear.is_disabled()
    undo.click()
    assert np.array_equal(path_of(page), zigzag)
    undo.click()
    settle(page)
    assert path_of(page) == pytest.approx(circle(), abs=6e-4) and undo.is_disabled()
    redo.click()
    assert np.array_equal(path_of(page), zigzag)
    page.get_by_role("button", name="circle").click()
    settle(page)
    assert redo.is_disabled() and page.errors == []


def test_pace_by_slider_and_keys(browser, tmp_path):
    page = opened(browser, tmp_path)
    slider = page.get_by_role("slider", name="Pace")
    slider.fill("2.5")
    page.wait_for_function("models[0].told.length === 1")
    assert told(page) == [{"pace": 2.5}] and page.get_by_text("a jog").is_visible()
    assert page.locator("output").inner_text() == f"{path_length(circle()):.1f} m · {path_length(circle()) / 2.5:.1f} s"
    slider.focus()
    for _ in range(3):
        page.keyboard.press("ArrowLeft")
    page.wait_for_function("models[0].told.length === 2")
    assert told(page)[1] == {"pace": 2.2}, "one message for keys that follow one another"
    page.keyboard.press("End")
    page.wait_for_function("models[0].told.length === 3")
    assert told(page)[2] == {"pace": 3.5} and page.errors == []


def test_what_python_says_is_drawn(browser, tmp_path):
    page = opened(browser, tmp_path)
    lines = "p => p.getAttribute('d').split('L').length"
    page.evaluate("models[0].set('walked', [[0, 0], [0, 1], [0.2, 2]]); models[0].set('note', '3 cm off')")
    page.wait_for_function("models[0].heard && true")
    page.get_by_text("3 cm off").wait_for()
    assert page.locator("path.walked").first.evaluate(lines) == 3 and page.get_by_text("asked for").is_visible()
    page.evaluate("models[0].set('busy', true)")
    page.get_by_text("walking …").wait_for()
    page.evaluate("models[0].set('busy', false); models[0].set('path', [[0, 0], [0, 30]])")
    page.wait_for_function(f"{CANVAS}.state.span >= 30")
    drag(page, [(0, 0), (3, 9)])
    page.wait_for_function(f"!{CANVAS}.state.stroke")
    page.locator("path.walked").wait_for(state="detached")
    assert page.errors == []


def test_two_canvases_and_one_shown_twice(browser, tmp_path):
    page = opened(browser, tmp_path, PathCanvas("circle"), PathCanvas("zigzag"), copies=2)
    page.locator(".host").nth(2).get_by_role("button", name="figure of eight").click()  # the first's second copy
    states = page.evaluate("[...document.querySelectorAll('.host')].map(e => e.canvas.state.path.length)")
    zigzag = len(PathCanvas("zigzag").path)
    assert states == [300, zigzag, 300, zigzag] and len(told(page)) == 1 and told(page, 1) == []
    page.evaluate("leave[0]()")
    page.locator(".host").nth(2).get_by_role("button", name="circle").click()
    page.wait_for_timeout(100)
    assert page.errors == [] and page.locator(".surface").count() == 3


def test_dark_where_the_notebook_is_dark(browser, tmp_path):
    page = opened(browser, tmp_path, color_scheme="light")
    shade = "e => getComputedStyle(e).backgroundColor.match(/\\d+/g).reduce((a, b) => a + +b, 0)"
    assert page.locator(".canvas").evaluate(shade) > 600
    page.evaluate("document.body.dataset.jpThemeLight = 'false'")
    page.locator(".canvas.dark").wait_for()
    assert page.locator(".canvas").evaluate(shade) < 150


# -- notebooks -----------------------------------------------------------------------------------------------

CELL = """import json, pathlib
from tutorial_lib.view import PathCanvas, show
from tutorial_lib.view.benchmark import stand_in
canvas = PathCanvas("circle")

@canvas.on_path
def heard(path, pace):
    canvas.show_walked(path, note=f"walked {len(path)} points")
    pathlib.Path("heard.json").write_text(json.dumps([path.tolist(), pace]))
    return show(stand_in(30))

canvas"""


def test_in_jupyterlab_the_path_arrives_in_python_and_a_figure_moves_below(browser, tmp_path):
    with running_cell(browser, tmp_path, CELL) as page:
        surface = page.locator(".surface")
        surface.wait_for(timeout=60_000)
        page.locator(".canvas").scroll_into_view_if_needed()
        picture = page.locator(".jp-RenderedImage")
        picture.wait_for(state="hidden")
        assert picture.count() == 1, "the picture is kept in the notebook, and hidden where the canvas runs"
        box = surface.bounding_box()
        page.mouse.move(box["x"] + 100, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 400, box["y"] + 100, steps=12)
        page.mouse.move(box["x"] + 600, box["y"] + 300, steps=12)
        page.mouse.up()
        page.get_by_text("walked ").first.wait_for(timeout=30_000)
        path, pace = _heard(tmp_path / "heard.json")
        across = path_length(path) / (np.hypot(300, 100) + np.hypot(200, 200))
        assert across == pytest.approx(12 / box["width"], rel=0.02) and pace == 1.3, "metres a pixel"
        page.wait_for_function(
            "[...document.querySelectorAll('[data-motion-player]')].some(e => e.player?.drawn)", timeout=30_000
        )
        surface.focus()
        page.keyboard.press("ArrowUp")
        further = _heard(tmp_path / "heard.json", lambda found: len(found[0]) == len(path) + 1)[0]
        assert further[-1] - path[-1] == pytest.approx([0.5, 0], abs=1e-3)
        assert page.locator(".jp-Notebook .jp-Cell").count() == 1, "no key reached JupyterLab"
        assert [e for e in page.errors if "WebSocket" not in e] == []


def _heard(file, wanted=lambda found: True):
    for _ in range(150):
        if file.exists() and file.stat().st_size:
            found = json.loads(file.read_text())
            if wanted(found):
                return np.array(found[0]), found[1]
        time.sleep(0.2)
    raise AssertionError(f"{file.name}: Python has not heard of it")


def test_an_exported_notebook_shows_the_picture_and_the_line(browser, tmp_path):
    nbconvert, nbformat = pytest.importorskip("nbconvert"), pytest.importorskip("nbformat")
    canvas = PathCanvas()
    view = {"version_major": 2, "version_minor": 0, "model_id": "none"}
    bundles = [
        {"image/png": base64.b64encode(canvas.png).decode(), "text/plain": canvas.alt},
        {"application/vnd.jupyter.widget-view+json": view, "text/html": canvas.html, "text/plain": repr(canvas)},
    ]
    outputs = [nbformat.v4.new_output("display_data", data=data) for data in bundles]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("canvas", outputs=outputs)])
    body, _ = nbconvert.HTMLExporter().from_notebook_node(notebook)
    (tmp_path / "exported.html").write_text(body, encoding="utf-8")
    page = new_page(browser)
    page.route(lambda url: not url.startswith("file:"), lambda route: route.abort())  # nbconvert's own MathJax
    page.goto((tmp_path / "exported.html").as_uri())
    assert page.locator("img").bounding_box()["width"] == 720
    assert page.get_by_text("Drawing needs a live kernel").is_visible()
