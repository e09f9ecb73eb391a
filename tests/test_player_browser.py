"""The player in a real browser: from disk, in notebooks live, saved, untrusted and exported; and every control."""

from __future__ import annotations

import base64
import pathlib

import numpy as np
import pytest

nbformat = pytest.importorskip("nbformat")

from browser import PLAYER, jupyterlab, new_page, picture, wait_until_ready  # noqa: E402

from tutorial_lib.motion import Motion  # noqa: E402
from tutorial_lib.view import show  # noqa: E402
from tutorial_lib.view.benchmark import decoded_error, stand_in  # noqa: E402

LESSON = pathlib.Path(__file__).parents[1] / "notebooks" / "01_motion_data.ipynb"
CANVAS = "document.querySelector('[data-motion-player]').shadowRoot.querySelector('canvas')"
CELL = "from tutorial_lib.view import show\nfrom tutorial_lib.view.benchmark import stand_in\nshow(stand_in(90))"


pytestmark = pytest.mark.usefixtures("closed_afterwards")


@pytest.fixture(scope="module")
def walker() -> Motion:
    """Ten seconds on the spot, then carried four metres along x, so that following it shows."""
    motion = stand_in(300)
    positions = motion.positions.copy()
    positions[150:, :, 0] += np.linspace(0, 4, 150)[:, None]
    return Motion(motion.skeleton, motion.fps, positions, name="walker")


def opened(browser, player, folder, **choices):
    page = new_page(browser, **choices)
    page.goto(player.save(folder / "page.html").as_uri())
    wait_until_ready(page)
    return page


def state(page, name: str):
    return page.evaluate(f"{PLAYER}.state.{name}")


