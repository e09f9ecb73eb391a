"""The lessons' figures: they hold the numbers they were given, and belong to nothing global."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from tutorial_lib.errors import TutorialError
from tutorial_lib.view import bar_plot, curve_plot, distance_plot, motion_change_plot, pose_strip, rest_pose_plot


def line(figure, label):
    return next(line for line in figure.axes[0].get_lines() if line.get_label() == label)


def test_curves_hold_the_numbers_and_differ_without_colour():
    curves = {name: np.arange(5.0) * k for k, name in enumerate("abc", 1)}
    figure = curve_plot(curves, x=[10, 20, 30, 40, 50], xlabel="time", ylabel="way")
    for name, values in curves.items():
        assert np.array_equal(line(figure, name).get_ydata(), values)
        assert np.array_equal(line(figure, name).get_xdata(), [10, 20, 30, 40, 50])
    assert len({str(line(figure, name).get_linestyle()) for name in curves}) > 1
    assert [t.get_text() for t in figure.legends[0].get_texts()] == list("abc")
    assert figure.axes[0].get_xlabel() == "time" and figure.axes[0].get_ylim()[0] <= 0
    with pytest.raises(TutorialError, match="no curves"):
        curve_plot({})
    with pytest.raises(TutorialError, match="'a' of 5 values over 3"):
        curve_plot(curves, x=[1, 2, 3])


def test_motion_change_is_smoothed_and_compared_with_the_truth():
    change = np.r_[np.zeros(50), np.ones(50)]
    figure = motion_change_plot({"x": change}, truth=2.0, smooth=10)
    drawn = line(figure, "x").get_ydata()
    assert drawn[0] == 0 and drawn[-1] == 1 and 0 < drawn[45] < 1
    at = line(figure, "x").get_xdata()  # half way up where the step is, between 49 and 50
    assert len(at) == len(drawn) and np.interp(0.5, drawn[38:52], at[38:52]) == pytest.approx(49.5)
    two = motion_change_plot({"long": change, "short": change[:60]}, smooth=15)
    assert line(two, "short").get_xdata()[[0, -1]].tolist() == [7, 52]
    assert any(np.allclose(other.get_ydata(), 2.0) for other in figure.axes[0].get_lines())
    assert figure.axes[0].get_ylim()[1] >= 2.5


def test_bars_and_distances():
    figure = bar_plot({"walk": {"a": 1.0, "b": 2.0}, "run": {"a": 3.0}})
    heights = [bar.get_height() for bar in figure.axes[0].patches]
    assert heights[:2] == [1.0, 3.0] and heights[2] == 2.0 and np.isnan(heights[3])
    matrix = np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    figure = distance_plot({"one": matrix, "two": 2 * matrix}, fps=30)
    images = [axes.images[0] for axes in figure.axes if axes.images]
    assert len(images) == 2 and np.array_equal(images[1].get_array(), 2 * matrix)
    assert tuple(images[0].get_extent()) == (0, 2.0, 2.0, 0)


def test_rest_pose_names_every_joint_on_its_own_side(small_skeleton):
    figure = rest_pose_plot(small_skeleton)
    names = {t.get_text().split()[1]: t for t in figure.axes[0].texts}
    assert set(names) == {small_skeleton.names[j] for j in small_skeleton.joints}
    assert names["leg"].get_position()[0] > 0.1  # it stands at x = 0.1, so its name is on the right


def test_every_figure_is_a_small_picture_in_a_notebook(small_motion, small_skeleton):
    figures = (curve_plot({"a": np.arange(9.0)}), rest_pose_plot(small_skeleton), pose_strip(small_motion, 4))
    for figure in figures:
        png = figure._repr_png_()
        picture = np.asarray(Image.open(io.BytesIO(png)).convert("L"))
        assert len(png) < 60_000 and picture.min() < 150 and picture.max() == 255


def test_no_pyplot_and_no_backend():
    code = (
        "import sys, numpy as np; from tutorial_lib.view import curve_plot;"
        "curve_plot({'a': np.arange(3)})._repr_png_();"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
