"""``explorer``: what u and v of auto-conditioning do, to be tried out in the page, without a kernel or a network.

Zhou et al., "Auto-conditioned recurrent networks", figures 1, 2 and 9: the schedule drawn for the chosen u and
v, the motion change of every trained pair, and the chosen pair's motion in the player. The page part is
``explorer.js``; before it goes a picture with all pairs at once, for pages in which no script may run.
"""

from __future__ import annotations

import functools
import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import TutorialError
from ..metrics import moving_mean
from ..motion.clip import Motion
from . import palette
from .figure import NotebookFigure
from .page import PageOutput, filled_element, page_file
from .player import Player
from .plots import draw_schedule

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CLIP_STEP = 0.001  # metres: what a clip to watch is rounded to, a tenth of a line's width on the screen
_POINTS = 240  # of a curve in the page
_TOP = 3.0  # times the true motion change: what is above leaves the picture
_HINT = "The explorer needs its script: open this notebook as a trusted one, or in a browser."


@dataclass(frozen=True, eq=False)
class Cell:
    """One trained pair of u and v.

    curve: motion change per frame after the seed, already a mean over seeds, ``(N,)`` (``metrics.motion_change``).
    motion: a short clip that the network made, to be watched; its first ``seed_frames`` frames were given to it.
    notes: numbers and words about it, ``{"error at 400 ms": 1.89, "frozen": "3 of 20"}``.
    """

    curve: np.ndarray
    motion: Motion | None = None
    notes: Mapping[str, float | str | None] = field(default_factory=dict)
    seed_frames: int = 0


def explorer(
    cells: Mapping[tuple[int, int], Cell],
    *,
    truth: float | None = None,
    fps: float = 30.0,
    start: tuple[int, int] | None = None,
    smooth: int = 15,
    unit: str = "motion change per frame",
    title: str = "Auto-conditioning: u frames of truth, then v of the network's own",
    width: int = 720,
    height: int = 360,
    picture: bool = True,
) -> Explorer:
    """Two sliders for u and v over a grid of trained networks, to be the last line of a cell, or ``.save(path)``.

    cells: ``{(u, v): Cell}``; u of 1 or more, v of 0 or more. With v = 0 every frame is the truth whatever u
        is: teacher forcing, at most once. Pairs that are missing can be chosen, and are said to be missing.
    truth: the mean motion change of real motion, a dotted line.
    fps: frames a second of the curves; smooth: they are drawn as running means over so many frames.
    start: the pair shown at first; without, the first of ``cells``.
    width, height: of the explorer, and of its player, in pixels of the page.
    picture: put a picture of all pairs (PNG) before the explorer, for pages where no script runs.
    Raises ``TutorialError`` for pairs and curves that cannot be.
    """
    return Explorer(
        cells, truth=truth, fps=fps, start=start, smooth=smooth, unit=unit, title=title, width=width, height=height,
        picture=picture,
    )  # fmt: skip