def settle(page) -> None:
    """Two pictures later: what was asked for has been drawn."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


# -- from disk -----------------------------------------------------------------------------------------------


def test_page_from_disk_plays_and_asks_for_nothing(browser, walker, tmp_path):
    page = opened(browser, show(walker), tmp_path)
    still = picture(page)
    assert picture(page) == still, "it must not move before it is asked to"
    page.get_by_title("Play").click()
    page.wait_for_timeout(500)
    assert picture(page) != still and state(page, "t") > 0.1
    page.get_by_title("Pause").click()
    assert page.locator("output").inner_text().startswith("frame ")
    assert page.errors == [] and [u for u in page.asked if not u.startswith(("file:", "data:", "blob:"))] == []
    assert len(page.asked) == 1, "the page itself"


def test_decoded_joints_are_exact_for_motions_of_any_rate_and_length(browser, walker, small_motion, tmp_path):
    player = show([walker, walker[40:160:4], small_motion], seed_frames=[10, 0, 5])
    page = opened(browser, player, tmp_path)
    assert decoded_error(page, player) <= 3e-4
    page.evaluate(f"{PLAYER}.seek(299)")  # the second lasts 3.9 s, the third 1.6 s: they hold their last frames
    settle(page)
    for i, motion in enumerate(player.motions):
        seen = page.evaluate(f"[...{PLAYER}.characters[{i}].pose]")
        held = np.reshape(seen, (-1, 3)) - page.evaluate(f"{PLAYER}.characters[{i}].at")
        assert np.allclose(held, motion.positions[-1] - motion.positions[0, 0], atol=3e-4)


def test_time_runs_by_the_second_at_the_speed_asked_for(browser, walker, tmp_path):
    page = opened(browser, show(walker, speed=2), tmp_path)
    page.evaluate(f"{PLAYER}.play()")
    page.wait_for_timeout(300)
    now = f"[{PLAYER}.state.t, performance.now() / 1000]"
    (t, at), _, (later, then) = page.evaluate(now), page.wait_for_timeout(700), page.evaluate(now)
    assert 1.4 < (later - t) / (then - at) < 2.6


def test_keys(browser, walker, tmp_path):
    page = opened(browser, show([walker, walker], loop=False), tmp_path)
    page.locator("canvas").click()
    keys = page.keyboard
    for key, frame in (
        ("ArrowRight", 1),
        ("Shift+ArrowRight", 31),
        ("ArrowLeft", 30),
        ("End", 299),
        ("Home", 0),
    ):
        keys.press(key)
        settle(page)
        assert page.locator("output").inner_text().startswith(f"frame {frame} /"), key
    for key, name in (("f", "follow"), ("g", "ghosts"), ("t", "trails"), ("l", "loop"), ("o", "overlay")):
        before, image = state(page, name), picture(page)
        keys.press(key)
        settle(page)
        assert state(page, name) is not before
        assert page.get_by_role("button", name=name).get_attribute("aria-pressed") == str(not before).lower()
        if name == "overlay":
            assert picture(page) != image
        keys.press(key)
    for key, speed in ((".", 2), (",", 1), (",", 0.5)):
        keys.press(key)
        assert state(page, "speed") == speed and page.locator("select").input_value() == str(speed)
    keys.press("+")
    assert state(page, "zoom") < 1
    keys.press("r")
    assert state(page, "zoom") == 1
    keys.press("?")
    assert page.get_by_text("one frame").is_visible()
    keys.press(" ")
    assert state(page, "playing") is True
    keys.press("Space")
    assert state(page, "playing") is False
    page.evaluate("document.activeElement.blur()")
    keys.press("End")
    assert state(page, "t") < 1, "without the focus the keys are the page's"


def test_pointer_orbits_moves_and_zooms(browser, walker, tmp_path):
    page = opened(browser, show(walker), tmp_path)
    box = page.locator("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag(dx: int, dy: int) -> None:
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + dx, y + dy, steps=4)
        page.mouse.up()
        settle(page)

    still = picture(page)
    page.mouse.move(x, y)
    page.mouse.wheel(0, 200)
    settle(page)
    assert state(page, "zoom") == 1, "the wheel is the page's before a click"
    azimuth, elevation = state(page, "azimuth"), state(page, "elevation")
    drag(100, 30)
    assert np.isclose(state(page, "azimuth"), azimuth - 0.8) and np.isclose(state(page, "elevation"), elevation + 0.24)
    assert picture(page) != still and state(page, "pan") == [0, 0, 0]
    page.keyboard.down("Shift")
    drag(50, 20)
    page.keyboard.up("Shift")
    assert np.linalg.norm(state(page, "pan")) > 0.1 and np.isclose(state(page, "azimuth"), azimuth - 0.8)
    page.mouse.wheel(0, -300)
    settle(page)
    assert state(page, "zoom") < 0.8
    page.mouse.dblclick(x, y)
    settle(page)
    assert state(page, "zoom") == 1 and state(page, "pan") == [0, 0, 0] and state(page, "azimuth") == azimuth


def test_two_fingers_pinch(browser, walker, tmp_path):
    page = opened(browser, show(walker), tmp_path, has_touch=True, viewport={"width": 360, "height": 640})
    assert page.evaluate("document.documentElement.scrollWidth") <= 360, "fits a telephone"
    box = page.locator("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = page.context.new_cdp_session(page)

    def fingers(kind: str, *apart: int) -> None:
        points = [{"x": x + s * d, "y": y, "id": i} for d in apart for i, s in enumerate((-1, 1))]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", 40)
    for d in (50, 60, 70, 80):
        fingers("touchMove", d)
    fingers("touchEnd")
    assert np.isclose(state(page, "zoom"), 0.5, atol=0.05), "twice as far apart: twice as near"
    azimuth = state(page, "azimuth")
    touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y, "id": 5}]})
    for d in (20, 40, 60):
        touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x + d, "y": y, "id": 5}]})
    fingers("touchEnd")
    assert state(page, "azimuth") < azimuth - 0.2 and page.errors == []


def test_follow_keeps_the_figure_in_the_middle(browser, walker, tmp_path):
    """At the last frame the figure is 4 m away: in the middle of the picture, or out of it."""
    page = opened(browser, show(walker, trails=False), tmp_path)
    middle = f"(c => c.screen[3 * c.body.root] / {CANVAS}.clientWidth)"
    where = {}
    for follow in (True, False):
        page.evaluate(f"{PLAYER}.seek(0)")
        settle(page)
        page.evaluate(f"{PLAYER}.state.follow = {str(follow).lower()}; {PLAYER}.seek(299)")
        settle(page)
        where[follow] = page.evaluate(f"{middle}({PLAYER}.characters[0])")
    assert abs(where[True] - 0.5) < 0.2 and abs(where[False] - where[True]) > 0.3


NAMES = """() => {
  const pen = CanvasRenderingContext2D.prototype, write = pen.fillText, found = [];
  pen.fillText = function (text, x, y) {
    found.push([text, x, y, this.measureText(text).width]);
    write.call(this, text, x, y);
  };
  const player = %s;
  player.seek(1);
  return new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => {
    pen.fillText = write;
    done(found);
  })));
}"""


def test_names_of_a_crowd_do_not_lie_on_one_another(browser, walker, tmp_path):
    """Ten people on one another's heels, seen from the front: who stands in front keeps the name over the head."""
    crowd = []
    for k in range(10):
        places = walker.positions + np.array([0.05 * k, 0.0, -0.5 * k])
        crowd.append(Motion(walker.skeleton, walker.fps, places, name=f"a long name {k}"))
    page = opened(browser, show(crowd, layout="as is"), tmp_path)
    settle(page)
    found = page.evaluate(NAMES % PLAYER)
    assert sorted(name for name, *_ in found) == [motion.name for motion in crowd]
    for k, (_, x, y, width) in enumerate(found):
        for _, other_x, other_y, other_width in found[:k]:
            assert abs(x - other_x) >= (width + other_width) / 2 or abs(y - other_y) >= 12
    assert not page.errors


def test_slider_and_seed_colour(browser, walker, tmp_path):
    page = opened(browser, show(walker, seed_frames=100), tmp_path)
    assert page.locator("output").inner_text().endswith("· seed")
    given = picture(page)
    page.get_by_role("slider", name="Frame").fill("120")
    settle(page)
    assert state(page, "t") == pytest.approx(4.0) and not page.locator("output").inner_text().endswith("seed")
    colors = [page.evaluate(f"{PLAYER}.characters[0].seed"), given != picture(page)]
    assert colors == [100, True]


def test_dark_where_the_system_or_the_notebook_is_dark(browser, walker, tmp_path):
    page = opened(browser, show(walker), tmp_path, color_scheme="dark")
    corner = f"[...{CANVAS}.getContext('2d').getImageData(3, 3, 1, 1).data].slice(0, 3)"
    assert max(page.evaluate(corner)) < 60
    page.evaluate("document.body.dataset.jpThemeLight = 'true'")
    page.wait_for_timeout(200)
    assert min(page.evaluate(corner)) > 200
    page.evaluate("document.body.dataset.jpThemeLight = 'false'")
    page.wait_for_timeout(200)
    assert max(page.evaluate(corner)) < 60


def test_idle_when_paused_and_when_out_of_sight(browser, walker, tmp_path):
    page = opened(browser, show(walker, autoplay=True), tmp_path)
    page.wait_for_timeout(300)
    assert state(page, "playing") and page.evaluate(f"{PLAYER}.drawn") > 3
    page.evaluate("document.body.insertAdjacentHTML('beforeend', '<div style=height:5000px></div>'); scrollTo(0, 4000)")
    page.wait_for_timeout(300)
    drawn = page.evaluate(f"{PLAYER}.drawn")
    page.wait_for_timeout(400)
    assert page.evaluate(f"{PLAYER}.drawn") == drawn, "out of sight"
    page.evaluate("scrollTo(0, 0)")
    page.wait_for_timeout(400)
    assert page.evaluate(f"{PLAYER}.drawn") > drawn
    page.evaluate(f"{PLAYER}.pause()")
    page.wait_for_timeout(200)
    drawn = page.evaluate(f"{PLAYER}.drawn")
    page.wait_for_timeout(300)
    assert page.evaluate(f"{PLAYER}.drawn") == drawn, "paused"


