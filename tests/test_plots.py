"""The lessons' figures: they hold the numbers they were given, and belong to nothing global."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

from tutorial_lib.errors import TutorialError
from tutorial_lib.view import (
    bar_plot,
    cloud_plot,
    curve_plot,
    distance_plot,
    motion_change_plot,
    pose_strip,
    rest_pose_plot,
    schedule_plot,
)
from tutorial_lib.view.plots import nearest_distance


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


def test_no_two_of_twelve_curves_look_alike():
    names = "abcdefghijkl"
    rng = np.random.default_rng(0)
    curves = curve_plot({name: np.arange(3.0) for name in names})
    where, far = cloud_plot(rng.normal(size=(50, 4)), {name: rng.normal(size=(5, 4)) for name in names}, fps=30).axes
    for drawn in (curves.axes[0].get_lines(), curves.legends[0].get_lines(), where.get_lines(), far.get_lines()):
        looks = [(one.get_color(), one._dash_pattern) for one in drawn]
        assert len(looks) == 12
        assert len({color for color, _ in looks}) == 12, "the colours come again"
        dashes = [pattern for _, pattern in looks]
        assert len({str(pattern) for pattern in dashes[:6]}) == 6, "the first six also differ without colour"
        assert all(a != b for a, b in zip(dashes, dashes[6:], strict=False)), "two of one hue have the same dashes"
    bars = bar_plot({"one": dict.fromkeys(names, 1.0)}).axes[0].patches
    assert len({bar.get_facecolor() for bar in bars}) == 12


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


def test_a_strip_can_show_other_frames_of_each_motion(small_motion):
    figure = pose_strip([small_motion, small_motion], [[5, 40], [7, 20, 49]], labels=["early", "late"])
    numbers = [t.get_text().split("\n") for t in figure.texts if "\n" in t.get_text()]
    assert [n[0] for n in numbers] == [f"frame {f}" for f in (5, 40, 7, 20, 49)]
    assert numbers[1][1] == "1.33 s"
    first, second = (len(axes.collections) for axes in figure.axes)
    assert 0 < 3 * first == 2 * second, "two poses above, three below"
    places = [t.get_position() for t in figure.texts if "\n" in t.get_text()]
    assert places[0][1] == places[1][1] > places[2][1] and places[0][0] == places[2][0]
    for wrong, says in (
        ([[5]], "1 lists of frames"),
        ([[5], []], "not empty"),
        ([[5], [50]], "frame 50 of row 1, expected 0 to 49"),
    ):
        with pytest.raises(TutorialError, match=says):
            pose_strip([small_motion, small_motion], wrong)


# -- schedules -----------------------------------------------------------------------------------------------


def squares(axes) -> dict[str, set[tuple[int, int]]]:
    """Places (row, frame) of the dark and of the light squares, on axes where a square is 1 x 1."""
    dark, light = axes.collections[:2]
    assert dark.get_facecolor().mean() < light.get_facecolor().mean(), "they differ without colour, too"
    corners = [np.array([path.vertices.min(0) for path in c.get_paths()]).reshape(-1, 2) for c in (dark, light)]
    return {name: {(int(y), int(x)) for x, y in at} for name, at in zip(("truth", "own"), corners, strict=True)}


def test_a_schedule_is_drawn_as_figure_1_has_it():
    figure = schedule_plot({"u = 3, v = 2": np.array([1, 1, 1, 0, 0, 1, 1, 1, 0, 0], bool)})
    drawn = squares(figure.axes[0])
    assert drawn["truth"] == {(0, t) for t in (0, 1, 2, 5, 6, 7)} and drawn["own"] == {(0, t) for t in (3, 4, 8, 9)}
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == ["u = 3, v = 2"]
    assert {t.get_text() for t in figure.axes[1].texts} == {"fed the truth", "fed its own last output"}


def test_a_schedule_of_several_sequences_has_a_row_for_each_and_long_ones_are_cut():
    tensor = torch.zeros(3, 100, dtype=torch.bool)
    tensor[:, 0] = True
    tensor[1] = True
    figure = schedule_plot({"tossed": tensor}, frames=30)
    drawn = squares(figure.axes[0])
    assert drawn["truth"] == {(0, 0), (2, 0)} | {(1, t) for t in range(30)}
    assert len(drawn["own"]) == 58


@pytest.mark.parametrize("wrong", [np.ones(5), np.ones((2, 2, 2), bool), np.ones((0, 5), bool)])
def test_what_is_no_schedule_is_refused(wrong):
    with pytest.raises(TutorialError, match=r"'x' is \w+ of shape .*, expected booleans \(T,\) or \(B, T\)"):
        schedule_plot({"x": wrong})
    with pytest.raises(TutorialError, match="no schedules"):
        schedule_plot({})


# -- what it was fed and what it met -------------------------------------------------------------------------


@pytest.fixture
def cloud() -> np.ndarray:
    """500 frames of four channels: widest along (0, 1, 1, 0) / sqrt 2, then along channel 3."""
    rng = np.random.default_rng(3)
    wide, second = rng.normal(scale=3.0, size=500), rng.normal(scale=1.0, size=500)
    return np.stack([0.01 * rng.normal(size=500), wide / 2**0.5, wide / 2**0.5, second], axis=1) + [1, 2, 3, 4]


def test_paths_are_seen_from_the_clouds_widest_side(cloud):
    path = np.array([1.0, 2, 3, 4]) + np.linspace(0, 2, 60)[:, None] * [0, 2**-0.5, 2**-0.5, 0]
    where, far = cloud_plot(cloud, {"out": path}, fps=30).axes
    x, y = line_of(where, "out")
    assert abs(x[-1] - x[0]) == pytest.approx(2, abs=0.02) and abs(y[-1] - y[0]) < 0.1
    points = where.collections[0].get_offsets()
    assert len(points) == 500 and np.allclose(points.std(0), [3, 1], rtol=0.15)
    assert "90%" in where.get_xlabel(), "9 of 10 of the spread"
    assert [t.get_text() for t in where.texts if t.get_text()] == ["0", "1"], "marked by the second"
    assert far.get_lines()[0].get_xdata()[-1] == pytest.approx(59 / 30)


def test_distance_to_the_nearest_frame_is_over_all_channels(cloud):
    path = np.repeat(cloud[[7, 8]], 30, axis=0)
    path[30:, 0] += 5  # along the channel that the picture cannot show
    _, far = cloud_plot(cloud, {"away": path}, fps=30).axes
    distance = far.get_lines()[0].get_ydata()
    assert np.allclose(distance[:30], 0) and np.allclose(distance[30:], 5, atol=0.05)
    brute = [min(np.linalg.norm(cloud - p, axis=1)) for p in path]
    assert np.allclose(nearest_distance(path, cloud), brute)


def test_a_path_that_runs_off_ends_and_does_not_shrink_the_cloud(cloud):
    path = cloud[:60] * np.exp(np.arange(60) / 3)[:, None]
    path[50:] = np.inf
    where, far = cloud_plot(cloud, {"off": path}, fps=30).axes
    assert len(line_of(where, "off")[0]) == len(far.get_lines()[0].get_ydata()) == 50
    assert np.ptp(where.get_xlim()) < 4 * np.ptp(where.collections[0].get_offsets()[:, 0])
    assert far.get_ylim()[0] == 0


def test_clouds_and_paths_that_do_not_fit_are_refused(cloud):
    with pytest.raises(TutorialError, match=r"'p' of shape \(9, 3\) beside a cloud of 4 channels"):
        cloud_plot(cloud, {"p": np.zeros((9, 3))}, fps=30)
    with pytest.raises(TutorialError, match=r"a cloud of shape \(4,\)"):
        cloud_plot(cloud[0], {}, fps=30)
    cloud[3, 2] = np.nan
    with pytest.raises(TutorialError, match="all finite"):
        cloud_plot(cloud, {}, fps=30)


def line_of(axes, label):
    return next(line for line in axes.get_lines() if line.get_label() == label).get_data()
