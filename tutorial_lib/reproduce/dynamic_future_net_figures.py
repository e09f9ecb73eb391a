"""Figures 6 to 9 of the Dynamic Future Net paper, of a result of ``reproduce dynamic-future-net``.

They are of a network of all four actions: the one named, by default the weights shipped, which were trained for
longest, or else the plan's own. None where there is none. Colours are the actions', in table 1's order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..view import palette
from ..view.figure import NotebookFigure
from ..view.latent_plot import band_plot
from .dynamic_future_net_plan import ACTIONS, JOINT, SHIPPED
from .dynamic_future_net_tables import note
from .results import Result, numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ALONE = "alone"
LATENTS = {"z": "what is decoded, z", "s": "current state s"}


def color(action: str) -> str:
    """Of an action, in all figures."""
    return palette.color(ACTIONS.index(action))


def _drawn(result: Result, label: str | None, latent: bool = True) -> dict | None:
    """The network that the figures are of; ``latent``: it must have what figures 6 to 8 are drawn from."""
    runs = result["runs"]
    run = runs.get(label) if label else runs.get(SHIPPED) or runs.get(JOINT)
    return run if run is None or run["paths"] or not latent else None


def figure_6(result: Result, label: str | None = None) -> Figure | None:
    """The codes z of a training clip of each action, one after another, in their two main directions.

    What lies far outside is cut off: some captured clips begin with a frame or two that are no dance.
    """
    run = _drawn(result, label)
    if run is None:
        return None
    figure = NotebookFigure(figsize=(4.6, 3.8), layout="constrained")
    axes = figure.subplots()
    for action, path in run["paths"]["clips"].items():
        _path(axes, numbers(path), color(action), action)
    _show_most(axes, np.concatenate([numbers(path) for path in run["paths"]["clips"].values()]))
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    _plain(axes, "")
    figure.suptitle("Figure 6: clips in the latent space" + note(result), fontsize=9, x=0.01, ha="left")
    return figure


def figure_7(result: Result, label: str | None = None) -> Figure | None:
    """Futures of one prefix of each action in the directions of figure 6; a circle where they begin."""
    run = _drawn(result, label)
    if run is None:
        return None
    figure, panels = _panels(run["paths"]["futures"])
    for axes, (action, futures) in zip(panels, run["paths"]["futures"].items(), strict=True):
        for k, path in enumerate(futures):
            tone = palette.mix(color(action), "#ffffff" if k % 2 else "#000000", 0.55 * k / len(futures))
            _path(axes, numbers(path), tone)
        _plain(axes, f"from {action}")
    figure.suptitle("Figure 7: futures of one prefix" + note(result), fontsize=10)
    return figure


def figure_8(result: Result, label: str | None = None) -> Figure | None:
    """The states of many futures of one prefix, early and late: z above, s below."""
    run = _drawn(result, label)
    if run is None:
        return None
    prefixes = run["fan"]["prefixes"]
    figure = NotebookFigure(figsize=(2.4 * len(prefixes), 4.9), layout="constrained")
    rows = figure.subplots(2, len(prefixes), squeeze=False)
    early, late = (str(t) for t in result["protocol"]["at"])
    for row, (name, title) in zip(rows, LATENTS.items(), strict=True):
        for axes, (action, entry) in zip(row, prefixes.items(), strict=True):
            for time, tone in ((late, palette.ORANGE), (early, palette.VERMILLION)):
                x, y = numbers(entry["latent"][name][time]).T
                axes.scatter(x, y, s=5, color=tone, linewidths=0, alpha=0.7, label=f"frame {time}")
            _plain(axes, f"from {action}" if name == "z" else "")
        row[0].set_ylabel(title, fontsize=9)
    handles, labels = rows[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    figure.suptitle(f"Figure 8: {result['protocol']['fan']} futures of one prefix, some of them" + note(result),
                    fontsize=10)  # fmt: skip
    return figure


def figure_9(result: Result, label: str | None = None) -> Figure | None:
    """The distance to the mean pose over time from a prefix of each action, mean and deviation, beside the data's.

    label: as for the other figures; "alone": each action's own network, also where there is no other.
    """
    whole, found = None if label == ALONE else _drawn(result, label, latent=False), {}
    for action in ACTIONS:
        run = whole or (result["runs"].get(action) if label in (None, ALONE) else None)
        if run is not None and action in run["fan"]["prefixes"]:
            found[action] = run
    if not found:
        return None
    panels = {}
    for action, run in found.items():
        fan = run["fan"]
        entry, flat = fan["prefixes"][action], np.ones(len(fan["frames"]))
        panels[f"from {action}"] = {
            "futures": tuple(numbers(values) for values in entry["band"]),
            "data of this action": tuple(x * flat for x in entry["own"]["data"]),
        }
        if whole:  # else they are the same
            panels[f"from {action}"]["all data"] = tuple(x * flat for x in fan["data"])
    return band_plot(panels, x=fan["frames"], xlabel="frame", title="Figure 9, metres" + note(result))


def _panels(found) -> tuple[NotebookFigure, np.ndarray]:
    figure = NotebookFigure(figsize=(2.4 * len(found), 2.9), layout="constrained")
    return figure, figure.subplots(1, len(found), squeeze=False)[0]


def _path(axes: Axes, path: np.ndarray, tone: str, label: str = "") -> None:
    axes.plot(*path.T, color=tone, linewidth=1, alpha=0.85, label=label or None)
    axes.plot(*path[0], marker="o", color=tone, markerfacecolor="white", markersize=5, linestyle="none", zorder=5)


def _show_most(axes: Axes, points: np.ndarray, beyond: float = 1.0) -> None:
    """Limits that hold the middle nine tenths of points ``(N, 2)``, and ``beyond`` times their width to both sides."""
    low, high = np.nanquantile(points, [0.05, 0.95], axis=0)
    inside = ((points >= low - beyond * (high - low)) & (points <= high + beyond * (high - low))).all(1)
    least, most = points[inside].min(0), points[inside].max(0)
    margin = 0.05 * (most - least)
    axes.set(xlim=(least[0] - margin[0], most[0] + margin[0]), ylim=(least[1] - margin[1], most[1] + margin[1]))


def _plain(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])
