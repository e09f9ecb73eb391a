"""The explorer of u and v without a browser: what is sent, how big, what is shown without scripts, what is refused."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import pathlib
import re

import numpy as np
import pytest
from PIL import Image

from tutorial_lib import view
from tutorial_lib.errors import TutorialError
from tutorial_lib.view import Cell, explorer, palette
from tutorial_lib.view.benchmark import stand_in
from tutorial_lib.view.codec import Payload, decode_positions


@pytest.fixture(scope="module")
def cells():
    """Three pairs and teacher forcing, which has no motion of its own; 600 changes each."""
    falling = 0.16 * np.exp(-np.arange(600) / 100)
    return {
        (5, 5): Cell(np.full(600, 0.15), stand_in(90, seed=1), {"error": 1.8854, "frozen": "0 of 20"}, seed_frames=10),
        (1, 10): Cell(np.full(600, 0.12), stand_in(60, seed=2), {"error": 1.5}, seed_frames=10),
        (5, 10): Cell(np.linspace(0.2, 0.1, 600), stand_in(90, seed=3)),
        (3, 0): Cell(falling, notes={"frozen": "20 of 20"}),
    }


def sent(html: str) -> tuple[dict, bytes]:
    """What the page's script is given."""
    return (
        json.loads(re.search(r"explore\(el, (\{.*\}), fromBase64", html)[1]),
        base64.b64decode(re.search(r'fromBase64\("([^"]*)"\)', html)[1]),
    )


def test_every_motion_comes_back_from_the_page(cells):
    spec, payload = sent(explorer(cells).html)
    shown = 0
    for entry in spec["cells"]:
        motion = cells[entry["u"], entry["v"]].motion
        if motion is None:
            assert "player" not in entry
            continue
        own = {**spec["player"], **entry["player"]["spec"]}
        part = payload[slice(*entry["player"]["bytes"])]
        (character,) = own["characters"]
        parents = own["bodies"][character["body"]]["parents"]
        data = part[slice(*character["bytes"])]
        back = decode_positions(Payload(data, character["step"], tuple(motion.positions[0, 0]), len(motion)), parents)
        assert np.linalg.norm(back - motion.positions, axis=-1).max() < 9e-4
        assert own["frames"] == len(motion) and character["seed"] == cells[entry["u"], entry["v"]].seed_frames
        shown += 1
    assert shown == 3
    assert {"style", "keys", "width"} <= spec["player"].keys(), "what all have alike goes once"


def test_curves_are_running_means_in_thousandths_of_the_height(cells):
    spec = explorer(cells, truth=0.16, smooth=15).spec
    assert spec["top"] == pytest.approx(1.05 * 0.2, rel=0.05) and spec["frames"] == 600
    by_pair = {(c["u"], c["v"]): np.array(c["curve"]) * spec["top"] / 1000 for c in spec["cells"]}
    assert np.allclose(by_pair[5, 5], 0.15, atol=spec["top"] / 1500)
    frames = spec["first"] + spec["every"] * np.arange(len(by_pair[5, 10]))
    # change number t is of frame t + 1 after the seed; a running mean of a straight line is the line
    assert np.allclose(by_pair[5, 10], 0.2 - 0.1 * (frames - 1) / 599, atol=spec["top"] / 1500)
    assert len(frames) <= 240 and frames[-1] <= 600


def test_a_curve_that_runs_off_leaves_the_picture_and_one_that_ends_leaves_a_gap():
    off = np.r_[np.full(50, 0.1), np.full(50, 1e9)]
    ended = np.r_[np.full(50, 0.1), np.full(50, np.nan)]
    spec = explorer({(1, 1): Cell(off), (2, 2): Cell(ended)}, truth=0.1, smooth=1).spec
    assert spec["top"] == pytest.approx(0.3)
    assert spec["cells"][0]["curve"][-1] == 9999 and spec["cells"][1]["curve"][49:51] == [333, None]
    assert spec["player"] is None, "no pair has a motion"


def test_sliders_have_the_grids_values_and_teacher_forcing_adds_no_u(cells):
    spec = explorer(cells).spec
    assert (spec["us"], spec["vs"], spec["start"]) == ([1, 5], [0, 5, 10], [5, 5])
    assert explorer(cells, start=(1, 5)).spec["start"] == [1, 5], "a pair that was not trained can be shown first"
    only = explorer({(4, 0): cells[3, 0]}).spec
    assert (only["us"], only["vs"], only["start"]) == ([4], [0], [4, 0])


