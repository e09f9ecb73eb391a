"""Graphical models, latent paths and bands: what is drawn, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from tutorial_lib.errors import TutorialError
from tutorial_lib.view import band_plot, graph_plot, latent_path_plot
from tutorial_lib.view.latent_plot import main_directions

GRAPHS = {"generation": {"f": ["h"], "s": ["f", "h"]}, "transition": {"next": ["h", "s"]}}
PLACES = {"h": (0, 1), "f": (1, 2), "s": (1, 0), "next": (2, 1)}


def test_a_graph_has_an_arrow_for_each_parent_and_circles_for_chance():
    figure = graph_plot(GRAPHS, PLACES, drawn={"f", "s"}, known={"transition": {"s"}}, labels={"f": "$f_t$"})
    first, second = figure.axes
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["generation", "transition"]
    written = [t for t in first.texts if not hasattr(t, "arrow_patch")]
    assert len(first.texts) - len(written) == 3 and {t.get_text() for t in written} == {"$f_t$", "s", "h"}
    kinds = [type(patch).__name__ for patch in first.patches]
    assert sorted(kinds) == ["Circle", "Circle", "Rectangle"]
    grey = [patch.get_facecolor() for patch in second.patches if type(patch).__name__ == "Circle"]
    assert grey != [first.patches[0].get_facecolor()], "known there, and not in the first"


def test_arrows_end_at_the_rims():
    figure = graph_plot({"": {"b": ["a"]}}, {"a": (0, 0), "b": (2, 0)}, drawn={"b"})
    (arrow,) = [t for t in figure.axes[0].texts if hasattr(t, "arrow_patch")]
    (start, _), (end, _) = arrow.xyann, arrow.xy
    assert start == pytest.approx(0.3) and 1.6 < end < 1.72


@pytest.mark.parametrize("graphs", [{}, {"": {"lost": ["h"]}}])
def test_graphs_that_cannot_be_drawn(graphs):
    with pytest.raises(TutorialError, match="no graph|'lost' of '' has no place"):
        graph_plot(graphs, PLACES)


def test_main_directions_are_where_codes_differ_most():
    rng = np.random.default_rng(0)
    codes = rng.normal(size=(500, 6)) * (0.1, 5, 0.1, 0.1, 2, 0.1) + 7
    mean, main = main_directions(codes)
    assert mean == pytest.approx(codes.mean(0)) and np.abs(main[1, 0]) > 0.99 and np.abs(main[4, 1]) > 0.99
    with pytest.raises(TutorialError, match=r"codes of shape \(1, 6\)"):
        main_directions(codes[:1])


def test_a_latent_path_is_coloured_by_time():
    t = np.linspace(0, 6, 91)
    path = np.stack([np.cos(t), np.sin(t), 0 * t], 1)
    figure = latent_path_plot({"circle": path, "half": path[:46]}, fps=30, cloud=path * 1.5)
    for axes, n in zip(figure.axes[:2], (90, 45), strict=True):
        (lines,) = [c for c in axes.collections if isinstance(c, LineCollection)]
        assert np.allclose(lines.get_array(), np.arange(n) / 30) and lines.get_clim() == (0, 91 / 30)
        lengths = np.linalg.norm(np.diff(lines.get_segments(), axis=1), axis=-1)
        assert np.allclose(lengths, 6 / 90, rtol=0.01), "turned, not stretched"
    with pytest.raises(TutorialError, match="no paths"):
        latent_path_plot({}, fps=30)


def test_bands_reach_a_deviation_to_both_sides():
    mean, deviation = np.linspace(0, 1, 20), np.full(20, 0.25)
    figure = band_plot({"one": {"prior": (mean, deviation), "posterior": (mean, deviation / 5)},
                        "two": {"prior": (mean, deviation)}}, xlabel="frame")  # fmt: skip
    one, two = figure.axes
    edges = [c.get_paths()[0].vertices[:, 1] for c in one.collections]
    assert [(e.min(), e.max()) for e in edges] == [pytest.approx((-0.25, 1.25)), pytest.approx((-0.05, 1.05))]
    assert [text.get_text() for text in figure.legends[0].texts] == ["prior", "posterior"]
    assert len(two.lines) == 1 and two.get_xlabel() == "frame"
    with pytest.raises(TutorialError, match="means .20,. and deviations .19,."):
        band_plot({"": {"prior": (mean, deviation[1:])}})
    with pytest.raises(TutorialError, match="no panels"):
        band_plot({})