class Explorer(PageOutput):
    """What ``explorer`` returns: displays itself in a notebook, ``html`` is its page part, ``save`` writes a page.

    ``spec`` (JSON-able) and ``payload`` (bytes) are what ``explore`` in ``explorer.js`` takes; ``players`` are
    the players of the pairs that have a motion.
    """

    def __init__(
        self,
        cells: Mapping[tuple[int, int], Cell],
        *,
        truth: float | None = None,
        fps: float = 30.0,
        start: tuple[int, int] | None = None,
        smooth: int = 15,
        unit: str = "motion change per frame",
        title: str = "Auto-conditioning: u frames of truth, then v of the network's own",
        width: int = 720,
        height: int = 360,
        picture: bool = True,
    ):
        if truth is not None and not (math.isfinite(truth) and truth > 0):
            raise TutorialError(f"explorer: true motion change {truth}, expected a number above zero")
        if not (math.isfinite(fps) and fps > 0):
            raise TutorialError(f"explorer: {fps} frames a second, expected a number above zero")
        self.cells = _checked(cells, smooth)
        self.truth, self.fps, self.unit, self.title, self.picture = truth, float(fps), unit, title, picture
        self.smooth = smooth
        # with v = 0 any u is the same: it adds none to the slider
        us = sorted({u for u, v in self.cells if v} or {u for u, _ in self.cells})
        vs = sorted({v for _, v in self.cells})
        u, v = next(iter(self.cells)) if start is None else start
        if v == 0 and start is None and u not in us:
            u = us[0]
        if u not in us or v not in vs:
            raise TutorialError(f"explorer: start {start}, expected u of {us} and v of {vs}")
        self.curves = {pair: moving_mean(np.asarray(cell.curve, float), smooth) for pair, cell in self.cells.items()}
        values = np.concatenate(list(self.curves.values()))
        highest = max(values[np.isfinite(values)].max(initial=0.0), 1.2 * (truth or 0.0)) or 1.0
        self.top = float(min(1.05 * highest, _TOP * truth) if truth else 1.05 * highest)
        self.length = max(len(cell.curve) for cell in self.cells.values())
        every = max(1, math.ceil(self.length / _POINTS))

        self.players: dict[tuple[int, int], Player] = {}
        for pair, cell in self.cells.items():
            if cell.motion is not None:
                self.players[pair] = Player(
                    cell.motion, labels=pair_name(*pair), seed_frames=cell.seed_frames, step=CLIP_STEP,
                    width=width - 26, height=height, title=f"{pair_name(*pair)}: {_lasts(cell.motion)}",
                )  # fmt: skip
        common = _common([player.spec for player in self.players.values()])
        payload, drawn = bytearray(), []
        for (u_, v_), cell in self.cells.items():
            entry: dict[str, Any] = {
                "u": u_,
                "v": v_,
                "curve": _thousandths(self.curves[u_, v_][::every], self.top),
                "notes": [[str(name), note(value)] for name, value in cell.notes.items()],
            }
            if player := self.players.get((u_, v_)):
                entry["player"] = {
                    "spec": {name: value for name, value in player.spec.items() if name not in common},
                    "bytes": [len(payload), len(payload) + len(player.payload)],
                    "seed": player.seed_frames[0] / cell.motion.fps,  # seconds
                }
                payload += player.payload
            drawn.append(entry)
        self.payload = bytes(payload)
        self.spec: dict[str, Any] = {
            "title": title,
            "unit": unit,
            "width": int(width),
            "style": page_file("controls.css", "explorer.css"),
            "us": us,
            "vs": vs,
            "start": [u, v],
            "fps": int(fps) if float(fps).is_integer() else float(fps),
            "truth": truth,
            "top": self.top,
            "frames": self.length,
            "first": (smooth - 1) / 2 + 1,  # the frame after the seed that a curve's first value belongs to
            "every": every,
            "player": common if self.players else None,
            "cells": drawn,
        }

    @functools.cached_property
    def html(self) -> str:
        """Self-contained HTML: an element and the script that fills every copy of it on the page."""
        return filled_element(
            "explorer",
            "explore",
            self.spec,
            self.payload,
            hint=_HINT,
            scripts=["page.js", "player.js", "stage.js", "explorer.js"],
        )

    @functools.cached_property
    def figure(self) -> NotebookFigure:
        """All pairs at once, a row each: schedule, motion change, notes."""
        return _overview(self)

    @property
    def png(self) -> bytes:
        """``figure`` as a PNG file's bytes."""
        return self.figure.png()

    @property
    def alt(self) -> str:
        """What the picture shows, in words."""
        return f"{self.title}. Schedule and motion change of {', '.join(pair_name(*pair) for pair in self.cells)}"

    def __repr__(self) -> str:
        return f"<Explorer: {len(self.cells)} pairs, {len(self.players)} with a motion>"


def pair_name(u: int, v: int) -> str:
    """What a pair is called: ``"u = 5, v = 5"``, or teacher forcing where v is 0."""
    return f"u = {u}, v = {v}" if v else "teacher forcing"


def note(value: float | str | None) -> str:
    """A note as it is written: numbers to three digits, a dash for one that is not finite or None."""
    if value is None or (not isinstance(value, str) and not math.isfinite(value)):
        return "–"
    return value if isinstance(value, str) else f"{value}" if isinstance(value, int) else f"{float(value):.3g}"