def test_numbers_are_written_to_three_digits_and_words_as_they_are(cells):
    spec = explorer(cells).spec
    assert spec["cells"][0]["notes"] == [["error", "1.89"], ["frozen", "0 of 20"]]
    assert explorer({(1, 1): Cell(np.ones(30), notes={"steps": 2500})}).spec["cells"][0]["notes"] == [["steps", "2500"]]


def test_ten_pairs_of_eight_seconds_are_small():
    motions = [stand_in(240, seed=i) for i in range(10)]  # noisier than people: real clips take a fifth less
    grid = {(u, v): None for u in (1, 2, 5, 10) for v in (0, 2, 5, 10)}
    pairs = [p for p in grid if p[1] or p[0] == 1][:10]
    shown = explorer({p: Cell(np.random.default_rng(0).random(900), m) for p, m in zip(pairs, motions, strict=True)})
    assert motions[0].skeleton.n_joints == 57 and len(shown.html) < 450_000


def test_the_script_asks_for_nothing_and_labels_cannot_break_out():
    folder = pathlib.Path(view.__file__).parent
    source = (folder / "explorer.js").read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?:|import |fetch\(|getElementById|innerHTML", source)
    bad = "</script><!--<script>alert(1)</script>"
    shown = explorer({(1, 1): Cell(np.ones(30), notes={bad: bad})}, title=bad)
    assert shown.html.count("</script") == 1 and "<!--" not in shown.html
    assert sent(shown.html)[0]["cells"][0]["notes"] == [[bad, bad]]


def test_without_scripts_a_picture_shows_every_pair(cells, tmp_path):
    shown = explorer(cells, truth=0.16)
    image = np.asarray(Image.open(io.BytesIO(shown.png)).convert("RGB")).astype(int)
    assert image.shape[1] == 720 and len(shown.png) < 40_000
    words = [t.get_text() for t in shown.figure.texts]
    for expected in ("u = 5, v = 5", "u = 1, v = 10", "teacher forcing", "20 of 20", "1.89", "–"):
        assert expected in words
    boxes = [t.get_window_extent() for t in shown.figure.texts]
    assert all(b.x0 >= 0 and b.x1 <= 720 for b in boxes), "cut off at an edge"
    for i, a in enumerate(boxes):
        assert not any(a.overlaps(b) for b in boxes[i + 1 :]), words[i]
    drawn = shown.figure.axes[1].get_lines()[-1].get_ydata()
    assert np.allclose(drawn, 0.15)
    blue = np.abs(image - list(bytes.fromhex(palette.BLUE[1:]))).sum(-1) < 40
    assert blue.sum() > 500, "own outputs and curves"
    page = shown.save(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<noscript><img alt=" in page and "teacher forcing" in shown.alt


def test_a_notebook_gets_the_picture_first(cells, monkeypatch):
    display = pytest.importorskip("IPython.display")
    outputs = []
    monkeypatch.setattr(display, "display", lambda data, **_: outputs.append(data))
    explorer(cells)._ipython_display_()
    explorer(cells, picture=False)._ipython_display_()
    assert [sorted(o)[0] for o in outputs] == ["image/png", "text/html", "text/html"]
    assert outputs[1]["text/plain"] == "<Explorer: 4 pairs, 3 with a motion>"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"cells": {}}, "no cells"),
        ({"cells": {(0, 5): Cell(np.ones(30))}}, "pair (0, 5), expected (u, v)"),
        ({"cells": {(5, -1): Cell(np.ones(30))}}, "pair (5, -1)"),
        ({"cells": {(2.5, 1): Cell(np.ones(30))}}, "pair (2.5, 1)"),
        ({"cells": {5: Cell(np.ones(30))}}, "pair 5"),
        ({"cells": {(1, 1): np.ones(30)}}, "ndarray at (1, 1), expected a Cell"),
        ({"cells": {(1, 1): Cell(np.ones(9))}}, "shape (9,) at (1, 1), expected (15 or more,)"),
        ({"cells": {(1, 1): Cell(np.ones((3, 30)))}}, "shape (3, 30)"),
        ({"cells": {(1, 0): Cell(np.ones(30)), (2, 0): Cell(np.ones(30))}}, "several pairs with v = 0"),
        ({"truth": 0.0}, "true motion change 0.0"),
        ({"fps": float("nan")}, "nan frames a second"),
        ({"start": (2, 5)}, "start (2, 5), expected u of [1, 5] and v of [0, 5, 10]"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(cells, change, says):
    choices = {"cells": cells, **change}
    with pytest.raises(TutorialError, match=re.escape(says)) as caught:
        explorer(choices.pop("cells"), **choices)
    assert "\n" not in str(caught.value)


def test_a_cell_is_a_value():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Cell(np.ones(3)).curve = np.zeros(3)
