"""A path along the ground and who walked it, seen from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import TutorialError
from ..motion.clip import Motion
from ..motion.ground import check_path
from . import palette
from .figure import NotebookFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def path_plot(
    path: Sequence | None,
    walked: Mapping[str, Motion | np.ndarray] | None = None,
    *,
    every: float = 0.0,
    fps: float = 30.0,
    title: str = "",
    path_label: str = "path asked for",
    size: tuple[float, float] = (7.5, 4.0),
) -> NotebookFigure:
    """A path ``(N, 2)`` of x and z in metres, broad and grey, and the ways of some roots over it, in metres.

    walked: ``{label: Motion or places (T, 2) or (T, 3)}``. every: mark each way every so many seconds (0: not);
    fps: of places, motions have their own. path_label: of the path, in the legend. z runs to the right and x up, so
    that headings turn as angles do.
    Raises ``TutorialError`` for nothing to draw, and for places of another shape.
    """
    ways = {label: ground_of(way) for label, way in (walked or {}).items()}
    if path is None and not ways:
        raise TutorialError("path_plot: neither a path nor who walked it, expected one of them")
    figure = NotebookFigure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots()
    if path is not None:
        draw_path(axes, check_path(path), color="#c3cad3", width=7, label=path_label, ends=not ways)
    for i, (label, place) in enumerate(ways.items()):
        color = palette.color(i)
        axes.plot(place[:, 1], place[:, 0], color=color, linewidth=1.6, label=label)
        axes.scatter(*place[0, ::-1], s=34, color="white", edgecolors=color, linewidths=1.8, zorder=3)
        if every > 0:
            rate = walked[label].fps if isinstance(walked[label], Motion) else fps
            marks = place[max(1, round(every * rate)) :: max(1, round(every * rate))]
            axes.scatter(marks[:, 1], marks[:, 0], s=11, color=color, edgecolors="white", linewidths=0.5, zorder=3)
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel("z, metres", fontsize=9)
    axes.set_ylabel("x, metres", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def draw_path(axes: Axes, path: np.ndarray, *, color: str, width: float, label: str = "", ends: bool = True) -> None:
    """A path ``(N, 2)``, with its start and, as an arrow, its end, on axes of z to the right and x up."""
    axes.plot(path[:, 1], path[:, 0], color=color, linewidth=width, solid_capstyle="round", solid_joinstyle="round",
              label=label or None, zorder=1.5)  # fmt: skip
    if not ends:
        return
    back = path[np.linalg.norm(path - path[-1], axis=1) > 0.02]
    axes.annotate("", path[-1, ::-1], (back[-1] if len(back) else path[0])[::-1], zorder=2.5,
                  arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": width / 3,
                              "mutation_scale": 10 + 2 * width})  # fmt: skip
    axes.scatter(*path[0, ::-1], s=12 * width, color="white", edgecolors=color, linewidths=width / 2.5, zorder=2.6)


def ground_of(way: Motion | np.ndarray) -> np.ndarray:
    """The places on the ground, x and z ``(T, 2)``, of a motion's root or of places ``(T, 2)`` or ``(T, 3)``."""
    place = way.positions[:, 0] if isinstance(way, Motion) else np.asarray(way, dtype=float)
    if place.ndim != 2 or place.shape[1] not in (2, 3) or not len(place) or not np.isfinite(place).all():
        raise TutorialError(f"places of shape {place.shape}: expected (T, 2) or (T, 3), metres, all finite")
    return place[:, [0, -1]]
