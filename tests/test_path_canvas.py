"""The path canvas without a page: what Python says and hears, and what is shown where nobody can draw."""

from __future__ import annotations

import io
import subprocess
import sys
import warnings

import numpy as np
import pytest
from PIL import Image

from tutorial_lib.data import load
from tutorial_lib.errors import MotionError, TutorialError
from tutorial_lib.motion.ground import circle, prepared_path
from tutorial_lib.view import PathCanvas, path_plot


def test_a_path_and_a_pace_are_there_before_anybody_draws():
    canvas = PathCanvas()
    assert canvas.path == pytest.approx(prepared_path("figure of eight"), abs=6e-4) and canvas.pace == 1.3
    canvas.path = "circle"
    assert canvas.path == pytest.approx(circle(), abs=6e-4)
    canvas.path = [(0, 0), (1, 2)]
    canvas.pace = 2
    assert canvas.path.tolist() == [[0, 0], [1, 2]] and canvas.pace == 2.0
    assert repr(canvas) == "<PathCanvas: path of 2 points, 2.2 m, at 2 m/s>"


def test_functions_hear_of_every_change_and_speak_through_the_canvas():
    canvas = PathCanvas("circle")
    heard = []

    @canvas.on_path
    def walk(path, pace):
        assert canvas.widget.busy
        heard.append((len(path), pace))
        if len(path) == 3:
            warnings.warn("limited at 2 m", stacklevel=1)
            canvas.show_walked(path + 0.1, note="3 cm off")
        if len(path) == 4:
            raise TutorialError("the network knows no such turn")

    assert walk.__name__ == "walk" and heard == []
    canvas.widget.path = [[0, 0], [0, 1]]  # as the page sets it
    canvas.widget.pace = 0.8
    assert heard == [(2, 1.3), (2, 0.8)] and canvas.widget.note == "" and not canvas.widget.busy
    canvas.widget.path = [[0, 0], [0, 1], [1, 1]]
    assert canvas.widget.note == "3 cm off · limited at 2 m"
    assert canvas.widget.walked == [[0.1, 0.1], [0.1, 1.1], [1.1, 1.1]]
    canvas.widget.path = [[0, 0], [0, 1], [1, 1], [1, 0]]
    assert canvas.widget.note == "the network knows no such turn" and canvas.widget.walked == []
    assert not canvas.widget.busy
    canvas.widget.path = []  # cleared
    assert canvas.path.shape == (0, 2) and canvas.widget.note == "" and len(heard) == 4
    canvas.widget.path = [[0, 0], [None, 1]]  # what no page of ours sends
    assert "point 1 is not finite" in canvas.widget.note and len(heard) == 4


def test_a_walked_way_is_thinned_out():
    canvas = PathCanvas()
    clip = load("samples/walking")[1]
    canvas.show_walked(clip)
    assert len(canvas.widget.walked) == min(600, len(clip)) and canvas.widget.note == ""
    assert canvas.widget.walked[-1] == pytest.approx(clip.positions[-1, 0, [0, 2]], abs=6e-4)
    canvas.show_walked(np.zeros((5000, 3)))
    assert len(canvas.widget.walked) == 600
    for bad in (np.zeros((5, 4)), np.full((5, 2), np.nan), np.zeros((0, 2))):
        with pytest.raises(TutorialError, match="places of shape"):
            canvas.show_walked(bad)


def test_where_nobody_can_draw_there_is_a_picture_and_a_line(monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", lambda data, **more: shown.append((data, more)))
    canvas = PathCanvas("zigzag", title="Draw <here>")
    canvas._ipython_display_()
    (picture, how), (live, _) = shown
    assert picture["image/png"].endswith(canvas.widget.picture) and len(canvas.widget.picture) > 50
    assert set(picture) == {"image/png", "text/plain"} and how["metadata"]["image/png"]["alt"] == canvas.alt
    assert "live kernel" in picture["text/plain"] and "zigzag" in canvas.alt
    image = Image.open(io.BytesIO(canvas.png)).convert("RGB")
    assert image.size == (720, 250) and len(canvas.png) < 20_000
    assert (np.asarray(image)[:, 10:150].std((0, 1)) > 5).all() and (
        np.asarray(image)[:, 450:700].std((0, 1)) > 5
    ).all()
    assert live["application/vnd.jupyter.widget-view+json"]["model_id"]
    assert "needs a live kernel" in live["text/html"], "for pages that know no widgets"
    shown.clear()
    PathCanvas(picture=False)._ipython_display_()
    assert len(shown) == 1


@pytest.mark.parametrize(
    ("choices", "says"),
    [
        (dict(path="spiral"), "no prepared path 'spiral': expected one of circle, figure of eight, zigzag"),
        (dict(path=[]), "expected (N, 2)"),
        (dict(path=[(0, 0), (np.nan, 0)]), "point 1 is not finite"),
        (dict(pace=0), "pace 0 m/s, expected 0.5 to 3.5"),
        (dict(pace=60), "pace 60 m/s"),
        (dict(pace="fast"), "pace 'fast' m/s"),
        (dict(paces=(2, 1)), "paces 2 to 1 m/s"),
        (dict(paces=3), "paces 3, expected 2 numbers"),
        (dict(metres=0), "0 m"),
        (dict(width="wide"), "expected 3 numbers"),
    ],
)
def test_bad_choices_are_refused_in_one_line(choices, says):
    with pytest.raises(TutorialError) as error:
        PathCanvas(**choices)
    assert says in str(error.value) and "\n" not in str(error.value)


def test_on_path_of_no_function():
    with pytest.raises(TutorialError, match="on_path of int"):
        PathCanvas().on_path(3)
    with pytest.raises(MotionError):
        PathCanvas().path = [(0, 0)]


def test_widgets_are_imported_when_the_first_canvas_is_made():
    code = (
        "import sys, tutorial_lib.view; print([m for m in ('ipywidgets', 'anywidget', 'IPython') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_the_plot_from_above_has_z_to_the_right_and_x_up():
    clip = load("samples/walking")[1]
    figure = path_plot([(0, 0), (1, 5)], {"hip": clip, "other": np.zeros((4, 2))}, every=1.0, title="from above")
    axes = figure.axes[0]
    path, hip = (next(line for line in axes.get_lines() if line.get_label() == n) for n in ("path asked for", "hip"))
    assert path.get_xydata().tolist() == [[0, 0], [5, 1]]
    assert np.array_equal(hip.get_xydata(), clip.positions[:, 0, [2, 0]])
    assert axes.get_aspect() == 1 and axes.get_xlabel() == "z, metres"
    assert [line.get_label() for line in path_plot(circle(), path_label="way").axes[0].get_lines()] == ["way"]
    for bad in (lambda: path_plot(None), lambda: path_plot([(0, 0)]), lambda: path_plot(None, {"a": np.zeros(3)})):
        with pytest.raises(TutorialError):
            bad()