def _checked(cells: Mapping[tuple[int, int], Cell], smooth: int) -> dict[tuple[int, int], Cell]:
    if not isinstance(cells, Mapping) or not cells:
        raise TutorialError("explorer: no cells, expected at least one, {(u, v): Cell(...)}")
    known: dict[tuple[int, int], Cell] = {}
    for pair, cell in cells.items():
        whole = isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(x, (int, np.integer)) for x in pair)
        if not whole or pair[0] < 1 or pair[1] < 0:
            raise TutorialError(f"explorer: pair {pair!r}, expected (u, v), whole numbers, u from 1 and v from 0")
        if not isinstance(cell, Cell):
            raise TutorialError(f"explorer: {type(cell).__name__} at {pair}, expected a Cell")
        shape = np.shape(cell.curve)
        if len(shape) != 1 or shape[0] < smooth:
            raise TutorialError(f"explorer: a curve of shape {shape} at {pair}, expected ({smooth} or more,)")
        known[int(pair[0]), int(pair[1])] = cell
    if sum(v == 0 for _, v in known) > 1:
        raise TutorialError("explorer: several pairs with v = 0, expected one: they are all teacher forcing")
    return known


def _common(specs: list[dict[str, Any]]) -> dict[str, Any]:
    """What all the players have alike, to be sent once."""
    return {k: v for k, v in specs[0].items() if all(s[k] == v for s in specs)} if specs else {}


def _thousandths(curve: np.ndarray, top: float) -> list[int | None]:
    """Whole thousandths of ``top``, None where the curve is not finite; 9,999 stands for all above."""
    return [int(min(9999, round(1000 * x / top))) if math.isfinite(x) else None for x in curve.tolist()]


def _lasts(motion: Motion) -> str:
    return f"{len(motion)} frames, {(len(motion) - 1) / motion.fps:.1f} s"


def _overview(shown: Explorer) -> NotebookFigure:
    names = list(dict.fromkeys(str(name) for cell in shown.cells.values() for name in cell.notes))[:4]
    wide, row, head, foot = 7.2, 0.34, 0.72, 0.32  # inches
    note_width = 0.66
    notes = wide - 0.06 - note_width * len(names)
    squares, at = 20, 1.12
    square = 0.095 + 0.015 * (4 - len(names))
    curve = at + squares * square + 0.14
    total = head + len(shown.cells) * row + foot
    figure = NotebookFigure(figsize=(wide, total), dpi=100, facecolor="white")

    def write(x: float, y: float, words: str, **style) -> None:
        figure.text(x / wide, 1 - y / total, words, **{"fontsize": 8, "color": "#24292f", "va": "bottom", **style})

    def axes_at(x: float, y: float, width: float, height: float) -> Axes:
        return figure.add_axes((x / wide, 1 - (y + height) / total, width / wide, height / total))

    write(0.06, 0.08, shown.title, fontsize=9.5, weight="bold", va="top")
    write(at, head - 0.04, "fed: truth (dark),\nown output (light)", linespacing=1.1)
    write(curve, head - 0.04, textwrap.fill(shown.unit, 20), linespacing=1.1)
    for k, name in enumerate(names):
        write(notes + (k + 0.5) * note_width, head - 0.04, textwrap.fill(name, 9), ha="center", linespacing=1.1)
    for i, ((u, v), cell) in enumerate(shown.cells.items()):
        y = head + i * row
        write(0.06, y + row / 2, pair_name(u, v), va="center")
        axes = axes_at(at, y + (row - square) / 2, squares * square, square)
        draw_schedule(axes, (np.arange(squares) % (u + v) < u)[None], 0.0, line=0.5)
        axes.set(xlim=(0, squares), ylim=(1, 0))
        axes.axis("off")
        axes = axes_at(curve, y + 0.1 * row, notes - curve - 0.06, 0.8 * row)
        if shown.truth:
            axes.axhline(shown.truth, color=palette.GREY, linewidth=1, linestyle=(0, (1, 2)))
        values = shown.curves[u, v]
        axes.plot(np.arange(len(values)) + shown.spec["first"], values, color=palette.BLUE, linewidth=1.3)
        axes.set(xlim=(0, shown.length), ylim=(0, shown.top), xticks=[], yticks=[])
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.spines["bottom"].set_color("#c3cad3")
        for k, name in enumerate(names):
            value = note(cell.notes[name]) if name in cell.notes else "–"
            write(notes + (k + 0.5) * note_width, y + row / 2, value, ha="center", va="center")
    true = f"; dotted: true motion, {shown.truth:.3g}" if shown.truth else ""
    says = (
        f"Curves: frames 0 to {shown.length} after the seed, {shown.fps:g} a second; height 0 to {shown.top:.2g}{true}."
    )
    write(0.06, total - 0.08, says, fontsize=7.5, color=palette.GREY)
    return figure