def test_the_same_output_twice_on_a_page(browser, walker, tmp_path):
    part = show(walker).html
    (tmp_path / "twice.html").write_text(f"<!doctype html><meta charset=utf-8><body>{part}<hr>{part}", encoding="utf-8")
    page = new_page(browser, viewport={"width": 1000, "height": 1200})
    page.goto((tmp_path / "twice.html").as_uri())
    wait_until_ready(page, 2)
    first, second = picture(page, 0), picture(page, 1)
    page.get_by_title("Play").nth(1).click()
    page.wait_for_timeout(400)
    assert picture(page, 0) == first and picture(page, 1) != second
    assert page.locator("canvas").count() == 2 and page.errors == []


def test_without_scripts_the_strip_is_there(browser, walker, tmp_path):
    page = new_page(browser, java_script_enabled=False)
    page.goto(show(walker).save(tmp_path / "page.html").as_uri())
    box = page.get_by_alt_text("Film strip").bounding_box()
    assert box["width"] >= 700 and box["height"] > 100


def test_a_damaged_payload_says_so(browser, walker, tmp_path):
    player = show(walker)
    player.payload = player.payload[: len(player.payload) // 2]
    page = new_page(browser)
    page.goto(player.save(tmp_path / "page.html").as_uri())
    page.get_by_text("Cannot be shown").wait_for(timeout=5000)


# -- notebooks -----------------------------------------------------------------------------------------------


def saved_notebook(walker: Motion):
    """A notebook with the two outputs that show() publishes, as a kernel would have stored them."""
    player = show(walker)
    bundles = [
        {"image/png": base64.b64encode(player.png).decode(), "text/plain": player.alt},
        {"text/html": player.html, "text/plain": repr(player)},
    ]
    outputs = [nbformat.v4.new_output("display_data", data=data) for data in bundles]
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell("show(motion)", outputs=outputs, execution_count=1)]
    )
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return notebook


def test_exported_page_from_disk(browser, walker, tmp_path):
    nbconvert = pytest.importorskip("nbconvert")
    body, _ = nbconvert.HTMLExporter().from_notebook_node(saved_notebook(walker))
    (tmp_path / "exported.html").write_text(body, encoding="utf-8")
    page = new_page(browser)
    page.route(lambda url: not url.startswith("file:"), lambda route: route.abort())  # nbconvert's own MathJax
    page.goto((tmp_path / "exported.html").as_uri())
    wait_until_ready(page)
    still = picture(page)
    page.get_by_title("Play").click()
    page.wait_for_timeout(400)
    assert picture(page) != still
    strip = page.locator("img").first.bounding_box()
    assert strip["y"] < page.locator("canvas").bounding_box()["y"], "the strip comes first"


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    pytest.importorskip("jupyterlab")
    folder = tmp_path_factory.mktemp("lab")
    with jupyterlab(folder) as address:
        yield folder, address


def open_notebook(browser, lab, name: str):
    page = new_page(browser, viewport={"width": 1300, "height": 1000})
    page.goto(lab[1].format(name))
    page.locator(".jp-Notebook").wait_for(timeout=60_000)
    return page


def without_kernel(page) -> None:
    """Answer the question for a kernel with none."""
    dialog = page.locator(".jp-Dialog")
    dialog.wait_for(timeout=30_000)
    dialog.locator("select").select_option("null")
    dialog.locator("button.jp-mod-accept").click()
    dialog.wait_for(state="detached")


