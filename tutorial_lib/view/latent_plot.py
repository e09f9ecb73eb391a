"""Latent spaces on paper: paths through them in time, and how sure a network is of where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import TutorialError
from . import palette
from .figure import NotebookFigure
from .plots import plain_axes


def main_directions(codes: np.ndarray, count: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Mean ``(C,)`` and the ``count`` directions ``(C, count)`` in which codes ``(..., C)`` differ most, the largest
    first: principal components. Raises ``TutorialError`` for fewer codes or numbers than that."""
    flat = np.asarray(codes, dtype=np.float64)
    flat = flat.reshape(-1, flat.shape[-1])
    if min(flat.shape) < count or not np.isfinite(flat).all():
        raise TutorialError(f"codes of shape {np.shape(codes)}: expected {count} or more, all finite")
    _, _, rows = np.linalg.svd(flat - flat.mean(0), full_matrices=False)
    return flat.mean(0), rows[:count].T


def latent_path_plot(
    paths: Mapping[str, np.ndarray],
    *,
    fps: float,
    cloud: np.ndarray | None = None,
    title: str = "",
    panel: float = 3.1,
) -> NotebookFigure:
    """Paths of codes ``{label: (T, C)}`` as curves coloured by time, a panel each, in the two directions in which all
    of them (or ``cloud``, ``(N, C)``, drawn faint behind them) differ most. A circle where each begins, a dot a second.

    panel: inches of a panel's side. Raises ``TutorialError`` for no paths.
    """
    from matplotlib.collections import LineCollection

    if not paths:
        raise TutorialError("latent_path_plot: no paths, expected at least one")
    codes = {label: np.asarray(path, dtype=float) for label, path in paths.items()}
    mean, main = main_directions(np.concatenate(list(codes.values())) if cloud is None else cloud)
    figure = NotebookFigure(figsize=(panel * len(codes) + 0.8, panel + 0.3), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(codes), squeeze=False, sharex=True, sharey=True)[0]
    last = max(map(len, codes.values())) / fps
    for axes, (label, path) in zip(panels, codes.items(), strict=True):
        flat = (path - mean) @ main  # (T, 2)
        if cloud is not None:
            axes.scatter(*((np.asarray(cloud) - mean) @ main).T, s=2, color="#c3cad3", linewidths=0, zorder=0)
        pieces = np.stack([flat[:-1], flat[1:]], axis=1)  # (T - 1, 2, 2)
        lines = LineCollection(pieces, cmap="viridis", array=np.arange(len(pieces)) / fps, linewidths=1.8)
        lines.set_clim(0, last)
        axes.add_collection(lines)
        every = flat[:: max(1, round(fps))]
        axes.scatter(*every.T, c=np.arange(len(every)), cmap="viridis", vmin=0, vmax=last, s=14, zorder=3)
        axes.scatter(*flat[0], s=46, facecolor="white", edgecolor="#24292f", zorder=4)
        axes.set_title(label, fontsize=9.5)
        axes.set(xticks=[], yticks=[])
        axes.autoscale_view()
    bar = figure.colorbar(lines, ax=list(panels), shrink=0.85, pad=0.02)
    bar.set_label("seconds", fontsize=8.5)
    bar.ax.tick_params(labelsize=8)
    if title:
        figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure


def band_plot(
    panels: Mapping[str, Mapping[str, tuple[Any, Any]]],
    *,
    x: Sequence[float] | None = None,
    xlabel: str = "",
    title: str = "",
    columns: int = 2,
    size: tuple[float, float] = (4.2, 1.9),
) -> NotebookFigure:
    """Means and deviations over time as bands, one over the other: ``{panel: {label: (mean (T,), deviation (T,))}}``.

    Each band reaches one deviation to both sides. x: ``(T,)``, by default 0, 1, 2 ... size: inches of a panel.
    Raises ``TutorialError`` for no panels, and for a mean and a deviation of different lengths.
    """
    if not panels:
        raise TutorialError("band_plot: no panels, expected at least one")
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    figure = NotebookFigure(figsize=(size[0] * columns, size[1] * rows + 0.5), layout="constrained", facecolor="white")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for axes in grid[len(panels) :]:
        axes.axis("off")
    labels: dict[str, Any] = {}
    for axes, (name, bands) in zip(grid, panels.items(), strict=False):
        for i, (label, band) in enumerate(bands.items()):
            mean, deviation = (np.asarray(values, dtype=float) for values in band)
            if mean.shape != deviation.shape or mean.ndim != 1:
                raise TutorialError(
                    f"band_plot: {label!r} of {name!r} has means {mean.shape} and deviations {deviation.shape}, "
                    "expected (T,) both"
                )
            at = np.arange(len(mean)) if x is None else np.asarray(x, dtype=float)
            color = palette.color(i)
            axes.fill_between(at, mean - deviation, mean + deviation, color=color, alpha=0.25, linewidth=0)
            (labels[label],) = axes.plot(at, mean, color=color, linewidth=1.6, linestyle=("-", (0, (5, 2)))[i % 2])
        axes.set_title(name, fontsize=9, loc="left")
        plain_axes(axes)
    for axes in grid[max(0, len(panels) - columns) : len(panels)]:
        axes.set_xlabel(xlabel, fontsize=9)
    figure.legend(
        labels.values(), labels.keys(), loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9
    )
    if title:
        figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure
