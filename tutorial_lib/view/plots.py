"""The lessons' figures: curves over time, schedules, clouds of frames, distances, the rest pose with its names.

Every function returns a matplotlib ``Figure`` that belongs to no window: a notebook shows it as a cell's last value,
``figure.savefig`` writes it. Colours are those of ``palette``; curves also differ in dashes, so that they can be told
apart in grey. From the seventh curve on the colours come again, darker and with other dashes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import TutorialError
from ..metrics import moving_mean
from ..motion.skeleton import Skeleton
from . import palette
from .figure import NotebookFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
        axes.plot(at, values, label=label, linewidth=1.8, **_curve_style(i))
    if log:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    figure.legend(loc="outside right upper", frameon=False, fontsize=9, handlelength=3)  # the longest dashes, whole
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


def schedule_plot(
    schedules: Mapping[str, np.ndarray], *, frames: int = 40, title: str = "", width: float = 7.5
) -> NotebookFigure:
    """acRNN, figure 1, as rows of squares: dark where the network is fed the truth, light where its own last output.

    schedules: ``{label: (T,) or (B, T)}`` booleans, True for the truth (arrays or tensors); of each the first
    ``frames`` frames are drawn, a row a sequence. width: of the figure, inches.
    Raises ``TutorialError`` for no schedules, and for what is not a schedule.
    """
    if not schedules:
        raise TutorialError("schedule_plot: no schedules, expected at least one")
    rows = {}
    for label, schedule in schedules.items():
        each = np.atleast_2d(np.asarray(schedule))
        if each.dtype != bool or each.ndim != 2 or not each.size:
            raise TutorialError(
                f"schedule_plot: {label!r} is {each.dtype} of shape {np.shape(schedule)}, "
                "expected booleans (T,) or (B, T)"
            )
        rows[label] = each[:, :frames]
    across = max(each.shape[1] for each in rows.values())
    lines = [label.split("\n") for label in rows]
    left = 0.12 + 0.078 * max(len(line) for label in lines for line in label)
    square = (width - left - 0.1) / across  # inches
    gap = max(0.7, 0.16 * max(map(len, lines)) / square - 1)  # between schedules, in squares
    tall = sum(len(each) for each in rows.values()) + gap * (len(rows) - 1)
    above, below = 0.34 + 0.24 * bool(title), 0.42
    total = tall * square + above + below
    figure = NotebookFigure(figsize=(width, total), dpi=100, facecolor="white")
    axes = figure.add_axes((left / width, below / total, across * square / width, tall * square / total))
    at, middles = 0.0, []
    for each in rows.values():
        draw_schedule(axes, each, at)
        middles.append(at + len(each) / 2)
        at += len(each) + gap
    axes.set(xlim=(0, across), ylim=(tall, 0))
    axes.set_yticks(middles, list(rows), fontsize=9)
    every = 5 if across <= 50 else 10
    numbers = np.arange(0, across, every)
    axes.set_xticks(numbers + 0.5, numbers, fontsize=8)
    axes.set_xlabel("frame", fontsize=9)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    if title:
        figure.text(0.1 / width, 1 - 0.07 / total, title, va="top", fontsize=10)
    legend = figure.add_axes((left / width, 1 - above / total, across * square / width, 0.3 / total))
    legend.set(xlim=(0, across * square), ylim=(0.3, 0))
    legend.axis("off")
    for x, label, is_truth in ((0.0, "fed the truth", True), (1.35, "fed its own last output", False)):
        draw_schedule(legend, np.array([[is_truth]]), 0.08, size=0.14, left=x)
        legend.text(x + 0.2, 0.15, label, fontsize=8.5, va="center")
    return figure


def draw_schedule(
    axes: Axes, rows: np.ndarray, top: float, *, size: float = 1.0, left: float = 0.0, line: float = 1.0
) -> None:
    """Squares of ``size`` for a schedule (B, T), its first row at y = ``top``, on axes whose y runs downwards.

    left: where its first frame starts; line: width of the squares' edges, in points.
    """
    from matplotlib.collections import PolyCollection

    row, frame = np.indices(rows.shape)
    corners = np.array([[0.08, 0.08], [0.92, 0.08], [0.92, 0.92], [0.08, 0.92]])
    squares = (np.stack([frame, row], -1)[..., None, :] + corners) * size + (left, top)
    light = palette.mix(palette.BLUE, "#ffffff", 0.82)
    for chosen, face, edge in ((rows, palette.GREY, palette.GREY), (~rows, light, palette.BLUE)):
        axes.add_collection(PolyCollection(squares[chosen], facecolors=face, edgecolors=edge, linewidths=line))


def cloud_plot(
    cloud: np.ndarray,
    paths: Mapping[str, np.ndarray],
    *,
    fps: float,
    every: float = 1.0,
    numbers: int = 8,
    cloud_label: str = "training frames",
    unit: str = "",
    title: str = "",
    size: tuple[float, float] = (9.5, 4.0),
) -> NotebookFigure:
    """What a network was fed in training, a cloud of frames, and what it met in synthesis, paths through the cloud.

    Left: both on the two directions in which the cloud is widest (its principal components). Right: each path's
    distance, over all channels, to the nearest frame of the cloud: how new what the network is fed is to it. A
    real clip that the cloud does not hold shows what distance is ordinary.

    cloud: ``(N, D)`` features. paths: ``{label: (T, D)}`` in the same features; at most six. Marked every
    ``every`` seconds, the first ``numbers`` marks with the seconds passed. fps: of the paths. A path ends where it
    is no longer finite. Raises ``TutorialError`` for shapes that do not fit.
    """
    cloud = np.asarray(cloud, dtype=float)
    if cloud.ndim != 2 or min(cloud.shape) < 2 or not np.isfinite(cloud).all():
        raise TutorialError(
            f"cloud_plot: a cloud of shape {cloud.shape}, expected (N, D), 2 or more of each, all finite"
        )
    finite = {}
    for label, path in paths.items():
        path = np.asarray(path, dtype=float)
        if path.ndim != 2 or path.shape[1] != cloud.shape[1]:
            raise TutorialError(
                f"cloud_plot: path {label!r} of shape {path.shape} beside a cloud of {cloud.shape[1]} channels"
            )
        ok = np.isfinite(path).all(1)
        finite[label] = path if ok.all() else path[: int(ok.argmin())]
    middle = cloud.mean(0)
    spread, directions = np.linalg.eigh(np.cov(cloud.T))
    directions, share = directions[:, :-3:-1], spread[:-3:-1] / max(spread.sum(), 1e-300)
    directions = directions * np.sign(directions[np.abs(directions).argmax(0), [0, 1]])  # else the sign is chance

    figure = NotebookFigure(figsize=size, layout="constrained", facecolor="white")
    if title:
        figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    where, far = figure.subplots(1, 2, width_ratios=(1.15, 1))
    points = (cloud - middle) @ directions
    thin = points[:: max(1, len(points) // 4000)]
    where.scatter(*thin.T, s=5, color="#b4bcc6", linewidths=0, label=cloud_label)
    low, high = points.min(0), points.max(0)
    behind = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.65, "linewidth": 0}
    for i, (label, path) in enumerate(finite.items()):
        line = (path - middle) @ directions
        style = _curve_style(i)
        where.plot(*line.T, linewidth=1.3, label=label, **style)
        far.plot(np.arange(len(path)) / fps, nearest_distance(path, cloud), linewidth=1.6, **style)
        marks = np.arange(0, len(path), max(1, round(every * fps)))
        where.scatter(*line[marks].T, s=16, color=style["color"], edgecolors="white", linewidths=0.6, zorder=3)
        for k, frame in enumerate(marks[:numbers]):
            where.annotate(f"{k * every:g}", line[frame], xytext=(3, 3), textcoords="offset points", fontsize=7.5,
                           color=palette.mix(style["color"], "#000000", 0.3), weight="bold",
                           bbox=behind)  # fmt: skip
        if len(line):
            low, high = np.minimum(low, line.min(0)), np.maximum(high, line.max(0))
    # a path that runs off must not shrink the cloud to a dot
    room, centre = 1.5 * np.ptp(points, axis=0), points.mean(0)
    low, high = np.maximum(low, centre - room), np.minimum(high, centre + room)
    margin = 0.06 * (high - low)
    where.set(xlim=(low[0] - margin[0], high[0] + margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))
    where.set_xlabel(f"first principal component ({share[0]:.0%} of the spread)", fontsize=9)
    where.set_ylabel(f"second ({share[1]:.0%})", fontsize=9)
    where.legend(loc="best", fontsize=8, framealpha=0.85, edgecolor="none", markerscale=2)
    far.set_xlabel("seconds", fontsize=9)
    far.set_ylabel(f"distance to the nearest of the {cloud_label}{f' ({unit})' if unit else ''}", fontsize=9)
    far.set_ylim(bottom=0)
    for axes in (where, far):
        plain_axes(axes)
    return figure


def nearest_distance(frames: np.ndarray, cloud: np.ndarray) -> np.ndarray:
    """Euclidean distance of each of ``frames`` (T, D) to the nearest of ``cloud`` (N, D): (T,)."""
    from scipy.spatial.distance import cdist

    step = max(1, 4_000_000 // len(cloud))  # so that little memory is needed beside them
    parts = [cdist(frames[i : i + step], cloud).min(1) for i in range(0, len(frames), step)]
    return np.concatenate(parts) if parts else np.zeros(0)


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
        bars = axes.bar(at, values, 0.92 * width, color=_tone(i), label=label)
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


def _tone(index: int) -> str:
    """The palette's colours, and after its end the same ones darker, twice."""
    return palette.mix(palette.color(index), "#000000", min(0.7, 0.35 * (index // len(palette.COLORS))))


def _curve_style(index: int) -> dict[str, Any]:
    """Colour and dashes of a curve: in each round of the colours the dashes are one further on."""
    return {"color": _tone(index), "linestyle": _DASHES[(index + index // len(palette.COLORS)) % len(_DASHES)]}


def _axes(size, title, xlabel, ylabel):
    figure = NotebookFigure(figsize=size, layout="constrained", facecolor="white")
    axes = figure.subplots()
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(xlabel, fontsize=9)
    axes.set_ylabel(ylabel, fontsize=9)
    plain_axes(axes)
    return figure, axes


def plain_axes(axes: Axes) -> None:
    """Small numbers, a faint grid, no frame: how all curves here look."""
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