#: The place of the first code cell that has put out a player; the error's name if a cell has failed before.
FIRST_PLAYER = """() => {
  const cells = jupyterapp.shell.currentWidget.content.widgets.map(w => w.model.sharedModel.toJSON());
  const outputs = cells.map(c => c.outputs || []);
  const failed = outputs.flat().find(o => o.output_type === 'error');
  if (failed) return `${failed.ename}: ${failed.evalue}`;
  const at = outputs.findIndex(all => all.some(o => String(o.data?.['text/html']).includes('data-motion-player')));
  return at < 0 ? null : at;
}"""


def test_lab_runs_lesson_1_and_its_figure_moves(browser, lab):
    """A notebook of one cell stands in where the lessons are not installed beside the tests."""
    if LESSON.exists():
        notebook = nbformat.read(LESSON, 4)
        for cell in notebook.cells:
            if cell.cell_type == "code":
                cell.outputs, cell.execution_count = [], None
    else:
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(notebook, lab[0] / "live.ipynb")
    page = open_notebook(browser, lab, "live.ipynb")
    page.wait_for_function(
        "window.jupyterapp?.shell?.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'",
        timeout=60_000,
    )
    page.errors.clear()  # JupyterLab's own, of its start
    page.evaluate("void jupyterapp.commands.execute('notebook:run-all-cells')")
    at = page.wait_for_function(
        f"() => {{ const at = ({FIRST_PLAYER})(); return at === null ? false : {{ at }} }}", timeout=120_000
    )
    at = at.json_value()["at"]
    assert isinstance(at, int), at
    page.evaluate("at => jupyterapp.shell.currentWidget.content.scrollToItem(at, 'start')", at)  # else it is not drawn
    wait_until_ready(page)
    player = page.locator("[data-motion-player]").first
    player.scroll_into_view_if_needed()
    still = picture(page)
    player.get_by_title("Play").click()
    page.wait_for_timeout(700)
    assert picture(page) != still
    page.keyboard.press("Space")
    settle(page)
    assert state(page, "playing") is False, "the keys are the player's, not JupyterLab's"
    frame = player.locator("output").inner_text()
    page.keyboard.press("ArrowRight")
    settle(page)
    assert player.locator("output").inner_text() != frame
    assert [e for e in page.errors if "WebSocket" not in e] == []


def test_lab_shows_a_saved_notebook_without_a_kernel(browser, lab, walker):
    notebook = saved_notebook(walker)
    del notebook.metadata["kernelspec"]
    notebook.cells[0].metadata["trusted"] = True
    nbformat.write(notebook, lab[0] / "saved.ipynb")
    from nbformat.sign import NotebookNotary

    NotebookNotary(data_dir=str(lab[0] / ".jupyter-home" / "data")).sign(nbformat.read(lab[0] / "saved.ipynb", 4))
    page = open_notebook(browser, lab, "saved.ipynb")
    without_kernel(page)
    wait_until_ready(page)
    still = picture(page)
    page.get_by_title("Play").click()
    page.wait_for_timeout(500)
    assert picture(page) != still
    assert not page.evaluate("jupyterapp.shell.currentWidget.sessionContext.session"), "there is a kernel"


def test_lab_shows_the_strip_of_an_untrusted_notebook(browser, lab, walker):
    notebook = saved_notebook(walker)
    del notebook.metadata["kernelspec"]
    notebook.metadata["stranger"] = "its signature is nobody's"
    nbformat.write(notebook, lab[0] / "untrusted.ipynb")
    page = open_notebook(browser, lab, "untrusted.ipynb")
    without_kernel(page)
    strip = page.locator(".jp-RenderedImage img")
    strip.wait_for(timeout=20_000)
    assert strip.evaluate("e => e.naturalWidth") == 720
    page.get_by_text("The moving figure needs its script").wait_for()
    assert (
        page.locator("canvas").count() == 0
        and page.evaluate("document.querySelector('[data-motion-player]')?.player") is None
    )
