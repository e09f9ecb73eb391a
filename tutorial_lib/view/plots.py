"""The lessons' figures: curves over time, distances between frames, the rest pose with its names.

Every function returns a matplotlib ``Figure`` that belongs to no window: a notebook shows it as a cell's last value,
``figure.savefig`` writes it. Colours are those of ``palette``; curves also differ in dashes, so that they can be told
apart in grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import TutorialError
from ..metrics import moving_mean
from ..motion.skeleton import Skeleton
from . import palette
from .figure import NotebookFigure

_DASHES = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (7, 2, 1.5, 2)), (0, (1, 1)), (0, (4, 1, 1, 1, 1, 1)))


def curve_plot(
    curves: Mapping[str, np.ndarray],
    *,
    x: Sequence[float] | None = None,
    xlabel: str = "",
    ylabel: str = "",
    title: str = "",
    log: bool = False,
    size: tuple[float, float] = (7.5, 3.4),
) -> NotebookFigure:
    """Curves ``{label: (N,)}`` over ``x`` (None: 0, 1, 2 ...), with a legend beside them, not over them.

    A shorter curve than ``x`` ends earlier. Raises ``TutorialError`` for no curves, or an ``x`` that is too short.
    """
    if not curves:
        raise TutorialError("curve_plot: no curves, expected at least one")
    figure, axes = _axes(size, title, xlabel, ylabel)
    for i, (label, values) in enumerate(curves.items()):
        values = np.asarray(values, dtype=float)
        at = np.arange(len(values)) if x is None else np.asarray(x, dtype=float)[: len(values)]
        if len(at) < len(values):
            raise TutorialError(f"curve_plot: curve {label!r} of {len(values)} values over {len(at)} places")
        style = {"color": palette.color(i), "linestyle": _DASHES[i % len(_DASHES)], "linewidth": 1.8}
        axes.plot(at, values, label=label, **style)
    if log:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def motion_change_plot(
    changes: Mapping[str, np.ndarray], *, truth: float | None = None, smooth: int = 15, title: str = ""
) -> NotebookFigure:
    """acRNN, figure 2: how far a generated frame is from the one before it, over the frames since the seed.

    changes: ``{label: (N,)}`` as ``metrics.motion_change`` gives them; drawn as running means over ``smooth``
    frames, each at the middle of its frames. truth: what it is in real motion, a dotted line.
    """
    smoothed = {label: moving_mean(np.asarray(c, dtype=float), smooth) for label, c in changes.items()}
    middles = np.arange(max(map(len, smoothed.values()), default=0)) + (smooth - 1) / 2
    figure = curve_plot(
        smoothed, x=middles, xlabel="frames after the seed", ylabel="motion change per frame", title=title
    )
    if truth is not None:
        axes = figure.axes[0]
        axes.axhline(truth, color=palette.GREY, linewidth=1.2, linestyle=(0, (1, 2)))
        axes.annotate("true motion", (1, truth), xycoords=("axes fraction", "data"), xytext=(-4, 3),
                      textcoords="offset points", ha="right", fontsize=8, color=palette.GREY)  # fmt: skip
        axes.set_ylim(top=max(axes.get_ylim()[1], 1.25 * truth))
    return figure


def bar_plot(
    groups: Mapping[str, Mapping[str, float]], *, ylabel: str = "", title: str = "", size=(7.5, 3.2)
) -> NotebookFigure:
    """Bars ``{group: {label: value}}``, the value written above each."""
    figure, axes = _axes(size, title, "", ylabel)
    labels = list(dict.fromkeys(label for bars in groups.values() for label in bars))
    width = 0.8 / len(labels)
    for i, label in enumerate(labels):
        at = np.arange(len(groups)) + (i - (len(labels) - 1) / 2) * width
        values = [bars.get(label, np.nan) for bars in groups.values()]
        bars = axes.bar(at, values, 0.92 * width, color=palette.color(i), label=label)
        axes.bar_label(bars, fmt="%.3g", fontsize=8, padding=2)
    axes.set_xticks(np.arange(len(groups)), groups)
    axes.margins(y=0.15)
    if len(labels) > 1:
        figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def distance_plot(
    matrices: Mapping[str, np.ndarray], *, fps: float, title: str = "", size: float = 3.3
) -> NotebookFigure:
    """Distances between every two frames, ``{label: (T, T)}``: dark where two frames are alike; axes in seconds."""
    figure = NotebookFigure(figsize=(size * len(matrices) + 0.6, size + 0.5), layout="constrained", facecolor="white")
    figure.suptitle(title, fontsize=10)
    for axes, (label, matrix) in zip(np.atleast_1d(figure.subplots(1, len(matrices))), matrices.items(), strict=True):
        seconds = len(matrix) / fps
        image = axes.imshow(matrix, cmap="cividis", extent=(0, seconds, seconds, 0), vmin=0)
        axes.set_title(label, fontsize=10)
        axes.set_xlabel("seconds", fontsize=9)
        axes.tick_params(labelsize=8)
        figure.colorbar(image, ax=axes, shrink=0.8).ax.tick_params(labelsize=8)
    return figure


def rest_pose_plot(skeleton: Skeleton, *, names: bool = True, size: float = 6.5) -> NotebookFigure:
    """The skeleton with nothing turned, from the front; each joint that can turn with its name and number."""
    rest = skeleton.rest_pose()
    figure = NotebookFigure(figsize=(size * 1.5, size), layout="constrained", facecolor="white")
    axes = figure.subplots()
    for a, b in skeleton.bones:
        axes.plot(*rest[[a, b]][:, :2].T, color=palette.mix(palette.BLUE, "#ffffff", 0.3), linewidth=3, zorder=1)
    joints = list(skeleton.joints)
    axes.scatter(*rest[joints][:, :2].T, s=22, color=palette.BLUE, zorder=2)
    if sorted(skeleton.end_sites):
        ends = rest[sorted(skeleton.end_sites)]
        axes.scatter(*ends[:, :2].T, s=16, facecolor="white", edgecolor=palette.GREY, zorder=2)
    if names:
        _write_names(axes, skeleton, rest, joints)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.margins(0.12)
    return figure


def _write_names(axes, skeleton: Skeleton, rest: np.ndarray, joints: list[int]):
    """Names in two columns beside the body, each with a thin line to its joint, so that none covers another."""
    span = np.ptp(rest[:, :2], axis=0)
    low, high = rest[:, :2].min(0), rest[:, :2].max(0)
    middle = 0.5 * (low[0] + high[0])
    on_right = [rest[j, 0] > middle if abs(rest[j, 0] - middle) > 0.02 * span[0] else k % 2 == 0
                for k, j in enumerate(joints)]  # fmt: skip
    for side in (-1, 1):
        mine = [j for j, right in zip(joints, on_right, strict=True) if right == (side > 0)]
        mine.sort(key=lambda j: rest[j, 1])
        heights = np.linspace(low[1], high[1], max(len(mine), 2))
        for j, y in zip(mine, heights, strict=False):
            edge = high[0] + 0.12 * span[0] if side > 0 else low[0] - 0.12 * span[0]
            axes.annotate(
                f"{j} {skeleton.names[j]}", rest[j, :2], (edge, y), fontsize=7.5, va="center",
                ha="left" if side > 0 else "right", color="#24292f",
                arrowprops={"arrowstyle": "-", "color": "#c3cad3", "linewidth": 0.7, "shrinkA": 0, "shrinkB": 2},
            )  # fmt: skip


def _axes(size, title, xlabel, ylabel):
    figure = NotebookFigure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots()
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(xlabel, fontsize=9)
    axes.set_ylabel(ylabel, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes
