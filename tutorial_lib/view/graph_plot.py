"""Graphical models on paper: which quantity is told or drawn from which, as in figure 5 of "Dynamic Future Net"."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import TutorialError
from . import palette
from .figure import NotebookFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RADIUS = 0.3  # of a node, in the unit of the places
_INCH = 0.62  # that unit on paper


def graph_plot(
    panels: Mapping[str, Mapping[str, Sequence[str]]],
    places: Mapping[str, tuple[float, float]],
    *,
    drawn: Collection[str] = (),
    known: Mapping[str, Collection[str]] | None = None,
    labels: Mapping[str, str] | None = None,
) -> NotebookFigure:
    """Graphs side by side, ``{title: {node: its parents}}``: an arrow from each parent.

    places: ``{node: (x, y)}`` of all nodes, y upwards, neighbours about 1 apart. drawn: nodes that are drawn by chance,
    circles; the others, which follow from their parents, are squares. known: ``{title: nodes}`` that are given there,
    in grey. labels: what is written in a node (also as TeX, ``"$f_t$"``) where that is not its name.
    Raises ``TutorialError`` for no graph, and for a node without a place.
    """
    if not panels:
        raise TutorialError("graph_plot: no graph, expected at least one")
    nodes = {title: dict.fromkeys([*graph, *(p for each in graph.values() for p in each)]) for title, graph in
             panels.items()}  # fmt: skip
    for title, names in nodes.items():
        for name in names:
            if name not in places:
                raise TutorialError(f"graph_plot: {name!r} of {title!r} has no place, those with one are "
                                    f"{', '.join(map(str, places))}")  # fmt: skip
    points = {title: np.array([places[name] for name in names], dtype=float) for title, names in nodes.items()}
    low = {title: at.min(0) - 0.55 for title, at in points.items()}
    size = {title: at.max(0) + 0.55 - low[title] for title, at in points.items()}
    bottom = min(each[1] for each in low.values())
    tall = max(low[title][1] + size[title][1] for title in panels) - bottom
    gap, above = 0.35, 0.32  # inches
    wide = _INCH * sum(each[0] for each in size.values()) + gap * (len(panels) - 1)
    high = _INCH * tall + above
    figure = NotebookFigure(figsize=(wide, high), dpi=100, facecolor="white")
    left = 0.0
    for title, graph in panels.items():
        across = _INCH * size[title][0]
        axes = figure.add_axes((left / wide, 0, across / wide, 1 - above / high))
        axes.set(xlim=(low[title][0], low[title][0] + size[title][0]), ylim=(bottom, bottom + tall))
        axes.axis("off")
        axes.set_aspect("equal")
        axes.set_title(title, fontsize=9.5, loc="left")
        for name, parents in graph.items():
            for parent in parents:
                _arrow(axes, np.array(places[parent], float), np.array(places[name], float), name in drawn)
        for name in nodes[title]:
            _node(
                axes, places[name], (labels or {}).get(name, name), name in drawn, name in (known or {}).get(title, ())
            )
        left += across + gap
    return figure


def _arrow(axes: Axes, start: np.ndarray, end: np.ndarray, to_circle: bool) -> None:
    way = end - start
    unit = way / np.linalg.norm(way)
    rim = _RADIUS if to_circle else _RADIUS / max(abs(unit))  # of a circle, of a square
    axes.annotate("", end - unit * (rim + 0.02), start + unit * _RADIUS, zorder=1,
                  arrowprops={"arrowstyle": "-|>", "color": palette.GREY, "linewidth": 1.3, "mutation_scale": 12,
                              "shrinkA": 0, "shrinkB": 0})  # fmt: skip


def _node(axes: Axes, at: tuple[float, float], label: str, drawn: bool, known: bool) -> None:
    from matplotlib.patches import Circle, Rectangle

    style = {
        "facecolor": "#d9dee5" if known else palette.mix(palette.BLUE, "#ffffff", 0.86) if drawn else "white",
        "edgecolor": palette.BLUE if drawn else palette.GREY,
        "linewidth": 1.6, "zorder": 2,
    }  # fmt: skip
    corner = np.subtract(at, _RADIUS)
    axes.add_patch(Circle(at, _RADIUS, **style) if drawn else Rectangle(corner, 2 * _RADIUS, 2 * _RADIUS, **style))
    axes.text(*at, label, ha="center", va="center", fontsize=11, color="#24292f", zorder=3)
